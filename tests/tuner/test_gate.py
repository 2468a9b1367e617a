"""The one way to the machine: whatever operators do, no motion leaves the bounds of now unasked."""

from __future__ import annotations

import ast
import json
import math
from collections.abc import Coroutine, Mapping, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import assume, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule
from rclpy.task import Future

import mobo_tuner
from mobo_msgs_py import msg
from mobo_msgs_py.action import ApplySetpoint, EvaluateSetpoint
from mobo_msgs_py.srv import DescribeMachine
from mobo_tuner.core import Optimizer, Problem, ProblemError
from mobo_tuner.core.machine_facts import MachineFacts
from mobo_tuner.errors import UserError
from mobo_tuner.ros.conversions import values_of
from mobo_tuner.runs.history import History
from mobo_tuner.runs.records import StartRecord
from mobo_tuner.runs.run_log import RunLog
from mobo_tuner.tuner.gate import (
    BoundsError,
    EvaluationRequest,
    Gate,
    Target,
    check_bounds,
    check_grids,
    settle_on_bounds,
)
from mobo_tuner.tuner.machine_client import Answer, FeedbackCallback
from mobo_tuner.tuner.run.fallbacks import Fallbacks, fallback_target
from mobo_tuner.tuner.run.loop import take_queued
from mobo_tuner.tuner.run.run import Outcome, Run, Suggestion
from mobo_tuner.tuner.run.steering import Change
from mobo_tuner.tuner.services.parameter_changes import check_reach
from mobo_tuner.tuner.services.steering import check_queued

PACKAGE = Path(mobo_tuner.__file__).parent
ROOMS = ("tuner", "nodes")  # of which the tuner's node is made
LIMITS = {"x": (-2.0, 12.0), "y": (-6.0, 6.0)}
WIDEST = {"x": (0.0, 10.0), "y": (-5.0, 5.0)}
POLICIES = ("hold", "restore", "restore_anyway", "best")


def make_problem(bounds: Mapping[str, tuple[float, float]]) -> Problem:
    return Problem.from_dict(
        {
            "variables": {
                n: {"min": low, "max": high, "approach": 0.5} for n, (low, high) in bounds.items()
            },
            "objectives": {name: {"reference": 20.0} for name in ("f", "g")},
        }
    )


def measure(at: Mapping[str, float]) -> dict[str, tuple[float, float]]:
    return {
        "f": (math.hypot(at["x"], at["y"]), math.nan),
        "g": (math.hypot(at["x"] - 8.0, at["y"] - 3.0), math.nan),
    }


def finish(coroutine: Coroutine[Any, Any, Any]) -> Any:
    """The result of a coroutine that waits for nothing."""
    try:
        coroutine.send(None)
    except StopIteration as end:
        return end.value
    raise AssertionError("the coroutine waits")


class Trace:
    """The machine's end of the gate: keeps what was sent."""

    action_name = "/evaluate_setpoint"
    is_there = True

    def __init__(self) -> None:
        self.sent: list[dict[str, float]] = []

    async def describe(self, timeout: float, *_: Future) -> DescribeMachine.Response:
        del timeout
        variables = [msg.Variable(name=n, min=low, max=high) for n, (low, high) in LIMITS.items()]
        return DescribeMachine.Response(name="trace", variables=variables)

    async def where(self, *_: Future, patience: float = 0.0) -> dict[str, float]:
        del patience
        return self.sent[-1]

    async def evaluate(
        self, goal: EvaluateSetpoint.Goal, on_feedback: FeedbackCallback, *_: Future
    ) -> Answer:
        del on_feedback
        named = (
            *(goal.setpoint, goal.if_client_lost_via, goal.if_client_lost),
            *(goal.if_violated_via, goal.if_violated),
        )
        self.sent += [values_of(each) for each in named if each]
        return Answer(0, "", 0.0, {}, measure(values_of(goal.setpoint)))

    async def apply(
        self,
        goal: ApplySetpoint.Goal,
        on_feedback: FeedbackCallback,
        *_: Future,
        leave: Future | None = None,
    ) -> Answer:
        del on_feedback, leave
        self.sent += [values_of(each) for each in (goal.via, goal.setpoint) if each]
        return Answer(0, "", 0.0)

    async def send_off(self, goal: ApplySetpoint.Goal, timeout: float) -> bool:
        del timeout
        self.sent += [values_of(each) for each in (goal.via, goal.setpoint) if each]
        return True


def inside(at: Mapping[str, float], problem: Problem) -> bool:
    return all(v.minimum <= at[v.name] <= v.maximum for v in problem.variables)


class Shift(RuleBasedStateMachine):
    """What operators do in a shift, against the tuner's own logic without its node."""

    def __init__(self) -> None:
        super().__init__()
        self.problem = make_problem(WIDEST)
        self.trace = Trace()
        self.gate = Gate(self.trace, lambda: self.problem)
        finish(self.gate.describe(1.0))
        self.crossing: set[tuple[float, ...]] = set()  # set-points that an operator's word allows
        self.start_run()

    def start_run(self) -> None:
        optimizer = Optimizer(self.problem, seed=3, initial_evaluations=500)
        start = StartRecord("shift", 0.0, self.problem, {"model_input": "setpoint"})
        self.run = Run("shift", 500, optimizer, Future(), RunLog(None, start))

    def check(self, already: int) -> None:
        """Check everything that was sent since `already`, by the bounds of this moment."""
        for at in self.trace.sent[already:]:
            assert all(low <= at[n] <= high for n, (low, high) in LIMITS.items())
            assert inside(at, self.problem) or tuple(at.values()) in self.crossing

    def evaluate(self, setpoint: Mapping[str, float], policies: Sequence[str]) -> Answer:
        already = len(self.trace.sent)
        targets = [fallback_target(policy, self.run, self.gate) for policy in policies]
        self.crossing = {tuple(t.setpoint.values()) for t in targets if t is not None and t.anyway}
        request = EvaluationRequest(
            "shift", self.run.index, 0, setpoint, if_client_lost=targets[0], if_violated=targets[1]
        )
        answer: Answer = finish(self.gate.evaluate(request, {}, lambda _: None))
        self.check(already)
        return answer

    @rule(
        x=st.tuples(st.floats(-3.0, 13.0), st.floats(-3.0, 13.0)),
        y=st.tuples(st.floats(-7.0, 7.0), st.floats(-7.0, 7.0)),
    )
    def set_bounds(self, x: tuple[float, float], y: tuple[float, float]) -> None:
        try:
            problem = make_problem({"x": x, "y": y})
            MachineFacts(LIMITS, {"f": "", "g": ""}).check(problem)
            check_reach(self.run, problem)
        except ProblemError:
            return
        self.problem = problem
        self.run.steering.change = Change(problem, self.run.budget)

    @rule(x=st.floats(-3.0, 13.0), y=st.floats(-7.0, 7.0))
    def queue(self, x: float, y: float) -> None:
        try:
            check_queued(self.run, self.gate, {"x": x, "y": y})
        except UserError:
            assert not inside({"x": x, "y": y}, self.problem)
        else:
            self.run.steering.queue.append({"x": x, "y": y})

    @rule(policies=st.tuples(st.sampled_from(POLICIES), st.sampled_from(POLICIES)))
    def evaluate_next(self, policies: tuple[str, str]) -> None:
        change, self.run.steering.change = self.run.steering.change, None
        if change is not None:
            self.run.apply(change, 0.0)
        suggestion = self.run.suggest()
        queued, _ = take_queued(self.run, self.gate)
        if queued is not None:
            suggestion = Suggestion(queued, "operator", 0.0)
        answer = self.evaluate(suggestion.setpoint, policies)
        self.run.learn(suggestion, Outcome(answer, 1))

    @rule(policies=st.tuples(st.sampled_from(POLICIES), st.sampled_from(POLICIES)))
    def try_again_after_a_change(self, policies: tuple[str, str]) -> None:
        setpoint = self.run.suggest().setpoint  # of the bounds before, if they were changed
        try:
            self.evaluate(setpoint, policies)
        except BoundsError:
            assert not inside(setpoint, self.problem)

    @rule(x=st.floats(-2.1, 12.1), y=st.floats(-6.1, 6.1))
    def begin_elsewhere(self, x: float, y: float) -> None:
        self.start_run()
        self.run.state_before = settle_on_bounds(self.problem, {"x": x, "y": y})

    @precondition(lambda self: self.run.found.front)
    @rule(data=st.data(), anyway=st.booleans())
    def go(self, data: st.DataObject, anyway: bool) -> None:
        point = data.draw(st.sampled_from(self.run.found.front))["setpoint"]
        already = len(self.trace.sent)
        self.crossing = {tuple(point.values())} if anyway else set()
        try:
            finish(self.gate.move(Target(point, anyway), {}, lambda _: None))
        except BoundsError:
            assert not anyway
            assert not inside(point, self.problem)
        self.check(already)

    @rule(policy=st.sampled_from(POLICIES), ending=st.booleans())
    def abort(self, policy: str, ending: bool) -> None:
        already = len(self.trace.sent)
        target = fallback_target(policy, self.run, self.gate)
        assume(target is not None)
        assert target is not None
        self.crossing = {tuple(target.setpoint.values())} if target.anyway else set()
        if ending:
            assert finish(self.gate.send_off(target, {}, 1.0))
        else:
            finish(self.gate.move(target, {}, lambda _: None))
        self.check(already)

    @precondition(lambda self: self.run.found.front)
    @rule(data=st.data(), radius=st.floats(0.001, 1.0))
    def hold(self, data: st.DataObject, radius: float) -> None:
        point = data.draw(st.sampled_from(self.run.found.front))
        try:
            focused = self.run.optimizer.focus(point["index"], None, radius, self.problem)
        except ProblemError:
            return
        assert inside(point["setpoint"], self.problem)
        corners = [{v.name: getattr(v, side) for v in focused.problem.variables} for side in SIDES]
        assert all(inside(corner, self.problem) for corner in corners)
        start = StartRecord("held", 0.0, focused.problem, {"model_input": "setpoint"})
        written = [json.loads(line) for line in RunLog(None, start).outline.splitlines()]
        assert History.from_records(written).problem == focused.problem
        self.evaluate(point["setpoint"], ("hold", "hold"))

    @invariant()
    def best_is_inside(self) -> None:
        best = fallback_target("best", self.run, self.gate)
        if best is None:
            return
        assert inside(best.setpoint, self.problem)
        if best.via is not None:  # it comes from the side from which the evaluation came
            index = next(p["index"] for p in self.run.found.front if p["setpoint"] == best.setpoint)
            before = self.run.records[index - 1][1].setpoint if index else self.run.state_before
            assert before is not None
            for name, value in best.via.items():
                way, back = value - best.setpoint[name], before[name] - best.setpoint[name]
                assert abs(way) <= min(0.5, abs(back)) + 1e-9
                assert way * back >= 0.0
            assert inside(best.via, self.problem)


SIDES = ("minimum", "maximum")
Shift.TestCase.settings = settings(
    max_examples=40, stateful_step_count=25, deadline=None, derandomize=True
)
TestShift = Shift.TestCase


@pytest.fixture
def gate() -> Gate:
    gate = Gate(Trace(), lambda: make_problem({"x": (2.0, 8.0), "y": (-5.0, 5.0)}))
    finish(gate.describe(1.0))
    return gate


@pytest.mark.parametrize(
    ("at", "anyway", "sentence"),
    [
        ({"x": 8.5, "y": 0.0}, False, "set-point x is 8.5; 2 to 8 is allowed"),
        ({"x": 12.5, "y": 0.0}, True, "set-point x is 12.5; -2 to 12 is allowed"),
        ({"x": math.nan, "y": 0.0}, True, "set-point x is nan; -2 to 12 is allowed"),
    ],
)
def test_what_is_refused_is_not_sent(
    gate: Gate, at: dict[str, float], anyway: bool, sentence: str
) -> None:
    with pytest.raises(BoundsError, match=sentence):
        finish(gate.move(Target(at, anyway), {}, lambda _: None))


def test_an_operators_word_leads_across_the_bounds(gate: Gate) -> None:
    assert gate.allows(Target({"x": 8.5, "y": 0.0}, anyway=True))
    assert not gate.allows(Target({"x": 8.5, "y": 0.0}))


def test_a_fallback_outside_the_bounds_is_not_sent(gate: Gate) -> None:
    request = EvaluationRequest(
        "run", 0, 0, {"x": 5.0, "y": 0.0}, if_violated=Target({"x": 9.0, "y": 0.0})
    )
    with pytest.raises(BoundsError, match="x is 9"):
        finish(gate.evaluate(request, {}, lambda _: None))


def test_a_readback_a_hair_outside_is_taken_for_the_bound() -> None:
    problem = make_problem({"x": (2.0, 8.0), "y": (-5.0, 5.0)})
    assert settle_on_bounds(problem, {"x": 8.05, "y": -5.2}) == {"x": 8.0, "y": -5.2}


def test_a_fallback_that_would_not_act_is_said_until_it_would() -> None:
    shift = Shift()
    shift.run.state_before = {"x": 6.0, "y": 4.0}
    suggestion = Suggestion({"x": 1.0, "y": 1.0}, "operator", 0.0)
    answer = shift.evaluate(suggestion.setpoint, ("hold", "hold"))
    shift.run.learn(suggestion, Outcome(answer, 1))
    policies = {
        "on_end": "best",
        "on_abort": "restore",
        "on_violation": "restore_anyway",
        "on_client_lost": "hold",
    }
    context: Any = SimpleNamespace(gate=shift.gate, parameters=SimpleNamespace(**policies))
    fallbacks = Fallbacks(context)
    assert fallbacks.hints(shift.run) == []
    shift.problem = make_problem({"x": (3.0, 5.0), "y": (3.0, 5.0)})
    best, restore = fallbacks.hints(shift.run)
    assert best.startswith("on_end is 'best', but the machine would hold: no point of the front")
    assert restore.startswith("on_abort is 'restore', but the machine would hold: ")
    shift.problem = make_problem(WIDEST)
    assert fallbacks.hints(shift.run) == []


def names_in(path: Path) -> set[str]:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    names = {n.id for n in ast.walk(tree) if isinstance(n, ast.Name)}
    return names | {n.attr for n in ast.walk(tree) if isinstance(n, ast.Attribute)}


def test_only_the_gate_talks_to_the_machine() -> None:
    """Only the machine's client makes clients of interfaces, and only the gate is given one."""
    names = {path.relative_to(PACKAGE): names_in(path) for path in PACKAGE.rglob("*.py")}
    of_the_machine = ("EVALUATE_SETPOINT", "APPLY_SETPOINT", "DESCRIBE_MACHINE")
    for name in (*of_the_machine, "send_goal_async", "MachineClient"):
        users = {str(p) for p, found in names.items() if name in found and p.parts[0] in ROOMS}
        expected = {"tuner/machine_client.py"}
        if name == "MachineClient":  # a worker of a campaign has a machine of its own
            expected = {"nodes/tuner.py", "nodes/twin.py"}
        if name == "DESCRIBE_MACHINE":  # `mobo.py new` asks for it, too; nothing moves
            expected.add("nodes/new_config.py")
        assert users == expected, name
    for path, found in names.items():
        if path.parts[0] in ROOMS and path.name != "machine_client.py":
            assert not found & {"ActionClient", "create_client"}, path
    tree = ast.parse((PACKAGE / "nodes" / "tuner.py").read_text(encoding="utf-8"))
    calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call)]
    (gate,) = (call for call in calls if ast.unparse(call.func) == "Gate")
    given = [call for call in calls if ast.unparse(call.func) == "MachineClient"]
    assert given == [gate.args[0]]


def test_a_queued_set_point_is_on_the_grids() -> None:
    variables = {
        "x": {"min": 0.0, "max": 10.0, "step": 0.5},
        "y": {"choices": [-1.0, 2.0]},
        "z": {"min": 0.0, "max": 1.0, "fixed": 0.5},
    }
    problem = Problem.from_dict({"variables": variables, "objectives": {"f": {"reference": 1.0}}})
    check_grids(problem, {"x": 1.5, "y": 2.0, "z": 0.7})
    for setpoint, words in (
        ({"x": 1.6, "y": 2.0, "z": 0.5}, ("x is 1.6", "1.5 and 2")),
        ({"x": 1.5, "y": 0.0, "z": 0.5}, ("y is 0", "-1 and 2")),
    ):
        with pytest.raises(BoundsError) as error:
            check_grids(problem, setpoint)
        assert all(word in str(error.value) for word in words)


def test_a_limit_between_variables_is_a_bound() -> None:
    limits = {"sum": {"x": 1.0, "y": 1.0, "max": 11.0}}
    problem = Problem.from_dict({**make_problem(WIDEST).to_dict(), "limits": limits})
    check_bounds(problem, {"x": 6.0, "y": 5.0})
    check_bounds(problem, {"x": 6.0})  # a readback is missing
    with pytest.raises(BoundsError, match=r"limit sum is 11\.5"):
        check_bounds(problem, {"x": 6.5, "y": 5.0})

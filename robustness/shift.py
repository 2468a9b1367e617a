"""Random shifts: what operators do and how the machine fails, against a model of what must hold.

The tuner's own node, a machine and an operator live in one process. A shift is a list of actions drawn from its seed:
runs, pauses, steps, skips, stops, cancels, set-points, changes of bounds, limits, references and budget, working points
with and without holding, withdrawals, queries of earlier runs, and faults of the machine. What must hold:

- every set-point that the tuner sends is inside the bounds as they are then, unless an operator said `anyway`;
- requests are answered in time, and refused without a run; a run ends when it is asked to;
- status, result, journal and a restored optimiser agree on counts, front and hypervolume;
- a pause or a wait has a reason; every answer names the run that was asked for; queries change nothing;
- every journal can be read and resumed, and no error is internal.

A shift that fails is shortened to the actions that are needed for it.
"""

from __future__ import annotations

import argparse
import math
import os
import shutil
import sys
import tempfile
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import rclpy
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.action import ActionClient
from rclpy.executors import SingleThreadedExecutor
from rclpy.logging import LoggingSeverity, set_logger_level
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from std_srvs.srv import Trigger

from launcher.ros_domain import RosDomain
from mobo_msgs_py import msg
from mobo_msgs_py.action import EvaluateSetpoint, GoToWorkingPoint, Tune
from mobo_msgs_py.srv import Ask, ForgetEvaluation, ListWorkingPoints, QueueSetpoint, Tell
from mobo_tuner.machine.double import Answer, MachineDouble
from mobo_tuner.nodes.tuner import Tuner
from mobo_tuner.ros import interfaces
from mobo_tuner.ros.conversions import named_values, values_of
from mobo_tuner.ros.process import STOP_TIMEOUT
from mobo_tuner.runs.history import History
from mobo_tuner.runs.journal import FILE_NAME, read_journal
from mobo_tuner.runs.replay import restore
from robustness.offline_run import toy

TOY = Path(__file__).parents[1] / "config" / "toy.yaml"
NAMES = ("x1", "x2")
LIMIT = 3.0  # of the machine's variables, on both sides
PATIENCE = 30.0  # [s] for an answer, and for a run to end
QUERIES = ("points", "points of an earlier run")
_CODES = EvaluateSetpoint.Result
FAULTS = (
    _CODES.INTERLOCK,
    _CODES.NOT_ACTIVE,
    _CODES.MACHINE_LOST,
    _CODES.TIMEOUT,
    _CODES.INVALID_MEASUREMENT,
    _CODES.VIOLATION,
    _CODES.BUSY,
)
POLICIES = {
    "on_interlock": ("wait", "retry", "pause", "abort"),
    "on_fault": ("wait", "retry", "pause", "abort"),
    "on_failure": ("skip", "retry", "pause", "abort"),
    "on_abort": ("hold", "restore", "best"),
    "on_violation": ("hold", "restore", "best"),
    "on_client_lost": ("hold", "restore", "best"),
    "pause_on_violation": ("true", "false"),
    "model_input": ("setpoint", "readback"),
}
CONSTANTS = {
    "retry_delay": 0.1,
    "interlock_timeout": 1.0,
    "machine_return_timeout": 1.0,
    "machine_timeout": 1.0,
    "discovery_timeout": 5.0,
    "max_consecutive_failures": 4,
    "initial_evaluations": 30,
}
WEIGHTS = {
    "tune": 8,
    "resume run": 2,
    "wait": 10,
    "pause": 4,
    "resume": 6,
    "step": 3,
    "skip": 4,
    "stop_after_this": 2,
    "cancel": 2,
    "queue": 6,
    "bounds": 6,
    "limits": 2,
    "reference": 2,
    "budget": 2,
    "go": 6,
    "forget": 3,
    "unforget": 2,
    "points": 2,
    "points of an earlier run": 2,
    "ask and tell": 2,
    "fault": 4,
    "hold the machine": 2,
    "release the machine": 3,
}


class Act(NamedTuple):
    """One action; the numbers in [0, 1) decide about its details, so that others may be left out before it."""

    name: str
    numbers: tuple[float, float, float]


class BrokenPromiseError(AssertionError):
    """Something that must hold did not."""


class Watch:
    """The machine's client, with a check of everything that is sent.

    Args:
        client: Client of the machine.
        check: Function that is given each set-point before it is sent.
    """

    def __init__(self, client: Any, check: Callable[[Mapping[str, float]], None]) -> None:
        self._client = client
        self._check = check

    def __getattr__(self, name: str) -> Any:
        return getattr(self._client, name)

    async def evaluate(self, goal: EvaluateSetpoint.Goal, *others: Any) -> Any:
        """Have a set-point evaluated."""
        for named in (goal.setpoint, goal.if_client_lost, goal.if_violated):
            self._check(values_of(named))
        return await self._client.evaluate(goal, *others)

    async def apply(self, setpoint: Sequence[msg.NamedValue], *others: Any, **more: Any) -> Any:
        """Have the machine go to a set-point."""
        self._check(values_of(setpoint))
        return await self._client.apply(setpoint, *others, **more)

    async def send_off(self, setpoint: Sequence[msg.NamedValue], timeout: float) -> Any:
        """Have the machine go to a set-point by itself."""
        self._check(values_of(setpoint))
        return await self._client.send_off(setpoint, timeout)


class Shift:
    """One shift.

    Args:
        folder: Folder of its runs, which is empty.
        seed: Seed of the policies.
        domain: ROS domain, which nobody else uses.
    """

    def __init__(self, folder: Path, seed: int, domain: int) -> None:
        rng = np.random.default_rng([seed, 1])
        policies = {name: str(rng.choice(choices)) for name, choices in POLICIES.items()}
        given = {**policies, **CONSTANTS, "runs_dir": folder, "seed": seed}
        words = [w for n, v in given.items() for w in ("-p", f"tuner:{n}:={v}")]
        rclpy.init(
            args=["--ros-args", "--params-file", str(TOY), *words],
            domain_id=domain,
            signal_handler_options=SignalHandlerOptions.NO,
        )
        self._runs_dir = folder
        self._executor = SingleThreadedExecutor()
        self._tuner = Tuner(self._executor)
        set_logger_level("tuner", LoggingSeverity.FATAL)
        self._executor.add_node(self._tuner.node)
        self._node = Node("operator", use_global_arguments=False)
        self._executor.add_node(self._node)
        set_logger_level("operator", LoggingSeverity.FATAL)
        self._faults: deque[int] = deque()
        limits = dict.fromkeys(NAMES, (-LIMIT, LIMIT))
        self._machine = MachineDouble(self._node, limits, ("f1", "f2", "g"), self._answer)
        self._machine.position = dict.fromkeys(NAMES, 0.5)
        gate = self._tuner._context.gate
        gate._machine = Watch(gate._machine, self._check_motion)
        self._bounds = dict.fromkeys(NAMES, (-2.0, 2.0))
        self._asked_bounds: dict[str, tuple[float, float]] | None = None  # not answered yet
        self._crossing: dict[str, float] | None = None  # where an operator sends the machine anyway
        self._broken: list[str] = []
        self._status = msg.TunerStatus()
        interfaces.STATUS.subscription(self._node, self._hear)
        self._clients: dict[str, Any] = {}
        self._tune = ActionClient(self._node, Tune, "tune")
        self._go = ActionClient(self._node, GoToWorkingPoint, "go_to_working_point")
        self._handle: Any = None
        self._result: Any = None  # future of the active run
        self._ended: list[str] = []  # ids of runs that have ended
        self._latest = ""  # id of the run that began last
        self._number = 0
        self._spin(lambda: self._tune.server_is_ready() and self._go.server_is_ready(), "the tuner")

    def close(self) -> None:
        """Release everything."""
        self._machine.held = False
        stopped = self._executor.create_task(self._tuner.stop)
        deadline = time.monotonic() + STOP_TIMEOUT
        while not stopped.done() and time.monotonic() < deadline:
            self._executor.spin_once(timeout_sec=0.01)
        self._tuner.close()
        self._executor.shutdown(timeout_sec=1.0)
        self._node.destroy_node()
        rclpy.try_shutdown()

    # ------------------------------------------------------------------ the machine and what is seen

    def _answer(self, goal: EvaluateSetpoint.Goal) -> Answer:
        values = toy(values_of(goal.setpoint))
        if not self._faults:
            return Answer(values)
        code = self._faults.popleft()
        return Answer(values if code == _CODES.VIOLATION else {}, code, "a fault of this campaign")

    def _check_motion(self, at: Mapping[str, float]) -> None:
        if not at or at == self._crossing:
            return
        for bounds in (self._bounds, self._asked_bounds):
            if bounds is not None and all(
                bounds[n][0] - 1e-12 <= at[n] <= bounds[n][1] + 1e-12 for n in NAMES
            ):
                return
        self._broken.append(f"the machine is sent to {at}, outside {self._bounds}")

    def _hear(self, status: msg.TunerStatus) -> None:
        self._status = status
        if status.state == msg.TunerStatus.PAUSED and not status.message:
            self._broken.append("a pause has no reason")
        if status.state == msg.TunerStatus.WAITING and self._running and not status.message:
            self._broken.append("a wait has no reason")

    @property
    def _running(self) -> bool:
        return self._result is not None

    def _require(self, condition: object, text: str) -> None:
        if not condition:
            raise BrokenPromiseError(text)

    def _spin(self, condition: Callable[[], object], what: str, patience: float = PATIENCE) -> None:
        deadline = time.monotonic() + patience
        while not condition():
            self._require(time.monotonic() < deadline, f"{what}: nothing came in {patience:g} s")
            self._executor.spin_once(timeout_sec=0.01)
            if self._result is not None and self._result.done():
                self._conclude(self._result.result().result)
        self._require(not self._broken, "; ".join(self._broken[:2]))

    def _pass(self, seconds: float) -> None:
        """Let time pass."""
        end = time.monotonic() + seconds
        self._spin(lambda: time.monotonic() > end, "time")

    def _call(self, kind: Any, name: str, request: Any = None) -> Any:
        client = self._clients.setdefault(name, self._node.create_client(kind, name))
        self._spin(client.service_is_ready, f"the service {name}")
        answer = client.call_async(kind.Request() if request is None else request)
        self._spin(answer.done, f"the answer of {name}")
        return answer.result()

    # ------------------------------------------------------------------ what must hold

    def _conclude(self, result: Tune.Result) -> None:
        """Check everything that is known of a run that has ended."""
        self._result = self._handle = None
        self._crossing = None
        if not (self._runs_dir / result.run_id / FILE_NAME).is_file():  # it was refused
            self._require(result.error_msg, "a refusal has no reason")
            return
        self._ended.append(result.run_id)
        self._latest = result.run_id
        self._require(result.error_code != Tune.Result.INTERNAL, f"internal: {result.error_msg}")
        self._check_files(result.run_id, result.evaluations, result.pareto_front)
        self._spin(lambda: self._status.state == msg.TunerStatus.IDLE, "an idle tuner")
        status = self._status
        self._require(status.run_id == result.run_id, "the status has another run than the result")
        self._require(status.stop_reason == result.stop_reason, "another stop reason")
        self._require(status.evaluations == result.evaluations, "another number of evaluations")
        self._require(status.front_size == len(result.pareto_front.points), "another front")

    def _check_files(self, run_id: str, evaluations: int, front: msg.ParetoFront) -> None:
        history = History.from_records(read_journal(self._runs_dir / run_id))
        self._require(history.run_id == run_id, f"the journal of {run_id} names {history.run_id}")
        self._require(
            len(history.evaluations) == evaluations, f"the journal of {run_id} lacks evaluations"
        )
        optimizer = restore(history, None)
        kept = {point["index"] for point in optimizer.pareto_front()}
        told = {point.index for point in front.points}
        self._require(kept == told, f"the front of {run_id} is {kept} in its journal, {told} told")
        self._require(
            math.isclose(optimizer.hypervolume, front.hypervolume, rel_tol=1e-6, abs_tol=1e-9),
            f"the hypervolume of {run_id} is {optimizer.hypervolume}, {front.hypervolume} told",
        )

    # ------------------------------------------------------------------ actions

    def act(self, act: Act) -> None:
        """Do one action, and check what must hold.

        Raises:
            BrokenPromiseError: If something does not.
        """
        a, b, c = act.numbers
        name = act.name
        if name in ("tune", "resume run"):
            self._begin(name, a, b)
        elif name == "wait":
            self._pass(0.01 + 0.2 * a * a)
        elif name in ("pause", "resume", "step", "skip", "stop_after_this"):
            self._trigger(name)
        elif name == "cancel":
            if self._handle is not None:
                self._handle.cancel_goal_async()
        elif name == "queue":
            self._queue(a, b)
        elif name in ("bounds", "limits", "reference", "budget"):
            self._set(name, a, b, c)
        elif name == "go":
            self._go_to(a, b, c)
        elif name in ("forget", "unforget"):
            self._withdraw(name, a, b)
        elif name in QUERIES:
            self._list(earlier=name != "points", share=a)
        elif name == "ask and tell":
            self._ask_and_tell()
        elif name == "fault":
            self._faults.extend([FAULTS[int(a * len(FAULTS))]] * (1 + int(4 * b)))
        else:
            self._machine.held = name == "hold the machine"
        self._pass(0.002)

    def _begin(self, name: str, a: float, b: float) -> None:
        self._number += 1
        goal = Tune.Goal(run_id=f"run-{self._number}", evaluations=2 + int(14 * a))
        if name == "resume run":
            if not self._ended:
                return
            goal.resume_from = self._ended[int(b * len(self._ended))]
            goal.evaluations = 20 + int(20 * a)
        already = self._running
        sent = self._tune.send_goal_async(goal)
        self._spin(sent.done, "the answer to a goal")
        handle = sent.result()
        self._require(handle.accepted, "a goal was rejected")
        result = handle.get_result_async()
        if already and self._running:  # refused at once, unless the other run has just ended
            self._spin(lambda: result.done() or not self._running, "the refusal of a second run")
            if result.done():
                refusal = result.result().result
                self._require(refusal.error_code == Tune.Result.INVALID_GOAL, "two runs were begun")
                return
        self._result, self._handle = result, handle
        self._pass(0.02)
        if self._running:
            self._latest = goal.run_id

    def _trigger(self, name: str) -> None:
        idle = not self._running
        answer = self._call(Trigger, name)
        if idle:
            self._require(not answer.success, f"'{name}' was accepted without a run")
        self._require(answer.message, f"'{name}' has no answer in words")

    def _queue(self, a: float, b: float) -> None:
        setpoint = {"x1": LIMIT * (2.2 * a - 1.1), "x2": LIMIT * (2.2 * b - 1.1)}
        idle = not self._running
        request = QueueSetpoint.Request(setpoint=named_values(setpoint, {}))
        answer = self._call(QueueSetpoint, "queue_setpoint", request)
        inside = all(low <= setpoint[n] <= high for n, (low, high) in self._bounds.items())
        self._require(not (answer.success and idle), "a set-point was queued without a run")
        self._require(not answer.success or inside, f"{setpoint} was queued, out of bounds")

    def _set(self, kind: str, a: float, b: float, c: float) -> None:
        values: dict[str, Any]
        if kind == "bounds":
            name = NAMES[int(2.0 * c)]
            low, high = LIMIT * (1.2 * a - 1.01), LIMIT * (1.01 - 1.2 * b)
            values = {f"variables.{name}.min": low, f"variables.{name}.max": high}
            self._asked_bounds = {**self._bounds, name: (low, high)}
        elif kind == "limits":
            values = {"constraints.g.max": 4.0 * a - 1.0}
        elif kind == "reference":
            values = {f"objectives.f{1 + int(2.0 * c)}.reference": 0.5 + 6.0 * a}
        else:
            values = {"evaluations": 1 + int(25.0 * a)}
        request = SetParametersAtomically.Request(
            parameters=[Parameter(n, value=v).to_parameter_msg() for n, v in values.items()]
        )
        answer = self._call(SetParametersAtomically, "tuner/set_parameters_atomically", request)
        self._require(answer.result.successful or answer.result.reason, "a refusal has no reason")
        if answer.result.successful and self._asked_bounds is not None:
            self._bounds = self._asked_bounds
        self._asked_bounds = None

    def _go_to(self, a: float, b: float, c: float) -> None:
        before = self._latest
        goal = GoToWorkingPoint.Goal(anyway=c < 0.3, measure=c > 0.7)
        if self._ended and b < 0.3:
            goal.run_id = self._ended[int(a * len(self._ended))]
        listed = self._call(
            ListWorkingPoints, "list_working_points", ListWorkingPoints.Request(run_id=goal.run_id)
        )
        points = listed.measured.points if listed.success else []
        if points and b > 0.1:
            point = points[int(a * len(points))]
            goal.index = point.index
            if goal.anyway:
                self._crossing = values_of(point.setpoint)
        else:
            goal.choice = GoToWorkingPoint.Goal.BY_WEIGHTS
            goal.weights = named_values({"f1": a}, {})
            goal.anyway = False
        goal.hold_evaluations = int(3.0 * b) if c < 0.5 else 0
        active = self._running
        sent = self._go.send_goal_async(goal)
        self._spin(sent.done, "the answer to a move")
        finished = sent.result().get_result_async()
        if self._machine.held and not active:
            sent.result().cancel_goal_async()
        deadline = time.monotonic() + PATIENCE
        while not finished.done() and time.monotonic() < deadline:
            next_look = time.monotonic() + 0.5
            self._spin(lambda: finished.done() or time.monotonic() > next_look, "a move")  # noqa: B023
            if self._status.state == msg.TunerStatus.PAUSED:  # of a run that holds the point
                self._call(Trigger, "resume")
        self._spin(finished.done, "the end of a move")
        result = finished.result().result
        self._crossing = None
        self._require(
            result.error_code != GoToWorkingPoint.Result.INTERNAL, f"internal: {result.error_msg}"
        )
        if result.error_code == GoToWorkingPoint.Result.NONE:
            wanted = goal.run_id or before
            self._require(result.run_id == wanted, f"{result.run_id} in place of {wanted}")
            if not goal.hold_evaluations and goal.choice == GoToWorkingPoint.Goal.BY_INDEX:
                self._require(result.point.index == goal.index, "another point")
                at, meant = self._machine.position, values_of(result.point.setpoint)
                self._require(
                    all(abs(at[n] - meant[n]) < 1e-9 for n in NAMES), f"at {at}, not at {meant}"
                )

    def _withdraw(self, name: str, a: float, b: float) -> None:
        index = int(a * 1.1 * max(1, self._status.evaluations))
        request = ForgetEvaluation.Request(index=index, diagnostic="f1" if b < 0.4 else "")
        answer = self._call(ForgetEvaluation, name, request)
        self._require(answer.message, f"'{name}' has no answer in words")

    def _list(self, *, earlier: bool, share: float) -> None:
        run_id = self._ended[int(share * len(self._ended))] if earlier and self._ended else ""
        request = ListWorkingPoints.Request(run_id=run_id)
        answer = self._call(ListWorkingPoints, "list_working_points", request)
        wanted = run_id or self._latest
        if answer.success and wanted:
            self._require(
                answer.measured.run_id == wanted, f"{answer.measured.run_id} for {wanted}"
            )
        elif self._latest and not run_id:
            raise BrokenPromiseError(f"the front of the latest run is refused: {answer.message}")

    def _ask_and_tell(self) -> None:
        idle = not self._running
        asked = self._call(Ask, "ask")
        if not asked.success:
            self._require(asked.message, "a refusal has no reason")
            return
        self._require(idle or not self._running, "'ask' was answered during a run")
        self._latest = asked.run_id
        request = Tell.Request(
            run_id=asked.run_id,
            index=asked.index,
            setpoint=asked.setpoint,
            diagnostics=named_values(toy(values_of(asked.setpoint)), {}),
        )
        told = self._call(Tell, "tell", request)
        self._require(told.success or told.message, "a refusal has no reason")

    def end(self) -> None:
        """End the shift: the machine works, and the run ends when it is asked to."""
        self._machine.held = False
        self._faults.clear()
        if self._handle is not None:
            self._handle.cancel_goal_async()
            self._spin(lambda: not self._running, "the end of a canceled run")
        for path in sorted(self._runs_dir.glob("*/journal.jsonl")):
            History.from_records(read_journal(path))


def draw(seed: int, count: int) -> list[Act]:
    """Return the actions of a shift."""
    rng = np.random.default_rng([seed, 0])
    names = rng.choice(
        list(WEIGHTS), count, p=np.array([*WEIGHTS.values()]) / sum(WEIGHTS.values())
    )
    return [Act(str(name), (rng.random(), rng.random(), rng.random())) for name in names]


@contextmanager
def _folder() -> Iterator[Path]:
    folder = Path(tempfile.mkdtemp(prefix="shift-"))
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def live(seed: int, acts: Sequence[Act], domain: int) -> str:
    """Live one shift; return what did not hold, or nothing."""
    with _folder() as folder:
        shift = Shift(folder, seed, domain)
        try:
            for number, act in enumerate(acts):
                try:
                    shift.act(act)
                except Exception as error:  # whatever it is, it is a finding
                    return f"action {number}, {act.name}: {type(error).__name__}: {error}"
            try:
                shift.end()
            except Exception as error:
                return f"at the end: {type(error).__name__}: {error}"
        finally:
            shift.close()
    return ""


def shorten(
    acts: Sequence[Act], fails: Callable[[Sequence[Act]], bool], end: float
) -> Sequence[Act]:
    """Return as few of the actions as still fail, until a time by `time.monotonic` [s]."""
    size = max(1, len(acts) // 2)
    while size and time.monotonic() < end:
        start, shorter = 0, False
        while start < len(acts) and time.monotonic() < end:
            rest = [*acts[:start], *acts[start + size :]]
            if rest and fails(rest):
                acts, shorter = rest, True
            else:
                start += size
        if not shorter or size > 1:
            size = 0 if size == 1 else size // 2
    return acts


def main() -> int:
    """Live the shifts; print the failures, shortened, and a summary."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--actions", type=int, default=10_000, metavar="N")
    parser.add_argument("--per-shift", type=int, default=100, metavar="N")
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="seed of the first shift")
    parser.add_argument("--minutes", type=float, default=60.0, help="time for all shifts [min]")
    options = parser.parse_args()
    with RosDomain() as domain:
        os.environ.update(domain.environment)
        return _campaign(options, domain.id)


def _campaign(options: argparse.Namespace, domain: int) -> int:
    end = time.monotonic() + 60.0 * options.minutes
    lived: Counter[str] = Counter()
    failures = 0
    seed = options.seed
    while lived.total() < options.actions and time.monotonic() < end:
        acts = draw(seed, min(options.per_shift, options.actions - lived.total()))
        finding = live(seed, acts, domain)
        lived.update(act.name for act in acts)
        if finding:
            failures += 1

            def fails(some: Sequence[Act], seed: int = seed) -> bool:
                return bool(live(seed, some, domain))

            short = shorten(acts, fails, min(end, time.monotonic() + 120.0))
            print(f"seed {seed}: {finding}\n  {len(short)} actions are enough:", flush=True)
            for act in short:
                print(f"    {act}", flush=True)
        seed += 1
    print(
        f"{lived.total()} actions in {seed - options.seed} shifts, {failures} shifts failed; "
        + ", ".join(f"{count} {name}" for name, count in lived.most_common())
    )
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())

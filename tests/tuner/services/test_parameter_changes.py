"""Changes of the problem and the budget by parameters: checked, applied between evaluations, kept."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest
from rclpy.node import Node

from mobo_msgs_py import msg
from mobo_msgs_py.action import EvaluateSetpoint, Tune
from mobo_tuner.ros.qos import LATCHED
from tests.support.processes import NodeProcess
from tests.support.tuner import (
    CONFIG,
    GoalClient,
    Listener,
    Services,
    evaluated,
    journal,
    toy_machine,
)

NONE = EvaluateSetpoint.Result.NONE


def area(points: Sequence[tuple[float, float]], reference: tuple[float, float]) -> float:
    """What two-dimensional minimised points dominate below the reference point."""
    total, ceiling = 0.0, reference[1]
    for x, y in sorted(points):
        if x < reference[0] and y < ceiling:
            total += (reference[0] - x) * (ceiling - y)
            ceiling = y
    return total


def test_a_change_holds_from_the_next_evaluation_on(
    start_tuner: Callable[..., NodeProcess],
    client: GoalClient,
    services: Services,
    node: Node,
    spin_until: Callable[..., None],
    tmp_path: Path,
) -> None:
    machine = toy_machine(node)
    problems = Listener(node, msg.Problem, "problem", LATCHED)
    statuses = Listener(node, msg.TunerStatus, "status", LATCHED)
    start_tuner("initial_evaluations:=4", "evaluations:=7", "proximal:=costs")
    client.send(Tune.Goal(run_id="changed"))
    spin_until(lambda: len(client.feedback) >= 4, "four evaluations")
    machine.held = True
    count = len(machine.goals)
    spin_until(lambda: len(machine.goals) > count, "an evaluation that is held")
    held = machine.goals[-1].index
    values: dict[str, Any] = {
        "variables__x1__min": 0.5,
        "variables__x1__max": 1,  # an integer may stand for a number
        "variables__x2__cost": 3.0,
        "objectives__f1__reference": 3.0,
        "objectives__f2__truncation": [0.0, 4.5],
        "evaluations": 10,
    }
    result = services.set(**values)
    assert result.successful, result.reason
    assert problems.messages[-1].variables[0].max == 2.0  # not yet
    machine.held = False
    result = client.wait()
    assert (result.error_code, result.stop_reason, result.evaluations) == (0, "budget", 10)

    asked = [{s.name: s.value for s in goal.setpoint}["x1"] for goal in machine.goals]
    assert all(0.5 <= x1 <= 1.0 for x1 in asked[held + 1 :])
    assert not all(0.5 <= x1 <= 1.0 for x1 in asked[: held + 1])
    spin_until(lambda: problems.messages[-1].variables[0].max == 1.0, "the new problem")
    new = problems.messages[-1]
    assert (new.variables[0].min, new.variables[1].cost) == (0.5, 3.0)
    assert [o.reference for o in new.objectives] == [3.0, 4.3]
    assert (new.objectives[1].truncation_min, new.objectives[1].truncation_max) == (0.0, 4.5)
    assert statuses.messages[-1].budget == 10

    records = journal(tmp_path, "changed")
    [change] = [r for r in records if r["type"] == "change"]
    assert (change["index"], change["budget"]) == (held + 1, 10)
    assert change["problem"]["variables"]["x1"] == {
        **{"min": 0.5, "max": 1.0, "unit": "", "cost": 1.0}
    }
    assert records.index(change) == held + 2
    evaluations = [r for r in records if r["type"] == "evaluation"]
    points = [(r["diagnostics"]["f1"][0], r["diagnostics"]["f2"][0]) for r in evaluations]
    for n, record in enumerate(evaluations, start=1):
        reference = (4.3, 4.3) if n <= held + 1 else (3.0, 4.3)
        assert record["hypervolume"] == pytest.approx(area(points[:n], reference), rel=1e-12)


def test_costs_shorten_the_steps_of_a_run_that_goes_on(
    start_tuner: Callable[..., NodeProcess],
    client: GoalClient,
    services: Services,
    node: Node,
    spin_until: Callable[..., None],
    tmp_path: Path,
) -> None:
    machine = toy_machine(node)
    start_tuner("initial_evaluations:=6", "proximal:=costs")
    machine.held = True
    client.send(Tune.Goal(run_id="short", evaluations=12))
    spin_until(lambda: machine.goals, "an evaluation")
    result = services.set(variables__x1__cost=1e4, variables__x2__cost=0.0)
    assert result.successful, result.reason
    machine.held = False
    assert client.wait().error_code == 0
    x = [r["setpoint"] for r in journal(tmp_path, "short") if r["type"] == "evaluation"]
    steps = {
        name: [abs(x[i][name] - x[i - 1][name]) for i in range(6, 12)] for name in ("x1", "x2")
    }
    assert max(steps["x1"]) < 0.1
    assert max(steps["x2"]) > 0.3


def test_what_cannot_be_meant_is_refused_as_a_whole_with_one_sentence(
    start_tuner: Callable[..., NodeProcess],
    client: GoalClient,
    services: Services,
    node: Node,
    spin_until: Callable[..., None],
    tmp_path: Path,
) -> None:
    machine = toy_machine(node)
    start_tuner("initial_evaluations:=4")
    machine.held = True
    client.send(Tune.Goal(run_id="same", evaluations=5))
    spin_until(lambda: machine.goals, "an evaluation")
    refused: tuple[tuple[dict[str, Any], str], ...] = (
        (
            {"variables__x2__max": 1.0, "variables__x1__min": 3.0},
            "variables.x1.min is 3, which must be less than its max of 2",
        ),
        (
            {"variables__x1__max": 2.5},
            "variables.x1.max is 2.5, outside the machine's limits of -2 to 2",
        ),
        ({"objectives__f1__reference": "high"}, "objectives.f1.reference must be a number"),
        ({"objectives__f1__truncation": [5.0, 6.0]}, "outside its truncation box [5, 6]"),
        ({"variables__x1__cost": -1.0}, "variables.x1.cost is -1"),
        ({"evaluations": 0}, "evaluations is 0; 1 to 100000 is allowed"),
        ({"objectives__f1__unit": "mm"}, "declared"),
        ({"seed": 3}, "read-only"),
    )
    for values, sentence in refused:
        result = services.set(**values)
        assert not result.successful
        assert sentence in result.reason
    machine.held = False
    spin_until(lambda: len(client.feedback) >= 2, "two evaluations")
    machine.held = True
    count = len(machine.goals)
    spin_until(lambda: len(machine.goals) > count, "an evaluation that is held")
    result = services.set(evaluations=count)
    assert result.reason == (
        f"evaluations is {count}; more than the {count} that are finished are allowed, "
        "and 'stop' ends the run"
    )
    machine.held = False
    assert client.wait().evaluations == 5
    assert [r["type"] for r in journal(tmp_path, "same")] == ["start", *["evaluation"] * 5, "end"]


def test_constraints_change_and_without_a_run_it_is_for_those_to_come(
    start_tuner: Callable[..., NodeProcess],
    client: GoalClient,
    services: Services,
    node: Node,
    spin_until: Callable[..., None],
    tmp_path: Path,
) -> None:
    text = (CONFIG / "toy.yaml").read_text(encoding="utf-8")
    config = tmp_path / "constrained.yaml"
    config.write_text(
        text.replace(
            "    # constraints:\n    #   g: {max: 0.5}", "    constraints: {f1: {max: 3.0}}"
        )
    )
    machine = toy_machine(node)
    start_tuner("initial_evaluations:=8", config=config)
    result = services.set(constraints__f1__max=2.5, evaluations=9)
    assert result.successful, result.reason
    machine.held = True
    client.send(Tune.Goal(run_id="before"))
    spin_until(lambda: machine.goals, "an evaluation that is held")
    result = services.set(constraints__f1__min=1.0, constraints__f1__critical=True)
    assert result.successful, result.reason
    machine.held = False
    assert client.wait().evaluations == 9
    [change] = [r for r in journal(tmp_path, "before") if r["type"] == "change"]
    limit = {"min": 1.0, "max": 2.5, "unit": "", "critical": True}
    assert change["problem"]["constraints"]["f1"] == limit
    for record in evaluated(tmp_path, "before"):
        if record["type"] == "evaluation":
            f1 = record["diagnostics"]["f1"][0]
            low = 1.0 if record["index"] >= change["index"] else -1.0
            assert record["feasible"] == (low <= f1 <= 2.5)
    critical = [goal.critical for goal in machine.goals]
    assert not critical[0]
    [last] = critical[-1]
    assert (last.name, last.min, last.max, last.critical) == ("f1", 1.0, 2.5, True)


def test_a_reference_and_its_truncation_box_are_set_together_and_a_cost_without_effect_is_refused(
    start_tuner: Callable[..., NodeProcess], services: Services
) -> None:
    start_tuner()
    # Each alone would contradict what the other one is now.
    both = {"objectives__f1__reference": 9.0, "objectives__f1__truncation": [6.0, 9.0]}
    assert not services.set(objectives__f1__truncation=[6.0, 9.0]).successful
    result = services.set(**both)
    assert result.successful, result.reason
    refused = services.set(variables__x1__cost=5.0)
    assert not refused.successful
    assert "variables.x1.cost has no effect: proximal is null" in refused.reason
    assert "proximal: costs" in refused.reason

"""What the records of a run show of its machine, in sentences that say what to do."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pytest

from mobo_tuner.core import Problem
from mobo_tuner.runs.hints import FAILING, FEWEST, MOST, PERIOD, Hints, run_hints
from mobo_tuner.runs.history import CANCELED
from mobo_tuner.runs.records import EvaluationRecord
from tests.runs.test_records import EVALUATION

PROBLEM = Problem.from_dict(
    {
        "variables": {
            "x": {"min": 0.0, "max": 10.0, "unit": "A"},
            "y": {"min": -1.0, "max": 1.0},
        },
        "objectives": {"f": {"reference": 9.0}, "g": {"reference": 9.0}},
    }
)
RNG = np.random.default_rng(5)
POINTS = [{"x": float(x), "y": float(y)} for x, y in RNG.uniform((0, -1), (10, 1), (16, 2))]


def made(
    f: Sequence[float] | None = None, readbacks: Sequence[Mapping[str, float]] = POINTS
) -> list[EvaluationRecord]:
    values = RNG.uniform(0.0, 5.0, (16, 2)) if f is None else np.column_stack([f, RNG.random(16)])
    return [
        replace(
            EVALUATION,
            index=index,
            setpoint=POINTS[index],
            readbacks=readbacks[index],
            valid=True,
            error_code=0,
            diagnostics={"f": (values[index, 0], math.nan), "g": (values[index, 1], math.nan)},
        )
        for index in range(16)
    ]


def test_a_run_that_gets_somewhere_has_no_hints() -> None:
    assert run_hints(PROBLEM, made(), POINTS[:3], {}) == []


def test_failures_in_a_row_are_told_from_the_fifth_on() -> None:
    records = made()
    failed = [replace(r, error_code=5, error_msg="no picture") for r in records]
    skipped = replace(records[0], error_code=CANCELED, error_msg="skipped by an operator")
    [hint] = run_hints(PROBLEM, [*records, *failed[:FAILING], skipped], POINTS[:3], {})
    assert hint.startswith(
        f"the last {FAILING} evaluations failed, the last one because no picture"
    )
    assert run_hints(PROBLEM, [*records, *failed[1:FAILING]], POINTS[:3], {}) == []
    assert run_hints(PROBLEM, failed[:FAILING], [], {}) == [hint]  # before anything else is said


def test_set_points_that_are_quantised_are_named_with_their_step() -> None:
    steps = [point | {"x": round(point["x"] / 0.25) * 0.25} for point in POINTS]
    [hint] = run_hints(PROBLEM, made(readbacks=steps), POINTS[:3], {})
    assert "x reads in steps of 0.25 A" in hint
    assert "model_input" in hint
    assert run_hints(PROBLEM, made(readbacks=steps)[: FEWEST - 1], POINTS[:3], {}) == []


def test_a_coarse_readback_of_coarse_set_points_is_no_trouble() -> None:
    steps = [point | {"x": round(point["x"] / 0.25) * 0.25} for point in POINTS]
    records = [replace(r, setpoint=r.readbacks) for r in made(readbacks=steps)]
    assert run_hints(PROBLEM, records, POINTS[:3], {}) == []


@pytest.mark.parametrize(("count", "said"), [(13, True), (3, False)])
def test_a_clipped_diagnostic_is_named_with_its_value(count: int, said: bool) -> None:
    f = [30.0] * count + [float(n) for n in range(16 - count)]
    found = run_hints(PROBLEM, made(f), POINTS[:3], {})
    assert [f"{count} of the last 16 readings of f are exactly 30" in hint for hint in found] == [
        True
    ] * said


def test_a_front_at_a_bound_that_the_machine_could_cross_is_named() -> None:
    front = [{"x": 10.0, "y": 0.1}, {"x": 9.95, "y": -0.3}, {"x": 4.0, "y": 0.6}]
    [hint] = run_hints(PROBLEM, made(), front, {"x": (0.0, 12.0), "y": (-1.0, 1.0)})
    assert "2 of 3 points" in hint
    assert "variables.x.max" in hint
    assert run_hints(PROBLEM, made(), front, {"x": (0.0, 10.0), "y": (-1.0, 1.0)}) == []


def test_there_are_few_hints_and_the_optimiser_s_come_first() -> None:
    general = ["a", "b", "c", "d"]
    found = run_hints(PROBLEM, made([30.0] * 12 + [1.0] * 4), POINTS[:3], {}, general)
    assert found == general[:MOST]


def test_figures_change_only_now_and_then() -> None:
    shown = Hints()
    first = shown.update(["13 of 16 read 30"], 16)
    assert shown.update(["14 of 17 read 30"], 17) == first == ("13 of 16 read 30",)
    assert shown.update(["23 of 26 read 30"], 16 + PERIOD) == ("23 of 26 read 30",)
    assert shown.update(["x is at its bound"], 27) == ("x is at its bound",)
    assert shown.update(["24 of 28 read 30"], 28) == ("24 of 28 read 30",)


def test_a_context_that_falls_silent_is_named_with_what_the_models_take_for_it() -> None:
    problem = Problem.from_dict(PROBLEM.to_dict() | {"context": {"charge": {"unit": "nC"}}})
    readings = [1.0, 1.02, math.nan, math.nan, math.nan]
    records = [
        replace(record, diagnostics={**record.diagnostics, "charge": (reading, math.nan)})
        for record, reading in zip(made(), readings, strict=False)
    ]
    assert run_hints(problem, records[:4], [], {}) == []
    [hint] = run_hints(problem, records, [], {})
    assert "context charge was not measured in the last 3 evaluations" in hint
    assert "1.02 nC of evaluation 1" in hint
    [hint] = run_hints(problem, records[2:], [], {})
    assert "the models do without it" in hint

"""What the optimiser is given is checked where it comes in; what is taken can be worked with."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from mobo_tuner.core import Optimizer, Problem, ProblemError

AT = {"x": 0.5}
PROBLEM: dict[str, Any] = {
    "variables": {"x": {"min": 0.0, "max": 1.0}},
    "objectives": {"f": {"reference": 3.0}},
}


def optimizer(**settings: Any) -> Optimizer:
    """An optimiser that was told one evaluation."""
    made = Optimizer(Problem.from_dict(PROBLEM), initial_evaluations=1, **settings)
    made.tell(AT, {"f": 1.0})
    return made


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ((None, {}), "set-point"),
        (([0.5], {}), "set-point"),
        (({"x": "0.5"}, {}), "x"),
        (({"x": np.array([0.5])}, {}), "x"),
        (({"x": 1e155}, {}), "1e\\+155"),
        ((AT, None), "outputs"),
        ((AT, [1.0]), "outputs"),
        ((AT, {1: 1.0}), "output"),
        ((AT, {"f": "1.0"}), "'f'"),
        ((AT, {"f": b"1"}), "'f'"),
        ((AT, {"f": True}), "'f'"),
        ((AT, {"f": np.array(True)}), "'f'"),
        ((AT, {"f": np.complex128(1.0 + 1.0j)}), "'f'"),
        ((AT, {"f": 10**400}), "'f'"),
        ((AT, {"f": 10**5000}), "'f'"),
        ((AT, {"f": (1.0, "0.1")}), "'f'"),
        ((AT, {"f": (1.0, 0.1, 0.1)}), "'f'"),
        ((AT, {"f": 1.0}, None), "readbacks"),
        ((AT, {"f": 1.0}, {"x": None}), "readback x"),
        ((AT, {"f": 1.0}, {"x": "0.5"}), "readback x"),
        ((AT, {"f": 1.0}, {"y": 0.5}), "'y'"),
        ((AT, {"f": 1.0}, {}, "no"), "failed"),
        ((AT, {"f": 1.0}, {}, np.array([1.0, 2.0])), "failed"),
    ],
)
def test_what_cannot_be_told_is_refused_and_nothing_is_learned(
    arguments: tuple[Any, ...], named: str
) -> None:
    told = optimizer()
    with pytest.raises(ProblemError, match=named):
        told.tell(*arguments)
    assert len(told.dataset) == 1


@pytest.mark.parametrize("value", [0.0, -0.5])
def test_a_set_point_of_a_logarithmic_scale_must_be_positive(value: float) -> None:
    variables = {"x": {"min": 0.001, "max": 1.0, "scale": "log"}}
    told = Optimizer(Problem.from_dict(PROBLEM | {"variables": variables}))
    with pytest.raises(ProblemError, match="scale log it must be greater than 0"):
        told.tell({"x": value}, {"f": 1.0})


@pytest.mark.parametrize(
    "reading",
    [sys.float_info.max, -1e300, 3.4028234e38, 9.91e37, -9.9e37, math.inf, math.nan, None, -9999.0],
)
def test_a_sentinel_is_not_measured(reading: float | None) -> None:
    problem = PROBLEM | {"objectives": {"f": {"reference": 2.0, "invalid": [-9999]}}}
    told = Optimizer(Problem.from_dict(problem), initial_evaluations=4)
    for i in range(6):
        setpoint = told.ask()
        evaluation = told.tell(setpoint, {"f": reading if i == 1 else setpoint["x"]})
        assert evaluation.valid == (i != 1)
    assert told.hypervolume == pytest.approx(2.0 - min(p["x"] for p in _setpoints(told)))


def _setpoints(told: Optimizer) -> list[Any]:
    return [e.setpoint for e in told.dataset.evaluations if e.valid]


def test_a_sentinel_of_a_readback_is_not_where_the_machine_was() -> None:
    told = optimizer()
    assert told.tell(AT, {"f": 1.0}, {"x": sys.float_info.max}).readbacks == {}
    assert told.dataset.inputs[-1] == told.dataset.inputs[0]


@pytest.mark.parametrize("power", [-300, -150, -60, -12, 12, 34, 37])
def test_any_magnitude_that_is_taken_can_be_worked_with(power: int) -> None:
    unit = 10.0**power
    objectives = {f"f{j}": {"reference": 2.0 * unit} for j in range(7)}
    told = Optimizer(Problem.from_dict(PROBLEM | {"objectives": objectives}))
    for _ in range(6):
        x = told.ask()["x"]
        told.tell({"x": x}, {f"f{j}": unit * abs(x - j / 7.0) for j in range(7)})
    assert 0.0 <= told.ask()["x"] <= 1.0
    assert math.isfinite(told.hypervolume)
    assert 0.0 <= told.focus(told.pareto_front()[0]["index"]).ask()["x"] <= 1.0


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"variables": {"x": {"min": -1e308, "max": 1e308}}}, "variables.x.min is -1e\\+308"),
        ({"variables": {"x": {"min": 0.0, "max": 1e-320}}}, "variables.x.max"),
        ({"variables": {"x": {"min": 1.0, "max": math.nextafter(1.0, 2.0)}}}, "variables.x.max"),
        ({"objectives": {"f": {"reference": 1e160}}}, "objectives.f.reference is 1e\\+160"),
        (
            {"objectives": {f"f{j}": {"reference": 1e30} for j in range(20)}},
            "objectives.f0.reference is 1e\\+30",
        ),
        ({"objectives": {"f": {"reference": 10**400}}}, "objectives.f.reference"),
        ({"objectives": {"f": {"reference": 1.0, "invalid": 9999}}}, "objectives.f.invalid"),
        ({"constraints": {"g": {"max": 1e300}}}, "constraints.g.max"),
        ({"objectives": {"f": {"goal": 1e38}}}, "objectives.f.goal is 1e\\+38"),
    ],
)
def test_a_magnitude_that_cannot_be_worked_with_is_refused(
    changes: dict[str, Any], named: str
) -> None:
    with pytest.raises(ProblemError, match=named):
        Problem.from_dict(PROBLEM | changes)


def test_sentinels_are_part_of_the_problem_as_a_mapping() -> None:
    entry = {"invalid": [-1.0, 9999.0]}
    problem = Problem.from_dict(
        {
            "variables": {"x": {"min": 0.0, "max": 1.0}},
            "objectives": {"f": {"reference": 3.0} | entry},
            "constraints": {"g": {"max": 1.0} | entry},
            "observables": {"h": entry},
        }
    )
    assert Problem.from_dict(problem.to_dict()) == problem
    for name in "fgh":
        assert not problem.is_reading(name, float(np.float32(9999.0)))
        assert problem.is_reading(name, 9998.0)


@pytest.mark.parametrize(
    "call",
    [
        lambda o: o.predicted_front(size=0),
        lambda o: o.predicted_front(size=1.5),
        lambda o: o.focus(weights={"f": 1.0}, radius=1e-320),
        lambda o: o.focus(weights={"f": 1.0}, radius="wide"),
        lambda o: o.focus(weights={"f": math.inf}),
        lambda o: o.focus(weights={"f": None}),
        lambda o: o.focus(weights=1.0),
        lambda o: o.focus(index="0"),
        lambda o: o.focus(index=False),
        lambda o: o.focus(index=np.zeros(2)),
        lambda o: o.log_acquisition(np.zeros((2, 3))),
        lambda o: o.log_acquisition(np.zeros(1)),
        lambda o: o.log_acquisition(np.full((2, 1), math.nan)),
        lambda o: o.log_acquisition("0"),
        lambda o: o.log_acquisition([[0.0], [0.0, 0.0]]),
        lambda o: o.focus(weights={"f": 1.0}, bounds={"x": [0.0, 1.0]}),
        lambda o: o.save(1.5),
        lambda o: o.save(""),
        lambda o: o.save("a\0b"),
        lambda _: Optimizer.load("a\0b"),
        lambda _: Problem.from_yaml("a\0b"),
        lambda _: Problem.from_yaml(None),  # type: ignore[arg-type]
        lambda o: o.save("/dev/null/state.json"),
        lambda o: o.with_problem(PROBLEM),
        lambda o: o.forget(0, {"f": 1.0}),
        lambda o: o.unforget(0, {"f"}),
        lambda _: Optimizer.load(1.5),  # type: ignore[arg-type]
        lambda o: Optimizer.from_state(o.get_state() | {"version": np.ones(2)}),
        lambda o: Optimizer(o.problem, np.ones(2)),  # type: ignore[arg-type]
        lambda o: Optimizer(o.problem, maximizer=np.ones(2)),
        lambda o: Optimizer(o.problem, maximizer_settings={None: 1}),
        lambda o: Optimizer(o.problem, mean=1e308),
        lambda o: Optimizer(o.problem, noise=1e308),
        lambda o: Optimizer(o.problem, acquisition="ei", weights=(1e300,)),
        lambda _: Optimizer(PROBLEM),  # type: ignore[arg-type]
        lambda o: Optimizer(o.problem, prior_means=[1.0]),  # type: ignore[arg-type]
        lambda o: Optimizer(o.problem, prior_means={"f": 1.0}),  # type: ignore[dict-item]
        lambda o: Optimizer(o.problem, prior_means={"f": lambda _: math.nan}),  # type: ignore
        lambda o: Optimizer(o.problem, prior_means={"f": lambda x: x["x"] * math.nan}),
    ],
)
def test_a_bad_argument_is_refused(call: Callable[[Optimizer], Any]) -> None:
    with pytest.raises(ProblemError):
        call(optimizer())


def test_integers_of_numpy_are_integers() -> None:
    told = Optimizer(Problem.from_dict(PROBLEM), seed=np.int64(3))  # type: ignore[arg-type]
    assert told.ask() == Optimizer(told.problem, seed=3).ask()
    assert len(told.ask(np.int32(2))) == 2  # type: ignore[call-overload]
    told.tell(AT, {"f": 1.0})
    told.forget(np.intp(0))  # type: ignore[arg-type]
    assert told.get_state()["forgotten"] == [[0, None]]
    json.dumps(told.get_state())


@pytest.mark.parametrize("pair", [(1.0, None), [1.0, math.nan]])
def test_an_unknown_standard_deviation_may_be_none(pair: Any) -> None:
    evaluation = optimizer().tell(AT, {"f": pair, "g": (None, None)})  # type: ignore[dict-item]
    assert evaluation.values["f"] == 1.0
    assert math.isnan(evaluation.stddevs["f"])
    assert math.isnan(evaluation.value("g"))


def test_a_focus_of_the_least_radius_can_be_worked_with() -> None:
    narrow = optimizer().focus(weights={"f": 1.0}, radius=1e-4)
    for _ in range(3):
        setpoint = narrow.ask()
        narrow.tell(setpoint, {"f": setpoint["x"]})
        assert abs(setpoint["x"] - AT["x"]) <= 1e-4


def test_a_misspelt_output_is_warned_of_once() -> None:
    told = Optimizer(
        Problem.from_dict(PROBLEM | {"objectives": {"sigma_x": {"reference": 3.0}}}),
        initial_evaluations=2,
    )
    with pytest.warns(UserWarning, match="'SIGMA_X'.*'sigma_x'"):
        told.tell(AT, {"SIGMA_X": 1.0, "charge": 2.0})
    told.tell(AT, {"SIGMA_X": 1.0})
    told.tell(AT, {"sigma_x": 1.0, "sigma_y": 1.0})

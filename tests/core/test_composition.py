"""Derived quantities predicted by the models of their parts, against sampling, differences and the scalar formula."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from scipy.optimize import approx_fprime

from mobo_tuner.core import Optimizer, Problem
from mobo_tuner.core.composition import ComposedProcess, Composition
from mobo_tuner.core.derived import Derived
from mobo_tuner.core.gaussian_process import Prediction

FORMULAS = [
    "a + 2 * b - 3",
    "-a / b + a // b - a % b + (+a)",
    "sqrt(a * b)",
    "abs(a) ** 1.5 + 2 ** b",
    "hypot(a, b, 2) + atan2(a, b) * pi",
    "log(abs(a) + 1) + log(abs(a) + 1, 3) + log10(b ** 2 + 1) + exp(a)",
    "min(a, b, 0.3) * max(a, b)",
    "sin(a) + cos(b) + tan(a) + asin(a / 9) + acos(b / 9) + atan(a)",
    "sinh(a) + cosh(b) + tanh(a) + radians(a) + degrees(b)",
    "a * `BPM:X`",
]


def problem(formula: str = "", **derived: str) -> Problem:
    derived = derived or {"q": formula}
    return Problem.from_dict(
        {
            "variables": {"x": {"min": 0.0, "max": 4.0}, "y": {"min": -1.0, "max": 1.0}},
            "derived": {name: {"formula": text} for name, text in derived.items()},
            "objectives": {name: {"reference": 10.0} for name in derived},
        }
    )


@pytest.mark.parametrize("formula", FORMULAS)
def test_many_readings_at_once_are_those_one_by_one(formula: str) -> None:
    derived = Derived("q", formula)
    rng = np.random.default_rng(1)
    columns = {name: rng.uniform(-4.0, 4.0, (3, 20)) for name in ("a", "b", "BPM:X")}
    values = derived.over({name: columns[name] for name in derived.names})
    for at in np.ndindex(3, 20):
        result = derived.of({name: (float(c[at]), 0.0) for name, c in columns.items()})
        assert values[at] == pytest.approx(result.value, rel=1e-12, nan_ok=True)
    assert np.isfinite(values).any()


@pytest.mark.parametrize("formula", ["a if b > 0 else 1", "a < b", "a and b", "not a"])
def test_formulas_that_may_jump_are_not_composed(formula: str) -> None:
    with pytest.raises(ValueError, match="choice"):
        Derived("q", formula).over({"a": np.ones(2), "b": np.ones(2)})
    jumping = problem(q=formula + " + 0 * a + 0 * b")
    optimizer = told(jumping, lambda x: {"a": x["x"], "b": x["y"]}, 6)
    assert not any(isinstance(m, ComposedProcess) for m in optimizer.models.objectives)


@pytest.mark.parametrize(
    ("formula", "rel"),
    [
        ("3 * a - b / 2 + x", 0.01),
        ("a * b + c", 0.02),
        ("a ** 2 + b", 0.02),
        ("hypot(a, b)", 0.05),
        ("sqrt(a * b * c * d)", 0.05),
    ],
)
def test_mean_and_deviation_are_those_of_samples(formula: str, rel: float) -> None:
    composition = Composition(Derived("q", formula), problem(q=formula), 1.0)
    means = np.array([[2.0, 1.5, 3.0, 2.5], [4.0, 3.0, 1.0, 0.8]])[:, : len(composition.parts)]
    stddevs = 0.1 * means
    x = np.array([[0.5, 0.0], [-0.5, 0.3]])
    mean, stddev = composition.moments(x, means, stddevs)
    draws = np.random.default_rng(2).standard_normal((100_000, *means.shape))
    sampled = composition.values(x, means + stddevs * draws)
    assert mean == pytest.approx(sampled.mean(axis=0), rel=0.003)
    assert stddev == pytest.approx(sampled.std(axis=0), rel=rel)


def test_the_tip_of_a_cone_is_not_taken_for_certain() -> None:
    composition = Composition(Derived("q", "hypot(a, b)"), problem("hypot(a, b)"), 1.0)
    mean, stddev = composition.moments(np.zeros((1, 2)), np.zeros((1, 2)), np.full((1, 2), 0.2))
    rayleigh = 0.2 * np.array([math.sqrt(math.pi / 2.0), math.sqrt(2.0 - math.pi / 2.0)])
    assert [*mean, *stddev] == pytest.approx(rayleigh, rel=0.3)


@pytest.mark.parametrize(
    "formula", ["a * b * x", "sqrt(a * b + 1) / (2 + x)", "hypot(a, b) - y * x"]
)
def test_gradients_are_those_of_differences(formula: str) -> None:
    composition = Composition(Derived("q", formula), problem(formula), -1.0)

    def part(x: np.ndarray, k: int) -> Prediction:
        mean = 2.0 + k + np.sin((k + 1) * x[:, 0]) * x[:, 1]
        slope = np.column_stack(
            [(k + 1) * np.cos((k + 1) * x[:, 0]) * x[:, 1], np.sin((k + 1) * x[:, 0])]
        )
        stddev = 0.2 + 0.1 * x[:, 0] ** 2 + 0.05 * k * x[:, 1]
        by_stddev = np.column_stack([0.2 * x[:, 0], np.full(len(x), 0.05 * k)])
        return Prediction(mean, stddev, slope, by_stddev)

    def at(x: np.ndarray) -> Prediction:
        parts = [part(x, k) for k, _ in enumerate(composition.parts)]
        return composition.gradients(x, parts, np.full(len(parts), 1e-4))

    for point in np.random.default_rng(3).uniform(-0.9, 0.9, (5, 2)):
        predicted = at(point[None])
        for value, gradient in ((0, 2), (1, 3)):
            numerical = approx_fprime(point, lambda x, k=value: at(x[None])[k][0], 1e-6)
            assert predicted[gradient][0] == pytest.approx(numerical, rel=1e-3, abs=1e-4)


def orbit(at: Mapping[str, float]) -> dict[str, float]:
    return {"a": at["x"] - 1.3 + 0.2 * at["y"] ** 2, "b": math.sin(at["y"] + 0.3 * at["x"]) - 0.2}


def told(of: Problem, measure: Any, evaluations: int = 12, **choices: Any) -> Optimizer:
    optimizer = Optimizer(of, seed=4, **choices)
    for _ in range(evaluations):
        at = optimizer.ask()
        optimizer.tell(at, measure(at))
    return optimizer


def test_an_orbit_is_found_sooner_by_its_parts() -> None:
    optimizer = told(problem(q="hypot(a, b)"), orbit)
    assert all(isinstance(m, ComposedProcess) for m in optimizer.models.objectives)
    assert min(e.values["q"] for e in optimizer.dataset.evaluations) < 1e-3
    assert list(optimizer.models.by_output) == ["q"]


def test_rough_parts_of_a_smooth_quantity_are_left_alone() -> None:
    def measure(at: Mapping[str, float]) -> dict[str, float]:
        rough = 5.0 * math.sin(9.0 * at["x"] + 20.0 * at["y"])
        return {"a": (at["x"] - 1.0) ** 2 + at["y"] + rough, "b": rough}

    optimizer = told(problem(q="a - b"), measure)
    assert not any(isinstance(m, ComposedProcess) for m in optimizer.models.objectives)


def test_where_the_formula_is_undefined_the_quantity_itself_predicts() -> None:
    def measure(at: Mapping[str, float]) -> dict[str, float]:
        return {"a": at["x"] - 0.5 * at["y"]}

    optimizer = told(problem(q="sqrt(a)"), measure)  # undefined in a corner
    (model,) = optimizer.models.objectives
    assert isinstance(model, ComposedProcess)
    corner = np.array([[-1.0, 1.0], [0.5, 0.0]])
    for values in (*model.predict(corner), *model.predict_with_gradient(corner)):
        assert np.isfinite(values).all()
    assert np.isfinite(model.sample(corner, np.random.default_rng(5).standard_normal((9, 2)))).all()
    assert model.predict(corner[1:])[0] == pytest.approx(math.sqrt(3.0), rel=0.03)


def test_it_is_saved_restored_and_learned_again() -> None:
    both = problem(q="hypot(a, b)", r="-a + abs(b)")
    optimizer = told(both, orbit, noise="learned")
    restored = Optimizer.from_state(optimizer.get_state())
    assert optimizer.ask() == restored.ask()
    # One of the parts is withdrawn: the rest is known, and what is derived from it is not.
    for each in (optimizer, restored):
        each.forget(3, "a")
        each.tell({"x": 1.0, "y": 0.5}, {"b": 0.3})
    assert optimizer.ask() == restored.ask()
    optimizer.unforget(3, "a")
    assert len(optimizer.ask(3)) == 3

"""Prior means: their gradients against finite differences, and which of them a process chooses."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import approx_fprime

from mobo_tuner.core import Optimizer, Problem, ProblemError
from mobo_tuner.core.gaussian_process import GaussianProcess, GaussianProcessSettings
from mobo_tuner.core.prior_mean import PriorMeans, SmoothPriorModel
from mobo_tuner.core.problem import Array

PROBLEM = Problem.from_dict(
    {
        "variables": {
            "a": {"min": -1.0, "max": 3.0},
            "b": {"min": 1.0, "max": 100.0, "scale": "log"},
            "c": {"min": 0.0, "max": 4.0, "step": 0.5},
        },
        "objectives": {"f": {"reference": 9.0}, "g": {"direction": "maximize", "reference": -9.0}},
        "constraints": {"h": {"max": 5.0}},
    }
)


class Formula:
    """Three quantities of three variables, in one call; counts its calls."""

    outputs = ("g", "f", "h")

    def __init__(self) -> None:
        self.calls = 0

    def predict(self, columns: Mapping[str, Array]) -> Array:
        self.calls += 1
        a, b, c = (columns[name] for name in "abc")
        return np.column_stack([np.sin(a) * np.log(b), a * a + c, a * c + 0.01 * b])


class SmoothFormula(Formula):
    """The same, which knows its derivatives."""

    def predict_with_gradient(
        self, columns: Mapping[str, Array]
    ) -> tuple[Array, Mapping[str, Array]]:
        a, b, c = (columns[name] for name in "abc")
        zero, one = np.zeros_like(a), np.ones_like(a)
        return self.predict(columns), {
            "a": np.column_stack([np.cos(a) * np.log(b), 2.0 * a, c]),
            "b": np.column_stack([np.sin(a) / b, zero, 0.01 * one]),
            "c": np.column_stack([zero, one, a]),
        }


@pytest.mark.parametrize("model", [Formula(), SmoothFormula()])
@pytest.mark.parametrize("timed", [False, True])
def test_gradients_are_those_of_finite_differences(model: Formula, timed: bool) -> None:
    assert isinstance(model, SmoothPriorModel) == (type(model) is SmoothFormula)
    means = PriorMeans(PROBLEM, model)
    x = np.random.default_rng(1).uniform(-0.95, 0.95, (5, 3 + timed))
    for name in ("f", "g", "h"):
        mean, gradient = means.mean(name), means.gradient(name)
        assert mean is not None
        assert gradient is not None
        expected = [
            approx_fprime(point, lambda p, mean=mean: float(mean(p[None])[0]), 1e-6) for point in x
        ]
        np.testing.assert_allclose(gradient(x), expected, atol=1e-4)
    at = dict(zip("abc", ([1.0], [10.0], [2.0]), strict=True))
    g = means.mean("g")
    assert g is not None  # maximised: what is minimised is its negative
    expected_g = -model.predict({n: np.array(v) for n, v in at.items()})[0, 0]
    assert g(PROBLEM.normalize({"a": 1.0, "b": 10.0, "c": 2.0})[None])[0] == pytest.approx(
        expected_g
    )


def test_a_model_is_asked_within_the_bounds_and_once_for_all_quantities() -> None:
    model = Formula()
    means = PriorMeans(PROBLEM, model)
    f, slope = means.mean("f"), means.gradient("f")
    assert f is not None
    assert slope is not None
    x = np.array([[1.5, 0.0, -3.0], [1.0, 1.0, -1.0]])
    np.testing.assert_allclose(f(x), 9.0)
    # At the bounds only the side within counts, and beyond them nothing changes.
    np.testing.assert_allclose(slope(x), [[12.0, 0.0, 2.0]] * 2, rtol=1e-4, atol=1e-9)
    calls = model.calls
    for name in ("f", "g", "h"):
        mean, gradient = means.mean(name), means.gradient(name)
        assert mean is not None
        assert gradient is not None
        gradient(x), mean(x)
    assert model.calls == calls


@pytest.mark.parametrize(
    ("predicted", "words"),
    [
        (np.zeros((2, 2)), "2 by 3 numbers"),
        ("no", "2 by 3 numbers"),
        (np.array([[0.0, np.nan, 0.0]] * 2), "'f' is not a finite number"),
    ],
)
def test_what_is_no_prediction_is_refused(predicted: object, words: str) -> None:
    model = Formula()
    model.predict = lambda _: predicted  # type: ignore[assignment,method-assign,return-value]
    with pytest.raises(ProblemError, match=words):
        PriorMeans(PROBLEM, model)


def truth(x: Array) -> Array:
    """An output over three normalised variables."""
    return np.asarray(40.0 + 9.0 * np.sin(2.0 * x[:, 0]) * x[:, 1] + 5.0 * x[:, 2] ** 2)


@pytest.mark.parametrize(
    ("offset", "factor", "name"),
    [(0.0, 1.0, "function"), (30.0, 1.0, "function"), (-7.0, 0.25, "scaled function")],
)
def test_offset_and_scale_of_a_good_prior_are_learned(
    offset: float, factor: float, name: str
) -> None:
    def mean(x: Array) -> Array:
        return (truth(x) - offset) / factor + 0.05 * np.cos(5.0 * x[:, 0]) / factor

    x = np.random.default_rng(2).uniform(-1.0, 1.0, (10, 3))
    new = np.random.default_rng(3).uniform(-1.0, 1.0, (200, 3))
    model = GaussianProcess(mean=mean).fit(x, truth(x))
    assert model.model == name
    logarithmic = GaussianProcess(GaussianProcessSettings(transform="log"), mean=mean)
    assert logarithmic.fit(x, truth(x)).model == name
    plain = GaussianProcess().fit(x, truth(x))
    error, without = (np.abs(m.predict(new)[0] - truth(new)).max() for m in (model, plain))
    assert error < 0.2
    assert error < 0.1 * without
    restored = GaussianProcess.from_state(model.get_state(), x, truth(x), mean=mean)
    np.testing.assert_array_equal(restored.predict(new), model.predict(new))


def test_a_wrong_prior_is_not_used() -> None:
    def mean(x: Array) -> Array:
        return 300.0 * np.cos(7.0 * x[:, 1]) + 100.0 * x[:, 0]

    x = np.random.default_rng(2).uniform(-1.0, 1.0, (20, 3))
    model, plain = (GaussianProcess(mean=m).fit(x, truth(x)) for m in (mean, None))
    assert model.model == plain.model == "data"
    new = np.random.default_rng(3).uniform(-1.0, 1.0, (50, 3))
    np.testing.assert_array_equal(model.predict(new), plain.predict(new))
    restored = GaussianProcess.from_state(model.get_state(), x, truth(x), mean=mean)
    np.testing.assert_array_equal(restored.predict(new), model.predict(new))


def test_with_a_prior_model_fewer_points_are_initial_and_a_saved_state_continues(
    tmp_path: Path,
) -> None:
    model = SmoothFormula()
    optimizer = Optimizer(PROBLEM, seed=2, prior_means=model)
    assert optimizer.initial_evaluations == 2 < Optimizer(PROBLEM).initial_evaluations
    for _ in range(5):
        setpoint = optimizer.ask()
        measured = model.predict({n: np.array([v]) for n, v in setpoint.items()})[0]
        g, f, h = (float(v) for v in 1.1 * measured)
        optimizer.tell(setpoint, {"f": f, "g": g, "h": h})
    optimizer.save(tmp_path / "state.json")
    assert Optimizer.load(tmp_path / "state.json", SmoothFormula()).ask() == optimizer.ask()
    narrower = PROBLEM.to_dict()
    del narrower["constraints"]
    assert optimizer.with_problem(Problem.from_dict(narrower)).ask()


class Broken(Formula):
    """A model that fails at one of its calls, or answers with what is no prediction."""

    def __init__(self, failing: int = 1, gradient: Any = None) -> None:
        super().__init__()
        self.failing, self.gradient = failing, gradient

    def predict(self, columns: Mapping[str, Array]) -> Array:
        if self.calls + 1 == self.failing:
            self.calls += 1
            raise KeyError("server")
        return super().predict(columns)


class BrokenGradient(Broken):
    """A model whose gradient is wrong."""

    def predict_with_gradient(self, columns: Mapping[str, Array]) -> Any:
        return self.gradient if columns else None


@pytest.mark.parametrize("gradient", [None, 1.0, (1.0,), ([[1.0, 1.0, 1.0]], None)])
def test_a_model_that_fails_is_named(gradient: Any) -> None:
    with pytest.raises(ProblemError, match="KeyError: 'server'"):
        PriorMeans(PROBLEM, Broken())
    means = PriorMeans(PROBLEM, BrokenGradient(0, gradient))
    with pytest.raises(ProblemError, match="predict_with_gradient"):
        means.gradients(np.zeros((1, 3)))


@pytest.mark.parametrize("outputs", [None, 3, ("f", "f")])
def test_the_outputs_of_a_model_are_names(outputs: Any) -> None:
    model = Formula()
    model.outputs = outputs
    with pytest.raises(ProblemError, match="outputs"):
        PriorMeans(PROBLEM, model)


def test_functions_do_not_disturb_each_other() -> None:
    def emptied(columns: Any) -> Array:
        columns["a"] *= 0.0
        return np.asarray(columns.pop("a"))

    means = PriorMeans(PROBLEM, {"f": emptied, "h": lambda columns: columns["a"]})
    np.testing.assert_array_equal(means.values(np.ones((2, 3)))[:, 1], 3.0)
    with pytest.raises(ProblemError, match="'f'"):
        PriorMeans(PROBLEM, {"f": lambda columns: 1j * columns["a"]})  # type: ignore


@pytest.mark.parametrize("failing", [2, 6, 20])
def test_a_run_goes_on_as_before_where_a_model_failed_once(failing: int) -> None:
    inferred = PROBLEM.to_dict()
    inferred["objectives"] = {"f": {}, "g": {"direction": "maximize"}}
    asked: list[list[dict[str, float]]] = []
    for model in (Formula(), Broken(failing)):
        tuned = Optimizer(Problem.from_dict(inferred), initial_evaluations=3, prior_means=model)
        asked.append([])
        while len(tuned.dataset) < 5:
            try:
                setpoint = tuned.ask()
            except ProblemError:
                assert model.calls == failing
                continue
            a, b, c = (setpoint[name] for name in "abc")
            tuned.tell(setpoint, {"f": a * a + c, "g": np.sin(a) * np.log(b), "h": a * c})
            asked[-1].append(setpoint)
    assert asked[0] == asked[1]
    assert model.calls >= failing

"""Unordered variables in the models: every choice is as far from every other one."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from mobo_tuner.core import Optimizer, Problem
from mobo_tuner.core.exploration import explore
from mobo_tuner.core.gaussian_process import GaussianProcess
from mobo_tuner.core.initial_design import initial_design
from mobo_tuner.core.one_hot import OneHot
from mobo_tuner.core.proximal import ProximalBiasing
from mobo_tuner.core.resolution import Taken
from mobo_tuner.core.validity import ValidityModel

PLACES = np.array([-1.0, -0.5, 1.0])
ONE_HOT = OneHot([None, PLACES])


def test_columns_are_one_for_the_choice_and_time_stays_last() -> None:
    x = np.array([[0.3, -0.5, 7.0], [0.4, 0.9, 8.0]])
    assert ONE_HOT.width == 4
    assert ONE_HOT.expand(x).tolist() == [[0.3, 0, 1, 0, 7.0], [0.4, 0, 0, 1, 8.0]]
    assert ONE_HOT.pull_back(np.array([[1.0, 2, 3, 4, 5]])).tolist() == [[1.0, 0.0, 5.0]]
    assert (
        ONE_HOT.fold(np.diag([1.0, 2.0, 4.0, 3.0, 5.0])).tolist() == np.diag([1.0, 4, 5]).tolist()
    )


def test_the_order_of_the_choices_does_not_matter() -> None:
    rng = np.random.default_rng(1)
    x = np.column_stack([rng.uniform(-1, 1, 20), rng.choice(PLACES, 20)])
    y = np.sin(2.0 * x[:, 0]) + np.where(x[:, 1] == -0.5, 2.0, 0.0)
    renamed = dict(zip(PLACES, PLACES[[2, 0, 1]], strict=True))
    other = np.column_stack([x[:, 0], [renamed[place] for place in x[:, 1]]])
    here = np.array([[0.2, p] for p in PLACES])
    there = np.array([[0.2, renamed[p]] for p in PLACES])
    models = [GaussianProcess(one_hot=ONE_HOT).fit(inputs, y) for inputs in (x, other)]
    predicted = [m.predict(p)[0] for m, p in zip(models, (here, there), strict=True)]
    assert predicted[0] == pytest.approx(predicted[1], abs=0.02)
    assert predicted[0] == pytest.approx(np.sin(0.4) + np.array([0.0, 2.0, 0.0]), abs=0.1)
    model = models[0]
    gradient = model.predict_with_gradient(here).mean_gradient
    step = np.array([[1e-5, 0.0]])
    slope = (model.predict(here + step)[0] - model.predict(here - step)[0]) / 2e-5
    assert gradient[:, 0] == pytest.approx(slope, rel=1e-4)
    assert not gradient[:, 1].any()


def test_failures_of_one_choice_say_nothing_of_another() -> None:
    rng = np.random.default_rng(2)
    x = np.column_stack([rng.uniform(-1, 1, 24), np.repeat(PLACES, 8)])
    model = ValidityModel(ONE_HOT).fit(x, x[:, 1] != -0.5)
    believed = np.exp(model.predict_log_probability([[0.0, p] for p in PLACES]))
    assert believed[1] < 0.2
    assert believed[[0, 2]] == pytest.approx([0.95, 0.95], abs=0.08)


def test_any_change_of_a_choice_costs_the_same() -> None:
    factor = ProximalBiasing([0.0, -1.0], [1.0, 1.0], [False, True])
    x = np.array([[0.0, p] for p in PLACES])
    assert factor.log_value(x).tolist() == [0.0, -0.5, -0.5]


def filters(values: list[float]) -> Problem:
    """A problem with an unordered variable, whatever the machine takes for its choices."""
    return Problem.from_dict(
        {
            "variables": {
                "x": {"min": 0.0, "max": 1.0},
                "filter": {"choices": ["foil", "mesh", "none", "slit"], "values": values},
            },
            "objectives": {"f": {"reference": 4.0}},
        }
    )


def test_the_numbers_that_stand_for_choices_matter_nowhere() -> None:
    few, far = filters([0, 1, 2, 3]), filters([0, 1, 2, 1000])
    assert few.domain.values[1] is not None
    assert few.domain.values[1].tolist() == [-0.75, -0.25, 0.25, 0.75]
    for name in few.variables[1].choice_names:
        places = [
            problem.normalize(
                {"x": 0.3, "filter": dict(zip(v.choice_names, v.choices, strict=True))[name]}
            )
            for problem in (few, far)
            for v in problem.variables[1:]
        ]
        assert places[0].tolist() == places[1].tolist()
        back = far.denormalize(places[1])["filter"]
        assert far.variables[1].shown(back) == name == far.shown("filter", back + 0.1)
        assert far.columns(places[1][None])["filter"].tolist() == [back]
    chosen = [design(far, seed) for seed in range(3)]
    assert chosen == [design(few, seed) for seed in range(3)]
    assert sorted(chosen[0]) == sorted(2 * few.variables[1].choice_names)


def design(problem: Problem, seed: int) -> list[str]:
    """The choices of an initial design, from the same random numbers."""
    points = initial_design("latin_hypercube", 8, problem.domain, seed)
    setpoints = [problem.denormalize(point) for point in points]
    return [problem.variables[1].shown(setpoint["filter"]) for setpoint in setpoints]


def test_every_other_choice_is_half_a_range_away() -> None:
    domain = filters([0, 1, 2, 1000]).domain
    x = np.array([[-0.4, -0.75], [0.2, -0.75], [-0.4, -0.25], [0.4, 0.75]])
    euclidean = [0.0, 0.6, 1.0, np.hypot(0.8, 1.0)]
    assert domain.distances(x[:1], x)[0] == pytest.approx(euclidean)
    assert domain.distances(x[:1], x, "chebyshev")[0] == pytest.approx([0.0, 0.6, 1.0, 1.0])
    # Space is filled over all choices before any place between two of one choice.
    rng = np.random.default_rng(0)
    inputs = np.array([[0.0, place] for place in (-0.75, -0.25, 0.75)])
    nothing = Taken(np.empty((0, 2)), np.empty((0, 2)))
    assert explore(inputs, nothing, rng, domain=domain)[1] == 0.25


def test_a_guarded_search_changes_a_choice_once_half_the_range_is_trusted() -> None:
    problem = filters([0, 1, 2, 1000])
    for trust, changes in ((0.3, False), (0.5, True)):
        optimizer = Optimizer(problem, seed=1, trust_distance=trust, initial_evaluations=4)
        optimizer.tell({"x": 0.5, "filter": 1.0}, {"f": 1.0})
        choices = set()
        for _ in range(3):
            setpoint = optimizer.ask()
            choices.add(setpoint["filter"])
            optimizer.tell(setpoint, {"f": math.nan if changes else 1.0 + setpoint["x"]})
        assert (choices != {1.0}) == changes


def test_suggestions_are_among_the_choices_and_a_state_goes_on() -> None:
    problem = Problem.from_dict(
        {
            "variables": {
                "x": {"min": 0.0, "max": 1.0},
                "target": {"choices": ["foil", "mesh", "none"], "values": [10, 30, 20]},
            },
            "objectives": {"f": {"reference": 4.0}, "g": {"reference": 4.0}},
        }
    )
    losses = {10.0: 0.3, 20.0: 1.5, 30.0: 0.0}  # between which there is no order
    optimizer = Optimizer(problem, seed=3)
    for _ in range(14):
        setpoint = optimizer.ask()
        assert setpoint["target"] in losses
        loss = losses[setpoint["target"]]
        optimizer.tell(
            setpoint,
            {"f": (setpoint["x"] - 0.2) ** 2 + loss, "g": (setpoint["x"] - 0.8) ** 2 + loss},
        )
    front = optimizer.pareto_front()
    assert {point["setpoint"]["target"] for point in front} == {30.0}
    restored = Optimizer.from_state(json.loads(json.dumps(optimizer.get_state())))
    assert restored.ask() == optimizer.ask()
    focused = optimizer.focus(front[0]["index"])
    assert focused.problem.variables[1].fixed == 30.0
    assert optimizer.predicted_front(5)[0]["setpoint"]["target"] in losses

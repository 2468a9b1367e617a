"""The choice of a fidelity: information and gain per cost, and what keeps a bad one cheap."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from mobo_tuner.core import Optimizer, Problem
from mobo_tuner.core.fidelity_choice import choose_fidelity, times_served
from tests.core.test_fidelity import DEFINITION, SIMPLE, run, simulate


def made(section: dict[str, Any] = SIMPLE["fidelity"]) -> Optimizer:
    optimizer = Optimizer(Problem.from_dict({**DEFINITION, "fidelity": section}), seed=1)
    for setpoint in (
        *({"x": x, "y": y, "s": 0.0} for x in (0.1, 0.5, 0.9) for y in (0.2, 0.8)),
        *({"x": x, "y": 0.4, "s": 1.0} for x in (0.2, 0.5, 0.7)),
    ):
        optimizer.tell(setpoint, simulate(setpoint))
    optimizer.ask()
    return optimizer


def chosen(optimizer: Optimizer, x: float, y: float) -> float:
    fidelity = optimizer.problem.fidelity
    assert fidelity is not None
    place = optimizer.problem.normalize({"x": x, "y": y})
    return choose_fidelity(optimizer.archive, fidelity, place, 0)["s"]


def test_what_is_cheap_is_chosen_where_it_teaches_and_once_at_a_place() -> None:
    optimizer = Optimizer(Problem.from_dict(SIMPLE), seed=2)
    run(optimizer, optimizer.initial_evaluations)
    setpoint = optimizer.ask()
    assert setpoint["s"] == 1.0  # nothing was measured there yet
    while setpoint["s"] == 1.0:
        optimizer.tell(setpoint, simulate(setpoint))
        assert len(optimizer.dataset) < 30
        setpoint = optimizer.ask()
    assert chosen(optimizer, setpoint["x"], setpoint["y"]) == 0.0
    optimizer.tell(setpoint, simulate(setpoint))
    optimizer.ask()
    assert chosen(optimizer, setpoint["x"], setpoint["y"]) == 1.0


def test_what_costs_as_much_as_the_highest_is_not_chosen() -> None:
    assert chosen(made({"s": {"choices": [0.0, 1.0]}, "cost": "1 + 0.01 * s"}), 0.35, 0.55) == 1.0


def test_no_more_is_spent_on_cheap_evaluations_than_on_one_at_the_highest() -> None:
    optimizer = Optimizer(Problem.from_dict(SIMPLE), seed=4)
    spent = 0.0
    for _ in range(30):
        setpoint = optimizer.ask()
        optimizer.tell(setpoint, {})  # whatever it is, it fails
        spent = 0.0 if setpoint["s"] == 1.0 else spent + 0.1
        assert spent <= 1.0 + 1e-9
    assert any(e.setpoint["s"] == 1.0 for e in optimizer.dataset.evaluations)


def test_failures_of_all_at_the_highest_fidelity_are_told() -> None:
    optimizer = Optimizer(Problem.from_dict(SIMPLE), seed=2)
    for x in (0.1, 0.6, 0.9):
        cheap = {"x": x, "y": 0.4, "s": 0.0}
        optimizer.tell(cheap, simulate(cheap))
    assert optimizer.hints() == []
    for x in (0.2, 0.7):
        optimizer.tell({"x": x, "y": 0.4, "s": 1.0}, {}, failed=True)
    [hint] = optimizer.hints()
    assert hint.startswith("all 2 evaluations of the highest fidelity failed")


def test_correlations_are_those_of_the_joint_prediction() -> None:
    model = made().models.objectives[0]
    here = np.array([0.1, 0.2])
    cheap = np.array([[0.1, 0.2, 0.5], [0.8, -0.5, 0.5]])
    normals = np.random.default_rng(0).standard_normal((200_000, 3))
    drawn = model.sample(np.vstack([np.append(here, 0.0), cheap]), normals)
    expected = np.atleast_2d(np.corrcoef(drawn.T))[0, 1:]
    assert model.correlations(here, cheap) == pytest.approx(expected, abs=0.02)


def test_a_fidelity_that_is_unrelated_is_not_learned_from() -> None:
    optimizer = Optimizer(Problem.from_dict(SIMPLE), seed=1)
    rng = np.random.default_rng(0)
    for i in range(36):
        setpoint = {"x": rng.random(), "y": rng.random(), "s": float(i % 2)}
        waves = {n: math.sin(40.0 * setpoint["x"] + k) for k, n in enumerate("fg")}
        optimizer.tell(setpoint, simulate(setpoint) if i % 2 else waves)
    optimizer.ask()
    assert [model.n for model in optimizer.archive.models.objectives] == [18, 18]
    assert chosen(optimizer, 0.3, 0.3) == 1.0
    state = optimizer.get_state()
    restored = Optimizer.from_state(state)
    assert restored.ask() == optimizer.ask()


def test_where_what_is_cheap_says_little_a_design_is_made_at_the_highest_fidelity() -> None:
    optimizer = Optimizer(Problem.from_dict(SIMPLE), seed=1)
    rng = np.random.default_rng(0)
    for i in range(20):
        setpoint = {"x": rng.random(), "y": rng.random(), "s": float(i % 4 == 0)}
        waves = {n: math.sin(40.0 * setpoint["x"] + k) for k, n in enumerate("fg")}
        optimizer.tell(setpoint, waves if i % 4 else simulate(setpoint))
    design = Optimizer(Problem.from_dict(SIMPLE), seed=1)
    run(design, 5)
    assert optimizer.ask() == {**design.ask(), "s": 1.0}


def test_a_biased_fidelity_is_learned_from() -> None:
    optimizer = Optimizer(Problem.from_dict(SIMPLE), seed=1)
    rng = np.random.default_rng(0)
    for i in range(24):
        setpoint = {"x": rng.random(), "y": rng.random(), "s": float(i % 4 == 0)}
        optimizer.tell(setpoint, simulate(setpoint))
    optimizer.ask()
    assert [model.n for model in optimizer.archive.models.objectives] == [24, 24]


def test_knowledge_serves_more_evaluations_where_many_variables_agree() -> None:
    times = {}
    for count, relation in ((6, "alike"), (6, "unrelated"), (2, "alike")):
        definition = {
            **SIMPLE,
            "variables": {f"x{i}": {"min": 0.0, "max": 1.0} for i in range(count)},
        }
        optimizer = Optimizer(Problem.from_dict(definition), seed=1)
        rng = np.random.default_rng(0)
        for i in range(30):
            place, s = rng.random(count), float(i % 3 == 0)
            plain = {"f": float(place.sum()), "g": float(np.square(place - 0.3).sum())}
            waves = {name: math.sin(40.0 * place[0] + k) for k, name in enumerate("fg")}
            setpoint = {f"x{i}": float(x) for i, x in enumerate(place)} | {"s": s}
            optimizer.tell(setpoint, waves if s == 0.0 and relation == "unrelated" else plain)
        optimizer.ask()
        times[count, relation] = times_served(optimizer.archive, np.array([[1.0]]))
    assert times == {(6, "alike"): 3.0, (6, "unrelated"): 1.0, (2, "alike"): 1.0}

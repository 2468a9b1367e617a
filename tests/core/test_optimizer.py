"""Ask and tell: what is asked and what is learned."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import moocore
import numpy as np
import pytest
from scipy.stats import qmc

from mobo_tuner.core import Optimizer, Problem, ProblemError
from mobo_tuner.core.focus import largest_box
from tests.core.toy_runs import REFERENCE, TOY, toy, tune, with_changes


def toy_share(optimizer: Optimizer) -> float:
    """Hypervolume as a share of that of the true front, the line from (0, 2.83) to (2.83, 0)."""
    t = np.linspace(0.0, 2.0 * math.sqrt(2.0), 20_001)
    true = moocore.hypervolume(np.column_stack([t, t[::-1]]), ref=[REFERENCE] * 2)
    return float(optimizer.hypervolume / true)


@pytest.mark.parametrize("acquisition", ["ehvi", "ucb_hvi"])
def test_the_toy_problem_is_solved_in_twenty_evaluations(acquisition: str) -> None:
    optimizer = Optimizer(
        Problem.from_dict(TOY), seed=1, initial_evaluations=5, acquisition=acquisition
    )
    tune(optimizer, 20)
    assert toy_share(optimizer) > 0.92
    front = np.array([list(p["objectives"].values()) for p in optimizer.pareto_front()])
    assert optimizer.hypervolume == pytest.approx(
        moocore.hypervolume(front, ref=[REFERENCE] * 2), rel=1e-12
    )


def test_the_paper_preset_runs_its_own_recipe() -> None:
    optimizer = Optimizer(Problem.from_dict(TOY), preset="paper", initial_evaluations=6)
    assert optimizer.settings.acquisition == "ucb_hvi"
    assert optimizer.settings.beta == 0.01
    assert optimizer.settings.training == "adam"
    assert Optimizer(Problem.from_dict(TOY), preset="paper").initial_evaluations == 20
    asked = tune(optimizer, 9)
    assert all(-2.0 <= value <= 2.0 for x in asked for value in x.values())


def test_the_first_setpoints_are_a_latin_hypercube() -> None:
    optimizer = Optimizer(Problem.from_dict(TOY), seed=5, initial_evaluations=8)
    asked = tune(optimizer, 8)
    assert optimizer.last_source == "initial"
    points = np.array([list(x.values()) for x in asked]) / 2.0
    cells = np.floor((points + 1.0) * 4.0)
    assert all(sorted(column) == list(range(8)) for column in cells.T)
    optimizer.ask()
    source: str = optimizer.last_source
    assert source == "model"


def test_asking_twice_gives_the_same_answer() -> None:
    optimizer = Optimizer(Problem.from_dict(TOY), seed=2, initial_evaluations=4)
    for _ in range(6):
        x = optimizer.ask()
        assert optimizer.ask() == x
        optimizer.tell(x, toy(x))


def test_the_same_seed_gives_the_same_asks_and_another_seed_others() -> None:
    runs = [
        tune(Optimizer(Problem.from_dict(TOY), seed=seed, initial_evaluations=4), 8)
        for seed in (3, 3, 4)
    ]
    assert runs[0] == runs[1]
    assert runs[0] != runs[2]


def test_setpoints_that_were_never_asked_for_are_learned() -> None:
    optimizer = Optimizer(Problem.from_dict(TOY), initial_evaluations=5)
    points = 4.0 * qmc.LatinHypercube(2, seed=np.random.default_rng(0)).random(12) - 2.0
    for x1, x2 in points:
        optimizer.tell({"x1": x1, "x2": x2}, toy({"x1": x1, "x2": x2}))
    x = optimizer.ask()
    assert optimizer.last_source == "model"
    assert abs(x["x1"] - x["x2"]) < 0.5  # on the line where the front is


def test_where_readbacks_are_told_the_models_learn_from_them(tmp_path: Path) -> None:
    problem = Problem.from_dict(TOY)
    sent, there = (Optimizer(problem, seed=2, initial_evaluations=4) for _ in range(2))
    for _ in range(6):
        x = sent.ask()
        assert x == there.ask()
        where = {"x1": x["x1"] + 0.3, "x2": x["x2"]}  # what the supply really gives
        sent.tell(x, toy(where), {"x1": where["x1"], "x2": math.nan})
        there.tell(where, toy(where))
    assert np.array_equal(sent.dataset.inputs, there.dataset.inputs)
    assert sent.ask() == there.ask()
    assert sent.dataset.evaluations[0].setpoint["x1"] != there.dataset.evaluations[0].setpoint["x1"]
    front = {point["setpoint"]["x1"] + 0.3 for point in sent.pareto_front()}
    assert front == {point["setpoint"]["x1"] for point in there.pareto_front()}
    sent.save(tmp_path / "state.json")
    for other in (Optimizer.load(tmp_path / "state.json"), sent.with_problem(problem)):
        assert np.array_equal(other.dataset.inputs, there.dataset.inputs)
    with pytest.raises(ProblemError, match="'x3'"):
        sent.tell(x, {}, {"x3": 1.0})


def test_a_maximised_objective_is_maximised() -> None:
    problem = with_changes(
        objectives={
            "f1": {"reference": REFERENCE},
            "h2": {"reference": -REFERENCE, "direction": "maximize"},
        }
    )

    def machine(x: Mapping[str, float]) -> dict[str, Any]:
        values = toy(x)
        return {"f1": values["f1"], "h2": -values["f2"]}

    turned = Optimizer(problem, seed=1, initial_evaluations=5)
    plain = Optimizer(Problem.from_dict(TOY), seed=1, initial_evaluations=5)
    assert tune(turned, 10, machine) == tune(plain, 10)
    assert turned.hypervolume == pytest.approx(plain.hypervolume)
    assert all(p["objectives"]["h2"] < 0.0 for p in turned.pareto_front())


def test_a_constraint_keeps_the_front_feasible() -> None:
    optimizer = Optimizer(with_changes(constraints={"g": {"max": 0.5}}), seed=1)
    tune(optimizer, 25)
    front = optimizer.pareto_front()
    assert len(front) > 5
    assert all(point["setpoint"]["x1"] <= 0.5 for point in front)
    late = optimizer.dataset.evaluations[12:]
    assert sum(e.feasible for e in late) >= 0.75 * len(late)


def test_in_twenty_variables_suggestions_beat_a_latin_hypercube() -> None:
    names = [f"x{j}" for j in range(20)]
    problem = with_changes(variables={name: {"min": -2.0, "max": 2.0} for name in names})
    optimizer = Optimizer(problem, seed=1, initial_evaluations=12)

    def machine(x: Mapping[str, float]) -> dict[str, Any]:
        point = np.array([x[name] for name in names])
        return {f"f{i}": float(np.linalg.norm(point - c)) / 2.25 for i, c in ((1, 1.0), (2, -1.0))}

    for x in tune(optimizer, 30, machine):
        assert x.keys() == set(names)
        assert all(-2.0 <= value <= 2.0 for value in x.values())
    assert optimizer.last_source == "model"
    hypercubes = []
    for seed in range(10):
        points = 4.0 * qmc.LatinHypercube(20, seed=np.random.default_rng(seed)).random(30) - 2.0
        values = [list(machine(dict(zip(names, row, strict=True))).values()) for row in points]
        hypercubes.append(moocore.hypervolume(np.array(values), ref=[REFERENCE] * 2))
    assert optimizer.hypervolume > 1.2 * max(hypercubes)


@pytest.mark.parametrize("acquisition", ["ei", "ucb"])
def test_weights_make_it_a_single_objective_problem(acquisition: str) -> None:
    optimizer = Optimizer(
        Problem.from_dict(TOY), seed=1, acquisition=acquisition, weights=(1.0, 0.0), beta=1.0
    )
    tune(optimizer, 25)
    assert min(e.values["f1"] for e in optimizer.dataset.evaluations) < 0.15


def test_a_good_prior_mean_finds_the_front_at_once_and_survives_saving(tmp_path: Path) -> None:
    def predict_f1(x: Mapping[str, np.ndarray]) -> np.ndarray:
        return np.hypot(x["x1"] - 1.0, x["x2"] - 1.0)

    def predict_f2(x: Mapping[str, np.ndarray]) -> np.ndarray:
        return np.hypot(x["x1"] + 1.0, x["x2"] + 1.0)

    means = {"f1": predict_f1, "f2": predict_f2}
    problem = Problem.from_dict(TOY)
    informed = Optimizer(problem, seed=1, initial_evaluations=2, prior_means=means)
    for x in tune(informed, 8)[2:]:
        assert abs(x["x1"] - x["x2"]) < 0.05
    informed.save(tmp_path / "state.json")
    assert Optimizer.load(tmp_path / "state.json", means).ask() == informed.ask()
    with pytest.raises(ProblemError, match="a prior mean is given for 'f3'"):
        Optimizer(problem, prior_means={"f3": predict_f1})


def test_focus_goes_on_around_a_point_of_the_front() -> None:
    optimizer = Optimizer(Problem.from_dict(TOY), seed=1, initial_evaluations=5)
    tune(optimizer, 15)
    front = optimizer.pareto_front()
    chosen = front[len(front) // 2]
    focused = optimizer.focus(index=chosen["index"], radius=0.1)
    assert len(focused.dataset) == 15
    for x in tune(focused, 5):
        assert all(abs(x[n] - chosen["setpoint"][n]) <= 0.4 + 1e-9 for n in x)

    weighted = optimizer.focus(weights={"f1": 1.0, "f2": 3.0}, radius=1.0)
    tune(weighted, 12)
    # f1 + 3 f2 is least at the lower end of the front, where f2 = 0.
    assert min(e.values["f2"] for e in weighted.dataset.evaluations) < 0.1


def test_another_problem_goes_on_with_all_that_was_told() -> None:
    optimizer = Optimizer(Problem.from_dict(TOY), seed=1, initial_evaluations=5)
    tune(optimizer, 9)
    narrow = with_changes(
        variables={"x1": {"min": 0.5, "max": 1.0}, "x2": {"min": -2.0, "max": 2.0}},
        objectives={"f1": {"reference": 2.0}, "f2": {"reference": REFERENCE}},
    )
    changed = optimizer.with_problem(narrow)
    assert changed.problem == narrow
    assert changed.settings == optimizer.settings
    points = [[toy(e.setpoint)[n] for n in ("f1", "f2")] for e in optimizer.dataset.evaluations]
    expected = moocore.hypervolume(np.array(points), ref=[2.0, REFERENCE])
    assert changed.hypervolume == pytest.approx(expected, rel=1e-12)
    # What it asks depends on the problem and the data alone.
    told = Optimizer(narrow, seed=1, initial_evaluations=5)
    for evaluation in optimizer.dataset.evaluations:
        told.tell(evaluation.setpoint, toy(evaluation.setpoint))
    assert changed.ask() == told.ask()
    assert all(0.5 <= x["x1"] <= 1.0 for x in tune(changed, 4))
    assert len(optimizer.dataset) == 9

    limited = changed.with_problem(with_changes(constraints={"g": {"max": 0.2}}))
    assert {e.feasible for e in limited.dataset.evaluations if e.setpoint["x1"] > 0.2} == {False}
    with pytest.raises(
        ProblemError, match="the variables are x1; with what was measured only x1, x2"
    ):
        optimizer.with_problem(with_changes(variables={"x1": {"min": 0.0, "max": 1.0}}))


def test_the_largest_box_is_that_of_a_point_in_the_middle() -> None:
    optimizer = Optimizer(Problem.from_dict(TOY))
    assert largest_box(optimizer.problem, optimizer.pareto_front()) is None
    for t in (-1.0, -0.5, 0.1, 0.6, 1.0):
        optimizer.tell({"x1": t, "x2": t}, toy({"x1": t, "x2": t}))
    front = optimizer.pareto_front()
    boxes = [math.prod(REFERENCE - f for f in p["objectives"].values()) for p in front]
    best = largest_box(optimizer.problem, front)
    assert best is not None
    assert best["index"] == front[int(np.argmax(boxes))]["index"] == 2


@pytest.mark.parametrize(
    ("keywords", "sentence"),
    [
        ({}, "index or weights must be given"),
        ({"index": 999}, "index is 999; the front has"),
        ({"weights": {"f1": 1.0}}, "weights are .*; one for each of f1, f2"),
        ({"weights": {"f1": -1.0, "f2": 1.0}}, "numbers of at least 0"),
        ({"weights": {"f1": 1.0, "f2": 1.0}, "radius": 0.0}, "radius is 0.0"),
    ],
)
def test_a_focus_that_cannot_be_is_refused(keywords: dict[str, Any], sentence: str) -> None:
    optimizer = Optimizer(Problem.from_dict(TOY), initial_evaluations=5)
    with pytest.raises(ProblemError, match="the front is empty"):
        optimizer.focus(index=0)
    tune(optimizer, 5)
    with pytest.raises(ProblemError, match=sentence):
        optimizer.focus(**keywords)


@pytest.mark.parametrize("seed", [-1, 1.5, True, "1"])
def test_a_seed_that_is_not_a_integer_is_refused(seed: Any) -> None:
    with pytest.raises(ProblemError, match="seed is"):
        Optimizer(Problem.from_dict(TOY), seed=seed)

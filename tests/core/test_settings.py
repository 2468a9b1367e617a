"""The choices of the optimiser: refused at once where they do not suit, effective where they do."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from mobo_tuner.core import Optimizer, Problem, ProblemError
from mobo_tuner.core.acquisition import ACQUISITION_FUNCTIONS, beta_schedule
from mobo_tuner.core.acquisition_optimizer import MAXIMIZERS, MultiStart, ParticleSwarm
from mobo_tuner.core.gaussian_process import GaussianProcess
from mobo_tuner.core.kernels import KERNELS, precision_from_hessian
from mobo_tuner.core.settings import CHOICES, PRESETS, OptimizerSettings, make_settings

PROBLEM = Problem.from_dict(
    {
        "variables": {
            "x": {"min": 0.0, "max": 1.0, "cost": 2.0},
            "y": {"min": 0.0, "max": 1.0},
        },
        "objectives": {"f": {"reference": 3.0}, "g": {"reference": 3.0}},
    }
)


def machine(x: Mapping[str, float]) -> dict[str, float]:
    return {
        "f": math.hypot(x["x"] - 0.2, x["y"] - 0.3),
        "g": math.hypot(x["x"] - 0.7, x["y"] - 0.9),
    }


def tune(evaluations: int, **choices: Any) -> Optimizer:
    optimizer = Optimizer(PROBLEM, seed=1, **{"initial_evaluations": 4} | choices)
    for _ in range(evaluations):
        x = optimizer.ask()
        optimizer.tell(x, machine(x))
    return optimizer


@pytest.mark.parametrize(
    ("choices", "name", "value"),
    [
        ({"preset": "best"}, "preset", "'best'"),
        ({"preset": ["default"]}, "preset", "['default']"),
        ({"acqusition": "ehvi"}, "'acqusition' is unknown", "did you mean 'acquisition'"),
        ({"acquisition": "pi"}, "acquisition", "'pi'"),
        ({"acquisition": True}, "acquisition", "True"),
        ({"acquisition": "ei"}, "acquisition", "weights"),
        ({"acquisition": "ucb"}, "acquisition", "weights"),
        ({"acquisition": "ei", "weights": (1.0, -1.0)}, "weights[1]", "-1"),
        ({"acquisition": "ei", "weights": (0, 0)}, "weights", "(0.0, 0.0)"),
        ({"acquisition": "ei", "weights": (1.0,)}, "weights", "(1.0,)"),
        ({"acquisition": "ei", "weights": np.ones(3)}, "weights", "(1.0, 1.0, 1.0)"),
        ({"acquisition": "ei", "weights": ("1", "1")}, "weights", "'1'"),
        ({"acquisition": "ei", "weights": (True, True)}, "weights", "True"),
        ({"acquisition": "ei", "weights": 1.0}, "weights", "1.0"),
        ({"acquisition": "ei", "weights": ()}, "weights", "()"),
        ({"acquisition": "ei", "weights": {"f": 1.0}}, "weights", "'f'"),
        ({"acquisition": "ei", "weights": (1.0, math.nan)}, "weights[1]", "nan"),
        ({"weights": (1.0, 1.0)}, "weights", "(1.0, 1.0)"),
        ({"beta": -1.0}, "beta", "-1.0"),
        ({"beta": True}, "beta", "True"),
        ({"beta": "0.5"}, "beta", "'0.5'"),
        ({"beta": math.inf}, "beta", "inf"),
        ({"beta": np.array([1.0])}, "beta", "[1.0]"),
        ({"kernel": "cubic"}, "kernel", "'cubic'"),
        ({"kernel": None}, "kernel", "None"),
        ({"initial_evaluations": -3}, "initial_evaluations", "-3"),
        ({"initial_evaluations": 5.0}, "initial_evaluations", "5.0"),
        ({"initial_evaluations": True}, "initial_evaluations", "True"),
        ({"initial_design": "sobol"}, "initial_design", "'sobol'"),
        ({"refit_every": "10"}, "refit_every", "'10'"),
        ({"suggestion_seconds": 0.0}, "suggestion_seconds", "0.0"),
        ({"suggestion_seconds": "5"}, "suggestion_seconds", "'5'"),
        ({"suggestion_seconds": True}, "suggestion_seconds", "True"),
        ({"suggestion_seconds": math.nan}, "suggestion_seconds", "nan"),
        ({"length_scales": (1, 2, 3)}, "kernel is 'matern52_full': length_scales", "got 3"),
        ({"length_scales": (1, 2), "kernel": "rbf_isotropic"}, "kernel is", "got 2"),
        ({"length_scales": (1, 2, 3), "kernel": "rbf_full"}, "kernel is", "got 3"),
        ({"length_scales": "1"}, "length_scales", "'1'"),
        ({"precision": np.eye(3), "kernel": "rbf_full"}, "kernel is", "got 3 rows"),
        ({"precision": np.eye(2)}, "kernel is 'matern52_full': precision", "'rbf_full'"),
        ({"variance": "2"}, "variance", "'2'"),
        ({"noise": True}, "noise", "True"),
        ({"mean": "0"}, "mean", "'0'"),
        ({"proximal": "near"}, "proximal", "'near'"),
        ({"proximal": True}, "proximal", "True"),
        ({"proximal": False}, "proximal", "False"),
        ({"proximal": -1.0}, "proximal", "-1.0"),
        ({"proximal": [1.0, 2.0, 3.0]}, "proximal", "(1.0, 2.0, 3.0)"),
        ({"proximal": ["1", "2"]}, "proximal", "'1'"),
        ({"proximal": np.eye(3)}, "proximal", "0.0"),
        ({"proximal": [[1.0, 2.0], [0.0, 1.0]]}, "proximal", "symmetric"),
        ({"proximal": [[1.0, 2.0], [2.0, 1.0]]}, "proximal", "semi-definite"),
        ({"proximal": [[1.0, 2.0]]}, "proximal", "square"),
        ({"proximal": np.zeros((2, 2, 2))}, "proximal", "0.0"),
        ({"maximizer": "gradient"}, "maximizer", "'gradient'"),
        ({"maximizer_settings": 5}, "maximizer_settings", "5"),
        ({"maximizer_settings": {"screen": 5}}, "'screen' is unknown", "'screened'"),
        ({"maximizer_settings": {"screened": 0}}, "maximizer_settings.screened", "0"),
        ({"maximizer_settings": {"screened": 5.5}}, "maximizer_settings.screened", "5.5"),
        ({"maximizer_settings": {"population": 9}}, "'population' is unknown", "multi_start"),
        ({"adam_rate": "fast"}, "adam_rate", "'fast'"),
    ],
)
def test_a_choice_that_is_not_allowed_is_refused_at_once(
    choices: dict[str, Any], name: str, value: str
) -> None:
    with pytest.raises(ProblemError) as error:
        Optimizer(PROBLEM, **choices)
    assert str(error.value).startswith(name)
    assert value in str(error.value)


@pytest.mark.parametrize(
    "choices",
    [
        {"acquisition": "ei", "weights": np.array([1.0, 1.0])},
        {"acquisition": "ucb", "weights": [1, 0], "beta": "schedule"},
        {"acquisition": "ucb_hvi", "beta": np.float64(0.5)},
        {"length_scales": np.array([1.0, 2.0])},
        {"length_scales": 1, "kernel": "rbf_isotropic", "variance": 2, "noise": 0},
        {"kernel": "rbf_full", "precision": [[2.0, 1.0], [1.0, 2.0]]},
        {"proximal": "costs"},
        {"proximal": np.array([[2.0, 1.0], [1.0, 2.0]])},
        {"maximizer": "particle_swarm", "maximizer_settings": {"population": 16}},
        {"mean": 2, "transform": "auto", "prior": "none", "suggestion_seconds": 60},
        {"training": "adam", "adam_steps": 10, "adam_retraining_steps": 2},
    ],
)
def test_a_choice_that_is_allowed_is_used_and_survives_json(choices: dict[str, Any]) -> None:
    optimizer = tune(7, **choices)
    assert optimizer.last_source == "model"
    kept = json.loads(json.dumps(optimizer.settings.to_dict()))
    assert OptimizerSettings.from_dict(kept) == optimizer.settings
    restored = Optimizer.from_state(json.loads(json.dumps(optimizer.get_state())))
    assert restored.ask() == optimizer.ask()


def test_a_matrix_may_be_given_row_by_row_and_costs_by_their_values() -> None:
    rows = tune(8, proximal=[[2.0, 1.0], [1.0, 2.0]])
    assert tune(8, proximal=(2.0, 1.0, 1.0, 2.0)).ask() == rows.ask()
    assert rows.settings.proximal == (2.0, 1.0, 1.0, 2.0)
    costs = tune(8, proximal="costs")
    assert tune(8, proximal=(2.0, 1.0)).ask() == costs.ask() != rows.ask()


def test_the_schedule_of_beta_is_that_of_the_evaluations() -> None:
    scheduled = tune(7, acquisition="ucb_hvi", beta="schedule")
    fixed = tune(7, acquisition="ucb_hvi", beta="schedule")
    fixed.settings = make_settings(
        "default", fixed.settings.to_dict() | {"beta": beta_schedule(7, 2)}
    )
    assert fixed.ask() == scheduled.ask() != tune(7, acquisition="ucb_hvi").ask()


def test_settings_of_the_maximiser_are_used() -> None:
    swarm = tune(6, maximizer="particle_swarm", maximizer_settings={"generations": 2})
    assert swarm.settings.make_maximizer() == ParticleSwarm(generations=2)
    assert swarm.ask() != tune(6, maximizer="particle_swarm").ask()
    assert make_settings("paper", {"maximizer": "multi_start"}).make_maximizer() == MultiStart()


def test_a_precision_matrix_from_a_hessian_is_held() -> None:
    precision = precision_from_hessian([[-4.0, -1.0], [-1.0, -2.0]], amplitude=1.0)
    optimizer = tune(6, kernel="rbf_full", precision=precision)
    x = optimizer.dataset.inputs
    process = GaussianProcess(optimizer.settings.gaussian_process).fit(x, x[:, 0])
    np.testing.assert_allclose(process.precision, [[4.0, 1.0], [1.0, 2.0]])


def test_weights_of_a_single_objective_scale_it() -> None:
    alone = Problem.from_dict(
        {"variables": {"x": {"min": 0.0, "max": 1.0}}, "objectives": {"f": {"reference": 2.0}}}
    )
    asked = []
    for weights in (None, (1.0,), (8.0,)):
        optimizer = Optimizer(alone, acquisition="ei", weights=weights, initial_evaluations=3)
        for _ in range(5):
            x = optimizer.ask()
            optimizer.tell(x, {"f": (x["x"] - 0.3) ** 2})
        asked.append(optimizer.ask()["x"])
    np.testing.assert_allclose(asked, asked[0], atol=1e-3)


def test_focus_keeps_all_other_choices() -> None:
    optimizer = tune(8, kernel="rbf", noise=0.01, refit_every=3, proximal=2.0)
    focused = optimizer.focus(weights={"f": 1.0, "g": 1.0}, radius=0.5)
    changed = {n for n in CHOICES if getattr(focused.settings, n) != getattr(optimizer.settings, n)}
    assert changed == {"acquisition", "weights", "initial_evaluations"}


def test_presets_differ_only_where_the_paper_says_so() -> None:
    default, paper = PRESETS["default"].to_dict(), PRESETS["paper"].to_dict()
    assert {n for n in CHOICES if default[n] != paper[n]} == {
        "initial_evaluations",
        "acquisition",
        "maximizer",
        "maximizer_settings",
        "refit_every",
        "kernel",
        "mean",
        "training",
        "prior",
        "transform",
        "exploration",
    }


def test_what_can_be_chosen_has_the_names_of_the_manual() -> None:
    assert list(ACQUISITION_FUNCTIONS) == ["ei", "ucb", "ehvi", "ucb_hvi"]
    assert list(KERNELS) == ["rbf", "rbf_isotropic", "matern52", "matern52_full", "rbf_full"]
    assert list(MAXIMIZERS) == ["particle_swarm", "multi_start"]

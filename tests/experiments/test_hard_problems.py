"""The problems on which starts get stuck: each is what its name says."""

from __future__ import annotations

import numpy as np
import pytest

from experiments.peers.hard import HARD
from experiments.peers.problems import HELD_OUT, PROBLEMS
from mobo_tuner.core.arrays import FloatArray


def sample(name: str) -> tuple[FloatArray, FloatArray]:
    benchmark = HARD[name]()
    x = np.random.default_rng(7).uniform(-1.0, 1.0, (4000, len(benchmark.problem.variables)))
    return x, benchmark.objectives(x)


def test_they_are_no_problems_of_the_comparison() -> None:
    assert not HARD.keys() & (PROBLEMS.keys() | set(HELD_OUT))


@pytest.mark.parametrize("name", HARD)
def test_a_name_says_variables_and_objectives(name: str) -> None:
    problem = HARD[name]().problem
    d, *n_objectives = (int(word) for word in name.split("_") if word.isdigit())
    assert len(problem.variables) == d
    assert len(problem.objectives) == (n_objectives[0] if n_objectives else 2)


@pytest.mark.parametrize("name", [n for n in HARD if n.startswith("well")])
def test_a_well_is_narrow_and_objectives_fall_outwards_from_it(name: str) -> None:
    x, y = sample(name)
    assert 0.01 < np.mean(y.max(axis=1) < 0.5) < 0.15
    if x.shape[1] <= 3:  # in more variables, nearly all of the box is far out
        beside = y.min(axis=1) > 0.5
        outwards = np.linalg.norm(x - x[y.mean(axis=1).argmin()], axis=1)
        assert np.corrcoef(outwards[beside], y.mean(axis=1)[beside])[0, 1] < -0.1


@pytest.mark.parametrize("name", [n for n in HARD if n.startswith(("tails", "long_valley"))])
def test_tails_span_decades(name: str) -> None:
    _, y = sample(name)
    steepest = np.quantile(y, [0.005, 0.995], axis=0)
    assert np.log10(steepest[1] / steepest[0]).max() > 2.0


@pytest.mark.parametrize("name", [n for n in HARD if n.startswith("cliff")])
def test_a_cliff_is_flat_but_for_a_corner(name: str) -> None:
    _, y = sample(name)
    low, middle, high = np.quantile(y[:, 0], [0.05, 0.3, 0.9])
    assert middle - low > 3.0 * (high - middle)


@pytest.mark.parametrize("name", [n for n in HARD if n.startswith("needle")])
def test_a_needle_is_met_in_a_fiftieth(name: str) -> None:
    x, _ = sample(name)
    others = HARD[name]().others
    assert others is not None
    assert np.mean(others["g"](x) <= 0.0) == pytest.approx(0.02, abs=0.01)


@pytest.mark.parametrize("name", [n for n in HARD if n.startswith(("steep", "ledge", "slender"))])
def test_a_steep_constraint_is_far_away_beyond_its_limit_and_near_within(name: str) -> None:
    x, _ = sample(name)
    others = HARD[name]().others
    assert others is not None
    for excess in others.values():
        g = excess(x)
        assert 0.1 < np.mean(g <= 0.0) < 0.7
        assert g.max() > 10.0 * -g.min()

"""The methods that the paper compares with, against what is known about them."""

from __future__ import annotations

import moocore
import numpy as np

from experiments.paper import baselines
from experiments.problems import dtlz2


def test_hypervolumes_agree_with_moocore() -> None:
    benchmark = dtlz2()
    objectives = baselines.random_search(benchmark, 40, seed=1)
    curve = baselines.hypervolumes(benchmark, objectives)
    for n in (1, 20, 40):
        expected = moocore.hypervolume(objectives[:n], ref=benchmark.problem.reference_point)
        np.testing.assert_allclose(curve[n - 1], expected / benchmark.unit)


def test_all_methods_start_from_the_same_points() -> None:
    benchmark = dtlz2()
    first = benchmark.objectives(baselines.starts(benchmark, baselines.POPULATION, 3))
    evolved, last = baselines.nsga2(benchmark, 65, seed=3)
    assert evolved.shape == (65, 3)
    assert last.shape == (baselines.POPULATION, 3)
    for objectives in (evolved, baselines.random_search(benchmark, 30, seed=3)):
        np.testing.assert_allclose(objectives[: baselines.POPULATION], first)


def test_estimated_hypervolume_agrees_with_the_exact_one() -> None:
    benchmark = dtlz2()
    angles = np.random.default_rng(0).uniform(0.0, 0.5 * np.pi, (baselines.MANY + 200, 2))
    a, b = angles.T
    sphere = np.stack([np.cos(a) * np.cos(b), np.cos(a) * np.sin(b), np.sin(a)], axis=1)
    ((_, estimate, error),) = baselines.hypervolumes_at(benchmark, sphere, [len(sphere)], 0)
    exact = moocore.hypervolume(sphere, ref=[2.0] * 3) / benchmark.unit
    assert 0.0 < error < 0.002
    assert abs(estimate - exact) < 5.0 * error

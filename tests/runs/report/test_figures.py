"""The pictures of a report."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import trapezoid

from mobo_tuner.runs.recorded_run import RecordedRun
from mobo_tuner.runs.report.figures import (
    front_figure,
    hypervolume_figure,
    staircase,
)
from tests.support.run_folders import TWO, evaluation, write_run


def test_the_front_of_two_has_the_right_names_units_and_steps(mixed: Path) -> None:
    figure = front_figure(RecordedRun.load(mixed))
    axes = figure.axes[0]
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("f1 [mm]", "f2")
    steps = next(line for line in axes.lines if line.get_label() == "front")
    assert np.asarray(steps.get_xydata()).tolist() == [
        [2.0, 10.0], [2.0, 8.0], [5.0, 8.0], [5.0, 5.0], [8.0, 5.0], [8.0, 2.0], [10.0, 2.0]
    ]  # fmt: skip


def test_the_front_is_shown_in_the_plane_of_the_objectives_that_conflict_most(
    tmp_path: Path,
) -> None:
    objectives = {
        name: {"reference": 10.0, "unit": unit}
        for name, unit in (("sigma_x", "mm"), ("eps_x", "mm mrad"), ("dE", "MeV"))
    }
    problem = {"variables": TWO["variables"], "objectives": objectives}
    problem["constraints"] = {"dE": {"max": 5.0}}
    folder = write_run(
        tmp_path,
        [
            evaluation(i, {"sigma_x": x, "eps_x": 1.0 + i, "dE": 4.0 - i})
            for i, x in enumerate([3.0, 1.0, 2.0])
        ],
        problem,
    )
    axes = front_figure(RecordedRun.load(folder)).axes[0]
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("eps_x [mm mrad]", "dE [MeV]")
    assert "limit of dE" in axes.get_legend_handles_labels()[1]


def test_the_hypervolume_is_shown_with_failures_and_the_product_of_units(mixed: Path) -> None:
    axes = hypervolume_figure(RecordedRun.load(mixed)).axes[0]
    assert axes.get_ylabel() == "hypervolume [mm]"
    (line,) = axes.lines
    assert np.asarray(line.get_ydata()).tolist() == [10.0 * i for i in range(8)]
    labels = axes.get_legend_handles_labels()[1]
    assert {"initial design", "failed", "infeasible"} <= set(labels)


def test_the_staircase_bounds_the_dominated_area() -> None:
    rng = np.random.default_rng(5)
    x = np.sort(rng.random(6))
    points = np.column_stack([x, np.sort(rng.random(6))[::-1]])[rng.permutation(6)]
    reference = np.array([1.2, 1.3])
    corners = staircase(points, reference)
    assert corners.shape == (13, 2)
    area = -trapezoid(corners[:, 1] - reference[1], corners[:, 0])
    grid = (rng.random((20_000, 2))) * reference
    dominated = (points[None] <= grid[:, None]).all(axis=2).any(axis=1)
    assert area == pytest.approx(dominated.mean() * reference.prod(), abs=0.02)

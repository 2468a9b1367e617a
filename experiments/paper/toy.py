"""Runs on the paper's toy problem, Eq. (5) (eqn:toy_problem), with the settings of section subsec:MOBO."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes

from experiments.campaign import Record, rounded
from experiments.problems import PERFECT, prior_means, resume, toy
from mobo_tuner.core import Optimizer
from mobo_tuner.core.arrays import FloatArray

INITIAL = 5
START: dict[str, Any] = {"initial_evaluations": INITIAL, "initial_design": "random"}
# The length-scale of 1 in x is 0.5 after scaling [-2, 2] to [-1, 1]. All hyperparameters are fixed, so that nothing is
# trained. The paper gives neither noise nor reference point.
SETTINGS: dict[str, dict[str, Any]] = {
    "paper": {
        "preset": "paper",
        "kernel": "rbf_isotropic",
        "length_scales": 0.5,
        "variance": 0.5,
        "noise": 0.01,
        "training": "lbfgs",
    },
    "default": {"preset": "default"},
}
PICTURED = 2  # seed of the single run in a picture
ORDER = "plasma"


def run_toy(
    seed: int,
    evaluations: int,
    preset: str,
    constrained: bool = False,
    proximal: float | None = None,
) -> Record:
    """Return the record of a run.

    It has the hypervolumes as shares of the true one, the lengths of the steps in x between suggestions, their median
    distance from the best set-points, and feasibility; for the run that is drawn also the set-points in x.

    Args:
        seed: Seed.
        evaluations: Number of evaluations, including the random ones.
        preset: Name in `SETTINGS`.
        constrained: Whether x1 <= 0.5 is required.
        proximal: Precision of proximal biasing in normalised variables.
    """
    settings = START | SETTINGS[preset] | {"proximal": proximal}
    optimizer = Optimizer(toy(constrained).problem, seed=seed, **settings)
    run = resume(toy(constrained), optimizer, evaluations)
    data = run.optimizer.dataset
    x = 2.0 * data.inputs
    suggested = x[INITIAL:]
    along = np.clip(
        suggested.mean(axis=1), -1.0, 1.0
    )  # the best ones lie between (-1, -1) and (1, 1)
    record: Record = {
        "hypervolumes": rounded(run.hypervolumes),
        "steps": rounded(np.linalg.norm(np.diff(x[INITIAL - 1 :], axis=0), axis=1), 3),
        "distance": rounded([np.median(np.linalg.norm(suggested - along[:, None], axis=1))])[0],
    }
    if seed == PICTURED:
        record["x"] = [rounded(row, 7) for row in x]
    if constrained:
        record["feasible"] = "".join("01"[int(met)] for met in data.feasible)
    return record


def run_perfect(seed: int, evaluations: int) -> Record:
    """Return the hypervolumes of the greedy method that knows the objectives, as shares of the true one.

    It starts from the same random points as the others, and continues with the largest improvement.
    """
    benchmark = toy()
    settings = START | PERFECT
    means = prior_means(benchmark)
    optimizer = Optimizer(benchmark.problem, seed=seed, prior_means=means, **settings)
    return {"hypervolumes": rounded(resume(benchmark, optimizer, evaluations).hypervolumes)}


def evaluated(record: Record, preset: str = "paper", constrained: bool = False) -> Optimizer:
    """Return an optimiser that knows the evaluations of a record."""
    benchmark = toy(constrained)
    optimizer = Optimizer(benchmark.problem, **START, **SETTINGS[preset])
    for x1, x2 in record["x"]:
        setpoint = {"x1": x1, "x2": x2}
        optimizer.tell(setpoint, benchmark.measure(setpoint))
    return optimizer


def grid(size: int) -> tuple[FloatArray, FloatArray]:
    """Return an axis in x `(size,)`, and all pairs as normalised inputs `(size^2, 2)`, x1 fastest."""
    axis = np.linspace(-1.0, 1.0, size)
    return 2.0 * axis, np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)


def input_axes(axes: Axes, title: str) -> None:
    """Set up axes for the input space."""
    axes.set(title=title, xlim=(-2.0, 2.0), ylim=(-2.0, 2.0), xlabel="$x_1$", ylabel="$x_2$")
    axes.set(aspect="equal", xticks=range(-2, 3), yticks=range(-2, 3))


def show_evaluations(axes: Axes, points: FloatArray) -> Any:
    """Draw crosses for the random points, and dots coloured by number for the suggested ones."""
    axes.plot(*points[:INITIAL].T, "x", color="tab:orange", markersize=7, markeredgewidth=2)
    rest = points[INITIAL:]
    x, y = rest.T
    numbers = np.arange(1, len(rest) + 1)
    return axes.scatter(
        x, y, c=numbers, cmap=ORDER, edgecolors="white", linewidths=0.8, s=36, zorder=3
    )

"""Figure toy_mobo: the toy problem after 5 random and 15 suggested evaluations, and how much of the front is found."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.figure import Figure

from experiments.campaign import PlannedRun, Results, Size
from experiments.paper.experiment import Experiment, Row, runs
from experiments.paper.toy import (
    PICTURED,
    evaluated,
    grid,
    input_axes,
    run_perfect,
    run_toy,
    show_evaluations,
)
from experiments.problems import toy
from mobo_tuner.core.acquisition import UpperConfidenceBoundHypervolumeImprovement
from mobo_tuner.core.gaussian_process import GaussianProcess
from mobo_tuner.core.hypervolume import BoxDecomposition

EVALUATIONS = 20
GRID = 121
COLORS = "viridis"  # as in the paper: 0 is blue, 1 is yellow


def plan(size: Size) -> list[PlannedRun]:
    """Return runs of 60 seeds with the paper's and the default settings, and 20 with perfect knowledge."""
    n = size.number(EVALUATIONS, 10)
    seeds = [*dict.fromkeys([PICTURED, *size.seeds_of(60)])]
    runs = [
        PlannedRun(preset, seed, run_toy, {"evaluations": n, "preset": preset})
        for preset in ("paper", "default")
        for seed in (seeds if preset == "paper" else size.seeds_of(60))
    ]
    return runs + [
        PlannedRun("perfect", seed, run_perfect, {"evaluations": n}) for seed in size.seeds_of(20)
    ]


def compare(results: Results) -> list[Row]:
    """Return the distance of suggestions from the best set-points and the share of the hypervolume."""
    rows = []
    distances = results.values("paper", "distance")
    if len(distances):
        rows.append(
            Row(
                "where it measures: distance of a suggestion from the best set-points, median",
                "“located near the analytical Pareto optimal region”",
                f"{distances.mean():.3f} of a range of 4 ({runs(len(distances))})",
            )
        )
    for n in (15, 20):
        shares = [
            f"{title} {100 * curves[:, n - 1].mean():.1f} % (worst {100 * curves[:, n - 1].min():.1f})"
            for label, title in (("paper", "UCB-HVI"), ("default", "default"), ("perfect", "limit"))
            if (curves := results.curves(label)).size and curves.shape[1] >= n
        ]
        if shares:
            claim = "“closely matches the analytical one”" if n == 20 else "–"
            rows.append(
                Row(f"share of the true hypervolume, {n} evaluations", claim, "; ".join(shares))
            )
    return rows


def draw(results: Results) -> Figure:
    """Draw true objectives, predicted means, acquisition function and front of one run."""
    optimizer = evaluated(results.runs["paper"][PICTURED])
    problem, data = optimizer.problem, optimizer.dataset
    settings = optimizer.settings.gaussian_process
    models = [
        GaussianProcess(settings, float(r)).fit(data.inputs, data.objectives[:, j])
        for j, r in enumerate(problem.reference_point)
    ]
    beta = optimizer.settings.beta
    assert isinstance(beta, float)
    boxes = BoxDecomposition(problem.reference_point, data.objectives)
    alpha = UpperConfidenceBoundHypervolumeImprovement(models, boxes, beta)
    x, inputs = grid(GRID)
    truth = toy().objectives(inputs)
    maps = [
        *truth.T,
        *(model.predict(inputs)[0] for model in models),
        np.exp(alpha.log_value(inputs)),
    ]

    figure = Figure(figsize=(8.0, 11.0))
    panels = figure.subplots(3, 2).ravel()
    titles = [
        "(a) $f_1$",
        "(b) $f_2$",
        r"(c) $\mu_1$",
        r"(d) $\mu_2$",
        r"(e) UCB-HVI, $\beta = 0.01$",
    ]
    for i, (axes, title, values) in enumerate(zip(panels, titles, maps, strict=False)):
        input_axes(axes, title)
        scaled = (values - values.min()) / np.ptp(values)
        axes.pcolormesh(
            x, x, scaled.reshape(GRID, GRID), cmap=COLORS, shading="nearest", rasterized=True
        )
        if i < 2:
            axes.plot([-1.0, 1.0], [-1.0, 1.0], color="tab:green", linewidth=2.5)
        else:
            show_evaluations(axes, 2.0 * data.inputs)
    axes, length = panels[5], 2.0 * math.sqrt(2.0)
    axes.set(title="(f) evaluations and true front", xlabel="$f_1$", ylabel="$f_2$")
    axes.set(xlim=(-0.15, 4.4), ylim=(-0.15, 4.4), aspect="equal")
    axes.plot([0.0, length], [length, 0.0], color="tab:green", linewidth=2.5)
    dots = show_evaluations(axes, data.objectives)
    figure.colorbar(dots, ax=panels[4:], label="suggestion", location="bottom", shrink=0.5)
    return figure


EXPERIMENT = Experiment(
    "Toy problem: objectives, models, acquisition function and front",
    plan,
    compare,
    draw,
)

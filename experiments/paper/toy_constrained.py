"""Figure toy_constrained: the toy problem with x1 <= 0.5, known from measurements only."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure

from experiments.campaign import PlannedRun, Results, Size
from experiments.paper.experiment import Experiment, Row, draw_curves, runs
from experiments.paper.toy import INITIAL, PICTURED, evaluated, grid, input_axes, run_toy
from mobo_tuner.core.arrays import FloatArray
from mobo_tuner.core.constraints import ProbabilityOfFeasibility
from mobo_tuner.core.gaussian_process import GaussianProcess

LIMIT = 0.5
GRID = 121


def plan(size: Size) -> list[PlannedRun]:
    """Return 25 runs of 50 evaluations with the paper's and the default settings."""
    n = size.number(50, 10)
    seeds = [*dict.fromkeys([PICTURED, *size.seeds_of(25)])]
    return [
        PlannedRun(preset, seed, run_toy, {"evaluations": n, "preset": preset, "constrained": True})
        for preset in ("paper", "default")
        for seed in (seeds if preset == "paper" else size.seeds_of(25))
    ]


def _feasible(results: Results, label: str) -> FloatArray:
    """Return whether each evaluation of each run met the limit, as 0 or 1 `(r, n)`."""
    return np.array([list(map(float, r["feasible"])) for r in results.records(label)])


def _so_far(feasible: FloatArray) -> FloatArray:
    """Return the share of the evaluations so far that met the limit `(r, n)`."""
    return np.asarray(feasible.cumsum(axis=1) / np.arange(1, feasible.shape[1] + 1))


def compare(results: Results) -> list[Row]:
    """Return the shares of evaluations that violate the limit."""
    rows = []
    for label, title in (("paper", "UCB-HVI"), ("default", "default")):
        feasible = _feasible(results, label)
        if not feasible.size:
            continue
        n = feasible.shape[1]
        first, last = 1.0 - feasible[:, :INITIAL].mean(), 1.0 - feasible[:, n // 2 :].mean()
        suggested = 1.0 - feasible[:, INITIAL:].mean()
        rows.append(
            Row(
                f"{title}: share of evaluations that violate the limit",
                "falls as the optimisation progresses (figure only)" if label == "paper" else "–",
                f"{100 * first:.0f} % of the random ones, {100 * suggested:.1f} % of the suggested ones, "
                f"{100 * last:.1f} % of the second half ({runs(len(feasible))})",
            )
        )
    return rows


def draw(results: Results) -> Figure:
    """Draw the learned probability of feasibility of one run, and the share of feasible evaluations."""
    optimizer = evaluated(results.runs["paper"][PICTURED], constrained=True)
    data = optimizer.dataset
    settings = replace(optimizer.settings.gaussian_process, mean="data")
    model = GaussianProcess(settings).fit(data.inputs, data.column("g"))
    x, inputs = grid(GRID)
    probability = np.exp(ProbabilityOfFeasibility(model, upper=LIMIT).log_value(inputs))

    figure = Figure(figsize=(11.0, 4.4))
    left, right = figure.subplots(1, 2)
    input_axes(left, f"(a) probability of $x_1 \\leq 0.5$ after {len(data)} evaluations")
    values = probability.reshape(GRID, GRID)
    filled = left.contourf(x, x, values, np.linspace(0.0, 1.0, 11), cmap="cividis")
    figure.colorbar(filled, ax=left, label=r"$P_g$")
    left.axvline(LIMIT, color="white", linestyle="--", linewidth=1.5)
    for rows, marker, color, label in (
        (data.feasible, "o", "white", "met"),
        (~data.feasible, "X", "tab:red", "violated"),
    ):
        at = 2.0 * data.inputs[rows]
        left.scatter(
            *at.T, marker=marker, c=color, edgecolors="black", linewidths=0.8, s=38, label=label
        )
    arrow = {"arrowstyle": "-|>", "color": "tab:red", "linewidth": 2.5, "mutation_scale": 18}
    left.annotate("", (LIMIT, 0.45), (1.5, -0.6), arrowprops=arrow)
    left.legend(loc="upper left", frameon=True, framealpha=1.0)

    right.set_title("(b) share of evaluations so far with $x_1 \\leq 0.5$; shading: one sigma")
    right.axvspan(0.0, INITIAL, color="#F0F0F0", zorder=0)
    for label, title, color in (
        ("paper", "constrained UCB-HVI", "tab:blue"),
        ("default", "default", "tab:green"),
    ):
        feasible = _feasible(results, label)
        if feasible.size:
            draw_curves(right, _so_far(feasible), title, color)
    right.set(xlim=(0, len(data)), ylim=(0, 1.02), xlabel="evaluations", ylabel="share")
    right.legend(loc="lower right")
    return figure


EXPERIMENT = Experiment(
    "Toy problem with a constraint: probability of feasibility, and share of feasible evaluations",
    plan,
    compare,
    draw,
)

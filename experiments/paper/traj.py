"""Figure traj: paths through the input space of the toy problem without and with the proximal factor."""

from __future__ import annotations

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from experiments.campaign import PlannedRun, Results, Size
from experiments.paper.experiment import Experiment, Row, runs
from experiments.paper.toy import INITIAL, ORDER, PICTURED, input_axes, run_toy

# 4 I in x: steps in x are twice as long as in normalised space.
PRECISION = 16.0
CASES = {
    "ucb_hvi": ("paper", None, "(a) UCB-HVI"),
    "proximal": ("paper", PRECISION, r"(b) P-UCB-HVI, $\Lambda = 4\,I$"),
    "default": ("default", None, "default"),
    "default proximal": ("default", PRECISION, "default, proximal"),
}


def plan(size: Size) -> list[PlannedRun]:
    """Return 25 runs of 5 random points and 25 suggestions for each case."""
    n = INITIAL + size.number(25, 5)
    seeds = [*dict.fromkeys([PICTURED, *size.seeds_of(25)])]
    return [
        PlannedRun(
            label, seed, run_toy, {"evaluations": n, "preset": preset, "proximal": precision}
        )
        for label, (preset, precision, _) in CASES.items()
        for seed in (seeds if preset == "paper" else size.seeds_of(25))
    ]


def compare(results: Results) -> list[Row]:
    """Return mean step lengths and hypervolumes without and with the factor."""
    rows = []
    for plain, biased, title in (
        ("ucb_hvi", "proximal", "UCB-HVI"),
        ("default", "default proximal", "default"),
    ):
        steps = [results.curves(label, "steps") for label in (plain, biased)]
        if not all(s.size for s in steps):
            continue
        means = [float(s.mean()) for s in steps]
        volumes = [100 * results.curves(label)[:, -1].mean() for label in (plain, biased)]
        claim = "shorter (insets only)" if title == "UCB-HVI" else "–"
        rows.append(
            Row(
                f"{title}: mean step without, with the factor",
                claim,
                f"{means[0]:.2f}, {means[1]:.2f}: × {means[1] / means[0]:.2f} ({runs(len(steps[1]))})",
            )
        )
        rows.append(
            Row(
                f"{title}: share of the true hypervolume without, with the factor",
                "–",
                f"{volumes[0]:.1f} %, {volumes[1]:.1f} %",
            )
        )
    return rows


def draw(results: Results) -> Figure:
    """Draw the path of one run, and as insets the step lengths of all, without and with the factor."""
    figure = Figure(figsize=(11.0, 5.2))
    panels = figure.subplots(1, 2)
    bins = np.linspace(0.0, 4.0, 21)
    for axes, label in zip(panels, ("ucb_hvi", "proximal"), strict=True):
        path = np.array(results.runs[label][PICTURED]["x"][INITIAL - 1 :])
        numbers = np.arange(1, len(path))
        input_axes(axes, f"{CASES[label][2]}: {len(numbers)} suggestions")
        axes.plot([-1.0, 1.0], [-1.0, 1.0], color="tab:green", linewidth=5.0, alpha=0.4)
        lines = LineCollection([path[i : i + 2] for i in range(len(numbers))], cmap=ORDER)
        lines.set_array(numbers)
        axes.add_collection(lines)
        dots = axes.scatter(*path[1:].T, c=numbers, cmap=ORDER, edgecolors="black", s=34, zorder=3)
        axes.plot(*path[0], "x", color="tab:orange", markersize=9, markeredgewidth=2.5)
        inset = axes.inset_axes((0.64, 0.07, 0.34, 0.26))
        steps = results.curves(label, "steps").ravel()
        inset.hist(steps, bins, weights=np.full(len(steps), 100.0 / len(steps)))
        inset.axvline(float(steps.mean()), color="tab:red", linestyle="--")
        inset.set_title(f"$L$, mean {steps.mean():.2f} [% of steps]", fontsize=8, pad=3.0)
        inset.tick_params(labelsize=7)
    figure.colorbar(dots, ax=panels, label="suggestion", shrink=0.8)
    return figure


EXPERIMENT = Experiment(
    "Toy problem: paths in the input space without and with the proximal factor",
    plan,
    compare,
    draw,
)

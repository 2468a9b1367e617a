"""Draw the pictures of docs/method.md and docs/machine.md with the optimiser, the simulation and the surrogate.

    python docs/make_pictures.py [FOLDER]

The toy problem is that of the paper, [Roussel2021]_ Eq. (5) (label eqn:toy_problem), with the paper's settings. The
same arguments give the same pictures.

.. [Roussel2021] R. Roussel, A. Hanuka, A. Edelen, "Multiobjective Bayesian optimization for online
   accelerator tuning", Phys. Rev. Accel. Beams 24, 062801 (2021).
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from cartoons import BLUE, GREEN, RED, draw_acquisition, draw_boxes
from machine_pictures import draw_beam, draw_beamline, draw_front, draw_knobs
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from awa_sim_node.machine.models import create_model
from mobo_tuner.core import Optimizer, Problem
from mobo_tuner.core.acquisition import UpperConfidenceBoundHypervolumeImprovement
from mobo_tuner.core.constraints import ProbabilityOfFeasibility
from mobo_tuner.core.gaussian_process import GaussianProcess
from mobo_tuner.core.hypervolume import BoxDecomposition
from mobo_tuner.core.pareto import FloatArray

ROOT = Path(__file__).resolve().parent.parent

ORDER, MAP = "plasma", "Greys"
STYLE: dict[Any, Any] = {
    "figure.dpi": 130,
    "figure.constrained_layout.use": True,
    "font.size": 10,
    "axes.titlesize": 10.5,
    "axes.titlelocation": "left",
    "axes.titlepad": 8.0,
    "legend.frameon": False,
    "legend.fontsize": 9,
}

# Settings of the paper's section subsec:MOBO. Its length-scale of 1 in x is 0.5 after scaling [-2, 2] to [-1, 1].
# All hyperparameters are fixed, so that nothing is trained. The noise is not given in the paper.
TOY: dict[str, Any] = {
    "preset": "paper",
    "initial_evaluations": 5,
    "initial_design": "random",
    "kernel": "rbf_isotropic",
    "length_scales": 0.5,
    "variance": 0.5,
    "noise": 0.01,
    "training": "lbfgs",
}
INITIAL = 5
# 4 I in x (section on proximal exploration): steps in x are twice as long as in normalised space.
PRECISION = 16.0


def main(arguments: Sequence[str] | None = None) -> None:
    """Draw all pictures."""
    parser = argparse.ArgumentParser(
        description="Draw the pictures of docs/method.md and docs/machine.md."
    )
    parser.add_argument(
        "folder", type=Path, nargs="?", default=ROOT / "docs" / "images", help="folder to write to"
    )
    parser.add_argument("--seed", type=int, default=2, help="seed of the single runs")
    parser.add_argument(
        "--constraint-seeds",
        type=int,
        default=25,
        help="number of runs averaged in the constraint's picture",
    )
    parser.add_argument(
        "--proximal-seeds",
        type=int,
        default=10,
        help="number of runs in the histograms of step lengths",
    )
    parser.add_argument(
        "--grid", type=int, default=121, help="number of points of a map along each axis"
    )
    parser.add_argument(
        "--particles", type=int, default=10_000, help="number of particles of a simulated beam"
    )
    parser.add_argument("--samples", type=int, default=2**17, help="number of random set-points")
    parser.add_argument(
        "--evaluations", type=int, default=60, help="number of evaluations of a run on the machine"
    )
    parser.add_argument(
        "--only", nargs="+", choices=PICTURES, default=list(PICTURES), help="pictures to draw"
    )
    options = parser.parse_args(arguments)
    options.folder.mkdir(parents=True, exist_ok=True)
    with rc_context(STYLE):
        for name in options.only:
            figure = PICTURES[name](options)
            FigureCanvasAgg(figure)
            # The file does not contain the version of matplotlib.
            figure.savefig(options.folder / f"{name}.png", metadata={"Software": None})


# ---------------------------------------------------------------- the toy problem


def toy_problem(constrained: bool = False) -> Problem:
    """Return the problem of config/toy.yaml, optionally with the constraint x1 <= 0.5."""
    problem = Problem.from_yaml(ROOT / "config" / "toy.yaml")
    definition = problem.to_dict()
    if constrained:
        definition["constraints"] = {"g": {"max": 0.5}}
    return Problem.from_dict(definition)


def run_toy(
    iterations: int, seed: int, constrained: bool = False, proximal: float | None = None
) -> Optimizer:
    """Return the optimiser after five random evaluations and `iterations` suggested ones."""
    optimizer = Optimizer(toy_problem(constrained), seed=seed, proximal=proximal, **TOY)
    machine = create_model("toy")
    for _ in range(INITIAL + iterations):
        setpoint = optimizer.ask()
        optimizer.tell(setpoint, machine.true_values(setpoint))
    return optimizer


def draw_toy(options: argparse.Namespace) -> Figure:
    """Draw objectives, models, acquisition function and front after 5 random and 15 suggested points."""
    optimizer = run_toy(15, options.seed)
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
    x, inputs = _grid(options.grid)
    truth = _toy_objectives(inputs)
    maps = [truth[:, 0], truth[:, 1], *(m.predict(inputs)[0] for m in models)]

    figure = Figure(figsize=(12.6, 7.4))
    panels = figure.subplots(2, 3)
    order = [panels[0, 0], panels[1, 0], panels[0, 1], panels[1, 1]]
    titles = [
        "(a) objective $f_1$",
        "(b) objective $f_2$",
        r"(c) predicted mean $\mu_1$",
        r"(d) predicted mean $\mu_2$",
    ]
    levels = np.linspace(0.0, 4.5, 10)
    for i, (axes, title, values) in enumerate(zip(order, titles, maps, strict=True)):
        _input_axes(axes, title)
        shape = (options.grid, options.grid)
        filled = axes.contourf(x, x, values.reshape(shape), levels, cmap=MAP, extend="both")
        axes.plot([-1.0, 1.0], [-1.0, 1.0], color=GREEN, linewidth=2.5)
        if i >= 2:
            _show_evaluations(axes, 2.0 * data.inputs)
    figure.colorbar(filled, ax=order, location="left", shrink=0.6, label="objective, from 0 (best)")

    acquisition = np.exp(alpha.log_value(inputs)).reshape(shape)
    axes = panels[0, 2]
    _input_axes(axes, r"(e) acquisition function $\alpha$ (UCB-HVI)")
    mesh = axes.pcolormesh(x, x, acquisition, cmap=MAP, shading="nearest", rasterized=True)
    figure.colorbar(mesh, ax=axes, label=r"$\alpha$")
    axes.plot([-1.0, 1.0], [-1.0, 1.0], color=GREEN, linewidth=1.2)
    _show_evaluations(axes, 2.0 * data.inputs)

    axes = panels[1, 2]
    length = 2.0 * math.sqrt(2.0)
    axes.set_title("(f) evaluations in objective space")
    axes.plot([0.0, length], [length, 0.0], color=GREEN, linewidth=2.5, label="true front")
    dots = _show_evaluations(axes, data.objectives)
    figure.colorbar(dots, ax=axes, label="suggestion")
    axes.set(xlabel="$f_1$", ylabel="$f_2$", xlim=(-0.15, 4.4), ylim=(-0.15, 4.4))
    axes.legend(loc="upper right")
    return figure


def draw_constraint(options: argparse.Namespace) -> Figure:
    """Draw the learned probability of x1 <= 0.5, and the fraction of evaluations that meet it."""
    optimizer = run_toy(45, options.seed, constrained=True)
    data = optimizer.dataset
    settings = replace(optimizer.settings.gaussian_process, mean="data")
    model = GaussianProcess(settings).fit(data.inputs, data.column("g"))
    x, inputs = _grid(options.grid)
    probability = np.exp(ProbabilityOfFeasibility(model, upper=0.5).log_value(inputs))

    figure = Figure(figsize=(11.6, 4.6))
    left, right = figure.subplots(1, 2)
    _input_axes(left, "(a) probability of $x_1 \\leq 0.5$ after 50 evaluations")
    values = probability.reshape(options.grid, options.grid)
    filled = left.contourf(x, x, values, np.linspace(0.0, 1.0, 11), cmap="cividis")
    figure.colorbar(filled, ax=left, label=r"$P_g$")
    left.axvline(0.5, color="white", linestyle="--", linewidth=1.5)
    feasible = data.feasible
    for rows, marker, color, label in (
        (feasible, "o", "white", "met"),
        (~feasible, "X", RED, "violated"),
    ):
        at = 2.0 * data.inputs[rows]
        left.scatter(
            *at.T, marker=marker, c=color, edgecolors="black", linewidths=0.8, s=38, label=label
        )
    left.annotate(
        "",
        (0.5, 0.45),
        (1.5, -0.6),
        arrowprops={"arrowstyle": "-|>", "color": RED, "linewidth": 2.5, "mutation_scale": 18},
    )
    left.legend(loc="upper left", frameon=True, framealpha=1.0)

    count = options.constraint_seeds
    met = np.array([run_toy(45, s, constrained=True).dataset.feasible for s in range(count)])
    n = np.arange(1, met.shape[1] + 1)
    share = met.cumsum(axis=1) / n
    mean, spread = share.mean(axis=0), share.std(axis=0)
    right.set_title(f"(b) mean of {count} runs, shaded: one standard deviation")
    right.axvspan(0.0, INITIAL, color="#F0F0F0", zorder=0)
    right.text(0.5 * INITIAL, 0.05, "random", ha="center", rotation=90, color="#555555")
    low, high = np.clip([mean - spread, mean + spread], 0.0, 1.0)
    right.fill_between(n, low, high, color=BLUE, alpha=0.2, linewidth=0.0)
    right.plot(n, mean, color=BLUE, linewidth=2.0)
    right.set(xlim=(0, met.shape[1]), ylim=(0, 1.02))
    right.set(xlabel="evaluations", ylabel="share of them with $x_1 \\leq 0.5$")
    return figure


def draw_proximal(options: argparse.Namespace) -> Figure:
    """Draw the path of 25 suggestions without and with proximal biasing, and the step lengths."""
    figure = Figure(figsize=(10.6, 7.6))
    panels = figure.subplots(2, 2, height_ratios=[2.4, 1.0], sharey="row")
    bins = np.linspace(0.0, 4.0, 21)
    cases = ((None, "(a) UCB-HVI"), (PRECISION, r"(b) P-UCB-HVI, $\Lambda = 4\,I$"))
    for column, (proximal, title) in enumerate(cases):
        above, below = panels[:, column]
        path = _travelled(options.seed, proximal)
        _input_axes(above, f"{title}: 25 suggestions")
        above.plot([-1.0, 1.0], [-1.0, 1.0], color=GREEN, linewidth=5.0, alpha=0.4)
        lines = LineCollection(
            [path[i : i + 2] for i in range(len(path) - 1)], cmap=ORDER, linewidths=1.3
        )
        lines.set_array(np.arange(1, len(path)))
        above.add_collection(lines)
        dots = above.scatter(
            *path[1:].T, c=np.arange(1, len(path)), cmap=ORDER, edgecolors="black", s=34, zorder=3
        )
        above.plot(*path[0], "x", color=RED, markersize=9, markeredgewidth=2.5)
        steps = np.concatenate(
            [
                np.linalg.norm(np.diff(_travelled(seed, proximal), axis=0), axis=1)
                for seed in range(options.proximal_seeds)
            ]
        )
        below.hist(steps, bins, weights=np.full(len(steps), 100.0 / len(steps)), color=BLUE)
        below.axvline(float(steps.mean()), color=RED, linestyle="--")
        below.text(steps.mean() + 0.06, 0.88, f"mean {steps.mean():.2f}", color=RED)
        below.texts[-1].set_transform(below.get_xaxis_transform())
        below.set(xlim=(0.0, 4.0), xlabel="step length $L$ in $\\mathbf{x}$")
    panels[1, 0].set_ylabel(f"steps of {options.proximal_seeds} runs [%]")
    figure.colorbar(dots, ax=panels[0, :], shrink=0.87, label="suggestion")
    return figure


def _travelled(seed: int, proximal: float | None) -> FloatArray:
    """Return the last random set-point and the 25 suggestions after it in x, ``(26, 2)``."""
    return np.asarray(2.0 * run_toy(25, seed, proximal=proximal).dataset.inputs[INITIAL - 1 :])


def _grid(size: int) -> tuple[FloatArray, FloatArray]:
    """Return an axis in x ``(size,)``, and all pairs as normalised inputs ``(size^2, 2)``, x1 fastest."""
    axis = np.linspace(-1.0, 1.0, size)
    return 2.0 * axis, np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)


def _toy_objectives(inputs: FloatArray) -> FloatArray:
    """Return the true objectives ``(n, 2)`` at normalised inputs ``(n, 2)``."""
    return np.stack([np.linalg.norm(2.0 * inputs + s, axis=1) for s in (-1.0, 1.0)], axis=1)


def _show_evaluations(axes: Axes, points: FloatArray) -> Any:
    """Draw crosses for the random points, and dots coloured by number for the suggested ones."""
    axes.plot(*points[:INITIAL].T, "x", color=RED, markersize=7, markeredgewidth=2, label="random")
    rest = points[INITIAL:]
    numbers = np.arange(1, len(rest) + 1)
    x, y = rest.T
    return axes.scatter(
        x, y, c=numbers, cmap=ORDER, edgecolors="white", linewidths=0.8, s=36, zorder=3
    )


def _input_axes(axes: Axes, title: str) -> None:
    axes.set(title=title, xlim=(-2.0, 2.0), ylim=(-2.0, 2.0), xlabel="$x_1$", ylabel="$x_2$")
    axes.set(aspect="equal", xticks=range(-2, 3), yticks=range(-2, 3))


PICTURES: dict[str, Callable[[argparse.Namespace], Figure]] = {
    "method_boxes": lambda _: draw_boxes(),
    "method_acquisition": lambda _: draw_acquisition(),
    "method_toy": draw_toy,
    "method_constraint": draw_constraint,
    "method_proximal": draw_proximal,
    "machine_beamline": lambda _: draw_beamline(),
    "machine_beam": lambda options: draw_beam(options.particles),
    "machine_knobs": lambda _: draw_knobs(),
    "machine_front": lambda options: draw_front(options.samples, options.evaluations, options.seed),
}

if __name__ == "__main__":
    main()

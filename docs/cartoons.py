"""Pictures of docs/method.md that show the method's concepts in objective space, computed by the optimiser."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from mobo_tuner.core.acquisition import (
    ExpectedHypervolumeImprovement,
    UpperConfidenceBoundHypervolumeImprovement,
)
from mobo_tuner.core.arrays import FloatArray
from mobo_tuner.core.gaussian_process import GaussianProcess, GaussianProcessSettings
from mobo_tuner.core.hypervolume import BoxDecomposition
from mobo_tuner.core.pareto import pareto_front

# Safe for colour-blind readers: the palette of Okabe and Ito.
BLUE, ORANGE, GREEN, RED, PURPLE = "#0072B2", "#E69F00", "#009E73", "#D55E00", "#CC79A7"
GREY = "#8C8C8C"


# ---------------------------------------------------------------- hypervolume and boxes


def draw_boxes() -> Figure:
    """Draw the hypervolume improvement, the boxes that sum to it, and the one-dimensional terms."""
    front = np.array([[1.0, 7.2], [2.6, 4.8], [4.6, 3.2], [7.4, 1.6]])
    reference, y = np.array([9.0, 9.0]), np.array([3.4, 2.2])
    decomposition = BoxDecomposition(reference, front)
    figure = Figure(figsize=(12.6, 4.4))
    left, middle, right = figure.subplots(1, 3)

    left.set_title("(a) the hypervolume and its improvement")
    _objective_axes(left)
    _shade_dominated(left, front, reference, BLUE)
    _shade_improvement(left, front, y, reference)
    _mark_front(left, front, reference)
    _mark_candidate(left, y, r"$\mathbf{y}$")
    left.text(6.6, 6.5, r"$\mathcal{H}$", color=BLUE, fontsize=17)
    left.text(3.75, 2.45, r"$\mathcal{H}_I$", color="#00573F", fontsize=13)

    total = decomposition.improvement(y[None])[0]
    middle.set_title(f"(b) the free region in boxes, $\\mathcal{{H}}_I$ = {total:.2f}")
    _objective_axes(middle)
    boxes = _corners(decomposition)
    for i, (lower, upper) in enumerate(boxes[np.argsort(-boxes[:, 1, 1])]):
        seen = np.maximum(lower, -1.0)
        _rectangle(middle, seen, upper, facecolor=("#FFF4DC", "#F6E3B4")[i % 2], edgecolor=ORANGE)
        middle.text(0.15, 0.5 * (max(lower[1], 0.0) + upper[1]), f"{i + 1}", va="center")
        inside = np.maximum(seen, y)
        area = float(np.prod(np.maximum(upper - inside, 0.0)))
        if area > 0.0:
            _rectangle(middle, inside, upper, facecolor=GREEN, alpha=0.6, edgecolor="none")
            middle.text(*(inside + 0.5 * (upper - inside)), f"{area:.2f}", ha="center", va="center")
    _mark_front(middle, front, reference)
    _mark_candidate(middle, y, r"$\mathbf{y}$")

    _draw_terms(right)
    return figure


def _draw_terms(axes: Axes) -> None:
    """Draw the functions G for a predicted mean of 5 and a standard deviation of 1.2."""
    mean, stddev, floor = 5.0, 1.2, 4.4
    t = np.linspace(0.0, 9.0, 181)

    def term(mean: float, stddev: float, floor: float = -math.inf) -> FloatArray:
        # With one objective and no points, the improvement is G at the reference point.
        return np.array(
            [
                BoxDecomposition([each]).expected_improvement(
                    [[mean]], [[stddev]], [floor] if floor < each else None
                )[0]
                if floor < each
                else 0.0
                for each in t
            ]
        )

    axes.set_title(r"(c) terms $G_j(t)$, prediction $5 \pm 1.2$")
    axes.plot(t, term(mean - stddev, 0.0), color=BLUE, label=r"UCB-HVI, $\beta = 1$")
    axes.plot(t, term(mean, stddev), color=RED, linestyle="--", label="EHVI")
    axes.plot(
        t, term(mean, stddev, floor), color=PURPLE, linestyle="-.", label="EHVI truncated, A = 4.4"
    )
    axes.axvspan(mean - stddev, mean + stddev, color="#EFEFEF", zorder=0)
    axes.text(mean, 4.75, r"$\mu_j \pm \sigma_j$", ha="center", color="#555555")
    axes.set(xlim=(0.0, 9.0), ylim=(-0.1, 5.2), xlabel="$t$, a box's corner", ylabel="$G_j(t)$")
    axes.legend(loc="upper left", bbox_to_anchor=(0.0, 0.9))


def _corners(decomposition: BoxDecomposition) -> FloatArray:
    """Return the lower and upper corners of all boxes, ``(b, 2, P)``, in the tree's order."""
    tree, levels = decomposition._tree, decomposition._levels
    leaves = np.flatnonzero(tree.first_child[: decomposition._n_nodes] == 0)
    axes = np.arange(levels.shape[1])
    return np.stack([levels[tree.lower[leaves], axes], levels[tree.upper[leaves], axes]], axis=1)


# ---------------------------------------------------------------- acquisition functions


def draw_acquisition() -> Figure:
    """Draw two models of one variable, and three acquisition functions of the same candidate."""
    x = np.array([[-0.8], [0.0], [0.8]])
    front = np.array([[1.4, 7.6], [3.8, 4.4], [7.0, 2.2]])
    reference = np.array([9.0, 9.0])
    models = [
        GaussianProcess(
            GaussianProcessSettings(
                kernel="rbf", mean="reference", length_scales=0.45, variance=variance, noise=0.01
            ),
            float(r),
        ).fit(x, y)
        for r, y, variance in zip(reference, front.T, (5.0, 11.0), strict=True)
    ]
    candidate = np.array([[0.18]])
    mean, stddev = (np.ravel(m) for m in zip(*[m.predict(candidate) for m in models], strict=True))
    boxes = BoxDecomposition(reference, front)
    beta = 1.0
    optimistic = mean - math.sqrt(beta) * stddev

    figure = Figure(figsize=(10.0, 9.4))
    panels = figure.subplots(2, 2).ravel()
    _draw_models(panels[0], models, x, front, candidate[0, 0])

    expected = np.exp(ExpectedHypervolumeImprovement(models, boxes).log_value(candidate))[0]
    panels[1].set_title(rf"(b) EHVI: the mean over all outcomes, $\alpha$ = {expected:.2f}")
    _show_front(panels[1], front, reference)
    outcome = mean + np.array([-1.6, -0.3]) * stddev
    _shade_improvement(panels[1], front, outcome, reference)
    _show_prediction(panels[1], mean, stddev, shaded=True)
    panels[1].plot(*outcome, "o", color="white", markeredgecolor="black", markersize=6)
    panels[1].annotate(
        "one outcome",
        (outcome[0], outcome[1]),
        (0.5, 1.1),
        arrowprops={"arrowstyle": "-", "color": "#333333"},
    )

    alpha = UpperConfidenceBoundHypervolumeImprovement(models, boxes, beta)
    value = np.exp(alpha.log_value(candidate))[0]
    panels[2].set_title(rf"(c) UCB-HVI: an optimistic outcome, $\beta$ = 1, $\alpha$ = {value:.2f}")
    _show_front(panels[2], front, reference)
    _shade_improvement(panels[2], front, optimistic, reference)
    _show_prediction(panels[2], mean, stddev)
    _show_optimistic(panels[2], mean, optimistic)

    lower, upper = np.array([0.6, 1.0]), np.array([5.6, 8.0])
    truncated = UpperConfidenceBoundHypervolumeImprovement(
        models, BoxDecomposition(upper, front), beta, (lower, upper)
    )
    value = np.exp(truncated.log_value(candidate))[0]
    panels[3].set_title(
        rf"(d) truncated UCB-HVI: only inside $\mathcal{{T}}$, $\alpha$ = {value:.2f}"
    )
    _objective_axes(panels[3])
    inside = pareto_front(front, upper)
    _shade_dominated(panels[3], inside, upper, BLUE)
    _shade_improvement(panels[3], inside, optimistic, upper)
    _shade_outside(panels[3], lower, upper)
    _mark_front(panels[3], front, upper, r"$\mathbf{r} = \mathbf{B}$")
    panels[3].plot(*lower, "*", color="black", markersize=11)
    panels[3].text(lower[0] + 0.25, lower[1] - 0.55, r"$\mathbf{A}$")
    _show_prediction(panels[3], mean, stddev)
    _show_optimistic(panels[3], mean, optimistic)
    return figure


def _draw_models(
    axes: Axes, models: list[GaussianProcess], x: FloatArray, y: FloatArray, candidate: float
) -> None:
    grid = np.linspace(-1.0, 1.0, 201)[:, None]
    axes.set_title("(a) one Gaussian process for each objective")
    for j, (model, color) in enumerate(zip(models, (BLUE, RED), strict=True)):
        mean, stddev = model.predict(grid)
        axes.fill_between(
            grid[:, 0], mean - stddev, mean + stddev, color=color, alpha=0.2, linewidth=0.0
        )
        label = rf"$\mu_{j + 1} \pm \sigma_{j + 1}$"
        axes.plot(grid, mean, color=color, linestyle=("-", "--")[j], label=label)
        axes.plot(x[:, 0], y[:, j], ("o", "s")[j], color=color)
        at = float(model.predict(np.array([[candidate]]))[0][0])
        axes.plot(candidate, at, "x", color="black", markersize=8, markeredgewidth=2)
    axes.axvline(candidate, color=GREY, linestyle=":")
    axes.text(candidate + 0.03, 0.3, r"candidate $\mathbf{x}$")
    axes.set(xlim=(-1.02, 1.02), xlabel="variable, normalised", xticks=np.linspace(-1.0, 1.0, 5))
    axes.set(ylim=(0.0, 11.0), ylabel="objectives", box_aspect=1.0)
    axes.legend(loc="upper center", ncols=2, fontsize=11)


def _show_front(axes: Axes, front: FloatArray, reference: FloatArray) -> None:
    _objective_axes(axes)
    _shade_dominated(axes, front, reference, BLUE)
    _mark_front(axes, front, reference)


def _show_prediction(
    axes: Axes, mean: FloatArray, stddev: FloatArray, shaded: bool = False
) -> None:
    """Draw the predicted distribution: outlines at one and two standard deviations."""
    angle = np.linspace(0.0, 2.0 * np.pi, 181)
    for radius in (1.0, 2.0):
        x, y = mean[:, None] + radius * stddev[:, None] * np.stack([np.cos(angle), np.sin(angle)])
        if shaded:
            axes.fill(x, y, color=ORANGE, alpha=0.25, linewidth=0.0)
        axes.plot(x, y, color=ORANGE, linewidth=1.2)
    axes.plot(*mean, "x", color="black", markersize=8, markeredgewidth=2)


def _show_optimistic(axes: Axes, mean: FloatArray, optimistic: FloatArray) -> None:
    axes.plot(*zip(mean, optimistic, strict=True), color="black", linewidth=1.0)
    axes.plot(*optimistic, "D", color="white", markeredgecolor="black", markersize=6)
    axes.annotate(
        r"$\mu - \sqrt{\beta}\,\sigma$",
        (optimistic[0], optimistic[1]),
        (optimistic[0] - 2.5, optimistic[1] - 1.1),
        arrowprops={"arrowstyle": "-", "color": "#333333"},
    )


def _shade_outside(axes: Axes, lower: FloatArray, upper: FloatArray) -> None:
    """Shade the region outside the truncation box, and outline the box."""
    far = 20.0
    for low, high in (
        ((-far, -far), (lower[0], far)),
        ((upper[0], -far), (far, far)),
        ((lower[0], -far), (upper[0], lower[1])),
        ((lower[0], upper[1]), (upper[0], far)),
    ):
        _rectangle(axes, np.array(low), np.array(high), facecolor="#D9D9D9", edgecolor="none")
    _rectangle(axes, lower, upper, facecolor="none", edgecolor="#555555")
    axes.text(upper[0] - 0.6, upper[1] - 0.7, r"$\mathcal{T}$", fontsize=14)


# ---------------------------------------------------------------- shared by the panels


def _objective_axes(axes: Axes) -> None:
    axes.set(xlim=(0.0, 9.6), ylim=(0.0, 9.6), xlabel="$f_1$ (minimised)")
    axes.set(ylabel="$f_2$ (minimised)", aspect="equal")


def _rectangle(axes: Axes, lower: FloatArray, upper: FloatArray, **style: Any) -> None:
    axes.add_patch(Rectangle((lower[0], lower[1]), *(upper - lower), **style))


def _staircase(front: FloatArray, reference: FloatArray) -> FloatArray:
    """Return the outline of the dominated region of two objectives, without its closing corner."""
    front = front[np.argsort(front[:, 0])]
    corners = [[front[0, 0], reference[1]]]
    for i, (x, y) in enumerate(front):
        after = front[i + 1, 0] if i + 1 < len(front) else reference[0]
        corners += [[x, y], [after, y]]
    return np.array(corners)


def _shade_dominated(axes: Axes, front: FloatArray, reference: FloatArray, color: str) -> None:
    outline = np.vstack([_staircase(front, reference), reference])
    axes.fill(*outline.T, color=color, alpha=0.22, linewidth=0.0)
    axes.plot(*outline[:-1].T, color=color, linewidth=1.3)


def _shade_improvement(axes: Axes, front: FloatArray, y: FloatArray, reference: FloatArray) -> None:
    """Shade the region dominated by y but not by the front, box by box."""
    for lower, upper in _corners(BoxDecomposition(reference, front)):
        inside = np.maximum(lower, y)
        if (inside < upper).all():
            _rectangle(axes, inside, upper, facecolor=GREEN, alpha=0.5, edgecolor="none")


def _mark_front(
    axes: Axes, front: FloatArray, reference: FloatArray, name: str = r"$\mathbf{r}$"
) -> None:
    axes.plot(*front.T, "o", color=BLUE, markersize=6, zorder=4)
    axes.plot(*reference, "*", color="black", markersize=11, zorder=4)
    axes.text(reference[0] - 0.15, reference[1] + 0.12, name, ha="right")


def _mark_candidate(axes: Axes, y: FloatArray, name: str) -> None:
    axes.plot(*y, "D", color="white", markeredgecolor="black", markersize=7, zorder=4)
    axes.text(y[0] - 0.25, y[1] - 0.15, name, ha="right", va="top", fontsize=12)

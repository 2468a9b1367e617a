"""An experiment of the paper: the runs it needs, what is compared with the paper's claims, and the picture."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from experiments.campaign import PlannedRun, Results, Size
from mobo_tuner.core.arrays import FloatArray

STYLE: dict[Any, Any] = {
    "figure.dpi": 110,
    "figure.constrained_layout.use": True,
    "font.size": 10,
    "axes.titlesize": 10.5,
    "axes.titlelocation": "left",
    "axes.titlepad": 8.0,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
}


class Row(NamedTuple):
    """One line of the comparison: the quantity, the paper's value and ours, as text."""

    quantity: str
    paper: str
    ours: str


@dataclass(frozen=True)
class Experiment:
    """An experiment of the paper.

    Attributes:
        caption: What the picture shows.
        plan: Function from the size to the runs, those that tell most first.
        compare: Function from the results to the lines of the comparison; cases without runs are left out.
        draw: Function from the results to the picture in the paper's layout.
    """

    caption: str
    plan: Callable[[Size], list[PlannedRun]]
    compare: Callable[[Results], list[Row]]
    draw: Callable[[Results], Figure]


def runs(number: int) -> str:
    """Return a number of runs as text."""
    return f"{number} run" + "s" * (number > 1)


def mean_and_spread(values: FloatArray, digits: int = 2) -> str:
    """Return mean, standard deviation and number of values `(r,)` as text."""
    return f"{with_spread(values, digits)} ({runs(len(values))})"


def with_spread(values: FloatArray, digits: int) -> str:
    """Return mean and standard deviation of values `(r,)` as text; of one value no standard deviation."""
    mean = f"{values.mean():.{digits}f}"
    return mean if len(values) == 1 else f"{mean} ± {values.std(ddof=1):.{digits}f}"


def draw_curves(axes: Axes, curves: FloatArray, label: str, color: str, **line: Any) -> None:
    """Draw the mean of curves `(r, n)` against the number of evaluations, and one sigma as shading.

    Args:
        axes: Axes.
        curves: Curves; nothing is drawn if there are none.
        label: Label in the legend, to which the number of runs is added.
        color: Colour.
        line: Properties of the line.
    """
    if not len(curves):
        return
    n = np.arange(1, curves.shape[1] + 1)
    mean, spread = curves.mean(axis=0), curves.std(axis=0, ddof=min(len(curves) - 1, 1))
    axes.plot(n, mean, color=color, label=f"{label} ({runs(len(curves))})", **line)
    axes.fill_between(n, mean - spread, mean + spread, color=color, alpha=0.2, linewidth=0.0)


def draw_front(axes: Axes, points: FloatArray, color: str, label: str, **line: Any) -> None:
    """Draw the front of points `(n, 2)`, both axes minimised, as stairs with dots."""
    front = projected_front(points)
    axes.step(*front.T, where="post", color=color, label=label, marker="o", markersize=3, **line)


def projected_front(points: FloatArray) -> FloatArray:
    """Return the non-dominated ones of points `(n, 2)`, by their first coordinate."""
    ordered = points[np.lexsort((points[:, 1], points[:, 0]))]
    lowest = np.minimum.accumulate(ordered[:, 1])
    new = np.append(True, ordered[1:, 1] < lowest[:-1])
    return np.asarray(ordered[new])

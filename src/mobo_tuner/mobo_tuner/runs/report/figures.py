"""The pictures of a report."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PathCollection
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from mobo_tuner.core.conflict import conflicting_pair
from mobo_tuner.core.pareto import is_nondominated
from mobo_tuner.core.problem import Array, Objective
from mobo_tuner.core.units import product_of_units
from mobo_tuner.files import replace_file
from mobo_tuner.runs.recorded_run import BoolArray, RecordedRun
from mobo_tuner.wording import counted

# Told apart by the colour-blind, too: after Okabe and Ito.
_BLUE, _ORANGE, _RED, _GREY = "#0072B2", "#E69F00", "#D55E00", "#8C8C8C"
_STYLE: dict[Any, Any] = {
    "figure.figsize": (8.0, 5.0),
    "figure.dpi": 150,
    "figure.constrained_layout.use": True,
    "font.size": 11,
    "axes.titlesize": 12,
    "axes.titlelocation": "left",
    "axes.titlepad": 10.0,
    "axes.formatter.use_mathtext": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#E6E6E6",
    "axes.axisbelow": True,
    "legend.frameon": False,
    "legend.fontsize": 9.5,
}


def write_figure(figure: Figure, path: Path) -> None:
    """Write a figure as PNG, whole or not at all.

    Raises:
        OSError: If it cannot be written.
    """
    buffer = BytesIO()
    with rc_context(_STYLE):
        FigureCanvasAgg(figure)
        figure.savefig(buffer, format="png")
    replace_file(path, buffer.getvalue())


def hypervolume_figure(run: RecordedRun) -> Figure:
    """Plot the hypervolume over the evaluations, with the initial design shaded and failures marked."""
    with rc_context(_STYLE):
        figure = Figure()
        axes = figure.subplots()
        axes.set_title(f"run {run.run_id}: {counted(len(run.indices), 'evaluation')}")
        unit = product_of_units([o.unit for o in run.problem.objectives])
        axes.set_ylabel(f"hypervolume [{unit}]" if unit else "hypervolume")
        axes.set_xlabel("index of the evaluation")
        axes.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
        if not len(run.indices):
            _say(axes, "no evaluation")
            return figure
        x, y = run.indices, run.hypervolumes
        if run.initial.any():
            end = x[run.initial].max() + 0.5
            axes.axvspan(-0.5, end, color="#F0F0F0", zorder=0, label="initial design")
        axes.step(x, y, where="post", color=_BLUE, linewidth=2.0)
        grew = np.diff(y, prepend=0.0) > 0.0
        for kind, marker, color, size, label in (
            (grew, "o", _BLUE, 22, "front grew"),
            (run.valid & run.cheaper, "s", _GREY, 14, "lower fidelity"),
            (run.infeasible, "x", _ORANGE, 32, "infeasible"),
            (run.failed, "X", _RED, 48, "failed"),
        ):
            if kind.any():
                axes.scatter(
                    x[kind],
                    y[kind],
                    s=size,
                    c=color,
                    marker=marker,
                    label=label,
                    zorder=3,
                    clip_on=False,
                )
        axes.set_xlim(-0.5, max(x[-1] + 0.5, 1.0))
        top = np.nanmax(y, initial=0.0)
        axes.set_ylim(0.0, 1.08 * top if top > 0.0 else 1.0)
        _legend(axes)
        return figure


def front_figure(run: RecordedRun) -> Figure:
    """All evaluations and the front, in the plane of two objectives.

    The plane is that of the two objectives that conflict most, see `conflicting_pair`. A single
    objective is shown over the evaluations.
    """
    with rc_context(_STYLE):
        figure = Figure()
        axes = figure.subplots()
        if len(run.problem.objectives) == 1:
            _draw_single(axes, run)
        else:
            points = _draw_plane(axes, run)
            if points is not None:
                bar = figure.colorbar(points, ax=axes, pad=0.02, label="index of the evaluation")
                bar.locator = MaxNLocator(integer=True)
                bar.outline.set_visible(False)
        _legend(axes)
        return figure


def staircase(points: Array, reference: Array) -> Array:
    """Return the border of the area that points of a plane dominate, as a line.

    Args:
        points: Minimised non-dominated points ``(k, 2)``.
        reference: End of the border on either side ``(2,)``.

    Returns:
        The corners in order, shape ``(2 k + 1, 2)``.
    """
    points = points[np.argsort(points[:, 0])]
    x = np.append(points[:, 0], max(reference[0], points[-1, 0]))
    y = np.append(max(reference[1], points[0, 1]), points[:, 1])
    return np.column_stack([np.repeat(x, 2)[:-1], np.repeat(y, 2)[1:]])


def _draw_single(axes: Axes, run: RecordedRun) -> None:
    (objective,) = run.problem.objectives
    axes.set_title(f"run {run.run_id}: best value so far")
    axes.set_xlabel("index of the evaluation")
    axes.set_ylabel(_label(objective))
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    values, sign = run.objectives[:, 0], objective.sign
    if not run.valid.any():
        _say(axes, "no evaluation to show")
        return
    feasible = run.feasible
    axes.scatter(run.indices[feasible], values[feasible], color=_BLUE, s=18, label="feasible")
    _draw_outside_the_front(axes, run, run.indices.astype(float), values, run.valid)
    if feasible.any():
        best = sign * np.minimum.accumulate(np.where(feasible, sign * values, np.inf))
        known = np.isfinite(best)
        axes.step(run.indices[known], best[known], where="post", color=_BLUE, label="best so far")
    axes.axhline(objective.reference, color=_GREY, linestyle="--", label="reference")


def _draw_plane(axes: Axes, run: RecordedRun) -> PathCollection | None:
    """Draw two objectives; return the points that carry the colour of their index, if any."""
    names = run.problem.objective_names
    signs_of_all = np.array([objective.sign for objective in run.problem.objectives])
    columns = list(conflicting_pair(run.front_objectives * signs_of_all))
    across, up = (run.problem.objectives[column] for column in columns)
    axes.set_title(f"run {run.run_id}: {counted(len(run.front), 'point')} on the Pareto front")
    axes.set_xlabel(_label(across))
    axes.set_ylabel(_label(up))
    xy = run.objectives[:, columns]
    measured = run.valid & np.isfinite(xy).all(axis=1)
    if not measured.any():
        _say(axes, "no evaluation to show")
        return None
    signs = np.array([across.sign, up.sign])
    reference = np.array([across.reference, up.reference])
    _draw_limits(axes, run, across, up)
    feasible = measured & run.feasible
    _draw_outside_the_front(axes, run, xy[:, 0], xy[:, 1], measured)
    points = axes.scatter(
        xy[feasible, 0],
        xy[feasible, 1],
        c=run.indices[feasible],
        cmap="viridis",
        s=24,
        alpha=0.55,
        linewidths=0,
    )
    points.set_clim(0, max(run.indices[-1], 1))
    front = run.front_objectives[:, columns]
    if len(front):
        projected = front[is_nondominated(front * signs)]
        steps = staircase(projected * signs, reference * signs) * signs
        axes.plot(
            steps[:, 0],
            steps[:, 1],
            color=_BLUE,
            linewidth=1.8,
            label="front of these two" if len(names) > 2 else "front",
            zorder=2,
        )
        axes.scatter(
            front[:, 0],
            front[:, 1],
            facecolors="none",
            edgecolors="black",
            s=46,
            linewidths=1.0,
            zorder=3,
            label=f"front of all {len(names)}" if len(names) > 2 else None,
        )
    _set_view(axes, xy, measured, np.vstack([front, reference]))
    return points if feasible.any() else None


def _draw_limits(axes: Axes, run: RecordedRun, across: Objective, up: Objective) -> None:
    for objective, line in ((across, axes.axvline), (up, axes.axhline)):
        label = "reference" if objective is across else None
        line(objective.reference, color=_GREY, linestyle="--", linewidth=1.2, label=label)
        for constraint in run.problem.constraints:
            if constraint.name == objective.name:
                for limit in (constraint.minimum, constraint.maximum):
                    if np.isfinite(limit):
                        line(limit, color=_RED, linewidth=1.2, label=f"limit of {objective.name}")


def _set_view(axes: Axes, xy: Array, measured: BoolArray, needed: Array) -> None:
    """Show what is needed and the bulk of the rest; count what lies outside."""
    low, high = np.percentile(xy[measured], [5.0, 80.0], axis=0)
    low, high = np.minimum(low, needed.min(axis=0)), np.maximum(high, needed.max(axis=0))
    margin = 0.05 * np.where(high > low, high - low, 1.0)
    low, high = low - margin, high + margin
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    outside = int(np.count_nonzero((measured[:, None] & ((xy < low) | (xy > high))).any(axis=1)))
    if outside:
        axes.annotate(
            f"{outside} more outside",
            (1.0, 1.01),
            xycoords="axes fraction",
            ha="right",
            color=_GREY,
            fontsize=9,
        )


def _draw_outside_the_front(
    axes: Axes, run: RecordedRun, x: Array, y: Array, measured: BoolArray
) -> None:
    """Draw what can never be on the front: evaluations of a lower fidelity, and infeasible ones."""
    for kind, marker, color, size, label in (
        (run.cheaper, "s", _GREY, 14, "lower fidelity"),
        (run.infeasible, "x", _ORANGE, 30, "infeasible"),
    ):
        rows = measured & kind
        if rows.any():
            axes.scatter(x[rows], y[rows], marker=marker, color=color, s=size, label=label)


def _label(objective: Objective) -> str:
    unit = f" [{objective.unit}]" if objective.unit else ""
    direction = ", maximised" if objective.direction == "maximize" else ""
    return f"{objective.name}{unit}{direction}"


def _legend(axes: Axes) -> None:
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc="best")


def _say(axes: Axes, text: str) -> None:
    axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center", va="center", color=_GREY)

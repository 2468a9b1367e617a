"""Plots of what was found, as options of Apache ECharts.

Every plot always has the same series, so that the browser updates it in place. Points carry the index of their
evaluation as their third value. Tooltips are drawn on the canvas, where text is never read as HTML.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np

from mobo_tuner.client import Evaluation, Point
from mobo_tuner.core.problem import Objective, Problem, Variable
from mobo_tuner.core.units import spans_decades
from mobo_tuner.displays.evaluations import Number
from mobo_tuner.displays.settings import labelled
from mobo_tuner.page.board import RunBoard
from mobo_tuner.page.chart_parts import (
    FONT,
    NUMBER,
    Colours,
    Options,
    axis,
    bounds_of,
    choice_labels,
    curve,
    finite,
    legend,
    marks,
    options,
    scatter,
    thinned,
)
from mobo_tuner.page.words import measured, set_to

MAX_LINES = 150  # of the parallel coordinates
FAINT: Options = {"itemStyle": {"opacity": 0.15}}
PALETTE = ("#56b4e9", "#e69f00", "#009e73", "#cc79a7", "#d55e00", "#0072b2", "#8a94a3")
"""Colours of several runs, of Okabe and Ito."""


def front(
    run: RunBoard,
    x: str,
    y: str,
    chosen: int | None,
    colours: Colours,
    wanted: Callable[[Point], bool] = lambda _: True,
) -> Options:
    """Return the plot of two objectives: all evaluations, the front, the reference point, the box.

    Args:
        run: Run to show.
        x: Objective of the horizontal axis.
        y: Objective of the vertical axis.
        chosen: Index of the chosen point of the front.
        colours: Colours of the plot.
        wanted: Function that says whether a point of the front is shown clearly.
    """
    problem = run.problem
    assert problem is not None
    objectives = {o.name: o for o in problem.objectives}
    points = run.front.points if run.front is not None else ()
    on_front = [point.index for point in points if point.index is not None]
    evaluations = run.evaluations
    across, up = evaluations.objectives(x), evaluations.objectives(y)
    valid, feasible = evaluations.numbers("valid") > 0.0, run.is_feasible
    drawable = np.isfinite(across) & np.isfinite(up)
    drawable &= ~np.isin(evaluations.numbers("index"), on_front)
    is_other = drawable & valid & feasible
    groups = [
        np.flatnonzero(group).tolist()
        for group in (is_other, drawable & valid & ~feasible, drawable & ~valid)
    ]

    def places(positions: Iterable[int]) -> list[Options]:
        return [_evaluated(evaluations[i], x, y, problem) for i in positions]

    others, infeasible, failed = (places(thinned(group)) for group in groups)
    drawn = [
        (_front_point(p, x, y, problem) | ({} if wanted(p) else FAINT), _guessed(p, x, y))
        for p in points
    ]
    measured_points = [point for point, is_guessed in drawn if not is_guessed]
    guessed = [point for point, is_guessed in drawn if is_guessed]
    end = len(evaluations) - 1
    last = places([end] if end >= 0 and math.isfinite(across[end] + up[end]) else [])
    ring = [p for p in (*measured_points, *guessed) if p["value"][2] == chosen]
    ring += places(i for i in groups[0] if i == evaluations.position(chosen))
    shown = {"model": guessed, "feasible": others, "infeasible": infeasible, "failed": failed}
    used = [p["value"] for p in (*measured_points, *guessed, *last)]
    used += zip(across[is_other].tolist(), up[is_other].tolist(), strict=True)
    used = used or [p["value"] for p in (*infeasible, *failed)]
    return options(
        colours,
        grid=[{"left": 62, "right": 20, "top": 42, "bottom": 46}],
        legend=legend(
            colours, ["front", *(name for name, group in shown.items() if group), "last"]
        ),
        xAxis=[_objective_axis(objectives[x], [value[0] for value in used], colours, 28)],
        yAxis=[_objective_axis(objectives[y], [value[1] for value in used], colours, 46)],
        series=[
            scatter("feasible", others, "circle", 6, colours.others, opacity=0.75),
            scatter("infeasible", infeasible, "triangle", 9, colours.infeasible),
            scatter("failed", failed, "path://M0,0L8,8M8,0L0,8", 9, colours.failed, line=2),
            scatter("model", guessed, "emptyCircle", 13, colours.front, line=2),
            {
                **scatter("front", measured_points, "circle", 14, colours.front),
                "z": 4,
                "markLine": marks(_straight_lines(problem, x, y, colours), colours),
                "markArea": _box(objectives[x], objectives[y], colours),
            },
            {**scatter("last", last, "diamond", 16, colours.last, line=2), "z": 5},
            {**scatter("chosen", ring, "emptyCircle", 24, colours.chosen, line=3), "z": 6},
        ],
    )


def hypervolume(run: RunBoard, colours: Colours) -> Options:
    """Return the plot of the hypervolume over the evaluations."""
    modelled, plain = _course(run, "hypervolume"), _course(run, "hypervolume_measured")
    plot = options(
        colours,
        grid=[{"left": 62, "right": 20, "top": 42, "bottom": 46}],
        legend=legend(colours, ["hypervolume", "of the readings as they are"], lines=True),
        xAxis=[axis("evaluations", colours, 28, min=0, minInterval=1)],
        yAxis=[axis("hypervolume", colours, 46, splitNumber=2)],
        series=[
            curve("of the readings as they are", plain, colours.others, dashed=True),
            {
                **curve("hypervolume", modelled, colours.front, width=3),
                "markLine": marks([{"xAxis": count} for count in run.changes], colours)
                | {"label": {"formatter": "changed", "color": colours.text}},
            },
        ],
    )
    plot["tooltip"] |= {"trigger": "axis"}
    del plot["tooltip"]["formatter"]
    return plot


def compared(runs: Sequence[RunBoard], colours: Colours) -> Options:
    """Return the hypervolumes of several runs over their evaluations, on one plot."""
    names = [run.run_id for run in runs]
    lines = [
        curve(
            run.run_id,
            _course(run, "hypervolume"),
            PALETTE[i % len(PALETTE)],
            width=3,
            dashed=i % 2 == 1,  # a run that continues another one has its line, to begin with
        )
        for i, run in enumerate(runs)
    ]
    plot = options(
        colours,
        grid=[{"left": 62, "right": 20, "top": 42, "bottom": 46}],
        legend=legend(colours, names, lines=True),
        xAxis=[axis("evaluations", colours, 28, min=0, minInterval=1)],
        yAxis=[axis("hypervolume", colours, 46)],
        series=lines,
    )
    plot["tooltip"] |= {"trigger": "axis"}
    del plot["tooltip"]["formatter"]
    return plot


def _course(run: RunBoard, field: Number) -> list[list[float | None]]:
    """Return a field of the evaluations over their number."""
    counts, values = (run.evaluations.numbers(name).tolist() for name in ("index", field))
    pairs = zip(thinned(counts), thinned(values), strict=True)
    return [[int(index) + 1, finite(value)] for index, value in pairs]


def parallel(run: RunBoard, chosen: int | None, colours: Colours) -> Options:
    """Return the parallel coordinates of the front: all objectives, then all variables that are not fixed."""
    problem = run.problem
    assert problem is not None
    points = run.front.points[:MAX_LINES] if run.front is not None else ()
    variables = [v for v in problem.variables if v.fixed is None]
    axes = [
        *(
            _parallel_axis(i, o.name, o.unit, colours)
            | _scale_of([p.objectives.get(o.name, math.nan) for p in points])
            for i, o in enumerate(problem.objectives)
        ),
        *(
            _bounded(_parallel_axis(i, v.name, v.unit, colours), v, points)
            for i, v in enumerate(variables, start=len(problem.objectives))
        ),
    ]

    def line(point: Point) -> Options:
        values = [*(point.objectives.get(o.name, math.nan) for o in problem.objectives)]
        values += [v.rank(point.setpoint.get(v.name, math.nan)) for v in variables]
        return {"name": f"#{point.index}", "value": [finite(value) for value in values]}

    style = {"width": 1.5, "opacity": 0.55, "color": colours.front}
    ring = {"width": 4, "opacity": 1.0, "color": colours.chosen}
    return {
        "animation": False,
        "backgroundColor": "transparent",
        "parallel": {"left": 48, "right": 48, "top": 50, "bottom": 16},
        "parallelAxis": axes,
        "series": [
            {
                "type": "parallel",
                "lineStyle": style,
                "inactiveOpacity": 0.06,
                "data": [line(p) for p in points],
            },
            {
                "type": "parallel",
                "lineStyle": ring,
                "data": [line(p) for p in points if p.index == chosen],
            },
        ],
    }


def _objective_axis(
    objective: Objective, values: Sequence[float | None], colours: Colours, gap: int
) -> Options:
    """Return an axis that shows the points and the reference, whatever lies far out."""
    arrow = "less is better" if objective.sign > 0 else "more is better"
    name = f"{labelled(objective.name, objective.unit)}, {arrow}"
    known = [v for v in (*values, objective.reference) if v is not None and math.isfinite(v)]
    low, high = min(known, default=0.0), max(known, default=1.0)
    if spans_decades([v for v in values if v is not None]) and low > 0.0:
        least, most = math.floor(math.log10(low)), math.ceil(math.log10(high))
        return axis(name, colours, gap, type="log", min=10.0**least, max=10.0**most)
    margin = 0.06 * (high - low) or 0.06 * abs(high) or 1.0
    return axis(
        name,
        colours,
        gap,
        bare_ends=True,
        min=_rounded(low - margin, margin),
        max=_rounded(high + margin, margin),
    )


def _rounded(value: float, margin: float) -> float:
    """Return a value with no more digits than an axis needs."""
    return round(value, max(1 - math.floor(math.log10(margin)), 0))


def _parallel_axis(position: int, name: str, unit: str, colours: Colours) -> Options:
    return {
        "dim": position,
        "id": name,
        "name": f"{name}\n[{unit}]" if unit else name,
        "scale": True,
        "nameTextStyle": {
            "color": colours.text,
            "fontSize": 14,
            "lineHeight": 17,
            "fontFamily": FONT,
        },
        "axisLabel": {
            "color": colours.text,
            "fontSize": 12,
            "fontFamily": FONT,
            "hideOverlap": True,
            "textBorderColor": colours.card,  # the lines of the points run through the labels
            "textBorderWidth": 4,
            ":formatter": NUMBER,
        },
        "axisLine": {"lineStyle": {"color": colours.faint}},
        "splitNumber": 3,
    }


def _scale_of(values: Sequence[float]) -> Options:
    """Return what the axis of measured values needs if they span decades."""
    return {"type": "log"} if spans_decades(values) else {}


def _bounded(axis: Options, variable: Variable, points: Sequence[Point]) -> Options:
    """Return an axis that ends at the bounds of a variable, or at points outside of bounds that were changed."""
    if variable.choice_names:
        return axis | choice_labels(variable, axis["axisLabel"])
    values = [point.setpoint[variable.name] for point in points if variable.name in point.setpoint]
    bounds = bounds_of(variable, values)
    axis["axisLabel"]["customValues"] = bounds["axisTick"]["customValues"]
    return axis | bounds


def _straight_lines(problem: Problem, x: str, y: str, colours: Colours) -> list[Options]:
    """Return the reference (dashed) and the limits (solid) of two objectives."""
    references = {o.name: o.reference for o in problem.objectives}
    lines: list[Options] = []
    for side, name in (("xAxis", x), ("yAxis", y)):
        if math.isfinite(references[name]):
            lines.append({side: references[name]})
        for constraint in problem.constraints:
            ends = (constraint.minimum, constraint.maximum) if constraint.name == name else ()
            style = {"color": colours.failed, "type": "solid"}
            lines += [{side: end, "lineStyle": style} for end in ends if math.isfinite(end)]
    return lines


def _box(x: Objective, y: Objective, colours: Colours) -> Options:
    """Return the truncation box, as far as it is bounded in these two objectives."""
    corners: list[Options] = [{}, {}]
    for side, objective in (("xAxis", x), ("yAxis", y)):
        if objective.truncation is not None:
            for corner, limit in zip(corners, objective.truncation, strict=True):
                if math.isfinite(limit):
                    corner[side] = limit
    style = {"color": colours.front, "opacity": 0.08}
    return {"silent": True, "itemStyle": style, "data": [corners] if any(corners) else []}


def _evaluated(evaluation: Evaluation, x: str, y: str, problem: Problem) -> Options:
    """Return an evaluation as a point."""
    values = [evaluation.objectives[name] for name in (x, y)]
    lines = [f"evaluation {evaluation.index}", *setpoint_lines(evaluation.setpoint, problem)]
    return {"name": "\n".join(lines), "value": [*values, evaluation.index]}


def setpoint_lines(setpoint: Mapping[str, float], problem: Problem) -> list[str]:
    """Return a set-point, a line for each variable of the problem."""
    return [
        f"{v.name} {set_to(v, setpoint[v.name])}" for v in problem.variables if v.name in setpoint
    ]


def _front_point(point: Point, x: str, y: str, problem: Problem) -> Options:
    units = problem.units
    lines = [f"evaluation {point.index}, on the front"]
    for name, value in point.objectives.items():
        spread = point.stddevs.get(name, math.nan)
        lines.append(f"{name}  {measured(value, spread, units.get(name, ''))}")
    lines += setpoint_lines(point.setpoint, problem)
    values = [point.objectives.get(x, math.nan), point.objectives.get(y, math.nan)]
    return {"name": "\n".join(lines), "value": [*map(finite, values), point.index]}


def _guessed(point: Point, x: str, y: str) -> bool:
    """Return whether one of the objectives was not measured there."""
    return bool({x, y} & {*point.predicted})

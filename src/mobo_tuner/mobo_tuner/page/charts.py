"""Plots of a run, as options of Apache ECharts.

Every plot always has the same series, so that the browser updates it in place. Points carry the index of their
evaluation as their third value. Tooltips are drawn on the canvas, where text is never read as HTML.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from mobo_tuner.client import Evaluation, Point
from mobo_tuner.core.problem import Objective, Problem, Variable
from mobo_tuner.displays.settings import labelled
from mobo_tuner.page.board import RunBoard
from mobo_tuner.page.words import measured, number, quantity

MAX_POINTS = 600  # of a series; more are thinned out
FONT = "Roboto, sans-serif"
MAX_LINES = 150  # of the parallel coordinates

Options = dict[str, Any]


@dataclass(frozen=True)
class Colours:
    """Colours of a plot, from the palette of Okabe and Ito, which the colour-blind can tell apart."""

    text: str
    faint: str
    grid: str
    front: str
    others: str
    infeasible: str
    failed: str
    last: str
    chosen: str


DARK = Colours(
    text="#e6e9ef",
    faint="#a3acba",
    grid="#333c4a",
    front="#56b4e9",
    others="#8a94a3",
    infeasible="#e69f00",
    failed="#ff7a33",
    last="#f0e442",
    chosen="#ffffff",
)
LIGHT = Colours(
    text="#1b2330",
    faint="#525c6b",
    grid="#dde2e9",
    front="#0072b2",
    others="#7d8796",
    infeasible="#b87a00",
    failed="#c24e00",
    last="#9a6a00",
    chosen="#000000",
)


def front(run: RunBoard, x: str, y: str, chosen: int | None, colours: Colours) -> Options:
    """Return the plot of two objectives: all evaluations, the front, the reference point, the box.

    Args:
        run: Run to show.
        x: Objective of the horizontal axis.
        y: Objective of the vertical axis.
        chosen: Index of the chosen point of the front.
        colours: Colours of the plot.
    """
    problem = run.problem
    assert problem is not None
    objectives = {o.name: o for o in problem.objectives}
    points = run.front.points if run.front is not None else ()
    on_front = {point.index for point in points}
    others: list[Options] = []
    infeasible: list[Options] = []
    failed: list[Options] = []
    for evaluation in run.evaluations:
        if evaluation.index in on_front:
            continue
        place = _place(evaluation, x, y)
        if place is not None:
            group = (
                failed if not evaluation.valid else others if evaluation.feasible else infeasible
            )
            group.append(place)
    measured_points = [_front_point(p, x, y, problem) for p in points if not _guessed(p, x, y)]
    guessed = [_front_point(p, x, y, problem) for p in points if _guessed(p, x, y)]
    last = [p for p in [_place(e, x, y) for e in run.evaluations[-1:]] if p is not None]
    ring = [p for p in (*measured_points, *guessed) if p["value"][2] == chosen]
    used = [*measured_points, *guessed, *others, *last] or [*infeasible, *failed]
    return _options(
        colours,
        grid=[{"left": 62, "right": 20, "top": 42, "bottom": 46}],
        legend=_legend(colours, ["front", "model", "feasible", "infeasible", "failed", "last"]),
        xAxis=[_objective_axis(objectives[x], [p["value"][0] for p in used], colours, 28)],
        yAxis=[_objective_axis(objectives[y], [p["value"][1] for p in used], colours, 46)],
        series=[
            _scatter("feasible", _thin(others), "circle", 6, colours.others, opacity=0.75),
            _scatter("infeasible", _thin(infeasible), "triangle", 9, colours.infeasible),
            _scatter("failed", _thin(failed), "path://M0,0L8,8M8,0L0,8", 9, colours.failed, line=2),
            _scatter("model", guessed, "emptyCircle", 13, colours.front, line=2),
            {
                **_scatter("front", measured_points, "circle", 14, colours.front),
                "z": 4,
                "markLine": _lines(
                    [
                        {axis: objectives[name].reference}
                        for axis, name in (("xAxis", x), ("yAxis", y))
                        if math.isfinite(objectives[name].reference)
                    ],
                    colours,
                ),
                "markArea": _box(objectives[x], objectives[y], colours),
            },
            {**_scatter("last", last, "diamond", 16, colours.last, line=2), "z": 5},
            {**_scatter("chosen", ring, "emptyCircle", 24, colours.chosen, line=3), "z": 6},
        ],
    )


def hypervolume(run: RunBoard, colours: Colours) -> Options:
    """Return the plot of the hypervolume over the evaluations."""
    evaluations = _thin(run.evaluations)
    modelled = [[e.index + 1, _json(e.hypervolume)] for e in evaluations]
    plain = [[e.index + 1, _json(e.hypervolume_measured)] for e in evaluations]
    options = _options(
        colours,
        grid=[{"left": 62, "right": 20, "top": 42, "bottom": 46}],
        legend=_legend(colours, ["hypervolume", "of the readings as they are"]),
        xAxis=[_axis("evaluations", colours, 28, min=0, minInterval=1)],
        yAxis=[_axis("hypervolume", colours, 46)],
        series=[
            _line("of the readings as they are", plain, colours.others, dashed=True),
            _line("hypervolume", modelled, colours.front, width=3),
        ],
    )
    options["tooltip"] |= {"trigger": "axis"}
    del options["tooltip"]["formatter"]
    return options


def parallel(run: RunBoard, chosen: int | None, colours: Colours) -> Options:
    """Return the parallel coordinates of the front: all objectives, then all variables."""
    problem = run.problem
    assert problem is not None
    points = run.front.points[:MAX_LINES] if run.front is not None else ()
    axes = [
        *(_parallel_axis(i, o.name, o.unit, colours) for i, o in enumerate(problem.objectives)),
        *(
            _parallel_axis(i, v.name, v.unit, colours) | {"min": v.minimum, "max": v.maximum}
            for i, v in enumerate(problem.variables, start=len(problem.objectives))
        ),
    ]

    def line(point: Point) -> Options:
        values = [*(point.objectives.get(o.name, math.nan) for o in problem.objectives)]
        values += [point.setpoint.get(v.name, math.nan) for v in problem.variables]
        return {"name": f"#{point.index}", "value": [_json(value) for value in values]}

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


def variable(run: RunBoard, variable: Variable, colours: Colours) -> Options:
    """Return the plot of a variable over the evaluations, between its bounds."""
    name = variable.name
    made = [e for e in _thin(run.evaluations) if name in e.setpoint]
    bounds = [{"yAxis": variable.minimum}, {"yAxis": variable.maximum}]
    return _options(
        colours,
        title=_title(labelled(name, variable.unit), colours),
        grid=[{"left": 54, "right": 14, "top": 34, "bottom": 26}],
        xAxis=[_axis("", colours, 0, min=0, minInterval=1)],
        yAxis=[_axis("", colours, 0)],
        series=[
            {
                **_scatter(
                    "set-point",
                    [_trace(e, e.setpoint[name], variable.unit) for e in made if e.valid],
                    *("circle", 5, colours.front),
                ),
                "markLine": _lines(bounds, colours),
            },
            _scatter(
                "failed",
                [_trace(e, e.setpoint[name], variable.unit) for e in made if not e.valid],
                *("path://M0,0L8,8M8,0L0,8", 8, colours.failed),
                line=2,
            ),
        ],
    )


def diagnostic(run: RunBoard, name: str, unit: str, colours: Colours) -> Options:
    """Return the plot of a diagnostic over the evaluations, with error bars and its limits."""
    problem = run.problem
    assert problem is not None
    known = [
        (e, *e.diagnostics[name])
        for e in _thin(run.evaluations)
        if math.isfinite(e.diagnostics.get(name, (math.nan, math.nan))[0])
    ]
    bars = []
    for evaluation, mean, stddev in known:
        spread = stddev if math.isfinite(stddev) else 0.0
        bars.append([evaluation.index + 1, mean, mean, mean - spread, mean + spread])
    limits = [
        limit
        for c in problem.constraints
        if c.name == name
        for limit in (c.minimum, c.maximum)
        if math.isfinite(limit)
    ]
    return _options(
        colours,
        title=_title(labelled(name, unit), colours),
        grid=[{"left": 54, "right": 14, "top": 34, "bottom": 26}],
        xAxis=[_axis("", colours, 0, min=0, minInterval=1)],
        yAxis=[_axis("", colours, 0)],
        series=[
            {
                "type": "custom",
                "name": "standard deviation",
                "silent": True,
                "data": bars,
                "encode": {"x": 0, "y": [3, 4]},
                ":renderItem": _ERROR_BAR,
                "itemStyle": {"color": colours.others},
            },
            {
                **_scatter(
                    "feasible",
                    [_trace(e, mean, unit, stddev) for e, mean, stddev in known if e.feasible],
                    *("circle", 5, colours.front),
                ),
                "markLine": _lines([{"yAxis": limit} for limit in limits], colours),
            },
            _scatter(
                "infeasible",
                [_trace(e, mean, unit, stddev) for e, mean, stddev in known if not e.feasible],
                *("triangle", 7, colours.infeasible),
            ),
        ],
    )


_NUMBER = """(value) => Math.abs(value) >= 1e5
  ? value.toExponential().replace("e+", "e") : value.toLocaleString("en-US", {useGrouping: false})
"""
_ERROR_BAR = """(params, api) => {
  const low = api.coord([api.value(0), api.value(3)]);
  const high = api.coord([api.value(0), api.value(4)]);
  return {type: "line", shape: {x1: low[0], y1: low[1], x2: high[0], y2: high[1]},
          style: {stroke: api.visual("color"), lineWidth: 1.5}};
}"""


# ------------------------------------------------------------------ parts of options


def _options(colours: Colours, **parts: Any) -> Options:
    return {
        "animation": False,
        "backgroundColor": "transparent",
        "textStyle": {"color": colours.text, "fontFamily": FONT},
        "tooltip": {"renderMode": "richText", "confine": True, "formatter": "{b}"},
        **parts,
    }


def _legend(colours: Colours, names: Sequence[str]) -> Options:
    return {
        "data": [*names],
        "type": "scroll",
        "top": 4,
        "left": 8,
        "itemGap": 14,
        "itemWidth": 14,
        "selectedMode": False,
        "textStyle": {"color": colours.text, "fontSize": 14, "fontFamily": FONT},
    }


def _title(text: str, colours: Colours) -> Options:
    style = {"color": colours.text, "fontSize": 14, "fontWeight": "bold"}
    return {"text": text, "left": 8, "top": 6, "textStyle": style}


def _axis(name: str, colours: Colours, gap: int, **parts: Any) -> Options:
    return {
        "type": "value",
        "name": name,
        "nameLocation": "middle",
        "nameGap": gap,
        "nameTextStyle": {"color": colours.text, "fontSize": 15, "fontFamily": FONT},
        "axisLabel": {
            "color": colours.faint,
            "fontSize": 13,
            "fontFamily": FONT,
            "hideOverlap": True,
            ":formatter": _NUMBER,
        },
        "axisLine": {"onZero": False, "lineStyle": {"color": colours.faint}},
        "splitLine": {"lineStyle": {"color": colours.grid}},
        "splitNumber": 4,
        "scale": True,
        **parts,
    }


def _objective_axis(
    objective: Objective, values: Iterable[float | None], colours: Colours, gap: int
) -> Options:
    """Return an axis that shows the points and the reference, whatever lies far out."""
    arrow = "less is better" if objective.sign > 0 else "more is better"
    known = [v for v in (*values, objective.reference) if v is not None and math.isfinite(v)]
    low, high = min(known, default=0.0), max(known, default=1.0)
    margin = 0.06 * (high - low) or 0.06 * abs(high) or 1.0
    return _axis(
        f"{labelled(objective.name, objective.unit)}, {arrow}",
        colours,
        gap,
        min=_rounded(low - margin, margin),
        max=_rounded(high + margin, margin),
    )


def _rounded(value: float, margin: float) -> float:
    """Return a value with no more digits than an axis needs."""
    return round(value, max(1 - math.floor(math.log10(margin)), 0))


def _parallel_axis(position: int, name: str, unit: str, colours: Colours) -> Options:
    return {
        "dim": position,
        "name": f"{name}\n[{unit}]" if unit else name,
        "scale": True,
        "nameTextStyle": {
            "color": colours.text,
            "fontSize": 14,
            "lineHeight": 17,
            "fontFamily": FONT,
        },
        "axisLabel": {
            "color": colours.faint,
            "fontSize": 12,
            "fontFamily": FONT,
            "hideOverlap": True,
        },
        "axisLine": {"lineStyle": {"color": colours.faint}},
        "splitNumber": 3,
    }


def _scatter(
    name: str,
    data: Sequence[Any],
    symbol: str,
    size: int,
    colour: str,
    *,
    opacity: float = 1.0,
    line: int = 0,
) -> Options:
    style: Options = {"color": colour, "opacity": opacity}
    if line:
        style |= {"borderColor": colour, "borderWidth": line}
    if symbol == "emptyCircle":
        symbol, style = "circle", style | {"color": "transparent"}
    return {
        "type": "scatter",
        "name": name,
        "data": [*data],
        "symbol": symbol,
        "symbolSize": size,
        "itemStyle": style,
    }


def _line(
    name: str, data: Sequence[Any], colour: str, *, width: int = 2, dashed: bool = False
) -> Options:
    return {
        "type": "line",
        "name": name,
        "data": [*data],
        "step": "end",
        "symbol": "none",
        "lineStyle": {"color": colour, "width": width, "type": "dashed" if dashed else "solid"},
        "itemStyle": {"color": colour},
    }


def _lines(data: Sequence[Options], colours: Colours) -> Options:
    return {
        "silent": True,
        "symbol": "none",
        "label": {"show": False},
        "lineStyle": {"color": colours.infeasible, "type": "dashed", "width": 1.5},
        "data": [*data],
    }


def _box(x: Objective, y: Objective, colours: Colours) -> Options:
    """Return the truncation box, as far as it is bounded in these two objectives."""
    corners: list[Options] = [{}, {}]
    for axis, objective in (("xAxis", x), ("yAxis", y)):
        if objective.truncation is not None:
            for corner, limit in zip(corners, objective.truncation, strict=True):
                if math.isfinite(limit):
                    corner[axis] = limit
    style = {"color": colours.front, "opacity": 0.08}
    return {"silent": True, "itemStyle": style, "data": [corners] if any(corners) else []}


def _place(evaluation: Evaluation, x: str, y: str) -> Options | None:
    """Return an evaluation as a point; None if one of the objectives was not measured."""
    values = [evaluation.objectives.get(name, math.nan) for name in (x, y)]
    if not all(map(math.isfinite, values)):
        return None
    lines = [f"evaluation {evaluation.index}"]
    lines += [f"{name}  {number(value, 4)}" for name, value in evaluation.setpoint.items()]
    return {"name": "\n".join(lines), "value": [*values, evaluation.index]}


def _front_point(point: Point, x: str, y: str, problem: Problem) -> Options:
    units = problem.units
    lines = [f"evaluation {point.index}, on the front"]
    for name, value in point.objectives.items():
        spread = point.stddevs.get(name, math.nan)
        lines.append(f"{name}  {measured(value, spread, units.get(name, ''))}")
    for name, value in point.setpoint.items():
        lines.append(f"{name}  {quantity(value, units.get(name, ''))}")
    values = [point.objectives.get(x, math.nan), point.objectives.get(y, math.nan)]
    return {"name": "\n".join(lines), "value": [*map(_json, values), point.index]}


def _guessed(point: Point, x: str, y: str) -> bool:
    """Return whether one of the objectives was not measured there."""
    return bool({x, y} & {*point.predicted})


def _trace(evaluation: Evaluation, value: float, unit: str, stddev: float = math.nan) -> Options:
    text = f"evaluation {evaluation.index}\n{measured(value, stddev, unit)}"
    return {"name": text, "value": [evaluation.index + 1, _json(value), evaluation.index]}


def _thin(items: Sequence[Any]) -> list[Any]:
    """Return items, evenly thinned out if there are many; the last one stays."""
    step = math.ceil(len(items) / MAX_POINTS) or 1
    return [*items[::-1][::step]][::-1]


def _json(value: float) -> float | None:
    return value if math.isfinite(value) else None

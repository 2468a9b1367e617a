"""Plots of variables and diagnostics over the evaluations, as options of Apache ECharts."""

from __future__ import annotations

import math

from mobo_tuner.client import Evaluation
from mobo_tuner.core.problem import Variable
from mobo_tuner.core.units import spans_decades
from mobo_tuner.displays.settings import labelled
from mobo_tuner.page.board import RunBoard
from mobo_tuner.page.chart_parts import (
    Colours,
    Options,
    axis,
    bounds_of,
    choice_labels,
    error_bars,
    finite,
    marks,
    options,
    scatter,
    thinned,
    title,
)
from mobo_tuner.page.words import limits, measured, set_to


def variable(run: RunBoard, variable: Variable, colours: Colours) -> Options:
    """Return the plot of a variable over the evaluations, between its bounds."""
    name = variable.name
    made = [e for e in thinned(run.evaluations) if name in e.setpoint]
    values = axis("", colours, 0)
    bounds: list[Options] = []
    if not variable.choice_names and variable.fixed is None:
        bounds = [{"yAxis": variable.minimum}, {"yAxis": variable.maximum}]
        reach = bounds_of(variable, [e.setpoint[name] for e in made])
        values = axis("", colours, 0, labels=reach.pop("axisTick")["customValues"], **reach)
    elif variable.scale == "log":
        values["type"] = "log"

    fixed = "" if variable.fixed is None else ", fixed"

    def said(evaluation: Evaluation) -> str:
        return set_to(variable, evaluation.setpoint[name])

    return options(
        colours,
        title=title(labelled(name, variable.unit) + fixed, colours),
        grid=[{"left": 54, "right": 14, "top": 34, "bottom": 26}],
        xAxis=[axis("", colours, 0, min=0, minInterval=1)],
        yAxis=[values | choice_labels(variable, values["axisLabel"])],
        series=[
            {
                **scatter(
                    "set-point",
                    [_trace(e, variable.rank(e.setpoint[name]), said(e)) for e in made if e.valid],
                    *("circle", 5, colours.front),
                ),
                "markLine": marks(bounds, colours),
            },
            scatter(
                "failed",
                [_trace(e, variable.rank(e.setpoint[name]), said(e)) for e in made if not e.valid],
                *("path://M0,0L8,8M8,0L0,8", 8, colours.failed),
                line=2,
            ),
        ],
    )


def diagnostic(run: RunBoard, name: str, unit: str, colours: Colours) -> Options:
    """Return the plot of a diagnostic over the evaluations, with error bars and its limits."""
    problem = run.problem
    assert problem is not None
    is_feasible = run.is_feasible
    drawn = [(i, run.evaluations[i]) for i in thinned(range(len(run.evaluations)))]
    known = [
        (e, bool(is_feasible[i]), *e.diagnostics[name])
        for i, e in drawn
        if math.isfinite(e.diagnostics.get(name, (math.nan, math.nan))[0])
    ]
    bars = []
    for evaluation, _, mean, stddev in known:
        spread = stddev if math.isfinite(stddev) else 0.0
        bars.append([evaluation.index, mean, mean, mean - spread, mean + spread])
    scale = {}
    if spans_decades([mean for _, _, mean, _ in known]):
        scale = {"type": "log"}
        bars = [bar for bar in bars if bar[3] > 0.0]  # the others have no lower end there
    constraints = [c for c in problem.constraints if c.name == name]
    ends = [end for c in constraints for end in (c.minimum, c.maximum) if math.isfinite(end)]
    # The limits are in words, too: those far from all readings lie outside of the plot.
    said = ", ".join([labelled(name, unit), *map(limits, constraints)])
    return options(
        colours,
        title=title(said, colours),
        grid=[{"left": 54, "right": 14, "top": 34, "bottom": 26}],
        xAxis=[axis("", colours, 0, min=0, minInterval=1)],
        yAxis=[axis("", colours, 0) | scale],
        series=[
            error_bars("standard deviation", bars, colours),
            {
                **scatter(
                    "feasible",
                    [
                        _trace(e, mean, measured(mean, stddev, unit))
                        for e, feasible, mean, stddev in known
                        if feasible
                    ],
                    *("circle", 5, colours.front),
                ),
                "markLine": marks([{"yAxis": end} for end in ends], colours),
            },
            scatter(
                "infeasible",
                [
                    _trace(e, mean, measured(mean, stddev, unit))
                    for e, feasible, mean, stddev in known
                    if not feasible
                ],
                *("triangle", 7, colours.infeasible),
            ),
        ],
    )


def _trace(evaluation: Evaluation, value: float, said: str) -> Options:
    text = f"evaluation {evaluation.index}\n{said}"
    return {"name": text, "value": [evaluation.index, finite(value), evaluation.index]}

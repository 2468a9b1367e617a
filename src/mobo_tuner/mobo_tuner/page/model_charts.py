"""Plots of what the models say, as options of Apache ECharts.

Their data are what `mobo_tuner.runs.report.insight` prints.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from mobo_tuner.core.problem import Problem, Variable
from mobo_tuner.displays.settings import labelled
from mobo_tuner.page.chart_parts import (
    FONT,
    Colours,
    Options,
    axis,
    bounds_of,
    choice_labels,
    error_bars,
    marks,
    options,
    scatter,
    title,
)
from mobo_tuner.page.words import measured, number, quantity

BAND = 2.0  # standard deviations


def model_slice(
    content: Mapping[str, Any], variable: Variable, output: str, colours: Colours
) -> Options:
    """Return an output along a variable with its band, and the acquisition function below.

    Args:
        content: What the models say.
        variable: Variable.
        output: Name of the output.
        colours: Colours of the plot.
    """
    part = content["slices"][variable.name]
    means, stddevs = part["means"][output], part["stddevs"][output]
    values = [variable.rank(value) for value in part["values"]]
    low = [[x, _minus(m, s)] for x, m, s in zip(values, means, stddevs, strict=True)]
    width = [
        [x, None if s is None else 2.0 * BAND * s] for x, s in zip(values, stddevs, strict=True)
    ]
    gain = [[x, a] for x, a in zip(values, part["acquisition"], strict=True)]
    here = [{"xAxis": variable.rank(content["setpoint"][variable.name])}]
    along = bounds_of(variable) | {"min": values[0], "max": values[-1]}
    if variable.choice_names:  # of which nothing is in between
        along = {"min": -0.5, "max": len(values) - 0.5}
    labels = along.pop("axisTick", {}).get("customValues", values)
    least, most = _reach(content, output)
    below = axis("", colours, 0, labels=labels, gridIndex=1, **along)
    band = {"type": "line", "stack": "band", "symbol": "none", "lineStyle": {"opacity": 0.0}}
    plain = {"type": "line", "symbol": "none"}
    plot = options(
        colours,
        title=title(labelled(variable.name, variable.unit), colours),
        grid=[
            {"left": 58, "right": 14, "top": 34, "bottom": 76},
            {"left": 58, "right": 14, "height": 34, "bottom": 24},
        ],
        xAxis=[
            axis(
                "",
                colours,
                0,
                labels=labels,
                axisLabel={"show": False},
                **along,
            ),
            below | choice_labels(variable, below["axisLabel"]),
        ],
        yAxis=[
            axis("", colours, 0, bare_ends=True, min=least, max=most),
            axis("", colours, 0, gridIndex=1, min=0.0, max=1.0, show=False),
        ],
        series=[
            {**band, "name": "low", "data": low, "silent": True},
            {
                **band,
                "name": "two standard deviations",
                "data": width,
                "silent": True,
                "areaStyle": {"color": colours.front, "opacity": 0.22},
            },
            {
                **plain,
                "name": "mean",
                "data": [[x, m] for x, m in zip(values, means, strict=True)],
                "lineStyle": {"color": colours.front, "width": 2.5},
                "markLine": marks(here, colours),
            },
            {
                **plain,
                "name": "acquisition function",
                "data": gain,
                "xAxisIndex": 1,
                "yAxisIndex": 1,
                "lineStyle": {"color": colours.last, "width": 2},
                "areaStyle": {"color": colours.last, "opacity": 0.25},
                "markLine": marks(here, colours),
            },
        ],
    )
    if variable.choice_names:
        _separate(plot["series"], low, width, colours)
    return plot


def _separate(
    series: list[Options], low: list[list[Any]], width: list[list[Any]], colours: Colours
) -> None:
    """Draw what stands for choices without an order as points and bars, which nothing connects."""
    bars = [
        [x, bottom, bottom, bottom, bottom + extent]
        for (x, bottom), (_, extent) in zip(low, width, strict=True)
        if bottom is not None and extent is not None
    ]
    first, second, mean, gain = series
    first["data"] = []
    second.clear()
    second |= error_bars("two standard deviations", bars, colours)
    points = {"symbol": "circle", "symbolSize": 9, "itemStyle": {"color": colours.front}}
    mean |= {"type": "scatter", **points}
    gain |= {"type": "bar", "barWidth": 12, "itemStyle": {"color": colours.last}}


def at_contexts(content: Mapping[str, Any], problem: Problem) -> str:
    """Return for which readings of the contexts the models speak, as the end of a sentence."""
    known = {n: value for n, value in content.get("contexts", {}).items() if value is not None}
    units = problem.units
    readings = [
        f"{name} {quantity(value, units.get(name, ''), 4)}" for name, value in known.items()
    ]
    return f", for the last reading of {' and '.join(readings)}" if readings else ""


def _reach(content: Mapping[str, Any], output: str) -> tuple[float | None, float | None]:
    """Return the ends of the bands of all slices, so that one look tells which variable matters."""
    ends = [
        mean + sign * BAND * (stddev or 0.0)
        for part in content["slices"].values()
        for mean, stddev in zip(part["means"][output], part["stddevs"][output], strict=True)
        for sign in (-1.0, 1.0)
        if mean is not None
    ]
    return min(ends, default=None), max(ends, default=None)


def drivers(outputs: Sequence[Mapping[str, Any]], colours: Colours) -> Options:
    """Return which variable drives what: the share of each output's variance that each explains alone."""
    outputs = [output for output in outputs if not output["is_noise"]]
    names = [*outputs[0]["drivers"]] if outputs else []
    cells = [
        {
            "value": [column, row, share],
            "name": f"{name} explains {share:.0%} of {output['name']} alone\n"
            f"which changes over {number(output['length_scales'][name] or math.nan, 3)}",
            "label": {"show": True, "formatter": f"{share:.0%}", "color": _on(share, colours)},
        }
        for row, output in enumerate(outputs)
        for column, name in enumerate(names)
        if (share := output["drivers"][name]) is not None
    ]
    common = {
        "type": "category",
        "axisLabel": {"color": colours.text, "fontSize": 14, "fontFamily": FONT},
        "axisTick": {"show": False},
        "axisLine": {"show": False},
    }
    return options(
        colours,
        title=title("Which variable drives what", colours),
        grid=[{"left": 90, "right": 14, "top": 36, "bottom": 30}],
        xAxis=[{**common, "data": names}],
        yAxis=[{**common, "data": [o["name"] for o in outputs], "inverse": True}],
        visualMap={
            "show": False,
            "min": 0.0,
            "max": 1.0,
            "dimension": 2,
            "inRange": {"color": [colours.grid, colours.front]},
        },
        series=[{"type": "heatmap", "name": "share", "data": cells}],
    )


def left_out(output: Mapping[str, Any], colours: Colours) -> Options:
    """Return each reading of an output over what the model predicts from all others."""
    known = [
        (p, m, s)
        for p, m, s in zip(output["predicted"], output["measured"], output["stddevs"], strict=True)
        if p is not None and m is not None
    ]
    points = [
        {"value": [m, p], "name": f"measured {number(m)}\npredicted {measured(p, s or math.nan)}"}
        for p, m, s in known
    ]
    bars = [[m, p, p, p - BAND * (s or 0.0), p + BAND * (s or 0.0)] for p, m, s in known]
    ends = [m for _, m, _ in known]
    low, high = min(ends, default=0.0), max(ends, default=1.0)
    diagonal = [[{"coord": [low, low]}, {"coord": [high, high]}]]
    name = labelled(output["name"], output["unit"])
    return options(
        colours,
        title=title("Predicted from all others, over measured", colours),
        grid=[{"left": 64, "right": 14, "top": 36, "bottom": 46}],
        xAxis=[axis(f"{name}, measured", colours, 28)],
        yAxis=[axis("", colours, 0)],
        series=[
            error_bars("two standard deviations", bars, colours),
            {
                **scatter("predicted", points, "circle", 7, colours.front),
                "markLine": {**marks([], colours), "data": diagonal},
            },
        ],
    )


def quality(output: Mapping[str, Any]) -> str:
    """Return how well a model predicts, in words."""
    if output["is_noise"]:
        noise = quantity(output["noise"], output["unit"], 2)
        return f"All readings differ by no more than their noise of {noise}: there is nothing to predict."
    skill, error, coverage = (output[key] for key in ("skill", "error", "coverage"))
    if skill is None or error is None or coverage is None:
        return ""
    return (
        f"The model explains {max(skill, 0.0):.0%} of the variance; the error is {quantity(error, output['unit'], 2)}; "
        f"{coverage:.0%} lie within two standard deviations (95% are expected)."
    )


def _minus(mean: float | None, stddev: float | None) -> float | None:
    return None if mean is None or stddev is None else mean - BAND * stddev


def _on(share: float, colours: Colours) -> str:
    """Return the colour of a text on a cell."""
    return "#000000" if share > 0.5 else colours.text

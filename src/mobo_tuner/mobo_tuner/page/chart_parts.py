"""Parts of plots, as options of Apache ECharts: colours, axes, series, marks."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from mobo_tuner.core.problem import Variable

MAX_POINTS = 600  # of a series; more are thinned out
FONT = "Roboto, sans-serif"
NUMBER = """(value) => {
  const size = Math.abs(value);
  if (size < 1e5 && (size >= 1e-3 || size === 0)) {
    return value.toLocaleString("en-US", {useGrouping: false}).replace("-", "−");
  }
  const [digits, power] = value.toExponential().split("e");
  const raised = [...power.replace("+", "")].map((c) => c === "-" ? "⁻" : "⁰¹²³⁴⁵⁶⁷⁸⁹"[c]).join("");
  return `${Number(Number(digits).toFixed(3))}×10${raised}`.replace("-", "−");
}"""
_ERROR_BAR = """(params, api) => {
  const low = api.coord([api.value(0), api.value(3)]);
  const high = api.coord([api.value(0), api.value(4)]);
  return {type: "line", shape: {x1: low[0], y1: low[1], x2: high[0], y2: high[1]},
          style: {stroke: api.visual("color"), lineWidth: 1.5}};
}"""

Options = dict[str, Any]


@dataclass(frozen=True)
class Colours:
    """Colours of a plot, from the palette of Okabe and Ito, which the colour-blind can tell apart."""

    card: str
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
    card="#17202c",
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
    card="#ffffff",
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


def error_bars(name: str, bars: list[Any], colours: Colours) -> Options:
    """Return the series of vertical bars.

    Args:
        name: Name of the series.
        bars: For each bar x in its first place, and its ends in the fourth and fifth.
        colours: Colours of the plot.
    """
    return {
        "type": "custom",
        "name": name,
        "silent": True,
        "data": bars,
        "encode": {"x": 0, "y": [3, 4]},
        ":renderItem": _ERROR_BAR,
        "itemStyle": {"color": colours.others},
    }


def options(colours: Colours, **parts: Any) -> Options:
    """Return the options of a plot with what all plots have in common."""
    return {
        "animation": False,
        "backgroundColor": "transparent",
        "textStyle": {"color": colours.text, "fontFamily": FONT},
        "tooltip": {"renderMode": "richText", "confine": True, "formatter": "{b}"},
        **parts,
    }


def legend(colours: Colours, names: Sequence[str], *, lines: bool = False) -> Options:
    """Return a legend of series, by their names; `lines` says whether they are lines."""
    return {
        **({"icon": "rect", "itemHeight": 3} if lines else {}),
        "data": [*names],
        "type": "scroll",
        "top": 4,
        "left": 8,
        "itemGap": 14,
        "itemWidth": 14,
        "selectedMode": False,
        "textStyle": {"color": colours.text, "fontSize": 14, "fontFamily": FONT},
    }


def title(text: str, colours: Colours) -> Options:
    """Return a title in the upper left corner."""
    style = {"color": colours.text, "fontSize": 14, "fontWeight": "bold"}
    return {"text": text, "left": 8, "top": 6, "textStyle": style}


def axis(
    name: str,
    colours: Colours,
    gap: int,
    *,
    labels: Sequence[float] = (),
    bare_ends: bool = False,
    **parts: Any,
) -> Options:
    """Return an axis of numbers.

    Args:
        name: Name of the axis, with the unit.
        colours: Colours of the plot.
        gap: Distance of the name [px].
        labels: Values that are labelled; empty = round ones.
        bare_ends: Whether the ends are not labelled, as they are not round.
        parts: Further options.
    """
    label: Options = {
        "color": colours.faint,
        "fontSize": 13,
        "fontFamily": FONT,
        "hideOverlap": True,
        ":formatter": NUMBER,
    }
    if bare_ends:
        label |= {"showMinLabel": False, "showMaxLabel": False}
    if labels:
        label["customValues"] = [*labels]
        parts = {"axisTick": {"customValues": [*labels]}, "splitLine": {"show": False}, **parts}
    return {
        "type": "value",
        "name": name,
        "nameLocation": "middle",
        "nameGap": gap,
        "nameTextStyle": {"color": colours.text, "fontSize": 15, "fontFamily": FONT},
        "axisLabel": label,
        "axisLine": {"onZero": False, "lineStyle": {"color": colours.faint}},
        "splitLine": {"lineStyle": {"color": colours.grid}},
        "splitNumber": 4,
        "scale": True,
        **parts,
    }


def choice_labels(variable: Variable, label: Options) -> Options:
    """Return what an axis of a variable needs to show names of choices; empty if there are none.

    Args:
        variable: Variable.
        label: Label of the axis for numbers.
    """
    if not variable.choice_names:
        return {}
    places = list(range(len(variable.choices)))
    shown = {
        "customValues": places,
        ":formatter": f"(value) => ({json.dumps(variable.choice_names)})[value] ?? ''",
    }
    ends = {"min": -0.5, "max": len(places) - 0.5}
    return {"axisLabel": {**label, **shown}, "axisTick": {"customValues": places}, **ends}


def bounds_of(variable: Variable, values: Sequence[float] = ()) -> Options:
    """Return what the axis of a variable needs to show its bounds, in the middle of which is a label, too.

    Args:
        variable: Variable, which has an order.
        values: Values to show, too, which lie outside if the bounds were others.
    """
    low, high = variable.minimum, variable.maximum
    is_log = variable.scale == "log"
    middle = float(f"{math.sqrt(low * high):.3g}") if is_log else 0.5 * (low + high)
    kind = {"type": "log"} if is_log else {}
    ends = (
        {"min": min(low, *values), "max": max(high, *values)}
        if values
        else {"min": low, "max": high}
    )
    return {**ends, "axisTick": {"customValues": [low, middle, high]}, **kind}


def scatter(
    name: str,
    data: Sequence[Any],
    symbol: str,
    size: int,
    colour: str,
    *,
    opacity: float = 1.0,
    line: int = 0,
) -> Options:
    """Return a series of symbols; `line` is the width of their outline [px]."""
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


def curve(
    name: str, data: Sequence[Any], colour: str, *, width: int = 2, dashed: bool = False
) -> Options:
    """Return a series that is drawn as steps."""
    return {
        "type": "line",
        "name": name,
        "data": [*data],
        "step": "end",
        "symbol": "circle" if len(data) == 1 else "none",  # a line of one point is not drawn
        "lineStyle": {"color": colour, "width": width, "type": "dashed" if dashed else "solid"},
        "itemStyle": {"color": colour},
    }


def marks(data: Sequence[Options], colours: Colours) -> Options:
    """Return straight lines through a plot, such as limits."""
    return {
        "silent": True,
        "symbol": "none",
        "label": {"show": False},
        "lineStyle": {"color": colours.infeasible, "type": "dashed", "width": 1.5},
        "data": [*data],
    }


def thinned(items: Sequence[Any]) -> list[Any]:
    """Return items, evenly thinned out if there are many; the last one stays."""
    step = math.ceil(len(items) / MAX_POINTS) or 1
    return [items[i] for i in range((len(items) - 1) % step, len(items), step)]


def finite(value: float) -> float | None:
    """Return a value as JSON knows it: None in place of NaN and infinity."""
    return value if math.isfinite(value) else None

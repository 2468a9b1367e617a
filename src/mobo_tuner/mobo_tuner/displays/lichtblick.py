"""Layouts for Lichtblick and Foxglove, as the JSON that both import.

Paths are Lichtblick's message paths: a topic, then fields; `[:]` takes all elements of a list, and `{name=="x1"}` those
of that name.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Sequence
from typing import Any

from mobo_tuner.core.problem import Constraint, Problem
from mobo_tuner.displays.settings import labelled

BUTTONS = {
    "pause": "Pause",
    "resume": "Continue",
    "step": "Step",
    "skip": "Skip",
    "stop_after_this": "Stop after this",
}
"""Text of the button of each service."""
MAX_PAIRS = 6  # pairs of objectives that are shown
# Of Okabe and Ito, which the colour-blind can tell apart.
BLUE, ORANGE, GREY = "#56b4e9", "#e69f00", "#8a94a3"

Panel = str | dict[str, Any]
"""Identifier of a panel, or a division of two panels."""


def lichtblick_layout(problem: Problem, *, live: bool) -> str:
    """Return a layout for a problem.

    Args:
        problem: Problem of the parameter file.
        live: Whether it is for a live run, which can be steered; otherwise it is for a bag.
    """
    sheet = _Sheet()
    left = _divided([_state(sheet), _fronts(sheet, problem)], "column", 22.0)
    right = _divided([_hypervolume(sheet), _details(sheet, problem)], "column", 35.0)
    side = [_diagnostics(sheet)]
    if live:
        side = [_buttons(sheet), sheet.add("Parameters", "Parameters"), *side]
    middle = _divided([left, right], "row", 50.0)
    layout = _divided([middle, _divided(side, "column", 45.0)], "row", 76.0)
    content = {
        "configById": sheet.configs,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": layout,
    }
    return json.dumps(content, indent=2, ensure_ascii=False) + "\n"


class _Sheet:
    """The panels of a layout, with their settings.

    Attributes:
        configs: Settings of each panel, by its identifier.
    """

    def __init__(self) -> None:
        self.configs: dict[str, dict[str, Any]] = {}

    def add(self, kind: str, title: str, **config: Any) -> str:
        """Add a panel; return its identifier."""
        identifier = f"{kind}!mobo{len(self.configs)}"
        titles = {"foxglovePanelTitle": title, "lichtblickPanelTitle": title}
        self.configs[identifier] = {**config, **titles}
        return identifier

    def plot(self, title: str, paths: Sequence[dict[str, Any]], **config: Any) -> str:
        """Add a plot; return its identifier."""
        general = {
            "showXAxisLabels": True,
            "showYAxisLabels": True,
            "showLegend": True,
            "legendDisplay": "floating",
            "showPlotValuesInLegend": False,
            "isSynced": True,
            "xAxisVal": "timestamp",
            "sidebarDimension": 240,
        }
        return self.add("Plot", title, paths=[*paths], **{**general, **config})

    def tabs(self, title: str, tabs: Iterable[tuple[str, Panel]]) -> str:
        """Add a panel of tabs, each with its title; return its identifier."""
        content = [{"title": name, "layout": panel} for name, panel in tabs]
        return self.add("Tab", title, activeTabIdx=0, tabs=content)


def _state(sheet: _Sheet) -> Panel:
    states = ("idle", "waiting", "suggesting", "evaluating", "canceling", "paused", "moving")
    colours = (GREY, ORANGE, BLUE, BLUE, ORANGE, ORANGE, BLUE)
    rules = [
        {"operator": "=", "rawValue": str(value), "color": colour, "label": word}
        for value, (word, colour) in enumerate(zip(states, colours, strict=True))
    ]
    indicator = sheet.add(
        "Indicator",
        "State",
        path="/status.state",
        style="background",
        fallbackColor=GREY,
        fallbackLabel="no tuner",
        rules=rules,
    )
    return _divided([indicator, sheet.add("RawMessages", "Status", topicPath="/status")], "row")


def _fronts(sheet: _Sheet, problem: Problem) -> Panel:
    """Return the front of pairs of objectives, each point a dot."""
    names = problem.objective_names
    pairs = [(a, b) for i, a in enumerate(names) for b in names[i + 1 :]][:MAX_PAIRS]
    units = problem.units
    tabs = []
    for x, y in pairs:
        plot = sheet.plot(
            f"Pareto front, {y} over {x}",
            [_series(_of_front(y), "front", BLUE, line=False)],
            xAxisVal="currentCustom",
            xAxisPath={"value": _of_front(x), "enabled": True},
            xAxisLabel=labelled(x, units.get(x, "")),
            yAxisLabel=labelled(y, units.get(y, "")),
        )
        tabs.append((f"{y} / {x}", plot))
    if not tabs:
        return _measured(sheet, problem, names[0])
    return sheet.tabs("Pareto front", tabs) if len(tabs) > 1 else tabs[0][1]


def _hypervolume(sheet: _Sheet) -> Panel:
    return sheet.plot(
        "Hypervolume",
        [
            _series("/evaluation.hypervolume", "hypervolume", BLUE),
            _series("/evaluation.hypervolume_measured", "of the readings as they are", GREY),
        ],
    )


def _details(sheet: _Sheet, problem: Problem) -> Panel:
    variables = [
        sheet.plot(
            labelled(v.name, v.unit),
            [
                _series(_of_evaluation("setpoint", v.name), "set-point", BLUE),
                _series(_of_evaluation("readbacks", v.name), "readback", ORANGE),
                *_limits((v.minimum, v.maximum)),
            ],
        )
        for v in problem.variables
    ]
    names = [*problem.required_diagnostics, *(o.name for o in problem.observables)]
    diagnostics = [_measured(sheet, problem, name) for name in dict.fromkeys(names)]
    return sheet.tabs(
        "Over the run",
        [("Variables", _stacked(variables)), ("Diagnostics", _stacked(diagnostics))],
    )


def _measured(sheet: _Sheet, problem: Problem, name: str) -> Panel:
    limits = [limit for c in problem.constraints if c.name == name for limit in _sides(c)]
    return sheet.plot(
        labelled(name, problem.units.get(name, "")),
        [_series(_of_evaluation("diagnostics", name), name, BLUE, line=False), *_limits(limits)],
    )


def _diagnostics(sheet: _Sheet) -> Panel:
    return sheet.add(
        "DiagnosticSummary",
        "Health",
        minLevel=0,
        pinnedIds=[],
        topicToRender="/diagnostics",
        hardwareIdFilter="",
        sortByLevel=True,
    )


def _buttons(sheet: _Sheet) -> Panel:
    return _stacked(
        [
            sheet.add(
                "CallService",
                text,
                serviceName=f"/{service}",
                requestPayload="{}",
                layout="horizontal",
                buttonText=text,
                buttonTooltip="",
                buttonColor=BLUE,
            )
            for service, text in BUTTONS.items()
        ]
    )


# ------------------------------------------------------------------ parts


def _of_front(name: str) -> str:
    return f'/pareto_front.points[:].objectives[:]{{name=="{name}"}}.value'


def _of_evaluation(field: str, name: str) -> str:
    return f'/evaluation.{field}[:]{{name=="{name}"}}.value'


def _series(path: str, label: str, colour: str, *, line: bool = True) -> dict[str, Any]:
    return {
        "value": path,
        "enabled": True,
        "label": label,
        "color": colour,
        "showLine": line,
        "timestampMethod": "headerStamp",
    }


def _limits(limits: Iterable[float]) -> list[dict[str, Any]]:
    """Return horizontal lines, which have a number in place of a path."""
    return [
        {**_series(f"{limit:g}", "limit", GREY), "timestampMethod": "receiveTime"}
        for limit in limits
        if math.isfinite(limit)
    ]


def _sides(constraint: Constraint) -> tuple[float, float]:
    return constraint.minimum, constraint.maximum


def _divided(panels: Sequence[Panel], direction: str, share: float = 50.0) -> Panel:
    """Return panels beside or below each other; the first has a share [%] of the room."""
    first, *others = panels
    if not others:
        return first
    rest = _divided(others, direction, 50.0)
    return {"direction": direction, "first": first, "second": rest, "splitPercentage": share}


def _stacked(panels: Sequence[Panel]) -> Panel:
    """Return panels below each other, each with the same room."""
    first, *others = panels
    if not others:
        return first
    share = 100.0 / len(panels)
    return {
        "direction": "column",
        "first": first,
        "second": _stacked(others),
        "splitPercentage": share,
    }

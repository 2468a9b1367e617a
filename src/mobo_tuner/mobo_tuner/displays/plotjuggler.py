"""Layouts for PlotJuggler, for a live run and for a bag.

PlotJuggler names a series by its topic and fields: `/plot/K1/data`. Two series make an XY plot if they come from one
message, which the objectives of an evaluation do.
"""

from __future__ import annotations

from collections.abc import Sequence
from xml.etree import ElementTree

from mobo_tuner.core.problem import Problem
from mobo_tuner.names import topic_token

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7")
MAX_PAIRS = 6  # pairs of objectives that are shown
COLUMNS = 2


def plotjuggler_layout(problem: Problem) -> str:
    """Return a layout for a problem.

    Args:
        problem: Problem of the parameter file.
    """
    root = ElementTree.Element("root")
    window = ElementTree.SubElement(
        root, "tabbed_widget", {"parent": "main_window", "name": "Main Window"}
    )
    pairs = _pairs(len(problem.objectives))
    objectives = [f"/evaluation/objectives[{i}]/value" for i in range(len(problem.objectives))]
    run = [["/evaluation/hypervolume", "/evaluation/hypervolume_measured"], ["/status/evaluations"]]
    _tab(window, "run", [*run, *((objectives[up], objectives[x]) for x, up in pairs)], len(run))
    _tab(window, "variables", [[_plot(v.name)] for v in problem.variables])
    names = [*problem.required_diagnostics, *(o.name for o in problem.observables)]
    _tab(window, "diagnostics", [[_plot(name)] for name in dict.fromkeys(names)])
    ElementTree.SubElement(window, "currentPlotMatrix", index="0")
    ElementTree.SubElement(root, "use_relative_time_offset", enabled="1")
    ElementTree.indent(root, " ")
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _pairs(objectives: int) -> list[tuple[int, int]]:
    every = [(x, up) for x in range(objectives) for up in range(x + 1, objectives)]
    return every[:MAX_PAIRS]


def _plot(name: str) -> str:
    return f"/plot/{topic_token(name)}/data"


def _tab(
    window: ElementTree.Element, name: str, plots: Sequence[Sequence[str]], xy_from: int = 1 << 30
) -> None:
    """Add a tab of plots.

    Args:
        window: Element that it belongs to.
        name: Its title.
        plots: Series of each plot; in an XY plot the second is the horizontal axis.
        xy_from: Number of the first XY plot.
    """
    rows = -(-len(plots) // COLUMNS)
    matrix = ElementTree.SubElement(
        window, "plotmatrix", rows=str(rows), columns=str(COLUMNS), tab_name=name
    )
    for number, series in enumerate(plots):
        place = {"row": str(number // COLUMNS), "col": str(number % COLUMNS)}
        is_xy = number >= xy_from
        style = "Dots" if is_xy else "LinesAndDots"
        plot = ElementTree.SubElement(matrix, "plot", place, style=style)
        transform = "XYPlot" if is_xy else "noTransform"
        for colour, curve in zip(COLOURS, series[:1] if is_xy else series, strict=False):
            red, green, blue = (str(int(colour[i : i + 2], 16)) for i in (1, 3, 5))
            ElementTree.SubElement(
                plot, "curve", name=curve, custom_transform=transform, R=red, G=green, B=blue
            )
        axis = {"axisX": series[1]} if is_xy else {}
        ElementTree.SubElement(plot, "transform", {"value": transform, **axis})

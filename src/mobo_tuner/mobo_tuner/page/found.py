"""What was found: the front of two objectives, the hypervolume, the chosen point, all coordinates."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from nicegui import events, ui

from mobo_tuner.client import Point
from mobo_tuner.core.conflict import conflicting_pair
from mobo_tuner.core.problem import Problem
from mobo_tuner.core.units import product_of_units
from mobo_tuner.page import chart_parts, charts
from mobo_tuner.page.board import RunBoard
from mobo_tuner.page.viewer import Table, Viewer, card
from mobo_tuner.page.words import measured, number, quantity

STAGNATION = 3  # evaluations without a gain that are worth a word
TELLING = 8  # points of a front that tell which objectives conflict
EMPTY: chart_parts.Options = {"series": [], "animation": False}


class FrontPanel:
    """The front of any two objectives; a click chooses a point."""

    def __init__(self, viewer: Viewer) -> None:
        self._viewer = viewer
        self._plane = ("", "")  # objectives that are shown at first
        self._settled = False  # whether the plane stays as it is until the viewer chooses another
        with card("front"):
            with ui.element("div").classes("card-head"):
                ui.label("Pareto front").classes("card-title").props(
                    'role="heading" aria-level="2"'
                )
                self._note = ui.label("It is drawn from the first evaluation on.").classes(
                    "quiet grow"
                )
                self._x = self._select("horizontal axis", "x")
                self._y = self._select("vertical axis", "y")
            self.chart = ui.echart(dict(EMPTY), on_point_click=self._click).classes("chart tall")
            self.chart.props(
                'role="img" aria-label="Pareto front; the table beside it has its points"'
            )

    def _select(self, label: str, axis: str) -> ui.select:
        def chosen(event: events.ValueChangeEventArguments) -> None:
            setattr(self._viewer, axis, event.value or "")
            self._viewer.choices += 1

        select = (
            ui.select([], label=label, on_change=chosen).props("dense outlined").classes("axis")
        )
        select.set_visibility(False)
        return select

    def refresh(self, run: RunBoard) -> None:
        """Show the front as it is now."""
        problem, viewer = run.problem, self._viewer
        if problem is None:
            return
        names = list(problem.objective_names)
        if self._x.options != names:
            self._plane = names[0], names[min(1, len(names) - 1)]
            self._settled = len(names) < 3
            self._x.set_options(names, value=self._plane[0])
            self._y.set_options(names, value=self._plane[1])
            for select in (self._x, self._y):
                select.set_visibility(True)
            viewer.x, viewer.y = self._plane
        points = run.front.points if run.front is not None else ()
        size = len(points)
        if not self._settled and size >= TELLING:
            self._settle(points, problem)
        points_of = "1 point" if size == 1 else f"{size} points"
        self._note.set_text(points_of if size else self._why_empty(run))
        show(
            self.chart,
            charts.front(run, viewer.x, viewer.y, viewer.chosen, viewer.colours, viewer.wants),
        )

    def _why_empty(self, run: RunBoard) -> str:
        """Return why there is no front."""
        if not run.evaluations:
            return "nothing was evaluated yet"
        if not run.is_feasible.any():
            return "no point is feasible yet"
        return "no feasible point is better than the reference yet"

    def _settle(self, points: Sequence[Point], problem: Problem) -> None:
        """Show the two objectives that conflict most, once, unless the viewer chose others."""
        self._settled = True
        names = problem.objective_names
        if (self._viewer.x, self._viewer.y) != self._plane:
            return
        signs = np.array([objective.sign for objective in problem.objectives])
        values = [[point.objectives.get(name, math.nan) for name in names] for point in points]
        across, up = conflicting_pair(signs * np.array(values))
        self._x.set_value(names[across])
        self._y.set_value(names[up])

    def _click(self, event: events.EChartPointClickEventArguments) -> None:
        value = event.value
        if isinstance(value, list) and len(value) > 2 and isinstance(value[2], int):
            self._viewer.choose(value[2])


class HypervolumePanel:
    """The hypervolume in large figures and over the evaluations."""

    def __init__(self, viewer: Viewer) -> None:
        self._viewer = viewer
        with card("hypervolume"):
            with ui.element("div").classes("card-head"):
                ui.label("Hypervolume").classes("card-title").props('role="heading" aria-level="2"')
                self._value = ui.label().classes("figure")
                self._unit = ui.label().classes("quiet")
                self._gain = ui.label("It is drawn from the first evaluation on.").classes(
                    "quiet grow"
                )
            self.chart = ui.echart(dict(EMPTY)).classes("chart low")
            self.chart.props('role="img" aria-label="hypervolume over the evaluations"')

    def refresh(self, run: RunBoard) -> None:
        """Show the hypervolume as it is now."""
        self._value.set_text(number(run.progress.hypervolume, 4))
        problem = run.problem
        units = [] if problem is None else [objective.unit for objective in problem.objectives]
        self._unit.set_text(product_of_units(units))
        idle = run.without_gain
        self._gain.set_text(f"nothing gained for {idle} evaluations" if idle >= STAGNATION else "")
        show(self.chart, charts.hypervolume(run, self._viewer.colours))


class ObjectivesPanel:
    """Last and best value of every objective."""

    def __init__(self, viewer: Viewer) -> None:
        self._viewer = viewer
        with card("objectives", "Objectives"):
            self._table = Table(("name", "last", "best", "note"), "objective-rows")

    def refresh(self, run: RunBoard) -> None:
        """Show the values as they are now."""
        if run.problem is None:
            return
        last, rows = run.progress.last, []
        for objective in run.problem.objectives:
            name, unit = objective.name, objective.unit
            value = math.nan if last is None else last.objectives.get(name, math.nan)
            spread = math.nan if last is None else last.stddev(name)
            best = run.progress.best(name)
            text = "–" if best is None else quantity(best[0], unit, 4)
            arrow = "↓" if objective.sign > 0 else "↑"
            note = "" if best is None else f"at {best[1]}"
            if objective.goal is not None:
                reached = run.progress.is_reached(name)
                goal = quantity(objective.goal, unit, 4)
                note += f", good enough ({goal})" if reached else f", good enough from {goal}"
            rows.append(
                (f"{name} {arrow}", f"last {measured(value, spread)}", f"best {text}", note)
            )
        self._table.show(rows)


class PointsPanel:
    """The points of the front as a table, to choose from by keyboard, too, and the chosen one."""

    def __init__(self, viewer: Viewer) -> None:
        self._viewer = viewer
        self._shown: list[dict[str, Any]] = []
        self._columns: list[str] = []
        with card("points", "Points of the front"):
            self._chosen = (
                ui.label("There is none yet.").classes("chosen").props('aria-live="polite"')
            )
            self._table = ui.table(
                columns=[], rows=[], row_key="#", selection="single", on_select=self._select
            )
            self._table.on("rowClick", self._click, [[], ["#"], None])
            self._table.classes("point-table").props("dense flat virtual-scroll hide-bottom")

    def refresh(self, run: RunBoard) -> None:
        """Show the points as they are now."""
        if run.problem is None:
            return
        names = ["#", *run.problem.objective_names]
        if names != self._columns:
            self._columns = names
            units = {**run.problem.units, "#": ""}
            self._table.columns = [
                {
                    "name": name,
                    "label": f"{name}\n[{units[name]}]" if units.get(name) else name,
                    "field": name,
                    "sortable": True,
                    "align": "right",
                }
                for name in names
            ]
        points = run.front.points if run.front is not None else ()
        points = tuple(filter(self._viewer.wants, points))
        rows = [_row(point) for point in points]
        if rows != self._shown:
            self._shown = rows
            self._table.rows = [dict(row) for row in rows]
        self._show_chosen(run, run.problem)

    def _show_chosen(self, run: RunBoard, problem: Problem) -> None:
        """Show the chosen point in words and in the table."""
        index = self._viewer.chosen
        point = run.point(index)
        text = "None is chosen; click on one." if self._shown else "There is none yet."
        if point is not None:
            values = charts.setpoint_lines(point.setpoint, problem)
            text = f"Chosen is {index}: {', '.join(values)}"
            if not run.is_on_front(index):
                text += "; it is not on the front"
        self._chosen.set_text(text)
        chosen = [row for row in self._shown if row["#"] == index]
        if self._table.selected != chosen:
            self._table.selected = [dict(row) for row in chosen]
            if chosen:
                self._table.run_method("scrollTo", self._shown.index(chosen[0]), "center")

    def _click(self, event: events.GenericEventArguments) -> None:
        row = event.args[1] if isinstance(event.args, list) and len(event.args) > 1 else None
        index = row.get("#") if isinstance(row, dict) else None
        if isinstance(index, int):
            self._viewer.choose(index)

    def _select(self, event: events.TableSelectionEventArguments) -> None:
        indices = [row.get("#") for row in event.selection]
        index = indices[0] if indices else None
        if index != self._viewer.chosen and (index is None or isinstance(index, int)):
            self._viewer.choose(index)


class CoordinatesPanel:
    """Parallel coordinates of the front; dragging along an axis keeps the points in that interval."""

    def __init__(self, viewer: Viewer) -> None:
        self._viewer = viewer
        with ui.element("div").classes("card-head"):
            self._note = (
                ui.label("The front has no point yet.").classes("quiet grow").mark("brush-note")
            )
            self._clear = ui.button("Show all points", on_click=self._forget, color=None)
            self._clear.props("no-caps flat")
        self._clear.set_visibility(False)
        self.chart = ui.echart(dict(EMPTY)).classes("chart wide")
        self.chart.props(
            'role="img" aria-label="objectives and variables of all points of the front"'
        )
        self.chart.on("chart:axisareaselected", self._brush, ["parallelAxisId", "intervals"])

    def refresh(self, run: RunBoard) -> None:
        """Show the coordinates as they are now."""
        if run.problem is None:
            return
        show(self.chart, charts.parallel(run, self._viewer.chosen, self._viewer.colours))
        points = run.front.points if run.front is not None else ()
        kept = sum(map(self._viewer.wants, points))
        self._clear.set_visibility(bool(self._viewer.brush))
        self._note.set_text(
            f"{kept} of {len(points)} points are in what you marked."
            if self._viewer.brush
            else "Drag along an axis to keep the points in that interval."
            if points
            else "The front has no point yet."
        )

    def _brush(self, event: events.GenericEventArguments) -> None:
        args = event.args if isinstance(event.args, dict) else {}
        run, name = self._viewer.run, args.get("parallelAxisId")
        if run is None or run.problem is None or run.front is None:
            return
        if name not in (*run.problem.objective_names, *run.problem.variable_names):
            return
        intervals = _intervals(args.get("intervals"))
        if intervals:
            self._viewer.brush[name] = intervals
        else:
            self._viewer.brush.pop(name, None)
        kept = [point.index for point in run.front.points if self._viewer.wants(point)]
        chosen = self._viewer.chosen if self._viewer.chosen in kept else None
        self._viewer.choose(kept[0] if len(kept) == 1 else chosen)

    def _forget(self) -> None:
        for name in self._viewer.brush:
            action = {"type": "axisAreaSelect", "parallelAxisId": name, "intervals": []}
            self.chart.run_chart_method("dispatchAction", action)
        self._viewer.brush.clear()
        self._viewer.choices += 1


def _intervals(given: Any) -> list[tuple[float, float]]:
    """Return the intervals that a browser sent, as far as they are ones."""
    try:
        pairs = [(float(low), float(high)) for low, high in given]
    except (TypeError, ValueError):
        return []
    return [(low, high) for low, high in pairs if math.isfinite(low) and math.isfinite(high)]


def show(chart: ui.echart, options: chart_parts.Options) -> None:
    """Have a plot show other options, in place."""
    if chart.options != options:
        chart.options.clear()
        chart.options.update(options)
        chart.update()


def _row(point: Point) -> dict[str, Any]:
    values = {name: float(f"{value:.4g}") for name, value in point.objectives.items()}
    finite = {name: value if math.isfinite(value) else None for name, value in values.items()}
    return {"#": point.index, **finite}

"""Why: every variable between its bounds and every diagnostic with its error bars, over the evaluations."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable

from nicegui import ui

from mobo_tuner.core.problem import Constraint, Problem
from mobo_tuner.displays.settings import labelled
from mobo_tuner.page import charts
from mobo_tuner.page.board import RunBoard
from mobo_tuner.page.found import EMPTY, show
from mobo_tuner.page.viewer import Table, Viewer
from mobo_tuner.page.words import number, quantity

Plot = Callable[[RunBoard], charts.Options]


class TracesPanel(ABC):
    """One small plot for each quantity; the plots are made again only if the quantities change."""

    def __init__(self, viewer: Viewer) -> None:
        self._viewer = viewer
        self._charts: dict[str, ui.echart] = {}
        self._body = ui.element("div").classes("traces")

    @abstractmethod
    def plots(self, problem: Problem) -> dict[str, Plot]:
        """Return the plot of each quantity, by its name."""

    def refresh(self, run: RunBoard) -> None:
        """Show the quantities as they are now."""
        if run.problem is None:
            return
        plots = self.plots(run.problem)
        if list(plots) != list(self._charts):
            self._body.clear()
            with self._body:
                self._charts = {name: self._chart(name) for name in plots}
        for name, plot in plots.items():
            show(self._charts[name], plot(run))

    def _chart(self, name: str) -> ui.echart:
        chart = ui.echart(dict(EMPTY)).classes("chart trace")
        chart.props["role"] = "img"
        chart.props["aria-label"] = f"{name} over the evaluations"
        return chart


class VariablesPanel(TracesPanel):
    """Every variable over the evaluations, between its bounds."""

    def plots(self, problem: Problem) -> dict[str, Plot]:
        """Return the plot of each variable."""
        colours = self._viewer.colours
        return {
            v.name: lambda run, v=v: charts.variable(run, v, colours)  # type: ignore[misc]
            for v in problem.variables
        }


class DiagnosticsPanel(TracesPanel):
    """Every objective and constrained diagnostic over the evaluations, with its limits."""

    def plots(self, problem: Problem) -> dict[str, Plot]:
        """Return the plot of each diagnostic."""
        colours, units = self._viewer.colours, problem.units
        names = [*problem.required_diagnostics, *(o.name for o in problem.observables)]
        return {
            name: lambda run, name=name: charts.diagnostic(  # type: ignore[misc]
                run, name, units.get(name, ""), colours
            )
            for name in dict.fromkeys(names)
        }


class ConstraintsPanel:
    """How often each constraint was met, and its last value."""

    def __init__(self, viewer: Viewer) -> None:
        self._viewer = viewer
        self._none = ui.label("The problem has no constraints.").classes("quiet")
        self._table = Table(("name", "limit", "last", "share"), "constraint-rows")

    def refresh(self, run: RunBoard) -> None:
        """Show the constraints as they are now."""
        if run.problem is None:
            return
        rows = []
        for constraint in run.problem.constraints:
            name = constraint.name
            values = [e.diagnostics.get(name, (math.nan, math.nan))[0] for e in run.evaluations]
            measured = [value for value in values if math.isfinite(value)]
            met = sum(map(constraint.is_met, measured))
            last = "–" if not measured else number(measured[-1], 4)
            share = f"met in {met} of {len(measured)}"
            label = labelled(name, constraint.unit) + (", critical" if constraint.critical else "")
            rows.append((label, _limit(constraint), f"last {last}", share))
        self._table.show(rows)
        self._none.set_visibility(not rows)


def _limit(constraint: Constraint) -> str:
    low, high, unit = constraint.minimum, constraint.maximum, constraint.unit
    if math.isfinite(low) and math.isfinite(high):
        return f"{number(low)} to {quantity(high, unit)}"
    return (
        f"at least {quantity(low, unit)}"
        if math.isfinite(low)
        else f"at most {quantity(high, unit)}"
    )

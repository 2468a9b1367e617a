"""Why: variables and diagnostics over the evaluations, constraints, and what the models say."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from nicegui import background_tasks, ui

from mobo_tuner.core.problem import Problem
from mobo_tuner.displays.settings import labelled
from mobo_tuner.page import chart_parts, model_charts, traces
from mobo_tuner.page.board import RunBoard
from mobo_tuner.page.found import EMPTY, show
from mobo_tuner.page.insights import Insights
from mobo_tuner.page.model_charts import at_contexts, quality
from mobo_tuner.page.viewer import Table, Viewer
from mobo_tuner.page.words import limits, number

Plot = Callable[[RunBoard], chart_parts.Options]


class TracesPanel(ABC):
    """One small plot for each quantity; the plots are made again only if the quantities change.

    Attributes:
        note: What the plots have in common.
    """

    note: str

    def __init__(self, viewer: Viewer) -> None:
        self._viewer = viewer
        ui.label(self.note).classes("quiet")
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

    note = (
        "Set-points over the index of the evaluation; dashed: bounds; crosses: failed evaluations."
    )

    def plots(self, problem: Problem) -> dict[str, Plot]:
        """Return the plot of each variable."""
        colours = self._viewer.colours
        return {
            v.name: lambda run, v=v: traces.variable(run, v, colours)  # type: ignore[misc]
            for v in problem.variables
        }


class DiagnosticsPanel(TracesPanel):
    """Every objective, constrained diagnostic, observable and context over the evaluations, with its limits."""

    note = (
        "Readings over the index of the evaluation, with one standard deviation; dashed: limits; triangles: "
        "evaluations that are infeasible or incomplete."
    )

    def plots(self, problem: Problem) -> dict[str, Plot]:
        """Return the plot of each diagnostic."""
        colours, units = self._viewer.colours, problem.units
        names = [*problem.required_diagnostics, *(o.name for o in problem.observables)]
        return {
            name: lambda run, name=name: traces.diagnostic(  # type: ignore[misc]
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
            values = run.evaluations.diagnostics(name)
            measured = [*map(float, values[np.isfinite(values)])]
            met = sum(map(constraint.is_met, measured))
            last = "–" if not measured else number(measured[-1], 4)
            share = f"met in {met} of {len(measured)}"
            label = labelled(name, constraint.unit) + (", critical" if constraint.critical else "")
            rows.append((label, limits(constraint), f"last {last}", share))
        self._table.show(rows)
        self._none.set_visibility(not rows)


class ModelsPanel:
    """What the models say: slices through the chosen or the last point, what drives what, how well they predict."""

    def __init__(self, viewer: Viewer, insights: Insights) -> None:
        self._viewer = viewer
        self._insights = insights
        self._shown: tuple[object, ...] = ()
        with ui.element("div").classes("card-head"):
            self._output = ui.select([], label="output", on_change=self._choose).props(
                "dense outlined"
            )
            self._output.classes("axis")
            self._note = ui.label().classes("quiet grow").mark("models-note")
        self._slices: dict[str, ui.echart] = {}
        self._body = ui.element("div").classes("traces")
        with ui.element("div").classes("pair"):
            self._drivers = self._chart("share of each output that each variable explains")
            self._left_out = self._chart("predictions over readings")

    def refresh(self, run: RunBoard) -> None:
        """Show what is known, and ask for what is not."""
        problem, index = run.problem, self._viewer.chosen
        if problem is None:
            return
        if self._insights.is_due(run.run_id, index, len(run.evaluations)):
            background_tasks.create(self._insights.ask(run.run_id, index))
        known = self._insights.known(run.run_id, index)
        if known is None:
            self._note.set_text("The models are being asked …")
            return
        content = known.content
        outputs = {output["name"]: output for output in content.get("outputs", ())}
        if not outputs:
            text = "Too little is known yet for models." if content else known.trouble
            self._note.set_text(text)
            return
        if list(outputs) != self._output.options:
            self._output.set_options(list(outputs), value=next(iter(outputs)))
        chosen = outputs[self._output.value]
        where = "chosen" if index is not None else "last"
        self._note.set_text(
            f"{chosen['name']} with two standard deviations, and below it the acquisition function{_remark(content)}, "
            f"along each variable through the {where} point, evaluation {content['index']}; the others stay as they "
            f"are there{at_contexts(content, problem)}. {quality(chosen)}"
        )
        shown = (id(content), chosen["name"], self._viewer.dark)
        if shown != self._shown:
            self._shown = shown
            self._draw(problem, content, chosen)

    def _draw(
        self, problem: Problem, content: Mapping[str, Any], chosen: Mapping[str, Any]
    ) -> None:
        colours, names = self._viewer.colours, list(content["slices"])
        if names != list(self._slices):
            self._body.clear()
            with self._body:
                self._slices = {name: self._chart(f"{name}: slice") for name in names}
        for name, chart in self._slices.items():
            variable = problem.variable(name)
            if variable is not None:
                options = model_charts.model_slice(content, variable, chosen["name"], colours)
                show(chart, options)
        show(self._drivers, model_charts.drivers(content["outputs"], colours))
        show(self._left_out, model_charts.left_out(chosen, colours))

    def _choose(self) -> None:
        self._viewer.choices += 1

    def _chart(self, label: str) -> ui.echart:
        chart = ui.echart(dict(EMPTY)).classes("chart slice")
        chart.props["role"] = "img"
        chart.props["aria-label"] = label
        return chart


def _remark(content: Mapping[str, Any]) -> str:
    """Return why there is no acquisition function, in brackets; empty if there is one."""
    values = (value for part in content["slices"].values() for value in part["acquisition"])
    return "" if any(v is not None for v in values) else " (none: nothing shows yet where to look)"

"""The runs of the folder, with a filter; one is opened, several are compared."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from typing import Any

from nicegui import ui

from mobo_tuner.errors import UserError
from mobo_tuner.page import charts
from mobo_tuner.page.board import RunBoard
from mobo_tuner.page.chart_parts import NUMBER
from mobo_tuner.page.found import EMPTY, show
from mobo_tuner.page.history import History, PastRun
from mobo_tuner.page.viewer import Viewer

CHOICE = """<q-checkbox dense v-model="props.selected" :aria-label="'run ' + props.row.run_id" />"""
MAX_COMPARED = 20  # runs on one plot

_COLUMNS = (
    ("run_id", "run", "left"),
    ("state", "state", "left"),
    ("started", "started", "left"),
    ("evaluations", "evaluations", "right"),
    ("failed", "failed", "right"),
    ("hypervolume", "hypervolume", "right"),
    ("reason", "reason", "left"),
)

_SHOWN = f"(value) => value === null ? '' : ({NUMBER})(Number(value.toPrecision(4)))"


class HistoryPanel:
    """A table of runs, read again on request; the chosen ones are opened or compared."""

    def __init__(self, viewer: Viewer, history: History) -> None:
        self._viewer = viewer
        self._history = history
        with ui.element("div").classes("card-head"):
            self._filter = ui.input("filter by id, state or reason", on_change=self.read)
            self._filter.props("dense outlined clearable debounce=300").classes("filter")
            ui.button("Read again", icon="refresh", on_click=self.read, color=None).props(
                "no-caps flat"
            )
            for text, act in (("Open", self._open), ("Compare", self._compare)):
                ui.button(text, on_click=act, color=None).props("no-caps unelevated").classes("act")
            self._trouble = ui.label().classes("refused grow").props('role="status"')
        self._plot = ui.echart(dict(EMPTY)).classes("chart slice").mark("comparison")
        self._plot.props('role="img" aria-label="hypervolume of the compared runs"')
        self._plot.set_visibility(False)
        self._table = ui.table(
            columns=[
                {"name": name, "label": label, "field": name, "align": align, "sortable": True}
                | ({":format": _SHOWN} if name == "hypervolume" else {})
                for name, label, align in _COLUMNS
            ],
            rows=[],
            row_key="run_id",
            selection="multiple",
            pagination=12,
        )
        self._table.add_slot("header-selection", '<span class="unseen">choice</span>')
        self._table.add_slot("body-selection", CHOICE)
        self._table.classes("history-table").props("dense flat")

    async def read(self) -> None:
        """Show the runs as they are now."""
        runs = await asyncio.to_thread(self._history.runs, self._filter.value or "")
        self._table.rows = [_row(run) for run in runs]

    async def _open(self) -> None:
        """Show the chosen run in the place of the active one."""
        names = self._chosen()
        if len(names) != 1:
            self._trouble.set_text("Choose one run to open.")
            return
        runs = await self._read(names)
        if runs:
            self._viewer.show_past(runs[0])

    async def _compare(self) -> None:
        """Show the hypervolumes of the chosen runs on one plot."""
        names = self._chosen()
        if not names:
            self._trouble.set_text("Choose the runs to compare.")
            return
        runs = await self._read(names)
        self._plot.set_visibility(bool(runs))
        if runs:
            show(self._plot, charts.compared(runs, self._viewer.colours))

    def _chosen(self) -> list[str]:
        return [str(row.get("run_id")) for row in self._table.selected][:MAX_COMPARED]

    async def _read(self, names: Sequence[str]) -> list[RunBoard]:
        """Read runs; empty, and the reason is shown, if one cannot be read."""
        try:
            runs = [await asyncio.to_thread(self._history.board_of, name) for name in names]
        except UserError as error:
            self._trouble.set_text(str(error))
            return []
        self._trouble.set_text("")
        return runs


def _row(run: PastRun) -> dict[str, Any]:
    hypervolume = None if run.hypervolume is None else float(f"{run.hypervolume:.6g}")
    return {**vars(run), "started": run.started[:19].replace("T", " "), "hypervolume": hypervolume}

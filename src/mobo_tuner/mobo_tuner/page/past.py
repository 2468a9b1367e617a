"""The runs of the folder, with a filter."""

from __future__ import annotations

import asyncio
from typing import Any

from nicegui import ui

from mobo_tuner.page.history import History, PastRun

_COLUMNS = (
    ("run_id", "run", "left"),
    ("state", "state", "left"),
    ("started", "started", "left"),
    ("evaluations", "evaluations", "right"),
    ("failed", "failed", "right"),
    ("hypervolume", "hypervolume", "right"),
    ("reason", "reason", "left"),
)


class HistoryPanel:
    """A table of runs, read again on request."""

    def __init__(self, history: History) -> None:
        self._history = history
        with ui.element("div").classes("card-head"):
            self._filter = ui.input("filter by id, state or reason", on_change=self.read)
            self._filter.props("dense outlined clearable debounce=300").classes("filter")
            ui.button("Read again", icon="refresh", on_click=self.read, color=None).props(
                "no-caps flat"
            )
        self._table = ui.table(
            columns=[
                {"name": name, "label": label, "field": name, "align": align, "sortable": True}
                for name, label, align in _COLUMNS
            ],
            rows=[],
            row_key="run_id",
            pagination=12,
        )
        self._table.classes("history-table").props("dense flat")

    async def read(self) -> None:
        """Show the runs as they are now."""
        runs = await asyncio.to_thread(self._history.runs, self._filter.value or "")
        self._table.rows = [_row(run) for run in runs]


def _row(run: PastRun) -> dict[str, Any]:
    hypervolume = None if run.hypervolume is None else float(f"{run.hypervolume:.6g}")
    return {**vars(run), "started": run.started.replace("T", " "), "hypervolume": hypervolume}

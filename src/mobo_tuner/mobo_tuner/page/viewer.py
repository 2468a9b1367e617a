"""What one viewer has chosen, and the small elements that all parts of the page are made of."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from nicegui import ui

from mobo_tuner.client import Point
from mobo_tuner.page import chart_parts
from mobo_tuner.page.board import Board, RunBoard
from mobo_tuner.page.commands import Answer, Commands


@dataclass
class Viewer:
    """One open page.

    Attributes:
        board: What is known.
        commands: Requests to the tuner; None if this viewer may only read.
        dark: Whether it is shown in the dark.
        chosen: Index of the chosen point.
        x: Objective of the horizontal axis; empty = the first.
        y: Objective of the vertical axis; empty = the second.
        brush: Intervals of objectives and variables in which points are wanted, by name.
        past: Run of the past that is shown in place of the active one; None for that.
        choices: Number of changes of what is above.
        say: Function that shows an answer of the tuner.
    """

    board: Board
    commands: Commands | None
    dark: bool = True
    chosen: int | None = None
    x: str = ""
    y: str = ""
    brush: dict[str, list[tuple[float, float]]] = field(default_factory=dict)
    past: RunBoard | None = None
    choices: int = 0
    say: Callable[[Answer], None] = field(default=lambda _: None)

    @property
    def colours(self) -> chart_parts.Colours:
        """Colours of its plots."""
        return chart_parts.DARK if self.dark else chart_parts.LIGHT

    @property
    def run(self) -> RunBoard | None:
        """Run that is shown."""
        return self.past or self.board.run

    def show_past(self, run: RunBoard | None) -> None:
        """Show a run of the past, or the active one again."""
        self.past, self.chosen = run, None
        self.brush.clear()
        self.choices += 1

    def wants(self, point: Point) -> bool:
        """Return whether a point lies in all intervals that the viewer brushed."""
        problem = None if self.run is None else self.run.problem
        places = {
            v.name: v.rank(point.setpoint[v.name])
            for v in (problem.variables if problem is not None else ())
            if v.name in point.setpoint
        }
        values = {**point.setpoint, **places, **point.objectives}
        return all(
            any(low <= values.get(name, math.nan) <= high for low, high in intervals)
            for name, intervals in self.brush.items()
        )

    def choose(self, index: int | None) -> None:
        """Choose a point of the front or another feasible evaluation, if it is one."""
        run = self.run
        if index is None or (run is not None and run.point(index) is not None):
            self.chosen = index
            self.choices += 1


def card(name: str, title: str = "") -> ui.element:
    """Return a section of the page; `name` is its class and its mark in tests."""
    section = ui.element("section").classes(f"card {name}")
    if title:
        with section:
            ui.label(title).classes("card-title").props('role="heading" aria-level="2"')
    return section


class Table:
    """Rows of labels, which are updated in place; they are made again only if their names change.

    Args:
        columns: Class of each column.
        classes: Classes of the whole table.
    """

    def __init__(self, columns: Sequence[str], classes: str) -> None:
        self._columns = columns
        self._body = ui.element("div").classes(f"rows {classes}").props('role="table"')
        self._rows: dict[str, list[ui.label]] = {}

    def show(self, rows: Sequence[Sequence[str]], tones: Sequence[str] = ()) -> None:
        """Show rows, each with its name first.

        Args:
            rows: Texts of each row.
            tones: Classes of each row.
        """
        if [row[0] for row in rows] != list(self._rows):
            self._make([row[0] for row in rows])
        for row in rows:
            for label, text in zip(self._rows[row[0]], row, strict=True):
                label.set_text(text)
        for row, tone in zip(rows, tones, strict=False):
            parent = self._rows[row[0]][0].parent_slot
            if parent is not None and parent.parent.classes != ["row-line", *tone.split()]:
                parent.parent.classes(replace=f"row-line {tone}")

    def _make(self, names: Sequence[str]) -> None:
        self._body.clear()
        self._rows.clear()
        with self._body:
            for name in dict.fromkeys(names):
                with ui.element("div").classes("row-line").props('role="row"'):
                    self._rows[name] = [
                        ui.label().classes(column).props('role="cell"') for column in self._columns
                    ]

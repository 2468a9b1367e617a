"""Dialogs that say what would change before it does."""

from __future__ import annotations

import math
from collections.abc import Awaitable, Callable
from typing import Any

from nicegui import ui

from mobo_tuner.client import Point
from mobo_tuner.core.problem import Variable
from mobo_tuner.displays.settings import labelled, setting_value, settings_of
from mobo_tuner.page.commands import Answer, Commands
from mobo_tuner.page.viewer import Table, Viewer
from mobo_tuner.page.words import evaluations, number, place, quantity, set_to


class Dialog:
    """A question with one action; a refusal of the tuner is shown in it.

    Args:
        viewer: Viewer who is asked.
        title: Question, or what the dialog is for.
        text: Further sentence.
        action: Text of the button that acts.
        act: Function that acts; None closes the dialog without a word.
        grave: Whether the action moves or ends something: then the other button has the focus.
        classes: Classes of the dialog.
    """

    def __init__(
        self,
        viewer: Viewer,
        title: str,
        text: str,
        action: str,
        act: Callable[[], Awaitable[Answer]],
        *,
        grave: bool = False,
        classes: str = "",
    ) -> None:
        self._viewer = viewer
        self._act = act
        with ui.dialog() as self._dialog, ui.element("div").classes(f"dialog {classes}"):
            self.title = ui.label(title).classes("dialog-title")
            self.title.props('role="heading" aria-level="2"')
            self._dialog.props["aria-labelledby"] = self.title.html_id
            self.text = ui.label(text).classes("" if grave else "quiet")
            self.body = ui.element("div").classes("dialog-body")
            self._refusal = ui.label().classes("refused").props('role="alert"').mark("refusal")
            with ui.element("div").classes("dialog-buttons"):
                back = ui.button(
                    "No, go back" if grave else "Close", on_click=self._dialog.close, color=None
                )
                back.props("no-caps flat autofocus" if grave else "no-caps flat")
                button = ui.button(action, on_click=self._pressed, color=None)
                button.props("no-caps unelevated").classes("" if grave else "act")

    def open(self) -> None:
        """Ask."""
        self._refusal.set_text("")
        self._dialog.open()

    async def _pressed(self) -> None:
        """Act; close the dialog if the tuner agreed, and otherwise show its sentence there."""
        answer = await self._act()
        if answer.agreed:
            self._dialog.close()
            self._viewer.say(answer)
        else:
            self._refusal.set_text(answer.sentence)


class GoDialog(Dialog):
    """A move to the chosen point, every device with its old and new value first."""

    def __init__(self, viewer: Viewer, commands: Commands) -> None:
        super().__init__(
            viewer, "", "", "Move the machine", self._send, grave=True, classes="go-dialog"
        )
        self._commands = commands
        self._point: Point | None = None
        self._run_id = ""
        with self.body:
            self._warning = ui.label().classes("refused")
            self._table = Table(("name", "way", "travel"), "go-rows")
            self._hold = ui.number(
                "evaluations to hold it against drift", value=0, min=0, step=1, format="%d"
            ).props("dense outlined")

    def open(self) -> None:
        """Show what would move, and ask."""
        board, run = self._viewer.board, self._viewer.board.run
        point = None if run is None else run.point(self._viewer.chosen)
        if run is None or run.problem is None or point is None or self._viewer.past is not None:
            self._viewer.say(Answer(False, "choose a point of this run first"))
            return
        self._point, self._run_id = point, run.run_id
        units = run.problem.units
        self.title.set_text(f"Go to the point of evaluation {point.index}?")
        values = [
            f"{name} {quantity(value, units.get(name, ''), 4)}"
            for name, value in point.objectives.items()
        ]
        self.text.set_text("There: " + ", ".join(values))
        self._warning.set_text(
            "A run is active: the tuner goes nowhere else before it has ended."
            if board.is_running
            else ""
        )
        rows = []
        for variable in run.problem.variables:
            name, here = variable.name, board.here.get(variable.name, math.nan)
            new = point.setpoint.get(name, math.nan)
            span = variable.maximum - variable.minimum
            way = f"{place(here, span)} → {place(new, span, variable.unit)}"
            if variable.choice_names:
                way = f"{set_to(variable, here)} → {set_to(variable, new)}"
            elif variable.approach:
                way += (
                    f", approached from {quantity(variable.approach, variable.unit, 4)} beside it"
                )
            rows.append((name, way, travel(variable, here, new)))
        self._table.show(rows)
        super().open()

    async def _send(self) -> Answer:
        point = self._point
        assert point is not None
        assert point.index is not None
        hold = whole(self._hold.value, 0)
        if hold is None:
            return _refused("evaluations to hold it", self._hold.value, 0)
        self._dialog.close()
        self._viewer.say(
            Answer(True, f"the machine is sent to the point of evaluation {point.index}")
        )
        answer = await self._commands.go(point.index, self._run_id, hold)
        self._viewer.say(answer)
        return answer


def travel(variable: Variable, here: float, new: float) -> str:
    """Return how far a variable goes, as a share of its range, in words."""
    if math.isnan(here):
        return "from an unknown place"
    reach = variable.maximum - variable.minimum
    if variable.choice_names:
        return "stays" if variable.shown(here) == variable.shown(new) else "changes"
    if reach <= 0.0:
        return "stays" if new == here else "it is fixed"
    if new == here:
        return "stays"
    share = abs(new - here) / reach
    if variable.scale == "log":
        share = 0.5 * abs(variable.normalize(new) - variable.normalize(here))
    return f"{share:.0%} of its range"


class QueueDialog(Dialog):
    """A set-point of the operator's own."""

    def __init__(self, viewer: Viewer, commands: Commands) -> None:
        super().__init__(
            viewer,
            "Queue a set-point",
            "The run evaluates it before its next suggestion.",
            "Queue it",
            self._send,
        )
        self._commands = commands
        self._fields: dict[str, ui.number | ui.select] = {}
        self.body.classes("fields")

    def open(self) -> None:
        """Show the fields, filled with the chosen point or with where the machine is."""
        board, run = self._viewer.board, self._viewer.board.run
        if run is None or run.problem is None:
            self._viewer.say(Answer(False, "no run is known yet"))
            return
        point = run.point(self._viewer.chosen)
        values = board.here if point is None else point.setpoint
        self.body.clear()
        self._fields.clear()
        with self.body:
            for variable in run.problem.variables:
                value = proposed(variable, values.get(variable.name))
                if variable.choices:
                    words = {choice: variable.shown(choice) for choice in variable.choices}
                    label = labelled(variable.name, variable.unit)
                    choice = ui.select(words, label=label, value=value)
                    self._fields[variable.name] = choice.props("dense outlined")
                    continue
                label = f"{labelled(variable.name, variable.unit)}, "
                label += f"{number(variable.minimum)} to {number(variable.maximum)}"
                if variable.fixed is not None:
                    label += f", fixed at {number(variable.fixed)}"
                elif variable.step:
                    label += f", in steps of {number(variable.step)}"
                field = ui.number(label, value=value)
                self._fields[variable.name] = field.props("dense outlined step=any")
        super().open()

    async def _send(self) -> Answer:
        empty = [name for name, field in self._fields.items() if field.value is None]
        if empty:
            return Answer(False, f"{empty[0]} is empty; a number is allowed")
        setpoint = {name: float(field.value) for name, field in self._fields.items()}
        return await self._commands.queue(setpoint)


class ChangeDialog(Dialog):
    """Bounds, limits, references and the budget, old and new side by side; all change, or none."""

    def __init__(self, viewer: Viewer, commands: Commands) -> None:
        super().__init__(
            viewer,
            "Change bounds, limits, references or the budget",
            "What is left empty stays. The run applies all of it before its next evaluation, or nothing.",
            "Apply",
            self._send,
            classes="change-dialog",
        )
        self._commands = commands
        self._fields: dict[str, ui.number] = {}
        self.body.classes("settings")

    def open(self) -> None:
        """Show the values of now."""
        board, run = self._viewer.board, self._viewer.board.run
        if run is None or run.problem is None:
            self._viewer.say(Answer(False, "no run is known yet"))
            return
        self.body.clear()
        self._fields.clear()
        with self.body:
            for setting in settings_of(run.problem, board.status.budget):
                with ui.element("div").classes("setting"):
                    ui.label(setting.label).classes("name")
                    ui.label(f"now {number(setting.value, 6)}").classes("old")
                    field = ui.number("new").props("dense outlined step=any")
                    field.props["aria-label"] = f"new {setting.label}"
                    self._fields[setting.name] = field.mark(setting.name)
        super().open()

    async def _send(self) -> Answer:
        given = {n: f.value for n, f in self._fields.items() if f.value is not None}
        if not given:
            return Answer(False, "nothing is filled in")
        values: dict[str, Any] = {name: setting_value(name, value) for name, value in given.items()}
        return await self._commands.set(values)


class MoreDialog(Dialog):
    """More evaluations after the end of a run, in a new run that begins with those of the old one."""

    def __init__(self, viewer: Viewer, commands: Commands) -> None:
        super().__init__(viewer, "More evaluations", "", "Begin", self._send)
        self._commands = commands
        with self.body:
            self._more = ui.number("evaluations more", value=10, min=1, step=1, format="%d")
            self._more.props("dense outlined")

    def open(self) -> None:
        """Show what the run has, and ask for how many more."""
        status = self._viewer.board.status
        self.text.set_text(
            f"A new run continues run {status.run_id} with its {evaluations(status.evaluations)}."
        )
        super().open()

    async def _send(self) -> Answer:
        status, more = self._viewer.board.status, whole(self._more.value, 1)
        if more is None:
            return _refused("evaluations more", self._more.value, 1)
        return await self._commands.more(status.run_id, status.evaluations + more)


def proposed(variable: Variable, value: float | None) -> float | None:
    """Return a value for a field: within the bounds, which a readback may be just outside of."""
    if value is None or not math.isfinite(value):
        return None
    if variable.choices:
        return min(variable.choices, key=lambda choice: abs(choice - value))
    return float(f"{min(max(value, variable.minimum), variable.maximum):.6g}")


def whole(value: Any, least: int) -> int | None:
    """Return what a field holds as an integer of at least `least`; None if it is none."""
    given = 0.0 if value is None else float(value)
    return int(given) if given.is_integer() and given >= least else None


def _refused(what: str, value: Any, least: int) -> Answer:
    shown = "empty" if value is None else number(float(value))
    return Answer(False, f"{what} is {shown}; an integer of at least {least} is allowed")

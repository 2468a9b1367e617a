"""What you can do: buttons, and dialogs that say what would change before it does."""

from __future__ import annotations

import math
from collections.abc import Awaitable, Callable
from typing import Any

from nicegui import ui

from mobo_tuner.client import Point
from mobo_tuner.core.problem import Variable
from mobo_tuner.displays.settings import labelled, setting_value, settings_of
from mobo_tuner.page.board import RunBoard
from mobo_tuner.page.commands import Answer, Commands
from mobo_tuner.page.viewer import Table, Viewer, card
from mobo_tuner.page.words import number, quantity

Request = Callable[[], Awaitable[Answer]]


class ActionsPanel:
    """The buttons, the last answer of the tuner, and the dialogs."""

    def __init__(self, viewer: Viewer, commands: Commands) -> None:
        self._viewer = viewer
        self._commands = commands
        viewer.say = self._say
        with card("actions"):
            with ui.element("div").classes("buttons"):
                self._pause = self._button("Pause", "pause", commands.pause)
                self._resume = self._button("Continue", "play_arrow", commands.resume)
                self._step = self._button("Step", "skip_next", commands.step)
                self._skip = self._button("Skip", "fast_forward", commands.skip)
                self._stop = self._dialog("Stop…", "stop", self._open_stop)
                self._halt = self._button("Halt the move", "front_hand", commands.cancel)
                self._go = self._dialog("Go to point…", "my_location", self._open_go)
                self._queue = self._dialog("Queue set-point…", "playlist_add", self._open_queue)
                self._change = self._dialog("Change…", "tune", self._open_change)
            self._answer = ui.label().classes("answer").props('role="status" aria-live="polite"')
            self._answer.mark("answer")
        self._stop_dialog = _Confirm(
            "Stop the run?",
            "The run ends after the current evaluation, and the machine stays at its set-point.",
            "Stop the run",
            lambda: self._ask(commands.stop),
        )
        self._go_dialog = GoDialog(viewer, commands)
        self._queue_dialog = QueueDialog(viewer, commands)
        self._change_dialog = ChangeDialog(viewer, commands)

    def refresh(self) -> None:
        """Enable the buttons that have an effect now."""
        board, status = self._viewer.board, self._viewer.board.status
        running, moving = board.is_running and not board.is_stale, status.state == "moving"
        paused = status.state == "paused"
        self._pause.set_visibility(not paused)
        self._resume.set_visibility(paused)
        self._halt.set_visibility(moving)
        for button, useful in (
            (self._pause, running),
            (self._step, running and paused),
            (self._skip, running and not paused),
            (self._stop, running),
            (self._queue, running),
            (self._change, board.run is not None and not board.is_stale),
            (self._go, self._viewer.chosen is not None and not board.is_stale),
        ):
            button.set_enabled(useful)

    def _button(self, text: str, icon: str, request: Request) -> ui.button:
        async def act() -> None:
            await self._ask(request)

        return _heard(ui.button(text, icon=icon, on_click=act, color=None))

    def _dialog(self, text: str, icon: str, open_dialog: Callable[[], None]) -> ui.button:
        return _heard(ui.button(text, icon=icon, on_click=open_dialog, color=None))

    def _open_stop(self) -> None:
        self._stop_dialog.open()

    def _open_go(self) -> None:
        self._go_dialog.open()

    def _open_queue(self) -> None:
        self._queue_dialog.open()

    def _open_change(self) -> None:
        self._change_dialog.open()

    async def _ask(self, request: Request) -> None:
        self._say(await request())

    def _say(self, answer: Answer) -> None:
        self._answer.set_text(answer.sentence)
        self._answer.classes(replace=f"answer {'agreed' if answer.agreed else 'refused'}")


def _heard(button: ui.button) -> ui.button:
    """Return a button of the panel whose presses are never dropped.

    It may be hidden or disabled while a press is on its way: then the tuner says why it came too late.
    """
    button.ignores_events_when_hidden = button.ignores_events_when_disabled = False
    return button.props("no-caps unelevated").classes("act")


class _Confirm:
    """A question before something that cannot be taken back."""

    def __init__(
        self, title: str, text: str, action: str, act: Callable[[], Awaitable[None]]
    ) -> None:
        async def confirmed() -> None:
            self._dialog.close()
            await act()

        with ui.dialog() as self._dialog, ui.element("div").classes("dialog"):
            _heading(title)
            ui.label(text)
            with ui.element("div").classes("dialog-buttons"):
                ui.button("No, go back", on_click=self._dialog.close, color=None).props(
                    "no-caps flat autofocus"
                )
                ui.button(action, on_click=confirmed, color=None).props("no-caps unelevated")

    def open(self) -> None:
        """Ask."""
        self._dialog.open()


class GoDialog:
    """A move to the chosen point, every device with its old and new value first."""

    def __init__(self, viewer: Viewer, commands: Commands) -> None:
        self._viewer = viewer
        self._commands = commands
        self._point: Point | None = None
        self._run_id = ""
        with ui.dialog() as self._dialog, ui.element("div").classes("dialog go-dialog"):
            self._title = _heading("")
            self._expected = ui.label().classes("quiet")
            self._warning = ui.label().classes("refused")
            self._table = Table(("name", "way", "travel"), "go-rows")
            self._hold = ui.number(
                "evaluations to hold it against drift", value=0, min=0, step=1, format="%d"
            ).props("dense outlined")
            with ui.element("div").classes("dialog-buttons"):
                ui.button("No, go back", on_click=self._dialog.close, color=None).props(
                    "no-caps flat autofocus"
                )
                self._act = ui.button("Move the machine", on_click=self._move, color=None)
                self._act.props("no-caps unelevated")

    def open(self) -> None:
        """Show what would move, and ask."""
        board, run = self._viewer.board, self._viewer.board.run
        point = _chosen(run, self._viewer.chosen)
        if run is None or run.problem is None or point is None:
            self._viewer.say(Answer(False, "choose a point of the front first"))
            return
        self._point, self._run_id = point, run.run_id
        units = run.problem.units
        self._title.set_text(f"Go to the point of evaluation {point.index}?")
        values = [
            f"{name} {quantity(value, units.get(name, ''), 4)}"
            for name, value in point.objectives.items()
        ]
        self._expected.set_text("There: " + ", ".join(values))
        self._warning.set_text(
            "A run is active: the tuner goes nowhere else before it has ended."
            if board.is_running
            else ""
        )
        rows = []
        for variable in run.problem.variables:
            name, here = variable.name, board.here.get(variable.name, math.nan)
            new = point.setpoint.get(name, math.nan)
            way = f"{number(here)} → {quantity(new, variable.unit)}"
            rows.append((name, way, travel(variable, here, new)))
        self._table.show(rows)
        self._dialog.open()

    async def _move(self) -> None:
        point = self._point
        if point is None or point.index is None:
            return
        self._dialog.close()
        hold = self._hold.value or 0
        self._viewer.say(
            Answer(True, f"the machine is sent to the point of evaluation {point.index}")
        )
        self._viewer.say(await self._commands.go(point.index, self._run_id, int(hold)))


def travel(variable: Variable, here: float, new: float) -> str:
    """Return how far a variable goes, as a share of its range, in words."""
    if math.isnan(here):
        return "from an unknown place"
    reach = variable.maximum - variable.minimum
    if reach <= 0.0:
        return "stays" if new == here else "it is fixed"
    return f"{abs(new - here) / reach:.0%} of its range"


class QueueDialog:
    """A set-point of the operator's own."""

    def __init__(self, viewer: Viewer, commands: Commands) -> None:
        self._viewer = viewer
        self._commands = commands
        self._fields: dict[str, ui.number] = {}
        with ui.dialog() as self._dialog, ui.element("div").classes("dialog"):
            _heading("Queue a set-point")
            ui.label("The run evaluates it before its next suggestion.").classes("quiet")
            self._body = ui.element("div").classes("fields")
            self._refusal = ui.label().classes("refused").props('role="alert"')
            with ui.element("div").classes("dialog-buttons"):
                ui.button("Close", on_click=self._dialog.close, color=None).props("no-caps flat")
                ui.button("Queue it", on_click=self._send, color=None).props(
                    "no-caps unelevated"
                ).classes("act")

    def open(self) -> None:
        """Show the fields, filled with the chosen point or with where the machine is."""
        board, run = self._viewer.board, self._viewer.board.run
        if run is None or run.problem is None:
            self._viewer.say(Answer(False, "no run is known yet"))
            return
        point = _chosen(run, self._viewer.chosen)
        values = board.here if point is None else point.setpoint
        self._body.clear()
        self._refusal.set_text("")
        with self._body:
            for variable in run.problem.variables:
                value = values.get(variable.name)
                label = f"{labelled(variable.name, variable.unit)}, "
                label += f"{number(variable.minimum)} to {number(variable.maximum)}"
                field = ui.number(label, value=None if value is None else float(f"{value:.6g}"))
                self._fields[variable.name] = field.props("dense outlined step=any")
        self._fields = {v.name: self._fields[v.name] for v in run.problem.variables}
        self._dialog.open()

    async def _send(self) -> None:
        setpoint = {name: _float(field.value) for name, field in self._fields.items()}
        answer = await self._commands.queue(setpoint)
        _conclude(answer, self._refusal, self._dialog, self._viewer)


class ChangeDialog:
    """Bounds, limits, references and the budget, old and new side by side; all change, or none."""

    def __init__(self, viewer: Viewer, commands: Commands) -> None:
        self._viewer = viewer
        self._commands = commands
        self._fields: dict[str, ui.number] = {}
        with ui.dialog() as self._dialog, ui.element("div").classes("dialog change-dialog"):
            _heading("Change bounds, limits, references or the budget")
            ui.label(
                "What is left empty stays. The run applies all of it before its next evaluation, or nothing."
            ).classes("quiet")
            self._body = ui.element("div").classes("settings")
            self._refusal = ui.label().classes("refused").props('role="alert"').mark("refusal")
            with ui.element("div").classes("dialog-buttons"):
                ui.button("Close", on_click=self._dialog.close, color=None).props("no-caps flat")
                ui.button("Apply", on_click=self._send, color=None).props(
                    "no-caps unelevated"
                ).classes("act")

    def open(self) -> None:
        """Show the values of now."""
        board, run = self._viewer.board, self._viewer.board.run
        if run is None or run.problem is None:
            self._viewer.say(Answer(False, "no run is known yet"))
            return
        self._body.clear()
        self._fields.clear()
        self._refusal.set_text("")
        with self._body:
            for setting in settings_of(run.problem, board.status.budget):
                with ui.element("div").classes("setting"):
                    ui.label(setting.label).classes("name")
                    ui.label(f"now {number(setting.value, 6)}").classes("old")
                    field = ui.number("new").props("dense outlined step=any")
                    field.props["aria-label"] = f"new {setting.label}"
                    self._fields[setting.name] = field.mark(setting.name)
        self._dialog.open()

    async def _send(self) -> None:
        given = {n: f.value for n, f in self._fields.items() if f.value is not None}
        if not given:
            self._refusal.set_text("nothing is filled in")
            return
        values: dict[str, Any] = {name: setting_value(name, value) for name, value in given.items()}
        answer = await self._commands.set(values)
        _conclude(answer, self._refusal, self._dialog, self._viewer)


def _chosen(run: RunBoard | None, index: int | None) -> Point | None:
    points = run.front.points if run is not None and run.front is not None else ()
    return next((point for point in points if point.index == index), None)


def _conclude(answer: Answer, refusal: ui.label, dialog: ui.dialog, viewer: Viewer) -> None:
    """Close a dialog if the tuner agreed; otherwise show its sentence there."""
    if answer.agreed:
        refusal.set_text("")
        dialog.close()
        viewer.say(answer)
    else:
        refusal.set_text(answer.sentence)


def _heading(text: str) -> ui.label:
    return ui.label(text).classes("dialog-title").props('role="heading" aria-level="2"')


def _float(value: Any) -> float:
    return math.nan if value is None else float(value)

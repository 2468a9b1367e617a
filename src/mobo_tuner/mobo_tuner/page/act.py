"""What you can do: buttons, the tuner's answers, and what it asks."""

from __future__ import annotations

import time
from collections.abc import Awaitable, Callable

from nicegui import ui

from mobo_tuner.page.commands import Answer, Commands
from mobo_tuner.page.dialogs import ChangeDialog, Dialog, GoDialog, MoreDialog, QueueDialog
from mobo_tuner.page.viewer import Viewer, card
from mobo_tuner.page.words import evaluations

ENDS_WELL = ("budget", "hypervolume_goal", "time", "stagnation", "little_expected")
ANSWER_TIME = 30.0  # [s] that what the tuner agreed to stays beside the buttons; a refusal stays until the next answer

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
                self._go = self._dialog("Go to point…", "my_location", self.open_go)
                self._queue = self._dialog("Queue set-point…", "playlist_add", self._open_queue)
                self._change = self._dialog("Change…", "tune", self._open_change)
            self._agreed_at: float | None = None  # by `time.monotonic` [s]
            self._answer = ui.label().classes("answer").props('role="status" aria-live="polite"')
            self._answer.mark("answer")
            self._question = Question(viewer, commands, self)
        self._stop_dialog = Dialog(
            viewer,
            "Stop the run?",
            "The run ends after the current evaluation, and the machine stays at its set-point.",
            "Stop the run",
            commands.stop,
            grave=True,
        )
        self._go_dialog = GoDialog(viewer, commands)
        self._more_dialog = MoreDialog(viewer, commands)
        self._restore_dialog = Dialog(
            viewer,
            "Restore the machine?",
            "The machine goes back to where it was before the run.",
            "Move the machine",
            lambda: commands.restore(viewer.board.status.run_id),
            grave=True,
        )
        self._queue_dialog = QueueDialog(viewer, commands)
        self._change_dialog = ChangeDialog(viewer, commands)

    def refresh(self) -> None:
        """Enable the buttons that have an effect now."""
        board, status = self._viewer.board, self._viewer.board.status
        running, moving = board.is_running and not board.is_stale, status.state == "moving"
        paused = status.state == "paused"
        self._question.refresh()
        if self._agreed_at is not None and time.monotonic() - self._agreed_at > ANSWER_TIME:
            self._agreed_at = None
            self._answer.set_text("")
        past = self._viewer.past is not None
        self._pause.set_visibility(not paused)
        self._resume.set_visibility(paused and not status.asks)  # then it is "Try again"
        self._halt.set_visibility(moving)
        for button, useful in (
            (self._pause, running),
            (self._step, running and paused),
            (self._skip, running and (not paused or status.asks)),
            (self._stop, running),
            (self._queue, running),
            (self._change, board.run is not None and not board.is_stale),
            (self._go, self._viewer.chosen is not None and not board.is_stale and not past),
        ):
            button.set_enabled(useful)

    def _button(self, text: str, icon: str, request: Request) -> ui.button:
        async def act() -> None:
            await self.ask(request)

        return _heard(ui.button(text, icon=icon, on_click=act, color=None))

    def _dialog(self, text: str, icon: str, open_dialog: Callable[[], None]) -> ui.button:
        return _heard(ui.button(text, icon=icon, on_click=open_dialog, color=None))

    def open_more(self) -> None:
        """Ask for more evaluations."""
        self._more_dialog.open()

    def open_restore(self) -> None:
        """Ask whether to go back to where the machine was before the run."""
        self._restore_dialog.open()

    def open_go(self) -> None:
        """Ask whether to go to the chosen point."""
        self._go_dialog.open()

    async def ask(self, request: Request) -> None:
        """Make a request of the tuner, and show its answer."""
        self._say(await request())

    def _open_stop(self) -> None:
        self._stop_dialog.open()

    def _open_queue(self) -> None:
        self._queue_dialog.open()

    def _open_change(self) -> None:
        self._change_dialog.open()

    def _say(self, answer: Answer) -> None:
        self._agreed_at = time.monotonic() if answer.agreed else None
        self._answer.set_text(answer.sentence)
        self._answer.classes(replace=f"answer {'agreed' if answer.agreed else 'refused'}")


def _heard(button: ui.button) -> ui.button:
    """Return a button of the panel whose presses are never dropped.

    It may be hidden or disabled while a press is on its way: then the tuner says why it came too late.
    """
    button.ignores_events_when_hidden = button.ignores_events_when_disabled = False
    return button.props("no-caps unelevated").classes("act")


class Question:
    """What the tuner asks: what to do with a failed evaluation, and what to do at the end of a run.

    Args:
        viewer: Viewer who is asked.
        commands: Requests to the tuner.
        panel: Panel that makes them, and has the dialogs.
    """

    def __init__(self, viewer: Viewer, commands: Commands, panel: ActionsPanel) -> None:
        self._viewer = viewer
        self._left = ""  # id of the run that the viewer leaves as it is

        def asking(request: Request) -> Callable[[], Awaitable[None]]:
            return lambda: panel.ask(request)

        with ui.element("div").classes("question").props('role="alert"') as self._body:
            self._text = ui.label().classes("question-text")
            self._of_failure = [
                self._button("Try again", asking(commands.resume)),
                self._button("Skip it", asking(commands.skip)),
                self._button("End the run", asking(commands.stop)),
            ]
            self._of_end = [
                self._button("More evaluations…", panel.open_more),
                self._button("Go to the chosen point…", panel.open_go),
                self._button("Restore…", panel.open_restore),
                self._button("Leave it", self._leave),
            ]

    def refresh(self) -> None:
        """Show what is asked now, if anything is."""
        board, status = self._viewer.board, self._viewer.board.status
        fresh = not board.is_stale and self._viewer.past is None
        failure = fresh and status.asks
        ended = status.state == "idle" and status.stop_reason in ENDS_WELL
        end = fresh and ended and self._left != status.run_id
        self._body.set_visibility(failure or end)
        for button in self._of_failure:
            button.set_visibility(failure)
        for button in self._of_end:
            button.set_visibility(end)
        if failure:
            self._text.set_text(f"{status.message}. What now?")
        elif end:
            done = evaluations(status.evaluations)
            self._text.set_text(f"The run has ended after {done}. What now?")

    def _leave(self) -> None:
        self._left = self._viewer.board.status.run_id
        self.refresh()

    def _button(self, text: str, act: Callable[[], object]) -> ui.button:
        return _heard(ui.button(text, on_click=act, color=None))

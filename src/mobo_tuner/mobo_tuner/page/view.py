"""The page of one viewer: its parts, and their refreshing."""

from __future__ import annotations

import json
import math
import time

from nicegui import ui

from mobo_tuner.page.act import ActionsPanel
from mobo_tuner.page.board import Board
from mobo_tuner.page.commands import Commands
from mobo_tuner.page.found import (
    CoordinatesPanel,
    FrontPanel,
    HypervolumePanel,
    ObjectivesPanel,
    PointsPanel,
)
from mobo_tuner.page.history import History
from mobo_tuner.page.insights import Insights
from mobo_tuner.page.now import HealthPanel, MotionPanel, StatePanel
from mobo_tuner.page.past import HistoryPanel
from mobo_tuner.page.viewer import Viewer
from mobo_tuner.page.why import ConstraintsPanel, DiagnosticsPanel, ModelsPanel, VariablesPanel
from mobo_tuner.page.words import duration, state_of

PERIOD = 0.4  # [s] at least between two refreshes, each of which costs a browser much more than the server
PLOT_PERIOD = 0.8  # [s] at least between two drawings of the plots
LONG_RUN = 1000  # evaluations of a run whose plots are drawn four times as rarely


class View:
    """One open page.

    It is built once; later only what has changed is sent to the browser.

    Args:
        board: What is known.
        commands: Requests to the tuner; None if this viewer may only read.
        history: Runs of the folder.
        insights: What the models of these runs say.
        dark: Whether the page begins in the dark.
    """

    def __init__(
        self,
        board: Board,
        commands: Commands | None,
        history: History,
        insights: Insights,
        *,
        dark: bool,
    ) -> None:
        self._viewer = viewer = Viewer(board, commands, dark=dark)
        self._refreshed = 0.0  # when anything was, by `time.monotonic` [s]
        self._urgent: tuple[object, ...] = ()  # what is shown at once
        self._drawn = 0.0  # when the plots were drawn, by `time.monotonic` [s]
        self._shown: tuple[object, ...] = ()
        self._title = ""
        self._dark = ui.dark_mode(value=dark)
        self._build_header()
        with ui.element("div").classes("board"):
            self._state = StatePanel(viewer)
            self._motion = MotionPanel(viewer)
            self._health = HealthPanel(viewer)
            self._actions = ActionsPanel(viewer, commands) if commands is not None else None
            self._front = FrontPanel(viewer)
            with ui.element("div").classes("side"):
                self._hypervolume = HypervolumePanel(viewer)
                self._objectives = ObjectivesPanel(viewer)
            self._points = PointsPanel(viewer)
            with ui.element("section").classes("card details"):
                self._build_details(history, insights)

    def _build_header(self) -> None:
        with ui.element("header").classes("top"):
            ui.label("MOBO").classes("brand").props('role="heading" aria-level="1"')
            self._run_id = ui.label().classes("run-id").mark("run-id")
            self._back = ui.button(
                "Back to now", on_click=lambda: self._viewer.show_past(None), color=None
            )
            self._back.props("no-caps unelevated").classes("act")
            self._live = ui.label().classes("live").mark("live")
            if self._viewer.commands is None:
                ui.label("read only").classes("badge")
            self._toggle = ui.button(icon="contrast", on_click=self._switch, color=None)
            self._toggle.props('flat round dense aria-label="light or dark"')

    def _build_details(self, history: History, insights: Insights) -> None:
        with ui.tabs().props("no-caps align=left dense inline-label") as tabs:
            ui.tab("coordinates", label="All coordinates")
            ui.tab("variables", label="Variables")
            ui.tab("diagnostics", label="Diagnostics")
            ui.tab("constraints", label="Constraints")
            ui.tab("models", label="Models")
            ui.tab("history", label="History")
        with ui.tab_panels(tabs, value="coordinates", animated=False, keep_alive=False) as panels:
            with panel("coordinates"):
                coordinates = CoordinatesPanel(self._viewer)
            with panel("variables"):
                variables = VariablesPanel(self._viewer)
            with panel("diagnostics"):
                diagnostics = DiagnosticsPanel(self._viewer)
            with panel("constraints"):
                constraints = ConstraintsPanel(self._viewer)
            with panel("models"):
                models = ModelsPanel(self._viewer, insights)
            with panel("history"):
                past = HistoryPanel(self._viewer, history)
        self._panels = panels
        self._details = {
            "coordinates": coordinates.refresh,
            "variables": variables.refresh,
            "diagnostics": diagnostics.refresh,
            "constraints": constraints.refresh,
            "models": models.refresh,
        }

        async def opened() -> None:
            self.refresh()
            if panels.value == "history":
                await past.read()

        panels.on_value_change(opened)

    def refresh(self) -> None:
        """Show everything as it is now.

        A new state, a question and what the viewer did are shown at once, and all else together, seldom: every message
        has the browser look at the whole page. While a suggestion begins, that waits, too: on a computer of few cores,
        what browsers draw would delay it.
        """
        board, moment = self._viewer.board, time.monotonic()
        chosen = (self._viewer.choices, self._viewer.dark, self._panels.value)
        chosen_now = self._shown[1:] != chosen
        status = board.status
        urgent = (state_of(board).word, status.run_id, status.asks, chosen)
        is_due = moment - self._refreshed >= PERIOD and not board.begins_suggestion
        if urgent == self._urgent and not is_due:
            return
        self._urgent, self._refreshed = urgent, moment
        self._state.refresh()
        self._motion.refresh()
        self._health.refresh()
        if self._actions is not None:
            self._actions.refresh()
        self._refresh_header()
        run = self._viewer.run
        if run is None:
            return
        shown = (board.version if self._viewer.past is None else 0, *chosen)
        period = PLOT_PERIOD * (4.0 if len(run.evaluations) > LONG_RUN else 1.0)
        if shown == self._shown and self._panels.value == "models":
            self._details["models"](run)  # an answer may have come
        if shown == self._shown or (moment - self._drawn < period and not chosen_now):
            return
        self._shown, self._drawn = shown, moment
        for part in (self._front, self._hypervolume, self._objectives, self._points):
            part.refresh(run)
        refresh_details = self._details.get(str(self._panels.value))
        if refresh_details is not None:
            refresh_details(run)

    def _refresh_header(self) -> None:
        board = self._viewer.board
        run = self._viewer.run
        run_id = run.run_id if run is not None else ""
        old = self._viewer.past is not None
        self._back.set_visibility(old)
        past = f"past run {run_id}; state, move and health are those of now"
        self._run_id.set_text(past if old else f"run {run_id}" if run_id else "no run yet")
        fresh = not board.is_stale
        age = "no tuner" if math.isinf(board.age) else f"stale, {duration(board.age)} old"
        self._live.set_text("● live" if fresh else f"▲ {age}")
        self._live.classes(replace="live fresh" if fresh else "live stale")
        status = board.status
        title = f"{state_of(board).word} {status.evaluations}/{status.budget} {run_id}"
        if title != self._title:
            self._title = title
            self._toggle.client.run_javascript(f"document.title = {json.dumps(title)}")

    def _switch(self) -> None:
        self._viewer.dark = not self._viewer.dark
        self._dark.set_value(self._viewer.dark)
        self._viewer.choices += 1


def panel(name: str) -> ui.tab_panel:
    """Return a panel of the details, which the keyboard can scroll."""
    return ui.tab_panel(name).props('tabindex="0"')

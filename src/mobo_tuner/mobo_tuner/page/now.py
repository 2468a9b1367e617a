"""What is happening: the state in large words, what moves where, and how the parts are."""

from __future__ import annotations

import math

from nicegui import ui

from mobo_tuner.displays.progress import contexts_text
from mobo_tuner.page.board import Level
from mobo_tuner.page.viewer import Table, Viewer, card
from mobo_tuner.page.words import SYMBOLS, duration, place, set_to, state_of

LONG_MESSAGE = 16  # letters, of which more get a line of their own where there is little room
LEAST_TRAVEL = 0.003  # share of a variable's range below which it counts as staying where it is
_LEVEL_SYMBOLS: dict[Level, str] = {"ok": "✓", "warning": "!", "error": "✕", "stale": "?"}
_LEVEL_WORDS: dict[Level, str] = {
    "ok": "good",
    "warning": "warning",
    "error": "error",
    "stale": "no answer",
}


class StatePanel:
    """The state in large words, with one sentence, and how far the run is."""

    def __init__(self, viewer: Viewer) -> None:
        self._viewer = viewer
        with card("state") as self._card:
            with ui.element("div").classes("state-head"):
                self._icon = ui.icon("stop").classes("state-icon")
                self._word = ui.label().classes("state-word").props('role="status"')
                with ui.element("div").classes("state-count"):
                    self._count = ui.label().classes("count")
                    self._left = ui.label().classes("count-note")
            self._sentence = ui.label().classes("sentence").mark("sentence")
            self._bar = ui.linear_progress(0.0, show_value=False, size="10px")
            self._bar.props('aria-label="finished share of the evaluations" instant-feedback')
            with ui.element("div").classes("state-foot"):
                self._failure = ui.label().classes("failure")
                self._phase = ui.label().classes("phase")
            self._contexts = ui.label().classes("contexts").mark("contexts")
            self._hints = ui.label().classes("hints")

    def refresh(self) -> None:
        """Show the state as it is now."""
        board = self._viewer.board
        state, status, run = state_of(board), board.status, board.run
        self._card.classes(replace=f"card state tone-{state.tone}")
        self._icon.set_name(SYMBOLS[state.tone])
        self._word.set_text(state.word)
        self._sentence.set_text(state.sentence)
        done = max(status.evaluations, 0)
        self._count.set_text(f"{done} / {status.budget}" if status.budget else "")
        goes_on = board.is_running and status.state not in ("paused", "waiting")
        left = run.progress.seconds_left if run is not None and goes_on else math.nan
        notes = ["evaluations"] if status.budget else []
        notes += [f"about {duration(left)} left"] if math.isfinite(left) else []
        self._left.set_text(", ".join(notes))
        self._bar.set_value(min(done / status.budget, 1.0) if status.budget else 0.0)
        phase = ""
        if status.phase and status.state in ("evaluating", "moving"):
            phase = f"{status.phase} {status.fraction:.0%}"
        self._phase.set_text(phase)
        counts = f"{status.feasible} feasible, {status.failed} failed" if done else ""
        failure = f"last failure: {status.last_failure}" if status.last_failure else ""
        self._failure.set_text(" · ".join(filter(None, (counts, failure))))
        contexts = contexts_text(status)
        self._contexts.set_text(f"Context: {contexts}" if contexts else "")
        self._contexts.set_visibility(bool(contexts))
        self._hints.set_text(" ".join(status.hints))


class MotionPanel:
    """What the machine moves now: old and new value, and the readback on its way."""

    def __init__(self, viewer: Viewer) -> None:
        self._viewer = viewer
        with card("motion"):
            self._title = ui.label().classes("card-title").props('role="heading" aria-level="2"')
            self._table = Table(("name", "way", "here", "share"), "motion-rows")
            self._none = ui.label("The tuner has not moved the machine yet.").classes("quiet")

    def refresh(self) -> None:
        """Show the motion as it is now: another one at once, its readbacks less often."""
        board = self._viewer.board
        motion, run, state = board.motion, board.run, board.status.state
        active = state == "moving" or (board.is_running and state not in ("paused", "waiting"))
        problem = run.problem if run is not None else None
        units = problem.units if problem is not None else {}
        ranges = {v.name: v.maximum - v.minimum for v in problem.variables} if problem else {}
        self._title.set_text("What moves" if active else "Last move")
        rows = []
        for name, target in motion.target.items():
            unit = units.get(name, "")
            start, fraction = motion.start.get(name, math.nan), motion.fraction(name)
            here = motion.readbacks.get(name, math.nan)
            span = ranges.get(name, 0.0)
            way = f"{place(start, span)} → {place(target, span, unit)}"
            now = place(here, span)
            variable = None if problem is None else problem.variable(name)
            if variable is not None and variable.choice_names:
                way = f"{set_to(variable, start)} → {set_to(variable, target)}"
                now = set_to(variable, here)
            share = "" if math.isnan(fraction) else f"{fraction:.0%}"
            if abs(target - start) < LEAST_TRAVEL * span:
                share = "stays"
            rows.append((name, way, f"now {now}", share))
        self._table.show(rows)
        self._none.set_visibility(not rows)


class HealthPanel:
    """How the tuner, the machine, the recorder and the disk are."""

    def __init__(self, viewer: Viewer) -> None:
        self._viewer = viewer
        with card("health", "Health"):
            self._table = Table(("name", "level", "message"), "health-rows")
            self._none = ui.label("No node has said how it is yet.").classes("quiet")

    def refresh(self) -> None:
        """Show the health as it is now."""
        found: list[tuple[str, Level, str]] = []
        for part in self._viewer.board.parts():
            found.append((part.name, part.level, part.message))
            if part.disk is not None:
                found.append((f"{part.name.partition(': ')[0]}: disk", *part.disk))
        rows, tones = [], []
        for name, level, message in found:
            rows.append((name, f"{_LEVEL_SYMBOLS[level]} {_LEVEL_WORDS[level]}", message))
            tones.append(f"level-{level}" + " long" * (len(message) > LONG_MESSAGE))
        self._table.show(rows, tones)
        self._none.set_visibility(not rows)

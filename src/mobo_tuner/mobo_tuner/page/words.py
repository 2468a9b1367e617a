"""What the page says: the state in a word and a sentence, numbers with their units."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from mobo_tuner.page.board import Board

Tone = Literal["busy", "good", "wait", "bad", "still"]
"""Kind of a state, which has a colour and a symbol."""

SYMBOLS: Mapping[Tone, str] = {
    "busy": "play_arrow",
    "good": "check_circle",
    "wait": "pause",
    "bad": "warning",
    "still": "stop",
}
_SENTENCES = {
    "suggesting": "The tuner computes the next set-point; nothing moves.",
    "evaluating": "The machine goes to the next set-point and measures there.",
    "waiting": "The tuner waits for the machine; nothing moves.",
    "paused": "The run is paused: nothing moves until somebody continues it.",
    "canceling": "The run is being canceled.",
    "moving": "The machine is on its way to a working point.",
}
_WORDS: Mapping[str, tuple[str, Tone]] = {
    "suggesting": ("Running", "busy"),
    "evaluating": ("Running", "busy"),
    "waiting": ("Waiting", "wait"),
    "paused": ("Paused", "wait"),
    "canceling": ("Stopping", "still"),
    "moving": ("Moving", "busy"),
}
_ENDS: Mapping[str, tuple[str, Tone, str]] = {
    "budget": ("Finished", "good", "All evaluations are done; nothing moves."),
    "hypervolume_goal": ("Finished", "good", "The goal is reached; nothing moves."),
    "time": ("Finished", "good", "The time of the run is over; nothing moves."),
    "stagnation": (
        "Finished",
        "good",
        "The last evaluations gained next to nothing; nothing moves.",
    ),
    "little_expected": ("Finished", "good", "Little more is expected; nothing moves."),
    "stopped": ("Stopped", "still", "An operator stopped the run; nothing moves."),
    "canceled": ("Canceled", "still", "The run was canceled; nothing moves."),
    "error": ("Failed", "bad", "The run ended with an error."),
}


@dataclass(frozen=True)
class State:
    """The state in large words.

    Attributes:
        word: One word, or two.
        tone: Its kind.
        sentence: One sentence.
    """

    word: str
    tone: Tone
    sentence: str


def state_of(board: Board) -> State:
    """Return the state of a tuner in a word and a sentence."""
    status = board.status
    if math.isinf(board.age):
        return State("No tuner", "bad", "No tuner has been heard in this ROS domain yet.")
    if board.is_stale:
        text = f"The tuner has been silent for {duration(board.age)}: what is shown is old."
        return State("Tuner silent", "bad", text)
    if status.state == "idle" or (status.stop_reason and status.state != "moving"):
        word, tone, text = _ENDS.get(
            status.stop_reason, ("Idle", "still", "No run is active; nothing moves.")
        )
        return State(word, tone, status.message or text)
    text = status.message or _SENTENCES.get(status.state, "")
    word, tone = _WORDS.get(status.state, ("Unknown", "wait"))
    return State(word, tone, text)


def number(value: float, digits: int = 5) -> str:
    """Return a number for people; a dash if it is unknown."""
    if math.isnan(value):
        return "–"
    return f"{value:.{digits}g}".replace("-", "−")


def quantity(value: float, unit: str = "", digits: int = 5) -> str:
    """Return a number with its unit."""
    return f"{number(value, digits)} {unit}".rstrip()


def measured(value: float, stddev: float, unit: str = "") -> str:
    """Return a number with its standard deviation, if it is known, and its unit."""
    spread = f" ± {number(stddev, 2)}" if math.isfinite(stddev) else ""
    return f"{number(value, 4)}{spread} {unit}".rstrip()


def duration(seconds: float) -> str:
    """Return a time in hours, minutes and seconds."""
    if not math.isfinite(seconds):
        return "?"
    minutes, rest = divmod(round(seconds), 60)
    if minutes == 0:
        return f"{rest} s"
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02} h" if hours else f"{minutes}:{rest:02} min"

"""What the page says: the state in a word and a sentence, numbers with their units."""

from __future__ import annotations

import html
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from mobo_tuner.core.problem import Constraint, Variable
from mobo_tuner.core.units import raised
from mobo_tuner.page.board import Board

MOST_DECIMALS = 6
LARGEST_PLACE = 1e6  # that is written without an exponent

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


def first_words(board: Board, *, dark: bool) -> str:
    """Return the state in HTML, which a browser shows until it has read the framework's scripts.

    Args:
        board: What is known.
        dark: Whether the page begins in the dark.
    """
    state, status = state_of(board), board.status
    count = f"{status.evaluations} / {status.budget}" if status.budget else ""
    theme = "dark" if dark else "light"
    word, done, sentence = map(html.escape, (state.word, count, state.sentence))
    return (
        f"<script>document.body.classList.add('body--{theme}')</script>"
        f'<div class="first-words tone-{state.tone}"><div>'
        f"<span>{word}</span><span>{done}</span></div><p>{sentence}</p></div>"
    )


def number(value: float, digits: int = 5) -> str:
    """Return a number for people; a dash if it is unknown."""
    if math.isnan(value):
        return "–"
    mantissa, _, exponent = f"{value:.{digits}g}".partition("e")
    text = f"{mantissa}×10{raised(int(exponent))}" if exponent else mantissa
    return text.replace("-", "−")


def place(value: float, span: float, unit: str = "") -> str:
    """Return a set-point with its unit, to a ten-thousandth of its range, so that its digits do not jump.

    Args:
        value: Value of a variable.
        span: Range of the variable.
        unit: Its unit.
    """
    decimals = math.ceil(4.0 - math.log10(span)) if 0.0 < span < math.inf else MOST_DECIMALS + 1
    if not (0 <= decimals <= MOST_DECIMALS and abs(value) < LARGEST_PLACE):
        return quantity(value, unit)
    text = f"{round(value, decimals) + 0.0:.{decimals}f}".replace("-", "−")
    return f"{text} {unit}".rstrip()


def set_to(variable: Variable, value: float) -> str:
    """Return the value of a variable with its unit, or the name of a choice that has one."""
    if variable.choice_names and math.isfinite(value):
        return variable.shown(value)
    return place(value, variable.maximum - variable.minimum, variable.unit)


def limits(constraint: Constraint) -> str:
    """Return the limits of a constraint with their unit."""
    low, high, unit = constraint.minimum, constraint.maximum, constraint.unit
    if math.isfinite(low) and math.isfinite(high):
        return f"{number(low)} to {quantity(high, unit)}"
    return (
        f"at least {quantity(low, unit)}"
        if math.isfinite(low)
        else f"at most {quantity(high, unit)}"
    )


def quantity(value: float, unit: str = "", digits: int = 5) -> str:
    """Return a number with its unit."""
    return f"{number(value, digits)} {unit}".rstrip()


def measured(value: float, stddev: float, unit: str = "") -> str:
    """Return a number with its standard deviation, if it is known, and its unit."""
    spread = f" ± {number(stddev, 2)}" if math.isfinite(stddev) else ""
    return f"{number(value, 4)}{spread} {unit}".rstrip()


def evaluations(count: int) -> str:
    """Return a number of evaluations in words."""
    return f"{count} evaluation" if count == 1 else f"{count} evaluations"


def duration(seconds: float) -> str:
    """Return a time in hours, minutes and seconds."""
    if not math.isfinite(seconds):
        return "?"
    minutes, rest = divmod(round(seconds), 60)
    if minutes == 0:
        return f"{rest} s"
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02} h" if hours else f"{minutes}:{rest:02} min"

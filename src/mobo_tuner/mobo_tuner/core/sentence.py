"""Errors that are told to the user in one sentence, whatever they quote of what was read."""

from __future__ import annotations

LONGEST = 1000  # characters


class SentenceError(ValueError):
    """An error whose message is one line of bounded length, without control characters."""

    def __init__(self, message: str) -> None:
        super().__init__(one_line(message))


def one_line(text: str) -> str:
    """A text on one line, cut off where it is too long to be read."""
    line = " ".join("".join(c if c.isprintable() else " " for c in text[: 4 * LONGEST]).split())
    return line if len(line) <= LONGEST else f"{line[: LONGEST - 3]}..."

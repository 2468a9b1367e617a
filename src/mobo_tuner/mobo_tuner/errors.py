"""Errors whose message is one sentence for the user, with one base class."""

from __future__ import annotations

MAX_LENGTH = 1000  # characters


class UserError(ValueError):
    """An error for the user: its message is one line of bounded length, without control characters."""

    def __init__(self, message: str) -> None:
        super().__init__(one_line(message))


class FileError(UserError):
    """A file that cannot be read or whose content is not allowed."""


class ParameterError(UserError):
    """A parameter that is unknown or has a value that is not allowed."""


class MessageError(UserError):
    """A message from another node whose content is not allowed."""


def one_line(text: str) -> str:
    """Return a text in one line of at most `MAX_LENGTH` characters."""
    line = " ".join("".join(c if c.isprintable() else " " for c in text[: 4 * MAX_LENGTH]).split())
    return line if len(line) <= MAX_LENGTH else f"{line[: MAX_LENGTH - 3]}..."

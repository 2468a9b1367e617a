"""Paths to one field of a message: ``data``, ``position[2]``, ``values[name=K1].value``."""

from __future__ import annotations

import re
from dataclasses import dataclass

MAX_LENGTH = 500  # characters of a path
MAX_INDEX = 9999
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_ELEMENT = re.compile(
    r"\[(?:(?P<index>[0-9]{1,4})|(?P<key>[A-Za-z][A-Za-z0-9_]*)=(?P<text>[^\[\]]+))\]"
)
_SHAPES = "a field, a field's element by number or by a name of its own, e.g. data, position[2], values[name=K1].value"


@dataclass(frozen=True)
class Field:
    """A field of a message."""

    name: str


@dataclass(frozen=True)
class Element:
    """An element of an array, by its index."""

    index: int


@dataclass(frozen=True)
class Selection:
    """The element of an array whose field `key` is `text`.

    If the elements have no fields, `key` is an array of strings in the same message, such as `name`
    for `position` in a JointState.
    """

    key: str
    text: str


Step = Field | Element | Selection


@dataclass(frozen=True)
class FieldPath:
    """A path from a message to one of its fields."""

    steps: tuple[Step, ...]

    def __str__(self) -> str:
        parts: list[str] = []
        for step in self.steps:
            if isinstance(step, Field):
                parts.append(f".{step.name}" if parts else step.name)
            elif isinstance(step, Element):
                parts.append(f"[{step.index}]")
            else:
                parts.append(f"[{step.key}={step.text}]")
        return "".join(parts)


def parse_field_path(text: str) -> FieldPath:
    """Parse a path: names separated by dots, each with at most one element in brackets.

    Raises:
        ValueError: If the text is not a path; the message is one sentence.
    """
    steps: list[Step] = []
    at = 0
    while len(text) <= MAX_LENGTH:
        name = _NAME.match(text, at)
        if name is None:
            break
        steps.append(Field(name[0]))
        at = name.end()
        element = _ELEMENT.match(text, at)
        if element is not None:
            at = element.end()
            if element["index"] is not None:
                steps.append(Element(int(element["index"])))
            else:
                steps.append(Selection(element["key"], element["text"]))
        if at == len(text):
            return FieldPath(tuple(steps))
        if text[at] != ".":
            break
        at += 1
    raise ValueError(f"{text[:MAX_LENGTH]!r} is not a path to {_SHAPES}")

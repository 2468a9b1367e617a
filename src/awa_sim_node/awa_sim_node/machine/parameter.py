"""A number that says how the machine behaves: its meaning, its range, and where its size is from."""

from __future__ import annotations

import math
from dataclasses import Field, dataclass, field, fields
from typing import Any, Final

SOURCED: Final = "S"
"""Its usual size is taken from publications on the real machine."""
ASSUMED: Final = "A"
"""Its usual size is assumed: what operators of such machines report."""
CHOSEN: Final = "C"
"""It is a choice of whoever runs the machine."""


@dataclass(frozen=True)
class ParameterInfo:
    """What is known of a parameter besides its value.

    Attributes:
        meaning: What it is, with its unit, in a few words.
        minimum: Least value allowed.
        maximum: Greatest value allowed.
        source: ``SOURCED``, ``ASSUMED`` or ``CHOSEN``.
    """

    meaning: str
    minimum: float
    maximum: float
    source: str

    def check(self, name: str, value: float) -> None:
        """Check a value; ValueError if it is not finite or out of the range."""
        if not (math.isfinite(value) and self.minimum <= value <= self.maximum):
            raise ValueError(f"{name} = {value} must be from {self.minimum:g} to {self.maximum:g}")


def parameter(meaning: str, minimum: float, maximum: float, source: str = ASSUMED) -> Any:
    """Return a dataclass field that carries a ``ParameterInfo``."""
    return field(metadata={"info": ParameterInfo(meaning, minimum, maximum, source)})


def info_of(item: Field[Any]) -> ParameterInfo:
    """Return what is known of a field made by ``parameter``."""
    info = item.metadata["info"]
    assert isinstance(info, ParameterInfo)
    return info


@dataclass(frozen=True)
class ParameterGroup:
    """Parameters that belong together; their ranges are checked on construction."""

    def __post_init__(self) -> None:
        """Check the values; ValueError if one of them is not finite or out of its range."""
        for item in fields(self):
            info_of(item).check(item.name, getattr(self, item.name))

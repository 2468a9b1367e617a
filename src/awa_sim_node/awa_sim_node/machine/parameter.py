"""One parameter of the machine's behaviour: its meaning, its range, and the source of its value."""

from __future__ import annotations

import math
from dataclasses import Field, dataclass, field, fields
from typing import Any, Final

SOURCED: Final = "S"
"""Source: the default value is taken from publications on the real machine."""
ASSUMED: Final = "A"
"""Source: the default value is assumed, of the size that operators of such machines report."""
CHOSEN: Final = "C"
"""Source: the value is the user's choice."""


@dataclass(frozen=True)
class ParameterInfo:
    """Description of a parameter.

    Attributes:
        meaning: Short description with the unit.
        minimum: Lowest value allowed.
        maximum: Highest value allowed.
        source: ``SOURCED``, ``ASSUMED`` or ``CHOSEN``.
    """

    meaning: str
    minimum: float
    maximum: float
    source: str

    def check(self, name: str, value: float) -> None:
        """Check a value.

        Args:
            name: Name of the parameter, for the error.
            value: Value to check.

        Raises:
            ValueError: If the value is not finite or out of the range.
        """
        if not (math.isfinite(value) and self.minimum <= value <= self.maximum):
            raise ValueError(f"{name} = {value} must be from {self.minimum:g} to {self.maximum:g}")


def parameter(meaning: str, minimum: float, maximum: float, source: str = ASSUMED) -> Any:
    """Return a dataclass field with a ``ParameterInfo``."""
    return field(metadata={"info": ParameterInfo(meaning, minimum, maximum, source)})


def info_of(item: Field[Any]) -> ParameterInfo:
    """Return the description of a field made by ``parameter``."""
    info = item.metadata["info"]
    assert isinstance(info, ParameterInfo)
    return info


@dataclass(frozen=True)
class ParameterGroup:
    """A group of parameters whose ranges are checked on construction."""

    def __post_init__(self) -> None:
        """Check the values.

        Raises:
            ValueError: If a value is not finite or out of its range.
        """
        for item in fields(self):
            info_of(item).check(item.name, getattr(self, item.name))

"""Reading of a file's mappings key by key; errors name the file, key, value and what is allowed."""

from __future__ import annotations

import math
import reprlib
from collections.abc import Mapping
from typing import Any

from mobo_tuner.errors import UserError

MAX_SHOWN = 60  # characters of a value in an error message
_TOO_LARGE = 1e300
_REPR = reprlib.Repr()  # also limited in depth: aliases make huge trees from small files
_REPR.maxstring = _REPR.maxother = _REPR.maxlong = MAX_SHOWN
_REPR.maxlevel = 2


class MappingError(UserError):
    """A mapping file that cannot be used."""


class Section:
    """One mapping of a file.

    Args:
        where: Name of the section in messages, e.g. ``bridge.yaml: variables.K1``.
        content: Content of the file at that place.

    Raises:
        MappingError: If the content is not a mapping with strings as keys.
    """

    def __init__(self, where: str, content: object) -> None:
        if not isinstance(content, Mapping) or not all(isinstance(key, str) for key in content):
            raise MappingError(f"{where} is {shown(content)}; it must be a mapping with text keys")
        self.where = where
        self._content = content
        self._asked: list[str] = []

    def __contains__(self, key: str) -> bool:
        return key in self._content

    @property
    def content(self) -> Mapping[str, Any]:
        """The unchecked mapping."""
        return self._content

    def path(self, key: str) -> str:
        """Return the name of a key of this section in messages."""
        shown_key = key if key.isprintable() and len(key) <= MAX_SHOWN else shown(key)
        return f"{self.where}{'' if self.where.endswith(': ') else '.'}{shown_key}"

    def error(self, key: str, allowed: str) -> MappingError:
        """Return the error for a key whose value is not allowed."""
        return MappingError(f"{self.path(key)} is {shown(self._content.get(key))}; {allowed}")

    def get(self, key: str, default: Any = None) -> Any:
        """Return the unchecked value."""
        self._asked.append(key)
        return self._content.get(key, default)

    def number(
        self,
        key: str,
        default: float | None = None,
        *,
        minimum: float = -math.inf,
        above: float = -math.inf,
        maximum: float = math.inf,
        finite: bool = True,
    ) -> float:
        """Return a number, which is required if there is no default."""
        value = self._needed(key, default)
        number = float(value) if _is_number(value) else math.nan
        if not (minimum <= number <= maximum and (number > above or above == -math.inf)) or (
            finite and math.isinf(number)
        ):
            raise self.error(key, f"it must be a number{_range(minimum, above, maximum)}")
        return number

    def whole(self, key: str, default: int | None = None, *, minimum: int, maximum: int) -> int:
        """Return an integer, which is required if there is no default."""
        value = self._needed(key, default)
        if not isinstance(value, int) or isinstance(value, bool) or not minimum <= value <= maximum:
            raise self.error(key, f"it must be an integer from {minimum} to {maximum}")
        return value

    def text(self, key: str, default: str | None = None) -> str:
        """Return a string, which must not be empty unless the default is; required without a default."""
        value = self._needed(key, default)
        if not isinstance(value, str) or (not value and default != ""):
            raise self.error(key, "it must be a text")
        return value

    def choice(self, key: str, default: str, choices: tuple[str, ...]) -> str:
        """Return one of several strings."""
        value = self.get(key, default)
        if value not in choices:
            raise self.error(key, f"it must be one of {', '.join(choices)}")
        return str(value)

    def one_of(self, *keys: str) -> str:
        """Return the only one of these keys that exists.

        Raises:
            MappingError: If none exists, or more than one.
        """
        present = [key for key in keys if key in self._content]
        if len(present) != 1:
            found = ", ".join(present) or "none"
            raise MappingError(
                f"{self.where} must have one of the keys {', '.join(keys)}; it has {found}"
            )
        return present[0]

    def section(self, key: str, *, needed: bool = True) -> Section:
        """Return the section of a key; an empty one if it is missing and not needed."""
        return Section(self.path(key), self._needed(key, None if needed else {}))

    def sections(self, key: str, *, needed: bool = True) -> dict[str, Section]:
        """Return the sections by name, at least one if needed."""
        outer = self.section(key, needed=needed)
        if needed and not outer._content:
            raise self.error(key, "it must have at least one entry")
        return {name: outer.section(name) for name in outer._content}

    def finish(self) -> None:
        """Reject keys that were not read, because they would be ignored silently."""
        for key in self._content:
            if key not in self._asked:
                allowed = ", ".join(dict.fromkeys(self._asked))
                raise MappingError(f"{self.path(key)} is unknown; allowed there are {allowed}")

    def _needed(self, key: str, default: Any) -> Any:
        value = self.get(key, default)
        if value is None:
            raise MappingError(f"{self.path(key)} is missing")
        return value


def shown(value: object) -> str:
    """Return a value as it is shown in messages: in one line of limited length."""
    text = _REPR.repr(value)
    return text if len(text) <= MAX_SHOWN else f"{text[:MAX_SHOWN]}..."


def _is_number(value: object) -> bool:
    if isinstance(value, int) and not isinstance(value, bool):
        return abs(value) < _TOO_LARGE  # YAML's integers have no limit, floats do
    return isinstance(value, float)


def _range(minimum: float, above: float, maximum: float) -> str:
    limits = []
    if above > -math.inf:
        limits.append(f"above {above:g}")
    if minimum > -math.inf:
        limits.append(f"at least {minimum:g}")
    if maximum < math.inf:
        limits.append(f"at most {maximum:g}")
    return f" {' and '.join(limits)}" if limits else ""

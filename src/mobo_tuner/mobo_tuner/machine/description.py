"""Description of a machine before its node starts, as JSON.

Each machine that a section of the parameter file chooses has a describing program.
`python -m MODULE FILE` checks that section and prints the description, or one sentence on standard
error, with exit status 2:

    {"name": "my injector",
     "variables": {"K1": {"min": 400.0, "max": 550.0, "unit": "A"}},
     "diagnostics": {"dE": {"unit": "MeV"}},
     "evaluation_seconds": 12.0,
     "files": {"mapping": "/lab/my_injector.yaml"}}
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mobo_tuner.errors import UserError


class DescriptionError(UserError):
    """A description of a machine that cannot be read."""


@dataclass(frozen=True)
class VariableLimits:
    """Hard limits of one variable, in `unit`, or the words for its positions 0, 1, 2, ..., if it is a selector."""

    minimum: float
    maximum: float
    unit: str = ""
    words: tuple[str, ...] = ()


@dataclass(frozen=True)
class MachineDescription:
    """Description of a machine.

    Attributes:
        name: Name of the machine, for people.
        variables: Limits of the variables, by name.
        diagnostics: Units of the diagnostics, by name.
        evaluation_seconds: Typical duration of one evaluation [s]; None = unknown.
        files: Absolute paths of files that are given by parameters of its node, by parameter.
    """

    name: str
    variables: Mapping[str, VariableLimits]
    diagnostics: Mapping[str, str]
    evaluation_seconds: float | None = None
    files: Mapping[str, str] = field(default_factory=dict)

    def to_json(self) -> str:
        """Return the description as one JSON object."""
        return json.dumps(
            {
                "name": self.name,
                "variables": {
                    name: {"min": v.minimum, "max": v.maximum, "unit": v.unit}
                    | ({"words": list(v.words)} if v.words else {})
                    for name, v in self.variables.items()
                },
                "diagnostics": {name: {"unit": unit} for name, unit in self.diagnostics.items()},
                "evaluation_seconds": self.evaluation_seconds,
                "files": dict(self.files),
            }
        )

    @classmethod
    def from_json(cls, text: str) -> MachineDescription:
        """Read a description.

        Raises:
            DescriptionError: If the text is not a description.
        """
        try:
            content = json.loads(text)
            duration = content.get("evaluation_seconds")
            return cls(
                name=str(content["name"]),
                variables={
                    str(name): VariableLimits(
                        _finite(item["min"]),
                        _finite(item["max"]),
                        str(item.get("unit", "")),
                        tuple(map(str, item.get("words", ()))),
                    )
                    for name, item in content["variables"].items()
                },
                diagnostics={
                    str(name): str(item.get("unit", ""))
                    for name, item in content["diagnostics"].items()
                },
                evaluation_seconds=None if duration is None else _finite(duration),
                files={str(name): str(path) for name, path in content.get("files", {}).items()},
            )
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            what = f"{type(error).__name__}: {error}"
            raise DescriptionError(f"the machine's description cannot be read ({what})") from None


def print_description(
    describe: Callable[[Path], MachineDescription], arguments: Sequence[str] | None = None
) -> int:
    """Run a machine's describing program: print the description of the machine of a file.

    Args:
        describe: Function that returns the description or raises `UserError`.
        arguments: Command line; that of the process if None.

    Returns:
        The exit status: 0, or 2 after one sentence on standard error.
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    if len(words) != 1:
        print("usage: python -m MODULE FILE", file=sys.stderr)
        return 2
    try:
        print(describe(Path(words[0])).to_json())
    except UserError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


def _finite(value: Any) -> float:
    number = float(value)
    if not math.isfinite(number):
        raise ValueError(f"{value} is not a finite number")
    return number

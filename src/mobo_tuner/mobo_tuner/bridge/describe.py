"""Description of a parameter file's bridged machine: `python -m mobo_tuner.bridge.describe FILE`."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path

from mobo_tuner.bridge.mapping import MachineMapping, load_mapping
from mobo_tuner.errors import ParameterError
from mobo_tuner.files import load_yaml
from mobo_tuner.machine.description import MachineDescription, VariableLimits, print_description
from mobo_tuner.machine.ramp import count_steps
from mobo_tuner.parameter_file import check_section, node_sections
from mobo_tuner.parameter_spec import AUTOSTART, ParameterSpec

NODE = "machine_bridge"
MACHINE_BRIDGE = (
    AUTOSTART,
    ParameterSpec(
        "mapping",
        "",
        "Mapping file, which assigns topics, services and actions to variables and diagnostics; its "
        "path is relative to the parameter file.",
    ),
)


def describe_file(path: Path) -> MachineDescription:
    """Return the description of the machine of a parameter file.

    Raises:
        UserError: If the file or its mapping cannot be read, or something in it is not allowed.
    """
    given = check_section(NODE, node_sections(load_yaml(path)).get(NODE, {}), MACHINE_BRIDGE)
    if not given["mapping"]:
        raise ParameterError(f"{NODE}.mapping is empty; it must name the mapping file")
    file = path.resolve().parent / str(given["mapping"])
    mapping = load_mapping(file)
    return MachineDescription(
        name=mapping.name,
        variables={
            v.name: VariableLimits(v.minimum, v.maximum, v.unit, v.words)
            for v in mapping.variables.values()
        },
        diagnostics={d.name: d.unit for d in mapping.diagnostics.values()},
        evaluation_seconds=_typical_duration(mapping),
        files={"mapping": str(file)},
    )


def mapping_file(value: str, command_line: Sequence[str]) -> Path:
    """Return the path of the mapping file of a node.

    Args:
        value: Value of the node's parameter ``mapping``.
        command_line: Command line of the node. A path from its parameter file is relative to that
            file, a path given by ``-p`` to the working folder.
    """
    if any(":=" in word and word.split(":=")[0].endswith("mapping") for word in command_line):
        return Path(value)
    files = [Path(file) for word, file in pairwise(command_line) if word == "--params-file"]
    # What ros2 launch adds to a file of the user is in a file of its own, in another folder.
    naming = [file for file in files if _names_mapping(file, value)] or files
    return naming[-1].resolve().parent / value if naming else Path(value)


def _names_mapping(file: Path, value: str) -> bool:
    """Return whether a parameter file gives this value to the parameter ``mapping``."""
    sections = load_yaml(file).values()
    parameters = [s.get("ros__parameters") for s in sections if isinstance(s, Mapping)]
    return any(isinstance(p, Mapping) and p.get("mapping") == value for p in parameters)


def _typical_duration(mapping: MachineMapping) -> float:
    """Return the duration of an evaluation as far as the mapping defines it [s].

    It consists of a ramp over a third of each range, which is the mean distance of two random points,
    the time to settle, and averages over time; the rate of shots is unknown.
    """
    period = 1.0 / mapping.rate
    variables = mapping.variables.values()
    steps = count_steps(
        {v.name: 0.0 for v in variables},
        {v.name: (v.maximum - v.minimum) / 3.0 for v in variables},
        {v.name: min(v.max_step, v.slew * period) for v in variables},
    )
    averaged = max(d.seconds for d in mapping.diagnostics.values())
    return steps * period + mapping.settle_time + averaged


if __name__ == "__main__":
    sys.exit(print_description(describe_file))

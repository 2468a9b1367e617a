"""What the simulated machine of a parameter file is: `python -m awa_sim_node.describe FILE`."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from awa_sim_node.machine import Behaviour, Mode, behaviour_of, describe
from awa_sim_node.machine.actuators import Actuators
from awa_sim_node.machine.models import kinds_of
from awa_sim_node.parameters import AWA_SIM, behaviour_specs
from mobo_tuner.errors import ParameterError
from mobo_tuner.files import load_yaml
from mobo_tuner.machine.description import MachineDescription, VariableLimits, print_description
from mobo_tuner.parameter_file import check_section, node_sections

NODE = "awa_sim"


def describe_file(path: Path) -> MachineDescription:
    """Return what the machine of a parameter file is.

    Raises:
        UserError: If the file cannot be read or a parameter of the machine is not allowed.
    """
    return describe_section(node_sections(load_yaml(path)).get(NODE, {}))


def describe_section(given: Mapping[str, Any]) -> MachineDescription:
    """Return what the machine with these parameters is.

    Raises:
        ParameterError: If one is unknown, of the wrong type or not allowed.
    """
    specs = (*AWA_SIM, *behaviour_specs("awa", "nominal"))
    values = check_section(NODE, given, specs)
    model = str(values["model"])
    behaviour = behaviour_of(model, Mode(str(values["mode"])))
    try:
        behaviour = behaviour.changed(
            {name: given[name] for name in behaviour.values if name in given}
        )
    except ValueError as error:
        raise ParameterError(f"{NODE}.{error}") from None
    machine = describe(model)
    return MachineDescription(
        name=machine.title,
        variables={v.name: VariableLimits(v.minimum, v.maximum, v.unit) for v in machine.variables},
        diagnostics={d.name: d.unit for d in machine.diagnostics},
        evaluation_seconds=_typical_duration(model, behaviour) / float(values["speed"]),
    )


def _typical_duration(model: str, behaviour: Behaviour) -> float:
    """Return the simulated time of an evaluation after a move by a third of each range [s].

    A third of the range is the mean distance of two points drawn from it.
    """
    machine = describe(model)
    actuators = Actuators(machine, kinds_of(model), behaviour)
    actuators.set({v.name: v.initial + (v.maximum - v.minimum) / 3.0 for v in machine.variables})
    shots = behaviour.beam.shots / behaviour.beam.repetition_rate
    return actuators.time_to_settled + shots


if __name__ == "__main__":
    sys.exit(print_description(describe_file))

"""Check a whole configuration against the simulated machine, before anything starts.

`python -m awa_sim_node.check_config FILE` prints one sentence and exits with 2 where it is wrong.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from typing import Any

from awa_sim_node.machine import Mode, behaviour_of, describe
from awa_sim_node.parameters import AWA_SIM, behaviour_specs
from mobo_tuner.core.problem import Problem, ProblemError
from mobo_tuner.errors import UserError
from mobo_tuner.files import load_yaml
from mobo_tuner.nodes.parameters import CONSOLE, RECORDER
from mobo_tuner.ros.parameters import ParameterSpec, check_section
from mobo_tuner.tuner.parameters import TUNER

NODES: Mapping[str, tuple[ParameterSpec, ...]] = {
    "tuner": TUNER,
    "recorder": RECORDER,
    "awa_sim": (*AWA_SIM, *behaviour_specs("awa", "nominal")),
    "console": CONSOLE,
}


def check(path: str) -> Problem:
    """Check a ROS parameter file: the problem, every node's parameters, and that they fit.

    Raises:
        ProblemError: something is unknown, missing, of the wrong type or not allowed.
    """
    content = load_yaml(path)
    if "/**" not in content:
        raise ProblemError(f"the file '{path}' lacks the section '/**' with the problem")
    values = {name: check_section(name, {}, specs) for name, specs in NODES.items()}
    for key, section in content.items():
        if key == "/**":
            continue
        name = str(key).removeprefix("/**").removeprefix("/")
        if name not in NODES:
            raise ProblemError(
                f"the section '{key}' is unknown; allowed are /**, {', '.join(NODES)}"
            )
        values[name] = check_section(name, _parameters(key, section), NODES[name])
        if name == "awa_sim":
            _check_behaviour(values[name], _parameters(key, section))
    problem = Problem.from_dict(content)
    machine = describe(str(values["awa_sim"]["model"]))
    problem.check_machine(
        {v.name: (v.minimum, v.maximum) for v in machine.variables},
        {d.name: d.unit for d in machine.diagnostics},
        {v.name: v.unit for v in machine.variables},
    )
    return problem


def _check_behaviour(values: Mapping[str, Any], given: Mapping[str, Any]) -> None:
    """Check what is given of the behaviour together with the mode's defaults."""
    behaviour = behaviour_of(values["model"], Mode(values["mode"]))
    try:
        behaviour.changed({name: given[name] for name in behaviour.values if name in given})
    except ValueError as error:
        raise ProblemError(f"awa_sim.{error}") from None


def _parameters(key: str, section: object) -> Mapping[str, Any]:
    if not isinstance(section, Mapping) or list(section) != ["ros__parameters"]:
        raise ProblemError(f"the section '{key}' must hold 'ros__parameters' and nothing else")
    parameters = section["ros__parameters"]
    if not isinstance(parameters, Mapping):
        raise ProblemError(f"'ros__parameters' of the section '{key}' must be a mapping")
    return parameters


def main() -> int:
    """Check the file named on the command line."""
    if len(sys.argv) != 2:
        print("usage: python -m awa_sim_node.check_config FILE", file=sys.stderr)
        return 2
    try:
        check(sys.argv[1])
    except UserError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())

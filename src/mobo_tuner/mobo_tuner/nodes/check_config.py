"""Check a whole parameter file before anything starts, and describe its meaning.

`python -m mobo_tuner.nodes.check_config FILE --machine-node NAME=MODULE ...` prints the facts that a
run needs as one JSON object, or an error of one sentence on standard error, with exit status 2.

The sections of the file choose the machine: each section NAME belongs to a machine's node, and
`python -m MODULE FILE` describes that machine. This module does not know the names of machines.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import yaml

from mobo_tuner.core.machine_facts import MachineFacts
from mobo_tuner.core.problem import ONE_FIDELITY, Problem
from mobo_tuner.core.settings import method_of
from mobo_tuner.displays.configuration import Configuration, explanation
from mobo_tuner.errors import FileError, ParameterError, UserError
from mobo_tuner.files import load_yaml
from mobo_tuner.machine.description import MachineDescription
from mobo_tuner.nodes.parameters import CONSOLE, LIVE_SERVER, PAGE, RECORDER
from mobo_tuner.offline.parameters import CAMPAIGN
from mobo_tuner.offline.simulation import command_of
from mobo_tuner.parameter_file import check_section, check_section_names, node_sections
from mobo_tuner.parameter_spec import ParameterSpec
from mobo_tuner.runs.history import MODEL
from mobo_tuner.tuner.parameters import check_tuner

CONFIG_FILE = "config.yaml"  # in a run's folder
DESCRIBE_TIMEOUT = 50.0  # [s]
NODES: Mapping[str, tuple[ParameterSpec, ...]] = {
    "recorder": RECORDER,
    "console": CONSOLE,
    "page": PAGE,
    "campaign": CAMPAIGN,
    "live_server": LIVE_SERVER,
}

Describe = Callable[[Path], MachineDescription]


def check(
    path: str | Path,
    machines: Mapping[str, Describe],
    program: str = "",
    *,
    program_yields: bool = False,
) -> Configuration:
    """Check a parameter file: the problem, the parameters of every node, and that they fit.

    Args:
        path: Path of the file.
        machines: Function that describes the machine, by the name of the section that chooses it.
        program: Command of a machine that is not chosen by a section; empty if there is none. Its
            sections are unknown, so all sections except misspelt ones are allowed.
        program_yields: Whether a section that chooses a machine replaces that command.

    Raises:
        UserError: If something is unknown, missing, of the wrong type or not allowed.
    """
    content = load_yaml(path)
    if "/**" not in content:
        raise FileError(f"the file '{path}' lacks the section '/**' with the problem")
    sections = node_sections(content)
    if program_yields and any(name in machines for name in sections):
        program = ""
    section = _machine_section(sections, machines, program)
    check_section_names(sections, ["tuner", *NODES, *machines], allow_others=bool(program))
    for name, specs in NODES.items():
        check_section(name, sections.get(name, {}), specs)
    tuner = check_tuner(sections.get("tuner", {}))
    problem = Problem.from_dict(content)
    method_of(tuner).check_problem(problem)
    if tuner[MODEL] and not problem.open_variables:
        # It takes a second to import, which other files can spare.
        from mobo_tuner.runs.prior_model import load_prior_model

        load_prior_model(problem, tuner)
    machine = None
    if section:
        machine = machines[section](Path(path))
        MachineFacts(
            {name: (v.minimum, v.maximum) for name, v in machine.variables.items()},
            machine.diagnostics,
            {name: v.unit for name, v in machine.variables.items()},
            {
                name: {word: float(i) for i, word in enumerate(v.words)}
                for name, v in machine.variables.items()
                if v.words
            },
        ).check(problem)
    campaign = check_section("campaign", sections.get("campaign", {}), CAMPAIGN)
    command_of(campaign, Path(path).parent)  # checks the names of files
    simulation = str(campaign["function"] or campaign["command"])
    if problem.fidelity and (section or program or not simulation):
        raise ParameterError(f"'fidelity' is given, {ONE_FIDELITY}")
    return Configuration(str(path), problem, tuner, section, machine, program, simulation)


def describe_by(module: str) -> Describe:
    """Return the function that describes the machine of a file by a module, in its own process."""

    def describe(path: Path) -> MachineDescription:
        command = [sys.executable, "-P", "-m", module, str(path)]
        try:
            done = subprocess.run(
                command, capture_output=True, text=True, timeout=DESCRIBE_TIMEOUT, check=False
            )
        except subprocess.TimeoutExpired:
            raise UserError(f"{module} did not end within {DESCRIBE_TIMEOUT:g} s") from None
        if done.returncode != 0:
            words = done.stderr.strip().splitlines()
            raise UserError(words[-1] if words else f"{module} ended with {done.returncode}")
        return MachineDescription.from_json(done.stdout)

    return describe


def copy_to(folder: Path, configuration: Configuration) -> list[str]:
    """Copy a parameter file and the files that its machine's node needs into a run's folder.

    Only names of files in the parameter file are changed, if the copies have other names.

    Returns:
        Names of the other files.

    Raises:
        OSError: If a file cannot be copied.
    """
    source = Path(configuration.path)
    machine = configuration.machine
    names = {}
    for parameter, file in machine.files.items() if machine else ():
        name = Path(file).name
        if Path(file).parent != source.resolve().parent or name == CONFIG_FILE:
            name = f"{parameter}{Path(file).suffix}"
        shutil.copyfile(file, folder / name)
        names[parameter] = name
    target = folder / CONFIG_FILE
    shutil.copyfile(source, target)
    content = load_yaml(target)
    if _rename(content, configuration.section, names):
        target.write_text(yaml.safe_dump(content, sort_keys=False, allow_unicode=True))
    return list(names.values())


def _rename(content: dict[str, Any], section: str, names: Mapping[str, str]) -> bool:
    """Set parameters of a node in a file's content; return whether a value changed."""
    changed = False
    for key, part in content.items():
        if not section or section not in node_sections({key: part}):
            continue
        for parameter, name in names.items():
            if part["ros__parameters"].get(parameter, name) != name:
                part["ros__parameters"][parameter] = name
                changed = True
    return changed


def _machine_section(
    sections: Mapping[str, object], machines: Mapping[str, Describe], program: str
) -> str:
    """Return the section that chooses the machine; empty if none does.

    Raises:
        ParameterError: If more than one machine is chosen.
    """
    chosen = [name for name in sections if name in machines]
    ways = [f"the section '{name}' of the file" for name in chosen]
    if program:
        ways.append(f"the command '{program}' of --machine")
    if len(ways) > 1:
        raise ParameterError(f"two machines are chosen, by {ways[0]} and by {ways[1]}; keep one")
    return chosen[0] if chosen else ""


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="mobo_tuner.nodes.check_config")
    parser.add_argument("file", type=Path)
    parser.add_argument(
        "--machine-node",
        metavar="NAME=MODULE",
        action="append",
        default=[],
        help="section of a machine's node, and the module that describes the machine",
    )
    parser.add_argument("--program", default="", help="command of a machine without a section")
    parser.add_argument(
        "--program-yields", action="store_true", help="a section replaces that command"
    )
    parser.add_argument("--copy-to", metavar="FOLDER", type=Path, help="folder of the copies")
    parser.add_argument("--explain", action="store_true", help="print plain lines for people")
    return parser


def main() -> int:
    """Check the file of the command line; return the exit status."""
    options = _parser().parse_args()
    nodes = dict(text.split("=", maxsplit=1) for text in options.machine_node)
    machines = {name: describe_by(module) for name, module in nodes.items()}
    try:
        configuration = check(
            options.file, machines, options.program, program_yields=options.program_yields
        )
        if options.explain:
            print("\n".join(explanation(configuration)))
            return 0
        files = copy_to(options.copy_to, configuration) if options.copy_to else []
    except UserError as error:
        print(error, file=sys.stderr)
        return 2
    except OSError as error:
        print(f"the files of a run cannot be copied: {error}", file=sys.stderr)
        return 2
    facts = {
        "section": configuration.section,
        "machine": configuration.machine.name if configuration.machine else "",
        "files": files,
        "on_abort": configuration.tuner["on_abort"],
    }
    print(json.dumps(facts))
    return 0


if __name__ == "__main__":
    sys.exit(main())

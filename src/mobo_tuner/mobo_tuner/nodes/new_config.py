"""Write a parameter file from what a machine has.

`python -m mobo_tuner.nodes.new_config FILE --machine-node NAME=MODULE ...` asks the machine that is there
(`describe_machine`), or describes that of another file (`--like`). It writes nothing over a file, and exits with
status 2 after one sentence on standard error.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from mobo_msgs_py.srv import DescribeMachine
from mobo_tuner.displays.template import template
from mobo_tuner.errors import FileError, ParameterError, UserError
from mobo_tuner.files import load_yaml
from mobo_tuner.machine.description import MachineDescription, VariableLimits
from mobo_tuner.nodes.check_config import describe_by
from mobo_tuner.parameter_file import node_sections
from mobo_tuner.ros import interfaces
from mobo_tuner.ros.parameters import check_domain

ANSWER_TIMEOUT = 1.0  # [s] for one request, which is lost if it is sent right after discovery


def ask_machine(timeout: float) -> MachineDescription:
    """Ask the machine in this ROS domain what it has.

    Args:
        timeout: Longest wait [s].

    Raises:
        UserError: If none answers.
    """
    check_domain()
    context = Context()
    rclpy.init(context=context)
    node = Node("new_config", context=context, enable_rosout=False, start_parameter_services=False)
    executor = SingleThreadedExecutor(context=context)
    try:
        client = interfaces.DESCRIBE_MACHINE.client(node)
        deadline = time.monotonic() + timeout
        while time.monotonic() < deadline:
            if not client.wait_for_service(timeout_sec=0.2):
                continue
            answer = client.call_async(DescribeMachine.Request())
            rclpy.spin_until_future_complete(node, answer, executor, timeout_sec=ANSWER_TIMEOUT)
            if answer.done():
                return _described(answer.result())
            client.remove_pending_request(answer)
        raise UserError(
            f"no machine answered on '{client.srv_name}' within {timeout:g} s in ROS domain "
            f"{os.environ.get('ROS_DOMAIN_ID', '0')}"
        )
    finally:
        executor.shutdown(timeout_sec=1.0)
        node.destroy_node()
        context.try_shutdown()


def _described(answer: DescribeMachine.Response) -> MachineDescription:
    return MachineDescription(
        name=answer.name,
        variables={
            v.name: VariableLimits(v.min, v.max, v.unit, tuple(c.name for c in v.choices))
            for v in answer.variables
        },
        diagnostics={d.name: d.unit for d in answer.diagnostics},
    )


def machine_of(
    path: Path, modules: Mapping[str, str], target: Path
) -> tuple[str, dict[str, Any], MachineDescription]:
    """Return section, parameters and description of the machine that a parameter file chooses.

    Args:
        path: Parameter file.
        modules: Module that describes the machine, by section.
        target: File for which the parameters are meant; names of files in them are relative to it.

    Raises:
        UserError: If the file chooses none, or something in it is not allowed.
    """
    sections = node_sections(load_yaml(path))
    chosen = [name for name in sections if name in modules]
    if len(chosen) != 1:
        raise ParameterError(
            f"'{path}' has {len(chosen)} sections that choose a machine; one of {', '.join(modules)} "
            "is allowed"
        )
    section = chosen[0]
    machine = describe_by(modules[section])(path)
    parameters = dict(sections[section])
    for name, file in machine.files.items():
        parameters[name] = os.path.relpath(file, target.resolve().parent)
    return section, parameters, machine


def write_template(options: argparse.Namespace) -> None:
    """Write the parameter file of the command line.

    Raises:
        UserError: If the file is there already, or the machine cannot be described.
        OSError: If it cannot be written.
    """
    if options.file.exists():
        raise FileError(f"the file '{options.file}' exists already, and nothing is written over it")
    section = ""
    parameters: dict[str, Any] = {}
    if options.like is not None:
        modules = dict(text.split("=", maxsplit=1) for text in options.machine_node)
        section, parameters, machine = machine_of(options.like, modules, options.file)
    else:
        machine = ask_machine(options.timeout)
    text = template(
        machine,
        minimize=options.minimize,
        maximize=options.maximize,
        around=options.around,
        section=section,
        parameters=parameters,
        how=options.how,
    )
    with options.file.open("x", encoding="utf-8") as file:
        file.write(text)


def main() -> int:
    """Write the file of the command line; return the exit status."""
    parser = argparse.ArgumentParser(prog="mobo_tuner.nodes.new_config")
    parser.add_argument("file", type=Path)
    parser.add_argument("--machine-node", metavar="NAME=MODULE", action="append", default=[])
    parser.add_argument("--like", metavar="FILE", type=Path)
    parser.add_argument("--minimize", metavar="NAME", nargs="*", default=[])
    parser.add_argument("--maximize", metavar="NAME", nargs="*", default=[])
    parser.add_argument("--around", metavar="WIDTH", default="")
    parser.add_argument("--how", metavar="OPTIONS", default="")
    parser.add_argument("--timeout", metavar="SECONDS", type=float, default=20.0)
    options = parser.parse_args()
    try:
        write_template(options)
    except UserError as error:
        print(error, file=sys.stderr)
        return 2
    except OSError as error:
        print(f"the file '{options.file}' cannot be written: {error.strerror}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""The machine of a run: one whose node the run starts, or one that is already running."""

from __future__ import annotations

import os
import shlex
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from launcher.errors import UsageError
from launcher.programs import NodeProgram
from launcher.ros_domain import HIGHEST as HIGHEST_DOMAIN


@dataclass(frozen=True)
class MachineNode:
    """A machine's node that a section of the parameter file chooses.

    Attributes:
        program: The node's program; its `node` is the name of the section.
        description: Module that describes the machine of a file.
        is_simulated: Whether the node simulates the machine; otherwise the machine has a ROS domain.
    """

    program: NodeProgram
    description: str
    is_simulated: bool = False


MACHINE_NODES = {
    node.program.node: node
    for node in (
        MachineNode(
            NodeProgram("machine", "awa_sim_node.node", "awa_sim", ("seed", "speed")),
            "awa_sim_node.describe",
            is_simulated=True,
        ),
        MachineNode(
            NodeProgram("machine", "mobo_tuner.nodes.machine_bridge", "machine_bridge"),
            "mobo_tuner.bridge.describe",
        ),
    )
}


@dataclass(frozen=True)
class Machine:
    """The machine of a run; without a section and a command, its node is already running.

    Attributes:
        section: Section of the parameter file that chooses it.
        files: Names of further files that its node reads, in the folder of the parameter file.
        command: Command of `--machine` that starts its node.
        folder: Working folder of the command.
    """

    section: str = ""
    files: Sequence[str] = ()
    command: str = ""
    folder: Path = field(default_factory=Path.cwd)

    @classmethod
    def from_facts(cls, facts: Mapping[str, Any]) -> Machine:
        """Return the machine of an earlier run, as its `run.json` describes it."""
        machine = facts.get("machine")
        if not isinstance(machine, Mapping):
            return cls()
        return cls(
            section=str(machine.get("section", "")),
            files=tuple(map(str, machine.get("files", ()))),
            command=str(machine.get("command", "")),
            folder=Path(machine.get("folder", Path.cwd())),
        )

    @property
    def facts(self) -> dict[str, Any]:
        """Description of the machine in `run.json`."""
        if self.section:
            return {"section": self.section, "files": list(self.files)}
        if self.command:
            return {"command": self.command, "folder": str(self.folder)}
        return {"external": True}

    @property
    def options(self) -> tuple[str, ...]:
        """Options of the command line that the machine's node takes as parameters."""
        node = MACHINE_NODES.get(self.section)
        return node.program.parameters if node else ()

    @property
    def needs_private_domain(self) -> bool:
        """Whether no part of the machine is already running in a ROS domain."""
        return bool(self.command) or (
            self.section in MACHINE_NODES and MACHINE_NODES[self.section].is_simulated
        )

    def start_command(
        self, python: Path, config: Path, values: Mapping[str, object]
    ) -> list[str] | None:
        """Return the command that starts the machine's node; None if it is already running."""
        if self.section:
            return MACHINE_NODES[self.section].program.command(python, config, values)
        if self.command:
            return [*split_command(self.command), "--ros-args", "--params-file", str(config)]
        return None

    def check_program(self, path: str) -> None:
        """Check that the program of the command exists.

        Args:
            path: Folders of programs, as in `PATH`.

        Raises:
            UsageError: If it does not.
        """
        if not self.command:
            return
        program = split_command(self.command)[0]
        where = str(self.folder / program) if os.sep in program else program
        if not self.folder.is_dir() or shutil.which(where, path=path) is None:
            raise UsageError(
                f"--machine is '{self.command}', and there is no program '{program}' to start"
                + (f" in '{self.folder}'" if os.sep in program else "")
            )


def split_command(command: str, option: str = "--machine") -> list[str]:
    """Return the words of a command, of which there is at least one.

    Args:
        command: Command line.
        option: Option that gives it, for the error.

    Raises:
        UsageError: If it has no words, or a quotation that does not end.
    """
    try:
        words = shlex.split(command)
    except ValueError as error:
        raise UsageError(f"{option} is '{command}', which is not a command: {error}") from None
    if not words:
        raise UsageError(f"{option} is '{command}'; it must be a command that starts a program")
    return words


def shared_domain(asked: int | None, earlier: int | None) -> tuple[int, str]:
    """Return the ROS domain in which a machine is expected, and where it is defined.

    Args:
        asked: Domain of `--domain-id`.
        earlier: Domain of the run that is resumed.

    Raises:
        UsageError: If the environment names a domain that is not allowed.
    """
    if asked is not None:
        return asked, "--domain-id"
    if earlier is not None:
        return earlier, "the domain of the run that is resumed"
    text = os.environ.get("ROS_DOMAIN_ID", "")
    if not text:
        return 0, "ROS_DOMAIN_ID is not set"
    if not (text.isdecimal() and len(text) < 4 and int(text) <= HIGHEST_DOMAIN):
        raise UsageError(
            f"ROS_DOMAIN_ID is '{text}'; an integer from 0 to {HIGHEST_DOMAIN} is allowed"
        )
    return int(text), "ROS_DOMAIN_ID"

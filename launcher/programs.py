"""The project's programs: the nodes of a run, and tools that print an answer."""

from __future__ import annotations

import os
import subprocess
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from launcher.environment import STAGES, Environment, Stage, clean_environment
from launcher.errors import UsageError
from launcher.processes import Processes, describe_status

# One thread each: the processes of a run share the cores.
THREADS = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
ANSWER_TIMEOUT = 60.0  # [s] for a check of a file, or a report
LONG = 3600.0  # [s] for programs that compute all suggestions of a run


@dataclass(frozen=True)
class NodeProgram:
    """A program that runs one ROS node.

    Attributes:
        name: Name of the program and of its log file.
        module: Python module that is run.
        node: Name of its ROS node.
        parameters: ROS parameters that override those of the parameter file.
    """

    name: str
    module: str
    node: str
    parameters: tuple[str, ...] = ()

    def command(self, python: Path, config: Path, values: Mapping[str, object]) -> list[str]:
        """Return the command line; the parameter file defines parameters without a value.

        They are qualified by the name of the node; otherwise the file's section of that name would
        override them.
        """
        given = [
            argument
            for name in self.parameters
            if (value := values.get(name)) is not None
            for argument in ("-p", f"{self.node}:{name}:={_as_yaml(value)}")
        ]
        ros = ["--ros-args", "--params-file", str(config), *given]
        return [str(python), "-P", "-m", self.module, *ros]


TUNER = NodeProgram("tuner", "mobo_tuner.nodes.tuner", "tuner", ("seed", "runs_dir"))
RECORDER = NodeProgram("recorder", "mobo_tuner.nodes.recorder", "recorder", ("bag_path",))
CONSOLE = NodeProgram(
    "console", "mobo_tuner.nodes.console", "console", ("run_id", "evaluations", "resume_from")
)
PAGE = NodeProgram("page", "mobo_tuner.nodes.page", "page", ("host", "port", "runs_dir"))


@dataclass(frozen=True)
class Project:
    """The project, ready for use.

    Attributes:
        environment: Virtual environment of its programs.
        processes: Processes that it starts.
    """

    environment: Environment
    processes: Processes

    @property
    def search_path(self) -> str:
        """`PATH` of its programs: `python` is that of the virtual environment."""
        inherited = os.environ.get("PATH", os.defpath)
        return os.pathsep.join((str(self.environment.python.parent), inherited))

    def ask(
        self,
        module: str,
        *arguments: object,
        show: bool = False,
        timeout: float = ANSWER_TIMEOUT,
        surroundings: Mapping[str, str] | None = None,
        machine: subprocess.Popen[bytes] | None = None,
    ) -> str:
        """Run one of the programs and return what it prints.

        Its last line on standard error describes an error.

        Args:
            module: Module of the program.
            arguments: Arguments of the program.
            show: Whether it prints to this script's output, so that nothing is returned.
            timeout: Longest time that it may take [s].
            surroundings: Environment variables by which it finds ROS nodes.
            machine: Process of the machine that it asks, without which it would wait in vain.

        Raises:
            UsageError: If something is wrong.
            Interrupted: If a signal came.
        """
        with tempfile.TemporaryFile() as output, tempfile.TemporaryFile() as complaint:
            process = self.processes.start(
                [str(self.environment.python), "-P", "-m", module, *map(str, arguments)],
                environment=clean_environment(**THREADS, MPLBACKEND="Agg", **(surroundings or {})),
                cwd=Path.cwd(),
                stdout=None if show else output,
                stderr=complaint,
            )
            self.processes.wait_until(
                lambda: (
                    process.poll() is not None
                    or (machine is not None and machine.poll() is not None)
                ),
                timeout,
            )
            if process.poll() is None and machine is not None and machine.returncode is not None:
                raise UsageError(f"the machine's program {describe_status(machine.returncode)}")
            status = process.returncode
            for stream in (output, complaint):
                stream.seek(0)
            words = complaint.read().decode(errors="replace").strip().splitlines()
            answer = output.read().decode(errors="replace")
        if status is None:
            raise UsageError(f"{module} was not done after {timeout:.0f} s")
        if status != 0:
            raise UsageError(words[-1] if words else f"{module} ended with status {status}")
        return answer


@contextmanager
def open_project(root: Path, stages: Sequence[Stage] = STAGES) -> Iterator[Project]:
    """Set up the project; at the end of the block all processes have ended.

    Raises:
        SetupError: If it cannot be set up.
        Interrupted: If a signal came.
    """
    with Processes() as processes:
        environment = Environment(root, stages)
        environment.set_up(processes)
        yield Project(environment, processes)


def _as_yaml(value: object) -> str:
    """Return a parameter's value for `-p name:=`; strings are quoted, so that they stay strings."""
    if isinstance(value, str | Path):
        return "'" + str(value).replace("'", "''") + "'"
    return repr(value)

"""The life of a node's process: help, start, spin, stop on SIGINT or SIGTERM, always end."""

from __future__ import annotations

import faulthandler
import json
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from types import FrameType
from typing import NoReturn, Protocol, TypeVar

import rclpy
from rclpy.exceptions import ROSInterruptException
from rclpy.executors import Executor, ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

from mobo_tuner.parameter_spec import ParameterSpec
from mobo_tuner.ros.parameters import as_node_arguments

POLL_PERIOD = 0.1  # [s] a signal is noticed within this time
STOP_TIMEOUT = 2.0  # [s] for a node to finish what it is doing
EXIT_TIMEOUT = 3.5  # [s] after which the process ends whatever it is doing


class StartError(Exception):
    """A node cannot start; the message is one sentence for the user."""


class ManagedNode(Protocol):
    """A node that can be stopped in an orderly way."""

    @property
    def node(self) -> Node:
        """The rclpy node."""

    @property
    def exit_code(self) -> int | None:
        """The process's exit status once the node is finished of itself; None before."""

    async def stop(self) -> None:
        """Finish what is running; rclpy still works."""

    def close(self) -> None:
        """Release everything; called once, last, whatever happened."""


@dataclass(frozen=True)
class Program:
    """What a node's program says of itself with `--help`.

    Attributes:
        name: Name of the node, unless it is renamed.
        description: Purpose of the node, in one sentence.
        parameters: Parameters of the node.
        notes: Further lines about the parameters.
    """

    name: str
    description: str = ""
    parameters: Sequence[ParameterSpec] = ()
    notes: str = ""

    @property
    def help(self) -> str:
        """The text of `--help`."""
        return "\n".join(self._help_lines())

    def _help_lines(self) -> Iterator[str]:
        yield f"usage: {self.name} [--help] [--ros-args [-p NAME:=VALUE] [--params-file FILE] ...]"
        if self.description:
            yield f"\n{self.description}"
        yield "\nparameters (* may also be set while the node runs):"
        for spec in self.parameters:
            mark = " *" if spec.writable else ""
            allowed = f"; allowed: {spec.range_text}" if spec.range_text else ""
            yield f"  {spec.name}{mark}: {spec.type_name}, default {_as_yaml(spec)}{allowed}"
            yield f"      {spec.description}"
        if self.notes:
            yield f"\n{self.notes}"


NodeT = TypeVar("NodeT", bound=ManagedNode)


def run_node(
    create: Callable[[Executor], NodeT],
    program: Program,
    on_interrupt: Callable[[NodeT], None] | None = None,
) -> int:
    """Run one node until it is finished or a signal asks it to stop.

    Every call of rclpy happens on this thread. The first SIGINT or SIGTERM stops the node in an
    orderly way, the second at once; in no case does the process outlive the signal by more than
    `EXIT_TIMEOUT` seconds.

    Args:
        create: Function that builds the node, given the executor on which it will run.
        program: Description of the program, for `--help`.
        on_interrupt: Function for a SIGINT that does not stop the node yet; the node then ends
            by itself. The next SIGINT counts as the first of those that stop it.

    Returns:
        The exit status: 0, also after `--help`, or what the node says, or 2 when it cannot start.
    """
    if {"-h", "--help"} & {*sys.argv[1:]}:
        print(program.help)
        return 0
    stop = _StopRequest(deferred=on_interrupt is not None)
    try:
        with as_node_arguments(sys.argv, program.name) as arguments:
            others = remove_ros_args(arguments)[1:]
            if others:
                print(
                    f"cannot start: the argument '{others[0]}' is unknown; see --help",
                    file=sys.stderr,
                )
                return 2
            rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
    except Exception as error:  # rclpy raises many kinds for an unreadable parameter file
        reason = _first_line(error)
        if type(error).__name__ == "UnknownROSArgsError":  # whose words are a list alone
            reason = f"ROS knows none of the arguments {reason}; see --help"
        print(f"cannot start: {reason}", file=sys.stderr)
        return 2
    executor = SingleThreadedExecutor()
    try:
        try:
            managed = create(executor)
        except (StartError, ValueError) as error:
            print(f"cannot start: {_first_line(error)}", file=sys.stderr)
            return 2
        try:
            executor.add_node(managed.node)
            while managed.exit_code is None and not stop.requested:
                executor.spin_once(timeout_sec=POLL_PERIOD)
                if on_interrupt is not None and stop.interrupted:
                    on_interrupt(managed)
                    on_interrupt = None
            task = executor.create_task(managed.stop)
            deadline = time.monotonic() + STOP_TIMEOUT
            while not task.done() and time.monotonic() < deadline:
                executor.spin_once(timeout_sec=POLL_PERIOD)
            if task.done() and task.exception() is not None:
                managed.node.get_logger().error(f"while stopping: {task.exception()}")
            return managed.exit_code or 0
        except (ExternalShutdownException, ROSInterruptException):
            return 0
        finally:
            managed.close()
    finally:
        executor.shutdown(timeout_sec=0.5)
        rclpy.try_shutdown()


def exit_process(status: int) -> NoReturn:
    """End the process now; threads that still compute are not waited for."""
    for stream in (sys.stdout, sys.stderr):
        if stream is not None:  # it was open when the process began
            stream.flush()
    os._exit(status)


class _StopRequest:
    """Remembers that SIGINT or SIGTERM came, and sees to it that the process ends in time.

    Attributes:
        requested: Whether the process was asked to end.
        interrupted: Whether a SIGINT came that is no such request yet.
    """

    def __init__(self, deferred: bool) -> None:
        self.requested = False
        self.interrupted = False
        self._deferred = deferred
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._handle)

    def _handle(self, number: int, _frame: FrameType | None) -> None:
        if self._deferred and number == signal.SIGINT:
            self._deferred, self.interrupted = False, True
            return
        if self.requested:
            os._exit(128 + number)
        self.requested = True
        # On a thread that needs no interpreter, so that the process ends, and says where it was, also
        # where a library never gives up the interpreter's lock.
        faulthandler.dump_traceback_later(EXIT_TIMEOUT, exit=True)


def _as_yaml(spec: ParameterSpec) -> str:
    """Return the default of a parameter as a parameter file holds it."""
    return json.dumps(spec.default)


def _first_line(error: BaseException) -> str:
    return str(error).strip().split("\n", maxsplit=1)[0]

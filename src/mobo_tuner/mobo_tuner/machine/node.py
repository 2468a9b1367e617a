"""Lifecycle node of a machine, and a program around it in one call.

`configure` connects the machine: it can be read, but not moved. `activate` allows motion and
`deactivate` forbids it again, after stopping what moves. With the parameter `autostart` (the default)
the node configures and activates itself when it starts; nothing moves before a client asks for it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NoReturn

from rcl_interfaces.msg import SetParametersResult
from rclpy.executors import Executor
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.node import Node
from rclpy.parameter import Parameter

from mobo_msgs_py.action import EvaluateSetpoint
from mobo_tuner.machine.backend import Failure, MachineBackend
from mobo_tuner.machine.health import machine_parts
from mobo_tuner.machine.server import MachineServer
from mobo_tuner.parameter_spec import AUTOSTART, ParameterSpec
from mobo_tuner.ros.diagnostics import Diagnostics
from mobo_tuner.ros.lifecycle import refuse_unknown_transitions
from mobo_tuner.ros.parameters import declare, refuse_undeclared, take_given
from mobo_tuner.ros.process import Program, StartError, exit_process, run_node
from mobo_tuner.wording import counted

NOT_CONFIGURED = "the machine's node is not configured"
NOT_ACTIVE = "the machine's node is not active"
_SUCCESS = TransitionCallbackReturn.SUCCESS


class MachineNode(LifecycleNode):
    """Lifecycle node that serves one machine.

    Every interface exists from the start and refuses what the node's state does not allow.

    Args:
        name: Name of the node.
        executor: Executor that spins the node.
        create: Function that makes the machine's backend for this node; it may declare parameters.

    Raises:
        ValueError, StartError: If `create` or a parameter says why the node cannot start.
    """

    exit_code = None

    def __init__(
        self, name: str, executor: Executor, create: Callable[[Node, Executor], MachineBackend]
    ) -> None:
        super().__init__(name, automatically_declare_parameters_from_overrides=True)
        refuse_unknown_transitions(self)
        given = take_given(self)
        try:
            self.backend = create(self, executor)
            if not self.has_parameter(AUTOSTART.name):
                declare(self, (AUTOSTART,))
            refuse_undeclared(self, given)
        except StartError:
            try:  # a name may have been misspelt
                refuse_undeclared(self, given, misspelt=True)
            finally:
                self.destroy_node()
            raise
        except BaseException:
            self.destroy_node()
            raise
        self.add_on_set_parameters_callback(self._refuse_undeclared)
        self.backend.inactive = NOT_CONFIGURED
        self.server = MachineServer(self, self.backend, executor)
        parts = machine_parts(self, self.backend, self.server)
        self._diagnostics = Diagnostics(self, self.backend.name, parts)

    @property
    def node(self) -> Node:
        """The rclpy node: this object."""
        return self

    def autostart(self) -> None:
        """Configure and activate the node if its parameter says so; called once, at the end of start.

        Raises:
            StartError: If a transition fails.
        """
        if not self.get_parameter(AUTOSTART.name).value:
            return
        if self.trigger_configure() is not _SUCCESS or self.trigger_activate() is not _SUCCESS:
            self.close()
            raise StartError("the machine could not be switched on; the log above says why")

    def on_configure(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Connect the machine; nothing may move yet."""
        self.backend.inactive = NOT_ACTIVE
        return _SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Allow motion."""
        self.backend.inactive = ""
        self.get_logger().info(
            f"{self.backend.name}: ready with {counted(len(self.backend.variables), 'variable')} and "
            f"{counted(len(self.backend.diagnostics), 'diagnostic')}; it serves {self.server.names}"
        )
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop what moves, and forbid motion."""
        self.halt("the machine's node was deactivated")
        return super().on_deactivate(state)

    def on_cleanup(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Disconnect the machine."""
        self.halt(NOT_CONFIGURED)
        return _SUCCESS

    def on_shutdown(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Stop what moves, for good."""
        self.halt("the machine's node was shut down")
        return _SUCCESS

    def on_error(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Stop what moves after a transition that failed."""
        self.halt("the machine's node failed")
        return _SUCCESS

    def halt(self, reason: str) -> None:
        """Stop what moves, and forbid motion for this reason."""
        self.backend.inactive = reason
        self.server.interrupt(Failure(EvaluateSetpoint.Result.NOT_ACTIVE, reason))
        self.backend.hold()
        self.get_logger().info(reason)

    async def stop(self) -> None:
        """Stop whatever moves, where it is."""
        await self.server.stop()

    def close(self) -> None:
        """Release the machine and the node."""
        self.backend.close()
        self.destroy_node()

    def _refuse_undeclared(self, parameters: list[Parameter]) -> SetParametersResult:
        """Refuse a parameter without a name, which rclpy accepts although nobody declared it."""
        unknown = [p.name for p in parameters if not self.has_parameter(p.name)]
        reason = f"the parameter '{unknown[0]}' is unknown" if unknown else ""
        return SetParametersResult(successful=not unknown, reason=reason)


def serve(
    create: Callable[[Node, Executor], MachineBackend],
    name: str = "machine",
    description: str = "Serves a machine to the tuner.",
    parameters: Sequence[ParameterSpec] = (AUTOSTART,),
) -> NoReturn:
    """Run a machine's node as this process until a signal stops it.

    Args:
        create: Function, or class of a backend, that makes the machine's backend when it is given
            the node and its executor. A `ValueError` or `StartError` that it raises ends the
            process with status 2 and the error's message.
        name: Name of the node.
        description: Purpose of the node, for `--help`.
        parameters: Parameters that `--help` lists.
    """

    def start(executor: Executor) -> MachineNode:
        node = MachineNode(name, executor, create)
        node.autostart()
        return node

    exit_process(run_node(start, Program(name, description, parameters)))

"""The simulated machine as a process in a separate ROS domain, with a client."""

from __future__ import annotations

import contextlib
import os
import signal
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

import rclpy
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.srv import SetParameters
from rclpy.action import ActionClient
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from mobo_msgs_py.action import ApplySetpoint, EvaluateSetpoint
from mobo_msgs_py.srv import DescribeMachine
from mobo_tuner.ros.qos import STREAM
from robustness.processes import NodeProcess

ROOT = Path(__file__).resolve().parents[1]
TIMEOUT = 30.0  # [s] for any wait


class LostError(Exception):
    """A wait that exceeded its time limit, or a machine that ended; the message says which."""


class MachineProcess:
    """The machine's process and a client of it; the end of the `with` block stops the process.

    Args:
        environment: Environment variables with the ROS domain.
        parameters: Parameters of the node.
    """

    def __init__(self, environment: Mapping[str, str], parameters: Mapping[str, Any]) -> None:
        options = [w for name, value in parameters.items() for w in ("-p", f"{name}:={value}")]
        self._scratch = tempfile.TemporaryDirectory()
        log = Path(self._scratch.name, "log")
        self._process = NodeProcess.start(
            "-m",
            "awa_sim_node.node",
            "--ros-args",
            *options,
            stdout_path=log,
            stderr_path=log,
            environment=environment,
        )
        self._context = Context()
        rclpy.init(context=self._context, domain_id=int(environment["ROS_DOMAIN_ID"]))
        self._executor = SingleThreadedExecutor(context=self._context)
        self.node = Node("client", context=self._context)
        self._executor.add_node(self.node)
        self._evaluate = ActionClient(self.node, EvaluateSetpoint, "evaluate_setpoint")
        self._apply = ActionClient(self.node, ApplySetpoint, "apply_setpoint")
        self._services = {
            "describe_machine": self.node.create_client(DescribeMachine, "describe_machine"),
            "set_parameters": self.node.create_client(SetParameters, "awa_sim/set_parameters"),
            "change_state": self.node.create_client(ChangeState, "awa_sim/change_state"),
        }

    def __enter__(self) -> MachineProcess:
        self.spin_until(
            lambda: (
                self._evaluate.server_is_ready()
                and self._apply.server_is_ready()
                and all(client.service_is_ready() for client in self._services.values())
            ),
            "the machine",
        )
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        with contextlib.suppress(TimeoutError):  # it is killed then
            self._process.stop(signal.SIGTERM, 10.0)
        self._executor.shutdown(timeout_sec=1.0)
        self.node.destroy_node()
        self._context.try_shutdown()
        self._scratch.cleanup()

    @property
    def alive(self) -> bool:
        """Whether the process is running."""
        return self._process.running

    @property
    def log(self) -> str:
        """Output of the machine so far."""
        return self._process.stderr

    @property
    def memory(self) -> float:
        """Resident memory of the machine [MB]."""
        pages = int(Path(f"/proc/{self._process.popen.pid}/statm").read_text().split()[1])
        return pages * os.sysconf("SC_PAGE_SIZE") / 1e6

    @property
    def open_files(self) -> int:
        """Number of open file descriptors of the machine."""
        return len(os.listdir(f"/proc/{self._process.popen.pid}/fd"))

    @property
    def threads(self) -> int:
        """Number of the machine's threads."""
        return len(os.listdir(f"/proc/{self._process.popen.pid}/task"))

    @property
    def cpu_seconds(self) -> float:
        """CPU time of the machine [s]."""
        fields = Path(f"/proc/{self._process.popen.pid}/stat").read_text().rsplit(")", 1)[1].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def spin_until(
        self, condition: Callable[[], object], what: str, timeout: float = TIMEOUT
    ) -> None:
        """Process messages until a condition holds.

        Args:
            condition: Callable that returns a true value to end the wait.
            what: Description of the condition, for the error.
            timeout: Time limit [s].

        Raises:
            LostError: If the condition does not hold in time, or the machine has ended.
        """
        deadline = time.monotonic() + timeout
        while not condition():
            if not self.alive:
                raise LostError(f"the machine ended while waiting for {what}:\n{self.log}")
            if time.monotonic() > deadline:
                raise LostError(f"{what} did not come within {timeout:g} s")
            self._executor.spin_once(timeout_sec=0.05)

    def send(self, goal: Any) -> Any:
        """Send a goal of either action, and return the handle of the accepted goal."""
        client = self._apply if isinstance(goal, ApplySetpoint.Goal) else self._evaluate
        sent = client.send_goal_async(goal)
        self.spin_until(sent.done, "the answer to a goal")
        handle = sent.result()
        if not handle.accepted:
            raise LostError("a goal was not accepted")
        return handle

    def result(self, handle: Any) -> Any:
        """Wait for the result of a goal."""
        future = handle.get_result_async()
        self.spin_until(future.done, "a result")
        return future.result().result

    def call(self, name: str, request: Any) -> Any:
        """Return the answer of a service: describe_machine, set_parameters or change_state."""
        future = self._services[name].call_async(request)
        self.spin_until(future.done, f"the answer of {name}")
        return future.result()

    def publisher(self, message: type, topic: str) -> Any:
        """Return a publisher that the machine has discovered."""
        publisher = self.node.create_publisher(message, topic, STREAM)
        self.spin_until(lambda: publisher.get_subscription_count() > 0, f"a subscriber of {topic}")
        return publisher

"""A tuner, a machine and a recorder as processes that can be killed, and a client of them.

The machine is the simulated one, or one without the project's message types behind the bridge.
Unlike with `mobo.py run`, no process stops the others when one dies, as with nodes on several hosts.
"""

from __future__ import annotations

import math
import signal
import time
import uuid
from collections.abc import Callable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

import rclpy
from action_msgs.srv import CancelGoal
from rclpy.action import ActionClient
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from launcher.ros_domain import RosDomain
from mobo_msgs_py import msg
from mobo_msgs_py.action import ApplySetpoint, EvaluateSetpoint, Tune
from mobo_tuner.ros.qos import LATCHED, STREAM
from robustness.processes import NodeProcess

ROOT = Path(__file__).resolve().parents[1]
TIMEOUT = 90.0  # [s] for any wait; a longer wait is a hang
CLIENT_TIMEOUT = 2.0  # [s] without a heartbeat
RUNS_PER_BAG = 12
_SPIN = 0.05  # [s]
_POLL = 0.3  # [s] between two readings of the machine's position


class HangError(Exception):
    """A wait that exceeded its time limit; the message says for what."""


class Client:
    """A client of one scene.

    A new client is free of discovery data of dead processes.

    Args:
        domain_id: ROS domain of the scene.

    Attributes:
        heard: Evaluations published so far.
        started: Goal IDs of the evaluations that the machine has begun.
    """

    def __init__(self, domain_id: int) -> None:
        self._context = Context()
        rclpy.init(context=self._context, domain_id=domain_id)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._node = Node("chaos", context=self._context, enable_rosout=False)
        self._executor.add_node(self._node)
        self._tune = ActionClient(self._node, Tune, "tune")
        self._apply = ActionClient(self._node, ApplySetpoint, "apply_setpoint")
        # Created last: a server that answers it has discovered all of the clients above.
        self._probe = self._node.create_client(CancelGoal, "tune/_action/cancel_goal")
        self.heard: list[msg.Evaluation] = []
        self.started: set[bytes] = set()
        self._recorded: set[str] = set()
        self._result: Any = None
        kind = EvaluateSetpoint.Impl.FeedbackMessage
        self._subscriptions = [
            self._node.create_subscription(msg.Evaluation, "evaluation", self.heard.append, STREAM),
            self._node.create_subscription(
                msg.RecorderStatus, "recorder_status", self._hear_recorder, LATCHED
            ),
            self._node.create_subscription(
                kind, "evaluate_setpoint/_action/feedback", self._hear_feedback, STREAM
            ),
        ]

    def _hear_feedback(self, message: Any) -> None:
        self.started.add(bytes(message.goal_id.uuid))

    def _hear_recorder(self, message: msg.RecorderStatus) -> None:
        self._recorded.update(message.topics)

    def spin(self, seconds: float) -> None:
        """Process messages for `seconds`."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0.0:
            self._executor.spin_once(timeout_sec=min(left, _SPIN))

    def spin_while(self, condition: Callable[[], bool], seconds: float) -> None:
        """Process messages while a condition holds, for at most `seconds`."""
        end = time.monotonic() + seconds
        while condition() and time.monotonic() < end:
            self._executor.spin_once(timeout_sec=_SPIN)

    def spin_until(self, condition: Callable[[], object], what: str) -> None:
        """Process messages until a condition holds.

        Args:
            condition: Callable that returns a true value to end the wait.
            what: Description of the condition, for the error.

        Raises:
            HangError: If the condition does not hold in time.
        """
        deadline = time.monotonic() + TIMEOUT
        while not condition():
            if time.monotonic() > deadline:
                raise HangError(f"{what} did not come within {TIMEOUT:g} s")
            self._executor.spin_once(timeout_sec=_SPIN)

    def wait_for_all(self) -> None:
        """Wait until tuner, machine and recorder are ready.

        Raises:
            HangError: If they are not ready in time.
        """
        for client, what in ((self._tune, "the tuner"), (self._apply, "the machine")):
            self.spin_until(client.server_is_ready, what)
        self._meet_tuner()
        self.spin_until(lambda: self._node.count_publishers("evaluation"), "the tuner's topics")
        self.spin_until(lambda: "/evaluation" in self._recorded, "the recorder")

    def _meet_tuner(self) -> None:
        """Cancel an unknown goal until the tuner answers, because earlier requests may be lost.

        Raises:
            HangError: If the tuner does not answer.
        """
        request = CancelGoal.Request()
        request.goal_info.goal_id.uuid = list(uuid.uuid4().bytes)
        deadline = time.monotonic() + TIMEOUT
        while time.monotonic() < deadline:
            answer = self._probe.call_async(request)
            self.spin_while(lambda a=answer: not a.done(), 1.0)  # type: ignore[misc]
            if answer.done():
                return
            self._probe.remove_pending_request(answer)
        raise HangError("the tuner does not answer")

    def begin(self, goal: Tune.Goal) -> None:
        """Begin a run.

        Args:
            goal: Goal of the tuner's action.

        Raises:
            HangError: If the tuner does not answer.
        """
        sent = self._tune.send_goal_async(goal)
        self.spin_until(sent.done, "the answer to a goal")
        self._result = sent.result().get_result_async()

    @property
    def done(self) -> bool:
        """Whether the run has ended."""
        return self._result is not None and self._result.done()

    def result(self) -> Tune.Result:
        """Wait for the result of the run.

        Raises:
            HangError: If the result does not come in time.
        """
        self.spin_until(lambda: self.done, "the end of a run")
        return self._result.result().result

    def where(self) -> dict[str, float]:
        """Return the machine's readbacks, from its answer to a move without a set-point.

        Raises:
            HangError: If the machine does not answer, or does not know where it is.
        """
        deadline = time.monotonic() + TIMEOUT
        while not all(map(math.isfinite, (found := self._ask_where(deadline)).values())):
            if time.monotonic() > deadline:  # a bridge that has just started hears its machine late
                raise HangError("the machine does not know where it is")
            self.spin(_POLL)
        return found

    def _ask_where(self, deadline: float) -> dict[str, float]:
        while True:  # a request right after discovery may be lost
            sent = self._apply.send_goal_async(ApplySetpoint.Goal())
            self.spin_while(lambda s=sent: not s.done(), 2.0)  # type: ignore[misc]
            if sent.done():
                break
            if time.monotonic() > deadline:
                raise HangError("the machine does not answer")
        got = sent.result().get_result_async()
        self.spin_until(got.done, "the machine's readbacks")
        return {item.name: item.value for item in got.result().result.readbacks}

    def watch_until(
        self, condition: Callable[[Mapping[str, float]], bool], after: float, seconds: float
    ) -> dict[str, float]:
        """Wait until the machine rests at a position that meets a condition.

        Args:
            condition: Callable that returns whether a position is as expected.
            after: Earliest time at which the position counts, by `time.monotonic` [s].
            seconds: Time after `after` at which the wait ends in any case [s].

        Returns:
            The last position.
        """
        deadline = after + seconds
        before: dict[str, float] = {}
        while True:
            now = self.where()
            rests = before and max(abs(now[name] - before[name]) for name in now) < 1e-3
            time_is_up = time.monotonic() > deadline
            if time_is_up or (time.monotonic() > after and rests and condition(now)):
                return now
            before = now
            self.spin(_POLL)

    def close(self) -> None:
        """Leave the domain."""
        self._executor.shutdown(timeout_sec=1.0)
        self._node.destroy_node()
        self._context.try_shutdown()


class Scene:
    """The processes of one ROS domain.

    Args:
        folder: Folder for runs, bags and logs.
        bridged: Whether the machine is behind the bridge.
    """

    def __init__(self, folder: Path, *, bridged: bool) -> None:
        self.folder = folder
        self.runs_dir = folder / "runs"
        self.runs_dir.mkdir(parents=True, exist_ok=True)
        self.machine = "bridge" if bridged else "machine"
        self._domain = RosDomain()
        self._processes: dict[str, NodeProcess] = {}
        self._bags = 0
        self.recorded: list[str] = []  # IDs of the runs that began after the recorder
        self.on_client_lost = "hold"
        self.client = Client(self._domain.id)

    def __enter__(self) -> Scene:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.client.close()
        for name in list(self._processes):
            self.kill(name)
        self._domain.close()

    @property
    def bag(self) -> Path:
        """The current or latest bag."""
        return self.folder / f"bag-{self._bags}"

    @property
    def bag_is_old(self) -> bool:
        """Whether the current bag has enough runs."""
        return self._alive("recorder") and len(self.recorded) >= RUNS_PER_BAG

    def start_missing(self, on_client_lost: str, speed: float) -> None:
        """Start all processes that are not running.

        Args:
            on_client_lost: Policy of the machine, for a tuner that is started.
            speed: Simulated seconds per second, for a machine that is started.
        """
        if self.machine == "bridge" and not self._alive("foreign"):
            self._start("foreign", [str(ROOT / "examples" / "foreign_machine.py")])
        if not self._alive(self.machine):
            self.start_machine(speed)
        if not self._alive("tuner"):
            self.on_client_lost = on_client_lost
            values = {
                "runs_dir": str(self.runs_dir),
                "initial_evaluations": 4,
                "client_timeout": CLIENT_TIMEOUT,
                "machine_timeout": 3.0,
                "machine_return_timeout": TIMEOUT / 2.0,
                "retry_delay": 0.2,
                "on_client_lost": on_client_lost,
            }
            self._start_node("tuner", "mobo_tuner.nodes.tuner", values, ROOT / "config/toy.yaml")
        if not self._alive("recorder"):
            self._bags += 1
            self.recorded = []
            self._start_node("recorder", "mobo_tuner.nodes.recorder", {"bag_path": str(self.bag)})
        self.client.close()
        self.client = Client(self._domain.id)
        self.client.wait_for_all()

    def start_machine(self, speed: float) -> None:
        """Start the machine, or the bridge to it.

        Args:
            speed: Simulated seconds per second.
        """
        if self.machine == "bridge":
            mapping = str(ROOT / "config" / "bridge_foreign.yaml")
            self._start_node("bridge", "mobo_tuner.nodes.machine_bridge", {"mapping": mapping})
        else:
            values = {"model": "toy", "mode": "ideal", "speed": speed}
            self._start_node("machine", "awa_sim_node.node", values)

    def begin(self, goal: Tune.Goal) -> None:
        """Begin a run, which the current bag records completely.

        Args:
            goal: Goal of the tuner's action.

        Raises:
            HangError: If the tuner does not answer.
        """
        self.recorded.append(goal.run_id)
        self.client.begin(goal)

    def kill(self, name: str) -> None:
        """Kill a process."""
        self._processes.pop(name).kill()

    def stop(self, name: str) -> int:
        """Stop a process and return its exit status.

        Args:
            name: Name of the process.

        Raises:
            HangError: If the process does not stop in time.
        """
        try:
            return self._processes.pop(name).stop(signal.SIGTERM, TIMEOUT)
        except TimeoutError:
            raise HangError(f"the {name} did not stop") from None

    def dead(self) -> list[str]:
        """Return the names of processes that ended without being stopped."""
        return [name for name, process in self._processes.items() if not process.running]

    def tracebacks(self) -> list[str]:
        """Return the names of the logs that contain a traceback."""
        return [
            path.stem for path in self.folder.glob("*.log") if b"Traceback" in path.read_bytes()
        ]

    def abandon(self) -> None:
        """Kill every node, from any thread."""
        for process in list(self._processes.values()):
            process.kill()

    def _alive(self, name: str) -> bool:
        return name in self._processes and self._processes[name].running

    def _start_node(
        self, name: str, module: str, values: Mapping[str, Any], file: Path | None = None
    ) -> None:
        given = [word for key, value in values.items() for word in ("-p", f"{key}:={value}")]
        files = ["--params-file", str(file)] if file else []
        node = {"machine": "awa_sim", "bridge": "machine_bridge"}.get(name, name)
        given = [w if w == "-p" else f"{node}:{w}" for w in given]
        self._start(name, ["-m", module, "--ros-args", *files, *given])

    def _start(self, name: str, words: list[str]) -> None:
        log = self.folder / f"{name}.log"
        self._processes[name] = NodeProcess.start(
            *words, stdout_path=log, stderr_path=log, environment=self._domain.environment
        )

"""A shift with a tuner, a machine, a recorder and an operator, and what may happen in it."""

from __future__ import annotations

import resource
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import rclpy
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.action import ActionClient
from rclpy.executors import SingleThreadedExecutor
from rclpy.logging import LoggingSeverity, set_logger_level
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from std_srvs.srv import Trigger

from mobo_msgs_py import msg
from mobo_msgs_py.action import EvaluateSetpoint, GoToWorkingPoint, Tune
from mobo_msgs_py.srv import Ask, ForgetEvaluation, ListWorkingPoints, QueueSetpoint, Tell
from mobo_tuner.machine.double import Answer, MachineDouble
from mobo_tuner.nodes.tuner import Tuner
from mobo_tuner.ros import interfaces
from mobo_tuner.ros.conversions import named_values, values_of
from mobo_tuner.ros.process import STOP_TIMEOUT
from mobo_tuner.runs.journal import FILE_NAME
from robustness.integrity import bag_faults
from robustness.offline_run import toy
from robustness.processes import NodeProcess, NodeStarter
from robustness.shift_model import NAMES, BrokenPromiseError, ShiftModel, Watch, require

TOY = Path(__file__).parents[1] / "config" / "toy.yaml"
LIMIT = 3.0  # of the machine's variables, on both sides
PATIENCE = 30.0  # [s] for an answer, and for a run to end
FULL = 1024  # [byte] that a file may have on a disk that is full
QUERIES = ("points", "points of an earlier run")
_CODES = EvaluateSetpoint.Result
FAULTS = (
    _CODES.INTERLOCK,
    _CODES.NOT_ACTIVE,
    _CODES.MACHINE_LOST,
    _CODES.TIMEOUT,
    _CODES.INVALID_MEASUREMENT,
    _CODES.VIOLATION,
    _CODES.BUSY,
)
POLICIES = {
    "on_interlock": ("wait", "retry", "pause", "abort"),
    "on_fault": ("wait", "retry", "pause", "abort"),
    "on_failure": ("skip", "retry", "pause", "abort"),
    "on_abort": ("hold", "restore", "best"),
    "on_violation": ("hold", "restore", "best"),
    "on_client_lost": ("hold", "restore", "best"),
    "pause_on_violation": ("true", "false"),
    "model_input": ("setpoint", "readback"),
    "on_recorder_lost": ("continue", "pause"),
}
CONSTANTS = {
    "retry_delay": 0.1,
    "interlock_timeout": 1.0,
    "machine_return_timeout": 1.0,
    "machine_timeout": 1.0,
    "discovery_timeout": 5.0,
    "max_consecutive_failures": 4,
    "initial_evaluations": 30,
}
WEIGHTS = {
    "tune": 8,
    "resume run": 2,
    "wait": 10,
    "pause": 4,
    "resume": 6,
    "step": 3,
    "skip": 4,
    "stop_after_this": 2,
    "cancel": 2,
    "queue": 6,
    "bounds": 6,
    "limits": 2,
    "reference": 2,
    "budget": 2,
    "go": 6,
    "forget": 3,
    "unforget": 2,
    "points": 2,
    "points of an earlier run": 2,
    "ask and tell": 2,
    "fault": 4,
    "hold the machine": 2,
    "release the machine": 3,
    "start a recorder": 2,
    "kill the recorder": 1,
    "fill the disk": 1,
    "free the disk": 3,
}


class Act(NamedTuple):
    """One action; the numbers in [0, 1) decide about its details, so that others may be left out before it."""

    name: str
    numbers: tuple[float, float, float]


class Shift:
    """One shift.

    Args:
        folder: Folder of its runs and processes, which is empty.
        seed: Seed of the policies.
        domain: ROS domain, which nobody else uses.
    """

    def __init__(self, folder: Path, seed: int, domain: int) -> None:
        rng = np.random.default_rng([seed, 1])
        policies = {name: str(rng.choice(choices)) for name, choices in POLICIES.items()}
        given = {**policies, **CONSTANTS, "runs_dir": folder / "runs", "seed": seed}
        words = [w for n, v in given.items() for w in ("-p", f"tuner:{n}:={v}")]
        rclpy.init(
            args=["--ros-args", "--params-file", str(TOY), *words],
            domain_id=domain,
            signal_handler_options=SignalHandlerOptions.NO,
        )
        self._runs_dir = folder / "runs"
        self._model = ShiftModel(self._runs_dir)
        self._processes = NodeStarter(folder)
        self._recorder: tuple[Path, NodeProcess] | None = None
        self._recorded: list[str] = []  # ids of the runs that began after the recorder
        self._unlimited = resource.getrlimit(resource.RLIMIT_FSIZE)
        self._executor = SingleThreadedExecutor()
        self._tuner = Tuner(self._executor)
        set_logger_level("tuner", LoggingSeverity.FATAL)
        self._executor.add_node(self._tuner.node)
        self._node = Node("operator", use_global_arguments=False)
        self._executor.add_node(self._node)
        set_logger_level("operator", LoggingSeverity.FATAL)
        self._faults: deque[int] = deque()
        limits = dict.fromkeys(NAMES, (-LIMIT, LIMIT))
        self._machine = MachineDouble(self._node, limits, ("f1", "f2", "g"), self._answer)
        self._machine.position = dict.fromkeys(NAMES, 0.5)
        gate = self._tuner._context.gate
        gate._machine = Watch(gate._machine, self._model.check_motion)
        interfaces.STATUS.subscription(self._node, self._model.hear)
        self._clients: dict[str, Any] = {}
        self._tune = ActionClient(self._node, Tune, "tune")
        self._go = ActionClient(self._node, GoToWorkingPoint, "go_to_working_point")
        self._handle: Any = None
        self._result: Any = None  # future of the active run
        self._number = 0
        self._before = ""  # id of the run before the one that was asked for last
        self._spin(lambda: self._tune.server_is_ready() and self._go.server_is_ready(), "the tuner")

    def close(self) -> None:
        """Release everything."""
        self._limit_files(self._unlimited[0])
        for process in self._processes.processes:
            process.kill()
        self._machine.held = False
        stopped = self._executor.create_task(self._tuner.stop)
        deadline = time.monotonic() + STOP_TIMEOUT
        while not stopped.done() and time.monotonic() < deadline:
            self._executor.spin_once(timeout_sec=0.01)
        self._tuner.close()
        self._executor.shutdown(timeout_sec=1.0)
        self._node.destroy_node()
        rclpy.try_shutdown()

    # ------------------------------------------------------------------ the machine and what is seen

    def _answer(self, goal: EvaluateSetpoint.Goal) -> Answer:
        values = toy(values_of(goal.setpoint))
        if not self._faults:
            return Answer(values)
        code = self._faults.popleft()
        return Answer(values if code == _CODES.VIOLATION else {}, code, "a fault of this campaign")

    @property
    def _running(self) -> bool:
        return self._result is not None

    def _spin(self, condition: Callable[[], object], what: str, patience: float = PATIENCE) -> None:
        deadline = time.monotonic() + patience
        while not condition():
            require(time.monotonic() < deadline, f"{what}: nothing came in {patience:g} s")
            self._executor.spin_once(timeout_sec=0.01)
            if self._result is not None and self._result.done():
                self._conclude(self._result.result().result)
        self._model.check()

    def _pass(self, seconds: float) -> None:
        """Let time pass."""
        end = time.monotonic() + seconds
        self._spin(lambda: time.monotonic() > end, "time")

    def _call(self, kind: Any, name: str, request: Any = None) -> Any:
        client = self._clients.setdefault(name, self._node.create_client(kind, name))
        self._spin(client.service_is_ready, f"the service {name}")
        answer = client.call_async(kind.Request() if request is None else request)
        self._spin(answer.done, f"the answer of {name}")
        return answer.result()

    def _conclude(self, result: Tune.Result) -> None:
        """Check everything that is known of a run that has ended."""
        self._result = self._handle = None
        if self._model.conclude(result):  # it was refused, though not at once
            self._model.latest = self._before
            return
        self._spin(lambda: self._model.status.state == msg.TunerStatus.IDLE, "an idle tuner")
        self._model.check_idle(result)

    # ------------------------------------------------------------------ actions

    def act(self, act: Act) -> None:
        """Do one action, and check what must hold.

        Raises:
            BrokenPromiseError: If something does not.
        """
        a, b, c = act.numbers
        name = act.name
        if name in ("tune", "resume run"):
            self._begin(name, a, b)
        elif name == "wait":
            self._pass(0.01 + 0.2 * a * a)
        elif name in ("pause", "resume", "step", "skip", "stop_after_this"):
            self._trigger(name)
        elif name == "cancel":
            if self._handle is not None:
                self._handle.cancel_goal_async()
        elif name == "queue":
            self._queue(a, b)
        elif name in ("bounds", "limits", "reference", "budget"):
            self._set(name, a, b, c)
        elif name == "go":
            self._go_to(a, b, c)
        elif name in ("forget", "unforget"):
            self._withdraw(name, a, b)
        elif name in QUERIES:
            self._list(earlier=name != "points", share=a)
        elif name == "ask and tell":
            self._ask_and_tell()
        elif name == "fault":
            self._faults.extend([FAULTS[int(a * len(FAULTS))]] * (1 + int(4 * b)))
        elif name == "start a recorder":
            self._start_recorder()
        elif name == "kill the recorder":
            self._lose_recorder(full=a < 0.5)
        elif name in ("fill the disk", "free the disk"):
            self._limit_files(FULL if name == "fill the disk" else self._unlimited[0])
        else:
            self._machine.held = name == "hold the machine"
        self._pass(0.002)

    def _begin(self, name: str, a: float, b: float) -> None:
        self._number += 1
        goal = Tune.Goal(run_id=f"run-{self._number}", evaluations=2 + int(14 * a))
        if name == "resume run":
            if not self._model.ended:
                return
            goal.resume_from = self._model.ended[int(b * len(self._model.ended))]
            goal.evaluations = 20 + int(20 * a)
        already = self._running
        sent = self._tune.send_goal_async(goal)
        self._spin(sent.done, "the answer to a goal")
        handle = sent.result()
        require(handle.accepted, "a goal was rejected")
        result = handle.get_result_async()
        if already and self._running:  # refused at once, unless the other run has just ended
            self._spin(lambda: result.done() or not self._running, "the refusal of a second run")
            if result.done():
                refusal = result.result().result
                require(refusal.error_code == Tune.Result.INVALID_GOAL, "two runs were begun")
                return
        self._result, self._handle = result, handle
        self._model.running = True
        self._before = self._model.latest
        self._recorded.append(goal.run_id)
        self._pass(0.02)
        if self._running:
            self._model.latest = goal.run_id

    def _trigger(self, name: str) -> None:
        idle = not self._running
        answer = self._call(Trigger, name)
        if idle:
            require(not answer.success, f"'{name}' was accepted without a run")
        require(answer.message, f"'{name}' has no answer in words")

    def _queue(self, a: float, b: float) -> None:
        setpoint = {"x1": LIMIT * (2.2 * a - 1.1), "x2": LIMIT * (2.2 * b - 1.1)}
        idle = not self._running
        request = QueueSetpoint.Request(setpoint=named_values(setpoint, {}))
        answer = self._call(QueueSetpoint, "queue_setpoint", request)
        inside = all(low <= setpoint[n] <= high for n, (low, high) in self._model.bounds.items())
        require(not (answer.success and idle), "a set-point was queued without a run")
        require(not answer.success or inside, f"{setpoint} was queued, out of bounds")

    def _set(self, kind: str, a: float, b: float, c: float) -> None:
        values: dict[str, Any]
        if kind == "bounds":
            name = NAMES[int(2.0 * c)]
            low, high = LIMIT * (1.2 * a - 1.01), LIMIT * (1.01 - 1.2 * b)
            values = {f"variables.{name}.min": low, f"variables.{name}.max": high}
            self._model.asked_bounds = {**self._model.bounds, name: (low, high)}
        elif kind == "limits":
            values = {"constraints.g.max": 4.0 * a - 1.0}
        elif kind == "reference":
            values = {f"objectives.f{1 + int(2.0 * c)}.reference": 0.5 + 6.0 * a}
        else:
            values = {"evaluations": 1 + int(25.0 * a)}
        request = SetParametersAtomically.Request(
            parameters=[Parameter(n, value=v).to_parameter_msg() for n, v in values.items()]
        )
        answer = self._call(SetParametersAtomically, "tuner/set_parameters_atomically", request)
        require(answer.result.successful or answer.result.reason, "a refusal has no reason")
        if answer.result.successful and self._model.asked_bounds is not None:
            self._model.bounds = self._model.asked_bounds
        self._model.asked_bounds = None

    def _go_to(self, a: float, b: float, c: float) -> None:
        before = self._model.latest
        goal = GoToWorkingPoint.Goal(anyway=c < 0.3, measure=c > 0.7)
        if self._model.ended and b < 0.3:
            goal.run_id = self._model.ended[int(a * len(self._model.ended))]
        listed = self._call(
            ListWorkingPoints, "list_working_points", ListWorkingPoints.Request(run_id=goal.run_id)
        )
        points = listed.measured.points if listed.success else []
        if points and b > 0.1:
            point = points[int(a * len(points))]
            goal.index = point.index
            if goal.anyway:
                self._model.crossing = values_of(point.setpoint)
        else:
            goal.choice = GoToWorkingPoint.Goal.BY_WEIGHTS
            goal.weights = named_values({"f1": a}, {})
            goal.anyway = False
        goal.hold_evaluations = int(3.0 * b) if c < 0.5 else 0
        active = self._running
        sent = self._go.send_goal_async(goal)
        self._spin(sent.done, "the answer to a move")
        finished = sent.result().get_result_async()
        if self._machine.held and not active:
            sent.result().cancel_goal_async()
        deadline = time.monotonic() + PATIENCE
        while not finished.done() and time.monotonic() < deadline:
            next_look = time.monotonic() + 0.5
            self._spin(lambda: finished.done() or time.monotonic() > next_look, "a move")  # noqa: B023
            if self._model.status.state == msg.TunerStatus.PAUSED:  # of a run that holds the point
                self._call(Trigger, "resume")
        self._spin(finished.done, "the end of a move")
        result = finished.result().result
        self._model.crossing = None
        require(
            result.error_code != GoToWorkingPoint.Result.INTERNAL, f"internal: {result.error_msg}"
        )
        if result.error_code == GoToWorkingPoint.Result.NONE:
            wanted = goal.run_id or before
            require(result.run_id == wanted, f"{result.run_id} in place of {wanted}")
            if not goal.hold_evaluations and goal.choice == GoToWorkingPoint.Goal.BY_INDEX:
                require(result.point.index == goal.index, "another point")
                at, meant = self._machine.position, values_of(result.point.setpoint)
                require(
                    all(abs(at[n] - meant[n]) < 1e-9 for n in NAMES), f"at {at}, not at {meant}"
                )

    def _withdraw(self, name: str, a: float, b: float) -> None:
        index = int(a * 1.1 * max(1, self._model.status.evaluations))
        request = ForgetEvaluation.Request(index=index, diagnostic="f1" if b < 0.4 else "")
        answer = self._call(ForgetEvaluation, name, request)
        require(answer.message, f"'{name}' has no answer in words")

    def _list(self, *, earlier: bool, share: float) -> None:
        run_id = (
            self._model.ended[int(share * len(self._model.ended))]
            if earlier and self._model.ended
            else ""
        )
        request = ListWorkingPoints.Request(run_id=run_id)
        answer = self._call(ListWorkingPoints, "list_working_points", request)
        wanted = run_id or self._model.latest
        if answer.success and wanted:
            require(answer.measured.run_id == wanted, f"{answer.measured.run_id} for {wanted}")
        elif self._model.latest and not run_id:
            raise BrokenPromiseError(f"the front of the latest run is refused: {answer.message}")

    def _ask_and_tell(self) -> None:
        idle = not self._running
        asked = self._call(Ask, "ask")
        if not asked.success:
            require(asked.message, "a refusal has no reason")
            return
        require(idle or not self._running, "'ask' was answered during a run")
        self._model.latest = asked.run_id
        request = Tell.Request(
            run_id=asked.run_id,
            index=asked.index,
            setpoint=asked.setpoint,
            diagnostics=named_values(toy(values_of(asked.setpoint)), {}),
        )
        told = self._call(Tell, "tell", request)
        require(told.success or told.message, "a refusal has no reason")
        if not self._running:
            self._spin(lambda: self._model.status.run_id == asked.run_id, "a status of that run")

    def _start_recorder(self) -> None:
        """Start a recorder, unless one lives, and wait until the tuner says that it records."""
        if self._recorder is not None or resource.getrlimit(resource.RLIMIT_FSIZE)[0] == FULL:
            return
        bag = self._processes.folder / f"bag{len(self._processes.processes)}"
        words = ("-m", "mobo_tuner.nodes.recorder", "--ros-args", "-p", f"bag_path:={bag}")
        self._recorder = (bag, self._processes(*words))
        self._recorded.clear()
        self._spin(lambda: str(bag) in self._model.status.recorder, "the recorder")

    def _lose_recorder(self, *, full: bool) -> None:
        """Kill the recorder, or let it write no more."""
        if self._recorder is None:
            return
        bag, process = self._recorder
        if full:
            hard = resource.prlimit(process.popen.pid, resource.RLIMIT_FSIZE)[1]
            resource.prlimit(process.popen.pid, resource.RLIMIT_FSIZE, (FULL, hard))
        else:
            process.kill()
            self._check_bag(bag, whole=False)
        self._recorder = None
        if not full or self._running:  # a recorder without messages writes nothing
            self._model.dead_recorders[str(bag)] = time.monotonic()

    def _check_bag(self, bag: Path, *, whole: bool) -> None:
        runs = [run_id for run_id in self._recorded if run_id in self._model.ended]
        faults = [
            fault
            for fault in bag_faults(bag, self._runs_dir, runs, runs if whole else ())
            if not any(f"run {run_id} " in fault for run_id in self._model.lacking)
        ]
        require(not faults, "; ".join(faults))

    def _limit_files(self, size: int) -> None:
        """Let no file of this process become larger, in which the tuner lives: its disk is full."""
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, self._unlimited[1]))

    def end(self) -> None:
        """End the shift: the machine works, and the run ends when it is asked to."""
        self._machine.held = False
        self._faults.clear()
        self._limit_files(self._unlimited[0])
        if self._handle is not None:
            self._handle.cancel_goal_async()
            self._spin(lambda: not self._running, "the end of a canceled run")
        for path in sorted(self._runs_dir.glob(f"*/{FILE_NAME}")):
            self._model.read(path.parent.name)
        if self._recorder is not None:
            bag, process = self._recorder
            require(process.stop() == 0, f"the recorder ended with an error: {process.stderr}")
            self._check_bag(bag, whole=True)
        self._spin(
            lambda: all(map(self._model.tells_of_loss, self._model.dead_recorders)),
            "the loss of a recorder",
        )

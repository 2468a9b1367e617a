"""Connection to one tuner: its services, actions and topics, for threads that may block."""

from __future__ import annotations

import contextlib
import os
import queue
import secrets
import time
import uuid
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future
from functools import partial
from typing import Any, Protocol

import rclpy
from action_msgs.srv import CancelGoal
from rcl_interfaces.srv import GetParameters, ListParameters, SetParametersAtomically
from rclpy.action import ActionClient
from rclpy.context import Context
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.node import Node

from mobo_msgs_py import msg
from mobo_tuner.client.values import ErrorCode, TunerError
from mobo_tuner.ros import interfaces
from mobo_tuner.ros.executor_thread import ExecutorThread
from mobo_tuner.ros.parameters import check_domain

SILENCE_TIMEOUT = 5.0  # [s] without a status, which is published at 1 Hz, until the tuner is lost
RESTART_TIMEOUT = 2.0  # [s] without a status, after which the tuner may have been restarted
PROBE_TIMEOUT = 1.0  # [s] for the response to a probe
CLOSE_TIMEOUT = 5.0  # [s] for the goals that are canceled at the end
POLL_PERIOD = 0.05  # [s]

SERVICES: Mapping[str, type] = {
    **{service.name: service.kind for service in interfaces.SERVICES if service.node == "tuner"},
    "tuner/get_parameters": GetParameters,
    "tuner/list_parameters": ListParameters,
    "tuner/set_parameters_atomically": SetParametersAtomically,
    "go_to_working_point/_action/cancel_goal": CancelGoal,
}
PROBE = "tune/_action/cancel_goal"
ACTIONS: Mapping[str, type] = {
    action.name: action.kind for action in interfaces.ACTIONS if action.node == "tuner"
}
RUN_TOPICS = (interfaces.PROBLEM, interfaces.PARETO_FRONT, interfaces.EVALUATION)

Inbox = queue.SimpleQueue[Callable[[], object] | None]
"""Calls for a waiting thread; None only wakes it."""


class Listener(Protocol):
    """Receiver of the messages of the tuner's topics, on the executor's thread."""

    def take(self, topic: str, message: Any) -> None:
        """Take a message."""


class Connection:
    """Connection to one tuner.

    Args:
        namespace: Namespace of the tuner, relative to that of the node.
        domain_id: ROS domain; None for that of the environment. Not used with `node`.
        node: Node to use; None for one of its own, on an executor and thread of its own.
        executor: Executor that spins `node`; None for the one to which it was added.
        timeout: Time for the tuner to appear, and to answer what is quick [s].

    Attributes:
        status: Status that the tuner published last.
    """

    def __init__(
        self,
        namespace: str,
        *,
        domain_id: int | None,
        node: Node | None,
        executor: Executor | None,
        timeout: float,
    ) -> None:
        self._namespace = namespace.rstrip("/")
        self._timeout = timeout
        self._context: Context | None = None
        if node is None:
            check_domain(domain_id)
            self._context = Context()
            rclpy.init(context=self._context, domain_id=domain_id)
            node = Node(
                f"tuner_client_{os.getpid()}_{secrets.token_hex(4)}",
                context=self._context,
                use_global_arguments=False,
                enable_rosout=False,
                start_parameter_services=False,
            )
            executor = SingleThreadedExecutor(context=self._context)
            executor.add_node(node)
        executor = executor or node.executor
        if executor is None:
            raise ValueError("the node is on no executor: add it to one, or name the executor")
        self.status = msg.TunerStatus()
        self._node = node
        self._heard: float | None = None  # time of the last status, by `time.monotonic` [s]
        self._met = False  # whether the tuner has answered a probe
        self._services: dict[str, Any] = {}
        self._actions: dict[str, ActionClient] = {}
        self._subscriptions: dict[str, Any] = {}
        self._listeners: list[Listener] = []
        self._pursuits: list[_Pursuit] = []
        self._closed = False
        self._executor = ExecutorThread(executor, spin=self._context is not None)
        self._made = self._executor.post(self._make)

    def connect(self, timeout: float | None = None) -> None:
        """Wait until the tuner exists and has discovered this client.

        Args:
            timeout: Longest wait [s]; None for that of the connection.

        Raises:
            TunerError: If no tuner is found, or the wait is canceled.
        """
        with self._pursuit() as pursuit:
            self._connect(pursuit, timeout)

    def close(self) -> None:
        """Cancel the goals of this client, and release everything."""
        if self._closed:
            return
        self.cancel()
        deadline = time.monotonic() + CLOSE_TIMEOUT
        while self._pursuits and not self._executor.is_current and time.monotonic() < deadline:
            time.sleep(POLL_PERIOD)
        self._closed = True
        if self._context is None:
            self._executor.post(self._destroy)
            return
        self._executor.close()
        self._node.destroy_node()
        self._context.try_shutdown()

    def call(self, name: str, request: Any, timeout: float | None = None) -> Any:
        """Return the answer of a service.

        Args:
            name: Name of the service.
            request: Request of its type.
            timeout: Longest wait for the answer [s]; None for that of the connection.

        Raises:
            TunerError: If there is no tuner, or it does not answer.
        """
        with self._pursuit() as pursuit:
            self._connect(pursuit)
            client = self._services[name]
            self._ready(client.service_is_ready, name, pursuit)
        answer = self._executor.start(lambda: client.call_async(request))
        return self._wait(answer, name, self._timeout if timeout is None else timeout)

    def pursue(self, name: str, goal: Any, inbox: Inbox, on_feedback: Callable[[Any], None]) -> Any:
        """Send a goal and return its result; meanwhile, make the calls in the inbox.

        An error in a call, including Ctrl-C, cancels the goal and is raised after its end.

        Args:
            name: Name of the action.
            goal: Goal of its type.
            inbox: Calls to make on this thread.
            on_feedback: Function that receives the feedback, on the executor's thread.

        Raises:
            TunerError: If there is no tuner, it refuses the goal, or it falls silent.
        """
        finished: Future[Any] | None = None
        with self._pursuit() as pursuit:
            try:
                self._connect(pursuit)
                client = self._actions[name]
                self._ready(client.server_is_ready, name, pursuit)
                sent = self._executor.start(
                    lambda: client.send_goal_async(goal, lambda m: on_feedback(m.feedback))
                )
                sent.add_done_callback(pursuit.answered)
                handle = self._wait(sent, name, self._timeout)
                if not handle.accepted:
                    raise TunerError(ErrorCode.REFUSED, "the tuner refused the goal")
                finished = self._executor.start(handle.get_result_async)
                finished.add_done_callback(lambda _: inbox.put(None))
                while not finished.done():
                    self.serve(inbox)
                return finished.result().result
            except BaseException:
                pursuit.cancel()
                if finished is not None:
                    with contextlib.suppress(TunerError):  # the first error counts
                        self._wait(finished, name, float("inf"))
                raise

    def begin(self, name: str, goal: Any, has_begun: Callable[[], bool]) -> Any:
        """Send a goal that is not canceled when this connection is closed.

        Args:
            name: Name of the action.
            goal: Goal of its type.
            has_begun: Function that says whether the tuner pursues it.

        Returns:
            The result if the goal has ended already, as one that is refused does; otherwise None.

        Raises:
            TunerError: If there is no tuner, or it does not answer.
        """
        with self._pursuit() as pursuit:
            self._connect(pursuit)
            client = self._actions[name]
            self._ready(client.server_is_ready, name, pursuit)
            handle = self._wait(
                self._executor.start(lambda: client.send_goal_async(goal)), name, self._timeout
            )
            finished = self._executor.start(handle.get_result_async)
            failure = f"the tuner did not begin within {self._timeout:g} s"
            self._until(lambda: finished.done() or has_begun(), self._timeout, failure, pursuit)
        return finished.result().result if finished.done() else None

    def cancel(self) -> None:
        """Cancel all goals and all waits for the tuner, without waiting."""
        for pursuit in list(self._pursuits):
            pursuit.cancel()

    @contextlib.contextmanager
    def listening(self, listener: Listener) -> Iterator[None]:
        """Pass the messages of all topics to a listener."""
        self.connect()
        self._executor.call(self._subscribe_to_runs)
        self._listeners.append(listener)
        try:
            yield
        finally:
            self._listeners.remove(listener)

    def serve(self, inbox: Inbox) -> None:
        """Make the next call in the inbox, if one arrives soon.

        Raises:
            TunerError: If the tuner has fallen silent.
        """
        with contextlib.suppress(queue.Empty):
            work = inbox.get(timeout=POLL_PERIOD)
            if work is not None:
                work()
        self._check_alive()

    # ------------------------------------------------------------------ on the executor's thread

    def _make(self) -> None:
        """Create all clients, and last the one that probes the tuner."""
        for name, kind in SERVICES.items():
            self._services[name] = self._node.create_client(kind, self._name(name))
        for name, kind in ACTIONS.items():
            self._actions[name] = ActionClient(self._node, kind, self._name(name))
        self._subscribe(interfaces.STATUS)
        self._services[PROBE] = self._node.create_client(CancelGoal, self._name(PROBE))

    def _subscribe(self, topic: interfaces.Topic) -> None:
        self._subscriptions[topic.name] = self._node.create_subscription(
            topic.kind, self._name(topic.name), partial(self._take, topic.name), topic.qos
        )

    def _subscribe_to_runs(self) -> None:
        for topic in RUN_TOPICS:
            if topic.name not in self._subscriptions:
                self._subscribe(topic)

    def _take(self, topic: str, message: Any) -> None:
        if topic == "status":
            now = time.monotonic()
            if self._heard is not None and now - self._heard > RESTART_TIMEOUT:
                self._met = False
            self.status, self._heard = message, now
        for listener in list(self._listeners):
            listener.take(topic, message)

    def _destroy(self) -> None:
        for subscription in self._subscriptions.values():
            self._node.destroy_subscription(subscription)
        for client in self._services.values():
            self._node.destroy_client(client)
        for action in self._actions.values():
            action.destroy()

    # ------------------------------------------------------------------ on the caller's thread

    @property
    def _silent(self) -> bool:
        return self._heard is None or time.monotonic() - self._heard > SILENCE_TIMEOUT

    def _meet(self, timeout: float, pursuit: _Pursuit) -> None:
        """Probe the tuner until it answers.

        Requests and responses are lost between nodes that have not discovered each other, and also while
        a killed tuner still seems to exist. Nodes discover each other's endpoints in the order of their
        creation: a tuner that answers the last one has discovered all.
        """
        client = self._services[PROBE]
        nobodys = CancelGoal.Request()
        nobodys.goal_info.goal_id.uuid = list(uuid.uuid4().bytes)
        self._ready(client.service_is_ready, PROBE, pursuit)

        def answers() -> bool:
            answer = self._executor.start(lambda: client.call_async(nobodys))
            with contextlib.suppress(TimeoutError):
                answer.result(PROBE_TIMEOUT)
                return True
            return False

        failure = f"the tuner did not answer within {timeout:g} s"
        self._until(answers, timeout, failure, pursuit)
        self._met = True

    def _check_alive(self) -> None:
        if self._silent:
            raise TunerError(
                ErrorCode.TUNER_LOST,
                f"the tuner has been silent for {SILENCE_TIMEOUT:g} s: it is gone",
            )

    @contextlib.contextmanager
    def _pursuit(self) -> Iterator[_Pursuit]:
        pursuit = _Pursuit(self._executor)
        self._pursuits.append(pursuit)
        try:
            yield pursuit
        finally:
            self._pursuits.remove(pursuit)

    def _connect(self, pursuit: _Pursuit, timeout: float | None = None) -> None:
        if self._executor.is_current:
            raise RuntimeError("a TunerClient blocks; do not call it on the executor's thread")
        if self._closed:
            raise RuntimeError("this TunerClient is closed")
        try:
            self._made.result(self._timeout)
        except TimeoutError:
            raise RuntimeError("the executor of the given node does not spin") from None
        timeout = self._timeout if timeout is None else timeout
        domain = self._node.context.get_domain_id()
        self._until(
            lambda: not self._silent,
            timeout,
            f"no tuner was heard on '{self._resolved('status')}' within {timeout:g} s "
            f"in ROS domain {domain}",
            pursuit,
        )
        if not self._met:
            self._meet(timeout, pursuit)

    def _name(self, name: str) -> str:
        return f"{self._namespace}/{name}" if self._namespace else name

    def _resolved(self, name: str) -> str:
        return str(self._node.resolve_topic_name(self._name(name)))

    def _ready(self, is_ready: Callable[[], bool], name: str, pursuit: _Pursuit) -> None:
        """Wait until the tuner offers a service or an action."""
        self._until(
            lambda: self._executor.call(is_ready),
            self._timeout,
            f"no tuner offered '{self._resolved(name)}' within {self._timeout:g} s",
            pursuit,
        )

    def _until(
        self, condition: Callable[[], bool], timeout: float, failure: str, pursuit: _Pursuit
    ) -> None:
        deadline = time.monotonic() + timeout
        while not condition():
            if pursuit.canceled:
                raise TunerError(ErrorCode.CANCELED, "it was canceled before it began")
            if time.monotonic() > deadline:
                raise TunerError(ErrorCode.NO_TUNER, failure)
            time.sleep(POLL_PERIOD)

    def _wait(self, future: Future[Any], name: str, timeout: float) -> Any:
        """Return the result of a future, as long as the tuner lives."""
        deadline = time.monotonic() + timeout
        while True:
            with contextlib.suppress(TimeoutError):
                return future.result(POLL_PERIOD)
            self._check_alive()
            if time.monotonic() > deadline:
                raise TunerError(
                    ErrorCode.NO_ANSWER,
                    f"the tuner did not answer on '{self._resolved(name)}' within {timeout:g} s",
                )


class _Pursuit:
    """A wait for the tuner, and its goal, if there is one."""

    def __init__(self, executor: ExecutorThread) -> None:
        self.canceled = False
        self._executor = executor
        self._handle: Any = None

    def answered(self, answer: Future[Any]) -> None:
        """Take the tuner's response to the goal, even if it is no longer awaited."""
        if answer.exception() is None and answer.result().accepted:
            self._handle = answer.result()
            if self.canceled:
                self.cancel()

    def cancel(self) -> None:
        """Ask the tuner to cancel the goal, now or once it is accepted."""
        self.canceled = True
        if self._handle is not None:
            self._executor.post(self._handle.cancel_goal_async)

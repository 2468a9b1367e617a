"""Calls of a service or an action of any type, with a time limit."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping
from typing import Any

from rclpy.action import ActionClient
from rclpy.node import Node
from rclpy.task import Future

from mobo_tuner.bridge.field_path import FieldPath
from mobo_tuner.bridge.interface_types import (
    FieldError,
    check_boolean,
    fill,
    load_type,
    read,
    write,
)
from mobo_tuner.bridge.mapping import Endpoint
from mobo_tuner.bridge.section import MappingError

Wait = Callable[[Future, float], Awaitable[bool]]
"""Waits for a future with a timeout [s] and returns whether it is done; an interrupt ends the wait."""


class CallError(Exception):
    """A failed call; the message is one sentence.

    Attributes:
        answered: Whether the server responded.
    """

    def __init__(self, message: str, *, answered: bool) -> None:
        super().__init__(message)
        self.answered = answered


class Call:
    """A service or an action with one call at a time.

    Args:
        node: Node that calls; its executor awaits the response.
        endpoint: Endpoint that is called, with its message and timeout.

    Raises:
        MappingError: If the types do not fit the endpoint.
    """

    def __init__(self, node: Node, endpoint: Endpoint) -> None:
        self._endpoint = endpoint
        self._target = endpoint.target
        interface = load(endpoint)
        self._is_action = self._target.kind == "action"
        if self._is_action:
            self._action = create(
                endpoint, lambda: ActionClient(node, interface, self._target.name)
            )
            self.request_type, self.answer_type = interface.Goal, interface.Result
        else:
            self._client = create(
                endpoint, lambda: node.create_client(interface, self._target.name)
            )
            self.request_type, self.answer_type = interface.Request, interface.Response
        self._handle: Any = None  # of the action's active goal
        check(endpoint, "message", lambda: fill(self.request_type(), endpoint.message))
        if endpoint.success is not None:
            success = endpoint.success
            check(endpoint, "success", lambda: check_boolean(self.answer_type, success))

    @property
    def ready(self) -> bool:
        """Whether its server exists."""
        if self._is_action:
            return bool(self._action.server_is_ready())
        return bool(self._client.service_is_ready())

    async def __call__(self, wait: Wait, numbers: Mapping[FieldPath, float | str] = {}) -> Any:
        """Call with these numbers in the request; return the response or the action's result.

        Raises:
            CallError: If no response arrives in time, or it reports a failure.
        """
        if not self.ready:
            raise CallError(f"the {self._target} is not there", answered=False)
        request = self.request(numbers)
        answer = await (self._act if self._is_action else self._ask)(request, wait)
        if self._endpoint.success is not None:
            try:
                success = read(answer, self._endpoint.success)
            except FieldError as error:
                raise CallError(f"the {self._target}: {error}", answered=True) from None
            if not success:
                reason = getattr(answer, "message", "") or "no reason"
                raise CallError(f"the {self._target} failed: {reason}", answered=True)
        return answer

    def request(self, numbers: Mapping[FieldPath, float | str]) -> Any:
        """Return the request with these numbers."""
        request = self.request_type()
        fill(request, self._endpoint.message)
        for path, number in numbers.items():
            write(request, path, number)
        return request

    def send(self, numbers: Mapping[FieldPath, float | str]) -> None:
        """Call without waiting for the response."""
        if self._is_action:
            self._action.send_goal_async(self.request(numbers))
        elif self.ready:
            self._client.call_async(self.request(numbers))

    def cancel(self) -> None:
        """Cancel the action's active goal, if there is one."""
        if self._handle is not None:
            self._handle.cancel_goal_async()
            self._handle = None

    async def _ask(self, request: Any, wait: Wait) -> Any:
        future = self._client.call_async(request)
        if not await wait(future, self._endpoint.timeout):
            self._client.remove_pending_request(future)
            raise self._silence()
        return self._result(future)

    async def _act(self, goal: Any, wait: Wait) -> Any:
        sent = self._action.send_goal_async(goal)
        if not await wait(sent, self._endpoint.timeout):
            sent.add_done_callback(_cancel_late)
            raise self._silence()
        self._handle = self._result(sent)
        if not self._handle.accepted:
            self._handle = None
            raise CallError(f"the {self._target} rejected its goal", answered=True)
        finished = self._handle.get_result_async()
        if not await wait(finished, self._endpoint.timeout):
            self.cancel()
            raise self._silence()
        self._handle = None
        return self._result(finished).result

    def _silence(self) -> CallError:
        return CallError(
            f"the {self._target} did not answer within {self._endpoint.timeout:g} s",
            answered=False,
        )

    def _result(self, future: Future) -> Any:
        error = future.exception()
        if error is not None:
            raise CallError(f"the {self._target} failed: {error}", answered=False)
        return future.result()


def load(endpoint: Endpoint) -> Any:
    """Return the class of an endpoint's type.

    Raises:
        MappingError: If the type is not installed.
    """
    try:
        return load_type(endpoint.target.type_name)
    except FieldError as error:
        raise MappingError(f"{endpoint.where}.type: {error}") from None


def check(endpoint: Endpoint, key: str, act: Callable[[], object]) -> None:
    """Turn a FieldError of `act` into a MappingError that names the endpoint's key."""
    try:
        act()
    except FieldError as error:
        raise MappingError(f"{endpoint.where}.{key}: {error}") from None


def create(endpoint: Endpoint, make: Callable[[], Any]) -> Any:
    """Turn rclpy's errors about names and types into a MappingError."""
    try:
        return make()
    except Exception as error:  # rclpy raises many types
        reason = str(error).strip().split("\n", maxsplit=1)[0]
        raise MappingError(
            f"{endpoint.where}.{endpoint.target.kind}: {endpoint.target.name!r} cannot be used: "
            f"{reason}"
        ) from None


def _cancel_late(sent: Future) -> None:
    if not sent.cancelled() and sent.exception() is None and sent.result().accepted:
        sent.result().cancel_goal_async()

"""Calls of rclpy from any thread, which are made on the thread of one executor."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any, ParamSpec, TypeVar

from rclpy.executors import Executor

SPIN_PERIOD = 0.25  # [s] between two checks of a spinning thread whether it must end
CALL_TIMEOUT = 10.0  # [s] for an executor to make a quick call
JOIN_TIMEOUT = 5.0  # [s]

P = ParamSpec("P")
T = TypeVar("T")


class ExecutorThread:
    """The thread of an executor, for use by other threads.

    rclpy loses goals and answers when its calls race with the executor. A thread that blocks therefore
    has each call made here, on the executor's own thread, and only waits for the result.

    Args:
        executor: Executor of the nodes that are used.
        spin: Whether to spin the executor in a thread of its own; otherwise the caller spins it.
    """

    def __init__(self, executor: Executor, *, spin: bool) -> None:
        self._executor = executor
        self._closing = threading.Event()
        self._identity: int | None = None  # of the spinning thread, as soon as it is known
        self._thread: threading.Thread | None = None
        if spin:
            self._thread = threading.Thread(target=self._spin, name="executor", daemon=True)
            self._thread.start()

    @property
    def is_current(self) -> bool:
        """Whether the caller is on the executor's thread, where nothing may block."""
        return threading.get_ident() == self._identity

    def call(self, function: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> T:
        """Call a quick function on the executor's thread and return its value.

        Raises:
            TimeoutError: If the executor does not spin.
        """
        if self.is_current:
            return function(*args, **kwargs)
        done = self.post(function, *args, **kwargs)
        try:
            return done.result(CALL_TIMEOUT)
        except TimeoutError:
            done.cancel()
            raise

    def post(self, function: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """Call a function on the executor's thread soon; return a future of its value."""
        done: Future[T] = Future()

        def work() -> None:
            self._identity = threading.get_ident()
            if not done.set_running_or_notify_cancel():
                return
            try:
                done.set_result(function(*args, **kwargs))
            except Exception as error:  # for the waiting thread, not for the executor
                done.set_exception(error)

        self._executor.create_task(work)
        return done

    def start(self, function: Callable[[], Any]) -> Future[Any]:
        """Call a function that returns a future of rclpy; return one to wait for on this thread."""
        finished: Future[Any] = Future()

        def transfer(future: Any) -> None:
            if finished.done():
                return
            error = future.exception()
            if error is not None:
                finished.set_exception(error)
            else:
                finished.set_result(future.result())

        self.call(lambda: function().add_done_callback(transfer))
        return finished

    def close(self) -> None:
        """End the spinning thread if it belongs to this object."""
        self._closing.set()
        if self._thread is not None:
            self.post(lambda: None)  # ends the wait in `spin_once`, which `wake` does not
            self._thread.join(JOIN_TIMEOUT)
            self._executor.shutdown(timeout_sec=JOIN_TIMEOUT)

    def _spin(self) -> None:
        self._identity = threading.get_ident()
        while not self._closing.is_set():
            self._executor.spin_once(timeout_sec=SPIN_PERIOD)

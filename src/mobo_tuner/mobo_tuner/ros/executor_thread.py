"""Calls of rclpy from any thread, each made on the thread of one executor."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any, ParamSpec, TypeVar

from rclpy.executors import Executor

SPIN_PERIOD = 0.25  # [s]; a thread that spins looks this often whether it was asked to end
CALL_TIMEOUT = 10.0  # [s] for an executor to make a quick call
JOIN_TIMEOUT = 5.0  # [s]

P = ParamSpec("P")
T = TypeVar("T")


class ExecutorThread:
    """The thread of an executor, as other threads use it.

    rclpy loses goals and answers when its calls race with the executor. A thread that blocks therefore
    has each call made here, on the executor's own thread, and only waits for the result.

    Args:
        executor: Executor of the nodes that are used.
        spin: Whether to spin the executor in a thread of its own; otherwise the caller spins it.
    """

    def __init__(self, executor: Executor, *, spin: bool) -> None:
        self._executor = executor
        self._closing = threading.Event()
        self._identity: int | None = None  # of the thread that spins, once it is known
        self._thread: threading.Thread | None = None
        if spin:
            self._thread = threading.Thread(target=self._spin, name="executor", daemon=True)
            self._thread.start()

    @property
    def is_current(self) -> bool:
        """Whether this is called on the executor's thread, where nothing may block."""
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
            except Exception as error:  # for whoever waits, and not for the executor
                done.set_exception(error)

        self._executor.create_task(work)
        return done

    def start(self, function: Callable[[], Any]) -> Future[Any]:
        """Call a function that gives a future of rclpy; return one to wait for on this thread."""
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
        """End the thread that spins, if it is this object's own."""
        self._closing.set()
        if self._thread is not None:
            self.post(lambda: None)  # ends the wait in `spin_once`, which `wake` does not
            self._thread.join(JOIN_TIMEOUT)
            self._executor.shutdown(timeout_sec=JOIN_TIMEOUT)

    def _spin(self) -> None:
        self._identity = threading.get_ident()
        while not self._closing.is_set():
            self._executor.spin_once(timeout_sec=SPIN_PERIOD)

"""Blocking work beside an executor: one thread, awaited from the executor's own."""

from __future__ import annotations

import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import ParamSpec, TypeVar

from rclpy.executors import Executor
from rclpy.task import Future

# [s] of `sys.setswitchinterval`. Work that gives up the interpreter's lock for some microseconds at a
# time, as a training does around its small array operations, wakes the executor's thread, has the
# lock again before that thread runs, and so restarts the interval: with the default of 5 ms, a
# cancel then took up to 2.5 s. It must be shorter than the work between two such operations.
SWITCH_INTERVAL = 1e-5

P = ParamSpec("P")
T = TypeVar("T")


class Worker:
    """One background thread whose results are awaited on the executor's thread.

    A blocking callback would starve the node's timers and could not be cancelled; rclpy itself must
    be called on the executor's thread only. So the node submits here what blocks, and awaits it.
    """

    def __init__(self, executor: Executor, name: str) -> None:
        sys.setswitchinterval(SWITCH_INTERVAL)
        self._executor = executor
        self._pool = ThreadPoolExecutor(max_workers=1, thread_name_prefix=name)
        self._pending = 0

    @property
    def busy(self) -> bool:
        """Whether submitted work has not finished yet."""
        return self._pending > 0

    def submit(self, function: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future:
        """Run `function` in the worker thread; await the future in a coroutine of the executor."""
        future: Future = Future(executor=self._executor)
        self._pending += 1

        def work() -> None:
            try:
                result = function(*args, **kwargs)
            except BaseException as error:
                self._pending -= 1
                future.set_exception(error)
            else:
                self._pending -= 1
                future.set_result(result)
            # An idle executor does not notice a future that another thread completes.
            self._executor.wake()

        self._pool.submit(work)
        return future

    def shutdown(self) -> None:
        """Refuse further work; what runs is not waited for."""
        self._pool.shutdown(wait=False, cancel_futures=True)

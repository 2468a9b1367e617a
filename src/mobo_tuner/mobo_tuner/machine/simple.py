"""Machine made of a few plain functions, which may block: a subclass writes, reads and takes shots."""

from __future__ import annotations

import math
import time
from abc import abstractmethod
from collections.abc import Iterable, Mapping
from types import MappingProxyType

from rclpy.executors import Executor
from rclpy.node import Node
from rclpy.task import Future

from mobo_msgs_py import msg
from mobo_msgs_py.action import EvaluateSetpoint
from mobo_tuner.errors import one_line
from mobo_tuner.machine.averaging import OutlierRule, average, percentile
from mobo_tuner.machine.backend import MEASURING, Failure, Measurement, Operation
from mobo_tuner.machine.ramp import RampedVariable, RampSettings
from mobo_tuner.machine.ramped import RampedBackend
from mobo_tuner.ros.waiting import STEADY_CLOCK
from mobo_tuner.ros.worker import Worker

READ_PERIOD = 0.1  # [s] between two readings of the machine
_Result = EvaluateSetpoint.Result
_DEFAULT_RAMP = RampSettings()
_KEEP_ALL = OutlierRule()


class SimpleMachine(RampedBackend):
    """Machine whose subclass implements `write`, `read` and `shot`, and may implement `interlock`.

    These functions may block and may raise any exception, which ends the running operation as a
    failure with the exception's text. `write`, `read` and `interlock` run in one thread, one at a
    time; `shot` runs in another, so that the machine is watched during a long shot. Limits, ramps,
    settling, readback tolerances, averages, cancels, critical limits and lost clients are taken care
    of.

    Args:
        node: Node that serves the machine.
        executor: Executor of the node.
        name: Name of the machine, for people.
        variables: Variables of the machine.
        diagnostics: Units of the diagnostics by name; empty for none.
        settings: Settings of the moves.
        shots: Number of shots of a measurement for which the client asks for no number.
        outliers: Rule that identifies shots to leave out of the averages.
        statistics: What is taken of the shots of a diagnostic in place of their mean, by its name:
            ``rms``, or a percentile such as ``p90``.
        timeout: Longest time that one `write` or `read` may take [s].
        shot_timeout: Longest time that one `shot` may take [s].
    """

    def __init__(
        self,
        node: Node,
        executor: Executor,
        *,
        name: str,
        variables: Iterable[RampedVariable],
        diagnostics: Mapping[str, str],
        settings: RampSettings = _DEFAULT_RAMP,
        shots: int = 1,
        outliers: OutlierRule = _KEEP_ALL,
        statistics: Mapping[str, str] = MappingProxyType({}),
        timeout: float = 2.0,
        shot_timeout: float = 30.0,
    ) -> None:
        super().__init__(node, name, variables, diagnostics, settings)
        self._shots = shots
        self._outliers = outliers
        for diagnostic, statistic in statistics.items():
            if diagnostic not in diagnostics:
                raise ValueError(
                    f"statistics names '{diagnostic}'; allowed are {', '.join(diagnostics)}"
                )
            percentile(statistic)
        self._statistics = dict(statistics)
        self._timeout = timeout
        self._shot_timeout = shot_timeout
        self._positions = dict.fromkeys(self.ramped, math.nan)
        self._interlock = ""
        self._read_at = time.monotonic()  # when the machine was last read
        self._read_error = ""
        self._control = Worker(executor, "control")
        self._camera = Worker(executor, "shots")
        self._timer = node.create_timer(READ_PERIOD, self._poll, clock=STEADY_CLOCK)

    # ------------------------------------------------------------------ for the subclass

    @abstractmethod
    def write(self, setpoint: Mapping[str, float]) -> None:
        """Send the set-points of all variables to the machine; one step of a ramp."""

    @abstractmethod
    def read(self) -> Mapping[str, float]:
        """Return the readbacks of all variables; NaN for one that is unknown."""

    @abstractmethod
    def shot(self) -> Mapping[str, float]:
        """Return the diagnostics of one shot; NaN for one that could not be measured."""

    def interlock(self) -> str:
        """Return why nothing may move, or an empty string; optional."""
        return ""

    # ------------------------------------------------------------------ what RampedBackend asks for

    def position(self, name: str) -> float:
        """Return the latest finite readback of a variable."""
        return self._positions[name]

    def readback_problem(self, name: str) -> str:
        """Return why the readback of a variable is unknown."""
        age = time.monotonic() - self._read_at
        if age > self._timeout:
            because = f" ({self._read_error})" if self._read_error else ""
            return f"the machine could not be read for {age:.1f} s{because}"
        return super().readback_problem(name)

    def forbidden(self) -> Failure | None:
        """Return why nothing may move."""
        return Failure(_Result.INTERLOCK, self._interlock) if self._interlock else None

    async def send(self, setpoint: Mapping[str, float], operation: Operation) -> Failure | None:
        """Write the set-point of one step, and read the machine."""
        written = self._control.submit(self._write_and_read, dict(setpoint))
        if not await self.wait(operation, written, self._timeout):
            text = f"the machine did not take a set-point within {self._timeout:g} s"
            return Failure(_Result.MACHINE_LOST, text)
        if written.exception() is not None:
            text = f"the machine did not take a set-point: {_reason(written)}"
            return Failure(_Result.MACHINE_LOST, text)
        self._take(written)
        return None

    def send_now(self, setpoint: Mapping[str, float]) -> None:
        """Write a set-point after what is being written now."""
        self._control.submit(self.write, dict(setpoint)).add_done_callback(self._report)

    async def take_shots(self, shots: int, operation: Operation) -> Measurement:
        """Take shot after shot, and average them."""
        count = shots or self._shots
        taken: list[Mapping[str, float]] = []
        failure: Failure | None = None
        operation.progress(MEASURING, 0.0)
        while len(taken) < count and failure is None:
            shot = self._camera.submit(self.shot)
            if not await self.wait(operation, shot, self._shot_timeout):
                if not operation.interrupt.done():
                    text = f"a shot took longer than {self._shot_timeout:g} s"
                    failure = Failure(_Result.TIMEOUT, text)
                break
            if shot.exception() is not None:
                text = f"a shot failed: {_reason(shot)}"
                failure = Failure(_Result.INVALID_MEASUREMENT, text)
                break
            taken.append(dict(shot.result()))
            operation.shot(taken[-1])
            operation.progress(MEASURING, len(taken) / count)
            if operation.interrupt.done():
                break
        diagnostics = []
        for diagnostic in self.diagnostics if taken else ():
            values = [shot.get(diagnostic.name, math.nan) for shot in taken]
            statistic = self._statistics.get(diagnostic.name, "mean")
            value, stddev = average(values, self._outliers, statistic)
            diagnostics.append(
                msg.NamedValue(
                    name=diagnostic.name, value=value, stddev=stddev, unit=diagnostic.unit
                )
            )
            if failure is None and math.isnan(value):
                text = f"{diagnostic.name} could not be measured: no shot gave a number"
                failure = Failure(_Result.INVALID_MEASUREMENT, text)
        return Measurement(diagnostics=diagnostics, shots=len(taken), failure=failure)

    def close(self) -> None:
        """Stop reading the machine."""
        self._timer.cancel()
        self._control.shutdown()
        self._camera.shutdown()

    def _report(self, written: Future) -> None:
        if written.exception() is not None:
            self.node.get_logger().error(f"the machine could not be held: {_reason(written)}")

    # ------------------------------------------------------------------ reading

    def _poll(self) -> None:
        if not self._control.busy:
            self._control.submit(self._read).add_done_callback(self._take)

    def _read(self) -> tuple[Mapping[str, float], str]:
        return self.read(), self.interlock()

    def _write_and_read(self, setpoint: Mapping[str, float]) -> tuple[Mapping[str, float], str]:
        self.write(setpoint)
        return self._read()

    def _take(self, future: Future) -> None:
        """Take what was read."""
        if future.exception() is not None:
            self._read_error = _reason(future)
            return
        positions, self._interlock = future.result()
        finite = {n: float(positions.get(n, math.nan)) for n in self._positions}
        if all(math.isfinite(value) for value in finite.values()):
            self._read_at, self._read_error = time.monotonic(), ""
        else:
            self._read_error = next(
                f"{n} is {v}" for n, v in finite.items() if not math.isfinite(v)
            )
        for name, value in finite.items():
            self.collect(name, value)
            if math.isfinite(value):
                self._positions[name] = value
        self.check()


def _reason(future: Future) -> str:
    error = future.exception()
    return one_line(f"{type(error).__name__}: {error}")

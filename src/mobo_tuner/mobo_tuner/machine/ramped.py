"""Backend of machines whose variables are set in small steps and read back."""

from __future__ import annotations

import math
import time
from abc import abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from statistics import median

from rclpy.node import Node
from rclpy.task import Future

from mobo_msgs_py import msg
from mobo_msgs_py.action import EvaluateSetpoint
from mobo_tuner.machine.averaging import average
from mobo_tuner.machine.backend import (
    RAMPING,
    SETTLING,
    Failure,
    MachineBackend,
    Measurement,
    Operation,
)
from mobo_tuner.machine.ramp import RampedVariable, RampSettings, count_steps, interpolate
from mobo_tuner.ros.diagnostics import OK, STALE, Health
from mobo_tuner.ros.waiting import first_of

WATCH_PERIOD = 0.1  # [s] between two checks of interlocks and readbacks during an operation
SETTLE_PERIOD = 0.05  # [s] between two checks whether the readbacks are settled
_Result = EvaluateSetpoint.Result


class RampedBackend(MachineBackend):
    """Machine whose variables are ramped together, in bounded steps, and read back.

    A subclass says how set-points are sent, where readbacks come from and how shots are taken; it
    calls `collect` for each new readback and `check` when something may have gone wrong. Here is
    what all such machines share: straight ramps, settling within tolerances, holding, refusing to
    start from where a variable should not be, and checking that all of them stayed at their
    set-points during a measurement.

    Args:
        node: Node on whose executor the coroutines run.
        name: Name of the machine, for people.
        variables: Variables of the machine.
        diagnostics: Units of the diagnostics by name; empty for none.
        settings: Settings of the moves.
    """

    def __init__(
        self,
        node: Node,
        name: str,
        variables: Iterable[RampedVariable],
        diagnostics: Mapping[str, str],
        settings: RampSettings,
    ) -> None:
        self.node = node
        self.name = name
        self.ramped = {variable.name: variable for variable in variables}
        self.variables = [
            msg.Variable(
                name=v.name,
                unit=v.unit,
                min=v.minimum,
                max=v.maximum,
                choices=[
                    msg.NamedValue(name=word, value=float(i)) for i, word in enumerate(v.words)
                ],
            )
            for v in self.ramped.values()
        ]
        self.diagnostics = [msg.Observable(name=n, unit=unit) for n, unit in diagnostics.items()]
        self.settings = settings
        self._setpoint: dict[str, float] = {}  # sent last; empty before the first move
        self._operation: Operation | None = None
        self._collected: dict[str, list[float]] | None = None  # readbacks during a measurement

    # ------------------------------------------------------------------ hooks

    @abstractmethod
    def position(self, name: str) -> float:
        """Return the latest finite readback of a variable; NaN if there was none."""

    def readback_problem(self, name: str) -> str:
        """Return why the readback of a variable is unknown, or an empty string; optional."""
        return "" if math.isfinite(self.position(name)) else "it gave no value yet"

    def forbidden(self) -> Failure | None:
        """Return why nothing may move or be measured, or None; optional. Called often."""
        return None

    def missing(self) -> str:
        """Return which part of the machine is missing before a move, or an empty string; optional."""
        return ""

    @abstractmethod
    async def send(self, setpoint: Mapping[str, float], operation: Operation) -> Failure | None:
        """Send the set-point of one step, and wait until the machine has taken it.

        Returns:
            Reason why the machine did not take it; None if it did or was interrupted.
        """

    @abstractmethod
    def send_now(self, setpoint: Mapping[str, float]) -> None:
        """Send a set-point at once, without waiting; used to hold."""

    def cancel(self) -> None:
        """Interrupt what the machine does by itself, such as an action it serves; optional."""

    def unsettled(self) -> str:
        """Return what is not settled besides the readbacks, or an empty string; optional."""
        return ""

    @abstractmethod
    async def take_shots(self, shots: int, operation: Operation) -> Measurement:
        """Measure the diagnostics, as `measure` does, without the readbacks."""

    # ------------------------------------------------------------------ what the server asks for

    def refusal(self) -> Failure | None:
        """Return why nothing may move now: an interlock, a lost or displaced variable, a missing part."""
        trouble = self._trouble()
        if trouble is not None:
            return trouble
        for variable in self.ramped.values():
            displaced = self._displaced(variable)
            if displaced:
                return Failure(_Result.INTERLOCK, displaced)
        missing = self.missing()
        return Failure(_Result.MACHINE_LOST, missing) if missing else None

    def readbacks(self) -> Sequence[msg.NamedValue]:
        """Return where the machine is now; NaN for a variable whose readback is unknown."""
        return [
            msg.NamedValue(
                name=name,
                value=math.nan if self.readback_problem(name) else self.position(name),
                stddev=math.nan,
                unit=variable.unit,
            )
            for name, variable in self.ramped.items()
        ]

    async def move(self, setpoint: Mapping[str, float], operation: Operation) -> Failure | None:
        """Ramp to a set-point, and wait until all readbacks stay within their tolerances."""
        self._operation = operation
        try:
            return await self._ramp(setpoint, operation) or await self._settle(operation)
        finally:
            self._operation = None

    async def measure(self, shots: int, operation: Operation) -> Measurement:
        """Measure all diagnostics, and where the machine is meanwhile."""
        self._operation = operation
        # The latest readback counts, too, so that there is one even if no other comes.
        collected = self._collected = {name: [self.position(name)] for name in self.ramped}
        try:
            measured = await self.take_shots(shots, operation)
        finally:
            self._operation = self._collected = None
        readbacks = []
        failure = measured.failure
        for name, variable in self.ramped.items():
            samples = without_strays(collected[name], variable.tolerance)
            value, stddev = average(samples)
            readbacks.append(
                msg.NamedValue(name=name, value=value, stddev=stddev, unit=variable.unit)
            )
            if failure is None and not abs(value - self._setpoint[name]) <= variable.tolerance:
                failure = Failure(
                    _Result.INVALID_MEASUREMENT,
                    f"{name} was {_quantity(value, variable.unit)} while measured, more than "
                    f"{variable.tolerance:g} from its set-point {self._setpoint[name]:g}",
                )
        return replace(measured, readbacks=readbacks, failure=failure)

    def hold(self) -> None:
        """Send nothing more; set a variable that lags during a move to its readback.

        The readback may be wrong, so that a set-point never moves back by more than its largest step.
        """
        held = dict(self._setpoint)
        for name, last in self._setpoint.items() if self._operation is not None else ():
            variable = self.ramped[name]
            lag = last - self.position(name)
            if not self.readback_problem(name) and abs(lag) > variable.tolerance:
                step = min(abs(lag), variable.max_step)
                back = last - math.copysign(step, lag)
                held[name] = min(max(back, variable.minimum), variable.maximum)
        self.cancel()
        if held != self._setpoint:
            self._setpoint = held
            self.send_now(held)

    def parts(self) -> Mapping[str, Callable[[], Health]]:
        """Return the function for the health of the variables."""
        return {"variables": self._variables_health}

    def _variables_health(self) -> Health:
        """Where each variable is and was set to, or why it is not known where it is."""
        values, problems = {}, {}
        for name, variable in self.ramped.items():
            problems[name] = self.readback_problem(name)
            setpoint = self._setpoint.get(name, math.nan)
            where = _quantity(self.position(name), variable.unit)
            values[name] = f"{where} (set {setpoint:g})" if math.isfinite(setpoint) else where
            if problems[name]:
                values[name] = f"unknown: {problems[name]}"
        unknown = [f"the readback of {name} is not known: {p}" for name, p in problems.items() if p]
        if unknown:
            return Health(STALE, unknown[0], values)
        return Health(OK, f"readbacks known: all {len(values)}", values)

    # ------------------------------------------------------------------ what subclasses use

    def collect(self, name: str, value: float) -> None:
        """Take a new readback of a variable; NaN if it gave none."""
        if self._collected is not None:
            self._collected[name].append(value)

    def check(self) -> None:
        """End the running operation if an interlock or a lost readback requires it."""
        if self._operation is not None and (trouble := self._trouble()) is not None:
            self._operation.stop(trouble)

    async def wait(self, operation: Operation, future: Future | None, timeout: float) -> bool:
        """Wait for a future, checking interlocks and readbacks meanwhile.

        Args:
            operation: Operation whose interrupt ends the wait.
            future: Future to wait for; None = wait until the timeout.
            timeout: Longest wait [s].

        Returns:
            Whether the future is done.
        """
        deadline = time.monotonic() + timeout
        futures = [operation.interrupt] if future is None else [future, operation.interrupt]
        while (remaining := deadline - time.monotonic()) > 0.0:
            self.check()
            if await first_of(self.node, *futures, timeout=min(remaining, WATCH_PERIOD)):
                break
        return future is not None and future.done()

    # ------------------------------------------------------------------ moving

    async def _ramp(self, target: Mapping[str, float], operation: Operation) -> Failure | None:
        period = 1.0 / self.settings.rate
        start = self._start()
        largest = {n: min(v.max_step, v.slew * period) for n, v in self.ramped.items()}
        selectors = {n for n, v in self.ramped.items() if v.words}
        steps = count_steps(start, target, largest)
        for number, point in enumerate(interpolate(start, target, steps, selectors), start=1):
            if operation.interrupt.done():
                return None
            self._setpoint = dict(point)
            failure = await self.send(point, operation)
            if failure is not None:
                return None if operation.interrupt.done() else failure
            operation.progress(RAMPING, number / steps)
            # Never two steps within one period, even if the one before was late.
            await self.wait(operation, None, period)
        return None

    async def _settle(self, operation: Operation) -> Failure | None:
        started = time.monotonic()
        since = math.inf  # when everything became settled, without a break until now
        while not operation.interrupt.done():
            now = time.monotonic()
            unsettled = self._not_at_setpoint() or self.unsettled()
            since = math.inf if unsettled else min(since, now)
            if now - since >= self.settings.settle_time:
                return None
            if unsettled and now - started > self.settings.settle_timeout:
                return Failure(
                    _Result.TIMEOUT,
                    f"{unsettled}, {self.settings.settle_timeout:g} s after the end of the ramp",
                )
            operation.progress(SETTLING, (now - started) / self.settings.settle_timeout)
            await self.wait(operation, None, SETTLE_PERIOD)
        return None

    def _start(self) -> dict[str, float]:
        """Return where a ramp starts: at the last set-point, or at the readback if that is far off."""
        start = {}
        for name, variable in self.ramped.items():
            position = self.position(name)
            last = self._setpoint.get(name, position)
            if abs(last - position) > variable.tolerance + variable.max_step:
                last = position  # `refusal` has allowed it
            start[name] = min(max(last, variable.minimum), variable.maximum)
        return start

    def _displaced(self, variable: RampedVariable) -> str:
        """Return why a move must not start where a variable is, or an empty string.

        If the readback is not where the variable was set, then either somebody moved it or the
        readback is wrong, and a ramp would start with a jump in one of the two cases.
        """
        position = self.position(variable.name)
        reads = f"{variable.name} reads {_quantity(position, variable.unit)}"
        low, high = variable.minimum - variable.tolerance, variable.maximum + variable.tolerance
        if not low <= position <= high:
            limits = _quantity(f"{variable.minimum:g} to {variable.maximum:g}", variable.unit)
            return f"{reads}, which is outside its limits, {limits}: bring it back by hand"
        last = self._setpoint.get(variable.name, position)
        reach = variable.tolerance + variable.max_step
        if self.settings.follow_moved or abs(position - last) <= reach:
            return ""
        return (
            f"{reads}, but was set to {_quantity(last, variable.unit)}: bring it back, or restart "
            "the machine's node once it is clear which of the two is right"
        )

    def _not_at_setpoint(self) -> str:
        """Return which readback is not within tolerance, or an empty string."""
        for name, variable in self.ramped.items():
            readback, setpoint = self.position(name), self._setpoint[name]
            if not abs(readback - setpoint) <= variable.tolerance:
                return (
                    f"{name} reads {_quantity(readback, variable.unit)}, which is not within "
                    f"{variable.tolerance:g} of its set-point {setpoint:g}"
                )
        return ""

    def _trouble(self) -> Failure | None:
        """Return what must end a move or a measurement at once, or None."""
        forbidden = self.forbidden()
        if forbidden is not None:
            return forbidden
        for name in self.ramped:
            problem = self.readback_problem(name)
            if problem:
                return Failure(
                    _Result.MACHINE_LOST, f"the readback of {name} is not known: {problem}"
                )
        return None


def without_strays(samples: Sequence[float], tolerance: float) -> list[float]:
    """Return the samples of a readback without those farther than the tolerance from their median.

    A single wrong sample spoils a mean, but neither the median nor what is left here. All samples are
    returned if they scatter by so much that the median tells nothing.
    """
    finite = [sample for sample in samples if math.isfinite(sample)]
    if not finite:
        return []
    middle = median(finite)
    near = [sample for sample in finite if abs(sample - middle) <= tolerance]
    return near if 2 * len(near) > len(finite) else finite


def _quantity(value: float | str, unit: str) -> str:
    number = value if isinstance(value, str) else f"{value:g}"
    return f"{number} {unit}" if unit else number

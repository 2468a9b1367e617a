"""Inputs of the models beside the variables: measured contexts, such as a temperature, fidelity and time."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple, Self

import numpy as np

from mobo_tuner.core.context_kernel import LONGEST_CONTEXT_SCALE
from mobo_tuner.core.dataset import Dataset
from mobo_tuner.core.problem import Array, Problem
from mobo_tuner.core.quantities import Context

_FIDELITY_UNIT = 2.0  # ranges, over which a fidelity is likely to matter
_TIME_UNIT = 100  # evaluations in a unit of time, if none is given
_JUMP = 100.0  # units of time that pass when the machine changes at once


class Scale(NamedTuple):
    """Origin and unit of an input, in the quantity's own unit."""

    origin: float
    unit: float


@dataclass(frozen=True)
class ContextInputs:
    """What is no variable, as inputs of the models; the scales hold from one training to the next.

    Attributes:
        names: Measured contexts.
        scales: Scale of each.
        fidelities: Number of variables of the fidelity.
        clock: Scale of time: the latest time and its unit at the last training [s].
        timed: Whether time is an input, which is then the last one.
        jumps: When the machine changed at once: the time of the first evaluation after each change [s].
    """

    names: tuple[str, ...]
    scales: tuple[Scale, ...]
    fidelities: int
    clock: Scale
    timed: bool
    jumps: tuple[float, ...] = ()

    @classmethod
    def of(
        cls, data: Dataset, timed: bool, time_unit: float, jumps: tuple[float, ...] = ()
    ) -> Self:
        """Return the inputs for models that are trained with some evaluations.

        Args:
            data: Evaluations.
            timed: Whether time is an input.
            time_unit: Time in which the machine changes noticeably [s]; 0 for the order of magnitude in
                which that would matter to a run.
            jumps: When the machine changed at once [s].
        """
        contexts = data.problem.context
        scales = tuple(_scale(context, data) for context in contexts)
        names, fidelities = tuple(c.name for c in contexts), data.lacks.shape[1]
        clock = _clock(data.times, time_unit)
        return cls(names, scales, fidelities, clock, timed, jumps if timed else ())

    @property
    def count(self) -> int:
        """Number of these inputs."""
        return len(self.names) + self.fidelities + self.timed

    def times(self, data: Dataset) -> Array:
        """Return when each evaluation was measured ``(n,)``, before the last training, in units of time.

        Much time passes in a jump, so that what was measured before it counts for little, as far as an
        output's length-scale of time is shorter than that.
        """
        times = _scaled(data.times, self.clock)
        for jump in self.jumps:
            times -= _JUMP * (data.times < jump)
        return times

    def inputs(self, data: Dataset) -> Array:
        """Return the inputs of the models ``(n, d)``."""
        if not self.count:
            return data.inputs
        return np.column_stack([data.inputs, *self._columns(data)])

    def now(self, data: Dataset, held: int) -> Array:
        """Return what holds after the first `held` evaluations: the last readings and the latest time.

        The fidelity is the highest: what is wanted is wanted there.
        """
        columns = [column[:held] for column in self._columns(data)]
        last = [column[-1:].max(initial=-math.inf) for column in columns[: len(self.names)]]
        latest = [column.max(initial=-math.inf) for column in columns[self.count - self.timed :]]
        return np.array([*last, *[0.0] * self.fidelities, *latest])

    def at(self, now: Array, lack: Array) -> Array:
        """Return what `now` gives, at another fidelity, of which `lack` ``(f,)`` is the distance."""
        first = len(self.names)
        return np.concatenate([now[:first], lack / _FIDELITY_UNIT, now[first + self.fidelities :]])

    def _columns(self, data: Dataset) -> list[Array]:
        """Return the inputs that are no variables, ``(n,)`` each."""
        columns = [
            _scaled(data.lasting(name), scale)
            for name, scale in zip(self.names, self.scales, strict=True)
        ]
        columns += list((data.lacks / _FIDELITY_UNIT).T)
        return [*columns, self.times(data)] if self.timed else columns

    def get_state(self) -> dict[str, Any]:
        """Return what `from_state` needs, as data for JSON."""
        return {
            "timed": self.timed,
            "clock": list(self.clock),
            "scales": [list(scale) for scale in self.scales],
            "jumps": list(self.jumps),
        }

    @classmethod
    def from_state(cls, state: dict[str, Any], problem: Problem) -> Self:
        """Return the inputs that `get_state` came from.

        Raises:
            ValueError: If the state does not suit the contexts.
        """
        names = tuple(context.name for context in problem.context)
        fidelities = len(problem.fidelity.variables) if problem.fidelity else 0
        scales = tuple(Scale(float(origin), float(unit)) for origin, unit in state["scales"])
        clock = Scale(*map(float, state["clock"]))
        if len(scales) != len(names) or not all(unit > 0.0 for _, unit in (*scales, clock)):
            raise ValueError(f"the scales of the contexts are {state['scales']}")
        jumps = tuple(map(float, state.get("jumps", ())))
        if not all(map(math.isfinite, jumps)):
            raise ValueError(f"the machine changed at {jumps}")
        return cls(names, scales, fidelities, clock, bool(state["timed"]), jumps)


def _scaled(values: Array, scale: Scale) -> Array:
    """Return values from an origin on in a unit; NaN becomes 0."""
    # What is farther than any length-scale would only cost digits.
    far = LONGEST_CONTEXT_SCALE
    return np.nan_to_num(np.clip((values - scale.origin) / scale.unit, -far, far))


def _scale(context: Context, data: Dataset) -> Scale:
    """Return the middle and half the width of the range that is given, or of the readings."""
    low, high = context.minimum, context.maximum
    if not math.isfinite(high - low):
        readings = data.lasting(context.name)
        readings = readings[np.isfinite(readings)]
        low, high = (float(readings.min()), float(readings.max())) if len(readings) else (0.0, 0.0)
    return Scale(0.5 * (low + high), 0.5 * (high - low) or 1.0)


def _clock(times: Array, unit: float) -> Scale:
    if not unit:
        steps = np.diff(np.sort(times))
        unit = _TIME_UNIT * (float(np.median(steps)) if len(steps) else 1.0)
    return Scale(float(times.max()) if len(times) else 0.0, unit or 1.0)

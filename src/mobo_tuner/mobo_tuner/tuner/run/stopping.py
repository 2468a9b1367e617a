"""When a run ends before its budget is spent: its time is over, or little is left to gain."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

from mobo_tuner.runs.records import EvaluationRecord, StopReason
from mobo_tuner.tuner.parameters import TunerParameters

LEAST_GAIN = 1e-3
"""Share of the hypervolume by which it must grow for a gain."""
SUGGESTIONS = 3
"""Suggestions in a row that must promise little: one may follow from a model that errs."""


class Progress:
    """What a run has gained lately, and how long it has taken.

    The parameters may change during a run: each question is answered by those of now. A resumed run
    and one with a changed problem begin to count again.

    Args:
        clock: Steady clock [s].
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._began = clock()
        self._hypervolumes = [0.0]  # the first is that before the evaluations that count
        self._little = 0

    def begin(self, hypervolume: float) -> None:
        """Note that the run starts now, with a hypervolume."""
        self._began = self._clock()
        self.count_again(hypervolume)

    def count_again(self, hypervolume: float) -> None:
        """Count evaluations without a gain from now on, from a hypervolume."""
        self._hypervolumes = [hypervolume]
        self._little = 0

    def note(self, record: EvaluationRecord) -> None:
        """Note an evaluation; those that failed or belong to the initial design do not count."""
        if record.source == "initial":
            self.count_again(record.hypervolume)
        elif record.valid:
            self._hypervolumes.append(record.hypervolume)

    def is_late(self, parameters: TunerParameters) -> bool:
        """Return whether the time of the run is over."""
        return 0.0 < parameters.stop_after <= self._clock() - self._began

    def stagnates(self, parameters: TunerParameters) -> bool:
        """Return whether the last evaluations have gained next to nothing."""
        count = parameters.stop_without_gain
        if count == 0 or len(self._hypervolumes) <= count:
            return False
        before, last = self._hypervolumes[-count - 1], self._hypervolumes[-count:]
        return max(last) <= before * (1.0 + LEAST_GAIN)

    def promises_little(self, expected: float, parameters: TunerParameters) -> bool:
        """Return whether the last suggestions promise next to nothing.

        Args:
            expected: Gain of hypervolume that is expected of the newest suggestion, as a share of the
                hypervolume; NaN if nothing is expected of it in particular.
            parameters: Parameters of the tuner.
        """
        little = 100.0 * expected < parameters.stop_below_expected_gain
        self._little = 0 if math.isnan(expected) or not little else self._little + 1
        return self._little >= SUGGESTIONS

    def reason(self, parameters: TunerParameters) -> StopReason | None:
        """Return why the run ends after an evaluation; None if it does not."""
        if self.is_late(parameters):
            return StopReason.TIME
        return StopReason.STAGNATION if self.stagnates(parameters) else None

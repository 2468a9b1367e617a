"""Whether a machine reads the same again: is it noisy, and does it drift?"""

from __future__ import annotations

import time
from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace

from mobo_tuner.core.dataset import Dataset
from mobo_tuner.core.gaussian_process import GaussianProcess
from mobo_tuner.core.problem import Array
from mobo_tuner.core.resolution import is_repeated, readings_agree, readings_differ

_NOISY = 11.0  # log evidence from which on the machine is taken for noisy
_CLEARLY_NOISY = 5.0  # the same of outputs whose noise is plain to see
_AGREED = (
    6.0  # the same where several outputs show it, or if the machine was taken for noisy before
)
_AGREES = 2.0  # log evidence of all outputs but the first one, from which on several show it
_FEWEST = 15  # readings of an output from which on that counts
_MAY_AGREE = 1.0  # the same from which on several may show it
_STILL_NOISY = 0.0  # the same of a machine that was taken for noisy before
_LIKELY = 4.0  # log evidence from which on it is worth an evaluation to find out
_DRIFTS = 10.0  # log evidence from which on the machine is taken to drift


@dataclass(frozen=True)
class Steadiness:
    """Noise and drift of a machine: as the settings say, or by the evidence of all outputs together.

    Attributes:
        noise: Setting of the noise.
        drift: Setting of the drift.
        is_noisy_by_evidence: Whether the evidence says that there is noise, as of the last training.
        may_be_noisy: Whether the evidence leaves it open, so that a set-point should be measured again.
        drift_evidence: Log evidence of drift at the last training.
        jumps: When the machine changed at once: the time of the first evaluation after each change [s].
    """

    noise: str | float
    drift: str
    is_noisy_by_evidence: bool = False
    may_be_noisy: bool = False
    drift_evidence: float = 0.0
    jumps: tuple[float, ...] = ()

    @property
    def drifts(self) -> bool:
        """Whether the machine changes with time."""
        seen = bool(self.jumps) or self.drift_evidence > _DRIFTS
        return self.drift == "on" or (self.drift == "auto" and seen)

    def learns_noise(self, data: Dataset) -> bool:
        """Return whether the noise is learned and there is some.

        What was measured again says so for sure; else the evidence decides.

        Args:
            data: Evaluations.
        """
        if not isinstance(self.noise, str):
            return False
        known = data.once(readings_differ)
        return known or (self.is_noisy_by_evidence and not data.once(readings_agree))

    def is_noisy(self, data: Dataset, outputs: Collection[str]) -> bool:
        """Return whether the machine is noisy: as was said or told, or by the evidence.

        Evidence is that readings differ at one place, or that no noiseless function explains them, unless
        every output was measured again somewhere and read the same.

        Args:
            data: Evaluations.
            outputs: Names of the modelled outputs.
        """
        if not isinstance(self.noise, str) and self.noise > 0.0:
            return True
        if any((data.stddev_column(name) > 0.0).any() for name in outputs):
            return True
        return self.learns_noise(data)

    def should_repeat(self, data: Dataset) -> bool:
        """Return whether a set-point should be measured again to find out whether the machine is noisy.

        Args:
            data: Evaluations.
        """
        # At even numbers only, so that others are asked for where a client does not measure this one.
        doubtful = self.may_be_noisy and isinstance(self.noise, str) and len(data) % 2 == 0
        return doubtful and not (data.once(is_repeated) or data.once(readings_differ))

    def with_jump(self, moment: float) -> Steadiness:
        """Return the steadiness of a machine that changed at once.

        Args:
            moment: Time of the first evaluation after that [s].
        """
        return replace(self, jumps=(*self.jumps, moment))

    def with_noise_of(self, processes: Iterable[GaussianProcess], deadline: float) -> Steadiness:
        """Return the steadiness with the evidence of noise in all outputs.

        Args:
            processes: Trained model of each output.
            deadline: Time by which it must be known [s], of `time.monotonic`; else it stays as it was.
        """
        evidence = clear = most = 0.0
        n = 0
        for process in processes:
            if time.monotonic() > deadline:
                return self
            if process.n:
                found = process.noise_evidence()
                evidence += max(found.log, 0.0)
                clear += max(found.log, 0.0) * found.is_clear
                most, n = max(most, found.log), max(n, process.n)
        # A step or a kink is seen in one output, noise in all of them.
        agreed = n >= _FEWEST and evidence - most > _AGREES
        least = _AGREED if agreed or self.is_noisy_by_evidence else _NOISY
        least_clear = _STILL_NOISY if self.is_noisy_by_evidence else _CLEARLY_NOISY
        is_noisy = evidence > least or clear > least_clear
        several = evidence - most > _MAY_AGREE or self.is_noisy_by_evidence
        is_open = not is_noisy and several and n >= _FEWEST and evidence > _LIKELY
        return replace(self, is_noisy_by_evidence=is_noisy, may_be_noisy=is_open)

    def with_drift_of(
        self, processes: Iterable[tuple[GaussianProcess, Array]], timed: bool, deadline: float
    ) -> Steadiness:
        """Return the steadiness with the evidence of drift in all outputs.

        Args:
            processes: Trained model of each output, and when its observations were measured ``(n,)``,
                in units of time.
            timed: Whether time is the last of their inputs.
            deadline: Time by which it must be known [s], of `time.monotonic`; else it stays as it was.
        """
        evidence = 0.0
        for process, times in processes:
            if time.monotonic() > deadline:
                return self
            evidence += max(float(process.drift_evidence(times, timed)), 0.0)
        return replace(self, drift_evidence=evidence)

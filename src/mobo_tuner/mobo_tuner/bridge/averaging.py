"""The mean of some shots, with outliers left out by a rule."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

MAD_TO_SIGMA = 1.4826  # of a normal distribution
LEAST_SHOTS = 3  # of fewer, none can be told to be an outlier


@dataclass(frozen=True)
class OutlierRule:
    """Which shots are outliers.

    Attributes:
        kind: ``none``; ``mad``: further from the median than `limit` standard deviations, estimated
            as 1.4826 times the median absolute deviation; ``sigma``: further from the mean than
            `limit` sample standard deviations, again and again until none is.
        limit: in standard deviations.
    """

    kind: str = "none"
    limit: float = math.inf

    def keep(self, shots: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """The shots (n,) that are no outliers; n finite ones."""
        if self.kind == "mad" and len(shots) >= LEAST_SHOTS:
            distances = np.abs(shots - np.median(shots))
            shots = shots[distances <= self.limit * MAD_TO_SIGMA * np.median(distances)]
        while self.kind == "sigma" and len(shots) >= LEAST_SHOTS:
            kept = shots[np.abs(shots - shots.mean()) <= self.limit * shots.std(ddof=1)]
            if len(kept) in (0, len(shots)):
                break
            shots = kept
        return shots


def average(shots: Sequence[float], rule: OutlierRule = OutlierRule()) -> tuple[float, float]:
    """The mean of the shots that are neither NaN nor outliers, and its standard uncertainty.

    Both are NaN without any shot; the uncertainty is NaN where one is left, which shows no scatter.
    """
    finite = np.asarray([shot for shot in shots if math.isfinite(shot)], dtype=np.float64)
    kept = rule.keep(finite)
    if len(kept) == 0:
        return math.nan, math.nan
    # Counted from the first shot, so that equal shots average to exactly their value.
    deviations = kept - kept[0]
    mean = float(kept[0] + deviations.mean())
    if len(kept) == 1:
        return mean, math.nan
    return mean, float(deviations.std(ddof=1) / math.sqrt(len(kept)))

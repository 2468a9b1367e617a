"""Mean of the shots of one quantity and its standard uncertainty, optionally without outliers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

# Standard deviation of a normal distribution over its median absolute deviation.
MAD_TO_SIGMA = 1.4826
MAX_SHOTS = 10_000  # largest number of shots of a measurement
FEWEST_SHOTS = 3  # among fewer shots, no outlier can be identified


@dataclass(frozen=True)
class OutlierRule:
    """Rule that identifies outliers.

    Attributes:
        kind: ``none``; ``mad``: a shot farther from the median than `limit` standard deviations,
            estimated as 1.4826 times the median absolute deviation; ``sigma``: a shot farther from
            the mean than `limit` sample standard deviations, repeated until no shot is.
        limit: Limit [standard deviations].
    """

    kind: str = "none"
    limit: float = math.inf

    def keep(self, shots: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Return the shots that are not outliers.

        Args:
            shots: Finite values, shape (n,).
        """
        if self.kind == "mad" and len(shots) >= FEWEST_SHOTS:
            distances = np.abs(shots - np.median(shots))
            shots = shots[distances <= self.limit * MAD_TO_SIGMA * np.median(distances)]
        while self.kind == "sigma" and len(shots) >= FEWEST_SHOTS:
            kept = shots[np.abs(shots - shots.mean()) <= self.limit * shots.std(ddof=1)]
            if len(kept) in (0, len(shots)):
                break
            shots = kept
        return shots


def average(shots: Sequence[float], rule: OutlierRule = OutlierRule()) -> tuple[float, float]:
    """Average the shots of one quantity.

    Args:
        shots: One value per shot; NaN or infinite if the shot gave none.
        rule: Rule that identifies outliers, which are left out.

    Returns:
        The mean over the valid shots and its standard uncertainty: the sample standard deviation of
        a shot, divided by the square root of their number. The uncertainty is NaN with a single
        valid shot, which shows no scatter; both are NaN without any.
    """
    finite = np.asarray([shot for shot in shots if math.isfinite(shot)], dtype=np.float64)
    kept = rule.keep(finite)
    if len(kept) == 0:
        return math.nan, math.nan
    # Relative to the first shot, so that equal shots average to exactly their value.
    deviations = kept - kept[0]
    mean = float(kept[0] + deviations.mean())
    if len(kept) == 1:
        return mean, math.nan
    return mean, float(deviations.std(ddof=1) / math.sqrt(len(kept)))

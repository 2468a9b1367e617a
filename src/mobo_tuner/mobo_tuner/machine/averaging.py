"""One value for the shots of a quantity and its standard uncertainty, optionally without outliers."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

# Standard deviation of a normal distribution over its median absolute deviation.
MAD_TO_SIGMA = 1.4826
_PERCENTILE = re.compile(r"p(\d{1,3}(?:\.\d+)?)")
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


def percentile(statistic: str) -> float | None:
    """Return the percentile that a statistic is, 0 to 100; None for the mean and the root mean square.

    Args:
        statistic: ``mean``, ``rms``, or a percentile such as ``p90``.

    Raises:
        ValueError: If it is none of these.

    Example:
        >>> percentile("p97.5")
        97.5
    """
    if statistic in ("mean", "rms"):
        return None
    found = _PERCENTILE.fullmatch(statistic)
    if not found or not float(found[1]) <= 100.0:
        raise ValueError(
            f"the statistic is '{statistic:.20}'; allowed are mean, rms, and p0 to p100 for a percentile"
        )
    return float(found[1])


def average(
    shots: Sequence[float], rule: OutlierRule = OutlierRule(), statistic: str = "mean"
) -> tuple[float, float]:
    """Average the shots of one quantity.

    Args:
        shots: One value per shot; NaN or infinite if the shot gave none.
        rule: Rule that identifies outliers, which are left out.
        statistic: What is taken of the valid shots, see `percentile`.

    Returns:
        The statistic of the valid shots and its standard uncertainty. That of the mean is the sample
        standard deviation of a shot, divided by the square root of their number; that of the root mean
        square follows to first order; that of a percentile is half the distance between the two percentiles
        that are a standard deviation of their rank away. The uncertainty is NaN with a single valid
        shot, which shows no scatter; both are NaN without any.

    Raises:
        ValueError: If there is no such statistic.
    """
    percent = percentile(statistic)
    finite = np.asarray([shot for shot in shots if math.isfinite(shot)], dtype=np.float64)
    kept = rule.keep(finite)
    if len(kept) == 0:
        return math.nan, math.nan
    if percent is not None:
        return _percentile_of(kept, percent / 100.0)
    if statistic == "rms":
        return _root_mean_square_of(kept)
    # Relative to the first shot, so that equal shots average to exactly their value.
    deviations = kept - kept[0]
    mean = float(kept[0] + deviations.mean())
    if len(kept) == 1:
        return mean, math.nan
    return mean, float(deviations.std(ddof=1) / math.sqrt(len(kept)))


def _root_mean_square_of(shots: npt.NDArray[np.float64]) -> tuple[float, float]:
    largest = float(np.abs(shots).max())
    if largest == 0.0:
        return 0.0, math.nan if len(shots) == 1 else 0.0
    squares = np.square(shots / largest)
    root = math.sqrt(squares.mean())
    if len(shots) == 1:
        return largest * root, math.nan
    stddev = float(squares.std(ddof=1)) / math.sqrt(len(shots)) / (2.0 * root)
    return largest * root, largest * stddev


def _percentile_of(shots: npt.NDArray[np.float64], share: float) -> tuple[float, float]:
    value = float(np.quantile(shots, share))
    if len(shots) == 1:
        return value, math.nan
    off = math.sqrt(share * (1.0 - share) / len(shots))
    low, high = np.quantile(shots, np.clip([share - off, share + off], 0.0, 1.0))
    return value, 0.5 * float(high - low)

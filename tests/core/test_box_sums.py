"""The one-dimensional integrals against adaptive quadrature, far into the tails."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from scipy.integrate import quad

from mobo_tuner.core import box_sums


def scaled_integral(power: int, start: float, width: float, weight_at: float) -> float:
    """integral_0^width (weight_at - s) w^power phi(w) / phi(start) ds with w = start + s."""

    def integrand(s: float) -> float:
        return (weight_at - s) * (start + s) ** power * math.exp(-start * s - 0.5 * s * s)

    peak = min(max(-start, 0.0), width)
    points = sorted({0.0, peak, width, *(min(max(peak + k, 0.0), width) for k in (-3, -1, 1, 3))})
    pieces = [
        quad(integrand, a, b, epsabs=0.0, epsrel=1e-12)[0] for a, b in itertools.pairwise(points)
    ]
    return math.fsum(pieces)


def density(z: float) -> float:
    return math.exp(-0.5 * z * z) / math.sqrt(2.0 * math.pi)


@pytest.mark.parametrize(
    "x", [0.0, 1e-9, 0.3, 1.0, 2.5, 4.9999, 5.0, 5.0001, 8.0, 12.0, 30.0, 37.0]
)
def test_tail_holds_its_relative_accuracy(x: float) -> None:
    shortfall, mass, at_x = box_sums._tail(x)
    reach = 40.0 / max(x, 1.0)

    def first_moment(s: float) -> float:
        return s * math.exp(-x * s - 0.5 * s * s)

    expected = density(x) * quad(first_moment, 0.0, reach, epsabs=0.0, epsrel=1e-13)[0]
    assert at_x == pytest.approx(density(x), rel=1e-12)
    assert mass == pytest.approx(0.5 * math.erfc(x / math.sqrt(2.0)), rel=1e-12)
    assert shortfall == pytest.approx(expected, rel=1e-11)


def test_tail_ends_in_zero() -> None:
    assert box_sums._tail(50.0) == (0.0, 0.0, 0.0)
    assert box_sums._tail(math.inf) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("z", [-30.0, -3.0, -0.1, 0.0, 0.1, 3.0, 30.0])
def test_expected_shortfall_reflects(z: float) -> None:
    shortfall, mass, _ = box_sums._expected_shortfall(z)
    mirrored, mirrored_mass, _ = box_sums._expected_shortfall(-z)
    assert shortfall - mirrored == pytest.approx(z, rel=1e-14, abs=1e-300)
    assert mass + mirrored_mass == pytest.approx(1.0, rel=1e-14)


@pytest.mark.parametrize("width", [1e-7, 1e-3, 0.02, 0.049, 0.051, 0.3, 0.99, 1.01, 3.0, 15.0])
@pytest.mark.parametrize("start", [-25.0, -10.0, -2.0, -0.4, 0.0, 0.5, 3.0, 12.0, 25.0])
def test_truncated_shortfall(start: float, width: float) -> None:
    value, slope_mean, slope_stddev = box_sums._truncated_shortfall(start, start + width)
    width = (start + width) - start  # what rounding left of it
    scale = density(start)
    zeroth = scale * scaled_integral(0, start, width, width)
    first = scale * scaled_integral(1, start, width, width)
    second = scale * scaled_integral(2, start, width, width) - zeroth
    tolerance = 1e-11 * (1.0 + start * start) * zeroth
    assert value == pytest.approx(zeroth, rel=1e-10)
    assert slope_mean == pytest.approx(first, rel=1e-10, abs=tolerance)
    assert slope_stddev == pytest.approx(second, rel=1e-10, abs=tolerance)


def test_no_credit_below_the_truncation_box() -> None:
    above = box_sums._truncated_shortfall(45.0, 50.0)
    assert above == (0.0, 0.0, 0.0)
    below = box_sums._truncated_shortfall(-50.0, -45.0)
    np.testing.assert_allclose(below, 0.0, atol=0.0)

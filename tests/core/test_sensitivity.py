"""First-order Sobol indices against functions whose indices are known."""

from __future__ import annotations

import numpy as np

from mobo_tuner.core.problem import Array
from mobo_tuner.core.sensitivity import first_order_indices


def test_the_function_of_ishigami() -> None:
    """Its indices are known exactly: Ishigami and Homma, ISUMA'90 (1990), with a = 7, b = 0.1."""
    a, b = 7.0, 0.1

    def ishigami(x: Array) -> Array:
        p, q, r = np.pi * x.T
        values: Array = np.sin(p) + a * np.sin(q) ** 2 + b * r**4 * np.sin(p)
        return values

    variance = a**2 / 8 + b * np.pi**4 / 5 + b**2 * np.pi**8 / 18 + 0.5
    exact = [0.5 * (1 + b * np.pi**4 / 5) ** 2 / variance, a**2 / 8 / variance, 0.0]
    np.testing.assert_allclose(first_order_indices(ishigami, 3, 4096), exact, atol=0.02)
    np.testing.assert_allclose(first_order_indices(ishigami, 3, 256), exact, atol=0.1)


def test_a_linear_function_is_shared_by_the_squares_of_its_slopes() -> None:
    slopes = np.array([3.0, -1.0, 0.0, 2.0])
    found = first_order_indices(lambda x: 1e6 + x @ slopes, 4, 1024)
    np.testing.assert_allclose(found, slopes**2 / (slopes @ slopes), atol=0.02)


def test_a_constant_function_is_driven_by_nothing() -> None:
    assert first_order_indices(lambda x: np.full(len(x), 3.0), 2).tolist() == [0.0, 0.0]

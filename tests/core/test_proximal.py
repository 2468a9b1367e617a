"""Proximal biasing against its equation."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from mobo_tuner.core.proximal import ProximalBiasing


def test_it_is_a_normal_density_up_to_a_constant() -> None:
    rng = np.random.default_rng(0)
    root = rng.standard_normal((4, 4))
    precision, center = root @ root.T, rng.uniform(-1.0, 1.0, 4)
    inputs = rng.uniform(-1.0, 1.0, (20, 4))
    normal = multivariate_normal(center, np.linalg.inv(precision))
    expected = normal.logpdf(inputs) - normal.logpdf(center)
    np.testing.assert_allclose(ProximalBiasing(center, precision).log_value(inputs), expected)


def test_number_diagonal_and_matrix_agree() -> None:
    inputs = np.random.default_rng(1).uniform(-1.0, 1.0, (20, 3))
    number = ProximalBiasing(np.zeros(3), 2.0).log_value(inputs)
    np.testing.assert_allclose(ProximalBiasing(np.zeros(3), [2.0] * 3).log_value(inputs), number)
    np.testing.assert_allclose(
        ProximalBiasing(np.zeros(3), 2.0 * np.eye(3)).log_value(inputs), number
    )
    np.testing.assert_allclose(number, -(inputs**2).sum(axis=1))


def test_costs_hold_back_the_expensive_variable() -> None:
    factor = ProximalBiasing([0.0, 0.0], [100.0, 1.0])
    assert factor.log_value([[0.5, 0.0]]) < factor.log_value([[0.0, 0.5]])


def test_it_is_one_at_the_center_and_everywhere_without_cost() -> None:
    assert ProximalBiasing([0.3, -0.2], 50.0).log_value([[0.3, -0.2]])[0] == 0.0
    value, gradient = ProximalBiasing([0.0], 0.0).log_value_with_gradient([[1.0]])
    assert value[0] == 0.0
    assert gradient[0, 0] == 0.0


@pytest.mark.parametrize(
    ("center", "precision", "message"),
    [
        ([[0.0]], 1.0, "center must be finite and of shape"),
        ([np.nan], 1.0, "center must be finite"),
        ([0.0], np.inf, "precision must be finite"),
        ([0.0], -1.0, "positive semi-definite"),
        ([0.0, 0.0], [1.0, -1.0], "positive semi-definite"),
        ([0.0, 0.0], [1.0], "precision must be a number or have shape"),
        ([0.0, 0.0], [[1.0, 2.0], [0.0, 1.0]], "precision must be symmetric"),
    ],
)
def test_wrong_arguments(center: list[float], precision: list[float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        ProximalBiasing(center, precision)


def test_wrong_number_of_variables() -> None:
    with pytest.raises(ValueError, match="inputs must have 2 columns, not 3"):
        ProximalBiasing([0.0, 0.0], 1.0).log_value([[0.0, 0.0, 0.0]])

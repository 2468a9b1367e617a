"""The domain of the search: what is allowed, and what is nearest to a point that is not."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import LinearConstraint, minimize

from mobo_tuner.core.acquisition import AcquisitionFunction, Predictions
from mobo_tuner.core.acquisition_optimizer import MAXIMIZERS
from mobo_tuner.core.arrays import FloatArray
from mobo_tuner.core.domain import Domain, EmptyDomainError
from mobo_tuner.core.initial_design import initial_design

A = np.array([[1.0, 1.0, 0.5], [-0.2, 1.0, -1.0]])
LOWER, UPPER = np.array([-np.inf, -0.3]), np.array([0.4, 0.9])
GRID = np.linspace(-1.0, 1.0, 9)


def limited(*values: FloatArray | None) -> Domain:
    return Domain(values or (None, None, None), A, LOWER, UPPER)


def test_a_box_leaves_points_as_they_are() -> None:
    domain = Domain([None, None])
    x = np.random.default_rng(0).uniform(-1.0, 1.0, (5, 2))
    assert domain.is_box
    assert domain.size == np.inf
    assert (domain.nearest(x) == x).all()


def test_the_nearest_value_of_a_grid_is_that_of_all_distances() -> None:
    choices = np.array([-1.0, -0.4, 0.1, 0.9])
    domain = Domain([choices, None, np.array([0.3])])
    x = np.random.default_rng(0).uniform(-1.0, 1.0, (50, 3))
    nearest = domain.nearest(x)
    expected = choices[np.abs(x[:, :1] - choices).argmin(axis=1)]
    assert (nearest[:, 0] == expected).all()
    assert (nearest[:, 1] == x[:, 1]).all()
    assert (nearest[:, 2] == 0.3).all()
    assert domain.contains(nearest).all()
    assert not domain.contains(x).any()


def test_a_projection_is_the_nearest_point_within_the_limits() -> None:
    """SciPy's SLSQP finds it, too."""
    domain = limited()
    x = np.random.default_rng(1).uniform(-1.0, 1.0, (20, 3))
    projected = domain.project(x.copy())
    assert domain.contains(projected).all()
    for point, found in zip(x, projected, strict=True):
        best = minimize(
            lambda y, point=point: ((y - point) ** 2).sum(),
            np.zeros(3),
            method="SLSQP",
            bounds=[(-1.0, 1.0)] * 3,
            constraints=LinearConstraint(A, LOWER, UPPER),
        ).x
        assert np.linalg.norm(found - point) <= np.linalg.norm(best - point) + 1e-3


def test_what_is_nearest_on_grids_is_within_the_limits_and_not_far() -> None:
    domain = limited(GRID, None, GRID)
    x = np.random.default_rng(2).uniform(-1.0, 1.0, (200, 3))
    nearest = domain.nearest(x)
    assert domain.contains(nearest).all()
    projected = domain.project(x.copy())
    assert np.median(np.linalg.norm(nearest - projected, axis=1)) < 0.25


def test_the_points_of_a_finite_domain_are_all_that_are_allowed() -> None:
    domain = limited(GRID, np.array([-0.5, 0.5]), np.array([0.0]))
    assert domain.size == 18
    points = {tuple(point) for point in domain.points()}
    by_hand = {
        (a, b, 0.0)
        for a in GRID
        for b in (-0.5, 0.5)
        if a + b <= 0.4 and -0.3 <= -0.2 * a + b <= 0.9
    }
    assert points == by_hand
    assert {tuple(point) for point in domain.draw(99, np.random.default_rng(0))} == by_hand


def test_points_that_are_drawn_are_allowed_and_different() -> None:
    domain = limited(GRID, None, None)
    points = domain.draw(256, np.random.default_rng(0))
    assert len(points) > 50
    assert domain.contains(points).all()
    assert len(np.unique(points, axis=0)) == len(points)
    narrow = Domain([None, None], np.array([[1.0, -1.0]]), np.array([0.0]), np.array([0.001]))
    points = narrow.draw(64, np.random.default_rng(0))
    assert len(points) > 30
    assert narrow.contains(points).all()
    assert np.ptp(points[:, 0]) > 1.5  # along all of the band


def test_limits_that_leave_nothing_are_found() -> None:
    with pytest.raises(EmptyDomainError):
        Domain([None, None], np.array([[1.0, 1.0]]), np.array([2.5]), np.array([np.inf]))
    half = np.array([-1.0, 1.0])
    with pytest.raises(EmptyDomainError):  # between the points of the grid
        Domain([half, half], np.array([[1.0, 1.0]]), np.array([0.5]), np.array([1.5]))
    uneven = np.array([-1.0, 0.1, 1.0])
    assert Domain([uneven, half], np.array([[1.0, 1.0]]), np.array([0.5]), np.array([1.5]))


@pytest.mark.parametrize("kind", ["latin_hypercube", "random"])
def test_an_initial_design_is_allowed_and_uses_every_point_before_any_again(kind: str) -> None:
    domain = limited(GRID, None, None)
    points = initial_design(kind, 12, domain, 3)
    assert domain.contains(points).all()
    assert len(np.unique(points, axis=0)) == 12
    small = Domain([np.array([-1.0, 0.0, 1.0]), np.array([-1.0, 1.0])])
    _, counts = np.unique(initial_design(kind, 14, small, 3), axis=0, return_counts=True)
    assert sorted(counts) == [2, 2, 2, 2, 3, 3]


class Peak(AcquisitionFunction):
    """A function with its peak off the grid and outside the limits."""

    def __init__(self, at: FloatArray) -> None:
        self._at = at

    def log_value_from(self, predictions: Predictions) -> FloatArray:
        x = predictions.inputs
        return -((x - self._at) ** 2 * [1.0, 3.0, 0.5]).sum(axis=1) - 0.3 * x[:, 0] * x[:, 1]

    def log_value_with_gradient_from(
        self, predictions: Predictions
    ) -> tuple[FloatArray, FloatArray]:
        x = predictions.inputs
        gradient = -2.0 * (x - self._at) * [1.0, 3.0, 0.5]
        gradient[:, 0] -= 0.3 * x[:, 1]
        gradient[:, 1] -= 0.3 * x[:, 0]
        return self.log_value_from(predictions), gradient


@pytest.mark.parametrize("maximizer", ["multi_start", "particle_swarm"])
@pytest.mark.parametrize("points", [9, 33, 257])
def test_the_maximum_on_grids_within_limits_is_that_of_all_points(
    maximizer: str, points: int
) -> None:
    grid = np.linspace(-1.0, 1.0, points)
    fixed = np.array([0.25])
    domain = limited(grid, grid, fixed)
    function = Peak(np.array([0.83, 0.47, 0.1]))
    found = MAXIMIZERS.find(maximizer)().maximize(
        function, 3, np.random.default_rng(0), domain=domain
    )
    assert found is not None
    assert domain.contains(found.x[None]).all()
    every = domain.points()
    best = function.log_value(every).max()
    assert found.log_value == pytest.approx(best, abs=1e-4 if points == 257 else 1e-12)


def test_the_maximum_within_limits_lies_on_them() -> None:
    """SciPy's SLSQP finds it, too."""
    domain = limited()
    function = Peak(np.array([0.83, 0.47, 0.1]))
    found = MAXIMIZERS.find("multi_start")().maximize(
        function, 3, np.random.default_rng(0), domain=domain
    )
    best = minimize(
        lambda x: -function.log_value(x[None])[0],
        np.zeros(3),
        method="SLSQP",
        bounds=[(-1.0, 1.0)] * 3,
        constraints=LinearConstraint(A, LOWER, UPPER),
    )
    assert found is not None
    assert domain.contains(found.x[None]).all()
    assert found.log_value == pytest.approx(-best.fun, abs=1e-3)

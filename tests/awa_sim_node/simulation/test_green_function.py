"""The integrated Green function, against an integral taken another way."""

from __future__ import annotations

import math
from itertools import pairwise, product

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import erf

from awa_sim_node.simulation.green_function import (
    NEAR_CELLS,
    green_octant,
    image_transform,
    own_transform,
)

SHAPES = [(1.0, 1.0, 1.0), (1.0, 0.8, 3.0), (1.0, 1.3, 0.05)]


def mean_inverse_distance(centre: tuple[float, ...], sides: tuple[float, ...]) -> float:
    """The mean of 1/r over a cell, by 1/r = 2/sqrt(pi) times the integral of exp(-r^2 t^2) over t."""
    edges = [(x - 0.5 * a, x + 0.5 * a) for x, a in zip(centre, sides, strict=True)]

    def integrand(s: float) -> float:
        t = s / (1.0 - s)  # from 0 to infinity
        value = 1.0 / (1.0 - s) ** 2
        for low, high in edges:
            value *= math.sqrt(math.pi) / (2.0 * t) * (erf(t * high) - erf(t * low))
        return value

    points = np.linspace(0.0, 1.0, 9)
    pieces = [
        quad(integrand, low, high, epsabs=1e-12, limit=200)[0] for low, high in pairwise(points)
    ]
    return 2.0 / math.sqrt(math.pi) * sum(pieces) / math.prod(sides)


@pytest.mark.parametrize("sides", SHAPES)
def test_cells_agree_with_an_independent_integral(sides: tuple[float, float, float]) -> None:
    # Within 1e-9 where it is exact, and 2e-5 where the cell is taken for a quadrupole.
    values = green_octant(9, 9, -2, 10, *sides)
    for i, j, k in product((0, 1, 4, 9), (0, 2, 8), (-2, 0, 1, 9)):
        centre = (i * sides[0], j * sides[1], k * sides[2])
        near = math.hypot(*centre) < NEAR_CELLS * max(sides)
        expected = mean_inverse_distance(centre, sides)
        assert values[i, j, k + 2] == pytest.approx(expected, rel=1e-9 if near else 2e-5)


def test_the_middle_of_a_cube() -> None:
    # The mean of 1/r over the unit cube is 3 ln(2 + sqrt 3) - pi/2.
    expected = 3.0 * math.log(2.0 + math.sqrt(3.0)) - 0.5 * math.pi
    assert green_octant(0, 0, 0, 1, 1.0, 1.0, 1.0)[0, 0, 0] == pytest.approx(expected, rel=1e-12)


def around(octant: np.ndarray) -> np.ndarray:
    """The whole cyclic array, twice the mesh, of which x and y from 0 to the middle are given."""
    whole = np.concatenate([octant, octant[-2:0:-1]], axis=0)
    return np.concatenate([whole, whole[:, -2:0:-1]], axis=1)


def test_the_transform_of_the_own_field_is_that_of_the_whole_array() -> None:
    shape, sides = (5, 6, 7), (1.0, 0.7, 2.0)
    octant = green_octant(5, 6, 0, 8, *sides)
    whole = around(np.concatenate([octant, octant[:, :, -2:0:-1]], axis=2))
    assert whole.shape == (10, 12, 14)
    transform = np.fft.rfftn(whole)
    np.testing.assert_allclose(transform.imag, 0.0, atol=1e-10)
    np.testing.assert_allclose(own_transform(shape, *sides), transform.real[:6, :7], atol=1e-10)


def test_the_transform_of_the_image_is_that_of_the_whole_array() -> None:
    shape, sides, offset = (5, 6, 7), (1.0, 0.7, 2.0), -3
    whole = around(green_octant(5, 6, offset, offset + 14, *sides))
    transform = np.fft.rfftn(whole)
    np.testing.assert_allclose(
        image_transform(shape, offset, *sides), transform[:6, :7], atol=1e-10
    )

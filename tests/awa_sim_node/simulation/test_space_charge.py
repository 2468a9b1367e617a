"""The field of a bunch, against charge distributions whose field is known.

A mesh of some 30 nodes and 2**16 particles gives these fields within one or two per cent; what is
linear in the particles, such as the image, is much closer.
"""

from __future__ import annotations

import math
from itertools import product

import numpy as np
import pytest
from numpy.typing import NDArray

from awa_sim_node.simulation.bunch import LOST, WAITING, Bunch, FloatArray
from awa_sim_node.simulation.constants import SPEED_OF_LIGHT, VACUUM_PERMITTIVITY
from awa_sim_node.simulation.pusher import push
from awa_sim_node.simulation.space_charge import BunchField, SpaceCharge, deposit, predicted
from tests.awa_sim_node.simulation.charges import (
    beamline,
    bunch_of,
    uniform_cylinder,
    uniform_sphere,
)

CHARGE = -1e-9
RADIUS = 2e-3
PARTICLES = 2**16


def field_of(
    bunch: Bunch, shape: tuple[int, int, int] = (32, 32, 32), image: bool = False
) -> BunchField:
    solver = SpaceCharge(shape)
    return solver.field(bunch, 0.0, 0.0, 0.0, image)


def nodes(field: BunchField) -> tuple[FloatArray, FloatArray, FloatArray]:
    nx, ny, nz = field.values.shape[:3]
    x, y, z = np.meshgrid(
        field.x + field.dx * np.arange(nx),
        field.y + field.dy * np.arange(ny),
        field.z + field.dz * np.arange(nz),
        indexing="ij",
    )
    return x, y, z


def inner(field: BunchField) -> NDArray[np.bool_]:
    """Which nodes have neighbours on all sides, for a central difference."""
    whole = np.zeros(field.values.shape[:3], dtype=bool)
    whole[1:-1, 1:-1, 1:-1] = True
    return whole


def sphere_field(x: FloatArray, y: FloatArray, z: FloatArray, radius: float) -> FloatArray:
    """E of a uniformly charged sphere around the origin, ``(..., 3)``."""
    r = np.sqrt(x * x + y * y + z * z)
    strength = CHARGE / (4.0 * math.pi * VACUUM_PERMITTIVITY) / np.maximum(r, radius) ** 3
    return strength[..., None] * np.stack([x, y, z], axis=-1)


@pytest.mark.parametrize("momentum", [0.0, 0.5, 12.0])
def test_a_uniform_sphere_inside_and_outside(momentum: float) -> None:
    # A sphere in its own frame: in the laboratory it is shorter by gamma.
    gamma = math.hypot(1.0, momentum)
    beta = momentum / gamma
    points = RADIUS * uniform_sphere(PARTICLES)
    points[:, 2] = points[:, 2] / gamma + 0.5
    bunch = bunch_of(points, momentum, CHARGE)
    field = field_of(bunch)
    x, y, z = nodes(field)
    z = gamma * (z - 0.5)
    expected = sphere_field(x, y, z, RADIUS)
    expected[..., :2] *= gamma
    distance = np.sqrt(x * x + y * y + z * z)
    clear = inner(field) & (np.abs(distance - RADIUS) > 1.8 * field.dx)
    # Share of the largest field: the surface's.
    largest = gamma * np.abs(CHARGE) / (4.0 * math.pi * VACUUM_PERMITTIVITY * RADIUS**2)
    error = np.linalg.norm(field.values[..., :3] - expected, axis=-1) / largest
    for where in (clear & (distance < RADIUS), clear & (distance > RADIUS)):
        assert where.sum() > 3000
        assert np.sqrt((error[where] ** 2).mean()) < 0.01
        assert error[where].max() < 0.05
    # The charge is at rest in its frame: B = beta x E / c.
    e_x, e_y, _, b_x, b_y = np.moveaxis(field.values, -1, 0)
    np.testing.assert_allclose(b_x, -beta * e_y / SPEED_OF_LIGHT, atol=1e-12 * largest)
    np.testing.assert_allclose(b_y, beta * e_x / SPEED_OF_LIGHT, atol=1e-12 * largest)


@pytest.mark.parametrize("momentum", [0.2, 30.0])
def test_a_long_beam(momentum: float) -> None:
    # In its frame the half length is 20 radii: to 2e-3 that of an endless beam in the middle,
    # E_r = lambda r / (2 pi eps0 R^2) in the laboratory as well, and a force smaller by gamma^2.
    gamma = math.hypot(1.0, momentum)
    beta = momentum / gamma
    half = 20.0 * RADIUS / gamma
    points = uniform_cylinder(PARTICLES) * [RADIUS, RADIUS, half] + [0.0, 0.0, 1.0]
    field = field_of(bunch_of(points, momentum, CHARGE), (24, 24, 64))
    x, y, z = nodes(field)
    r = np.sqrt(x * x + y * y)
    within = (np.abs(z - 1.0) < 0.3 * half) & (r > 0.2 * RADIUS) & (r < 0.8 * RADIUS)
    e_x, e_y, _, b_x, b_y = np.moveaxis(field.values, -1, 0)
    e_r, b_phi = (x * e_x + y * e_y) / r, (x * b_y - y * b_x) / r
    line_density = CHARGE / (2.0 * half)
    slope = line_density / (2.0 * math.pi * VACUUM_PERMITTIVITY * RADIUS**2)
    measured = (e_r / r)[within]
    assert within.sum() > 1000
    assert measured.mean() == pytest.approx(slope, rel=0.01)
    assert measured.std() < 0.03 * abs(slope)
    force = (e_r - beta * SPEED_OF_LIGHT * b_phi)[within]
    np.testing.assert_allclose(force, e_r[within] / gamma**2, rtol=1e-9)


def test_the_field_on_the_axis_of_a_cylinder() -> None:
    # By Gauss and symmetry: rho/(2 eps0) (|z+a| - |z-a| + sqrt((z-a)^2+R^2) - sqrt((z+a)^2+R^2)).
    half = 1.5 * RADIUS
    points = uniform_cylinder(PARTICLES) * [RADIUS, RADIUS, half]
    field = field_of(bunch_of(points, 0.0, CHARGE), (31, 31, 41))
    z = field.z + field.dz * np.arange(41)
    density = CHARGE / (math.pi * RADIUS**2 * 2.0 * half)
    expected = np.abs(z + half) - np.abs(z - half)
    expected += np.hypot(z - half, RADIUS) - np.hypot(z + half, RADIUS)
    expected *= density / (2.0 * VACUUM_PERMITTIVITY)
    away = np.abs(np.abs(z) - half) > 1.8 * field.dz
    away[[0, -1]] = False
    error = field.values[15, 15, :, 2] - expected
    assert np.abs(error[away]).max() < 0.02 * np.abs(expected).max()


@pytest.mark.parametrize("momentum", [0.0, 2.0])
def test_the_image_in_the_cathode(momentum: float) -> None:
    # That of a sphere is a sphere of the other charge: outside, a point. It flies the other way,
    # so its electric field is turned into a magnetic one with the other sign.
    gamma = math.hypot(1.0, momentum)
    beta = momentum / gamma
    height = 1.5 * RADIUS / gamma
    points = RADIUS * uniform_sphere(2**14)
    points[:, 2] = points[:, 2] / gamma + height
    bunch = bunch_of(points, momentum, CHARGE)
    shape = (20, 20, 24)
    with_image = field_of(bunch, shape, image=True)
    image = with_image.values - field_of(bunch, shape).values
    x, y, z = nodes(with_image)
    expected = -sphere_field(x, y, gamma * (z + height), 0.0)
    expected[..., :2] *= gamma
    inside = inner(with_image)
    error = np.linalg.norm(image[..., :3] - expected, axis=-1)[inside]
    largest = np.linalg.norm(expected, axis=-1)[inside].max()
    assert error.max() < 0.02 * largest
    assert np.sqrt((error**2).mean()) < 0.003 * largest
    np.testing.assert_allclose(
        image[..., 4], -beta * image[..., 0] / SPEED_OF_LIGHT, atol=1e-10 * largest
    )
    np.testing.assert_allclose(
        image[..., 3], beta * image[..., 1] / SPEED_OF_LIGHT, atol=1e-10 * largest
    )


def test_the_cathode_is_a_conductor() -> None:
    # A disc that has just left it: across the cathode no field is left, whatever the disc's own.
    points = uniform_cylinder(2**14) * [RADIUS, RADIUS, 1e-5] + [0.0, 0.0, 1e-5]
    bunch = bunch_of(points, 0.02, CHARGE)
    field = field_of(bunch, (20, 20, 24), image=True)
    own = field_of(bunch, (20, 20, 24)).values
    below = -field.z / field.dz  # whole or half a number of cells
    if below == round(below):
        across = field.values[:, :, round(below), :2]
    else:
        k = math.floor(below)
        across = 0.5 * (field.values[:, :, k, :2] + field.values[:, :, k + 1, :2])
    assert np.abs(across).max() < 1e-3 * np.abs(own[..., :2]).max()


def test_a_bunch_does_not_push_itself() -> None:
    points = np.random.default_rng(0).normal(size=(20000, 3)) * [1e-3, 2e-3, 5e-4] + [0, 0, 0.3]
    bunch = bunch_of(points, 3.0, CHARGE)
    dt = 1e-12
    field = SpaceCharge((24, 24, 32)).field(bunch, 0.0, 0.5 * dt, 0.0, False)
    before = bunch.phase_space.copy()
    particles = bunch.phase_space, bunch.state, bunch.emission
    push(*particles, 0.0, dt, beamline(), 0.0, 0.0, True, field)
    gained = (bunch.phase_space - before)[:, 3:]
    assert np.abs(gained.mean(axis=0)).max() < 2e-3 * gained.std(axis=0).max()


def test_the_same_bunch_gives_the_same_field_from_a_used_solver() -> None:
    rng = np.random.default_rng(1)
    first = bunch_of(rng.normal(size=(500, 3)) * 1e-3 + [0, 0, 0.01], 0.1)
    second = bunch_of(rng.normal(size=(500, 3)) * 3e-3 + [0, 0, 0.02], 0.4)
    solver = SpaceCharge((12, 12, 16))
    fresh = solver.field(first, 0.0, 0.0, 0.0, True).values.copy()
    solver.field(second, 0.0, 0.0, 0.0, False)
    np.testing.assert_array_equal(solver.field(first, 0.0, 0.0, 0.0, True).values, fresh)


def test_the_mesh_holds_every_bunch() -> None:
    rng = np.random.default_rng(2)
    solver = SpaceCharge((9, 12, 16))
    for width, height, length, momentum in product(
        (1e-5, 9e-3), (1e-5, 9e-3), (1e-7, 3e-3), (0, 30)
    ):
        points = rng.uniform(-1, 1, (50, 3)) * [width, height, length] + [1e-3, -2e-3, 0.2]
        field = solver.field(bunch_of(points, float(momentum)), 0.0, 0.0, 0.0, False)
        cells = (points - [field.x, field.y, field.z]) / [field.dx, field.dy, field.dz]
        assert cells.min() >= 0.0
        assert np.all(cells < np.array([8, 11, 15]))
        assert np.isfinite(field.values).all()


def test_deposit_keeps_charge_and_centre() -> None:
    points = np.random.default_rng(3).uniform(0.5, 6.5, (1000, 3)) * [1.0, 2.0, 3.0]
    charge = np.full((9, 9, 9), 7.0, dtype=np.float32)
    deposit(points, charge, 0.0, 0.0, 0.0, 1.0, 2.0, 3.0)
    assert charge.sum(dtype=np.float64) == pytest.approx(1000.0, rel=1e-6)
    for axis, step in enumerate((1.0, 2.0, 3.0)):
        others = tuple(q for q in range(3) if q != axis)
        centre = (charge.sum(axis=others, dtype=np.float64) @ np.arange(9.0)) * step / 1000.0
        assert centre == pytest.approx(points[:, axis].mean(), rel=1e-6)


def test_what_is_predicted() -> None:
    # At rest under a constant force, by hand; what waits is emitted on the way; the lost are not there.
    momentum = np.array([[0.0, 0.0, 0.0], [0.3, 0.0, 1.0], [0.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    bunch = bunch_of(np.zeros((4, 3)), momentum)
    bunch.state[2:] = WAITING, LOST
    bunch.emission[2] = 5e-12
    later, force = 2e-12, 1e11
    points, low, high, mean = predicted(bunch, 4e-12, later, force)
    assert len(points) == 3
    gain = force * later
    steps = SPEED_OF_LIGHT * later * 0.5 * gain / math.hypot(1.0, 0.5 * gain)
    np.testing.assert_allclose(points[0], [0.0, 0.0, steps])
    gamma = math.sqrt(1.0 + 0.3**2 + 1.1**2)
    np.testing.assert_allclose(
        points[1], SPEED_OF_LIGHT * later / gamma * np.array([0.3, 0.0, 1.1])
    )
    half = 0.5 * later  # as long as the third has been on its way
    third = SPEED_OF_LIGHT * half * 0.5 * force * half / math.hypot(1.0, 0.5 * force * half)
    np.testing.assert_allclose(points[2], [0.0, 0.0, third])
    np.testing.assert_allclose(low, points.min(axis=0))
    np.testing.assert_allclose(high, points.max(axis=0))
    assert mean == pytest.approx((gain + 1.0 + gain + force * half) / 3.0)


def test_the_field_ahead_is_that_of_the_bunch_there() -> None:
    points = np.random.default_rng(4).normal(size=(2000, 3)) * 1e-3 + [0, 0, 0.2]
    now = bunch_of(points, 2.0)
    ahead = 3e-12
    there = bunch_of(points, 2.0)
    there.phase_space[:, 2] += SPEED_OF_LIGHT * ahead * 2.0 / math.hypot(1.0, 2.0)
    solver = SpaceCharge((12, 12, 16))
    first = solver.field(now, 0.0, ahead, 0.0, False)
    moved, values = first.z, first.values.copy()
    second = solver.field(there, 0.0, 0.0, 0.0, False)
    assert moved == pytest.approx(second.z, rel=1e-12)
    np.testing.assert_allclose(values, second.values, atol=1e-5 * np.abs(values).max())


def test_no_particles_have_no_field() -> None:
    bunch = bunch_of(np.zeros((3, 3)), 1.0)
    bunch.state[:] = LOST
    assert np.all(field_of(bunch, (8, 8, 8), image=True).values == 0.0)

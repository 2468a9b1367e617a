"""Whole beams: exact properties, the validation table of `docs/simulation.md`, and the prototype's rows.

Most run on a coarse mesh, whose results are within some per cent of the finest
(`experiments/simulation_convergence.py`).
"""

from __future__ import annotations

import math
from dataclasses import asdict, astuple
from typing import Any

import numpy as np
import pytest

from awa_sim_node.simulation.bunch import Bunch, Laser
from awa_sim_node.simulation.constants import ELECTRON_REST_ENERGY
from awa_sim_node.simulation.injector import HALF_WAY, SCREEN, Injector, Resolution, Settings
from awa_sim_node.simulation.moments import Moments
from awa_sim_node.simulation.space_charge import SpaceCharge

MIDDLE = {"K1": 475.0, "K2": 230.0, "phi1": -5.0, "phi2": -5.0, "G1": 67.5, "G2": 20.0}
COARSE = Resolution(mesh=(16, 16, 32), particles=3000)
SOLVER = SpaceCharge(COARSE.mesh)


def coarse(
    *planes: float, seed: int = 1, laser: Laser | None = None, **settings: float
) -> list[Moments]:
    injector = Injector(Settings(**{**MIDDLE, **settings}), laser)
    return injector.track(planes, COARSE, seed=seed, solver=SOLVER)


@pytest.fixture(scope="module")
def middle() -> list[Moments]:
    """The beam in the middle of the box at 0.5 m and at the screen."""
    return coarse(0.5, SCREEN)


# Exact properties


def test_the_emittance_is_the_thermal_one_without_charge() -> None:
    # R/2 sqrt(E/mc^2): 0.383 mm mrad for 1 mm, where there is no magnetic field. Aberrations of
    # solenoids and cavities add up to 3 % to a short and narrow bunch.
    laser = Laser(radius=1e-3, duration=0.5e-12, rise_time=0.2e-12)
    momentum = math.sqrt(1e-6 * laser.transverse_energy / ELECTRON_REST_ENERGY)
    thermal = 1e6 * 0.5 * laser.radius * momentum
    for beam in coarse(0.5, HALF_WAY, SCREEN, charge=0.0, laser=laser):
        assert beam.eps_x == pytest.approx(thermal, rel=0.03)
        assert beam.eps_y == pytest.approx(thermal, rel=0.03)
        assert beam.transmission == 1.0


def test_without_charge_the_bunch_does_not_feel_itself() -> None:
    # The same particles one by one and together.
    (one,) = coarse(0.5, charge=0.0)
    (faint,) = coarse(0.5, charge=1e-9)
    np.testing.assert_allclose(astuple(one), astuple(faint), rtol=1e-4)


def test_a_round_beam_stays_round(middle: list[Moments]) -> None:
    for beam in middle:
        assert beam.sigma_x == pytest.approx(beam.sigma_y, rel=2e-3)
        assert beam.eps_x == pytest.approx(beam.eps_y, rel=0.01)


def test_the_couplers_kick_makes_it_wider_than_high() -> None:
    # As measured at AWA: 1.15 times, at about 1.2 mT.
    (beam,) = coarse(SCREEN, coupler_kick=1.2)
    assert beam.sigma_x / beam.sigma_y == pytest.approx(1.15, abs=0.03)


def test_the_same_seed_gives_the_same_beam(middle: list[Moments]) -> None:
    assert coarse(0.5, SCREEN) == middle
    other = coarse(SCREEN, seed=2)[0]
    assert other != middle[1]
    np.testing.assert_allclose(astuple(other), astuple(middle[1]), rtol=0.02)


def test_more_planes_change_nothing_at_the_others(middle: list[Moments]) -> None:
    # A plane ends a step of its own; so the steps behind it are others.
    beams = coarse(0.3, 0.5, 1.0, SCREEN)
    np.testing.assert_allclose(astuple(beams[3]), astuple(middle[1]), rtol=5e-3)


def test_a_beam_that_is_lost_has_no_moments() -> None:
    # Against the wave: all return to the cathode.
    for beam in coarse(0.5, SCREEN, phi1=180.0):
        assert beam.transmission == 0.0
        assert math.isnan(beam.sigma_x)


def test_a_wide_beam_loses_its_rim() -> None:
    (beam,) = coarse(SCREEN, K1=400.0, K2=180.0, G1=75.0, charge=50.0)
    assert 0.5 < beam.transmission < 0.99
    assert beam.sigma_x < 50.0 / 2.0  # a full pipe


def test_the_observer_sees_the_bunch_on_its_way() -> None:
    seen: list[tuple[float, float, int]] = []

    def look(time: float, position: float, bunch: Bunch) -> None:
        seen.append((time, position, len(bunch.flying)))

    injector = Injector(Settings(**MIDDLE))
    injector.track([0.1], COARSE, observer=look, solver=SOLVER)
    times, positions, counts = np.array(seen).T
    assert np.all(np.diff(times) > 0.0)
    assert np.all(np.diff(positions) >= 0.0)
    assert positions[-1] < 0.1
    assert counts[-1] == COARSE.particles


# The validation table: the prototype's and other codes' results


def test_one_nanocoulomb_as_in_opal_and_astra() -> None:
    # The public AWA example of OPAL: radius 0.75 mm, 20 ps flat top with 6 ps rise, 0.55 eV of the
    # electrons (two thirds of it across), K1 = 550 A, K2 = 273 A, 60 MV/m on crest, no linac, 5 m.
    settings = Settings(550.0, 273.0, 0.0, 0.0, 60.0, 0.0, charge=1.0)
    laser = Laser(radius=0.75e-3, duration=20e-12, rise_time=6e-12, transverse_energy=0.367)
    resolution = Resolution(mesh=(24, 24, 48), particles=10_000)
    (beam,) = Injector(settings, laser).track([5.0], resolution)
    # Tolerances by what OPAL (2.87-2.98, 2.23-2.24, 5.96-6.19, 66 keV, 6.272) and
    # ASTRA (3.22, 2.35, 5.64, 64 keV, 6.270) differ from one another.
    assert beam.sigma_x == pytest.approx(2.925, rel=0.03)
    assert beam.sigma_z == pytest.approx(2.29, rel=0.03)
    assert beam.eps_x == pytest.approx(6.08, rel=0.10)
    assert 1e3 * beam.dE == pytest.approx(65.0, rel=0.03)
    assert beam.energy == pytest.approx(6.271, abs=0.002)


def test_forty_nanocoulombs_behind_the_gun(middle: list[Moments]) -> None:
    beam = middle[0]
    # The prototype.
    assert beam.sigma_x == pytest.approx(8.53, rel=0.01)
    assert beam.sigma_z == pytest.approx(1.175, rel=0.01)
    assert beam.eps_x == pytest.approx(66.0, rel=0.02)
    assert beam.eps_z == pytest.approx(126.0, rel=0.02)
    assert beam.dE == pytest.approx(0.242, rel=0.01)
    assert beam.energy == pytest.approx(7.073, rel=1e-3)
    # RF-Track on a coarse mesh.
    assert beam.sigma_x == pytest.approx(9.19, rel=0.10)
    assert beam.sigma_z == pytest.approx(1.122, rel=0.06)
    assert beam.eps_x == pytest.approx(72.0, rel=0.10)
    assert beam.eps_z == pytest.approx(130.0, rel=0.05)
    assert beam.dE == pytest.approx(0.222, rel=0.10)
    assert beam.energy == pytest.approx(7.077, rel=1e-3)


@pytest.mark.parametrize(
    ("G1", "expected"),
    [
        (65.0, {200.0: 10.2, 230.0: 5.7, 250.0: 2.9, 270.0: 1.8}),
        (60.0, {200.0: 7.2, 230.0: 2.8, 250.0: 1.8, 270.0: 4.4}),
    ],
)
def test_the_scan_of_the_matching_solenoid(G1: float, expected: dict[float, float]) -> None:  # noqa: N803
    # The other settings of the prototype's scan are not on record: these are the round ones that
    # reproduce it. Within 5 %, and 8 % behind the waist, where half a per cent of K2 is as much.
    settings: Any = {"K1": 500.0, "phi1": 0.0, "phi2": 0.0, "G1": G1, "G2": 30.0}
    for current, size in expected.items():
        (beam,) = coarse(SCREEN, K2=current, **settings)
        assert beam.sigma_x == pytest.approx(size, rel=0.08 if size == 4.4 else 0.05)


# Rows of the prototype's data set (24x24x48, 10 000 particles), at the screen

PROTOTYPE_ROWS = [
    (
        (450.82349, 229.07055, -4.2969302, -7.5509703, 60.643386, 17.565301, 44.468988, 0.35329152),
        (8.71277, 8.31471, 1.68939, 74.5845, 75.1518, 272.839, 0.522401, 13.4005, 1.0),
    ),
    (
        (521.20749, 232.73038, -7.6192935, -3.9187911, 74.227371, 24.07938, 35.543093, 1.6393558),
        (12.173, 10.5364, 1.1326, 79.8363, 77.0907, 192.693, 0.477113, 17.4731, 1.0),
    ),
]


@pytest.mark.parametrize(("settings", "expected"), PROTOTYPE_ROWS)
def test_rows_of_the_prototype(settings: tuple[float, ...], expected: tuple[float, ...]) -> None:
    # Not the same particles, and the prototype is of first order in its steps.
    (beam,) = Injector(Settings(*settings)).track([SCREEN], seed=1)
    tolerances = {"eps_x": 0.02, "eps_y": 0.02, "eps_z": 0.015, "energy": 3e-4}
    for (name, value), reference in zip(asdict(beam).items(), expected, strict=True):
        assert value == pytest.approx(reference, rel=tolerances.get(name, 0.01)), name


# Convergence, from the coarse mesh


def test_finer_steps_change_little(middle: list[Moments]) -> None:
    fine = Resolution(
        COARSE.mesh,
        COARSE.particles,
        emission_steps=100,
        growth=0.01,
        longest_step=3.5e-12,
        refresh=0.03,
        longest_refresh=30e-12,
        image_until=0.04,
    )
    (beam,) = Injector(Settings(**MIDDLE)).track([SCREEN], fine, seed=1, solver=SOLVER)
    np.testing.assert_allclose(astuple(beam), astuple(middle[1]), rtol=0.01)


def test_a_finer_mesh_and_more_particles_change_little(middle: list[Moments]) -> None:
    fine = Resolution(mesh=(24, 24, 48), particles=10_000)
    (beam,) = Injector(Settings(**MIDDLE)).track([SCREEN], fine, seed=1)
    for name, value in asdict(beam).items():
        bound = {"eps_x": 0.08, "eps_y": 0.08, "eps_z": 0.10}.get(name, 0.02)
        assert value == pytest.approx(getattr(middle[1], name), rel=bound), name


# What is refused


@pytest.mark.parametrize(
    ("setting", "value"),
    [("K1", math.nan), ("phi2", math.inf), ("charge", -1.0), ("G2", -20.0), ("G1", 0.0)],
)
def test_settings_that_make_no_sense(setting: str, value: float) -> None:
    with pytest.raises(ValueError, match=f"^{setting} = {value:g} must be "):
        Settings(**{**MIDDLE, setting: value})


def test_resolutions_too_coarse() -> None:
    with pytest.raises(ValueError, match=r"^mesh = \(4, 16, 32\) .* 5 "):
        Resolution(mesh=(4, 16, 32))
    with pytest.raises(ValueError, match=r"^particles = 20 .* 20$"):
        Resolution(particles=20)


@pytest.mark.parametrize(
    "planes", [(3.1, 1.95), (0.5, 0.5), (0.0,), (-1.0, 3.1), (math.nan,), (0.5, math.inf)]
)
def test_planes_that_cannot_be_passed(planes: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match=r"^planes = .* m must be finite"):
        coarse(*planes)


def test_a_plane_in_the_laser() -> None:
    with pytest.raises(ValueError, match=r"plane at 0\.0001 m"):
        coarse(1e-4)

"""The crest: where an electron gains most, in the gun and in the linac."""

from __future__ import annotations

import math

import numpy as np
import pytest

from awa_sim_node.simulation.bunch import Laser
from awa_sim_node.simulation.constants import ELECTRON_REST_ENERGY, SPEED_OF_LIGHT
from awa_sim_node.simulation.gun import ANGULAR_FREQUENCY, gun_map
from awa_sim_node.simulation.injector import Injector, Resolution, Settings
from awa_sim_node.simulation.linac import linac_map
from awa_sim_node.simulation.phasing import gun_crest, linac_crest
from tests.awa_sim_node.simulation.charges import beamline, bunch_of
from tests.awa_sim_node.simulation.test_pusher import step

GUN = gun_map()
LINAC = linac_map()
SHORT = Laser(radius=1e-3, duration=1e-13, rise_time=1e-13)  # all electrons at one phase


def momentum_behind_the_gun(gradient: float, phase: float) -> float:
    field, time, dt = GUN.scaled(1e6 * gradient), 0.0, 5e-13
    bunch = bunch_of(np.zeros((1, 3)), 0.0)
    while bunch.phase_space[0, 2] < field.end:
        angle = math.radians(phase) + ANGULAR_FREQUENCY * (time + 0.5 * dt)
        step(bunch, beamline(gun=field), dt, time, gun_angle=angle)
        time += dt
    return float(bunch.phase_space[0, 5])


@pytest.mark.parametrize("gradient", [55.0, 78.0])
def test_the_guns_crest_is_the_highest_point(gradient: float) -> None:
    crest = gun_crest(GUN.scaled(1e6 * gradient))
    low, top, high = (momentum_behind_the_gun(gradient, crest + d) for d in (-2.0, 0.0, 2.0))
    assert top > max(low, high)
    # The parabola through them has its top within 0.1 degrees.
    assert abs((high - low) / (2.0 * top - low - high)) < 0.1


def test_the_linacs_crest_adds_what_the_map_can_give() -> None:
    energies = []
    for phase in (-3.0, 0.0, 3.0):
        settings = Settings(0.0, 0.0, 0.0, phase, 67.5, 20.0, charge=0.0)
        beam = Injector(settings, SHORT).track([1.95], Resolution(particles=64))[0]
        energies.append(beam.energy)
    gun = Injector(Settings(0.0, 0.0, 0.0, 0.0, 67.5, 0.0, charge=0.0), SHORT)
    gain = energies[1] - gun.track([0.5], Resolution(particles=64))[0].energy
    low, top, high = energies
    assert abs((high - low) / (2.0 * top - low - high)) < 0.1
    # An electron of 7 MeV falls behind the wave by little.
    assert gain / 20.0 == pytest.approx(0.4036, abs=0.001)


def test_the_linacs_crest_follows_the_arrival() -> None:
    # Another gun phase delays the electron; in its own time the linac's crest stays.
    gun, linac = GUN.scaled(67.5e6), LINAC.scaled(20e6)
    crest = gun_crest(gun)
    shift = linac_crest(gun, crest - 10.0, linac) - linac_crest(gun, crest, linac)
    momentum = momentum_behind_the_gun(67.5, crest)
    assert momentum == pytest.approx(7.1 / ELECTRON_REST_ENERGY + 1.0, rel=0.03)
    # Starting 10 degrees earlier in the wave, it leaves the gun later by less than that.
    assert -10.0 < shift < 0.0
    far = linac._replace(start=linac.start + 0.1)
    later = (linac_crest(gun, crest, far) - linac_crest(gun, crest, linac)) % 360.0
    beta = momentum / math.hypot(1.0, momentum)
    expected = math.degrees(-ANGULAR_FREQUENCY * 0.1 / (beta * SPEED_OF_LIGHT)) % 360.0
    assert later == pytest.approx(expected, abs=0.1)

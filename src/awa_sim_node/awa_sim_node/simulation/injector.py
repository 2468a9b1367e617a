"""The whole injector, from the laser on the cathode to the screen."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from itertools import pairwise
from typing import Final

import numpy as np

from awa_sim_node.simulation.bunch import Bunch, Laser, emit
from awa_sim_node.simulation.constants import SPEED_OF_LIGHT
from awa_sim_node.simulation.field_map import FieldMap
from awa_sim_node.simulation.gun import ANGULAR_FREQUENCY, gun_map
from awa_sim_node.simulation.linac import linac_map
from awa_sim_node.simulation.moments import Moments, moments
from awa_sim_node.simulation.phasing import gun_crest, linac_crest
from awa_sim_node.simulation.pusher import Beamline, push
from awa_sim_node.simulation.solenoid import solenoid_maps, superpose
from awa_sim_node.simulation.space_charge import BunchField, SpaceCharge

SCREEN: Final = 3.1
"""Position of the first screen [m from the cathode]."""

HALF_WAY: Final = 1.95
"""Position behind the linac [m from the cathode]."""


@dataclass(frozen=True)
class Settings:
    """Settings of the machine; names and units are those of the surrogate's inputs.

    Attributes:
        K1: Current of the bucking and focusing solenoid [A].
        K2: Current of the matching solenoid [A].
        phi1: Gun phase from crest [deg].
        phi2: Linac phase from crest [deg].
        G1: Gun gradient [MV/m].
        G2: Linac gradient [MV/m]; 0 for no linac.
        charge: Bunch charge [nC]; 0 for no space charge.
        coupler_kick: Integrated quadrupole gradient of the linac's coupler [mT].

    Raises:
        ValueError: If a value is not finite, a charge or gradient is negative, or G1 is 0.
    """

    K1: float
    K2: float
    phi1: float
    phi2: float
    G1: float
    G2: float
    charge: float = 40.0
    coupler_kick: float = 0.0

    def __post_init__(self) -> None:
        """Check the values."""
        for name, value in asdict(self).items():
            if not math.isfinite(value):
                raise ValueError(f"{name} = {value:g} must be a finite number")
        for name in ("G2", "charge"):
            if getattr(self, name) < 0.0:
                raise ValueError(f"{name} = {getattr(self, name):g} must be 0 or more")
        if self.G1 <= 0.0:
            raise ValueError(f"G1 = {self.G1:g} must be more than 0")


@dataclass(frozen=True)
class Resolution:
    """Resolution of the simulation.

    Attributes:
        mesh: Number of nodes of the space-charge mesh, ``(nx, ny, nz)``.
        particles: Number of macro-particles.
        emission_steps: Number of steps during the laser pulse.
        growth: Longest step as a fraction of the time since the laser pulse started.
        longest_step: Longest step in any case [s].
        refresh: Time between two solutions for the field of the bunch, as a fraction of the time
            since the laser pulse started; at least one step.
        longest_refresh: Longest time between two solutions [s].
        image_until: Position of the bunch up to which the image in the cathode is included [m].

    Raises:
        ValueError: If there are too few nodes or particles to compute a field.
    """

    mesh: tuple[int, int, int] = (24, 24, 48)
    particles: int = 10_000
    emission_steps: int = 50
    growth: float = 0.02
    longest_step: float = 7e-12
    refresh: float = 0.06
    longest_refresh: float = 60e-12
    image_until: float = 0.02

    @classmethod
    def of_mesh(cls, nodes: int) -> Resolution:
        """Return the resolution with as many nodes across the bunch, and as many particles for each of them.

        Raises:
            ValueError: If there are too few nodes to compute a field.
        """
        usual = cls()
        mesh = (nodes, nodes, 2 * nodes)
        return cls(mesh, round(usual.particles * (nodes / usual.mesh[0]) ** 3))

    def __post_init__(self) -> None:
        """Check the values."""
        if min(self.mesh) < _FEWEST_NODES:
            raise ValueError(
                f"mesh = {self.mesh} must have {_FEWEST_NODES} or more nodes in each direction"
            )
        if self.particles <= _FEWEST:
            raise ValueError(f"particles = {self.particles} must be more than {_FEWEST}")


_FEWEST_NODES: Final = 5
"""Lowest number of nodes in each direction.

One cell is free on each side of the bunch, and half a cell is lost to the alignment with the cathode.
"""

_FEWEST: Final = 20
"""Number of particles that must have been emitted before a field is computed."""

Observer = Callable[[float, float, Bunch], None]
"""Callable that receives the time [s], the mean position [m] and the bunch after each solution."""


class Injector:
    """The injector with given settings."""

    def __init__(self, settings: Settings, laser: Laser | None = None) -> None:
        """Scale the fields, and find the crest phases of gun and linac.

        Args:
            settings: Settings of the machine.
            laser: Laser pulse; by default that of the data set.
        """
        self.settings = settings
        self.laser = laser or Laser()
        gun, focusing, matching, linac = _maps()
        solenoids = superpose(focusing.scaled(settings.K1), matching.scaled(settings.K2))
        gun, linac = gun.scaled(1e6 * settings.G1), linac.scaled(1e6 * settings.G2)
        self.beamline = Beamline(gun, solenoids, linac, 1e-3 * settings.coupler_kick)
        self.gun_phase = gun_crest(gun) + settings.phi1
        self.linac_phase = 0.0
        if settings.G2 > 0.0:
            self.linac_phase = linac_crest(gun, self.gun_phase, linac) + settings.phi2

    def track(
        self,
        planes: Sequence[float] = (HALF_WAY, SCREEN),
        resolution: Resolution | None = None,
        seed: int = 0,
        observer: Observer | None = None,
        solver: SpaceCharge | None = None,
    ) -> list[Moments]:
        """Track a bunch, and return its moments at the time its mean reaches each plane.

        Args:
            planes: Positions in increasing order [m from the cathode].
            resolution: Resolution; by default that of the data set.
            seed: Seed of the bunch.
            observer: Callable that receives the bunch after each solution for its field.
            solver: Solver with the same mesh to reuse.

        Returns:
            The moments at each plane; NaN with a transmission of 0 if the whole bunch was lost.

        Raises:
            ValueError: If the planes are not in increasing order, or the bunch reaches one during
                the laser pulse.
        """
        _check_planes(planes)
        resolution = resolution or Resolution()
        solver = solver or SpaceCharge(resolution.mesh)
        space_charge = self.settings.charge > 0.0
        bunch = emit(self.laser, 1e-9 * self.settings.charge, resolution.particles, seed)
        pulse = 2.0 * self.laser.centre
        enough = float(np.sort(bunch.emission)[_FEWEST])
        gun_start = math.radians(self.gun_phase) - ANGULAR_FREQUENCY * self.laser.centre
        linac_start = math.radians(self.linac_phase) - ANGULAR_FREQUENCY * self.laser.centre
        time, position, momentum, force = 0.0, 0.0, 0.0, 0.0
        field, field_time, next_field = _no_field(), -1.0, 0.0
        passed: list[Moments] = []
        while len(passed) < len(planes):
            dt, refresh = _steps(resolution, time, pulse)
            if space_charge and time >= next_field and time + 0.5 * refresh > enough:
                image = position < resolution.image_until
                field = solver.field(bunch, time, 0.5 * refresh, force, image)
                field_time, next_field = time + 0.5 * refresh, time + (1.0 - 1e-9) * refresh
                if observer is not None:
                    observer(time, position, bunch)
            velocity = SPEED_OF_LIGHT * momentum / math.sqrt(1.0 + momentum**2)
            arrival = (planes[len(passed)] - position) / velocity if velocity > 0.0 else math.inf
            arrived = time > pulse and arrival <= dt
            if arrived and arrival < 0.0:
                raise ValueError(
                    f"the plane at {planes[len(passed)]:g} m is too near the cathode: at the end "
                    f"of the laser pulse the bunch is already at {position:.3g} m"
                )
            dt = arrival if arrived else dt
            middle = time + 0.5 * dt
            moved = field._replace(z=field.z + _advance(field.momentum, force, middle - field_time))
            count, position, momentum, force = push(
                bunch.phase_space,
                bunch.state,
                bunch.emission,
                time,
                dt,
                self.beamline,
                gun_start + ANGULAR_FREQUENCY * middle,
                linac_start + ANGULAR_FREQUENCY * middle,
                field_time >= 0.0,
                moved,
            )
            time += dt
            if arrived or (count == 0 and time > pulse):
                passed.append(moments(bunch))
        return passed


def _check_planes(planes: Sequence[float]) -> None:
    """Check that the planes are finite and in increasing order."""
    for first, second in pairwise([0.0, *planes]):
        if not first < second < math.inf:
            raise ValueError(
                f"planes = {', '.join(f'{plane:g}' for plane in planes)} m must be finite, more "
                "than 0, and in increasing order"
            )


def _steps(resolution: Resolution, time: float, pulse: float) -> tuple[float, float]:
    """Return the length of a step, and the time for which the bunch's field is reused [s]."""
    if time < (1.0 - 1e-9) * pulse:
        dt = pulse / resolution.emission_steps
        return dt, dt
    dt = max(pulse / resolution.emission_steps, resolution.growth * time)
    dt = min(dt, resolution.longest_step)
    refresh = max(dt, min(resolution.refresh * time, resolution.longest_refresh))
    # An integer number of steps, so that the field is computed for the middle of the interval.
    return dt, dt * round(refresh / dt)


def _advance(momentum: float, force: float, interval: float) -> float:
    """Return the distance that a particle moves under a constant force [m].

    Args:
        momentum: Initial momentum [mc].
        force: Force [mc/s].
        interval: Time [s].
    """
    later = momentum + force * interval
    mean = (momentum + later) / (math.sqrt(1.0 + momentum**2) + math.sqrt(1.0 + later**2))
    return SPEED_OF_LIGHT * mean * interval


@cache
def _maps() -> tuple[FieldMap, FieldMap, FieldMap, FieldMap]:
    return (gun_map(), *solenoid_maps(), linac_map())


def _no_field() -> BunchField:
    return BunchField(np.zeros((1, 1, 1, 5)), 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 0.0)

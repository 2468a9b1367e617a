"""Motion of the particles by Boris' method: half a drift, a kick, half a drift."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from awa_sim_node.simulation.bunch import FLYING, LOST, WAITING
from awa_sim_node.simulation.constants import CHARGE_OVER_MASS, SPEED_OF_LIGHT
from awa_sim_node.simulation.coupler_kick import gradient
from awa_sim_node.simulation.field_map import FieldMap, FloatArray
from awa_sim_node.simulation.space_charge import BunchField

GUN_APERTURE: Final = 0.025
"""Radius of the iris up to ``GUN_END`` [m]."""

GUN_END: Final = 0.575
"""Position where the aperture widens [m from the cathode]."""

PIPE_APERTURE: Final = 0.05
"""Radius of the aperture beyond ``GUN_END`` [m]."""


class Beamline(NamedTuple):
    """All external fields, for compiled code.

    Attributes:
        gun: Map of (E_z, E_r, B_phi) of the gun at crest [V/m, T].
        solenoids: Map of (B_z, B_r) of all solenoids [T].
        linac: Map of (E_z, E_r, B_phi) of the linac at crest [V/m, T].
        coupler_kick: Integrated quadrupole gradient of the linac's coupler [T].
    """

    gun: FieldMap
    solenoids: FieldMap
    linac: FieldMap
    coupler_kick: float


@njit(cache=True, fastmath=True)
def push(
    phase_space: FloatArray,
    state: NDArray[np.int8],
    emission: FloatArray,
    time: float,
    dt: float,
    beamline: Beamline,
    gun_angle: float,
    linac_angle: float,
    space_charge: bool,
    own: BunchField,
) -> tuple[int, float, float, float]:
    """Move all particles by one step.

    A particle emitted during the step only moves for the rest of it. Particles that return to the
    cathode or leave the aperture are lost.

    Args:
        phase_space: Positions [m] and momenta [mc], ``(n, 6)``; modified in place.
        state: State of each particle, ``(n,)``; modified in place.
        emission: Emission times [s], ``(n,)``.
        time: Start of the step [s].
        dt: Length of the step [s].
        beamline: External fields.
        gun_angle: Phase of the gun at the middle of the step [rad].
        linac_angle: Phase of the linac at the middle of the step [rad].
        space_charge: Whether to add ``own``.
        own: Field of the bunch at the middle of the step.

    Returns:
        The number of flying particles, their mean position [m], mean axial momentum [mc] and mean
        axial force [mc/s].
    """
    c = SPEED_OF_LIGHT
    gun, solenoids, linac = beamline.gun, beamline.solenoids, beamline.linac
    gun_cos, gun_sin = math.cos(gun_angle), math.sin(gun_angle)
    linac_cos, linac_sin = math.cos(linac_angle), math.sin(linac_angle)
    gun_columns = gun.values.shape[1] - 1
    solenoid_columns = solenoids.values.shape[1] - 1
    linac_columns = linac.values.shape[1] - 1
    nx, ny, nz = own.values.shape[0], own.values.shape[1], own.values.shape[2]
    count, sum_z, sum_u, sum_kick, sum_step = 0, 0.0, 0.0, 0.0, 0.0
    for p in range(len(phase_space)):
        if state[p] == LOST:
            continue
        step = dt
        if state[p] == WAITING:
            step = time + dt - emission[p]
            if step <= 0.0:
                continue
            state[p] = FLYING
        ux, uy, uz = phase_space[p, 3], phase_space[p, 4], phase_space[p, 5]
        half = 0.5 * step * c / math.sqrt(1.0 + ux * ux + uy * uy + uz * uz)
        x = phase_space[p, 0] + half * ux
        y = phase_space[p, 1] + half * uy
        z = max(phase_space[p, 2] + half * uz, 0.0)
        r = math.sqrt(x * x + y * y)

        # The maps accelerate at crest; the charge is negative, so E has the opposite sign.
        e_z, e_r, b_phi, b_z, b_r = 0.0, 0.0, 0.0, 0.0, 0.0
        v = (z - gun.start) / gun.dz
        if v < gun_columns:
            u = r / gun.dr
            i, j = min(int(u), gun.values.shape[0] - 2), int(v)
            f, g = min(u - i, 1.0), v - j
            w00, w01, w10, w11 = (1 - f) * (1 - g), (1 - f) * g, f * (1 - g), f * g
            m, n, q, s = (
                gun.values[i, j],
                gun.values[i, j + 1],
                gun.values[i + 1, j],
                gun.values[i + 1, j + 1],
            )
            e_z -= gun_cos * (w00 * m[0] + w01 * n[0] + w10 * q[0] + w11 * s[0])
            e_r -= gun_cos * (w00 * m[1] + w01 * n[1] + w10 * q[1] + w11 * s[1])
            b_phi += gun_sin * (w00 * m[2] + w01 * n[2] + w10 * q[2] + w11 * s[2])
        v = (z - solenoids.start) / solenoids.dz
        if v < solenoid_columns:
            u = r / solenoids.dr
            i, j = min(int(u), solenoids.values.shape[0] - 2), int(v)
            f, g = min(u - i, 1.0), v - j
            w00, w01, w10, w11 = (1 - f) * (1 - g), (1 - f) * g, f * (1 - g), f * g
            m, n, q, s = (
                solenoids.values[i, j],
                solenoids.values[i, j + 1],
                solenoids.values[i + 1, j],
                solenoids.values[i + 1, j + 1],
            )
            b_z += w00 * m[0] + w01 * n[0] + w10 * q[0] + w11 * s[0]
            b_r += w00 * m[1] + w01 * n[1] + w10 * q[1] + w11 * s[1]
        v = (z - linac.start) / linac.dz
        if 0.0 <= v < linac_columns:
            u = r / linac.dr
            i, j = min(int(u), linac.values.shape[0] - 2), int(v)
            f, g = min(u - i, 1.0), v - j
            w00, w01, w10, w11 = (1 - f) * (1 - g), (1 - f) * g, f * (1 - g), f * g
            m, n, q, s = (
                linac.values[i, j],
                linac.values[i, j + 1],
                linac.values[i + 1, j],
                linac.values[i + 1, j + 1],
            )
            e_z -= linac_cos * (w00 * m[0] + w01 * n[0] + w10 * q[0] + w11 * s[0])
            e_r -= linac_cos * (w00 * m[1] + w01 * n[1] + w10 * q[1] + w11 * s[1])
            b_phi += linac_sin * (w00 * m[2] + w01 * n[2] + w10 * q[2] + w11 * s[2])
        along_x, along_y = (x / r, y / r) if r > 1e-12 else (1.0, 0.0)
        e_x, e_y = e_r * along_x, e_r * along_y
        b_x = b_r * along_x - b_phi * along_y
        b_y = b_r * along_y + b_phi * along_x
        if beamline.coupler_kick != 0.0:
            slope = gradient(z, beamline.coupler_kick)
            b_x += slope * y
            b_y += slope * x

        if space_charge:
            a, b, d = (x - own.x) / own.dx, (y - own.y) / own.dy, (z - own.z) / own.dz
            if a >= 0.0 and b >= 0.0 and d >= 0.0:
                i, j, k = int(a), int(b), int(d)
                if i < nx - 1 and j < ny - 1 and k < nz - 1:
                    a -= i
                    b -= j
                    d -= k
                    for h in range(2):
                        wx = a if h == 1 else 1.0 - a
                        for m in range(2):
                            wy = wx * (b if m == 1 else 1.0 - b)
                            for n in range(2):
                                w = wy * (d if n == 1 else 1.0 - d)
                                node = own.values[i + h, j + m, k + n]
                                e_x += w * node[0]
                                e_y += w * node[1]
                                e_z += w * node[2]
                                b_x += w * node[3]
                                b_y += w * node[4]

        kick = 0.5 * CHARGE_OVER_MASS * step
        ux += kick * e_x / c
        uy += kick * e_y / c
        uz += kick * e_z / c
        turn = kick / math.sqrt(1.0 + ux * ux + uy * uy + uz * uz)
        tx, ty, tz = turn * b_x, turn * b_y, turn * b_z
        factor = 2.0 / (1.0 + tx * tx + ty * ty + tz * tz)
        vx = ux + uy * tz - uz * ty
        vy = uy + uz * tx - ux * tz
        vz = uz + ux * ty - uy * tx
        ux += factor * (vy * tz - vz * ty) + kick * e_x / c
        uy += factor * (vz * tx - vx * tz) + kick * e_y / c
        uz += factor * (vx * ty - vy * tx) + kick * e_z / c
        half = 0.5 * step * c / math.sqrt(1.0 + ux * ux + uy * uy + uz * uz)
        x += half * ux
        y += half * uy
        z += half * uz
        sum_kick += uz - phase_space[p, 5]
        sum_step += step
        phase_space[p, 0], phase_space[p, 1], phase_space[p, 2] = x, y, z
        phase_space[p, 3], phase_space[p, 4], phase_space[p, 5] = ux, uy, uz
        aperture = GUN_APERTURE if z < GUN_END else PIPE_APERTURE
        if z < 0.0 or x * x + y * y > aperture * aperture:
            state[p] = LOST
            continue
        count += 1
        sum_z += z
        sum_u += uz
    if count == 0:
        return 0, 0.0, 0.0, 0.0
    return count, sum_z / count, sum_u / count, sum_kick / sum_step

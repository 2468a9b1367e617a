"""Axisymmetric field maps from a few Fourier components of the field on axis.

Off axis a component cos(k z) of E_z is multiplied by I0(kappa r), kappa^2 = k^2 - (omega/c)^2 (by J0
if that is negative), and E_r and B_phi follow from Maxwell's equations; so every map satisfies
them at any radius. A static field is the case omega = 0.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import i0, i1, j0, j1

from awa_sim_node.simulation.constants import SPEED_OF_LIGHT

FloatArray = NDArray[np.float64]

COEFFICIENTS_FILE: Final = Path(__file__).with_name("field_coefficients.json")
"""Fourier coefficients of the normalised fields on axis of the gun and of both solenoids.

They were fitted to the on-axis maps in the AWA example of the public Sirepo (Apache-2.0).
"""


class FieldMap(NamedTuple):
    """A field on a grid in r and z, for compiled code.

    Attributes:
        values: Field components, ``(radii, positions, components)``.
        start: Position of the first column [m from the cathode].
        dr: Step in radius [m].
        dz: Step along the axis [m].
    """

    values: FloatArray
    start: float
    dr: float
    dz: float

    @property
    def end(self) -> float:
        """Position of the last column [m from the cathode]."""
        return float(self.start + self.dz * (self.values.shape[1] - 1))

    def scaled(self, factor: float) -> FieldMap:
        """Return the map multiplied by a factor."""
        return self._replace(values=self.values * factor)


def coefficients() -> dict[str, FloatArray]:
    """Read the Fourier coefficients: ``gun``, ``focusing``, ``matching``; lengths in m."""
    content = json.loads(COEFFICIENTS_FILE.read_text())
    return {name: np.asarray(value, dtype=np.float64) for name, value in content.items()}


def bessel(k: FloatArray, omega: float, r: float) -> tuple[FloatArray, FloatArray]:
    """Return I0(kappa r) and I1(kappa r)/kappa with kappa^2 = k^2 - (omega/c)^2.

    Args:
        k: Wave numbers [1/m].
        omega: Angular frequency [1/s].
        r: Radius [m].
    """
    square = k**2 - (omega / SPEED_OF_LIGHT) ** 2
    kappa = np.sqrt(np.abs(square))
    evanescent = square > 0.0
    zeroth = np.where(evanescent, i0(kappa * r), j0(kappa * r))
    # I1(kappa r)/kappa tends to r/2 for small kappa.
    safe = np.where(kappa > 0.0, kappa, 1.0)
    first = np.where(evanescent, i1(kappa * r), j1(kappa * r)) / safe
    return zeroth, np.where(kappa > 0.0, first, 0.5 * r)


def rf_map(
    k: FloatArray, cosine: FloatArray, sine: FloatArray, omega: float, shape: FieldMap
) -> FieldMap:
    """Return the map (E_z, E_r, B_phi) of a standing wave.

    On axis E_z = sum (cosine cos k z + sine sin k z), to be multiplied by cos(omega t). B_phi is to
    be multiplied by sin(omega t), with the sign of -dE_z/dt.

    Args:
        k: Wave numbers [1/m], ``(n,)``.
        cosine: Coefficients of the cosines, ``(n,)``.
        sine: Coefficients of the sines, ``(n,)``.
        omega: Angular frequency [1/s].
        shape: Map that defines the grid; z counts from its start.
    """
    radii, positions, _ = shape.values.shape
    z = shape.dz * np.arange(positions)
    c, s = np.cos(np.outer(k, z)), np.sin(np.outer(k, z))
    values = np.empty((radii, positions, 3))
    for i in range(radii):
        zeroth, first = bessel(k, omega, i * shape.dr)
        values[i, :, 0] = (cosine * zeroth) @ c + (sine * zeroth) @ s
        values[i, :, 1] = (cosine * k * first) @ s - (sine * k * first) @ c
        axial = (cosine * first) @ c + (sine * first) @ s
        values[i, :, 2] = axial * omega / SPEED_OF_LIGHT**2
    return shape._replace(values=values)


def empty_map(radius: float, radii: int, start: float, length: float, positions: int) -> FieldMap:
    """Return a map of zeros with three components.

    Args:
        radius: Largest radius of the grid [m].
        radii: Number of radii, including the axis.
        start: First position [m from the cathode].
        length: Length of the grid [m].
        positions: Number of positions along the axis.
    """
    values = np.zeros((radii, positions, 3))
    return FieldMap(values, start, radius / (radii - 1), length / (positions - 1))

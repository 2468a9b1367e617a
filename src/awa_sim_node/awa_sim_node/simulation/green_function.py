"""The integrated Green function of free space: the potential of a uniformly charged cell.

Except for a factor, it depends only on the shape of the cell and not on its size. So its Fourier
transform is cached for each shape of cells, and the mesh (``space_charge.py``) only uses shapes
from a lattice.

See J. Qiang et al., Phys. Rev. ST Accel. Beams 9, 044204 (2006).
"""

from __future__ import annotations

import math

import numpy as np
import scipy.fft
from numba import njit
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

NEAR_CELLS = 6.0
"""Distance, in units of a cell's longest side, up to which cells are integrated exactly.

Beyond it, they are expanded in multipoles.
"""


@njit(cache=True)
def _primitive(x: float, y: float, z: float) -> float:
    """Return the primitive of 1/r in all three coordinates."""
    r = math.sqrt(x * x + y * y + z * z)
    return (
        -0.5 * z * z * math.atan(x * y / (z * r))
        - 0.5 * y * y * math.atan(x * z / (y * r))
        - 0.5 * x * x * math.atan(y * z / (x * r))
        + y * z * math.log(x + r)
        + x * z * math.log(y + r)
        + x * y * math.log(z + r)
    )


@njit(cache=True)
def _exact(x: float, y: float, z: float, a: float, b: float, c: float) -> float:
    """Return the mean of 1/r over a cell with the sides a, b, c around (x, y, z)."""
    total = 0.0
    for i in (-0.5, 0.5):
        for j in (-0.5, 0.5):
            for k in (-0.5, 0.5):
                corner = _primitive(x + i * a, y + j * b, z + k * c)
                total += corner if i * j * k > 0.0 else -corner
    return total / (a * b * c)


@njit(cache=True)
def _expanded(x: float, y: float, z: float, a: float, b: float, c: float) -> float:
    """Return the far-field approximation of ``_exact``: monopole and quadrupole of the cell."""
    s = 1.0 / (x * x + y * y + z * z)
    second = a * a * (3.0 * x * x * s - 1.0)
    second += b * b * (3.0 * y * y * s - 1.0) + c * c * (3.0 * z * z * s - 1.0)
    return math.sqrt(s) * (1.0 + second * s / 24.0)


@njit(cache=True)
def green_octant(
    nx: int, ny: int, start: int, stop: int, a: float, b: float, c: float
) -> FloatArray:
    """Return the mean of 1/r over cells (i, j, k) with the sides a, b, c.

    i = 0 .. nx, j = 0 .. ny, k = start .. stop - 1; ``(nx + 1, ny + 1, stop - start)``. The origin
    is the centre of cell (0, 0, 0).
    """
    values = np.empty((nx + 1, ny + 1, stop - start))
    limit = (NEAR_CELLS * max(a, max(b, c))) ** 2
    for i in range(nx + 1):
        x = i * a
        for j in range(ny + 1):
            y = j * b
            for k in range(start, stop):
                z = abs(k) * c
                if x * x + y * y + z * z < limit:
                    values[i, j, k - start] = _exact(x, y, z, a, b, c)
                else:
                    values[i, j, k - start] = _expanded(x, y, z, a, b, c)
    return values


def own_transform(shape: tuple[int, int, int], a: float, b: float, c: float) -> FloatArray:
    """Return the transform of the Green function on twice the mesh.

    It is real and even, so that one octant is enough.

    Args:
        shape: Number of nodes of the mesh, ``(nx, ny, nz)``.
        a: Side of a cell in x.
        b: Side of a cell in y.
        c: Side of a cell in z.

    Returns:
        One octant of the transform, ``(nx + 1, ny + 1, nz + 1)``.
    """
    nx, ny, nz = shape
    values: FloatArray = scipy.fft.dctn(green_octant(nx, ny, 0, nz + 1, a, b, c), type=1)
    return values


def image_transform(
    shape: tuple[int, int, int], offset: int, a: float, b: float, c: float
) -> NDArray[np.complex128]:
    """Return the transform of the Green function between the mesh and its mirror image.

    Node k is ``offset + k + k'`` cells from the image of node k'.

    Args:
        shape: Number of nodes of the mesh, ``(nx, ny, nz)``.
        offset: Distance of the first node from its image, in cells.
        a: Side of a cell in x.
        b: Side of a cell in y.
        c: Side of a cell in z.

    Returns:
        The transform, ``(nx + 1, ny + 1, nz + 1)``; it is even in x and y.
    """
    nx, ny, nz = shape
    octant = green_octant(nx, ny, offset, offset + 2 * nz, a, b, c)
    transverse = scipy.fft.dctn(octant, type=1, axes=(0, 1))
    values: NDArray[np.complex128] = scipy.fft.rfft(transverse, axis=2)
    return values

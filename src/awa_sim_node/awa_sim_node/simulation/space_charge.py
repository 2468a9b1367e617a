"""The field of the bunch itself and of its image in the cathode, on a mesh that moves with it.

In the rest frame of the bunch's mean motion the field is electrostatic: the charges are assigned to
the nodes of a mesh (cloud in cell), the potential is their convolution with the integrated Green
function by fast Fourier transforms, and the field is the difference quotient of the potential.
Transformed back to the laboratory, the transverse electric field has a magnetic field with it. The
image moves in the opposite direction, so that its magnetic field has the opposite sign.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from typing import Any, Final, NamedTuple

import numpy as np
import scipy.fft
from numba import njit
from numpy.typing import NDArray

from awa_sim_node.simulation.bunch import FLYING, WAITING, Bunch
from awa_sim_node.simulation.constants import SPEED_OF_LIGHT, VACUUM_PERMITTIVITY
from awa_sim_node.simulation.green_function import image_transform, own_transform

FloatArray = NDArray[np.floating[Any]]
ComplexArray = NDArray[np.complexfloating[Any, Any]]

SHAPE_STEP: Final = 1.03
"""Base of the ratios of a cell's sides, which are integer powers of it, so that few shapes occur."""

_KEPT_SHAPES: Final = 600
_COULOMB: Final = 1.0 / (4.0 * math.pi * VACUUM_PERMITTIVITY)


class BunchField(NamedTuple):
    """Field of the bunch in the laboratory at one time.

    Attributes:
        values: Components E_x, E_y, E_z [V/m], B_x, B_y [T] at the nodes, ``(nx, ny, nz, 5)``.
        x: Position of the first node in x [m].
        y: Position of the first node in y [m].
        z: Position of the first node in z [m].
        dx: Step in x [m].
        dy: Step in y [m].
        dz: Step in z [m].
        momentum: Mean axial momentum of the bunch [mc].
    """

    values: FloatArray
    x: float
    y: float
    z: float
    dx: float
    dy: float
    dz: float
    momentum: float


class SpaceCharge:
    """A solver for the field of a bunch, which reuses its arrays and Green functions."""

    def __init__(self, shape: tuple[int, int, int]) -> None:
        """Allocate the arrays.

        Args:
            shape: Number of nodes of the mesh, ``(nx, ny, nz)``.
        """
        self.shape = shape
        self._charge = np.zeros(shape, dtype=np.float32)
        self._values = np.zeros((*shape, 5))
        padded = (2 * shape[0], 2 * shape[1], shape[2] + 1)
        self._transformed = np.zeros(padded, dtype=np.complex64)
        self._product = np.zeros_like(self._transformed)
        self._transforms: OrderedDict[tuple[int, int], FloatArray] = OrderedDict()

    def field(
        self, bunch: Bunch, time: float, ahead: float, force: float, image: bool
    ) -> BunchField:
        """Return the field of the bunch at a slightly later time.

        With the field at the middle of the interval in which it is used, the whole tracking is of
        second order in that interval.

        Args:
            bunch: Bunch at ``time``.
            time: Time of the bunch [s].
            ahead: Time from ``time`` to that of the field [s]; until then, the same axial force is
                assumed for all particles.
            force: Axial force [mc/s].
            image: Whether to add the field of the image in the cathode.

        Returns:
            The field at ``time + ahead``; zero if no particle is left. The next call overwrites its
            arrays.
        """
        points, low, high, momentum = predicted(bunch, time, ahead, force)
        if len(points) == 0:
            self._values[:] = 0.0
            return BunchField(self._values, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 0.0)
        gamma = math.sqrt(1.0 + momentum**2)
        beta = momentum / gamma
        dx, dy, dz_rest, ratios = self._cells(low, high, gamma)
        dz = dz_rest / gamma
        nx, ny, nz = self.shape
        x = 0.5 * (low[0] + high[0]) - 0.5 * (nx - 1) * dx
        y = 0.5 * (low[1] + high[1]) - 0.5 * (ny - 1) * dy
        z = 0.5 * (low[2] + high[2]) - 0.5 * (nz - 1) * dz
        # At a multiple of half a cell from the cathode: an integer number of cells from the image.
        offset = round(2.0 * z / dz)
        z = 0.5 * offset * dz
        deposit(points, self._charge, x, y, z, dx, dy, dz)
        _forward(self._charge, self._transformed)
        scale = _COULOMB * bunch.particle_charge / dx
        _times_real(self._transformed, self._transform(ratios), scale, self._product)
        own = _backward(self._product, self.shape)
        if image:
            kernel = image_transform(self.shape, offset, 1.0, dy / dx, dz_rest / dx)
            _times_mirrored(self._transformed, kernel, -scale, self._product)
            mirrored = _backward(self._product, self.shape)
        else:
            mirrored = own[:0]
        _differentiate(own, mirrored, dx, dy, dz_rest, gamma, beta, self._values)
        return BunchField(self._values, x, y, z, dx, dy, dz, momentum)

    def _cells(
        self, low: FloatArray, high: FloatArray, gamma: float
    ) -> tuple[float, float, float, tuple[int, int]]:
        """Return the sides of a cell in the rest frame, and the exponents of the ratios y/x, z/x."""
        # One cell is free on each side, and half a cell is lost to the alignment with the cathode.
        sides = np.maximum(high - low, 1e-9) / (np.array(self.shape) - 3.5)
        sides[2] *= gamma
        step = math.log(SHAPE_STEP)
        ratios = np.rint(np.log(sides[1:] / sides[0]) / step).astype(int)
        shape = np.array([1.0, *(SHAPE_STEP**ratios)])
        dx, dy, dz = shape * (sides / shape).max()
        return float(dx), float(dy), float(dz), (int(ratios[0]), int(ratios[1]))

    def _transform(self, ratios: tuple[int, int]) -> FloatArray:
        """Return the transform of the Green function for cells with dx = 1.

        Args:
            ratios: Exponents of the ratios y/x and z/x of the cell's sides.
        """
        kept = self._transforms.get(ratios)
        if kept is None:
            sides = 1.0, SHAPE_STEP ** ratios[0], SHAPE_STEP ** ratios[1]
            kept = own_transform(self.shape, *sides).astype(np.float32)
            self._transforms[ratios] = kept
            if len(self._transforms) > _KEPT_SHAPES:
                self._transforms.popitem(last=False)
        else:
            self._transforms.move_to_end(ratios)
        return kept


@njit(cache=True)
def _predict(
    phase_space: FloatArray,
    state: NDArray[np.int8],
    emission: FloatArray,
    time: float,
    ahead: float,
    force: float,
    points: FloatArray,
) -> tuple[int, FloatArray, FloatArray, float]:
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    count, momentum = 0, 0.0
    for p in range(len(phase_space)):
        interval = ahead
        if state[p] == WAITING:
            interval = time + ahead - emission[p]
            if interval <= 0.0:
                continue
        elif state[p] != FLYING:
            continue
        gain = force * interval
        mean = phase_space[p, 3], phase_space[p, 4], phase_space[p, 5] + 0.5 * gain
        step = interval * SPEED_OF_LIGHT
        step /= math.sqrt(1.0 + mean[0] ** 2 + mean[1] ** 2 + mean[2] ** 2)
        for q in range(3):
            value = phase_space[p, q] + step * mean[q]
            points[count, q] = value
            low[q] = min(low[q], value)
            high[q] = max(high[q], value)
        momentum += phase_space[p, 5] + gain
        count += 1
    return count, low, high, momentum / max(count, 1)


def predicted(
    bunch: Bunch, time: float, ahead: float, force: float
) -> tuple[FloatArray, FloatArray, FloatArray, float]:
    """Return the positions ``ahead`` seconds later, their bounds and mean axial momentum [mc].

    Args:
        bunch: Bunch at ``time``.
        time: Time of the bunch [s].
        ahead: Time to predict [s].
        force: Axial force on all particles [mc/s].
    """
    points = np.empty((len(bunch.phase_space), 3))
    count, low, high, momentum = _predict(
        bunch.phase_space, bunch.state, bunch.emission, time, ahead, force, points
    )
    return points[:count], low, high, momentum


@njit(cache=True, fastmath=True)
def deposit(
    points: FloatArray,
    charge: FloatArray,
    x: float,
    y: float,
    z: float,
    dx: float,
    dy: float,
    dz: float,
) -> None:
    """Assign particles to the eight nodes around each.

    Args:
        points: Positions of the particles [m], ``(n, 3)``.
        charge: Number of particles at each node, ``(nx, ny, nz)``; overwritten.
        x: Position of the first node in x [m].
        y: Position of the first node in y [m].
        z: Position of the first node in z [m].
        dx: Step in x [m].
        dy: Step in y [m].
        dz: Step in z [m].
    """
    charge[:] = 0.0
    for p in range(len(points)):
        a, b, c = (points[p, 0] - x) / dx, (points[p, 1] - y) / dy, (points[p, 2] - z) / dz
        i, j, k = int(a), int(b), int(c)
        a -= i
        b -= j
        c -= k
        for m in range(2):
            wx = a if m == 1 else 1.0 - a
            for n in range(2):
                w = wx * (b if n == 1 else 1.0 - b)
                charge[i + m, j + n, k] += w * (1.0 - c)
                charge[i + m, j + n, k + 1] += w * c


def _forward(charge: FloatArray, padded: ComplexArray) -> None:
    """Transform a mesh, padded to twice its size, into ``padded``; rows of zeros are skipped."""
    nx, ny, nz = charge.shape
    padded[:nx, ny:] = 0.0
    padded[nx:] = 0.0
    padded[:nx, :ny] = scipy.fft.rfft(charge, 2 * nz, axis=2)
    scipy.fft.fft(padded[:nx], axis=1, overwrite_x=True)
    scipy.fft.fft(padded, axis=0, overwrite_x=True)


def _backward(padded: ComplexArray, shape: tuple[int, int, int]) -> FloatArray:
    """Transform back in place, and return the mesh without its padding."""
    nx, ny, nz = shape
    scipy.fft.ifft(padded, axis=0, overwrite_x=True)
    scipy.fft.ifft(padded[:nx], axis=1, overwrite_x=True)
    potential: FloatArray = scipy.fft.irfft(padded[:nx, :ny], 2 * nz, axis=2)[:, :, :nz]
    return potential


@njit(cache=True, fastmath=True)
def _times_real(
    charge: ComplexArray, kernel: FloatArray, scale: float, product: ComplexArray
) -> None:
    """Multiply by the transform of an even kernel, given in one octant."""
    mx, my, mz = charge.shape
    for i in range(mx):
        ii = min(i, mx - i)
        for j in range(my):
            jj = min(j, my - j)
            for k in range(mz):
                product[i, j, k] = charge[i, j, k] * (scale * kernel[ii, jj, k])


@njit(cache=True, fastmath=True)
def _times_mirrored(
    charge: ComplexArray, kernel: ComplexArray, scale: float, product: ComplexArray
) -> None:
    """Multiply the transform of the charges, mirrored in z, by the kernel of the image."""
    mx, my, mz = charge.shape
    for i in range(mx):
        ii = min(i, mx - i)
        for j in range(my):
            jj = min(j, my - j)
            # The transform of a real mesh at -k_z is the conjugate of that at (-k_x, -k_y, k_z).
            mi, mj = (mx - i) % mx, (my - j) % my
            for k in range(mz):
                mirrored = np.conj(charge[mi, mj, k])
                product[i, j, k] = mirrored * (scale * kernel[ii, jj, k])


@njit(cache=True, fastmath=True)
def _differentiate(
    own: FloatArray,
    image: FloatArray,
    dx: float,
    dy: float,
    dz: float,
    gamma: float,
    beta: float,
    values: FloatArray,
) -> None:
    """Fill ``values`` with E and B in the laboratory from the potentials in the rest frame.

    Args:
        own: Potential of the bunch, ``(nx, ny, nz)``.
        image: Potential of the image, ``(nx, ny, nz)``, or empty.
        dx: Step in x [m].
        dy: Step in y [m].
        dz: Step in z, in the rest frame [m].
        gamma: Lorentz factor of the bunch.
        beta: Velocity of the bunch [c].
        values: Field at the nodes, ``(nx, ny, nz, 5)``; overwritten.
    """
    nx, ny, nz = own.shape
    with_image = image.shape[0] > 0
    across = gamma * beta / SPEED_OF_LIGHT
    for i in range(nx):
        i0, i1 = max(i - 1, 0), min(i + 1, nx - 1)
        wx = 1.0 / ((i1 - i0) * dx)
        for j in range(ny):
            j0, j1 = max(j - 1, 0), min(j + 1, ny - 1)
            wy = 1.0 / ((j1 - j0) * dy)
            for k in range(nz):
                k0, k1 = max(k - 1, 0), min(k + 1, nz - 1)
                wz = 1.0 / ((k1 - k0) * dz)
                ex = (own[i0, j, k] - own[i1, j, k]) * wx
                ey = (own[i, j0, k] - own[i, j1, k]) * wy
                ez = (own[i, j, k0] - own[i, j, k1]) * wz
                ix, iy = 0.0, 0.0
                if with_image:
                    ix = (image[i0, j, k] - image[i1, j, k]) * wx
                    iy = (image[i, j0, k] - image[i, j1, k]) * wy
                    ez += (image[i, j, k0] - image[i, j, k1]) * wz
                values[i, j, k, 0] = gamma * (ex + ix)
                values[i, j, k, 1] = gamma * (ey + iy)
                values[i, j, k, 2] = ez
                values[i, j, k, 3] = -across * (ey - iy)
                values[i, j, k, 4] = across * (ex - ix)

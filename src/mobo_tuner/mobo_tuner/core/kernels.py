"""Covariance functions of the Gaussian processes, each with its equation and its derivatives.

Every kernel here is a variance times a profile of a squared distance,

    k(x, x') = s^2 g(r^2),   r^2 = (x - x')^T Lambda (x - x'),

with the precision matrix Lambda of `[Roussel2021]_` (appendix, eqn:RBF). A kernel class defines its
profile and computes Lambda from its shape parameters; the variance s^2 belongs to the model.
Length-scales are in units of the normalised inputs, in which each variable ranges over [-1, 1].

.. [Roussel2021] R. Roussel, A. Hanuka, A. Edelen, "Multiobjective Bayesian optimization for online
   accelerator tuning", Phys. Rev. Accel. Beams 24, 062801 (2021), Appendix (sec:regression).
.. [Hanuka2021] A. Hanuka et al., "Physics model-informed Gaussian process for online optimization
   of particle accelerators", Phys. Rev. Accel. Beams 24, 072802 (2021).
.. [Hvarfner2024] C. Hvarfner, E. O. Hellsten, L. Nardi, "Vanilla Bayesian optimization performs
   great in high dimensions", ICML 2024.
.. [Rasmussen2006] C. E. Rasmussen, C. K. I. Williams, "Gaussian Processes for Machine Learning",
   MIT Press (2006).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mobo_tuner.core.arrays import FloatArray
from mobo_tuner.core.registry import Registry

SHORTEST_LENGTH_SCALE = 0.05
LONGEST_LENGTH_SCALE = 100.0
_LARGEST_TRIANGLE_ENTRY = 20.0
_LENGTH_SCALE_SPREAD = 0.5  # scale of the prior of the logarithm
_FREEDOM = 3.0
_LARGEST_MIXING = 0.8  # two length-scales that differ by (1 + 0.8) / (1 - 0.8) = 9
_MIXING_SPREAD = 0.2  # scale of the prior of an entry of S


class ShapePrior(NamedTuple):
    """Independent priors of shape parameters, each a Student's t with 3 degrees of freedom.

    A parameter stays near its location unless the observations clearly contradict it, which the
    heavy tail allows. Of many length-scales, those of the few variables that matter less, or not at
    all, grow, and the others stay similar. (With a wide normal prior, models of a few observations in
    many variables confidently consider most variables irrelevant, different ones each time.)

    Attributes:
        location: Location of each parameter's prior `(k,)`.
        scale: Scale of each parameter's prior `(k,)`.
    """

    location: FloatArray
    scale: FloatArray

    def penalty(self, parameters: FloatArray) -> tuple[float, FloatArray]:
        """Return minus the log density, up to a constant, and its gradient `(k,)`."""
        deviation = (parameters - self.location) / self.scale
        excess = _FREEDOM + deviation * deviation
        power = 0.5 * (_FREEDOM + 1.0)
        value = power * float(np.log(excess / _FREEDOM).sum())
        return value, 2.0 * power * deviation / (excess * self.scale)


def typical_log_length_scale(d: int) -> float:
    """Return the centre of the prior of a log length-scale: log sqrt(d).

    The distance between two random points grows as the square root of d, `[Hvarfner2024]_`
    section 4.
    """
    return float(0.5 * np.log(d))


class Kernel(ABC):
    """Shape of a covariance function of d inputs, defined by a vector of k shape parameters.

    `parameters` is always that vector `(k,)`: logarithms of positive quantities, and the entries of
    the triangle of the full precision matrix without a transformation.
    """

    def __init__(self, d: int) -> None:
        self.d = d

    @property
    @abstractmethod
    def size(self) -> int:
        """Number k of shape parameters."""

    @abstractmethod
    def profile(self, squared_distance: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the profile `g(r^2)` and slope `w = -2 dg/d(r^2) >= 0`, in the argument's shape."""

    @abstractmethod
    def factor(self, parameters: FloatArray) -> FloatArray:
        """Return F `(d, d)` with `Lambda = F F^T`: distances are Euclidean between rows of `x F`."""

    @abstractmethod
    def pull_back(self, parameters: FloatArray, precision_gradient: FloatArray) -> FloatArray:
        """Return the gradient `(k,)` in the parameters for a gradient `(d, d)` in Lambda."""

    @property
    def optional(self) -> NDArray[np.bool_]:
        """Which parameters `(k,)` keep their default until the observations clearly contradict it."""
        return np.zeros(self.size, dtype=np.bool_)

    @abstractmethod
    def default_parameters(self) -> FloatArray:
        """Return the default start of a training `(k,)`."""

    @abstractmethod
    def bounds(self) -> FloatArray:
        """Return the lowest and highest allowed parameters `(k, 2)`."""

    @abstractmethod
    def prior(self) -> ShapePrior:
        """Return a weakly informative prior of the parameters."""

    def from_length_scales(self, length_scales: FloatArray) -> FloatArray:
        """Return the parameters `(k,)` of given length-scales, `(1,)` for all inputs or `(d,)`.

        Raises:
            ValueError: If the kernel has no such parameters.
        """
        raise ValueError(f"length_scales cannot be held, got {length_scales}")

    def from_precision(self, precision: FloatArray) -> FloatArray:
        """Return the parameters `(k,)` of a given positive definite Lambda `(d, d)`.

        Raises:
            ValueError: If the kernel has no such parameters.
        """
        raise ValueError(f"precision needs kernel 'rbf_full', got {precision.tolist()}")

    def gradient(self, parameters: FloatArray, x: FloatArray, weights: FloatArray) -> FloatArray:
        """Return the gradient `(k,)` of `sum_ij C_ij g(r_ij^2)` in the parameters, O(n^2 d).

        Args:
            parameters: Shape parameters `(k,)`.
            x: Inputs `(n, d)`.
            weights: Products `w_ij C_ij` `(n, n)` of the slope and the symmetric C, with a zero
                diagonal (which has no influence except rounding errors); either the whole matrix or,
                with zeros above the diagonal, twice its lower triangle.
        """
        row_sums = weights.sum(axis=1) + weights.sum(axis=0)
        moment = x.T @ (weights @ x)
        # sum_ij W_ij (x_i - x_j)(x_i - x_j)^T, with d g / d Lambda = -w / 2 times that product.
        scatter = (x.T * row_sums) @ x - moment - moment.T
        return self.pull_back(parameters, -0.5 * scatter)


KERNELS = Registry[Kernel]("kernel", "mobo_tuner.kernels", Kernel)


def as_inputs(x: ArrayLike, d: int | None = None) -> FloatArray:
    """Return normalised inputs as an array `(n, d)`.

    Raises:
        ValueError: If a value is not finite or the shape is wrong.
    """
    inputs = np.asarray(x, dtype=np.float64)
    if inputs.ndim != 2 or inputs.shape[1] == 0 or (d is not None and inputs.shape[1] != d):
        raise ValueError(f"x must have shape (n, {d or 'd >= 1'}), got {inputs.shape}")
    if not np.isfinite(inputs).all():
        raise ValueError("x must be finite, got NaN or infinity")
    return inputs


def squared_distances(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return squared Euclidean distances `(m, n)` >= 0 between rows of a `(m, d)` and b `(n, d)`."""
    products = b @ a.T if a is b else a @ b.T
    products *= -2.0
    products += np.einsum("ij,ij->i", a, a)[:, None]
    products += np.einsum("ij,ij->i", b, b)
    return np.maximum(products, 0.0, out=products)


@KERNELS.register("rbf")
class RBF(Kernel):
    """Anisotropic radial basis function, `[Roussel2021]_` (eqn:RBF) with `Lambda = diag(l)^-2`.

        k(x, x') = s^2 exp(-r^2 / 2),   r^2 = sum_a (x_a - x'_a)^2 / l_a^2

    Parameters: `log l`, `(d,)`.
    """

    @property
    def size(self) -> int:
        """Number of length-scales: one per input."""
        return self.d

    def profile(self, squared_distance: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return `g = w = exp(-r^2 / 2)`."""
        value = np.exp(-0.5 * squared_distance)
        return value, value

    def factor(self, parameters: FloatArray) -> FloatArray:
        """Return `diag(1 / l)`."""
        return np.diag(np.exp(-parameters))

    def pull_back(self, parameters: FloatArray, precision_gradient: FloatArray) -> FloatArray:
        """Return the gradient, with `d Lambda_aa / d log l_a = -2 / l_a^2`."""
        return np.asarray(-2.0 * np.exp(-2.0 * parameters) * np.diagonal(precision_gradient))

    def default_parameters(self) -> FloatArray:
        """Return length-scales of sqrt(d), see `typical_log_length_scale`."""
        return np.full(self.size, typical_log_length_scale(self.d))

    def bounds(self) -> FloatArray:
        """Return length-scales from 0.05 to 100."""
        return np.tile(np.log([SHORTEST_LENGTH_SCALE, LONGEST_LENGTH_SCALE]), (self.size, 1))

    def prior(self) -> ShapePrior:
        """Return a prior around `typical_log_length_scale`."""
        return ShapePrior(self.default_parameters(), np.full(self.size, _LENGTH_SCALE_SPREAD))

    def from_length_scales(self, length_scales: FloatArray) -> FloatArray:
        """Return the logarithms of the length-scales."""
        if len(length_scales) not in (1, self.size):
            allowed = "one number" if self.size == 1 else f"one number or {self.size}"
            raise ValueError(
                f"length_scales must be {allowed} for {self.d} inputs, got {len(length_scales)}"
            )
        return np.broadcast_to(np.log(length_scales), (self.size,))


@KERNELS.register("rbf_isotropic")
class RBFIsotropic(RBF):
    """Isotropic radial basis function, `[Roussel2021]_` (eqn:RBF) with `Lambda = I / lambda^2`.

        k(x, x') = s^2 exp(-|x - x'|^2 / (2 lambda^2))

    Parameters: `log lambda`, `(1,)`.
    """

    @property
    def size(self) -> int:
        """Number of length-scales: one."""
        return 1

    def factor(self, parameters: FloatArray) -> FloatArray:
        """Return `I / lambda`."""
        return np.asarray(np.eye(self.d) * np.exp(-parameters[0]))

    def pull_back(self, parameters: FloatArray, precision_gradient: FloatArray) -> FloatArray:
        """Return the gradient, with `d Lambda / d log lambda = -2 I / lambda^2`."""
        return np.asarray(-2.0 * np.exp(-2.0 * parameters) * np.trace(precision_gradient))


@KERNELS.register("matern52")
class Matern52(RBF):
    """Anisotropic Matern function of smoothness 5/2, `[Rasmussen2006]_` Eq. (4.17).

        k(x, x') = s^2 (1 + sqrt(5) r + 5 r^2 / 3) exp(-sqrt(5) r)
        r^2 = sum_a (x_a - x'_a)^2 / l_a^2

    It is only twice differentiable, so that one kink or steep flank does not affect the whole model.
    Parameters: `log l`, `(d,)`.
    """

    def profile(self, squared_distance: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return `g` as above and `w = 5/3 (1 + sqrt(5) r) exp(-sqrt(5) r)`."""
        root = np.sqrt(5.0 * squared_distance)
        slope = np.exp(-root)
        curvature = slope * squared_distance
        root += 1.0
        slope *= root
        value = slope + (5.0 / 3.0) * curvature
        slope *= 5.0 / 3.0
        return value, slope


@KERNELS.register("matern52_full")
class Matern52Full(Matern52):
    """Matern function of smoothness 5/2 whose precision matrix is full where observations clearly say so.

        k(x, x') = s^2 g(r^2) as for `Matern52`,   Lambda = F F^T,   F = diag(1 / l) (I + S)

    with S symmetric and zero on its diagonal. Where two variables act together, as two solenoids that focus
    the same beam, the function is steep along one diagonal of their plane and flat along the other; S = 0
    is `Matern52`. Parameters: `log l`, then the entries of S right of its diagonal row by row, which are
    optional; `(d (d + 1) / 2,)`.
    """

    def __init__(self, d: int) -> None:
        super().__init__(d)
        self._rows, self._columns = np.triu_indices(d, 1)

    @property
    def size(self) -> int:
        """Number of parameters: d length-scales and d (d - 1) / 2 entries of S."""
        return self.d + len(self._rows)

    @property
    def optional(self) -> NDArray[np.bool_]:
        """The entries of S."""
        return np.arange(self.size) >= self.d

    def factor(self, parameters: FloatArray) -> FloatArray:
        """Return `diag(1 / l) (I + S)`."""
        mixing = np.eye(self.d)
        mixing[self._rows, self._columns] = mixing[self._columns, self._rows] = parameters[self.d :]
        return np.asarray(np.exp(-parameters[: self.d])[:, None] * mixing)

    def pull_back(self, parameters: FloatArray, precision_gradient: FloatArray) -> FloatArray:
        """Return the gradient, with that in F, `D = 2 G F`, as `-sum_b F_ab D_ab` and `D_ab / l_a + D_ba / l_b`."""
        factor = self.factor(parameters)
        by_factor = 2.0 * precision_gradient @ factor
        by_mixing = np.exp(-parameters[: self.d])[:, None] * by_factor
        both = (by_mixing + by_mixing.T)[self._rows, self._columns]
        return np.concatenate([-(factor * by_factor).sum(axis=1), both])

    def default_parameters(self) -> FloatArray:
        """Return length-scales of sqrt(d), and S = 0."""
        scales = np.full(self.d, typical_log_length_scale(self.d))
        return np.concatenate([scales, np.zeros(len(self._rows))])

    def bounds(self) -> FloatArray:
        """Return length-scales from 0.05 to 100, and entries of S of at most 0.8.

        At 1 the function would be constant along a diagonal, which a few observations seem to say too often.
        """
        scales = np.tile(np.log([SHORTEST_LENGTH_SCALE, LONGEST_LENGTH_SCALE]), (self.d, 1))
        return np.vstack(
            [scales, np.tile([-_LARGEST_MIXING, _LARGEST_MIXING], (len(self._rows), 1))]
        )

    def prior(self) -> ShapePrior:
        """Return a prior around `typical_log_length_scale`, and a narrow one around S = 0."""
        spread = np.where(self.optional, _MIXING_SPREAD, _LENGTH_SCALE_SPREAD)
        return ShapePrior(self.default_parameters(), spread)

    def from_length_scales(self, length_scales: FloatArray) -> FloatArray:
        """Return the logarithms of the length-scales and S = 0."""
        scales = Matern52(self.d).from_length_scales(length_scales)
        return np.concatenate([scales, np.zeros(len(self._rows))])


@KERNELS.register("rbf_full")
class RBFFull(Kernel):
    """Radial basis function with a full precision matrix, `[Roussel2021]_` (sec:regression).

        k(x, x') = s^2 exp(-(x - x')^T Lambda (x - x') / 2),   Lambda = L L^T + diag(l)

    with L an upper triangle including its diagonal, and l positive. Parameters: the d (d + 1) / 2
    entries of L row by row, then `log l`; `(d (d + 3) / 2,)`. (The gradients in L vanish at L = 0, so
    a training starts elsewhere.)
    """

    def __init__(self, d: int) -> None:
        super().__init__(d)
        self._rows, self._columns = np.triu_indices(d)

    @property
    def size(self) -> int:
        """Number of parameters: d (d + 1) / 2 for the triangle and d for the diagonal."""
        return len(self._rows) + self.d

    def _triangle(self, parameters: FloatArray) -> FloatArray:
        triangle = np.zeros((self.d, self.d))
        triangle[self._rows, self._columns] = parameters[: len(self._rows)]
        return triangle

    def precision(self, parameters: FloatArray) -> FloatArray:
        """Return the precision matrix Lambda `(d, d)`."""
        triangle = self._triangle(parameters)
        diagonal = np.diag(np.exp(parameters[len(self._rows) :]))
        return np.asarray(triangle @ triangle.T + diagonal)

    def from_length_scales(self, length_scales: FloatArray) -> FloatArray:
        """Return the parameters of the diagonal Lambda."""
        if len(length_scales) not in (1, self.d):
            raise ValueError(
                f"length_scales must be one number or {self.d} for {self.d} inputs, "
                f"got {len(length_scales)}"
            )
        return self.from_precision(np.eye(self.d) / length_scales**2)

    def from_precision(self, precision: FloatArray) -> FloatArray:
        """Return the parameters of any positive definite Lambda.

        Half of the lowest eigenvalue gives the diagonal l, and the rest gives the triangle.
        """
        floor = 0.5 * float(np.linalg.eigvalsh(precision)[0])
        rest = precision - floor * np.eye(self.d)
        # With rows and columns reversed the lower factor is the upper triangle with L L^T = rest.
        triangle = np.linalg.cholesky(rest[::-1, ::-1])[::-1, ::-1]
        return np.concatenate([triangle[self._rows, self._columns], np.full(self.d, np.log(floor))])

    def profile(self, squared_distance: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return `g = w = exp(-r^2 / 2)`."""
        value = np.exp(-0.5 * squared_distance)
        return value, value

    def factor(self, parameters: FloatArray) -> FloatArray:
        """Return the lower Cholesky factor of Lambda."""
        return np.asarray(np.linalg.cholesky(self.precision(parameters)), dtype=np.float64)

    def pull_back(self, parameters: FloatArray, precision_gradient: FloatArray) -> FloatArray:
        """Return `2 G L` for the triangle and `G_aa l_a` for `log l_a`; G is the gradient in Lambda."""
        triangle = 2.0 * precision_gradient @ self._triangle(parameters)
        diagonal = np.diagonal(precision_gradient) * np.exp(parameters[len(self._rows) :])
        return np.concatenate([triangle[self._rows, self._columns], diagonal])

    def default_parameters(self) -> FloatArray:
        """Return length-scales of sqrt(d), half of the precision from either part, no correlation."""
        half = 0.5 * np.exp(-2.0 * typical_log_length_scale(self.d))
        triangle = np.where(self._rows == self._columns, np.sqrt(half), 0.0)
        return np.concatenate([triangle, np.full(self.d, np.log(half))])

    def bounds(self) -> FloatArray:
        """Return bounds of the diagonal for length-scales from 0.05 to 100, and of 20 for L."""
        triangle = np.tile(
            [-_LARGEST_TRIANGLE_ENTRY, _LARGEST_TRIANGLE_ENTRY], (len(self._rows), 1)
        )
        limits = -2.0 * np.log([LONGEST_LENGTH_SCALE, SHORTEST_LENGTH_SCALE])
        return np.concatenate([triangle, np.tile(limits, (self.d, 1))])

    def prior(self) -> ShapePrior:
        """Return a prior around zero for L, and as for inverse squared length-scales for l."""
        m = len(self._rows)
        return ShapePrior(
            np.concatenate([np.zeros(m), np.full(self.d, -2.0 * typical_log_length_scale(self.d))]),
            np.concatenate([np.ones(m), np.full(self.d, 2.0 * _LENGTH_SCALE_SPREAD)]),
        )


def precision_from_hessian(hessian: ArrayLike, amplitude: float) -> FloatArray:
    """Return the precision matrix `(d, d)` from the Hessian of the modelled function at an optimum.

    Near an optimum with height A above (or depth below) its surroundings, `A exp(-x^T Lambda x / 2)`
    has the Hessian `-A Lambda`; hence `Lambda = |H| / A`, `[Hanuka2021]_`, last sentence of
    `[Roussel2021]_` (sec:regression). The absolute values of the eigenvalues are limited to the
    allowed length-scales (0.05 to 100), so that a saddle, a flat direction or a noisy estimate also
    gives a valid matrix.

    Args:
        hessian: Symmetric matrix `(d, d)` of second derivatives in normalised inputs, in the
            output's units.
        amplitude: Height A > 0 in the output's units, such as the process' standard deviation.

    Returns:
        A symmetric positive definite matrix `(d, d)`; `1 / sqrt(diagonal)` are length-scales for an
        anisotropic kernel.

    Raises:
        ValueError: If the Hessian is not square, symmetric and finite, or the amplitude is not
            positive.
    """
    matrix = np.asarray(hessian, dtype=np.float64)
    if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1] or not np.isfinite(matrix).all():
        raise ValueError(f"hessian must be a finite square matrix, got shape {matrix.shape}")
    if not np.allclose(
        matrix, matrix.T, rtol=1e-6, atol=1e-9 * float(np.abs(matrix).max(initial=0.0))
    ):
        raise ValueError("hessian must be symmetric")
    if not (np.isfinite(amplitude) and amplitude > 0.0):
        raise ValueError(f"amplitude must be positive and finite, got {amplitude}")
    values, vectors = np.linalg.eigh(0.5 * (matrix + matrix.T))
    curvatures = np.clip(
        np.abs(values) / amplitude, LONGEST_LENGTH_SCALE**-2, SHORTEST_LENGTH_SCALE**-2
    )
    precision = (vectors * curvatures) @ vectors.T
    return np.asarray(0.5 * (precision + precision.T))

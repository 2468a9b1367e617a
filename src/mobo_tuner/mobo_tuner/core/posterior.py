"""A Gaussian process with mean zero and given hyperparameters, conditioned on observations."""

from __future__ import annotations

from collections.abc import Iterator
from copy import copy
from typing import NamedTuple, Self

import numpy as np
from scipy.linalg import blas

from mobo_tuner.core.arrays import FloatArray
from mobo_tuner.core.kernels import Kernel, squared_distances
from mobo_tuner.core.linear_algebra import cholesky, inverse_triangle

RELATIVE_JITTER = 1e-10
"""Fraction of the signal variance added to the diagonal of every covariance before factorisation."""

_LEAST_VARIANCE = 1e-12
# Variance of a known value, as a share of the signal variance: set-points may be close.
_KNOWN = 1e-6
_BLOCK = 128


class Gradients(NamedTuple):
    """Gradients in x of the posterior's mean and standard deviation, `(m, d)` each."""

    mean: FloatArray
    stddev: FloatArray


class TriangularPosterior:
    """A posterior whose mean is `k(x)^T w` and whose variance is `s^2 - |T k(x)|^2`.

    Attributes:
        kernel: Covariance function of d inputs.
        variance: Signal variance s^2.
        factor: Matrix from inputs to scaled inputs `(d, d)`, see `Kernel.factor`.
        scaled: Scaled inputs of the n observations `(n, d)`.
        inverse: Lower triangle T `(n, n)`, in Fortran order.
        weights: Weights w `(n,)`.
    """

    kernel: Kernel
    variance: float
    factor: FloatArray
    scaled: FloatArray
    inverse: FloatArray
    weights: FloatArray

    def predict(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return mean and standard deviation `(m,)` of the function at x `(m, d)`; O(m n^2)."""
        mean, stddev = np.empty(len(x)), np.empty(len(x))
        for rows in _blocks(len(x)):
            scaled = x[rows] @ self.factor
            profile, _ = self.kernel.profile(squared_distances(scaled, self.scaled))
            mean[rows], stddev[rows], _ = self._moments(profile)
        return mean, stddev

    def predict_with_gradient(self, x: FloatArray) -> tuple[FloatArray, FloatArray, Gradients]:
        """Return the results of `predict` and their gradients in x, in about twice the time."""
        mean, stddev = np.empty(len(x)), np.empty(len(x))
        gradients = Gradients(np.empty_like(x), np.empty_like(x))
        for rows in _blocks(len(x)):
            scaled = x[rows] @ self.factor
            profile, slope = self.kernel.profile(squared_distances(scaled, self.scaled))
            mean[rows], stddev[rows], projected = self._moments(profile)
            # Gradient of k(x, x_i) in the scaled input: s^2 w (scaled_i - scaled).
            slope = self.variance * slope
            pull = slope * self.weights
            pull = pull @ self.scaled - pull.sum(axis=1)[:, None] * scaled
            gradients.mean[rows] = pull @ self.factor.T
            slope *= _times_triangle(self.inverse, projected, transposed=True).T
            pull = slope.sum(axis=1)[:, None] * scaled - slope @ self.scaled
            # At the lowest standard deviation, its gradient is zero.
            varies = stddev[rows] > self._least_stddev
            pull /= np.where(varies, stddev[rows], np.inf)[:, None]
            gradients.stddev[rows] = pull @ self.factor.T
        return mean, stddev, gradients

    @property
    def _least_stddev(self) -> float:
        return float(np.sqrt(_LEAST_VARIANCE * self.variance))

    def _moments(self, profile: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return mean, standard deviation `(m,)` and `L^-1 k` `(n, m)`, from the profile `(m, n)`."""
        covariance = self.variance * profile
        projected = _times_triangle(self.inverse, covariance.T)
        unexplained = self.variance - np.einsum("ij,ij->j", projected, projected)
        stddev = np.maximum(np.sqrt(np.maximum(unexplained, 0.0)), self._least_stddev)
        return covariance @ self.weights, stddev, projected


class Posterior(TriangularPosterior):
    """The process given n observations, `[Roussel2021]_` Appendix (sec:regression).

        mu(x)      = k(x)^T K^-1 z
        sigma(x)^2 = k(x, x) - k(x)^T K^-1 k(x)
        K_ij       = s^2 (g(r_ij^2) + 1e-10 delta_ij) + noise_i delta_ij

    It stores the inverse of the Cholesky factor of K, so that predictions are products with a
    triangle. O(n^3) to build, O(n^2) for each further observation.

    Args:
        kernel: Covariance function of d inputs.
        shape: Shape parameters of the kernel `(k,)`.
        variance: Signal variance s^2.
        x: Inputs `(n, d)`.
        z: Observations `(n,)`.
        noise: Noise variances of the observations `(n,)`.
    """

    def __init__(
        self,
        kernel: Kernel,
        shape: FloatArray,
        variance: float,
        x: FloatArray,
        z: FloatArray,
        noise: FloatArray,
    ) -> None:
        self.kernel, self.shape, self.variance = kernel, shape, variance
        self.factor = kernel.factor(shape)
        self._condition(x, z, noise)

    def _condition(self, x: FloatArray, z: FloatArray, noise: FloatArray) -> None:
        self.x, self.z, self.noise = x, z, noise
        self.scaled = x @ self.factor
        covariance = (
            self.variance * self.kernel.profile(squared_distances(self.scaled, self.scaled))[0]
        )
        covariance.flat[:: len(z) + 1] = self.variance * (1.0 + RELATIVE_JITTER) + noise
        lower, self.jitter = cholesky(covariance)
        self.inverse = inverse_triangle(lower)
        self.weights = self._solve(z)
        self.factorised = len(z)

    def _solve(self, z: FloatArray) -> FloatArray:
        half = blas.dtrmv(self.inverse, z, lower=1)
        return np.asarray(blas.dtrmv(self.inverse, half, lower=1, trans=1))

    def add(self, x: FloatArray, z: FloatArray, noise: FloatArray) -> None:
        """Add one observation.

        It adds a last row to the factor, O(n^2), or factorises again, O(n^3), in the rare case that
        rounding errors dominate that row. `factorised` is the number of observations at the last
        factorisation. Many are added faster by `add_all`.

        Args:
            x: Input `(1, d)`.
            z: Observation `(1,)`.
            noise: Noise variance `(1,)`.
        """
        n = len(self.z)
        inputs = np.vstack([self.x, x])
        values, variances = np.append(self.z, z), np.append(self.noise, noise)
        scaled = x @ self.factor
        row = self.variance * self.kernel.profile(squared_distances(scaled, self.scaled))[0][0]
        projected = blas.dtrmv(self.inverse, row, lower=1)
        least = self.variance * RELATIVE_JITTER + self.jitter + float(noise[0])
        square = self.variance + least - float(projected @ projected)
        if square < 0.5 * least:
            self._condition(inputs, values, variances)
            return
        pivot = np.sqrt(square)
        inverse = np.zeros((n + 1, n + 1), order="F")
        inverse[:n, :n] = self.inverse
        inverse[n, :n] = blas.dtrmv(self.inverse, projected, lower=1, trans=1) / -pivot
        inverse[n, n] = 1.0 / pivot
        self.x, self.z, self.noise = inputs, values, variances
        self.scaled = np.vstack([self.scaled, scaled])
        self.inverse = inverse
        self.weights = self._solve(values)

    def add_all(self, x: FloatArray, z: FloatArray, noise: FloatArray) -> None:
        """Add m observations at once, O(m n^2 + m^2 n + m^3), with the results of `add`, to rounding.

        Args:
            x: Inputs `(m, d)`.
            z: Observations `(m,)`.
            noise: Noise variances `(m,)`.
        """
        n, m = len(self.z), len(z)
        inputs = np.vstack([self.x, x])
        values, variances = np.append(self.z, z), np.append(self.noise, noise)
        scaled = x @ self.factor
        cross, _ = self.kernel.profile(squared_distances(scaled, self.scaled))
        projected = _times_triangle(self.inverse, self.variance * cross.T)
        covariance = self.variance * self.kernel.profile(squared_distances(scaled, scaled))[0]
        least = self.variance * RELATIVE_JITTER + self.jitter + noise
        covariance.flat[:: m + 1] = self.variance + least
        lower, jitter = cholesky(covariance - projected.T @ projected)
        if jitter or (np.square(np.diagonal(lower)) < 0.5 * least).any():
            self._condition(inputs, values, variances)
            return
        corner = inverse_triangle(lower)
        inverse = np.zeros((n + m, n + m), order="F")
        inverse[:n, :n] = self.inverse
        inverse[n:, :n] = -corner @ _times_triangle(self.inverse, projected, transposed=True).T
        inverse[n:, n:] = corner
        self.x, self.z, self.noise = inputs, values, variances
        self.scaled = np.vstack([self.scaled, scaled])
        self.inverse = inverse
        self.weights = self._solve(values)

    def joint(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the means `(m,)` at x `(m, d)` and a root `(m, m)` of their covariance matrix."""
        scaled = x @ self.factor
        profile, _ = self.kernel.profile(squared_distances(scaled, self.scaled))
        mean, _, projected = self._moments(profile)
        prior, _ = self.kernel.profile(squared_distances(scaled, scaled))
        covariance = self.variance * prior - projected.T @ projected
        covariance.flat[:: len(x) + 1] += self.variance * RELATIVE_JITTER
        lower, _ = cholesky(covariance)
        return mean, lower

    def drawn(self, normals: FloatArray) -> list[Self]:
        """Return what the posterior would be if the function were known at the observations, O(n^3).

        There is one for each draw of the function there. They share the variance, which is zero at the
        observations, to rounding.

        Args:
            normals: Independent standard normal numbers `(s, n)`.
        """
        mean, root = self.joint(self.x)
        values = mean + normals @ root.T
        known = copy(self)
        known._condition(self.x, values[0], np.full(len(self.z), _KNOWN * self.variance))
        posteriors = []
        for z in values:
            posterior = copy(known)
            posterior.z, posterior.weights = z, known._solve(z)
            posteriors.append(posterior)
        return posteriors

    def leave_one_out(self) -> tuple[FloatArray, FloatArray]:
        """Return the excess of each observation over its prediction from all others, and its variance.

        Both `(n,)`, `[Rasmussen2006]_` Eq. (5.12); the variance includes the noise; O(n^2).
        """
        precision = np.einsum("ij,ij->j", self.inverse, self.inverse)
        return self.weights / precision, 1.0 / precision

    @property
    def leave_one_out_log_density(self) -> FloatArray:
        """Log density of each observation under its prediction from all others `(n,)`; O(n^2)."""
        excess, variance = self.leave_one_out()
        return np.asarray(-0.5 * (np.log(2.0 * np.pi * variance) + excess * excess / variance))

    @property
    def log_marginal_likelihood(self) -> float:
        """Log density of the observations, `[Rasmussen2006]_` Eq. (5.8); O(n)."""
        log_det = -2.0 * float(np.log(np.diagonal(self.inverse)).sum())
        return -0.5 * (
            float(self.z @ self.weights) + log_det + len(self.z) * float(np.log(2.0 * np.pi))
        )


def _blocks(m: int) -> Iterator[slice]:
    """Yield blocks of rows whose covariances fit into the processor's cache."""
    for start in range(0, m, _BLOCK):
        yield slice(start, min(start + _BLOCK, m))


def _times_triangle(
    inverse: FloatArray, columns: FloatArray, transposed: bool = False
) -> FloatArray:
    """Return a lower triangle `(n, n)` or its transpose, times columns `(n, m)` in Fortran order."""
    if columns.shape[1] == 1:
        product = blas.dtrmv(inverse, columns[:, 0], lower=1, trans=int(transposed))
        return np.asarray(product)[:, None]
    return np.asarray(blas.dtrmm(1.0, inverse, columns, lower=1, trans_a=int(transposed)))

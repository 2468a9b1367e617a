"""The kernel of models with inputs that nobody sets, see `context`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mobo_tuner.core.arrays import FloatArray
from mobo_tuner.core.kernels import SHORTEST_LENGTH_SCALE, Kernel, ShapePrior

LONGEST_CONTEXT_SCALE = 1e4
_CONTEXT_SCALE_SPREAD = 1.0  # scale of the prior of the logarithm


class Contextual(Kernel):
    """Another kernel with further inputs, the last ones, which nobody sets: measured contexts and time.

        k((x, c), (x', c')) = s^2 g(r^2 + sum_a (c_a - c'_a)^2 / l_a^2)

    Parameters: those of the other kernel, then `log l`, one for each of these inputs.

    Args:
        settable: Kernel of the other inputs.
        contexts: Number of inputs that nobody sets.
    """

    def __init__(self, settable: Kernel, contexts: int) -> None:
        super().__init__(settable.d + contexts)
        self.settable = settable
        self.contexts = contexts

    @property
    def size(self) -> int:
        """Number of parameters: those of the other kernel and one for each context."""
        return self.settable.size + self.contexts

    def without_last(self) -> Kernel:
        """Return the kernel of all inputs but the last one."""
        others = self.contexts - 1
        return Contextual(self.settable, others) if others else self.settable

    @property
    def optional(self) -> NDArray[np.bool_]:
        """Those of the other kernel."""
        return np.append(self.settable.optional, np.zeros(self.contexts, dtype=np.bool_))

    def profile(self, squared_distance: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the profile and the slope of the other kernel."""
        return self.settable.profile(squared_distance)

    def factor(self, parameters: FloatArray) -> FloatArray:
        """Return the other kernel's factor and `1 / l` on the rest of the diagonal."""
        settable, scales = np.split(parameters, [self.settable.size])
        d = self.settable.d
        factor = np.zeros((self.d, self.d))
        factor[:d, :d] = self.settable.factor(settable)
        factor[d:, d:] = np.diag(np.exp(-scales))
        return factor

    def pull_back(self, parameters: FloatArray, precision_gradient: FloatArray) -> FloatArray:
        """Return the other kernel's gradient and, for the contexts, that of an anisotropic kernel."""
        settable, scales = np.split(parameters, [self.settable.size])
        d = self.settable.d
        others = self.settable.pull_back(settable, precision_gradient[:d, :d])
        by_scales = -2.0 * np.exp(-2.0 * scales) * np.diagonal(precision_gradient)[d:]
        return np.concatenate([others, by_scales])

    def default_parameters(self) -> FloatArray:
        """Return the other kernel's default and scales of one unit."""
        return np.concatenate([self.settable.default_parameters(), np.zeros(self.contexts)])

    def bounds(self) -> FloatArray:
        """Return the other kernel's bounds and scales from 0.05 to 10000 units."""
        scales = np.log([SHORTEST_LENGTH_SCALE, LONGEST_CONTEXT_SCALE])
        return np.vstack([self.settable.bounds(), np.tile(scales, (self.contexts, 1))])

    def prior(self) -> ShapePrior:
        """Return the other kernel's prior and one around scales of one unit."""
        prior = self.settable.prior()
        return ShapePrior(
            np.concatenate([prior.location, np.zeros(self.contexts)]),
            np.concatenate([prior.scale, np.full(self.contexts, _CONTEXT_SCALE_SPREAD)]),
        )

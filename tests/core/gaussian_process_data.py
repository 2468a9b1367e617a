"""Data that the tests of the Gaussian process share."""

import numpy as np
from hypothesis import settings

from mobo_tuner.core.kernels import KERNELS as KERNEL_REGISTRY

KERNELS = tuple(KERNEL_REGISTRY)
quick = settings(max_examples=30, deadline=None, derandomize=True)


def smooth(x):
    return 40.0 + 7.0 * np.sin(2.0 * x[:, 0]) + 3.0 * x[:, 1] ** 2


def sample(n=15, d=3, seed=0, noise=0.0):
    rng = np.random.default_rng(seed)
    x = rng.uniform(-1, 1, (n, d))
    return x, smooth(x) + noise * rng.normal(size=n), rng.uniform(-1, 1, (7, d))

"""Log evidence of noise in the observations of one output."""

from __future__ import annotations

import numpy as np
import pytest

from mobo_tuner.core.gaussian_process import GaussianProcess


@pytest.mark.parametrize(("noise", "kink"), [(0.0, False), (0.0, True), (0.05, False), (0.1, True)])
def test_noise_is_told_from_kinks_by_the_evidence(noise: float, kink: bool) -> None:
    rng = np.random.default_rng(4)
    x = rng.uniform(-1.0, 1.0, (40, 2))
    y = np.hypot(x[:, 0] - 0.3, x[:, 1]) if kink else np.sin(2.0 * x[:, 0]) + x[:, 1]
    model = GaussianProcess().fit(x, y + noise * rng.standard_normal(40))
    assert (model.noise_evidence().log > 8.0) == (noise > 0.0)

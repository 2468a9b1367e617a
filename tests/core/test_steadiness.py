"""Whether a machine is noisy, by the evidence of all outputs together."""

from __future__ import annotations

import math

import numpy as np

from mobo_tuner.core.gaussian_process import GaussianProcess
from mobo_tuner.core.steadiness import Steadiness


def test_a_little_noise_in_several_outputs_is_noise_and_in_one_may_be_a_kink() -> None:
    rng = np.random.default_rng(4)
    x = rng.uniform(-1.0, 1.0, (24, 3))
    outputs = np.stack(
        [np.sin(x[:, 0]) + x[:, 1] ** 2, np.cos(x[:, 1]) + x[:, 2], x[:, 0] * x[:, 2]], axis=1
    )
    noise = 0.05 * rng.standard_normal((24, 3))

    def is_noisy(readings: np.ndarray) -> bool:
        processes = [GaussianProcess().fit(x, y) for y in readings.T]
        return Steadiness("learned", "none").with_noise_of(processes, math.inf).is_noisy_by_evidence

    assert is_noisy(outputs + noise)
    assert not is_noisy(outputs + noise * [0.0, 1.0, 0.0])
    assert not is_noisy(outputs)

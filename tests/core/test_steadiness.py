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


def test_only_what_several_outputs_may_show_is_measured_again() -> None:
    rng = np.random.default_rng(1)
    x = rng.uniform(-1.0, 1.0, (24, 2))
    outputs = np.column_stack([np.sin(2.0 * x @ w) for w in ([1.0, 0.5], [-0.5, 1.0])])
    noise = 0.05 * rng.standard_normal(outputs.shape)

    def found(readings: np.ndarray) -> tuple[bool, bool]:
        processes = [GaussianProcess().fit(x, y) for y in readings.T]
        steadiness = Steadiness("learned", "none").with_noise_of(processes, math.inf)
        return steadiness.is_noisy_by_evidence, steadiness.may_be_noisy

    assert found(outputs) == (False, False)
    assert found(outputs + 0.24 * noise) == (False, True)
    assert found(outputs + noise * [0.0, 1.0]) == (False, False)
    assert found(outputs + noise) == (True, False)

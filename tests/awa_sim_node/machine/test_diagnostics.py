"""Shot noise."""

from __future__ import annotations

import math

import numpy as np
import pytest

from awa_sim_node.machine.diagnostics import ShotNoise

N = 4000


@pytest.mark.parametrize(
    ("noise", "value", "expected"),
    [
        (ShotNoise(0.02, 0.05), 10.0, 0.2),
        (ShotNoise(0.02, 0.05), 2.0, 0.05),
        (ShotNoise(0.07), 80.0, 5.6),
        (ShotNoise(0.1), -3.0, 0.3),
        (ShotNoise(), 5.0, 0.0),
    ],
)
def test_shots_scatter_as_stated(noise: ShotNoise, value: float, expected: float) -> None:
    rng = np.random.default_rng(1)
    shots = np.array([noise.shot(value, rng) for _ in range(N)])
    assert noise.stddev(value) == pytest.approx(expected)
    assert abs(shots.mean() - value) <= 4.0 * expected / math.sqrt(N)
    assert abs(shots.std() - expected) <= 4.0 * expected / math.sqrt(2 * N)


@pytest.mark.parametrize(("fraction", "floor"), [(-0.1, 0.0), (0.0, -1.0), (math.nan, 0.0)])
def test_senseless_noise_is_refused(fraction: float, floor: float) -> None:
    with pytest.raises(ValueError, match=r"^(fraction|floor) = .* must be finite and at least 0$"):
        ShotNoise(fraction, floor)

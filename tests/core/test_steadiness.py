"""Whether a machine is noisy, by the evidence of all outputs together."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from mobo_tuner.core import Optimizer, Problem
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


def steep(setpoint: dict[str, float]) -> dict[str, float]:
    """A step and two kinks."""
    a, b, c = setpoint.values()
    return {
        "f": math.tanh(8.0 * (a - 0.2)) + b**2,
        "g": abs(a + 0.3) + 0.5 * abs(b) + 0.2 * c,
    }


def test_a_machine_that_may_be_noisy_is_measured_again_once() -> None:
    problem = Problem.from_dict(
        {
            "variables": {name: {"min": -1.0, "max": 1.0} for name in "abc"},
            "objectives": {name: {"reference": 3.0} for name in "fg"},
        }
    )
    optimizer = Optimizer(problem, seed=2)
    asked: list[dict[str, float]] = []
    again: list[int] = []
    while not again and len(asked) < 40:
        setpoint = optimizer.ask()
        if any(setpoint == pytest.approx(former, abs=1e-9) for former in asked):
            again.append(len(asked))
            break
        asked.append(setpoint)
        optimizer.tell(setpoint, steep(setpoint))
    assert again
    noisy = Optimizer.from_state(json.loads(json.dumps(optimizer.get_state())))
    assert noisy.ask() == setpoint
    batch = Optimizer.from_state(optimizer.get_state()).ask(2)
    assert batch[0] == setpoint
    assert batch[1] != pytest.approx(setpoint, abs=1e-6)
    optimizer.tell(setpoint, steep(setpoint))
    noisy.tell(setpoint, {name: value + 0.05 for name, value in steep(setpoint).items()})
    for each, trusted in ((optimizer, True), (noisy, False)):
        following = each.ask()
        assert following != pytest.approx(setpoint, abs=1e-6)
        each.tell(following, steep(following))
        assert each.archive.models.trusts_readings(each.dataset) == trusted
    assert optimizer.hypervolume == optimizer.hypervolume_measured
    assert noisy.hypervolume != noisy.hypervolume_measured

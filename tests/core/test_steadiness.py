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
    for _ in range(10):
        asked = optimizer.ask()
        optimizer.tell(asked, steep(asked))
    optimizer.ask()
    state = json.loads(json.dumps(optimizer.get_state()))
    state["models"]["may_be_noisy"] = True

    def doubtful() -> Optimizer:
        return Optimizer.from_state(json.loads(json.dumps(state)))

    front = [point["setpoint"] for point in optimizer.pareto_front()]
    again = doubtful().ask()
    assert any(again == pytest.approx(setpoint, abs=1e-9) for setpoint in front)
    first, second = doubtful().ask(2)
    assert first == again
    assert second != pytest.approx(again, abs=1e-6)
    narrow = problem.to_dict() | {"variables": {n: {"min": 0.98, "max": 1.0} for n in "abc"}}
    moved = doubtful().with_problem(Problem.from_dict(narrow)).ask()
    assert all(0.98 <= value <= 1.0 for value in moved.values())

    quiet, noisy = doubtful(), doubtful()
    quiet.tell(again, steep(again))
    noisy.tell(again, {name: value + 0.05 for name, value in steep(again).items()})
    for each, trusted in ((quiet, True), (noisy, False)):
        following = each.ask()
        assert following != pytest.approx(again, abs=1e-6)
        each.tell(following, steep(following))
        assert each.archive.models.trusts_readings(each.dataset) == trusted
    assert quiet.hypervolume == quiet.hypervolume_measured
    assert noisy.hypervolume != noisy.hypervolume_measured


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

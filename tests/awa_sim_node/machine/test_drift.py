"""The drift is an Ornstein-Uhlenbeck process, however often it is looked at."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import pytest
from scipy.stats import chi2, kstest

from awa_sim_node.machine import SimulatedMachine
from awa_sim_node.machine.drift import Drift, DriftParameters
from awa_sim_node.machine.kind import Kind
from tests.awa_sim_node.machine.echo_model import START, EchoModel

TAU = 1000.0
PARAMETERS = DriftParameters(charge=0.04, phase=0.3, gradient=0.002, correlation_time=TAU)
# Many channels of one kind are many independent processes at once.
PHASES = {f"phi{i}": Kind.PHASE for i in range(2000)}


def phases(seed: int, times: list[float]) -> np.ndarray:
    drift = Drift(PARAMETERS, PHASES, np.random.default_rng(seed))
    return np.array([list(drift.at(time).values()) for time in times])


@pytest.mark.parametrize("steps", [1, 7, 400])
def test_its_spread_grows_as_the_process_says_whatever_the_steps(steps: int) -> None:
    times = [0.6 * TAU * (k + 1) / steps for k in range(steps)]
    values = phases(steps, times)[-1]
    expected = 0.3 * math.sqrt(1.0 - math.exp(-2.0 * 0.6))
    assert kstest(values / expected, "norm").pvalue > 1e-3
    # n s^2 / sigma^2 follows chi squared with n degrees of freedom.
    low, high = chi2.ppf([1e-4, 1.0 - 1e-4], len(values)) / len(values)
    assert low < float(np.mean(values**2)) / expected**2 < high


def test_it_is_forgotten_with_the_correlation_time() -> None:
    early, late = phases(3, [20.0 * TAU, 20.5 * TAU])
    correlation = float(np.corrcoef(early, late)[0, 1])
    # Fisher's z is normal with a standard deviation of 1 / sqrt(n - 3).
    distance = math.atanh(correlation) - math.atanh(math.exp(-0.5))
    assert abs(distance) < 4.0 / math.sqrt(len(early) - 3)
    assert float(late.std()) == pytest.approx(0.3, rel=4.0 / math.sqrt(2 * len(late)))


def test_looking_again_at_once_changes_nothing() -> None:
    drift = Drift(PARAMETERS, PHASES, np.random.default_rng(0))
    assert drift.at(5.0) == drift.at(5.0)
    assert set(drift.at(5.0).values()) != {0.0}


def test_what_does_not_drift_is_not_named() -> None:
    kinds = {"x": Kind.EXACT, "K": Kind.SOLENOID, "q": Kind.CHARGE, "k": Kind.FIXED}
    assert set(Drift(PARAMETERS, kinds, np.random.default_rng(0)).at(1.0)) == {"q"}


def test_drift_reaches_the_beam_and_not_the_readbacks() -> None:
    machine = SimulatedMachine(
        EchoModel(),
        "ideal",
        seed=5,
        parameters={"drift_phase": 0.3, "drift_gradient": 0.002, "drift_correlation_time": TAU},
    )
    machine.step(10.0 * TAU)
    shots: list[Mapping[str, float]] = []
    machine.start_evaluation(START, 2, lambda shot: shots.append(shot.measured))
    machine.step(2.0)
    first, second = shots
    assert machine.readbacks() == START
    for name, value, scale in (("phase", 10.0, 0.3), ("gradient", 70.0, 0.14)):
        assert 0.0 < abs(first[f"{name}_seen"] - value) < 4.0 * scale
        # Within a second it hardly moves: its steps have sigma sqrt(2 t / tau).
        step = abs(second[f"{name}_seen"] - first[f"{name}_seen"])
        assert 0.0 < step < 4.0 * scale * math.sqrt(2.0 / TAU)

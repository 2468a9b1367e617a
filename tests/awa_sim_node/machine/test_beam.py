"""Shots: dropped, invalid, retaken, and what an evaluation makes of them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import binom, norm

from awa_sim_node.machine import Cause, EvaluationResult, Shot, ShotStatus, SimulatedMachine
from awa_sim_node.machine.models import AwaModel
from awa_sim_node.surrogate import Surrogate
from tests.awa_sim_node.machine.echo_model import START, EchoModel

SHOTS = 5000


def measure(
    shots: int = SHOTS, seed: int = 0, **parameters: float
) -> tuple[EvaluationResult, list[Shot]]:
    machine = SimulatedMachine(EchoModel(), "ideal", seed=seed, parameters=parameters)
    taken: list[Shot] = []
    evaluation = machine.start_evaluation(START, shots=shots, on_shot=taken.append)
    machine.step(2.0 * shots + 100.0)
    assert evaluation.result is not None
    return evaluation.result, taken


def assert_share(count: int, total: int, probability: float) -> None:
    """Assert that a count is what chance allows, but once in five thousand."""
    low, high = binom.ppf([1e-4, 1.0 - 1e-4], total, probability)
    assert low <= count <= high, (count, total, probability)


def test_dropouts_give_nothing_and_are_as_frequent_as_stated() -> None:
    result, shots = measure(beam_dropout=0.05)
    dropped = [shot for shot in shots if shot.status is ShotStatus.DROPPED]
    assert_share(len(dropped), SHOTS, 0.05)
    assert all(math.isnan(value) for shot in dropped for value in shot.measured.values())
    assert result.shots == SHOTS - len(dropped)
    assert {d.name: d.value for d in result.diagnostics}["charge"] == 40.0


def test_invalid_images_lose_what_they_show_together() -> None:
    _, shots = measure(beam_invalid_image=0.1)
    first = [math.isnan(shot.measured["phase_seen"]) for shot in shots]
    assert first == [math.isnan(shot.measured["other_phase_seen"]) for shot in shots]
    second = [math.isnan(shot.measured["gradient_seen"]) for shot in shots]
    assert_share(sum(first), SHOTS, 0.1)
    assert_share(sum(second), SHOTS, 0.1)
    assert_share(sum(a and b for a, b in zip(first, second, strict=True)), SHOTS, 0.01)
    assert not any(math.isnan(shot.measured["charge"]) for shot in shots)


def test_shots_with_the_wrong_charge_are_retaken_and_counted() -> None:
    result, shots = measure(
        jitter_charge=0.08, beam_charge_window=0.1, beam_retakes=4.0, beam_noise_scale=1.0
    )
    assert result.failure is None
    assert result.shots == SHOTS
    retaken = [shot for shot in shots if shot.status is ShotStatus.RETAKEN]
    assert len(retaken) == result.retaken > 0
    assert result.duration == pytest.approx(SHOTS + len(retaken))
    kept = [s.measured["charge"] for s in shots if s.status is ShotStatus.GOOD]
    assert min(kept) >= 36.0
    assert max(kept) <= 44.0
    # Jitter of 8 % and a measurement of 1 % of it: relative spread 8.06 %, cut at 10 %.
    inside = 1.0 - 2.0 * float(norm.sf(0.1 / math.hypot(0.08, 0.01)))
    assert_share(SHOTS, SHOTS + len(retaken), inside)


def test_retaking_has_an_end() -> None:
    result, _ = measure(
        shots=5, jitter_charge=0.5, beam_charge_window=0.001, beam_retakes=4.0, seed=1
    )
    assert result.failure is not None
    assert result.failure.cause is Cause.CHARGE
    assert result.retaken == 21
    for part in ("21 shots", "40 nC", "0.1 %"):
        assert part in result.failure.message


def test_noise_scales_with_its_parameter() -> None:
    charges = [shot.measured["charge"] for shot in measure(beam_noise_scale=3.0)[1]]
    assert np.std(charges, ddof=1) / 1.2 == pytest.approx(1.0, abs=4.0 / math.sqrt(2 * SHOTS))


def test_each_shot_goes_through_the_surrogate() -> None:
    machine = SimulatedMachine(
        AwaModel(), "nominal", seed=3, parameters={"beam_dropout": 0.0, "trip_rate": 0.0}
    )
    shots: list[Shot] = []
    machine.start_evaluation(machine.setpoint, shots=20, on_shot=shots.append)
    machine.step(100.0)
    surrogate = Surrogate.load()
    emittances = set()
    for shot in shots:
        truth = surrogate.predict(shot.inputs)
        assert shot.truth == truth | {"charge": shot.inputs["charge"]}
        emittances.add(truth["eps_x"])
    assert len(emittances) == len(shots) >= 20


def test_what_the_beam_feels_stays_where_the_surrogate_answers() -> None:
    machine = SimulatedMachine(
        AwaModel(),
        "nominal",
        seed=3,
        parameters={"jitter_timing": 3.0, "jitter_charge": 0.5, "jitter_gradient": 0.1},
    )
    ends = {v.name: v.maximum for v in machine.description.variables}
    shots: list[Shot] = []
    machine.start_evaluation(ends, shots=100, on_shot=shots.append)
    machine.step(500.0)
    assert len(shots) > 100
    for name, (low, high) in AwaModel.ranges.items():
        assert all(low <= shot.inputs[name] <= high for shot in shots)
    assert max(shot.inputs["phi1"] for shot in shots) == AwaModel.ranges["phi1"][1]

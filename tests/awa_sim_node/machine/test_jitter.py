"""The jitter from shot to shot has the stated size, and acts through what the beam feels."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import pytest

from awa_sim_node.machine import SimulatedMachine
from awa_sim_node.machine.jitter import Jitter, JitterParameters
from awa_sim_node.machine.kind import Kind
from tests.awa_sim_node.machine.echo_model import START, EchoModel

SHOTS = 4000
KINDS = {"x": Kind.EXACT, "phi": Kind.PHASE, "psi": Kind.PHASE, "G": Kind.GRADIENT}


def test_phases_share_the_timing_and_nothing_else() -> None:
    rng = np.random.default_rng(1)
    jitter = Jitter(JitterParameters(charge=0.1, timing=0.4, phase=0.3, gradient=0.02), KINDS)
    draws = [jitter.draw(rng) for _ in range(SHOTS)]
    assert set(draws[0]) == {"phi", "psi", "G"}
    covariance = np.cov([[draw[name] for draw in draws] for name in ("phi", "psi", "G")])
    # A sample covariance of n normal pairs deviates by sqrt((s_xx s_yy + s_xy^2) / n).
    expected = np.array([[0.25, 0.16, 0.0], [0.16, 0.25, 0.0], [0.0, 0.0, 0.0004]])
    spread = np.sqrt((np.outer(expected.diagonal(), expected.diagonal()) + expected**2) / SHOTS)
    assert np.all(np.abs(covariance - expected) < 4.0 * spread)


def test_jitter_reaches_the_beam() -> None:
    machine = SimulatedMachine(
        EchoModel(),
        "ideal",
        seed=2,
        parameters={
            "jitter_charge": 0.02,
            "jitter_timing": 0.3,
            "jitter_phase": 0.4,
            "jitter_gradient": 0.002,
        },
    )
    shots: list[Mapping[str, float]] = []
    machine.start_evaluation(START, SHOTS, lambda shot: shots.append(shot.measured))
    machine.step(SHOTS + 1.0)
    assert len(shots) == SHOTS
    for name, mean, stddev in (
        ("phase_seen", 10.0, 0.5),
        ("other_phase_seen", -10.0, 0.5),
        ("gradient_seen", 70.0, 0.14),
        ("charge", 40.0, 0.8),
    ):
        values = np.array([shot[name] for shot in shots])
        assert abs(values.mean() - mean) < 4.0 * stddev / math.sqrt(SHOTS)
        assert abs(values.std(ddof=1) / stddev - 1.0) < 4.0 / math.sqrt(2 * SHOTS)
    assert {shot["current_seen"] for shot in shots} == {START["current"]}


@pytest.mark.parametrize(("name", "value"), [("charge", -0.1), ("phase", math.nan), ("timing", 9)])
def test_senseless_parameters_are_refused(name: str, value: float) -> None:
    good = {"charge": 0.0, "timing": 0.0, "phase": 0.0, "gradient": 0.0}
    with pytest.raises(ValueError, match=rf"^{name} = {value} must be from 0 to "):
        JitterParameters(**(good | {name: value}))

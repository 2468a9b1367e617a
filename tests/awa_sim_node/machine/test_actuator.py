"""The motion of an actuator, against hand calculation and a numerical integration."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from awa_sim_node.machine.actuator import INSTANTANEOUS, Actuator, ActuatorParameters

SOLENOID = ActuatorParameters(
    slew_rate=8.0, time_constant=1.5, tolerance=0.1, readback_noise=0.05, hysteresis=0.0
)
STICKY = replace(SOLENOID, hysteresis=2.0)


def test_time_to_settle_agrees_with_hand_calculation() -> None:
    actuator = Actuator(SOLENOID, 400.0)
    actuator.set(480.0)
    # 80 A at 8 A/s; the lag at the end is 8 * 1.5 = 12 A times (1 - exp(-10 / 1.5)).
    lag = 12.0 * (1.0 - math.exp(-10.0 / 1.5))
    assert actuator.time_to_ramped == pytest.approx(10.0)
    assert actuator.time_to_settled == pytest.approx(10.0 + 1.5 * math.log(lag / 0.1))


def test_position_follows_the_lag_equation() -> None:
    actuator = Actuator(SOLENOID, 400.0)
    actuator.set(430.0)

    def rate(time: float, position: np.ndarray) -> np.ndarray:
        reference = min(400.0 + 8.0 * time, 430.0)
        return (reference - position) / 1.5

    times = np.linspace(0.0, 9.0, 46)
    solution = solve_ivp(
        rate, (0.0, 9.0), [400.0], t_eval=times, rtol=1e-9, atol=1e-9, max_step=0.01
    )
    for i in range(1, len(times)):
        actuator.step(float(times[i] - times[i - 1]))
        assert actuator.position == pytest.approx(float(solution.y[0, i]), abs=1e-4)


def test_motion_does_not_depend_on_the_steps() -> None:
    coarse, fine = Actuator(SOLENOID, 500.0), Actuator(SOLENOID, 500.0)
    for actuator in (coarse, fine):
        actuator.set(450.0)
    coarse.step(8.5)
    for _ in range(850):
        fine.step(0.01)
    assert fine.position == pytest.approx(coarse.position, abs=1e-9)


def test_stepping_to_the_computed_time_settles_exactly_on_the_target() -> None:
    rng = np.random.default_rng(0)
    actuator = Actuator(SOLENOID, 475.0)
    for target in rng.uniform(400.0, 550.0, 200):
        actuator.set(float(target))
        actuator.step(0.5 * actuator.time_to_ramped)
        assert actuator.ramping
        actuator.step(actuator.time_to_ramped)
        assert not actuator.ramping
        actuator.step(actuator.time_to_settled)
        assert actuator.settled
        assert actuator.position == target


def test_a_turn_in_mid_ramp_settles_when_foretold() -> None:
    actuator = Actuator(SOLENOID, 400.0)
    actuator.set(500.0)
    actuator.step(5.0)
    actuator.set(410.0)
    foretold = actuator.time_to_settled
    actuator.step(0.999 * foretold)
    assert not actuator.settled
    actuator.step(0.001 * foretold)
    assert actuator.settled
    assert actuator.position == 410.0


def test_hold_stops_at_once() -> None:
    actuator = Actuator(SOLENOID, 400.0)
    actuator.set(500.0)
    actuator.step(3.0)
    position = actuator.position
    assert 400.0 < position < 424.0
    actuator.hold()
    actuator.step(10.0)
    assert actuator.settled
    assert actuator.position == actuator.target == position


def test_an_instantaneous_actuator_is_there_at_once() -> None:
    actuator = Actuator(INSTANTANEOUS, 0.0)
    actuator.set(1.5)
    assert actuator.settled
    assert actuator.position == 1.5
    assert actuator.time_to_settled == 0.0


def test_readback_noise_has_the_stated_size() -> None:
    rng = np.random.default_rng(3)
    actuator = Actuator(SOLENOID, 475.0)
    readbacks = np.array([actuator.readback(rng) for _ in range(4000)])
    # 4 sigma of the mean and of the standard deviation of 4000 samples.
    assert abs(readbacks.mean() - 475.0) < 4.0 * 0.05 / math.sqrt(4000)
    assert abs(readbacks.std(ddof=1) / 0.05 - 1.0) < 4.0 / math.sqrt(2 * 4000)
    assert actuator.position == 475.0


def test_without_hysteresis_the_beam_feels_the_position() -> None:
    actuator = Actuator(SOLENOID, 400.0)
    actuator.set(430.0)
    for _ in range(20):
        actuator.step(0.37)
        assert actuator.strength == actuator.position


def test_hysteresis_depends_on_where_the_actuator_came_from() -> None:
    actuator = Actuator(STICKY, 450.0)
    for target, strength in ((500.0, 499.0), (499.0, 499.0), (450.0, 451.0), (451.5, 451.0)):
        actuator.set(target)
        actuator.step(actuator.time_to_settled)
        assert actuator.settled
        assert actuator.strength == pytest.approx(strength, abs=1e-9)


def test_hysteresis_sees_a_turning_point_within_a_step() -> None:
    coarse, fine = Actuator(STICKY, 400.0), Actuator(STICKY, 400.0)
    for actuator in (coarse, fine):
        actuator.set(500.0)
        actuator.step(2.0)
        actuator.set(404.5)  # the position still runs up for a while
    farthest = 0.0
    for _ in range(40_000):
        fine.step(0.001)
        farthest = max(farthest, fine.position)
    coarse.step(40.0)
    assert fine.settled
    assert coarse.settled
    assert coarse.strength == pytest.approx(fine.strength, abs=1e-6)
    # Exactly one play below the position on the way down, the farthest point never reached again.
    assert coarse.strength == pytest.approx(405.5, abs=1e-9)
    assert farthest > 406.0


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("slew_rate", 0.0),
        ("slew_rate", math.nan),
        ("time_constant", -1.0),
        ("time_constant", math.inf),
        ("tolerance", 0.0),
        ("readback_noise", -0.1),
        ("hysteresis", -0.1),
        ("hysteresis", math.nan),
    ],
)
def test_senseless_parameters_are_refused(name: str, value: float) -> None:
    good: dict[str, Any] = {
        "slew_rate": 8.0,
        "time_constant": 1.5,
        "tolerance": 0.1,
        "readback_noise": 0.05,
        "hysteresis": 0.0,
    }
    with pytest.raises(ValueError, match=rf"^{name} = .* must be "):
        ActuatorParameters(**(good | {name: value}))

"""Lasting beam loss raises the interlock, and nothing moves until it is cleared."""

from __future__ import annotations

import math

import pytest

from awa_sim_node.machine import Cause, InterlockError, Phase, SimulatedMachine
from awa_sim_node.machine.interlock import Interlock, InterlockParameters
from tests.awa_sim_node.machine.echo_model import START, EchoModel

LOSSY = START | {"current": 160.0}


def test_only_losses_in_a_row_count() -> None:
    interlock = Interlock(InterlockParameters(shots=3))
    for lost in (True, True, False, True, True):
        interlock.see(lost)
        assert not interlock.raised
        interlock.check()
    interlock.see(True)
    assert interlock.raised
    interlock.see(False)  # it stays until it is cleared
    with pytest.raises(InterlockError, match=r"^the interlock is raised: 3 "):
        interlock.check()
    interlock.clear()
    assert not interlock.raised
    interlock.see(True)
    assert not interlock.raised


def test_zero_shots_switch_it_off() -> None:
    interlock = Interlock(InterlockParameters(shots=0))
    for _ in range(1000):
        interlock.see(True)
    assert not interlock.raised


def lossy_machine(shots: int) -> SimulatedMachine:
    return SimulatedMachine(
        EchoModel(),
        "ideal",
        seed=0,
        parameters={"beam_loss_limit": 0.9, "interlock_shots": shots},
    )


def test_an_evaluation_without_enough_beam_is_no_measurement() -> None:
    machine = lossy_machine(100)
    evaluation = machine.start_evaluation(LOSSY)
    machine.step(100.0)
    assert evaluation.phase is Phase.FAILED
    assert evaluation.result is not None
    assert evaluation.result.failure is not None
    assert evaluation.result.failure.cause is Cause.LOSS
    assert "lost in 5 of 5 shots" in (evaluation.result.failure.message)
    values = {reading.name: reading.value for reading in evaluation.result.diagnostics}
    assert (values["transmission"], values["charge"]) == (0.8, 40.0)
    assert math.isnan(values["phase_seen"])
    # A single loss does no harm: it moves on.
    evaluation = machine.start_evaluation(START)
    machine.step(100.0)
    assert evaluation.phase is Phase.DONE


def test_lasting_loss_stops_everything_until_it_is_cleared() -> None:
    machine = lossy_machine(3)
    evaluation = machine.start_evaluation(LOSSY)
    machine.step(100.0)
    assert evaluation.result is not None
    assert evaluation.result.failure is not None
    assert evaluation.result.failure.cause is Cause.INTERLOCK
    assert evaluation.result.shots == 3
    assert machine.interlock
    assert machine.free_shot() is None
    for refused in (
        lambda: machine.start_evaluation(START),
        lambda: machine.move(START),
        lambda: machine.measure(),
        lambda: machine.set("current", 100.0),
    ):
        with pytest.raises(InterlockError, match=r"^the interlock is raised"):
            refused()
    assert machine.setpoint == LOSSY
    machine.clear_interlock()
    machine.move(START)
    machine.step(100.0)
    assert machine.setpoint == START


def test_the_interlock_stops_what_moves_outside_evaluations() -> None:
    machine = lossy_machine(2)
    machine.set("current", 200.0)
    while machine.readbacks()["current"] < 155.0:
        assert not machine.interlock
        machine.step(0.5)
        machine.free_shot()
    machine.free_shot()
    assert machine.interlock
    assert machine.settled
    held = machine.readbacks()
    machine.step(20.0)
    assert machine.readbacks() == held

"""Trips come at the stated rate, last as long as stated, and evaluations bear or end with them."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import kstest, poisson

from awa_sim_node.machine import Cause, Phase, SimulatedMachine
from awa_sim_node.machine.trips import GREATEST_RATE, TripParameters, Trips
from tests.awa_sim_node.machine.echo_model import START, EchoModel

PARAMETERS = TripParameters(
    rate=2.0, threshold=72.0, steepness=0.75, recovery_min=30.0, recovery_max=60.0, patience=600.0
)
OFTEN = {"trip_rate": 60.0, "trip_recovery_min": 30.0, "trip_recovery_max": 60.0}


def time_of_trips(parameters: TripParameters, gradient: float, count: int) -> np.ndarray:
    """The times from the end of one trip to the next [s]."""
    trips = Trips(parameters, 75.0, np.random.default_rng(7))
    intervals = []
    for _ in range(count):
        waited = 0.0
        while not trips.tripped:
            waited += trips.time_to_next_event
            trips.step(trips.time_to_next_event, gradient)
        intervals.append(waited)
        trips.step(trips.time_to_next_event, gradient)
    return np.array(intervals)


@pytest.mark.parametrize("gradient", [60.0, 72.0, 73.5, 75.0])
def test_trips_are_a_poisson_process_with_the_rate_of_the_gradient(gradient: float) -> None:
    rate = 2.0 * math.exp(max(0.0, gradient - 72.0) / 0.75) / 3600.0
    assert PARAMETERS.rate_at(gradient) / 3600.0 == pytest.approx(rate)
    intervals = time_of_trips(PARAMETERS, gradient, 400)
    assert kstest(intervals * rate, "expon").pvalue > 1e-3


def test_a_trip_lasts_from_the_shortest_to_the_longest_recovery() -> None:
    trips = Trips(PARAMETERS, 75.0, np.random.default_rng(0))
    times: list[float] = []
    while len(times) < 500:
        if trips.tripped:
            times.append(trips.time_to_next_event)
        trips.step(trips.time_to_next_event, 75.0)
    assert kstest(times, "uniform", (30.0, 30.0)).pvalue > 1e-3
    assert trips.count == 500


def test_small_steps_give_the_same_trips() -> None:
    def count(dt: float) -> int:
        machine = SimulatedMachine(EchoModel(), "ideal", seed=3, parameters=OFTEN)
        for _ in range(round(40_000.0 / dt)):
            machine.step(dt)
        return machine.trips

    trips = count(40_000.0)
    # A renewal process: beam for 60 s on average, then 45 s without.
    assert abs(trips - 40_000.0 / 105.0) < 4.0 * math.sqrt(40_000.0 / 105.0)
    assert count(10.0) == trips


def test_the_rate_has_an_end() -> None:
    steep = replace(PARAMETERS, steepness=0.01)
    assert steep.rate_at(1000.0) == GREATEST_RATE
    trips = Trips(replace(PARAMETERS, rate=0.0), 75.0, np.random.default_rng(0))
    assert trips.time_to_next_event == math.inf


def test_a_machine_trips_as_often_as_stated() -> None:
    machine = SimulatedMachine(EchoModel(), "nominal", seed=1)
    hours = 300
    for _ in range(hours):
        machine.step(3600.0)
    low, high = poisson.ppf([1e-4, 1.0 - 1e-4], hours)  # at one an hour below 72 MV/m
    assert low <= machine.trips <= high


def test_an_evaluation_waits_for_the_beam() -> None:
    machine = SimulatedMachine(EchoModel(), "ideal", seed=2, parameters=OFTEN)
    evaluation = machine.start_evaluation(START, shots=100)
    fractions = []
    while evaluation.result is None:
        machine.step(1.0)
        fractions.append(evaluation.fraction)
    assert machine.trips > 0
    assert evaluation.phase is Phase.DONE
    assert evaluation.result.shots == 100
    assert evaluation.result.duration > 100.0 + 30.0 * machine.trips
    assert fractions == sorted(fractions)


def test_an_impatient_evaluation_ends_with_what_it_has() -> None:
    machine = SimulatedMachine(
        EchoModel(), "ideal", seed=2, parameters=OFTEN | {"trip_patience": 0.0}
    )
    evaluation = machine.start_evaluation(START, shots=1000)
    machine.step(1000.0)
    assert evaluation.phase is Phase.FAILED
    assert evaluation.result is not None
    assert evaluation.result.failure is not None
    assert evaluation.result.failure.cause is Cause.TRIP
    assert 0 < evaluation.result.shots < 1000
    assert evaluation.result.diagnostics[0].value == START["current"]


def test_there_are_no_shots_while_tripped() -> None:
    machine = SimulatedMachine(EchoModel(), "ideal", seed=2, parameters=OFTEN)
    while not machine.tripped:
        assert machine.free_shot() is not None
        machine.step(machine.time_to_next_event)
    assert machine.free_shot() is None
    machine.move(START | {"current": 110.0})  # magnets move all the same
    machine.step(60.0)
    assert machine.readbacks()["current"] == 110.0


def test_a_recovery_needs_time() -> None:
    with pytest.raises(ValueError, match=r"^recovery_min = 61\.0 must be at most recovery_max"):
        replace(PARAMETERS, recovery_min=61.0)

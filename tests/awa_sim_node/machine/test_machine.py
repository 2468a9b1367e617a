"""The simulated machine: moving, settling, measuring, stopping."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import pytest

from awa_sim_node.machine import (
    Cause,
    Evaluation,
    EvaluationResult,
    Phase,
    SimulatedMachine,
)
from awa_sim_node.machine.diagnostics import Reading
from awa_sim_node.machine.models import AwaModel, Model, ToyModel
from awa_sim_node.surrogate import Surrogate

CENTRE = {"K1": 475.0, "K2": 230.0, "phi1": -5.0, "phi2": -5.0, "G1": 67.5, "G2": 20.0}
FAR = {"K1": 525.0, "K2": 250.0, "phi1": -1.0, "phi2": -9.0, "G1": 70.0, "G2": 17.0}
READBACK_NOISE = {"K1": 0.05, "K2": 0.05, "phi1": 0.02, "phi2": 0.02, "G1": 0.01, "G2": 0.01}
STEADY = dict.fromkeys(
    (
        *("beam_dropout", "beam_invalid_image", "beam_charge_window", "trip_rate"),
        *("jitter_charge", "jitter_timing", "jitter_phase", "jitter_gradient"),
        *("drift_charge", "drift_phase", "drift_gradient"),
    ),
    0.0,
)


@pytest.fixture(scope="module")
def awa() -> Model:
    return AwaModel()


def finish(
    machine: SimulatedMachine, evaluation: Evaluation, dt: float | None = None
) -> EvaluationResult:
    for _ in range(100_000):
        if evaluation.result is not None:
            return evaluation.result
        machine.step(machine.time_to_next_event if dt is None else dt)
    raise AssertionError("the evaluation did not finish")


def values(readings: tuple[Reading, ...]) -> dict[str, float]:
    return {reading.name: reading.value for reading in readings}


def test_nothing_moves_at_construction(awa: Model) -> None:
    machine = SimulatedMachine(awa, "ideal", seed=0)
    assert machine.readbacks() == machine.setpoint == CENTRE
    assert machine.settled
    assert not machine.busy
    assert machine.time_to_next_event == math.inf
    machine.step(100.0)
    assert machine.time == pytest.approx(100.0)
    assert machine.readbacks() == CENTRE


def test_an_evaluation_goes_through_its_phases_in_physical_time(awa: Model) -> None:
    machine = SimulatedMachine(awa, "ideal", seed=0)
    evaluation = machine.start_evaluation(FAR, shots=5)
    seen = [(evaluation.phase, 0.0)]
    fractions = [evaluation.fraction]
    while not evaluation.phase.finished:
        machine.step(machine.time_to_next_event)
        fractions.append(evaluation.fraction)
        if evaluation.phase is not seen[-1][0]:
            seen.append((evaluation.phase, machine.time))
    assert [phase for phase, _ in seen] == [Phase.RAMP, Phase.SETTLE, Phase.MEASURE, Phase.DONE]
    # K1 is the slowest: 50 A at 8 A/s, then its lag of 12 A decays to 0.1 A with 1.5 s.
    ramp = 50.0 / 8.0
    settle = 1.5 * math.log(12.0 * (1.0 - math.exp(-ramp / 1.5)) / 0.1)
    times = [time for _, time in seen]
    assert times == pytest.approx([0.0, ramp, ramp + settle, ramp + settle + 5.0])
    assert evaluation.duration == pytest.approx(machine.time)
    assert fractions == sorted(fractions)
    assert (fractions[0], fractions[-1]) == (0.0, 1.0)
    assert 10.0 < machine.time < 30.0


def test_usual_evaluations_take_ten_to_thirty_seconds(awa: Model) -> None:
    machine = SimulatedMachine(awa, "nominal", seed=0, parameters=STEADY)
    rng = np.random.default_rng(2)
    variables = machine.description.variables
    durations = []
    for _ in range(50):
        evaluation = machine.start_evaluation(
            {v.name: rng.uniform(v.minimum, v.maximum) for v in variables}
        )
        durations.append(finish(machine, evaluation).duration)
    assert min(durations) > 10.0
    assert max(durations) < 35.0
    assert 15.0 < float(np.median(durations)) < 25.0


def test_the_ideal_machine_measures_the_surrogate_itself(awa: Model) -> None:
    machine = SimulatedMachine(awa, "ideal", seed=0)
    result = finish(machine, machine.start_evaluation(FAR, shots=3))
    measured = values(result.diagnostics)
    assert measured.pop("charge") == 40.0
    assert measured == Surrogate.load().predict(FAR)
    assert values(result.readbacks) == FAR
    assert {reading.stddev for reading in result.diagnostics} == {0.0}
    assert result.shots == 3


def test_the_nominal_machine_scatters_as_its_noise_says(awa: Model) -> None:
    machine = SimulatedMachine(awa, "nominal", seed=4, parameters=STEADY)
    result = finish(machine, machine.start_evaluation(CENTRE, shots=2000))
    truth = awa.true_values(CENTRE)
    for reading in result.diagnostics:
        expected = awa.noise[reading.name].stddev(truth[reading.name]) / math.sqrt(2000)
        assert abs(reading.value - truth[reading.name]) < 4.0 * expected, reading
        assert abs(reading.stddev / expected - 1.0) < 4.0 / math.sqrt(2 * 2000), reading
    for reading in result.readbacks:
        expected = READBACK_NOISE[reading.name] / math.sqrt(2000)
        assert abs(reading.value - CENTRE[reading.name]) < 4.0 * expected, reading


def test_equal_seeds_give_equal_runs_however_time_is_cut() -> None:
    def run(dt: float | None, looks: bool, seed: int) -> list[EvaluationResult]:
        machine = SimulatedMachine("toy", "nominal", seed=seed)
        results = []
        for x in (-1.5, 0.5, 2.0):
            evaluation = machine.start_evaluation({"x1": x, "x2": -x}, shots=4)
            if looks:
                machine.readbacks()
            results.append(finish(machine, evaluation, dt))
        return results

    first = run(None, False, 7)
    for second in (run(0.0007, True, 7), run(0.0313, False, 7)):
        assert [r.diagnostics for r in second] == [r.diagnostics for r in first]
        assert [r.readbacks for r in second] == [r.readbacks for r in first]
    assert run(None, False, 8)[0].diagnostics != first[0].diagnostics


def test_toy_is_exact_and_quick() -> None:
    machine = SimulatedMachine("toy", "ideal")
    evaluation = machine.start_evaluation({"x1": 1.0, "x2": -1.0})
    assert evaluation.phase is Phase.MEASURE
    result = finish(machine, evaluation)
    assert values(result.diagnostics) == {"f1": 2.0, "f2": 2.0, "g": 1.0}
    assert machine.time == pytest.approx(0.01)


def test_one_big_step_finishes_everything() -> None:
    machine = SimulatedMachine("toy", "ideal")
    evaluation = machine.start_evaluation({"x1": 0.0, "x2": 0.0}, shots=50)
    machine.step(1.0)
    assert evaluation.phase is Phase.DONE
    assert evaluation.result is not None
    assert evaluation.result.shots == 50
    assert evaluation.result.duration == pytest.approx(0.5)
    assert machine.time == pytest.approx(1.0)


def test_stop_holds_where_the_machine_is(awa: Model) -> None:
    machine = SimulatedMachine(awa, "ideal", seed=0)
    evaluation = machine.start_evaluation(FAR)
    machine.step(3.0)
    machine.stop()
    assert evaluation.phase is Phase.STOPPED
    assert evaluation.fraction == pytest.approx(3.0 / evaluation.duration)
    held = machine.readbacks()
    assert CENTRE["K1"] < held["K1"] < CENTRE["K1"] + 24.0
    machine.step(20.0)
    assert machine.readbacks() == held == machine.setpoint
    assert not machine.busy
    assert evaluation.result is not None
    assert values(evaluation.result.readbacks) == held
    assert all(math.isnan(reading.value) for reading in evaluation.result.diagnostics)
    assert evaluation.result.shots == 0
    assert evaluation.result.duration == pytest.approx(3.0)


def test_stop_while_measuring_keeps_the_shots_so_far(awa: Model) -> None:
    machine = SimulatedMachine(awa, "nominal", seed=0, parameters=STEADY)
    evaluation = machine.start_evaluation(CENTRE, shots=5)
    machine.step(2.5)
    machine.stop()
    assert evaluation.result is not None
    assert evaluation.result.shots == 2
    assert all(math.isfinite(reading.value) for reading in evaluation.result.diagnostics)
    assert finish(machine, machine.start_evaluation(CENTRE, shots=1)).shots == 1


def test_stop_at_rest_does_nothing(awa: Model) -> None:
    machine = SimulatedMachine(awa, "ideal")
    machine.stop()
    assert machine.setpoint == CENTRE


def test_a_move_settles_when_foretold_and_measures_nothing(awa: Model) -> None:
    machine = SimulatedMachine(awa, "ideal")
    duration = machine.move(FAR)
    machine.step(0.99 * duration)
    assert machine.busy
    machine.step(0.01 * duration)
    assert not machine.busy
    assert machine.readbacks() == FAR


def test_a_busy_machine_refuses_and_goes_on(awa: Model) -> None:
    machine = SimulatedMachine(awa, "ideal")
    evaluation = machine.start_evaluation(FAR)
    machine.step(2.0)
    with pytest.raises(RuntimeError, match=r"^the machine is busy"):
        machine.start_evaluation(CENTRE)
    with pytest.raises(RuntimeError, match=r"^the machine is busy"):
        machine.move(CENTRE)
    assert machine.setpoint == FAR
    assert finish(machine, evaluation).shots == 5


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"K1": 550.1}, r"^set-point K1 = 550.1 A is outside the machine's limits, 400 to 550 A$"),
        ({"G2": 14.9}, r"^set-point G2 = 14.9 MV/m is outside .*, 15 to 25 MV/m$"),
        ({"phi1": math.nan}, r"^set-point phi1 = nan deg is outside the machine's limits"),
        ({"phi2": -math.inf}, r"^set-point phi2 = -inf deg is outside the machine's limits"),
        ({"K3": 1.0}, r"^set-point names 'K3', but the machine's variables are K1, K2, .*G2$"),
        ({"K1": None}, r"^set-point lacks 'K1'; it must name all of the variables K1, .*G2$"),
    ],
)
def test_a_bad_set_point_moves_nothing(
    awa: Model, change: Mapping[str, float | None], message: str
) -> None:
    machine = SimulatedMachine(awa, "ideal")
    setpoint = {name: value for name, value in {**FAR, **change}.items() if value is not None}
    with pytest.raises(ValueError, match=message):
        machine.move(setpoint)
    with pytest.raises(ValueError, match=message):
        machine.start_evaluation(setpoint)
    machine.step(1.0)
    assert machine.readbacks() == machine.setpoint == CENTRE


@pytest.mark.parametrize("shots", [0, -1, 10_001])
def test_a_bad_number_of_shots_moves_nothing(shots: int) -> None:
    machine = SimulatedMachine("toy")
    with pytest.raises(ValueError, match=rf"^shots = {shots} must be from 1 to 10000$"):
        machine.start_evaluation({"x1": 1.0, "x2": 1.0}, shots=shots)
    assert machine.setpoint == {"x1": 0.0, "x2": 0.0}


@pytest.mark.parametrize("dt", [-1.0, math.nan, math.inf])
def test_a_senseless_step_is_refused(dt: float) -> None:
    with pytest.raises(ValueError, match=r"^dt = .* must be finite and at least 0$"):
        SimulatedMachine("toy").step(dt)


def test_senseless_construction_is_refused() -> None:
    with pytest.raises(
        ValueError, match=r"^mode = 'perfect' must be one of ideal, nominal, rough$"
    ):
        SimulatedMachine("toy", mode="perfect")
    with pytest.raises(ValueError, match=r"^seed = -1 must be at least 0$"):
        SimulatedMachine("toy", seed=-1)
    with pytest.raises(ValueError, match=r"^machine = 'lhc' must be one of awa, toy$"):
        SimulatedMachine("lhc")


def test_a_diagnostic_that_gives_nothing_reads_nan() -> None:
    class Blind(ToyModel):
        def true_values(self, inputs: Mapping[str, float]) -> dict[str, float]:
            return super().true_values(inputs) | {"g": math.nan}

    machine = SimulatedMachine(Blind(), "nominal", seed=0)
    evaluation = machine.start_evaluation({"x1": 1.0, "x2": 0.0}, shots=3)
    result = finish(machine, evaluation)
    assert evaluation.phase is Phase.FAILED
    assert result.failure is not None
    assert result.failure.cause is Cause.NO_DATA
    assert result.failure.message.startswith("g ")
    measured = values(result.diagnostics)
    assert math.isnan(measured["g"])
    assert math.isfinite(measured["f1"])

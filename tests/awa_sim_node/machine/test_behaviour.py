"""The modes and their parameters."""

from __future__ import annotations

import math

import pytest
from scipy.stats import ks_2samp

from awa_sim_node.machine import MODEL_NAMES, Mode, SimulatedMachine, behaviour_of
from awa_sim_node.machine.parameter import ASSUMED, CHOSEN, SOURCED


@pytest.mark.parametrize("model", MODEL_NAMES)
@pytest.mark.parametrize("mode", list(Mode))
def test_every_parameter_is_named_described_and_within_its_range(model: str, mode: Mode) -> None:
    behaviour = behaviour_of(model, mode)
    assert behaviour.changed(behaviour.values) == behaviour
    for name, value in behaviour.values.items():
        info = behaviour.infos[name]
        assert info.minimum <= value <= info.maximum, name
        assert math.isfinite(info.minimum)
        assert math.isfinite(info.maximum)
        assert info.meaning
        assert info.source in (SOURCED, ASSUMED, CHOSEN)


def test_the_ideal_machine_knows_no_chance() -> None:
    for model in MODEL_NAMES:
        values = behaviour_of(model, Mode.IDEAL).values
        chances = (
            "jitter",
            "drift_charge",
            "drift_phase",
            "drift_gradient",
            "beam_noise_scale",
            "beam_dropout",
            "beam_invalid_image",
            "trip_rate",
            "interlock_shots",
        )
        named = [n for n in values if n.startswith(chances) or n.endswith(("_noise", "hysteresis"))]
        assert len(named) >= 18
        assert all(values[name] == 0.0 for name in named)


def test_a_rough_machine_is_worse_in_everything() -> None:
    nominal = behaviour_of("awa", Mode.NOMINAL).values
    rough = behaviour_of("awa", Mode.ROUGH).values
    for name in nominal:
        if name.startswith(("jitter", "trip_rate", "beam_dropout", "beam_noise")):
            assert rough[name] >= nominal[name], name


def test_a_wrong_parameter_is_named_with_its_group() -> None:
    behaviour = behaviour_of("awa", Mode.NOMINAL)
    with pytest.raises(ValueError, match=r"^jitter_charge = 0\.7 must be from 0 to 0\.5$"):
        behaviour.changed({"jitter_charge": 0.7})
    with pytest.raises(ValueError, match=r"^solenoid_slew_rate = -1\.0 must be from 0\.001 to"):
        behaviour.changed({"solenoid_slew_rate": -1.0})
    with pytest.raises(ValueError, match=r"^parameter 'jitter' must be one of beam_repetition_ra"):
        behaviour.changed({"jitter": 0.7})
    with pytest.raises(
        ValueError, match=r"^trip_recovery_min = 90\.0 must be at most recovery_max"
    ):
        behaviour.changed({"trip_recovery_min": 90.0})
    with pytest.raises(ValueError, match=r"^phase_tolerance = inf must be from"):
        behaviour.changed({"phase_tolerance": math.inf})


def test_single_parameters_override_the_mode() -> None:
    machine = SimulatedMachine("toy", "ideal", seed=0, parameters={"beam_shots": 7})
    assert machine.behaviour.beam.shots == 7
    evaluation = machine.start_evaluation({"x1": 0.0, "x2": 0.0})
    machine.step(1.0)
    assert evaluation.result is not None
    assert evaluation.result.shots == 7


@pytest.mark.parametrize("mode", list(Mode))
def test_equal_seeds_give_equal_runs(mode: Mode) -> None:
    def run(seed: int) -> list[dict[str, float]]:
        machine = SimulatedMachine("awa", mode, seed=seed)
        shots: list[dict[str, float]] = []
        for k in range(3):
            setpoint = {**machine.setpoint, "K1": 450.0 + 10.0 * k}
            machine.start_evaluation(setpoint, None, lambda shot: shots.append(dict(shot.measured)))
            machine.step(700.0)
            machine.readbacks()
        return shots

    assert repr(run(4)) == repr(run(4))
    if mode is not Mode.IDEAL:
        assert repr(run(4)) != repr(run(5))


def test_in_nominal_equal_seeds_agree_statistically_however_time_is_cut() -> None:
    """Who looks at the readbacks and the beam in between changes the run, but not its statistics."""

    def emittances(looks: bool, **parameters: float) -> list[float]:
        values = []
        for seed in range(100):
            machine = SimulatedMachine("awa", Mode.NOMINAL, seed=seed, parameters=parameters)
            evaluation = machine.start_evaluation({**machine.setpoint, "K1": 440.0}, 3)
            while evaluation.result is None:
                machine.step(0.7 if looks else 700.0)
                if looks:
                    machine.readbacks()
                    machine.free_shot()
            values += [d.value for d in evaluation.result.diagnostics if d.name == "eps_x"]
        return values

    alone, watched = emittances(looks=False), emittances(looks=True)
    assert alone != watched
    assert ks_2samp(alone, watched).pvalue > 0.05
    # The comparison is sharp enough to see a machine that is noisier, or that stands elsewhere.
    assert ks_2samp(alone, emittances(looks=True, beam_noise_scale=4.0)).pvalue < 1e-3
    assert ks_2samp(alone, emittances(looks=True, beam_charge=44.0)).pvalue < 1e-3

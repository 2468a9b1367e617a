"""The parameters of the tuner's node, beside those of the problem: the run's and the method's.

The method's are the choices of `OptimizerSettings`, by the same names. What is not given is as the
preset says, so that the node's parameters always tell the method in use.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from mobo_tuner.core.acquisition_optimizer import MAXIMIZERS
from mobo_tuner.core.settings import CHOICES, PRESETS, OptimizerSettings, make_settings
from mobo_tuner.errors import ParameterError
from mobo_tuner.parameter_file import check_section, flat
from mobo_tuner.parameter_spec import ParameterSpec, specs_of
from mobo_tuner.runs.history import INPUTS, MODEL, OUTPUTS

_FALLBACKS = ("hold", "restore", "restore_anyway", "best")
_OBSTACLES = ("wait", "retry", "pause", "abort")
MAXIMIZER_SETTINGS = "maximizer_settings."
"""What the names of the maximiser's settings begin with."""

TUNER = (
    ParameterSpec(
        "preset",
        "default",
        "Choices of the method that are not given: the best recipe known, or the paper's.",
        choices=tuple(PRESETS),
    ),
    ParameterSpec("seed", 0, "Seed of the random number generators.", minimum=0, maximum=2**31 - 1),
    ParameterSpec(
        "evaluations",
        60,
        "Budget of a run whose goal names none; set during a run, it is that run's budget.",
        minimum=1,
        maximum=100_000,
        writable=True,
    ),
    ParameterSpec(
        "hypervolume_goal",
        0.0,
        "Hypervolume at which a run ends whose goal names none; 0 = none.",
        minimum=0.0,
    ),
    ParameterSpec(
        "stop_after",
        0.0,
        "Time from the start of a run after which it makes no further evaluation [s]; 0 = no limit.",
        minimum=0.0,
        maximum=31_536_000.0,
        writable=True,
    ),
    ParameterSpec(
        "stop_without_gain",
        0,
        "Measured evaluations after the initial design that end a run if none of them raises the "
        "hypervolume by more than 0.1 %; 0 = never.",
        minimum=0,
        maximum=100_000,
        writable=True,
    ),
    ParameterSpec(
        "stop_below_expected_gain",
        0.0,
        "Gain of hypervolume that the models expect of the next evaluation [%]: a run ends if three "
        "suggestions in a row promise less; 0 = never.",
        minimum=0.0,
        maximum=100.0,
        writable=True,
    ),
    ParameterSpec(
        "model_input",
        "setpoint",
        "Values of the variables from which the models learn: set-points or readbacks.",
        choices=("setpoint", "readback"),
    ),
    ParameterSpec(
        MODEL,
        "",
        "Model that predicts the machine, from which the models of the run learn the difference: "
        "PACKAGE:FUNCTION or FILE.py:FUNCTION, a file of torch (.pt, .ts, .pt2), or the folder of a run or "
        "campaign; empty = none.",
    ),
    ParameterSpec(
        INPUTS,
        "",
        "Inputs of that model in its order, such as K1, K2, charge=40: variables, and constants with their "
        "values; empty = all variables.",
    ),
    ParameterSpec(
        OUTPUTS,
        "",
        "Quantities that it predicts, in its order; empty = all objectives and constrained diagnostics.",
    ),
    ParameterSpec(
        "shots",
        0,
        "Shots that an evaluation averages; 0 = as many as the machine decides.",
        minimum=0,
        maximum=10_000,
    ),
    ParameterSpec(
        "runs_dir", "runs", "Folder in which runs are kept, relative to the working folder."
    ),
    ParameterSpec(
        "journal", True, "Whether runs are kept; without a journal they cannot be resumed."
    ),
    ParameterSpec(
        "discovery_timeout",
        10.0,
        "Longest time to wait for the machine at the start of a run [s].",
        minimum=0.1,
        maximum=3600.0,
    ),
    ParameterSpec(
        "machine_timeout",
        5.0,
        "Silence of the machine (no feedback, no result) after which it counts as lost [s].",
        minimum=0.5,
        maximum=3600.0,
    ),
    ParameterSpec(
        "suggestion_timeout",
        300.0,
        "Longest time of one suggestion before the run ends with an error [s].",
        minimum=1.0,
        maximum=86_400.0,
    ),
    ParameterSpec(
        "evaluation_timeout",
        900.0,
        "Longest time of one evaluation [s].",
        minimum=1.0,
        maximum=86_400.0,
    ),
    ParameterSpec(
        "max_consecutive_failures",
        10,
        "Failed evaluations in a row after which the run ends with an error.",
        minimum=1,
        maximum=100_000,
    ),
    ParameterSpec(
        "on_failure",
        "skip",
        "After a failed evaluation: repeat it, learn from it and continue, ask an operator which of these, "
        "pause before the next one, or end the run.",
        choices=("retry", "skip", "ask", "pause", "abort"),
    ),
    ParameterSpec(
        "max_attempts",
        3,
        "Attempts at an evaluation if on_failure, on_interlock or on_fault is retry.",
        minimum=1,
        maximum=1000,
    ),
    ParameterSpec(
        "retry_delay",
        1.0,
        "Delay before the first retry [s]; doubles on each further retry, up to 60 s.",
        minimum=0.0,
        maximum=60.0,
    ),
    ParameterSpec(
        "on_interlock",
        "wait",
        "While the machine forbids to move: wait, repeat the attempt, pause, or end the run.",
        choices=_OBSTACLES,
    ),
    ParameterSpec(
        "interlock_timeout",
        1800.0,
        "Longest wait until the machine allows to move, before the run ends with an error [s].",
        minimum=0.0,
        maximum=604_800.0,
    ),
    ParameterSpec(
        "on_fault",
        "wait",
        "While the machine is lost: wait, repeat the attempt, pause, or end the run.",
        choices=_OBSTACLES,
    ),
    ParameterSpec(
        "machine_return_timeout",
        300.0,
        "Longest wait until a lost machine is back, before the run ends with an error [s].",
        minimum=0.0,
        maximum=604_800.0,
    ),
    ParameterSpec(
        "on_recorder_lost",
        "continue",
        "When the recorder or the journal fails: continue (waiting for the journal), or pause.",
        choices=("continue", "pause"),
    ),
    ParameterSpec(
        "on_end",
        "hold",
        "Where the tuner sends the machine after a run that reached what it was asked for, or that an "
        "operator stopped.",
        choices=_FALLBACKS,
    ),
    ParameterSpec(
        "on_abort",
        "hold",
        "Where the tuner sends the machine after a cancel, a stop or an error.",
        choices=_FALLBACKS,
    ),
    ParameterSpec(
        "on_violation",
        "hold",
        "Where the machine goes when a critical constraint is violated.",
        choices=_FALLBACKS,
    ),
    ParameterSpec(
        "on_client_lost",
        "hold",
        "Where the machine goes when the tuner's heartbeat stops.",
        choices=_FALLBACKS,
    ),
    ParameterSpec(
        "pause_on_violation",
        False,
        "Whether a run pauses after a violation until an operator resumes or steps it.",
    ),
    ParameterSpec(
        "client_timeout",
        5.0,
        "Silence of the tuner's heartbeat after which the machine counts it as lost [s]; 0 = never.",
        minimum=0.0,
        maximum=3600.0,
    ),
)


def tuner_specs(given: Mapping[str, Any], where: str = "") -> tuple[ParameterSpec, ...]:
    """Return all parameters of the tuner's node, with the defaults that suit what is given.

    Args:
        given: Parameters by name; its preset and maximiser decide about the rest.
        where: Text that precedes the names in an error.

    Raises:
        ParameterError: If the preset or the maximiser is not allowed.
    """
    preset = TUNER[0].check(given.get("preset", TUNER[0].default), where)
    settings = PRESETS[str(preset)]
    method = {
        spec.name: replace(spec, default=getattr(settings, spec.name))
        for spec in specs_of(OptimizerSettings)
    }
    chosen = method["maximizer"]
    name = str(chosen.check(given.get("maximizer", chosen.default), where))
    return (*TUNER, *method.values(), *specs_of(MAXIMIZERS.find(name), MAXIMIZER_SETTINGS))


def check_tuner(section: Mapping[str, Any]) -> dict[str, Any]:
    """Check the tuner's section of a file; defaults fill what is not given.

    Raises:
        UserError: If a parameter is unknown, of another type or not allowed, or two do not go
            together.
    """
    specs = tuner_specs(dict(flat(section)), "tuner.")
    return with_method(check_section("tuner", section, specs))


def with_method(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return checked parameters with the maximiser's settings as one mapping.

    Raises:
        ProblemError: If two choices do not go together.
    """
    single = {n: v for n, v in values.items() if not n.startswith(MAXIMIZER_SETTINGS)}
    settings = {
        n.removeprefix(MAXIMIZER_SETTINGS): v
        for n, v in values.items()
        if n.startswith(MAXIMIZER_SETTINGS)
    }
    choices = {n: v for n, v in single.items() if n in CHOICES} | {"maximizer_settings": settings}
    return single | make_settings(single["preset"], choices).to_dict()


@dataclass
class TunerParameters:
    """The tuner's parameters that its node reads; `values` has those of the optimiser, too.

    The attributes are the parameters of the same names in `TUNER`; some change while the node runs.
    """

    values: dict[str, Any]
    evaluations: int
    hypervolume_goal: float
    stop_after: float
    stop_without_gain: int
    stop_below_expected_gain: float
    model_input: str
    shots: int
    runs_dir: str
    journal: bool
    discovery_timeout: float
    machine_timeout: float
    suggestion_timeout: float
    evaluation_timeout: float
    max_consecutive_failures: int
    on_failure: str
    max_attempts: int
    retry_delay: float
    on_interlock: str
    interlock_timeout: float
    on_fault: str
    machine_return_timeout: float
    on_recorder_lost: str
    on_end: str
    on_abort: str
    on_violation: str
    on_client_lost: str
    pause_on_violation: bool
    client_timeout: float

    @classmethod
    def from_values(cls, values: Mapping[str, Any]) -> TunerParameters:
        """Take them from the values of all parameters in `TUNER`.

        Raises:
            ParameterError: If runs must be kept and no folder is named.
        """
        if values["journal"] and not values["runs_dir"]:
            raise ParameterError(
                "runs_dir is empty; it must name the folder in which runs are kept, "
                "unless journal is false"
            )
        names = [field.name for field in fields(cls) if field.name != "values"]
        return cls(dict(values), **{name: values[name] for name in names})

    def update(self, changes: Mapping[str, Any]) -> None:
        """Change some parameters while the node runs."""
        self.values.update(changes)
        for name, value in changes.items():
            setattr(self, name, value)

    def run_dir(self, run_id: str) -> Path | None:
        """Return the folder in which a run is kept; None if runs are not kept."""
        return Path(self.runs_dir) / run_id if self.journal else None

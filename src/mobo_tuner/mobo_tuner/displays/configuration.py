"""What a parameter file means, in plain lines for people."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from mobo_tuner.core.derived import Derived
from mobo_tuner.core.fidelity import Fidelity
from mobo_tuner.core.problem import Constraint, Context, Limit, Objective, Problem, Variable
from mobo_tuner.machine.description import MachineDescription
from mobo_tuner.wording import counted

_FALLBACKS = {
    "hold": "holds where it is",
    "restore": "goes back to where it was before the run",
    "restore_anyway": "goes back to where it was before the run, also outside the bounds",
    "best": "goes to the best point found",
}
_EVENTS = {
    "on_end": "after a run that ends well",
    "on_abort": "after a cancel or an error",
    "on_violation": "after a shot beyond a critical limit",
    "on_client_lost": "if the tuner is lost",
}


@dataclass(frozen=True)
class Configuration:
    """A parameter file that was checked.

    Attributes:
        path: Path of the file.
        problem: Problem that it tunes.
        tuner: Parameters of the tuner, defaults included.
        section: Section that chooses the machine; empty if none does.
        machine: Description of the machine; None if it is known only when the run begins.
        program: Command that starts the machine; empty if there is none.
        simulation: Command of the simulation that a campaign optimises in place of a machine; empty if
            there is none.
    """

    path: str
    problem: Problem
    tuner: Mapping[str, Any]
    section: str
    machine: MachineDescription | None
    program: str
    simulation: str = ""


def explanation(configuration: Configuration) -> list[str]:
    """Return what a run with this file is about, in lines for people."""
    problem = configuration.problem
    lines = [f"{configuration.path} is good; a run with it means:"]
    lines += _entry("machine", _machine(configuration))
    lines += _entry("variables", _table(map(_variable, problem.variables)))
    if problem.limits:
        lines += _entry("limits", _table(map(_limit, problem.limits)))
    if problem.derived:
        lines += _entry("derived", _table(map(_derived, problem.derived)))
    lines += _entry("objectives", _table(map(_objective, problem.objectives)))
    lines += _entry("constraints", _table(map(_constraint, problem.constraints)) or ["none"])
    observables = ", ".join(
        _quantity(o.name, f"[{o.unit}]" if o.unit else "") for o in problem.observables
    )
    lines += _entry("observables", [observables or "none"])
    if problem.context:
        lines += _entry("context", _table(map(_context, problem.context)))
    if problem.fidelity:
        lines += _entry("fidelity", _fidelity(problem.fidelity))
    lines += _entry("method", [_method(configuration.tuner)])
    lines += _entry("budget", [_budget(configuration.tuner)])
    lines += _entry("ends early", _stops(configuration.tuner) or ["never"])
    lines += _entry("at the end", _ends(configuration))
    lines += _entry("time", [_time(configuration)])
    return lines


def _machine(configuration: Configuration) -> list[str]:
    machine = configuration.machine
    if machine is not None:
        return [
            f"{machine.name}, served by the node '{configuration.section}', which the run starts",
            f"{counted(len(machine.variables), 'variable')}, {counted(len(machine.diagnostics), 'diagnostic')}",
        ]
    if configuration.simulation and not configuration.program:
        return [
            f"none; 'mobo.py campaign' optimises the simulation '{configuration.simulation}' instead"
        ]
    asked = "it is asked what it can do when the run begins"
    if configuration.program:
        return [f"the program '{configuration.program}', which the run starts; {asked}"]
    return [f"one that is there already, in the ROS domain of the run; {asked}"]


def _variable(variable: Variable) -> tuple[str, str]:
    if variable.is_open:
        return variable.name, _open(variable)
    values = variable.values
    if values is None:
        bounds = f"{variable.minimum:g} to {variable.maximum:g}"
    elif variable.fixed is not None:
        bounds = f"fixed at {variable.shown(variable.fixed)}"
    elif variable.choices:
        bounds = f"one of {', '.join(map(variable.shown, values.tolist()))}"
        if variable.choice_names:
            numbers = ", ".join(f"{value:g}" for value in values)
            bounds += f", without an order; the machine takes {numbers} for them"
    else:
        bounds = f"{values[0]:g} to {values[-1]:g}"
    text = _quantity(bounds, variable.unit)
    if variable.step and variable.fixed is None:
        text += f", in steps of {variable.step:g}"
    return variable.name, text + (", logarithmic" if variable.scale == "log" else "")


def _fidelity(fidelity: Fidelity) -> list[str]:
    targets = zip(fidelity.variables, fidelity.targets, strict=True)
    rows = [
        (name, f"{text}; the highest is {target:g}")
        for (name, text), target in ((_variable(v), target) for v, target in targets)
    ]
    cheapest = f"{fidelity.shares[:-1].min():.3g} of the highest at least"
    return _table([*rows, ("cost", f"{fidelity.cost.formula}; {cheapest}")])


def _open(variable: Variable) -> str:
    if variable.at_present:
        return "fixed where the machine is at the start of a run"
    around = variable.around
    width = f"{around} of its range" if isinstance(around, str) else f"{around:g} {variable.unit}"
    return f"{width.rstrip()} around where the machine is at the start of a run, within its limits"


def _limit(limit: Limit) -> tuple[str, str]:
    terms = " + ".join(f"{coefficient:g} {name}" for name, coefficient in limit.coefficients)
    return limit.name, f"{terms} {_ends_of(limit)}"


def _derived(derived: Derived) -> tuple[str, str]:
    return derived.name, _quantity(derived.formula, f"[{derived.unit}]" if derived.unit else "")


def _objective(objective: Objective) -> tuple[str, str]:
    reference = _quantity(f"{objective.reference:g}", objective.unit)
    if math.isinf(objective.reference):
        reference = "inferred from the first evaluations"
    text = f"{objective.direction}, reference {reference}"
    if objective.goal is not None:
        text += f", good enough from {_quantity(f'{objective.goal:g}', objective.unit)}"
    elif objective.truncation is not None:
        low, high = objective.truncation
        text += f", truncated to {_quantity(f'{low:g} to {high:g}', objective.unit)}"
    return objective.name, text


def _constraint(constraint: Constraint) -> tuple[str, str]:
    text = _ends_of(constraint)
    critical = ", critical: one shot beyond it ends the evaluation" if constraint.critical else ""
    safe = f", believed with {constraint.safe:g} at every suggestion" if constraint.safe else ""
    return constraint.name, _quantity(text, constraint.unit) + critical + safe


def _context(context: Context) -> tuple[str, str]:
    expected = "expected in the range that is measured"
    if math.isfinite(context.maximum - context.minimum):
        expected = f"expected from {context.minimum:g} to {context.maximum:g}"
    return context.name, f"measured, not set; {_quantity(expected, context.unit)}"


def _ends_of(limit: Constraint | Limit) -> str:
    low, high = limit.minimum, limit.maximum
    if math.isfinite(low) and math.isfinite(high):
        return f"{low:g} to {high:g}"
    return f"at least {low:g}" if math.isfinite(low) else f"at most {high:g}"


def _method(tuner: Mapping[str, Any]) -> str:
    method = f"preset {tuner['preset']}, acquisition function {tuner['acquisition']}"
    model = tuner["prior_mean.model"]
    return f"{method}, prior mean by {model}" if model else method


def _budget(tuner: Mapping[str, Any]) -> str:
    initial = tuner["initial_evaluations"]
    return counted(tuner["evaluations"], "evaluation") + (
        f", the first {initial} spread over the bounds" if initial else ""
    )


def _stops(tuner: Mapping[str, Any]) -> list[str]:
    lines = []
    if tuner["hypervolume_goal"]:
        lines.append(f"at a hypervolume of {tuner['hypervolume_goal']:g}")
    if tuner["stop_after"]:
        lines.append(f"after {_duration(tuner['stop_after'])}")
    if tuner["stop_without_gain"]:
        lines.append(f"after {counted(tuner['stop_without_gain'], 'evaluation')} without a gain")
    if tuner["stop_below_expected_gain"]:
        lines.append(
            f"when less than {tuner['stop_below_expected_gain']:g} % is expected of the next evaluation"
        )
    return lines


def _ends(configuration: Configuration) -> list[str]:
    tuner, problem = configuration.tuner, configuration.problem
    lines = []
    for event, when in _EVENTS.items():
        if event == "on_violation" and not any(c.critical for c in problem.constraints):
            continue
        lines.append(
            f"{when} the machine {_FALLBACKS[str(tuner[event])]} ({event}: {tuner[event]})"
        )
    return lines


def _time(configuration: Configuration) -> str:
    machine = configuration.machine
    if machine is None or machine.evaluation_seconds is None:
        return "not known before the run begins"
    each = machine.evaluation_seconds
    whole, limit = configuration.tuner["evaluations"] * each, configuration.tuner["stop_after"]
    if 0.0 < limit < whole:
        return (
            f"{_duration(limit)}, enough for about {counted(limit // each, 'evaluation')} of "
            f"{_duration(each)} less the time of the suggestions"
        )
    return (
        f"about {_duration(whole)} at the machine, {_duration(each)} per evaluation; "
        "the time of the suggestions comes on top"
    )


def _entry(title: str, lines: Sequence[str]) -> list[str]:
    first, *others = lines
    return [f"  {title:<12} {first}", *(f"  {'':<12} {line}" for line in others)]


def _table(rows: Iterable[tuple[str, str]]) -> list[str]:
    rows = list(rows)
    width = max((len(name) for name, _ in rows), default=0)
    return [f"{name:<{width}}  {text}" for name, text in rows]


def _quantity(value: str, unit: str) -> str:
    return f"{value} {unit}".rstrip()


def _duration(seconds: float) -> str:
    if seconds < 100.0:
        return f"{seconds:.2g} s"
    if seconds < 6000.0:
        return f"{seconds / 60.0:.0f} min"
    return f"{seconds / 3600.0:.1f} h"

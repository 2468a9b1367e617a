"""A parameter file to begin with, written from what a machine has."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import yaml

from mobo_tuner.errors import UserError
from mobo_tuner.machine.description import MachineDescription, VariableLimits


def template(
    machine: MachineDescription,
    *,
    minimize: Sequence[str] = (),
    maximize: Sequence[str] = (),
    around: str = "",
    section: str = "",
    parameters: Mapping[str, Any] | None = None,
    how: str = "",
) -> str:
    """Return a commented parameter file that is good as it is and can be edited.

    Without objectives, the first diagnostic is one, and the others wait as comments.

    Args:
        machine: What the machine has.
        minimize: Diagnostics that are minimised.
        maximize: Diagnostics that are maximised.
        around: Distance of the bounds from the present value, such as "10 %"; empty = the machine's limits.
        section: Section that chooses the machine; empty if none does.
        parameters: Parameters of that section.
        how: Options of `mobo.py run` that choose the machine; empty if none are needed.

    Raises:
        UserError: If an objective is not a diagnostic of the machine, or given twice, or it has none.
    """
    chosen = [*minimize, *maximize]
    for name in chosen:
        if name not in machine.diagnostics:
            raise UserError(
                f"the objective '{name}' is not one of the machine's diagnostics: "
                f"{', '.join(machine.diagnostics)}"
            )
        if chosen.count(name) > 1:
            raise UserError(f"the objective '{name}' is given twice; once is allowed")
    if not machine.diagnostics or not machine.variables:
        raise UserError(f"'{machine.name}' has no variables or no diagnostics to tune")
    chosen = chosen or [next(iter(machine.diagnostics))]
    others = [name for name in machine.diagnostics if name not in chosen]
    lines = [
        f"# For {_one_line(machine.name)}. `python3 mobo.py check FILE` says what this file means, and",
        f"# `python3 mobo.py run --config FILE{how and ' ' + how}` runs it. docs/parameters.md has all parameters.",
        "/**:",
        "  ros__parameters:",
        "    # What is changed: within the machine's limits, or in a narrower range of yours. Also possible:",
        '    #   around: "10 %" (of its range around the present value, or a number), step: 0.5, choices: [1.0, 2.0],',
        "    #   choices: [foil, mesh] (names without an order), scale: log, fixed: 20.0, fixed: present",
        "    variables:",
        *_entries({n: _variable(v, around) for n, v in machine.variables.items()}),
        "    # What is wanted. Without a reference (the worst value of interest, e.g. reference: 25.0), it is inferred",
        "    # from the first evaluations. Better is less with direction: minimize, more with maximize. What is good",
        "    # enough may be a goal, e.g. goal: 5.0.",
        "    objectives:",
        *_entries({n: _objective(n in maximize, machine.diagnostics[n]) for n in chosen}),
        *_comments(
            _entries({n: _objective(False, machine.diagnostics[n]) for n in others}),
        ),
        "    # What must hold: min, max or both.",
        "    # constraints:",
        *_comments(_entries({n: {"max": 1.0} for n in others[:1]})),
        "    # What is computed: a formula over diagnostics and variables, for use as one of the others.",
        "    # derived:",
        f'    #   name: {{formula: "sqrt({_example(machine)})"}}',
    ]
    if others:
        lines += [
            "    # What is only recorded.",
            "    observables:",
            *_entries({n: {"unit": machine.diagnostics[n]} for n in others}),
        ]
    lines += [
        "",
        "/**/tuner:",
        "  ros__parameters:",
        "    evaluations: 60",
        "    # hypervolume_goal: 0.0       # ends earlier; so do stop_after [s] and stop_without_gain [evaluations]",
        "    # on_end: hold                # hold, restore or best; also on_abort",
        "    # seed: 1",
    ]
    if section:
        text = yaml.safe_dump(dict(parameters or {}), sort_keys=False, allow_unicode=True)
        lines += ["", f"/**/{section}:", "  ros__parameters:"]
        lines += [f"    {line}" for line in text.splitlines()]
    return "\n".join(lines) + "\n"


def _variable(limits: VariableLimits, around: str) -> dict[str, Any]:
    if limits.words:
        return {"choices": list(limits.words), "unit": limits.unit}
    if around:
        return {"around": _number(around), "unit": limits.unit}
    return {"min": limits.minimum, "max": limits.maximum, "unit": limits.unit}


def _number(text: str) -> float | str:
    """Return a number, or a text that is none as it is; the check of the file judges it."""
    try:
        return float(text)
    except ValueError:
        return text


def _objective(maximized: bool, unit: str) -> dict[str, Any]:
    return {"direction": "maximize" if maximized else "minimize", "unit": unit}


def _entries(entries: Mapping[str, Mapping[str, Any]]) -> list[str]:
    given = {n: {key: v for key, v in entry.items() if v != ""} for n, entry in entries.items()}
    return [f"      {_flow(name)}: {_flow(entry)}" for name, entry in given.items()]


def _flow(value: object) -> str:
    """Return a value as YAML on one line."""
    text = yaml.safe_dump(
        value, default_flow_style=True, sort_keys=False, allow_unicode=True, width=10**6
    )
    return text.removesuffix("...\n").strip()


def _comments(lines: Sequence[str]) -> list[str]:
    return [f"    # {line[4:]}" for line in lines]


def _example(machine: MachineDescription) -> str:
    names = [name if name.isidentifier() else f"`{name}`" for name in machine.diagnostics]
    return " * ".join((names * 2)[:2])


def _one_line(text: str) -> str:
    return " ".join(text.split()) or "a machine without a name"

"""Checks of a machine's goals before anything moves."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from mobo_msgs_py import msg
from mobo_msgs_py.action import ApplySetpoint, EvaluateSetpoint

MOST_SHOWN = 80  # characters of a received string in an error message


def check_setpoint(
    named: Sequence[msg.NamedValue], variables: Sequence[msg.Variable], what: str = "set-point"
) -> dict[str, float]:
    """Check a set-point and return its values in the machine's order.

    Args:
        named: Values, which must contain every variable once, within its limits, in its unit or
            without a unit.
        variables: Variables of the machine.
        what: Name of the set-point in messages.

    Raises:
        ValueError: If the set-point is not allowed; the message is one sentence.
    """
    given = _by_name(named, what, "a variable")
    names = [variable.name for variable in variables]
    unknown = [name for name in given if name not in names]
    if unknown:
        raise ValueError(
            f"{what} names {_shown(unknown[0])}, but the machine's variables are {', '.join(names)}"
        )
    missing = [name for name in names if name not in given]
    if missing:
        raise ValueError(
            f"{what} lacks {missing[0]!r}; it must name all of the variables {', '.join(names)}"
        )
    for variable in variables:
        item = given[variable.name]
        _check_unit(item, variable, what)
        if not (math.isfinite(item.value) and variable.min <= item.value <= variable.max):
            unit = f" {variable.unit}" if variable.unit else ""
            raise ValueError(
                f"{what} {item.name} = {item.value:g}{unit} is outside the machine's limits, "
                f"{variable.min:g} to {variable.max:g}{unit}"
            )
    return {name: given[name].value for name in names}


def check_move(
    goal: ApplySetpoint.Goal, variables: Sequence[msg.Variable]
) -> list[dict[str, float]]:
    """Check the set-points of a move and return them, in the order in which the machine goes to them.

    Raises:
        ValueError: If one is not allowed; the message is one sentence.
    """
    via = [check_setpoint(goal.via, variables, "via")] if goal.via else []
    return [*via, check_setpoint(goal.setpoint, variables)]


def check_evaluation(
    goal: EvaluateSetpoint.Goal,
    variables: Sequence[msg.Variable],
    diagnostics: Sequence[msg.Observable],
    max_shots: int,
) -> dict[str, float]:
    """Check the parts of a goal that do not depend on the machine's state; return its set-point.

    Raises:
        ValueError: If something is not allowed; the message is one sentence.
    """
    setpoint = check_setpoint(goal.setpoint, variables)
    for what in ("if_client_lost", "if_violated"):
        for name in (what, f"{what}_via"):
            if getattr(goal, name):
                check_setpoint(getattr(goal, name), variables, name)
    if goal.shots > max_shots:
        raise ValueError(f"shots = {goal.shots} must be from 0 to {max_shots}")
    _check_critical(goal.critical, diagnostics)
    if not (math.isfinite(goal.client_timeout) and goal.client_timeout >= 0.0):
        raise ValueError(f"client_timeout = {goal.client_timeout:g} must be finite and at least 0")
    if goal.client_timeout > 0.0 and not goal.run_id:
        raise ValueError("run_id is empty; with a client_timeout it must name the heartbeat's run")
    return setpoint


def _check_critical(
    critical: Sequence[msg.Constraint], diagnostics: Sequence[msg.Observable]
) -> None:
    known = {diagnostic.name: diagnostic for diagnostic in diagnostics}
    for limit in _by_name(critical, "critical", "a diagnostic").values():
        if limit.name not in known:
            raise ValueError(
                f"critical names {_shown(limit.name)}, but the machine's diagnostics are "
                f"{', '.join(known)}"
            )
        _check_unit(limit, known[limit.name], "critical")
        if not limit.min <= limit.max:  # also where one of them is NaN
            raise ValueError(
                f"critical {limit.name} has min = {limit.min:g} and max = {limit.max:g}; min must "
                "not be above max"
            )


def _by_name(items: Iterable, what: str, kind: str) -> dict:
    """Return items by name.

    Raises:
        ValueError: If a name occurs twice.
    """
    by_name: dict = {}
    for item in items:
        if item.name in by_name:
            raise ValueError(f"{what} names {kind} twice: {_shown(item.name)}")
        by_name[item.name] = item
    return by_name


def _shown(text: str) -> str:
    """Return a received string, quoted and with limited length."""
    return repr(text[:MOST_SHOWN])


def _check_unit(
    given: msg.NamedValue | msg.Constraint, known: msg.Variable | msg.Observable, what: str
) -> None:
    if given.unit and given.unit != known.unit:
        unit = f"{known.unit!r}" if known.unit else "none"
        raise ValueError(
            f"{what} {given.name} is in {_shown(given.unit)}; the machine's unit is {unit}"
        )

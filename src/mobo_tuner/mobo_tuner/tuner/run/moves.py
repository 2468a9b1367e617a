"""Moves that are not part of an evaluation: from which side they come, and what is kept of them."""

from __future__ import annotations

from collections.abc import Mapping

from mobo_tuner.runs.records import MoveRecord, StateRecord
from mobo_tuner.tuner.context import TunerContext
from mobo_tuner.tuner.gate import BoundsError, Gate, Target
from mobo_tuner.tuner.run.run import Run

_AWAY = "the side from which it should be approached is out of bounds"


def approached(target: Target, run: Run, index: int, gate: Gate) -> Target:
    """Return a target that is reached from the side from which its evaluation was, for hysteresis.

    Args:
        target: Set-point of the evaluation.
        run: Run of the evaluation.
        index: Index of the evaluation.
        gate: The way to the machine, whose problem says which variables are approached from how far.

    Returns:
        The target with the side as `via`; with the reason as `straight` if that side is unknown or the machine may not
        go there; the target itself if nothing has to be approached.
    """
    earlier = run.records[index - 1][1].setpoint if index else run.state_before or {}
    via = dict(target.setpoint)
    for variable in gate.bounds.variables:
        if variable.approach and variable.name not in earlier:
            return target._replace(straight=f"from where evaluation {index} came is unknown")
        if variable.approach:
            back = earlier[variable.name] - via[variable.name]
            place = via[variable.name] + min(max(back, -variable.approach), variable.approach)
            via[variable.name] = variable.nearest(place)
    if via == target.setpoint:
        return target
    beside = target._replace(via=via)
    try:
        gate.check(beside)
    except BoundsError as error:
        return target._replace(straight=f"{_AWAY}: {error}")
    return beside


def keep_move(
    context: TunerContext,
    run: Run,
    target: Target,
    purpose: str,
    by: str,
    evaluation: int | None = None,
) -> None:
    """Keep where the machine is sent, before it moves, in the journal and on the topic `run_records`.

    Args:
        context: The tuner's node and what works in it.
        run: Run to which the move belongs; it may have ended.
        target: Where the machine is sent.
        purpose: Purpose of the move, as in `MoveRecord`.
        by: Who asks for it, as in `MoveRecord`.
        evaluation: Index of the evaluation whose set-point it is; None if it is that of none.

    Raises:
        OSError: If the way leads across the bounds and this cannot be kept.
    """
    crossing = target.anyway and not context.gate.allows(Target(target.setpoint))
    record = MoveRecord(
        context.stamp(), run.index, target.setpoint, purpose, by, evaluation, crossing, target.via
    )
    if crossing:
        context.log.warning(
            f"run '{run.run_id}': the machine is sent across the bounds, as {by} has said"
        )
    _keep(context, run, record, required=crossing)


def keep_state(
    context: TunerContext, run: Run, readbacks: Mapping[str, float], error_msg: str = ""
) -> None:
    """Keep where the machine is: when a run begins, or at the end of a move."""
    _keep(context, run, StateRecord(context.stamp(), run.index, readbacks, error_msg))


def _keep(
    context: TunerContext, run: Run, record: MoveRecord | StateRecord, *, required: bool = False
) -> None:
    try:
        run.log.append(record)
    except OSError as error:
        if required:
            raise
        context.log.warning(f"run '{run.run_id}': where the machine goes is not kept: {error}")
        return
    context.topics.run_records(run.records_message(context.now()))

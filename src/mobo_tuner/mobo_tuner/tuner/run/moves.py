"""What is kept of the moves that are not part of an evaluation: what was asked, by whom, where it ended."""

from __future__ import annotations

from collections.abc import Mapping

from mobo_tuner.runs.records import MoveRecord, StateRecord
from mobo_tuner.tuner.context import TunerContext
from mobo_tuner.tuner.gate import Target
from mobo_tuner.tuner.run.run import Run


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
        context.stamp(), run.index, target.setpoint, purpose, by, evaluation, crossing
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

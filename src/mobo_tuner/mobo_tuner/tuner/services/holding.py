"""Holding a working point against drift: local optimisation of a single objective around it."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from rclpy.task import Future

from mobo_msgs_py import msg
from mobo_msgs_py.action import GoToWorkingPoint
from mobo_tuner.runs.records import EvaluationRecord
from mobo_tuner.tuner.context import TunerContext
from mobo_tuner.tuner.run.loop import RunLoop
from mobo_tuner.tuner.run.run import Run, RunError
from mobo_tuner.tuner.run.start import start_holding


class Holding:
    """Carries out runs that start from a point of another run's front and stay around it.

    Args:
        context: The tuner's node and what works in it.
        loop: Carries out runs.
    """

    def __init__(self, context: TunerContext, loop: RunLoop) -> None:
        self._context = context
        self._loop = loop

    async def hold(
        self,
        run: Run,
        index: int,
        weights: Sequence[float],
        radius: float,
        evaluations: int,
        interrupt: Future,
        listener: Callable[[int], None],
    ) -> tuple[Run, int]:
        """Evaluate the point again, then look around it for a better one.

        The evaluations make up a run of their own. Each is also added to the first run and its journal,
        unless an ask/tell client owns it.

        Args:
            run: Run to whose front the point belongs; it has ended.
            index: Index of the point's evaluation.
            weights: Weights of the minimised objectives, whose sum is minimised.
            radius: Radius of the search around the point, as a share of each variable's range.
            evaluations: Number of evaluations to spend.
            interrupt: Done when the holding must stop.
            listener: Called with the number of evaluations spent, after each.

        Returns:
            Run and index of the best evaluation of those that were made now; those of the point itself if
            none was feasible.

        Raises:
            RunError: If the run did not end well.
        """
        named = dict(zip(run.problem.objective_names, weights, strict=True))
        point = dict(run.records[index][1].setpoint)
        focused = await self._context.worker.submit(
            run.optimizer.focus,
            index=index,
            weights=named,
            radius=radius,
            bounds=self._context.gate.bounds,
        )
        before = run.index
        try:
            held = start_holding(
                run,
                focused,
                evaluations,
                self._context.parameters,
                point=point,
                interrupt=interrupt,
                stamp=self._context.stamp(),
            )
        except OSError as error:  # such as a full disk
            raise RunError(GoToWorkingPoint.Result.INVALID_GOAL, str(error)) from None

        if not run.by_client:
            held.holds = run

        def count(record: EvaluationRecord, _: msg.Evaluation) -> None:
            listener(record.index + 1 - before)

        ending = await self._loop.carry_out(held, count)
        made = [record for _, record in held.records[before:]]
        if not run.log.retry():
            self._context.log.warning(
                f"run '{run.run_id}' lacks what was measured: {run.log.trouble}"
            )
        if ending.error_code:
            raise RunError(ending.error_code, ending.error_msg)
        best = _best(run, made, weights)
        return (run, index) if best is None else (held, best)


def _best(run: Run, records: Sequence[EvaluationRecord], weights: Sequence[float]) -> int | None:
    """Return the index of the evaluation with the least weighted sum among the feasible evaluations."""
    feasible = [record for record in records if record.feasible]
    if not feasible:
        return None
    objectives = run.problem.objectives
    sums = [
        np.dot(weights, [record.diagnostics[o.name][0] * o.sign for o in objectives])
        for record in feasible
    ]
    return feasible[int(np.argmin(sums))].index

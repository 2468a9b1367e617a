"""Holding a working point against drift: local optimisation of a single objective around it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from rclpy.task import Future

from mobo_msgs_py import msg
from mobo_tuner.core.dataset import Evaluation
from mobo_tuner.ros.conversions import seconds
from mobo_tuner.tuner.context import TunerParts
from mobo_tuner.tuner.run.keeper import RunKeeper
from mobo_tuner.tuner.run.run import Run, RunError
from mobo_tuner.tuner.run.start import start_holding


class Holding:
    """Carries out runs that start from a point of another run's front and stay around it.

    Args:
        parts: of the tuner's node.
        keeper: sees them through.
    """

    def __init__(self, parts: TunerParts, keeper: RunKeeper) -> None:
        self._parts = parts
        self._keeper = keeper

    async def hold(
        self,
        run: Run,
        index: int,
        weights: Sequence[float],
        radius: float,
        evaluations: int,
        interrupt: Future,
        tell: Callable[[int], None],
    ) -> Mapping[str, float]:
        """Evaluate the point again, then look around it for a better one.

        The evaluations make up a run of their own, and the first run learns of them, too, unless
        it is that of a client who alone says what it is told.

        Args:
            run: to whose front the point belongs; it has ended.
            index: of the point's evaluation.
            weights: of the minimised objectives, whose sum is minimised.
            radius: of the search around the point, as a share of each variable's range.
            evaluations: to be spent.
            interrupt: done when the holding shall stop.
            tell: is told how many are spent, after each.

        Returns:
            The best set-point of those that were evaluated now; the point itself where none was
            feasible.

        Raises:
            RunError: the run did not end as it should.
        """
        named = dict(zip(run.problem.objective_names, weights, strict=True))
        point = dict(run.optimizer.dataset.evaluations[index].setpoint)
        focused = await self._parts.worker.submit(
            run.optimizer.focus, index=index, weights=named, radius=radius
        )
        before = len(focused.dataset)
        held = start_holding(
            run,
            focused,
            evaluations,
            self._parts.parameters,
            point=point,
            interrupt=interrupt,
            stamp=seconds(self._parts.now()),
        )

        def told(message: msg.Evaluation) -> None:
            tell(message.index + 1 - before)

        ending = await self._keeper.see_through(held, told)
        made = focused.dataset.evaluations[before:]
        for evaluation in () if run.by_client else made:
            outputs = {n: (v, evaluation.stddevs[n]) for n, v in evaluation.values.items()}
            await self._parts.worker.submit(
                run.optimizer.tell, evaluation.setpoint, outputs, evaluation.readbacks
            )
        if ending.error_code:
            raise RunError(ending.error_code, ending.error_msg)
        return _best(run, made, weights) or point


def _best(
    run: Run, evaluations: Sequence[Evaluation], weights: Sequence[float]
) -> Mapping[str, float] | None:
    """The set-point with the least weighted sum among the feasible evaluations."""
    feasible = [e for e in evaluations if e.feasible]
    if not feasible:
        return None
    signed = [w * o.sign for w, o in zip(weights, run.problem.objectives, strict=True)]
    sums = [np.dot(signed, [e.values[n] for n in run.problem.objective_names]) for e in feasible]
    return feasible[int(np.argmin(sums))].setpoint

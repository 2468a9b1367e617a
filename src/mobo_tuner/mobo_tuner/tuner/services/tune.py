"""The `tune` action: one goal is one run, from its start to its result."""

from __future__ import annotations

from collections.abc import Callable

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.task import Future

from mobo_msgs_py import msg
from mobo_msgs_py.action import Tune
from mobo_tuner.core import Problem
from mobo_tuner.ros.conversions import seconds
from mobo_tuner.tuner.context import TunerParts
from mobo_tuner.tuner.run.keeper import RunKeeper
from mobo_tuner.tuner.run.run import Run
from mobo_tuner.tuner.run.start import start_run
from mobo_tuner.tuner.session import Session, read_run

CANCELED = "a client canceled it"


class TuneServer:
    """Serves `tune`, one run at a time.

    Args:
        parts: of the tuner's node.
        session: which a run takes.
        keeper: sees runs through.
        problem: gives what a run that begins tunes.
    """

    def __init__(
        self,
        parts: TunerParts,
        session: Session,
        keeper: RunKeeper,
        problem: Callable[[], Problem],
    ) -> None:
        self._parts = parts
        self._session = session
        self._keeper = keeper
        self._problem = problem
        self._server = ActionServer(
            parts.node,
            Tune,
            "tune",
            execute_callback=self._execute,
            goal_callback=lambda _: GoalResponse.ACCEPT,  # refused with a reason in `_execute`
            cancel_callback=self._cancel,
            result_timeout=10,
        )

    def _cancel(self, goal_handle: ServerGoalHandle) -> CancelResponse:
        run = self._session.run
        if run is not None and run.goal_id == bytes(goal_handle.goal_id.uuid):
            run.stop(CANCELED)
            self._parts.status.set(state=msg.TunerStatus.CANCELING)
        return CancelResponse.ACCEPT

    async def _execute(self, goal_handle: ServerGoalHandle) -> Tune.Result:
        """One run, from its goal to its result, which carries the front whatever happens."""
        try:
            run = await self._start(goal_handle)
        except (ValueError, OSError) as error:
            self._parts.log.warning(f"goal refused: {error}")
            goal_handle.abort()
            return Tune.Result(
                run_id=goal_handle.request.run_id,
                stop_reason="error",
                error_code=Tune.Result.INVALID_GOAL,
                error_msg=str(error),
            )
        self._session.latest = run
        if goal_handle.is_cancel_requested:  # canceled before it began
            run.stop(CANCELED)

        def tell(message: msg.Evaluation) -> None:
            goal_handle.publish_feedback(
                Tune.Feedback(evaluation=message, evaluations=run.index, budget=run.budget)
            )

        ending = await self._keeper.see_through(run, tell)
        if ending.error_code == Tune.Result.NONE:
            goal_handle.succeed()
        elif goal_handle.is_cancel_requested:
            goal_handle.canceled()
        else:
            goal_handle.abort()
        return Tune.Result(
            run_id=run.run_id,
            evaluations=run.index,
            pareto_front=run.front(self._parts.now()),
            **ending._asdict(),
        )

    async def _start(self, goal_handle: ServerGoalHandle) -> Run:
        """The run of a goal.

        Raises:
            ValueError, OSError: it cannot be served, with the reason.
        """
        goal: Tune.Goal = goal_handle.request
        if self._session.occupied:
            raise ValueError(self._session.occupied)
        earlier = None
        if goal.resume_from:
            earlier = await read_run(self._parts, self._session, goal.resume_from)
        return start_run(
            goal,
            self._problem(),
            self._parts.parameters,
            goal_id=bytes(goal_handle.goal_id.uuid),
            interrupt=Future(executor=self._parts.node.executor),
            stamp=seconds(self._parts.now()),
            earlier=earlier,
        )

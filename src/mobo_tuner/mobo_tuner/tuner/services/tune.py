"""The action `tune`: one goal is one run, from its start to its result."""

from __future__ import annotations

from mobo_msgs_py import msg
from mobo_msgs_py.action import Tune
from mobo_tuner.ros import interfaces
from mobo_tuner.ros.action_server import Goal
from mobo_tuner.runs.records import EvaluationRecord, StopReason
from mobo_tuner.tuner.context import TunerContext
from mobo_tuner.tuner.problem_parameters import ProblemParameters
from mobo_tuner.tuner.run.loop import RunLoop
from mobo_tuner.tuner.run.run import Run
from mobo_tuner.tuner.run.start import RunRequest, read_earlier, start_run
from mobo_tuner.tuner.session import Session

CANCELED = "a client canceled it"


class TuneServer:
    """Serves `tune`, one run at a time.

    Args:
        context: The tuner's node and what works in it.
        session: Session that a run occupies.
        loop: Carries out runs.
        parameters: Parameters of the problem.
    """

    def __init__(
        self,
        context: TunerContext,
        session: Session,
        loop: RunLoop,
        parameters: ProblemParameters,
    ) -> None:
        self._context = context
        self._session = session
        self._loop = loop
        self._parameters = parameters
        self._server = interfaces.TUNE.server(context.node, self._execute)

    async def _execute(self, goal: Goal) -> Tune.Result:
        """Carry out one run; its result has the front, whatever happens."""
        try:
            run = await self._start(goal.request)
        except (ValueError, OSError) as error:
            return Tune.Result(
                run_id=goal.request.run_id,
                stop_reason=StopReason.ERROR,
                error_code=Tune.Result.INVALID_GOAL,
                error_msg=str(error),
            )
        self._session.know(run)

        def cancel() -> None:
            run.stop(CANCELED)
            self._context.status.set(state=msg.TunerStatus.CANCELING)

        def listener(_: EvaluationRecord, message: msg.Evaluation) -> None:
            goal.publish_feedback(evaluation=message, evaluations=run.index, budget=run.budget)

        goal.on_cancel(cancel)
        ending = await self._loop.carry_out(run, listener)
        return Tune.Result(
            run_id=run.run_id,
            evaluations=run.index,
            pareto_front=run.front_message(self._context.now()),
            **ending._asdict(),
        )

    async def _start(self, request: Tune.Goal) -> Run:
        """Prepare the run of a goal.

        Raises:
            ValueError, OSError: If it cannot be served, with the reason.
        """
        self._session.check_free()
        earlier = None
        if request.resume_from:
            earlier = await read_earlier(self._context, self._session, request.resume_from)
        return start_run(
            RunRequest(request.run_id, request.evaluations, request.hypervolume_goal),
            self._parameters.problem,
            self._context.parameters,
            interrupt=self._context.future(),
            stamp=self._context.stamp(),
            earlier=earlier,
        )

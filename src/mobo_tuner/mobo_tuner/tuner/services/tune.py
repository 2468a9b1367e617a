"""The action `tune`: one goal is one run, from its start to its result."""

from __future__ import annotations

from mobo_msgs_py import msg
from mobo_msgs_py.action import Tune
from mobo_tuner.ros import interfaces
from mobo_tuner.ros.action_server import Goal
from mobo_tuner.runs.records import EvaluationRecord, StopReason
from mobo_tuner.tuner.context import TunerContext
from mobo_tuner.tuner.machine_client import MachineLostError
from mobo_tuner.tuner.problem_parameters import ProblemParameters
from mobo_tuner.tuner.run.loop import RunLoop
from mobo_tuner.tuner.run.run import Run, RunError
from mobo_tuner.tuner.run.start import (
    Earlier,
    RunRequest,
    read_earlier,
    read_prior,
    start_run,
)
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
        except (ValueError, OSError, RunError) as error:
            return Tune.Result(
                run_id=goal.request.run_id,
                stop_reason=StopReason.ERROR,
                error_code=getattr(error, "code", Tune.Result.INVALID_GOAL),
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
            ValueError, OSError, RunError: If it cannot be served, with the reason.
        """
        self._session.check_free()
        earlier = None
        if request.resume_from:
            earlier = await read_earlier(self._context, self._session, request.resume_from)
        if self._parameters.open_variables:
            await self._locate(earlier)
        prior = None
        if earlier is None:
            prior = await read_prior(self._context, self._session, self._parameters.problem)
        return start_run(
            RunRequest(request.run_id, request.evaluations, request.hypervolume_goal),
            self._parameters.problem,
            self._context.parameters,
            interrupt=self._context.future(),
            stamp=self._context.stamp(),
            earlier=earlier,
            prior=prior,
        )

    async def _locate(self, earlier: Earlier | None) -> None:
        """Resolve the variables whose bounds depend on where the machine is, or was for an earlier run.

        Raises:
            ProblemError: If they cannot be resolved.
            RunError: If the machine does not say where it is.
        """
        if earlier is not None:
            last = earlier.history.last_problem
            self._parameters.resolve(lambda problem: problem.resolved_as(last))
            return
        context, names = self._context, ", ".join(self._parameters.open_variables)
        present = None
        try:
            with self._session.locating():
                patience = context.parameters.discovery_timeout
                machine = await context.gate.describe(patience, context.stopping)
                if machine is not None:
                    present = await context.gate.where(context.stopping, patience=patience)
        except MachineLostError as error:
            raise RunError(
                Tune.Result.MACHINE_UNAVAILABLE, f"the bounds of {names} are not known: {error}"
            ) from None
        if machine is None or present is None:
            raise RunError(Tune.Result.CANCELED, "the tuner was asked to stop")
        limits = {v.name: (v.min, v.max) for v in machine.variables}
        at = present
        self._parameters.resolve(lambda problem: problem.resolved(at, limits))
        bounds = [
            f"{v.name} {v.minimum:g} to {v.maximum:g}"
            if v.fixed is None
            else f"{v.name} {v.fixed:g}"
            for v in self._parameters.problem.variables
            if v.name in self._parameters.open_variables
        ]
        context.log.info(f"by where the machine is: {', '.join(bounds)}")

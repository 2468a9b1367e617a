"""The services `ask` and `tell`, for clients that run their own loop."""

from __future__ import annotations

from collections.abc import Iterable

from mobo_msgs_py.action import EvaluateSetpoint
from mobo_msgs_py.srv import Ask, Tell
from mobo_tuner.core import Problem, ProblemError
from mobo_tuner.ros import interfaces
from mobo_tuner.ros.conversions import measurements_of, named_values, unique_values
from mobo_tuner.runs.records import SOURCES, EvaluationRecord, StopReason
from mobo_tuner.runs.run_id import new_run_id
from mobo_tuner.tuner.context import TunerContext, describe
from mobo_tuner.tuner.machine_client import Answer
from mobo_tuner.tuner.problem_parameters import ProblemParameters
from mobo_tuner.tuner.run.loop import (
    Ending,
    end_run,
    publish_figures,
    publish_front_change,
    publish_run,
)
from mobo_tuner.tuner.run.run import Outcome, Run, Suggestion, checked
from mobo_tuner.tuner.run.start import RunRequest, read_prior, start_run
from mobo_tuner.tuner.run.steering import Change
from mobo_tuner.tuner.session import Session

UNBOUNDED = 2**31 - 1  # evaluations: a client that runs its own loop ends it itself
_CODES = EvaluateSetpoint.Result


class AskTell:
    """Serves `ask` and `tell` while no run is active.

    The first request begins a run of its own, kept and published like any other; it lasts until a run
    of the `tune` action begins or the node ends.

    Args:
        context: The tuner's node and what works in it.
        session: Session that must be free.
        parameters: Parameters of the problem.
    """

    def __init__(
        self, context: TunerContext, session: Session, parameters: ProblemParameters
    ) -> None:
        self._context = context
        self._session = session
        self._parameters = parameters
        self._run: Run | None = None
        self._asked: Suggestion | None = None
        interfaces.ASK.server(context.node, self._ask)
        interfaces.TELL.server(context.node, self._tell)

    def close(self) -> None:
        """End the run that was begun here, if any."""
        if self._run is not None:
            end_run(self._context, self._run, Ending(StopReason.STOPPED))
            self._context.topics.front(self._run.front_message(self._context.now()))
            self._run = None

    async def _ask(self, _: Ask.Request, response: Ask.Response) -> Ask.Response:
        try:
            run = await self._current()
            self._asked = asked = await self._context.worker.submit(run.suggest)
        except Exception as error:  # the client is told; the node goes on
            response.message = describe(error)
            return response
        response.success = True
        response.setpoint = named_values(asked.setpoint, run.problem.units)
        response.source = SOURCES.index(asked.source)
        response.run_id, response.index = run.run_id, run.index
        return response

    async def _tell(self, request: Tell.Request, response: Tell.Response) -> Tell.Response:
        try:
            setpoint = unique_values("the set-point", request.setpoint)
            unique_values("the list of diagnostics", request.diagnostics)
            readbacks = unique_values("the list of readbacks", request.readbacks)
            self._check_run(request)
            run = await self._current()
            run.problem.normalize(setpoint)
            _check_readbacks(run.problem, readbacks)
            outcome = Outcome(self._answer(run, setpoint, request, readbacks), 1)
            record = await self._context.worker.submit(self._learn, run, setpoint, outcome, request)
        except Exception as error:  # as above
            if request.run_id:
                self._context.log.warning(f"an answer is dropped: {describe(error)}")
            response.message = describe(error)
            return response
        response.evaluation = run.evaluation_message(record)
        response.success = True
        response.message = run.log.trouble
        self._context.topics.evaluation(response.evaluation)
        publish_front_change(self._context, run)
        publish_figures(self._context, run)
        return response

    def _check_run(self, request: Tell.Request) -> None:
        """Check that an answer is to the run that was begun here, before another begins.

        Raises:
            ValueError: If it is not.
        """
        run = self._run if self._run is self._session.latest else None
        if request.run_id and (run is None or request.run_id != run.run_id):
            raise ValueError(f"run '{request.run_id}' is not the run of the last ask")

    def _learn(
        self, run: Run, setpoint: dict[str, float], outcome: Outcome, request: Tell.Request
    ) -> EvaluationRecord:
        """Learn one answer, in the worker thread, so that one of two equal ones is the first.

        Raises:
            ValueError: If it is an answer to an evaluation that is not the next one, or an earlier one is
                not in the journal yet.
        """
        if not run.log.retry():
            raise ValueError(run.log.trouble)
        if request.run_id and request.index != run.index:
            why = "was told already" if request.index < run.index else "was not asked for yet"
            raise ValueError(f"evaluation {request.index} of run '{run.run_id}' {why}")
        record = run.learn(self._suggestion(setpoint), outcome)
        run.save()
        return record

    async def _current(self) -> Run:
        """Return the run of the clients that ask and tell; begin it if there is none.

        Raises:
            ValueError, OSError: If there can be none now.
        """
        self._session.check_free()
        if self._run is None or self._session.latest is not self._run:
            self.close()
            self._asked = None
            self._run = await self._begin()
            self._session.know(self._run)
        run, problem = self._run, self._parameters.problem
        status = self._context.status
        if status.message.run_id != run.run_id:  # it is new, or a run held a point of it meanwhile
            publish_run(self._context, run)
            status.set(
                publish=False, run_id=run.run_id, stop_reason="", message="", last_failure=""
            )
            publish_figures(self._context, run)
        if run.found.given_problem != problem:
            change = Change(problem, run.budget)
            await self._context.worker.submit(run.apply, change, self._context.stamp())
            publish_run(self._context, run)
        return run

    async def _begin(self) -> Run:
        prior = await read_prior(self._context, self._session, self._parameters.problem)
        run = start_run(
            RunRequest(run_id=new_run_id("ask"), evaluations=UNBOUNDED),
            self._parameters.problem,
            self._context.parameters,
            interrupt=self._context.future(),
            stamp=self._context.stamp(),
            prior=prior,
        )
        run.by_client = True
        return run

    def _suggestion(self, setpoint: dict[str, float]) -> Suggestion:
        """Return where a set-point comes from: it was asked for last, or is the client's own."""
        asked = self._asked
        if asked is not None and asked.setpoint == setpoint:
            return asked
        return Suggestion(setpoint, "operator", 0.0)

    def _answer(
        self,
        run: Run,
        setpoint: dict[str, float],
        request: Tell.Request,
        readbacks: dict[str, float],
    ) -> Answer:
        measured = measurements_of(request.diagnostics)
        answer = Answer(_CODES.NONE, "", self._context.stamp(), readbacks, measured)
        return checked(run, setpoint, answer, "client")


def _check_readbacks(problem: Problem, names: Iterable[str]) -> None:
    """Check that readbacks name variables.

    Raises:
        ProblemError: If one does not.
    """
    for name in names:
        if name not in problem.variable_names:
            raise ProblemError(
                f"the readbacks name '{name[:80]}'; allowed are {', '.join(problem.variable_names)}"
            )

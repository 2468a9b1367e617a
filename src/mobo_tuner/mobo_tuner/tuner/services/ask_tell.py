"""The services `ask` and `tell`, for clients that own their loop."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace

from rclpy.task import Future

from mobo_msgs_py import msg
from mobo_msgs_py.action import EvaluateSetpoint, Tune
from mobo_msgs_py.srv import Ask, Tell
from mobo_tuner.core import Problem, ProblemError
from mobo_tuner.ros.conversions import (
    measurements_of,
    named_values,
    seconds,
    unique_values,
    values_of,
)
from mobo_tuner.runs.run_id import new_run_id
from mobo_tuner.tuner.context import TunerParts, sentence
from mobo_tuner.tuner.machine_client import Answer
from mobo_tuner.tuner.messages import problem_units
from mobo_tuner.tuner.run.keeper import Ending, end_journal
from mobo_tuner.tuner.run.run import SOURCES, Outcome, Run, Suggestion, missing_diagnostics
from mobo_tuner.tuner.run.start import start_run
from mobo_tuner.tuner.run.steering import Change
from mobo_tuner.tuner.session import Session

UNBOUNDED = 2**32 - 1  # evaluations: a client that owns its loop ends it itself


class AskTell:
    """Serves `ask` and `tell` while no run goes on.

    The first of them begins a run of its own, kept and published like any other; it lasts until a
    run of the `tune` action begins or the node ends.

    Args:
        parts: of the tuner's node.
        session: must be free.
        problem: gives what is tuned.
    """

    def __init__(self, parts: TunerParts, session: Session, problem: Callable[[], Problem]) -> None:
        self._parts = parts
        self._session = session
        self._problem = problem
        self._run: Run | None = None
        self._asked: Suggestion | None = None
        parts.node.create_service(Ask, "ask", self._ask)
        parts.node.create_service(Tell, "tell", self._tell)

    def close(self) -> None:
        """End the run that goes on here, if any."""
        if self._run is not None:
            end_journal(self._parts, self._run, Ending("stopped"))
            self._run = None

    async def _ask(self, _: Ask.Request, response: Ask.Response) -> Ask.Response:
        try:
            run = await self._current()
            self._asked = asked = await self._parts.worker.submit(run.suggest)
        except Exception as error:  # of this client's own making, and none of a run's concern
            response.message = sentence(error)
            return response
        response.success = True
        response.setpoint = named_values(asked.setpoint, problem_units(run.problem))
        response.source = SOURCES[asked.source]
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
            message = await self._parts.worker.submit(self._learn, run, setpoint, request)
        except Exception as error:  # as above
            if request.run_id:
                self._parts.log.warning(f"an answer is dropped: {sentence(error)}")
            response.message = sentence(error)
            return response
        self._parts.publishers.evaluation(message)
        self._parts.publishers.front(run.front(self._parts.now()))
        response.success = True
        response.evaluation = message
        return response

    def _check_run(self, request: Tell.Request) -> None:
        """Check that an answer is to the run that goes on here, before another begins.

        Raises:
            ValueError: it is not.
        """
        run = self._run if self._run is self._session.latest else None
        if request.run_id and (run is None or request.run_id != run.run_id):
            raise ValueError(f"run '{request.run_id}' is not the one that is asked and told of now")

    def _learn(self, run: Run, setpoint: dict[str, float], request: Tell.Request) -> msg.Evaluation:
        """Learn one answer; made for the worker thread, so that of two equal ones one is the first.

        Raises:
            ValueError: it is an answer to an evaluation that is not due.
        """
        if request.run_id and request.index != run.index:
            why = "was told already" if request.index < run.index else "was not asked for yet"
            raise ValueError(f"evaluation {request.index} of run '{run.run_id}' {why}")
        return run.learn(self._suggestion(setpoint), self._outcome(run, request))

    async def _current(self) -> Run:
        """The run of whoever asks and tells.

        Raises:
            ValueError, OSError: there can be none now.
        """
        if self._session.occupied:
            raise ValueError(self._session.occupied)
        if self._run is None or self._session.latest is not self._run:
            self.close()
            self._asked = None
            self._run = self._session.latest = self._begin()
            self._publish_problem(self._run)
        run = self._run
        if run.optimizer.given_problem != self._problem():
            change = Change(self._problem(), run.budget)
            await self._parts.worker.submit(run.apply, change, seconds(self._parts.now()))
            self._publish_problem(run)
        return run

    def _begin(self) -> Run:
        goal = Tune.Goal(run_id=new_run_id("ask"), evaluations=UNBOUNDED)
        run = start_run(
            goal,
            self._problem(),
            self._parts.parameters,
            goal_id=b"",
            interrupt=Future(executor=self._parts.node.executor),
            stamp=seconds(self._parts.now()),
        )
        run.by_client = True
        return run

    def _publish_problem(self, run: Run) -> None:
        now = self._parts.now()
        self._parts.publishers.problem(run.problem_message(now))
        self._parts.publishers.front(run.front(now))

    def _suggestion(self, setpoint: dict[str, float]) -> Suggestion:
        """Where a set-point comes from: it was asked for last, or is the client's own."""
        asked = self._asked
        if asked is not None and asked.setpoint == setpoint:
            return asked
        return Suggestion(setpoint, "operator", 0.0)

    def _outcome(self, run: Run, request: Tell.Request) -> Outcome:
        answer = Answer(
            EvaluateSetpoint.Result.NONE,
            "",
            self._parts.now(),
            readbacks=values_of(request.readbacks),
            diagnostics=measurements_of(request.diagnostics),
        )
        missing = missing_diagnostics(run.problem, answer)
        if not missing:
            return Outcome(answer, 1)
        failed = replace(
            answer,
            error_code=EvaluateSetpoint.Result.INVALID_MEASUREMENT,
            error_msg=f"the client did not measure {', '.join(missing)}",
        )
        return Outcome(failed, 1)


def _check_readbacks(problem: Problem, names: Iterable[str]) -> None:
    """Check that readbacks are of variables.

    Raises:
        ProblemError: one is not.
    """
    for name in names:
        if name not in problem.variable_names:
            raise ProblemError(
                f"the readbacks name '{name[:80]}'; allowed are {', '.join(problem.variable_names)}"
            )

"""How a run begins: its request checked, its optimiser made or restored, its journal opened."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

from rclpy.task import Future

from mobo_tuner.core import Optimizer, Problem
from mobo_tuner.core.prior_mean import PriorModel
from mobo_tuner.runs.history import MODEL, History
from mobo_tuner.runs.journal import read_journal
from mobo_tuner.runs.optimizer_settings import kept_settings, make_optimizer
from mobo_tuner.runs.prior_model import load_prior_model
from mobo_tuner.runs.records import (
    ChangeRecord,
    EvaluationRecord,
    ForgetRecord,
    Record,
    StartRecord,
)
from mobo_tuner.runs.replay import restore
from mobo_tuner.runs.run_id import check_run_id, new_run_id
from mobo_tuner.runs.run_log import RunLog
from mobo_tuner.runs.saved_state import SavedState
from mobo_tuner.tuner.context import TunerContext
from mobo_tuner.tuner.parameters import TunerParameters
from mobo_tuner.tuner.run.run import Run
from mobo_tuner.tuner.session import Session


@dataclass(frozen=True)
class RunRequest:
    """What a client asks for.

    Attributes:
        run_id: Name of the run; empty = a new one is made up.
        evaluations: Budget, those of an earlier run included; 0 = that run's, or the parameter's.
        hypervolume_goal: Hypervolume at which the run stops; 0 or NaN = the parameter's, or that of
            the earlier run.
    """

    run_id: str = ""
    evaluations: int = 0
    hypervolume_goal: float = 0.0


class Earlier(NamedTuple):
    """An earlier run that a new run resumes: what happened in it, and its optimiser at the end."""

    history: History
    optimizer: Optimizer


async def read_earlier(context: TunerContext, session: Session, run_id: str) -> Earlier:
    """Read an earlier run from its folder, while nothing else may begin; the folder is left as it is.

    It may take as long as the training of its models took.

    Raises:
        ValueError, OSError: If there is no such run, or it cannot be resumed, with the reason.
    """
    with session.reading():
        runs_dir = context.parameters.runs_dir
        earlier: Earlier = await context.worker.submit(_read, runs_dir, run_id)
    return earlier


def _read(runs_dir: str, run_id: str) -> Earlier:
    if not runs_dir:
        raise ValueError("runs_dir is empty; earlier runs are read from that folder")
    folder = Path(runs_dir) / check_run_id(run_id)
    if folder.resolve().parent != Path(runs_dir).resolve():
        raise ValueError(f"the run '{run_id}' is a link out of '{runs_dir}'")
    if not folder.is_dir():
        raise ValueError(f"there is no run '{run_id}' in '{Path(runs_dir).absolute()}'")
    history = History.from_records(read_journal(folder))
    history.require_settings()
    return Earlier(history, restore(history, SavedState.read(folder)))


async def read_prior(
    context: TunerContext, session: Session, problem: Problem
) -> PriorModel | None:
    """Load the prior model that the parameters name, if they do, while nothing else may begin.

    Raises:
        ProblemError: If it cannot be loaded.
    """
    settings = context.parameters.values
    if not settings.get(MODEL):
        return None
    with session.reading():
        prior: PriorModel | None = await context.worker.submit(load_prior_model, problem, settings)
    return prior


def start_run(
    request: RunRequest,
    problem: Problem,
    parameters: TunerParameters,
    *,
    interrupt: Future,
    stamp: float,
    earlier: Earlier | None = None,
    prior: PriorModel | None = None,
) -> Run:
    """Check a request and prepare its run.

    Args:
        request: Request for the run.
        problem: Problem to tune.
        parameters: Parameters of the tuner's node.
        interrupt: Done when the run must stop; its result is the reason.
        stamp: Time now [s since the epoch].
        earlier: Run that this one resumes.
        prior: Prior model of a run that resumes none.

    Raises:
        ValueError, OSError: If the request cannot be served, with the reason.
    """
    run_id = check_run_id(request.run_id) if request.run_id else new_run_id("run")
    goal = request.hypervolume_goal if request.hypervolume_goal > 0.0 else 0.0
    if earlier is not None:
        return _resume(earlier, run_id, request, goal, problem, parameters, interrupt, stamp)
    goal = goal or parameters.hypervolume_goal
    budget = request.evaluations or parameters.evaluations
    settings = {**parameters.values, "budget": budget, "hypervolume_goal": goal}
    start = StartRecord(run_id, stamp, problem, settings)
    return Run(
        run_id=run_id,
        budget=budget,
        hypervolume_goal=goal,
        optimizer=make_optimizer(problem, settings, prior),
        interrupt=interrupt,
        log=RunLog(parameters.run_dir(run_id), start),
        model_input=parameters.model_input,
    )


def _resume(
    earlier: Earlier,
    run_id: str,
    request: RunRequest,
    goal: float,
    problem: Problem,
    parameters: TunerParameters,
    interrupt: Future,
    stamp: float,
) -> Run:
    """Prepare a run that begins with the evaluations of an earlier one."""
    history, optimizer = earlier
    made = len(history.evaluations)
    budget = request.evaluations or history.budget
    if budget <= made:
        raise ValueError(
            f"evaluations is {budget}; the run '{history.run_id}' has {made} already, more are allowed"
        )
    # It starts as the earlier one did, so that it can be replayed from its own journal alone.
    earlier_goal = float(history.settings.get("hypervolume_goal", 0.0))
    goal = goal or parameters.hypervolume_goal or earlier_goal
    settings: Mapping[str, Any] = {
        **parameters.values,
        **kept_settings(history.settings),
        "budget": history.settings.get("budget", budget),
        "hypervolume_goal": goal,
    }
    start = StartRecord(
        run_id,
        stamp,
        history.problem,
        settings,
        resumed_from={"run_id": history.run_id, "evaluations": made},
    )
    records: list[Record] = list(history.records)
    if problem != history.last_problem:
        optimizer = optimizer.with_problem(problem)
    if problem != history.last_problem or budget != history.budget:
        records.append(ChangeRecord(stamp, made, problem, budget))
    run = Run(
        run_id=run_id,
        budget=budget,
        hypervolume_goal=goal,
        optimizer=optimizer,
        interrupt=interrupt,
        log=RunLog(parameters.run_dir(run_id), start, records),
        model_input=history.model_input,
        records=_with_problems(history),
    )
    run.steering.queue.extend(dict(setpoint) for setpoint in history.waiting)
    return run


def _with_problems(history: History) -> list[tuple[Problem, EvaluationRecord]]:
    """Return the evaluations of a run, each with the problem at that time."""
    problem, found = history.problem, []
    for step in history.steps:
        if isinstance(step, ChangeRecord):
            problem = step.problem
        elif isinstance(step, EvaluationRecord):
            found.append((problem, step))
    return found


def reopen_run(earlier: Earlier, interrupt: Future, run_dir: Path | None) -> Run:
    """Return an earlier run as it was at its end; it is not active, and only moves are added to its journal."""
    history, optimizer = earlier
    return Run(
        run_id=history.run_id,
        budget=len(history.evaluations),
        optimizer=optimizer,
        interrupt=interrupt,
        changeable=False,
        log=RunLog(run_dir, history.start, [*history.records, *history.places], ended=True),
        state_before=None if history.before is None else dict(history.before.readbacks),
        model_input=history.model_input,
        records=_with_problems(history),
    )


def start_holding(
    run: Run,
    focused: Optimizer,
    evaluations: int,
    parameters: TunerParameters,
    *,
    point: Mapping[str, float],
    interrupt: Future,
    stamp: float,
) -> Run:
    """Prepare the run that holds a working point.

    Args:
        run: Run to whose front the point belongs.
        focused: Its optimiser, confined to the surroundings of the point.
        evaluations: Number of evaluations to spend; the first is at the point.
        parameters: Parameters of the tuner's node.
        point: Set-point of the working point.
        interrupt: Done when the holding must stop.
        stamp: Time now [s since the epoch].

    Raises:
        OSError: If its journal cannot be written.
    """
    run_id = new_run_id("hold")
    budget = len(focused.dataset) + evaluations
    # The method of this run suggested none of them, so that a replay does not compare them.
    taken_over = [(p, replace(record, source="operator")) for p, record in run.records]
    settings = {
        **parameters.values,
        **focused.settings.to_dict(),
        "budget": budget,
        "holds": run.run_id,
    }
    start = StartRecord(
        run_id,
        stamp,
        focused.problem,
        settings,
        resumed_from={"run_id": run.run_id, "evaluations": run.index},
    )
    held = Run(
        run_id=run_id,
        budget=budget,
        optimizer=focused,
        interrupt=interrupt,
        changeable=False,
        log=RunLog(
            parameters.run_dir(run_id),
            start,
            [
                *(record for _, record in taken_over),
                *(
                    ForgetRecord(stamp, run.index, index, name or "")
                    for index, name in focused.dataset.withdrawn
                ),
            ],
        ),
        model_input=run.model_input,
        records=taken_over,
    )
    held.steering.queue.append(dict(point))
    return held

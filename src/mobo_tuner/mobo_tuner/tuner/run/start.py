"""How a run begins: its goal checked, its optimiser made or restored, its journal opened."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from rclpy.task import Future

from mobo_msgs_py.action import Tune
from mobo_tuner.core import Optimizer, Problem
from mobo_tuner.runs.history import History
from mobo_tuner.runs.journal import Record, read_journal
from mobo_tuner.runs.optimizer_settings import kept_settings, make_optimizer
from mobo_tuner.runs.replay import restore
from mobo_tuner.runs.run_id import check_run_id, new_run_id
from mobo_tuner.runs.run_log import RunLog
from mobo_tuner.runs.saved_state import SavedState
from mobo_tuner.tuner.run.republish import earlier_evaluations
from mobo_tuner.tuner.run.run import Run


class Earlier(NamedTuple):
    """A run that another one goes on with: what happened in it, and its optimiser at the end."""

    history: History
    optimizer: Optimizer


def read_earlier(runs_dir: str, run_id: str) -> Earlier:
    """Read an earlier run, which may take as long as its training took; it is left as it is.

    Args:
        runs_dir: the tuner's.
        run_id: of the run, which must be in there.

    Raises:
        ValueError: there is no such run, or it cannot be gone on with.
    """
    if not runs_dir:
        raise ValueError(
            "an earlier run is read from the folder runs_dir, a parameter that is empty"
        )
    folder = Path(runs_dir) / check_run_id(run_id)
    if folder.resolve().parent != Path(runs_dir).resolve():
        raise ValueError(f"the run '{run_id}' is a link out of '{runs_dir}'")
    history = History.from_records(read_journal(folder))
    return Earlier(history, restore(history, SavedState.read(folder)))


def start_run(
    goal: Tune.Goal,
    problem: Problem,
    parameters: Mapping[str, Any],
    *,
    goal_id: bytes,
    interrupt: Future,
    stamp: float,
    earlier: Earlier | None = None,
) -> Run:
    """Check a goal and prepare its run.

    Args:
        goal: of the `tune` action.
        problem: what is tuned.
        parameters: of the tuner's node.
        goal_id: of the goal.
        interrupt: done when the run shall stop; its result says why.
        stamp: now [s since the epoch].
        earlier: the run that this one goes on with.

    Raises:
        ValueError, OSError: the goal cannot be served, with the reason.
    """
    run_id = check_run_id(goal.run_id) if goal.run_id else new_run_id("run")
    wanted = goal.hypervolume_goal if goal.hypervolume_goal > 0.0 else 0.0
    settings = {
        **parameters,
        "budget": goal.evaluations or parameters["evaluations"],
        "hypervolume_goal": wanted,
    }
    header = {"run_id": run_id, "stamp": stamp, "problem": problem.to_dict(), "settings": settings}
    run_dir = _run_dir(run_id, parameters)
    if earlier is None:
        return Run(
            run_id=run_id,
            budget=settings["budget"],
            hypervolume_goal=wanted,
            optimizer=make_optimizer(problem, parameters),
            goal_id=goal_id,
            interrupt=interrupt,
            journal=RunLog(run_dir, header),
            model_input=settings["model_input"],
        )
    history, optimizer = earlier
    told = len(history.evaluations)
    budget = goal.evaluations or history.budget
    if budget <= told:
        raise ValueError(
            f"evaluations is {budget}, and the run '{history.run_id}' has {told} already; a budget "
            "of more is allowed"
        )
    # It begins as the earlier one did, so that it can be lived through from its own journal alone.
    settings |= kept_settings(history.settings)
    settings["budget"] = history.settings.get("budget", budget)
    settings["hypervolume_goal"] = wanted or history.settings.get("hypervolume_goal", 0.0)
    header["problem"] = history.problem.to_dict()
    header["resumed_from"] = {"run_id": history.run_id, "evaluations": told}
    records: list[Record] = list(history.records)
    if problem != history.last_problem:
        optimizer = optimizer.with_problem(problem)
    if problem != history.last_problem or budget != history.budget:
        records.append(
            {
                "type": "change",
                "stamp": stamp,
                "index": told,
                "problem": problem.to_dict(),
                "budget": budget,
            }
        )
    run = Run(
        run_id=run_id,
        budget=budget,
        hypervolume_goal=float(settings["hypervolume_goal"]),
        optimizer=optimizer,
        goal_id=goal_id,
        interrupt=interrupt,
        journal=RunLog(run_dir, header, records),
        model_input=settings["model_input"],
        earlier=earlier_evaluations(history, run_id),
    )
    run.steering.queue.extend(dict(setpoint) for setpoint in history.waiting)
    run.journal.save(optimizer)
    return run


def reopen_run(earlier: Earlier, interrupt: Future) -> Run:
    """An earlier run as it was at its end: it does not go on, and nothing more is kept of it."""
    history, optimizer = earlier
    return Run(
        run_id=history.run_id,
        budget=len(history.evaluations),
        hypervolume_goal=0.0,
        optimizer=optimizer,
        goal_id=b"",
        interrupt=interrupt,
        changeable=False,
        journal=RunLog(None, {"run_id": history.run_id}),
    )


def start_holding(
    run: Run,
    focused: Optimizer,
    evaluations: int,
    parameters: Mapping[str, Any],
    *,
    point: Mapping[str, float],
    interrupt: Future,
    stamp: float,
) -> Run:
    """Prepare the run that holds a working point.

    Args:
        run: to whose front the point belongs.
        focused: its optimiser, drawn in around the point.
        evaluations: to be spent, of which the first is at the point.
        parameters: of the tuner's node.
        point: set-point of the working point.
        interrupt: done when the holding shall stop.
        stamp: now [s since the epoch].

    Raises:
        OSError: its journal cannot be written.
    """
    run_id = new_run_id("hold")
    budget = len(focused.dataset) + evaluations
    header = {
        "run_id": run_id,
        "stamp": stamp,
        "problem": focused.problem.to_dict(),
        "settings": {
            **parameters,
            **focused.settings.to_dict(),
            "budget": budget,
            "holds": run.run_id,
        },
    }
    held = Run(
        run_id=run_id,
        budget=budget,
        hypervolume_goal=0.0,
        optimizer=focused,
        goal_id=b"",
        interrupt=interrupt,
        changeable=False,
        journal=RunLog(_run_dir(run_id, parameters), header),
        model_input=run.model_input,
    )
    held.steering.queue.append(dict(point))
    return held


def _run_dir(run_id: str, parameters: Mapping[str, Any]) -> Path | None:
    """Where a run is kept; None where none is."""
    return Path(parameters["runs_dir"]) / run_id if parameters["runs_dir"] else None

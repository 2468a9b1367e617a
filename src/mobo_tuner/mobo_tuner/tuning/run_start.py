"""How a run begins: its goal checked, its optimiser made, its journal opened."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rclpy.task import Future

from mobo_msgs_py.action import Tune
from mobo_tuner.core import Optimizer, Problem
from mobo_tuner.journal import Journal
from mobo_tuner.run_id import check_run_id, new_run_id
from mobo_tuner.tuning.run import Run


def start_run(
    goal: Tune.Goal,
    problem: Problem,
    parameters: Mapping[str, Any],
    *,
    goal_id: bytes,
    interrupt: Future,
    stamp: float,
) -> Run:
    """Check a goal and prepare its run.

    Args:
        goal: of the `tune` action.
        problem: what is tuned.
        parameters: of the tuner's node.
        goal_id: of the goal.
        interrupt: done when the run shall stop; its result says why.
        stamp: now [s since the epoch].

    Raises:
        ValueError, OSError: the goal cannot be served, with the reason.
    """
    run = Run(
        run_id=check_run_id(goal.run_id) if goal.run_id else new_run_id("run"),
        budget=goal.evaluations or parameters["evaluations"],
        hypervolume_goal=goal.hypervolume_goal if goal.hypervolume_goal > 0.0 else 0.0,
        optimizer=make_optimizer(problem, parameters),
        goal_id=goal_id,
        interrupt=interrupt,
    )
    run.journal = open_journal(run, parameters, stamp)
    return run


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
    held = Run(
        run_id=new_run_id("hold"),
        budget=len(focused.dataset) + evaluations,
        hypervolume_goal=0.0,
        optimizer=focused,
        goal_id=b"",
        interrupt=interrupt,
        changeable=False,
    )
    held.steering.queue.append(dict(point))
    held.journal = open_journal(held, {**parameters, "holds": run.run_id}, stamp)
    return held


def make_optimizer(problem: Problem, parameters: Mapping[str, Any]) -> Optimizer:
    """The optimiser of a run that knows nothing yet."""
    choices: dict[str, Any] = {}
    if parameters["initial_evaluations"]:
        choices["initial_evaluations"] = parameters["initial_evaluations"]
    if parameters["proximal"]:
        choices["proximal"] = "costs"
    return Optimizer(problem, preset=parameters["preset"], seed=parameters["seed"], **choices)


def open_journal(run: Run, parameters: Mapping[str, Any], stamp: float) -> Journal | None:
    """The journal of a run that begins; None where none is kept.

    Raises:
        OSError: it cannot be written, or there is one of this name already.
    """
    if not parameters["runs_dir"]:
        return None
    start = {
        "run_id": run.run_id,
        "stamp": stamp,
        "problem": run.optimizer.problem.to_dict(),
        "settings": {**parameters, "budget": run.budget},
    }
    return Journal.create(Path(parameters["runs_dir"]) / run.run_id, start)

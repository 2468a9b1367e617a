"""A run of the tuner without ROS topics or a machine's node, for tests and campaigns of resumed runs.

It is the tuner's own `Run`, told what a Python function measures. What happens in it is drawn from a seed
for each evaluation, so that a run that was cut short meets the same failures, operators and changes when
it is resumed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from rclpy.task import Future

from mobo_msgs_py.action import EvaluateSetpoint
from mobo_tuner.core import Optimizer, Problem
from mobo_tuner.runs.history import SETPOINT, History
from mobo_tuner.runs.records import QueuedRecord, StartRecord
from mobo_tuner.runs.run_log import RunLog
from mobo_tuner.tuner.machine_client import Answer
from mobo_tuner.tuner.run.run import Outcome, Run, Suggestion
from mobo_tuner.tuner.run.steering import Change

Machine = Callable[[Mapping[str, float]], Mapping[str, float]]

BUDGET = 1000
TOY = {
    "variables": {"x1": {"min": -2.0, "max": 2.0}, "x2": {"min": -2.0, "max": 2.0}},
    "objectives": {"f1": {"reference": 4.3}, "f2": {"reference": 4.3}},
    "constraints": {"g": {"max": 0.5}},
}


def toy(x: Mapping[str, float]) -> dict[str, float]:
    """Return the paper's toy problem, Eq. 5 (eqn:toy_problem), and its constrained quantity g."""
    return {
        "f1": math.hypot(x["x1"] - 1.0, x["x2"] - 1.0),
        "f2": math.hypot(x["x1"] + 1.0, x["x2"] + 1.0),
        "g": x["x1"],
    }


def toy_optimizer(seed: int) -> Optimizer:
    """Return an optimiser of the toy problem with a short start."""
    return Optimizer(Problem.from_dict(TOY), seed=seed, initial_evaluations=4)


class OfflineRun:
    """One run; `step` makes an evaluation.

    Args:
        run_dir: Folder of the run.
        optimizer: Optimiser at the beginning, or as it was restored.
        machine: Function that measures.
        seed: Seed of what happens.
        earlier: Run that this one resumes, if any.
        events: Whether evaluations fail, operators give set-points and the problem changes.
        model_input: What the models learn from; the readbacks are a bit off the set-points.
    """

    def __init__(
        self,
        run_dir: Path,
        optimizer: Optimizer,
        machine: Machine,
        seed: int,
        earlier: History | None = None,
        events: bool = True,
        model_input: str = SETPOINT,
    ) -> None:
        self._machine = machine
        self._seed = seed
        self._events = events
        settings = {
            "preset": "default",
            "seed": optimizer.seed,
            **optimizer.settings.to_dict(),
            "budget": BUDGET,
            "model_input": model_input,
        }
        problem = optimizer.problem if earlier is None else earlier.problem
        start = StartRecord(run_dir.name, 0.0, problem, settings)
        self.run = Run(
            run_id=run_dir.name,
            budget=BUDGET,
            optimizer=optimizer,
            interrupt=Future(),
            log=RunLog(run_dir, start, () if earlier is None else earlier.records),
            model_input=model_input,
        )
        self._waiting = [] if earlier is None else [dict(point) for point in earlier.waiting]
        self._changed_at = {change.index for change in earlier.changes} if earlier else set()

    @property
    def log(self) -> RunLog:
        """Where the run is kept."""
        return self.run.log

    @property
    def optimizer(self) -> Optimizer:
        """Optimiser of the run."""
        return self.run.optimizer

    def ask(self) -> dict[str, float]:
        """Return what is measured next."""
        return self.run.optimizer.ask()

    def step(self) -> None:
        """Make one evaluation, and what an operator does before it."""
        index = self.run.index
        rng = np.random.default_rng([self._seed, index])
        happens = rng.random(3) if self._events else np.ones(3)
        if happens[0] < 0.05:
            share = float(rng.uniform(0.8, 1.0))
            if index not in self._changed_at:
                self._change(share)
        suggestion = self.run.suggest()._replace(seconds=0.0)
        if happens[1] < 0.1:
            setpoint = self._waiting.pop() if self._waiting else self._queue(rng)
            suggestion = Suggestion(setpoint, "operator", 0.0)
        failed = happens[2] < 0.15
        codes = EvaluateSetpoint.Result
        measured = {} if failed else self._machine(suggestion.setpoint)
        answer = Answer(
            error_code=codes.INVALID_MEASUREMENT if failed else codes.NONE,
            error_msg="not measured" if failed else "",
            stamp=1_700_000_000.0 + index,
            readbacks={name: value + 0.01 for name, value in suggestion.setpoint.items()},
            diagnostics={name: (value, math.nan) for name, value in measured.items()},
        )
        self.run.learn(suggestion, Outcome(answer, 1))
        self.run.save()

    def _queue(self, rng: np.random.Generator) -> dict[str, float]:
        """Queue a set-point as an operator would."""
        box = {v.name: (v.minimum, v.maximum) for v in self.run.problem.variables}
        setpoint = {name: float(rng.uniform(*ends)) for name, ends in box.items()}
        self.log.append(QueuedRecord(0.0, setpoint))
        return setpoint

    def _change(self, share: float) -> None:
        """Narrow the bounds of the first variable and worsen the first reference."""
        problem = self.run.problem
        first, *others = problem.variables
        narrower = replace(first, minimum=first.minimum * share, maximum=first.maximum * share)
        if not narrower.minimum < narrower.maximum or first.minimum > 0.0:
            narrower = first
        worse = replace(problem.objectives[0], reference=problem.objectives[0].reference * 1.05)
        changed = replace(
            problem,
            variables=(narrower, *others),
            objectives=(worse, *problem.objectives[1:]),
        )
        self.run.apply(Change(changed, BUDGET), 0.0)
        self.run.save()

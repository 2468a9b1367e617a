"""A run without ROS that keeps what the tuner keeps: for tests and benchmarks of going on with runs.

What happens in it is drawn from a seed, at every boundary anew, so that a run that was cut short
meets the same failures, operators and changes when it goes on.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from mobo_tuner.core import Optimizer, Problem
from mobo_tuner.runs.history import SETPOINT, History, told_outputs, told_readbacks
from mobo_tuner.runs.records import evaluation_record
from mobo_tuner.runs.run_log import RunLog

Machine = Callable[[Mapping[str, float]], Mapping[str, float]]

TOY = {
    "variables": {"x1": {"min": -2.0, "max": 2.0}, "x2": {"min": -2.0, "max": 2.0}},
    "objectives": {"f1": {"reference": 4.3}, "f2": {"reference": 4.3}},
    "constraints": {"g": {"max": 0.5}},
}


def toy(x: Mapping[str, float]) -> dict[str, float]:
    """The paper's toy problem, Eq. (eqn:toy_problem), and its constrained quantity g."""
    return {
        "f1": math.hypot(x["x1"] - 1.0, x["x2"] - 1.0),
        "f2": math.hypot(x["x1"] + 1.0, x["x2"] + 1.0),
        "g": x["x1"],
    }


class LivedRun:
    """One run; `step` makes an evaluation.

    Args:
        run_dir: its folder.
        optimizer: at the beginning, or as it was restored.
        machine: measures.
        seed: of what happens.
        earlier: the run that this one goes on with, if any.
        events: whether evaluations fail, operators give set-points and the problem changes.
        model_input: what the models learn from; the readbacks are a bit off the set-points.
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
        self.optimizer = optimizer
        self._machine = machine
        self._seed = seed
        self._events = events
        self._model_input = model_input
        settings = {
            "preset": "default",
            "seed": optimizer.seed,
            **optimizer.settings.to_dict(),
            "budget": 1000,
            "model_input": model_input,
        }
        header = {"run_id": run_dir.name, "stamp": 0.0, "settings": settings}
        problem = optimizer.problem if earlier is None else earlier.problem
        records = () if earlier is None else earlier.records
        self.log = RunLog(run_dir, {**header, "problem": problem.to_dict()}, records)
        self._waiting = [] if earlier is None else [dict(point) for point in earlier.waiting]
        self._changed_at = {change.index for change in earlier.changes} if earlier else set()

    def ask(self) -> dict[str, float]:
        """What is measured next."""
        return self.optimizer.ask()

    def step(self) -> None:
        """One evaluation, and what an operator does before it."""
        index = len(self.optimizer.dataset)
        rng = np.random.default_rng([self._seed, index])
        happens = rng.random(3) if self._events else np.ones(3)
        if happens[0] < 0.05:
            share = float(rng.uniform(0.8, 1.0))
            if index not in self._changed_at:
                self._change(index, share)
        setpoint, source = self.optimizer.ask(), self.optimizer.last_source
        if happens[1] < 0.1:
            source = "operator"
            setpoint = self._waiting.pop() if self._waiting else self._given(rng)
        failed = happens[2] < 0.15
        measured = {} if failed else dict(self._machine(setpoint))
        diagnostics = {name: (value, math.nan) for name, value in measured.items()}
        outputs = told_outputs(self.optimizer.problem, diagnostics, int(failed))
        readbacks = {name: value + 0.01 for name, value in setpoint.items()}
        told = told_readbacks(self.optimizer.problem, readbacks, self._model_input)
        evaluation = self.optimizer.tell(setpoint, outputs, told)
        message = SimpleNamespace(
            index=index,
            source=("initial", "model", "operator").index(source),
            attempts=1,
            stamp=SimpleNamespace(sec=1_700_000_000 + index, nanosec=5),
            setpoint=_named(setpoint),
            readbacks=_named(readbacks),
            diagnostics=_named(evaluation.values, evaluation.stddevs),
            valid=evaluation.valid,
            feasible=evaluation.feasible,
            error_code=5 if failed else 0,
            error_msg="not measured" if failed else "",
            hypervolume=self.optimizer.hypervolume,
            suggest_seconds=0.0,
            machine_seconds=0.0,
            total_seconds=0.0,
        )
        self.log.append(evaluation_record(message))
        self.log.save(self.optimizer)

    def _given(self, rng: np.random.Generator) -> dict[str, float]:
        """A set-point that an operator gives."""
        box = {v.name: (v.minimum, v.maximum) for v in self.optimizer.problem.variables}
        setpoint = {name: float(rng.uniform(*ends)) for name, ends in box.items()}
        self.log.append({"type": "queued", "stamp": 0.0, "setpoint": setpoint})
        return setpoint

    def _change(self, index: int, share: float) -> None:
        """Draw in the bounds of the first variable and worsen the first reference."""
        problem = self.optimizer.problem
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
        self.optimizer = self.optimizer.with_problem(changed)
        self.log.append(
            {
                "type": "change",
                "stamp": 0.0,
                "index": index,
                "problem": changed.to_dict(),
                "budget": 1000,
            }
        )
        self.log.save(self.optimizer)


def toy_optimizer(seed: int) -> Optimizer:
    """Of the toy problem, with a short start."""
    return Optimizer(Problem.from_dict(TOY), seed=seed, initial_evaluations=4)


def _named(values: Mapping[str, float], stddevs: Mapping[str, float] | None = None) -> list[Any]:
    return [
        SimpleNamespace(name=name, value=value, stddev=(stddevs or {}).get(name, math.nan))
        for name, value in values.items()
    ]

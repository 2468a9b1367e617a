"""The optimiser's state beside the journal, so that a run is resumed without a replay.

`optimizer.json` has two lines: the state without the evaluations, which are in the journal, and its
checksum. Its size does not grow with the run. If it is missing, damaged or behind by some evaluations,
the journal is replayed from there.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mobo_tuner.core import Optimizer, Problem
from mobo_tuner.core.prior_mean import PriorModel
from mobo_tuner.files import replace_file
from mobo_tuner.runs.history import History, told_of
from mobo_tuner.runs.records import ChangeRecord, EvaluationRecord

FILE_NAME = "optimizer.json"
MAX_BYTES = 1 << 26


@dataclass(frozen=True)
class SavedState:
    """A state and its position in its run.

    Attributes:
        run_id: Id of the run.
        evaluations: Number of evaluations that the optimiser had seen.
        changes: Number of changes that it had seen.
        state: State from `Optimizer.get_state`, without the evaluations.
    """

    run_id: str
    evaluations: int
    changes: int
    state: Mapping[str, Any]

    def write(self, run_dir: Path) -> None:
        """Write it into a run's folder, replacing an older one.

        It is not synced to disk, because the journal suffices after a power cut.

        Raises:
            OSError: If it cannot be written.
        """
        text = json.dumps(
            {
                "run_id": self.run_id,
                "evaluations": self.evaluations,
                "changes": self.changes,
                "state": self.state,
            }
        ).encode()
        replace_file(run_dir / FILE_NAME, text + b"\n" + checksum(text) + b"\n")

    @classmethod
    def read(cls, run_dir: Path) -> SavedState | None:
        """Read it from a run's folder; return None if there is no valid one."""
        path = run_dir / FILE_NAME
        try:
            if path.stat().st_size > MAX_BYTES:
                return None
            text, given, *_ = path.read_bytes().split(b"\n")
            if checksum(text) != given:
                return None
            content = json.loads(text)
            return cls(
                content["run_id"], content["evaluations"], content["changes"], content["state"]
            )
        except (KeyError, OSError, RecursionError, TypeError, ValueError):
            return None

    def revive(
        self, history: History, prior: PriorModel | None = None
    ) -> tuple[Optimizer, int] | None:
        """Return the optimiser at this state, and the number of steps that it has seen.

        Returns None if the state does not belong to the history, or was one of an optimiser with another
        prior model.
        """
        position = self._position(history)
        if position is None:
            return None
        problem = history.problem
        evaluations = []
        for step in history.steps[:position]:
            if isinstance(step, ChangeRecord):
                problem = step.problem
            elif isinstance(step, EvaluationRecord):
                evaluations.append(told_of(step, problem, history.model_input)._asdict())
        try:
            if Problem.from_dict(self.state["problem"]) != problem:
                return None
            state = {**self.state, "evaluations": evaluations}
            return Optimizer.from_state(state, prior), position
        except Exception:  # an invalid state is replaced by a replay
            return None

    def _position(self, history: History) -> int | None:
        """Return the number of steps of the history that the state has seen."""
        if self.run_id != history.run_id:
            return None
        evaluations = changes = 0
        for position, step in enumerate((*history.steps, None)):
            if (evaluations, changes) == (self.evaluations, self.changes):
                return position
            evaluations += isinstance(step, EvaluationRecord)
            changes += step is not None and not isinstance(step, EvaluationRecord)
        return None


def checksum(text: bytes) -> bytes:
    """Return the checksum of a state."""
    return hashlib.sha256(text).hexdigest().encode()

"""The optimiser's state beside the journal, so that going on with a run needs no replay of it.

`optimizer.json` holds two lines: the state, without the evaluations, which the journal holds, and a
checksum of it. Its size does not grow with the run. It may be missing, damaged or late by a few
evaluations: then the journal makes up for it.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mobo_tuner.core import Optimizer, Problem
from mobo_tuner.files import replace_file
from mobo_tuner.runs.history import History, told_of
from mobo_tuner.runs.records import ChangeRecord, EvaluationRecord

FILE_NAME = "optimizer.json"
MAX_BYTES = 1 << 26


@dataclass(frozen=True)
class SavedState:
    """A state and the place in its run to which it belongs.

    Attributes:
        run_id: of the run.
        evaluations, changes: how many of each the optimiser had seen.
        state: from `Optimizer.get_state`, without the evaluations.
    """

    run_id: str
    evaluations: int
    changes: int
    state: Mapping[str, Any]

    def write(self, run_dir: Path) -> None:
        """Write it into a run's folder, in place of an older one.

        It is not forced to disk: after a power cut the journal is there, and it suffices.

        Raises:
            OSError: it cannot be written.
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
        """Read it from a run's folder; None where there is none that is whole."""
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

    def revive(self, history: History) -> tuple[Optimizer, int] | None:
        """The optimiser at this state, and how many steps of the history it has seen.

        None where the state does not belong to the history.
        """
        position = self._position(history)
        if position is None:
            return None
        problem = history.problem
        evaluations = []
        for step in history.steps[:position]:
            if isinstance(step, ChangeRecord):
                problem = step.problem
            else:
                evaluations.append(told_of(step, problem, history.model_input)._asdict())
        try:
            if Problem.from_dict(self.state["problem"]) != problem:
                return None
            return Optimizer.from_state({**self.state, "evaluations": evaluations}), position
        except Exception:  # whatever is wrong with it, the history says what is right
            return None

    def _position(self, history: History) -> int | None:
        """How many steps of the history the state has seen."""
        if self.run_id != history.run_id:
            return None
        evaluations = changes = 0
        for position, step in enumerate((*history.steps, None)):
            if (evaluations, changes) == (self.evaluations, self.changes):
                return position
            evaluations += isinstance(step, EvaluationRecord)
            changes += isinstance(step, ChangeRecord)
        return None


def checksum(text: bytes) -> bytes:
    """What stands below a state, by which it is known to be whole."""
    return hashlib.sha256(text).hexdigest().encode()

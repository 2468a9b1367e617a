"""What the models of a run say, computed by a program of its own, which reads the run's folder.

Neither the tuner nor the page waits for it: it has the low priority of the page, and one is asked at a time.
"""

from __future__ import annotations

import asyncio
import json
import subprocess
import sys
import time
from dataclasses import dataclass, field
from typing import Any

from mobo_tuner.page.history import History

PROGRAM = "mobo_tuner.runs.report.insight"
TIMEOUT = 120.0  # [s]
PERIOD = 15.0  # [s] at least between two looks at the same point of a run that goes on


@dataclass(frozen=True)
class Insight:
    """What the models say, or why nothing is known.

    Attributes:
        content: Answer of the program, see `mobo_tuner.runs.report.insight`; empty if there is none.
        trouble: Reason why there is none; empty otherwise.
        made: Time of the answer, by `time.monotonic` [s].
    """

    content: dict[str, Any] = field(default_factory=dict)
    trouble: str = ""
    made: float = field(default_factory=time.monotonic)


class Insights:
    """Asks for the models of runs, and keeps the last answer of each point.

    Args:
        history: Runs of the folder.
    """

    def __init__(self, history: History) -> None:
        self._history = history
        self._known: dict[tuple[str, int | None], Insight] = {}
        self._free = asyncio.Lock()

    def known(self, run_id: str, index: int | None) -> Insight | None:
        """Return the last answer; None if there is none yet.

        Args:
            run_id: Id of the run.
            index: Index of the evaluation for the slices; None for the last one.
        """
        return self._known.get((run_id, index))

    def is_due(self, run_id: str, index: int | None, evaluations: int) -> bool:
        """Return whether it is time to ask, `evaluations` being the number of evaluations now."""
        known = self.known(run_id, index)
        if self._free.locked():
            return False
        if known is None:
            return evaluations > 0
        old = time.monotonic() - known.made > PERIOD
        return old and known.content.get("evaluations") != evaluations

    async def ask(self, run_id: str, index: int | None) -> None:
        """Ask the program, and keep its answer."""
        if self._free.locked():
            return
        async with self._free:
            answer = await asyncio.to_thread(self._ask, run_id, index)
            while len(self._known) >= 20:
                del self._known[next(iter(self._known))]
            self._known.pop((run_id, index), None)
            self._known[run_id, index] = answer

    def _ask(self, run_id: str, index: int | None) -> Insight:
        folder = self._history.folder_of(run_id)
        if folder is None:
            return Insight(trouble="The models are known from the run's folder, which is not here.")
        words = [sys.executable, "-P", "-m", PROGRAM, str(folder)]
        words += [] if index is None else ["--index", str(index)]
        try:
            done = subprocess.run(
                words, capture_output=True, text=True, timeout=TIMEOUT, check=False
            )
            if done.returncode == 0:
                return Insight(json.loads(done.stdout))
            lines = done.stderr.strip().splitlines()
            return Insight(trouble=lines[-1] if lines else f"it ended with {done.returncode}")
        except subprocess.TimeoutExpired:
            return Insight(trouble=f"it took longer than {TIMEOUT:.0f} s")
        except (OSError, ValueError) as error:
            return Insight(trouble=str(error))

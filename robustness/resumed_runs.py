"""Compare killed and resumed runs with uninterrupted ones, bit for bit.

Each run tunes the toy problem with a constraint, failed evaluations, set-points from an operator and changes of the
problem. It runs in a process that is killed (SIGKILL) at one to three random moments; the next process only has the
run folder. At the end, every set-point, measurement and hypervolume and the next suggestion are compared with those of
a run that was never killed.

Results are kept in experiments/.cache: an interrupted campaign continues where it stopped.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from experiments.problems import cached
from mobo_tuner.runs.history import History
from mobo_tuner.runs.journal import FILE_NAME, read_journal
from mobo_tuner.runs.replay import restore
from mobo_tuner.runs.saved_state import SavedState
from robustness.offline_run import OfflineRun, toy, toy_optimizer

LENGTH = 14  # evaluations of a run
_COMPARED = ("index", "source", "setpoint", "diagnostics", "valid", "feasible", "hypervolume")


def carry_out(run: OfflineRun) -> dict[str, float]:
    """Continue a run to its end, and return its next suggestion."""
    while len(run.optimizer.dataset) < LENGTH:
        run.step()
    run.log.close()
    return run.ask()


def begin(folder: Path, *, seed: int) -> OfflineRun:
    """Return a new run."""
    return OfflineRun(folder, toy_optimizer(seed), toy, seed)


def resume(earlier: Path, folder: Path, *, seed: int) -> OfflineRun:
    """Return a run that resumes an earlier one from its folder."""
    history = History.from_records(read_journal(earlier))
    optimizer = restore(history, SavedState.read(earlier))
    return OfflineRun(folder, optimizer, toy, seed, earlier=history)


def kill_during(start: Callable[[], OfflineRun], seconds: float) -> None:
    """Carry out a run in a child process, and kill it after `seconds`."""
    child = os.fork()
    if child == 0:
        try:
            carry_out(start())
        finally:
            os._exit(0)
    time.sleep(seconds)  # the kill comes at a random moment, whatever the run does then
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)


def kept(folder: Path) -> list[dict[str, Any]]:
    """Return the compared fields of the evaluations in a journal."""
    records = [r for r in read_journal(folder) if r["type"] == "evaluation"]
    return [{key: record[key] for key in _COMPARED} for record in records]


def compare(seed: int) -> dict[str, Any]:
    """Kill and resume the run of one seed, and compare it with the uninterrupted run."""
    rng = np.random.default_rng([seed, 1])
    with tempfile.TemporaryDirectory() as scratch:
        whole = Path(scratch, "whole")
        started = time.monotonic()
        asked = carry_out(begin(whole, seed=seed))
        duration = time.monotonic() - started
        start = partial(begin, seed=seed)
        told = [0]
        for number in range(int(rng.integers(1, 4))):
            folder = Path(scratch, f"run-{number}")
            rest = 1.0 - told[-1] / LENGTH
            kill_during(partial(start, folder), duration * rest * rng.random())
            journal = folder / FILE_NAME
            if (
                journal.exists() and b"\n" in journal.read_bytes()
            ):  # otherwise the run was killed before it began
                start = partial(resume, folder, seed=seed)
                told.append(len(kept(folder)))
        last = Path(scratch, "last")
        asked_now = carry_out(start(last))
        same = asked_now == asked and kept(last) == kept(whole)
        return {"seed": seed, "killed_after": told[1:], "same": same}


def main() -> int:
    """Carry out the missing comparisons, and print the results of all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=100, metavar="N", help="number of runs")
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="seed of the first run")
    options = parser.parse_args()
    path = cached("resumed-runs.jsonl")
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    results = {result["seed"]: result for result in map(json.loads, lines)}
    wanted = range(options.seed, options.seed + options.runs)
    with path.open("a", encoding="utf-8") as file:
        for seed in wanted:
            if seed not in results:
                results[seed] = compare(seed)
                print(json.dumps(results[seed]), file=file, flush=True)
    chosen = [results[seed] for seed in wanted]
    kills = [count for result in chosen for count in result["killed_after"]]
    different = [result["seed"] for result in chosen if not result["same"]]
    print(
        f"{len(chosen)} runs of {LENGTH} evaluations, killed {len(kills)} times after {min(kills)} to "
        f"{max(kills)} evaluations: {len(chosen) - len(different)} identical to uninterrupted ones"
    )
    if different:
        print(f"not identical: {different}")
    return 1 if different else 0


if __name__ == "__main__":
    sys.exit(main())

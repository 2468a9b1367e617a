"""Runs of an experiment: planned, computed in any order, kept in one small file, and continued where they stopped.

A finished run is a record in the experiment's file. Its version is a digest of the function and the arguments that made
it, the surrogate and the core: after a change of these, the next call computes it again and replaces it. A record also
has the commit and the date of its computation, because a file may have runs of several.
"""

from __future__ import annotations

import argparse
import ctypes
import hashlib
import json
import os
import platform
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, field
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from multiprocessing import active_children, get_context
from pathlib import Path
from typing import Any

import numpy as np

from experiments.problems import surrogate_digest
from experiments.run_cache import core_digest
from mobo_tuner.core.arrays import FloatArray
from mobo_tuner.files import replace_file
from robustness.processes import exit_at_sigterm

ROOT = Path(__file__).resolve().parent.parent
RESULTS = ROOT / "experiments" / "results"
PACKAGES = ("numpy", "scipy", "numba", "matplotlib", "pygmo", "torch", "pymoo", "botorch", "xopt")
_PR_SET_PDEATHSIG = 1

Record = dict[str, Any]
"""Result of one run: short lists of rounded numbers and strings, by name."""


@dataclass(frozen=True)
class Size:
    """Amount of an experiment to compute.

    Attributes:
        quick: Whether to check only that everything works, within seconds.
        seeds: Number of seeds in place of the experiment's own; None keeps it.
    """

    quick: bool = False
    seeds: int | None = None

    def number(self, full: int, quick: int) -> int:
        """Return the number of evaluations, steps or points for this size."""
        return quick if self.quick else full

    def seeds_of(self, full: int) -> range:
        """Return the seeds for this size, in place of `full` ones."""
        return range(1 if self.quick and self.seeds is None else self.seeds or full)


@dataclass(frozen=True)
class PlannedRun:
    """A run that an experiment needs.

    Attributes:
        label: Name of the method or the case.
        seed: Seed of the run.
        function: Function of the seed and the arguments that returns the record; at the top of a module.
        arguments: Arguments of the function, values of JSON.
        uses_core: Whether the result depends on the sources of the optimiser's core.
    """

    label: str
    seed: int
    function: Callable[..., Record]
    arguments: Mapping[str, Any] = field(default_factory=dict)
    uses_core: bool = True

    @property
    def version(self) -> str:
        """Eight hexadecimal digits that identify function, arguments, surrogate and core."""
        belongs: list[Any] = [self.function.__name__, dict(self.arguments), surrogate_digest()]
        belongs += [core_digest()] if self.uses_core else []
        return hashlib.sha256(json.dumps(belongs, sort_keys=True).encode()).hexdigest()[:8]

    def compute(self) -> tuple[Record, float]:
        """Return the record and the CPU time that it took [s]."""
        start = time.process_time()
        record = self.function(self.seed, **self.arguments)
        return record, time.process_time() - start


class Results:
    """Finished runs of an experiment, in a JSON file.

    Args:
        path: File, which may be missing.

    Attributes:
        path: File.
        about: Command, versions and date of the last computation.
        runs: Records by label and seed.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.about: dict[str, Any] = {}
        self.runs: dict[str, dict[int, Record]] = {}
        if path.exists():
            content = json.loads(path.read_text(encoding="utf-8"))
            self.about = content["about"]
            self.runs = {
                label: {int(seed): record for seed, record in records.items()}
                for label, records in content["runs"].items()
            }

    def missing(self, plan: Iterable[PlannedRun]) -> list[PlannedRun]:
        """Return the planned runs that are not there, or of another version."""
        return [
            run
            for run in plan
            if self.runs.get(run.label, {}).get(run.seed, {}).get("version") != run.version
        ]

    def add(self, run: PlannedRun, record: Record, seconds: float, about: dict[str, Any]) -> None:
        """Keep a finished run, and write the file.

        Args:
            run: Run.
            record: Its result.
            seconds: CPU time [s], unless the result says what it took in all.
            about: Command, versions and date.
        """
        made = {"version": run.version, "commit": about["commit"], "date": about["date"]}
        kept = {"seconds": round(seconds, 1)} | record | made
        self.runs.setdefault(run.label, {})[run.seed] = kept
        self.about = about
        self.path.parent.mkdir(parents=True, exist_ok=True)
        replace_file(self.path, self._text().encode())

    def records(self, label: str) -> list[Record]:
        """Return the records of a label in the order of their seeds."""
        return [record for _, record in sorted(self.runs.get(label, {}).items())]

    def curves(self, label: str, name: str = "hypervolumes") -> FloatArray:
        """Return one series of each run of a label `(r, n)`, cut to the shortest; `(0, 0)` without runs."""
        series = [np.array(record[name], dtype=float) for record in self.records(label)]
        if not series:
            return np.empty((0, 0))
        shortest = min(map(len, series))
        return np.stack([values[:shortest] for values in series])

    def values(self, label: str, name: str) -> FloatArray:
        """Return one number of each run of a label `(r,)`."""
        return np.array([record[name] for record in self.records(label)], dtype=float)

    def commits(self, label: str) -> list[str]:
        """Return the commits at which the runs of a label were computed, those of lower seeds first."""
        return list(dict.fromkeys(record["commit"] for record in self.records(label)))

    def _text(self) -> str:
        """Return the file's text: a line for each run."""
        blocks = []
        for label, records in sorted(self.runs.items()):
            lines = [
                f"   {json.dumps(str(seed))}: {json.dumps(record, separators=(',', ':'))}"
                for seed, record in sorted(records.items())
            ]
            blocks.append(f"  {json.dumps(label)}: {{\n" + ",\n".join(lines) + "\n  }")
        about = json.dumps(self.about)
        return f'{{\n "about": {about},\n "runs": {{\n' + ",\n".join(blocks) + "\n }\n}\n"


def compute(plan: Sequence[PlannedRun], results: Results, command: str, workers: int = 1) -> None:
    """Compute the planned runs that are missing, each of which is kept as soon as it is finished.

    Args:
        plan: Runs, the first ones first.
        results: Results so far.
        command: Command that computes them, for the record.
        workers: Number of processes. They end with this one.
    """
    missing = results.missing(plan)
    about = _about(command)
    done = len(plan) - len(missing)

    def keep(run: PlannedRun, finished: tuple[Record, float]) -> None:
        nonlocal done
        done += 1
        results.add(run, *finished, about)
        print(
            f"{results.path.stem}: {run.label}, seed {run.seed}: {finished[1]:.1f} s of CPU time "
            f"({done} of {len(plan)})",
            flush=True,
        )

    if workers == 1 or len(missing) < 2:
        for run in missing:
            keep(run, run.compute())
        return
    with ProcessPoolExecutor(workers, get_context("spawn"), _end_with_parent) as executor:
        futures = {executor.submit(run.compute): run for run in missing}
        try:
            for future in as_completed(futures):
                keep(futures[future], future.result())
        except BaseException:
            for process in active_children():  # otherwise the pool would wait for their runs
                process.terminate()
            raise


def _end_with_parent() -> None:
    """Let the system end this process when its parent dies, where it can (Linux)."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


def _about(command: str) -> dict[str, Any]:
    """Return command, versions and date of a computation."""
    versions = {"python": platform.python_version()}
    for package in PACKAGES:
        try:
            versions[package] = version(package)
        except PackageNotFoundError:
            continue
    commit = subprocess.run(
        ["git", "rev-parse", "--short", "HEAD"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=10,
        check=False,
    ).stdout.strip()
    return {
        "command": command,
        "date": f"{datetime.now(UTC):%Y-%m-%d}",
        "commit": commit or "unknown",
        "versions": versions,
    }


def require_one_thread() -> None:
    """End the program unless numerical libraries use one thread, which runs and times rely on."""
    if os.environ.get("OMP_NUM_THREADS") != "1":
        sys.exit("OMP_NUM_THREADS must be 1: several threads are slower and change the last digits")


def parse_options(
    parser: argparse.ArgumentParser,
    arguments: Sequence[str] | None,
    kind: str,
    known: Collection[str],
) -> argparse.Namespace:
    """Return the options of a command, and have it end in order at SIGTERM.

    Args:
        parser: Parser of the command's own options.
        arguments: Command line; by default that of the process.
        kind: Name of the option that lists what to compute.
        known: What there is to compute.
    """
    parser.add_argument(kind, nargs="*", metavar=kind[:-1].upper(), help=", ".join(known))
    parser.add_argument("--quick", action="store_true", help="few evaluations; nothing is kept")
    parser.add_argument("--seeds", type=int, help="number of runs of each method")
    parser.add_argument("--workers", type=int, default=1, help="number of processes")
    parser.add_argument(
        "--draw", action="store_true", help="compute nothing: draw and compare what is there"
    )
    options = parser.parse_args(arguments)
    unknown = set(getattr(options, kind)) - set(known)
    if unknown:
        parser.error(f"unknown: {', '.join(unknown)}; there are {', '.join(known)}")
    require_one_thread()
    exit_at_sigterm()
    return options


def rounded(values: Iterable[float], digits: int = 5) -> list[float]:
    """Return numbers with so many significant digits, for a record."""
    return [float(f"{value:.{digits}g}") for value in values]

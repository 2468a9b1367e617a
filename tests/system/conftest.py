"""Fixtures of tests of the entry script with real nodes."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.support.mobo_run import ROOT, Run


@contextlib.contextmanager
def runs_in(folder: Path) -> Iterator[Callable[..., Run]]:
    """A function that starts `mobo.py run`, or `mobo.py resume` of the run that is named by `resumed`."""
    started: list[Run] = []
    runs_dir = folder / "runs"

    def start(
        *arguments: str, config: str = "toy.yaml", run_id: str = "run", resumed: str = ""
    ) -> Run:
        verb = (
            ("resume", resumed) if resumed else ("run", "--config", str(ROOT / "config" / config))
        )
        process = subprocess.Popen(
            [
                *(sys.executable, str(ROOT / "mobo.py"), *verb, "--runs-dir", str(runs_dir)),
                *("--run-id", run_id, "--no-dashboard", *arguments),
            ],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        started.append(Run(process, runs_dir, run_id))
        return started[-1]

    yield start
    for run in started:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(run.process.pid, signal.SIGKILL)
        run.process.communicate(timeout=10.0)
        for pid in run.processes():
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Callable[..., Run]]:
    """Start a run in the test's own folder."""
    with runs_in(tmp_path) as start:
        yield start

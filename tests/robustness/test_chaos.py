"""A few of the random kills of robustness/chaos.py, one each of bridge, recorder, machine and tuner."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from tests.support.mobo_run import ROOT


@pytest.mark.timeout(300)
def test_random_kills_lose_nothing() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "robustness.chaos", "--fresh", "--seed", "99", "--kills", "4"],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=280.0,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "4 kills: 1 bridge, 1 recorder, 1 machine, 1 tuner" in done.stdout

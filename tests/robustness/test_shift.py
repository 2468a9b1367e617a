"""A short version of the campaign of random shifts, and the shortening of a shift that failed."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from robustness.shift import Act, draw, shorten

ROOT = Path(__file__).parents[2]


def test_a_random_shift_keeps_its_promises() -> None:
    done = subprocess.run(
        [
            *(sys.executable, "-m", "robustness.shift", "--actions=150", "--per-shift=75"),
            *("--seed=7", "--minutes=3"),
        ],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=280,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "150 actions in 2 shifts, 0 shifts failed" in done.stdout


def test_equal_seeds_draw_equal_shifts() -> None:
    assert draw(3, 50) == draw(3, 50)
    assert draw(3, 50) != draw(4, 50)


def test_a_shift_that_fails_is_shortened_to_what_is_needed() -> None:
    acts = draw(1, 60)
    needed = {acts[7], acts[41]}

    def fails(some: Sequence[Act]) -> bool:
        return needed <= set(some)

    assert set(shorten(acts, fails, time.monotonic() + 60.0)) == needed

"""Random shifts: what operators do and how the machine fails, against a model of what must hold.

The tuner's own node, a machine and an operator live in one process. A shift is a list of actions drawn from its seed:
runs, pauses, steps, skips, stops, cancels, set-points, changes of bounds, limits, references and budget, working points
with and without holding, withdrawals, queries of earlier runs, and faults of the machine, the recorder and the disk.
What must hold:

- every set-point that the tuner sends is inside the bounds as they are then, unless an operator said `anyway`;
- requests are answered in time, and refused without a run; a run ends when it is asked to;
- status, result, journal and a restored optimiser agree on counts, front and hypervolume;
- with a full disk or a dead recorder a run waits or goes on, loses nothing and says so;
- a pause or a wait has a reason; every answer names the run that was asked for; queries change nothing;
- every journal can be read and resumed, and no error is internal.

A shift that fails is shortened to the actions that are needed for it.
"""

from __future__ import annotations

import argparse
import os
import shutil
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from launcher.ros_domain import RosDomain
from robustness.shift_scene import WEIGHTS, Act, Shift

__all__ = ["Act", "draw", "shorten"]


def draw(seed: int, count: int) -> list[Act]:
    """Return the actions of a shift."""
    rng = np.random.default_rng([seed, 0])
    names = rng.choice(
        list(WEIGHTS), count, p=np.array([*WEIGHTS.values()]) / sum(WEIGHTS.values())
    )
    return [Act(str(name), (rng.random(), rng.random(), rng.random())) for name in names]


@contextmanager
def _folder() -> Iterator[Path]:
    folder = Path(tempfile.mkdtemp(prefix="shift-"))
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def live(seed: int, acts: Sequence[Act], domain: int) -> str:
    """Live one shift; return what did not hold, or nothing."""
    with _folder() as folder:
        shift = Shift(folder, seed, domain)
        try:
            for number, act in enumerate(acts):
                try:
                    shift.act(act)
                except Exception as error:  # whatever it is, it is a finding
                    return f"action {number}, {act.name}: {type(error).__name__}: {error}"
            try:
                shift.end()
            except Exception as error:
                return f"at the end: {type(error).__name__}: {error}"
        finally:
            shift.close()
    return ""


def shorten(
    acts: Sequence[Act], fails: Callable[[Sequence[Act]], bool], end: float
) -> Sequence[Act]:
    """Return as few of the actions as still fail, until a time by `time.monotonic` [s]."""
    size = max(1, len(acts) // 2)
    while size and time.monotonic() < end:
        start, shorter = 0, False
        while start < len(acts) and time.monotonic() < end:
            rest = [*acts[:start], *acts[start + size :]]
            if rest and fails(rest):
                acts, shorter = rest, True
            else:
                start += size
        if not shorter or size > 1:
            size = 0 if size == 1 else size // 2
    return acts


def main() -> int:
    """Live the shifts; print the failures, shortened, and a summary."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--actions", type=int, default=10_000, metavar="N")
    parser.add_argument("--per-shift", type=int, default=100, metavar="N")
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="seed of the first shift")
    parser.add_argument("--minutes", type=float, default=60.0, help="time for all shifts [min]")
    options = parser.parse_args()
    with RosDomain() as domain:
        os.environ.update(domain.environment)
        return _campaign(options, domain.id)


def _campaign(options: argparse.Namespace, domain: int) -> int:
    end = time.monotonic() + 60.0 * options.minutes
    lived: Counter[str] = Counter()
    failures = 0
    seed = options.seed
    while lived.total() < options.actions and time.monotonic() < end:
        acts = draw(seed, min(options.per_shift, options.actions - lived.total()))
        finding = live(seed, acts, domain)
        lived.update(act.name for act in acts)
        if finding:
            failures += 1

            def fails(some: Sequence[Act], seed: int = seed) -> bool:
                return bool(live(seed, some, domain))

            short = shorten(acts, fails, min(end, time.monotonic() + 120.0))
            print(f"seed {seed}: {finding}\n  {len(short)} actions are enough:", flush=True)
            for act in short:
                print(f"    {act}", flush=True)
        seed += 1
    print(
        f"{lived.total()} actions in {seed - options.seed} shifts, {failures} shifts failed; "
        + ", ".join(f"{count} {name}" for name, count in lived.most_common())
    )
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())

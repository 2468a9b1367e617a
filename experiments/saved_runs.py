"""Runs of the optimiser that take long: kept in experiments/.cache as they go, and gone on with by the next call.

A saved run belongs to its benchmark, its settings, its seed, and the sources of the core and the surrogate, by a digest
of them all: after a change of any, another run starts. As the optimiser goes on bitwise from its saved state, a run in
pieces ends where a run in one go does.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import time
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from experiments.problems import Benchmark, Run, cached, resume, surrogate_digest
from mobo_tuner.core import Optimizer, optimizer

SAVED_EVERY = 20.0  # seconds
_CORE = Path(optimizer.__file__).parent


def saved_run(
    name: str,
    benchmark: Benchmark,
    evaluations: int,
    seed: int,
    *,
    enough: float = math.inf,
    **settings: Any,
) -> Run:
    """As `problems.run`, from where the last call with these arguments was stopped.

    Args:
        name: of the benchmark, for the file.
        benchmark: problem and machine.
        evaluations: at most.
        seed: of the optimiser.
        enough: hypervolume at which the run ends.
        settings: of the optimiser.
    """
    belongs = [name, seed, settings, core_digest(), surrogate_digest()]
    digest = hashlib.sha256(json.dumps(belongs, sort_keys=True).encode()).hexdigest()[:12]
    path = cached(f"run-{name}-{seed}-{digest}.json")
    if path.exists():
        saved = json.loads(path.read_text(encoding="utf-8"))
        tuned = Optimizer.from_state(saved["state"])
        curve, asks, cpu = (list(saved[key]) for key in ("hypervolumes", "asks", "cpu"))
        seconds = float(saved["seconds"])
    else:
        tuned = Optimizer(benchmark.problem, seed=seed, **settings)
        curve, asks, cpu, seconds = [], [], [], 0.0

    def save() -> None:
        values = {"hypervolumes": curve, "asks": asks, "cpu": cpu, "seconds": seconds}
        partial = path.with_suffix(".partial")
        partial.write_text(json.dumps(values | {"state": tuned.get_state()}), encoding="utf-8")
        os.replace(partial, path)

    last_save = time.monotonic()
    done = len(curve)
    while len(curve) < evaluations and max(curve, default=0.0) < enough:
        step = resume(benchmark, tuned, 1)
        curve.extend(step.hypervolumes)
        asks.extend(step.asks)
        cpu.extend(step.cpu)
        seconds += step.seconds
        if time.monotonic() - last_save > SAVED_EVERY:
            save()
            last_save, done = time.monotonic(), len(curve)
    if len(curve) > done:
        save()
    return Run(
        tuned,
        np.array(curve[:evaluations]),
        np.array(asks[:evaluations]),
        np.array(cpu[:evaluations]),
        seconds,
    )


@cache
def core_digest() -> str:
    """Eight hexadecimal digits that change with the sources of the core."""
    digest = hashlib.sha256()
    for path in sorted(_CORE.glob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:8]

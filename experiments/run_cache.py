"""Long runs of the optimiser: saved in experiments/.cache during the run, and continued by the next call.

The key of a run is a digest of its benchmark, settings, seed, and the sources of the core and the surrogate: after a
change of any of them, a new run starts. Because the optimiser continues bit for bit from its saved state, an
interrupted run gives the same result as an uninterrupted one.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import time
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from experiments.problems import Benchmark, Run, cached, resume, surrogate_digest
from mobo_tuner.core import Optimizer, optimizer
from mobo_tuner.core.prior_mean import PriorMean

SAVED_EVERY = 20.0  # seconds
_CORE = Path(optimizer.__file__).parent


def cached_run(
    name: str,
    benchmark: Benchmark,
    evaluations: int,
    seed: int,
    *,
    enough: float = math.inf,
    prior_means: Mapping[str, PriorMean] | None = None,
    **settings: Any,
) -> Run:
    """Do the same as `problems.run`, continuing the saved run of an earlier call with these arguments.

    Args:
        name: Name of the benchmark, for the file.
        benchmark: Problem and machine.
        evaluations: Highest number of evaluations.
        seed: Seed of the optimiser.
        enough: Hypervolume at which the run ends.
        prior_means: Prior means; the name of the benchmark must say that there are some.
        settings: Settings of the optimiser.
    """
    belongs = [name, seed, settings, core_digest(), surrogate_digest()]
    digest = hashlib.sha256(json.dumps(belongs, sort_keys=True).encode()).hexdigest()[:12]
    path = cached(f"run-{name}-{seed}-{digest}.json")
    if path.exists():
        saved = json.loads(path.read_text(encoding="utf-8"))
        tuned = Optimizer.from_state(saved["state"], prior_means)
        curve, asks, cpu = (list(saved[key]) for key in ("hypervolumes", "asks", "cpu"))
        seconds = float(saved["seconds"])
    else:
        tuned = Optimizer(benchmark.problem, seed=seed, prior_means=prior_means, **settings)
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
    """Return eight hexadecimal digits that identify the sources of the core."""
    digest = hashlib.sha256()
    for path in sorted(_CORE.glob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:8]

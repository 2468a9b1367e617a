"""One optimiser on one problem: the same starts, noise and number of evaluations for all."""

from __future__ import annotations

import signal
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import numpy as np

from experiments.beliefs import output_ranges
from experiments.campaign import Record, rounded
from experiments.peers.methods import METHODS, output_names
from experiments.peers.problems import EVERY
from experiments.problems import Benchmark
from mobo_tuner.core.arrays import FloatArray
from mobo_tuner.core.hypervolume import BoxDecomposition
from mobo_tuner.core.initial_design import initial_design


def race(
    seed: int,
    problem: str,
    method: str,
    noise: float,
    evaluations: int,
    limit: float,
    batch: int = 1,
) -> Record:
    """Return the record of a run: the hypervolumes of the noiseless values at the feasible set-points so far.

    All methods start from the Latin hypercube of the seed, with two points more than twice the number of variables,
    and read the same noise at the same number of evaluations. They are not told how large it is.

    Args:
        seed: Seed of starts, noise and method.
        problem: Name of the problem.
        method: Name of the method.
        noise: Standard deviation of the noise, as a share of each output's range.
        evaluations: Number of evaluations, including the starts.
        limit: CPU time after which the run is stopped [s].
        batch: Number of set-points that are asked for at once.
    """
    benchmark = EVERY[problem]()
    d = len(benchmark.problem.variables)
    starts = min(2 * d + 2, evaluations)
    x = initial_design("latin_hypercube", starts, benchmark.problem.domain, seed)
    ranges = output_ranges(benchmark)
    sigma = noise * np.array([ranges[name] for name in output_names(benchmark)])
    normals = np.random.default_rng([seed, 77]).standard_normal((evaluations, len(sigma)))
    truth = outputs(benchmark, x)
    seconds = []
    warnings.simplefilter("ignore")
    with suppress(_TimeIsUpError), _cpu_limit(limit):
        suggest = METHODS[method](benchmark, starts, seed, batch)
        while len(x) < evaluations:
            begin = time.process_time()
            suggested = np.clip(suggest(x, truth + sigma * normals[: len(x)]), -1.0, 1.0)
            seconds.append(time.process_time() - begin)
            x = np.vstack([x, suggested])
            truth = np.vstack([truth, outputs(benchmark, suggested)])
    record: Record = {"hypervolumes": rounded(hypervolumes(benchmark, truth), 6)}
    if seconds:
        record["suggestion"] = rounded([float(np.median(seconds))], 3)[0]
    if len(x) < evaluations:
        record["stopped"] = len(x)
    return record


def outputs(benchmark: Benchmark, x: FloatArray) -> FloatArray:
    """Return the noiseless objectives and constrained diagnostics `(n, P + C)`."""
    others = benchmark.others or {}
    names = [c.name for c in benchmark.problem.constraints]
    return np.column_stack([benchmark.objectives(x), *(others[name](x) for name in names)])


def hypervolumes(benchmark: Benchmark, values: FloatArray) -> FloatArray:
    """Return the hypervolume of the feasible evaluations so far, after each of them `(n,)`."""
    problem = benchmark.problem
    n_objectives = len(problem.objectives)
    limits = np.array([c.maximum for c in problem.constraints])
    feasible = np.all(values[:, n_objectives:] <= limits, axis=1).tolist()
    boxes = BoxDecomposition(problem.reference_point)
    gains = [
        boxes.add(row[:n_objectives]) if met else 0.0
        for row, met in zip(values, feasible, strict=True)
    ]
    return np.cumsum(gains) / benchmark.unit


class _TimeIsUpError(BaseException):
    """The run has used its CPU time; whatever it is doing then, it may not take this for a failure of its own."""


@contextmanager
def _cpu_limit(seconds: float) -> Iterator[None]:
    """Raise an error in the block when the process has used so much more CPU time.

    It is raised again after each further second: code that must not fail, such as a callback of a compiled library,
    may have swallowed it.
    """

    def stop(*_: object) -> None:
        raise _TimeIsUpError

    former = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, seconds, 1.0)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, former)

"""Sets of evaluations to start from, in seven objectives and six variables."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

import numpy as np

from experiments.problems import Benchmark, awa, cached, run, surrogate_digest
from mobo_tuner.core import Optimizer, Problem
from mobo_tuner.core.arrays import FloatArray

N_OBJECTIVES = 7
N_VARIABLES = 6
NAMES = ["awa", "smooth", "sphere"]

Told = list[tuple[dict[str, float], dict[str, tuple[float, float]]]]
"""Set-points and measured values with standard deviations."""


@dataclass
class Archive:
    """A benchmark problem and evaluations of it.

    Attributes:
        benchmark: Problem and machine.
        told: Evaluations.
    """

    benchmark: Benchmark
    told: Told

    def optimizer(self, n: int, **settings: Any) -> Optimizer:
        """Return an optimiser with the first n evaluations."""
        optimizer = Optimizer(self.benchmark.problem, **settings)
        for setpoint, outputs in self.told[:n]:
            optimizer.tell(setpoint, outputs)
        return optimizer


def archive(name: str, n: int, seed: int = 0) -> Archive:
    """Return an archive with n evaluations.

    Args:
        name: "awa", a run of the optimiser on the AWA surrogate; "smooth", points near the Pareto set of squared
            distances to seven points, which is their hull; or "sphere", with all points on a concave sphere, which is
            the front with the most boxes.
        n: Number of evaluations.
        seed: Seed of the evaluations.
    """
    if name == "awa":
        record = awa_record(n, "default", seed)
        outputs = [
            {
                name: (mean, np.nan if stddev is None else stddev)
                for name, (mean, stddev) in evaluation["outputs"].items()
            }
            for evaluation in record["state"]["evaluations"]
        ]
        setpoints = [evaluation["setpoint"] for evaluation in record["state"]["evaluations"]]
        return Archive(awa(), list(zip(setpoints, outputs, strict=True)))
    benchmark, x = (smooth if name == "smooth" else sphere)(n, seed)
    names = benchmark.problem.objective_names
    return Archive(
        benchmark,
        [
            (
                benchmark.problem.denormalize(row),
                {name: (value, np.nan) for name, value in zip(names, values, strict=True)},
            )
            for row, values in zip(x, benchmark.objectives(x), strict=True)
        ],
    )


def awa_record(evaluations: int, preset: str, seed: int) -> dict[str, Any]:
    """Return the state and the times of a run on the AWA surrogate, from the cache if it is there."""
    path = cached(f"archive-{surrogate_digest()}-{preset}-{evaluations}-{seed}.json")
    if not path.exists():
        made = run(awa(), evaluations, seed, preset=preset)
        record = {
            "state": made.optimizer.get_state(),
            "hypervolumes": made.hypervolumes.tolist(),
            "asks": made.asks.tolist(),
            "cpu": made.cpu.tolist(),
            "seconds": made.seconds,
        }
        path.write_text(json.dumps(record), encoding="utf-8")
    record = json.loads(path.read_text(encoding="utf-8"))
    assert isinstance(record, dict)
    return record


def smooth(n: int, seed: int) -> tuple[Benchmark, FloatArray]:
    """Return the problem of squared distances to seven points, and inputs `(n, d)` near their hull."""
    centers = np.random.default_rng(1).uniform(-1.0, 1.0, (N_OBJECTIVES, N_VARIABLES))
    rng = np.random.default_rng(seed)
    shares = rng.dirichlet(np.ones(N_OBJECTIVES), n)
    x = np.clip(shares @ centers + 0.1 * rng.standard_normal((n, N_VARIABLES)), -1.0, 1.0)
    return (
        _benchmark(
            lambda x: np.square(x[:, None] - centers).sum(axis=2) / N_VARIABLES, reference=2.0
        ),
        x,
    )


def sphere(n: int, seed: int) -> tuple[Benchmark, FloatArray]:
    """Return a problem whose objectives lie on a concave sphere, none dominated, and inputs `(n, d)`."""
    rng = np.random.default_rng(seed)
    x = rng.uniform(-1.0, 1.0, (n, N_VARIABLES))
    mixing = rng.standard_normal((N_VARIABLES, N_OBJECTIVES))

    def objectives(inputs: FloatArray) -> FloatArray:
        share = np.exp(inputs @ mixing)
        return 2.0 * share / np.linalg.norm(share, axis=1, keepdims=True) - 1.0

    return _benchmark(objectives, reference=1.0), x


def _benchmark(objectives: Any, reference: float) -> Benchmark:
    variables = {f"x{i}": {"min": -1.0, "max": 1.0} for i in range(N_VARIABLES)}
    outputs = {f"f{i}": {"reference": reference} for i in range(N_OBJECTIVES)}
    problem = Problem.from_dict({"variables": variables, "objectives": outputs})
    return Benchmark(problem, objectives)

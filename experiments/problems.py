"""Test problems with noiseless machines, runs of the optimiser on them, and a cache for results."""

from __future__ import annotations

import hashlib
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from awa_sim_node.surrogate import Surrogate
from awa_sim_node.surrogate import metadata as surrogate_metadata
from mobo_tuner.core import Optimizer, Problem
from mobo_tuner.core.arrays import FloatArray
from mobo_tuner.core.hypervolume import hypervolume
from mobo_tuner.core.prior_mean import PriorMean

CACHE = Path(__file__).resolve().parent / ".cache"
AWA_OUTPUTS = ("sigma_x", "sigma_y", "sigma_z", "eps_x", "eps_y", "eps_z", "dE")
AWA_CONFIG = Path(__file__).resolve().parent.parent / "config" / "awa.yaml"
SURROGATE_FOLDER = Path(surrogate_metadata.__file__).parent


@dataclass(frozen=True)
class Benchmark:
    """A problem and its machine.

    Attributes:
        problem: Problem; every objective is minimised.
        objectives: Function from normalised set-points `(n, d)` to objectives `(n, P)`.
        unit: Unit of the hypervolume.
        others: Functions from normalised set-points `(n, d)` to other diagnostics `(n,)`, by name.
        fails: Function that returns whether the evaluation at a set-point in physical units fails.
    """

    problem: Problem
    objectives: Callable[[FloatArray], FloatArray]
    unit: float = 1.0
    others: dict[str, Callable[[FloatArray], FloatArray]] | None = None
    fails: Callable[[dict[str, float]], bool] | None = None

    def measure(self, setpoint: dict[str, float]) -> dict[str, float]:
        """Return all diagnostics at a set-point in physical units; none if the evaluation fails."""
        if self.fails is not None and self.fails(setpoint):
            return {}
        x = self.problem.normalize(setpoint)[None]
        values = dict(zip(self.problem.objective_names, self.objectives(x)[0], strict=True))
        return values | {name: other(x)[0] for name, other in (self.others or {}).items()}

    def score(self, objectives: FloatArray) -> float:
        """Return the hypervolume of objectives `(n, P)`, in `unit`."""
        return hypervolume(objectives, self.problem.reference_point) / self.unit


@dataclass
class Run:
    """Result of a run of the optimiser.

    Attributes:
        optimizer: Optimiser at the end of the run.
        hypervolumes: Hypervolume after each evaluation in the benchmark's unit, `(n,)`.
        asks: Wall time of each `ask` [s], `(n,)`.
        cpu: CPU time of each `ask` [s], `(n,)`.
        seconds: Wall time of the whole run [s].
    """

    optimizer: Optimizer
    hypervolumes: FloatArray
    asks: FloatArray
    cpu: FloatArray
    seconds: float


def run(
    benchmark: Benchmark,
    evaluations: int,
    seed: int,
    *,
    enough: float = math.inf,
    **settings: Any,
) -> Run:
    """Run the optimiser, including its initial design.

    Args:
        benchmark: Problem and machine.
        evaluations: Highest number of evaluations.
        seed: Seed of the optimiser.
        enough: Hypervolume at which the run ends.
        settings: Settings of the optimiser.
    """
    optimizer = Optimizer(benchmark.problem, seed=seed, **settings)
    return resume(benchmark, optimizer, evaluations, enough)


def resume(
    benchmark: Benchmark, optimizer: Optimizer, evaluations: int, enough: float = math.inf
) -> Run:
    """Continue with `evaluations` more evaluations, or until a hypervolume of `enough`."""
    hypervolumes: list[float] = []
    asks, cpu = [], []
    start = time.perf_counter()
    while len(hypervolumes) < evaluations and max(hypervolumes, default=0.0) < enough:
        before = time.perf_counter(), time.process_time()
        setpoint = optimizer.ask()
        asks.append(time.perf_counter() - before[0])
        cpu.append(time.process_time() - before[1])
        optimizer.tell(setpoint, benchmark.measure(setpoint))
        hypervolumes.append(optimizer.hypervolume / benchmark.unit)
    seconds = time.perf_counter() - start
    return Run(optimizer, np.array(hypervolumes), np.array(asks), np.array(cpu), seconds)


PERFECT: dict[str, Any] = {"acquisition": "ucb_hvi", "beta": 0.0, "exploration": 0.0}
"""Settings of the greedy method with perfect knowledge: the largest improvement by the prior means."""


def prior_means(benchmark: Benchmark) -> dict[str, PriorMean]:
    """Return the true outputs as prior means: the models then know everything.

    No method that only looks one evaluation ahead can do much better: the limit in plots of convergence.
    """
    problem = benchmark.problem
    low, high = np.array([(v.minimum, v.maximum) for v in problem.variables]).T
    known: tuple[FloatArray, FloatArray] = (np.empty((0, 0)), np.empty((0, 0)))

    def normalised(columns: Mapping[str, FloatArray]) -> FloatArray:
        setpoints = np.stack([columns[name] for name in problem.variable_names], axis=1)
        return np.asarray(2.0 * (setpoints - low) / (high - low) - 1.0)

    def objective(columns: Mapping[str, FloatArray], j: int) -> FloatArray:
        nonlocal known
        x = normalised(columns)
        if not np.array_equal(known[0], x):  # all objectives are asked one after the other
            known = x, benchmark.objectives(x)
        return known[1][:, j]

    means: dict[str, PriorMean] = {
        name: partial(objective, j=j) for j, name in enumerate(problem.objective_names)
    }

    def other(columns: Mapping[str, FloatArray], name: str) -> FloatArray:
        assert benchmark.others is not None
        return benchmark.others[name](normalised(columns))

    return means | {name: partial(other, name=name) for name in benchmark.others or {}}


def first_reaching(hypervolumes: FloatArray, enough: float) -> int | None:
    """Return the number of evaluations after which the hypervolume is at least `enough`, or None."""
    reached = np.flatnonzero(hypervolumes >= enough)
    return int(reached[0]) + 1 if len(reached) else None


def toy_objectives(x: FloatArray) -> FloatArray:
    """Return the distances to (1, 1) and (-1, -1) over [-2, 2]^2: the paper's Eq. (5), eqn:toy_problem."""
    return np.stack(
        [np.linalg.norm(2.0 * x - 1.0, axis=1), np.linalg.norm(2.0 * x + 1.0, axis=1)], axis=1
    )


def toy(constrained: bool = False, failing: bool = False) -> Benchmark:
    """Return the paper's toy problem; the unit is the true hypervolume for the reference point 4.3.

    Args:
        constrained: Whether x_1 <= 0.5 is required (figure toy_constrained).
        failing: Whether every evaluation at x_1 > 0 fails.
    """
    reference = 4.3
    definition: dict[str, Any] = {
        "variables": {name: {"min": -2.0, "max": 2.0} for name in ("x1", "x2")},
        "objectives": {name: {"reference": reference} for name in ("f1", "f2")},
    }
    if constrained:
        definition["constraints"] = {"g": {"max": 0.5}}
    length = 2.0 * math.sqrt(2.0)
    # The front is the line from (0, length) to (length, 0).
    true = reference**2 - 0.5 * length**2
    others = {"g": lambda x: 2.0 * x[:, 0]} if constrained else None
    fails = (lambda setpoint: setpoint["x1"] > 0.0) if failing else None
    return Benchmark(Problem.from_dict(definition), toy_objectives, true, others, fails)


def dtlz2(n_objectives: int = 3, n_variables: int = 6) -> Benchmark:
    """Return DTLZ2 with reference point 2; its front is the positive part of the unit sphere."""

    def objectives(x: FloatArray) -> FloatArray:
        unit = 0.5 * (x + 1.0)
        angles = 0.5 * math.pi * unit[:, : n_objectives - 1]
        radius = 1.0 + np.square(unit[:, n_objectives - 1 :] - 0.5).sum(axis=1)
        columns = []
        for i in range(n_objectives):
            value = radius * np.cos(angles[:, : n_objectives - 1 - i]).prod(axis=1)
            columns.append(value * np.sin(angles[:, -i]) if i else value)
        return np.stack(columns, axis=1)

    reference, half = 2.0, 0.5 * n_objectives
    ball = math.pi**half / math.gamma(half + 1.0) / 2.0**n_objectives
    definition = {
        "variables": {f"x{i}": {"min": 0.0, "max": 1.0} for i in range(n_variables)},
        "objectives": {f"f{i}": {"reference": reference} for i in range(n_objectives)},
    }
    return Benchmark(Problem.from_dict(definition), objectives, reference**n_objectives - ball)


def awa() -> Benchmark:
    """Return the AWA surrogate with six variables and seven objectives, as in the paper's section sec:accelerator.

    The reference point is the highest value of each objective. In the benchmark's unit, the hypervolume is that of
    objectives scaled to [-1, 1] with reference point 1; the whole box has 2^7.
    """
    return awa_variant()


def awa_variant(
    kept: Sequence[str] = (), limit: float | None = None, preferred: bool = False
) -> Benchmark:
    """Return `awa` with fewer objectives or a limit of dE.

    Args:
        kept: Names of the objectives in place of all seven.
        limit: Limit of dE [MeV], if there is one.
        preferred: Whether the limit is a preference (truncation) of the objective dE; otherwise it is a constraint in
            its place.
    """
    config = Problem.from_yaml(AWA_CONFIG)
    ranges = surrogate_metadata.output_ranges()
    objectives_of = {
        name: {"reference": float(ranges[name][1])} for name in kept or config.objective_names
    }
    definition: dict[str, Any] = {
        "variables": {v: {"min": a, "max": b} for v, (a, b) in _limits(config).items()},
        "objectives": objectives_of,
    }
    if limit is not None and preferred:
        definition["objectives"]["dE"] = {"reference": limit, "truncation": [0.0, limit]}
    elif limit is not None:
        del objectives_of["dE"]
        definition["constraints"] = {"dE": {"max": limit}}
    names = tuple(objectives_of)
    low, high = np.array([ranges[name] for name in names]).T
    columns = [AWA_OUTPUTS.index(name) for name in names]
    predict = _awa_outputs(config)
    others = {} if preferred or limit is None else {"dE": lambda x: predict(x)[:, -1]}
    return Benchmark(
        Problem.from_dict(definition),
        lambda x: predict(x)[:, columns],
        float(np.prod(0.5 * (high - low))),
        others,
    )


def awa_normalised(objectives: FloatArray) -> FloatArray:
    """Return all seven objectives `(n, 7)` of the AWA surrogate, scaled to [-1, 1] over their ranges."""
    ranges = surrogate_metadata.output_ranges()
    low, high = np.array([ranges[name] for name in AWA_OUTPUTS]).T
    return np.asarray(2.0 * (objectives - low) / (high - low) - 1.0)


def _awa_outputs(config: Problem) -> Callable[[FloatArray], FloatArray]:
    """Return the function from normalised set-points `(n, 6)` to the outputs `(n, 7)`, as in AWA_OUTPUTS."""
    surrogate = Surrogate.load()
    held = [surrogate.defaults[i.name] for i in surrogate_metadata.INPUTS[len(config.variables) :]]
    lower, upper = np.array(list(_limits(config).values())).T
    outputs = [[o.name for o in surrogate_metadata.OUTPUTS].index(name) for name in AWA_OUTPUTS]

    def predict(x: FloatArray) -> FloatArray:
        settings = lower + 0.5 * (np.clip(x, -1.0, 1.0) + 1.0) * (upper - lower)
        inputs = np.hstack([settings, np.tile(held, (len(x), 1))])
        return np.asarray(surrogate.predict_array(inputs)[:, outputs])

    return predict


def _limits(problem: Problem) -> dict[str, tuple[float, float]]:
    """Return the bounds of the variables, in the order of the surrogate's inputs."""
    bounds = {v.name: (v.minimum, v.maximum) for v in problem.variables}
    return {i.name: bounds[i.name] for i in surrogate_metadata.SETTINGS}


def surrogate_digest() -> str:
    """Return eight hexadecimal digits that identify the surrogate."""
    digest = hashlib.sha256()
    for name in ("weights.npz", "trained.json"):
        digest.update((SURROGATE_FOLDER / name).read_bytes())
    return digest.hexdigest()[:8]


def cached(name: str) -> Path:
    """Return the path of a file in the cache folder, which is created if it is missing."""
    CACHE.mkdir(exist_ok=True)
    return CACHE / name

"""The methods that the paper compares with: NSGA-II, iterated neural networks, and random search, all in serial.

All of them start from the Latin hypercube of the same seed as the optimiser with the preset `paper`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from itertools import pairwise
from typing import Any

import numpy as np
import pygmo
from numba import njit

from experiments.problems import Benchmark
from mobo_tuner.core.arrays import FloatArray
from mobo_tuner.core.hypervolume import BoxDecomposition
from mobo_tuner.core.initial_design import initial_design
from mobo_tuner.core.pareto import is_below, is_nondominated

POPULATION = 20  # NSGA-II of the paper, with the two probabilities
CROSSOVER, MUTATION = 0.8, 0.05
MANY = 1000  # points of a front whose exact hypervolume would take minutes in seven objectives
SAMPLES = 300_000

# Iterated networks; the paper does not say how large they are.
BATCH = 20  # measurements between two trainings
HIDDEN = (50, 50)
EPOCHS, RATE, DECAY = 1000, 3e-3, 1e-5
SEARCHED, GENERATIONS = 100, 150  # population and generations of NSGA-II on a network


def starts(benchmark: Benchmark, n: int, seed: int) -> FloatArray:
    """Return the first n set-points of the preset `paper` with this seed, normalised `(n, d)`."""
    return initial_design("latin_hypercube", n, benchmark.problem.domain, seed)


def hypervolumes(benchmark: Benchmark, objectives: FloatArray) -> FloatArray:
    """Return the exact hypervolume after each of the objectives `(n, P)`, `(n,)`."""
    boxes = BoxDecomposition(benchmark.problem.reference_point)
    return np.cumsum([boxes.add(row) for row in objectives]) / benchmark.unit


def random_search(benchmark: Benchmark, evaluations: int, seed: int) -> FloatArray:
    """Return the objectives `(n, P)` at random set-points after the starts."""
    first = starts(benchmark, POPULATION, seed)
    rng = np.random.default_rng([seed, 12345])
    rest = rng.uniform(-1.0, 1.0, (evaluations - len(first), first.shape[1]))
    return benchmark.objectives(np.vstack([first, rest]))


class _Logged:
    """Problem for pygmo that keeps the objectives of all evaluations; copies share them."""

    def __init__(self, d: int, n_objectives: int, function: Callable[..., FloatArray]) -> None:
        self.d, self.n_objectives, self.function = d, n_objectives, function
        self.log: list[FloatArray] = []

    def __deepcopy__(self, _: object) -> _Logged:
        return self

    def get_nobj(self) -> int:
        return self.n_objectives

    def get_bounds(self) -> tuple[list[float], list[float]]:
        return [-1.0] * self.d, [1.0] * self.d

    def fitness(self, x: FloatArray) -> FloatArray:
        y = self.function(np.asarray(x)[None])[0]
        self.log.append(y)
        return y

    def batch_fitness(self, x: FloatArray) -> FloatArray:
        return self.function(np.asarray(x).reshape(-1, self.d)).ravel()


def nsga2(benchmark: Benchmark, evaluations: int, seed: int) -> tuple[FloatArray, FloatArray]:
    """Return all objectives `(n, P)` that NSGA-II evaluates, in order, and those of its last population.

    The population of 20 starts with the Latin hypercube. 0.05 is the probability of each variable to mutate.
    """
    problem = benchmark.problem
    logged = _Logged(len(problem.variables), len(problem.objectives), benchmark.objectives)
    population = pygmo.population(pygmo.problem(logged))
    for x in starts(benchmark, POPULATION, seed):
        population.push_back(x)
    method = pygmo.nsga2(
        gen=math.ceil(evaluations / POPULATION) - 1, cr=CROSSOVER, m=MUTATION, seed=seed + 1
    )
    population = pygmo.algorithm(method).evolve(population)
    return np.array(logged.log[:evaluations]), np.asarray(population.get_f())


def iterated_network(
    benchmark: Benchmark, evaluations: int, seed: int
) -> tuple[FloatArray, list[tuple[int, float]]]:
    """Return all objectives `(n, P)` that iterated neural networks evaluate, and what they predicted.

    A network learns all evaluations; NSGA-II finds its front; a batch drawn from that is measured; and so on.

    Returns:
        The objectives in order, and after each training the number of evaluations and the hypervolume of the front
        that the network predicts.
    """
    import torch

    torch.manual_seed(seed)
    torch.set_num_threads(1)
    rng = np.random.default_rng([seed, 54321])
    x = starts(benchmark, POPULATION, seed)
    y = benchmark.objectives(x)
    sizes = [x.shape[1], *HIDDEN, y.shape[1]]
    layers: list[Any] = []
    for inputs, outputs in pairwise(sizes):
        layers += [torch.nn.Linear(inputs, outputs), torch.nn.Tanh()]
    network = torch.nn.Sequential(*layers[:-1]).double()
    predicted = []
    while len(x) < evaluations:
        mean, spread = y.mean(axis=0), y.std(axis=0)
        _train(network, x, (y - mean) / spread)
        weights = [(p.detach().numpy()) for p in network.parameters()]

        def predict(
            points: FloatArray,
            weights: list[FloatArray] = weights,
            mean: FloatArray = mean,
            spread: FloatArray = spread,
        ) -> FloatArray:
            for matrix, offset in zip(weights[0:-2:2], weights[1:-2:2], strict=True):
                points = np.tanh(points @ matrix.T + offset)
            return mean + spread * (points @ weights[-2].T + weights[-1])

        logged = _Logged(x.shape[1], y.shape[1], predict)
        population = pygmo.population(pygmo.problem(logged), SEARCHED, seed=len(x) + seed)
        method = pygmo.nsga2(gen=GENERATIONS, cr=CROSSOVER, m=MUTATION, seed=len(x) + seed + 1)
        method.set_bfe(pygmo.bfe(pygmo.member_bfe()))
        population = pygmo.algorithm(method).evolve(population)
        candidates, values = np.asarray(population.get_x()), np.asarray(population.get_f())
        predicted.append((len(x), benchmark.score(values)))
        front = np.flatnonzero(is_nondominated(values))
        batch = min(BATCH, evaluations - len(x), len(front))
        new = candidates[rng.choice(front, batch, replace=False)]
        x, y = np.vstack([x, new]), np.vstack([y, benchmark.objectives(new)])
    return y, predicted


def _train(network: Any, x: FloatArray, z: FloatArray) -> None:
    """Train a network on inputs `(n, d)` and standardised outputs `(n, P)`, from its last weights."""
    import torch

    inputs, outputs = torch.from_numpy(x), torch.from_numpy(z)
    adam = torch.optim.Adam(network.parameters(), lr=RATE, weight_decay=DECAY)
    for _ in range(EPOCHS):
        adam.zero_grad()
        loss = torch.nn.functional.mse_loss(network(inputs), outputs)
        loss.backward()
        adam.step()


def hypervolumes_at(
    benchmark: Benchmark, objectives: FloatArray, at: Iterable[int], seed: int
) -> list[tuple[int, float, float]]:
    """Return numbers of evaluations, the hypervolume after them and its standard error, 0 if it is exact."""
    rng = np.random.default_rng(seed)
    found = []
    for n in at:
        front = objectives[:n]
        front = front[is_below(front, benchmark.problem.reference_point)]
        front = front[is_nondominated(front)]
        found.append((n, *_any_hypervolume(benchmark, front, rng)))
    return found


def _any_hypervolume(
    benchmark: Benchmark, front: FloatArray, rng: np.random.Generator
) -> tuple[float, float]:
    """Return the hypervolume of a front `(n, P)` and its standard error, 0 if it is exact."""
    reference = benchmark.problem.reference_point
    if len(front) <= MANY:
        return benchmark.score(front), 0.0
    ideal = front.min(axis=0)
    box = float(np.prod(reference - ideal)) / benchmark.unit
    # Large dominated volumes first, so that a dominating point is found quickly for most samples.
    order = np.argsort(-np.log(reference - front).sum(axis=1))
    samples = ideal + (reference - ideal) * rng.random((SAMPLES, len(ideal)))
    share = _dominated(front[order], samples) / SAMPLES
    return box * share, box * math.sqrt(share * (1.0 - share) / SAMPLES)


@njit(cache=True)
def _dominated(front: FloatArray, samples: FloatArray) -> int:
    """Return the number of samples that the front dominates."""
    count = 0
    for sample in samples:
        for point in front:
            worse = False
            for j in range(len(sample)):
                if point[j] > sample[j]:
                    worse = True
                    break
            if not worse:
                count += 1
                break
    return count

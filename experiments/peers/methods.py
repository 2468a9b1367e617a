"""The optimisers that are compared, each behind one function: the next set-points from all that was measured.

Set-points are normalised to [-1, 1], objectives are minimised, constraints are met up to their maximum. Xopt runs with
its defaults, BoTorch's qLogNEHVI with independent models and the settings of its tutorial (128 Sobol samples, 10
restarts, 512 raw samples), pymoo's NSGA-II with a population of 20. Those need `experiments/requirements.txt`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib.util import find_spec
from typing import Any

import numpy as np

from experiments.problems import PERFECT, Benchmark, prior_means
from mobo_tuner.core import Optimizer
from mobo_tuner.core.arrays import FloatArray

Suggester = Callable[[FloatArray, FloatArray], FloatArray]
"""Function from inputs `(n, d)` and measured outputs `(n, P + C)` to the next inputs `(q, d)`."""

POPULATION = 20


def output_names(benchmark: Benchmark) -> list[str]:
    """Return the names of the objectives and, after them, of the constrained diagnostics."""
    return [*benchmark.problem.objective_names, *(c.name for c in benchmark.problem.constraints)]


def ours(benchmark: Benchmark, starts: int, seed: int, count: int, **settings: Any) -> Suggester:
    """Return this project's optimiser, which keeps its models from suggestion to suggestion."""
    optimizer = Optimizer(benchmark.problem, seed=seed, initial_evaluations=starts, **settings)
    names = output_names(benchmark)

    def suggest(x: FloatArray, y: FloatArray) -> FloatArray:
        for row in range(len(optimizer.dataset), len(x)):
            setpoint = benchmark.problem.denormalize(x[row])
            optimizer.tell(setpoint, dict(zip(names, map(float, y[row]), strict=True)))
        if count == 1:
            return benchmark.problem.normalize(optimizer.ask())[None]
        return np.array([benchmark.problem.normalize(asked) for asked in optimizer.ask(count)])

    return suggest


def perfect(benchmark: Benchmark, starts: int, seed: int, count: int) -> Suggester:
    """Return the greedy method that knows the true outputs."""
    means = prior_means(benchmark)
    return ours(benchmark, starts, seed, count, prior_means=means, **PERFECT)


def random_search(benchmark: Benchmark, _: int, seed: int, count: int) -> Suggester:
    """Return random search."""
    rng = np.random.default_rng([seed, 12345])
    d = len(benchmark.problem.variables)
    return lambda _x, _y: rng.uniform(-1.0, 1.0, (count, d))


def xopt(benchmark: Benchmark, _: int, seed: int, count: int) -> Suggester:
    """Return Xopt's MOBO generator."""
    import pandas as pd
    import torch
    from gest_api.vocs import VOCS
    from xopt.generators.bayesian.mobo import MOBOGenerator

    problem, names = benchmark.problem, output_names(benchmark)
    torch.manual_seed(seed)
    inputs = [f"x{i}" for i in range(len(problem.variables))]
    vocs = VOCS(
        variables={name: [-1.0, 1.0] for name in inputs},
        objectives=dict.fromkeys(problem.objective_names, "MINIMIZE"),
        constraints={c.name: ["LESS_THAN", c.maximum] for c in problem.constraints},
    )
    reference = {o.name: float(o.reference) for o in problem.objectives}
    generator = MOBOGenerator(vocs=vocs, reference_point=reference)

    def suggest(x: FloatArray, y: FloatArray) -> FloatArray:
        told = 0 if generator.data is None else len(generator.data)
        generator.add_data(pd.DataFrame(np.hstack([x, y])[told:], columns=[*inputs, *names]))
        candidates = generator.generate(count)
        return np.array([[candidate[name] for name in inputs] for candidate in candidates])

    return suggest


def botorch(benchmark: Benchmark, _: int, seed: int, count: int) -> Suggester:
    """Return BoTorch's qLogNEHVI; it chooses the points of a batch one after the other."""
    import torch
    from botorch.acquisition.multi_objective.logei import qLogNoisyExpectedHypervolumeImprovement
    from botorch.acquisition.multi_objective.objective import IdentityMCMultiOutputObjective
    from botorch.fit import fit_gpytorch_mll
    from botorch.models import ModelListGP, SingleTaskGP
    from botorch.models.transforms import Standardize
    from botorch.optim import optimize_acqf
    from botorch.sampling import SobolQMCNormalSampler
    from gpytorch.mlls import SumMarginalLogLikelihood

    torch.set_default_dtype(torch.float64)
    torch.manual_seed(seed)
    problem = benchmark.problem
    d, n_objectives = len(problem.variables), len(problem.objectives)
    limits = [c.maximum for c in problem.constraints]
    unit = torch.tensor([[0.0] * d, [1.0] * d])
    reference = -torch.tensor(problem.reference_point)

    def suggest(x: FloatArray, y: FloatArray) -> FloatArray:
        inputs, outputs = torch.tensor(0.5 * (x + 1.0)), torch.tensor(y)
        outputs[:, :n_objectives] *= -1.0
        model = ModelListGP(
            *(
                SingleTaskGP(inputs, outputs[:, i : i + 1], outcome_transform=Standardize(1))
                for i in range(outputs.shape[1])
            )
        )
        fit_gpytorch_mll(SumMarginalLogLikelihood(model.likelihood, model))
        constraints = [
            lambda z, j=j, limit=limit: z[..., n_objectives + j] - limit
            for j, limit in enumerate(limits)
        ]
        acquisition = qLogNoisyExpectedHypervolumeImprovement(
            model,
            reference,
            inputs,
            sampler=SobolQMCNormalSampler(torch.Size([128]), seed=seed),
            prune_baseline=True,
            objective=IdentityMCMultiOutputObjective(outcomes=list(range(n_objectives))),
            constraints=constraints or None,
        )
        candidates, _ = optimize_acqf(
            acquisition, unit, count, num_restarts=10, raw_samples=512, sequential=count > 1
        )
        return np.asarray(2.0 * candidates.detach().numpy() - 1.0)

    return suggest


def nsga2(benchmark: Benchmark, starts: int, seed: int, count: int) -> Suggester:
    """Return pymoo's NSGA-II; the starts and random points are its first population."""
    from pymoo.algorithms.moo.nsga2 import NSGA2
    from pymoo.core.evaluator import Evaluator
    from pymoo.core.problem import Problem as PymooProblem
    from pymoo.problems.static import StaticProblem

    d, n_objectives = len(benchmark.problem.variables), len(benchmark.problem.objectives)
    limits = np.array([c.maximum for c in benchmark.problem.constraints])
    rng = np.random.default_rng([seed, 2])
    extra = rng.uniform(-1.0, 1.0, (max(POPULATION - starts, 0), d))
    shape = {"n_var": d, "n_obj": n_objectives, "n_ieq_constr": len(limits)}
    definition = PymooProblem(**shape, xl=-np.ones(d), xu=np.ones(d))
    algorithm: Any = None
    population: Any = None
    asked = 0  # evaluations of all former populations

    def suggest(x: FloatArray, y: FloatArray) -> FloatArray:
        nonlocal algorithm, population, asked
        if len(x) < starts + len(extra):
            return extra[len(x) - starts :][:count]
        if algorithm is None:
            algorithm = NSGA2(pop_size=len(x), sampling=x)
            algorithm.setup(definition, termination=("n_gen", 10**6), seed=seed, verbose=False)
            population = algorithm.ask()
        while len(x) - asked == len(population):
            new = y[asked:]
            values = {"F": new[:, :n_objectives]}
            if len(limits):
                values["G"] = new[:, n_objectives:] - limits
            Evaluator().eval(StaticProblem(definition, **values), population)
            algorithm.tell(infills=population)
            asked = len(x)
            population = algorithm.ask()
        return np.asarray(population.get("X")[len(x) - asked :][:count])

    return suggest


METHODS: Mapping[str, Callable[[Benchmark, int, int, int], Suggester]] = {
    "default": lambda b, n, s, q: ours(b, n, s, q, preset="default"),
    "paper": lambda b, n, s, q: ours(b, n, s, q, preset="paper"),
    "perfect": perfect,
    "random": random_search,
    "nsga2": nsga2,
    "botorch": botorch,
    "xopt": xopt,
}
NEEDED = {"nsga2": "pymoo", "botorch": "botorch", "xopt": "xopt"}


def installed() -> list[str]:
    """Return the names of the methods whose packages are installed."""
    return [name for name in METHODS if name not in NEEDED or find_spec(NEEDED[name])]

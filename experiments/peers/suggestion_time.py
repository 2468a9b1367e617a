"""CPU time of one suggestion, compared with Xopt's MOBO and BoTorch's qLogEHVI on one thread.

The data are the same `n` Latin-hypercube points of DTLZ2 in six variables, followed by the suggestions of each
optimiser. Xopt runs with its defaults, BoTorch with the settings of its own tutorial (128 Sobol samples, 10 restarts,
512 raw samples). Needs experiments/requirements.txt.
"""

from __future__ import annotations

import argparse
import math
import os
import time
import warnings
from collections.abc import Callable, Iterator

import numpy as np
import pandas as pd
import torch
from botorch.acquisition.multi_objective.logei import qLogExpectedHypervolumeImprovement
from botorch.fit import fit_gpytorch_mll
from botorch.models import ModelListGP, SingleTaskGP
from botorch.models.transforms import Standardize
from botorch.optim import optimize_acqf
from botorch.sampling import SobolQMCNormalSampler
from botorch.utils.multi_objective.box_decompositions.non_dominated import (
    FastNondominatedPartitioning,
)
from gest_api.vocs import VOCS
from gpytorch.mlls import SumMarginalLogLikelihood
from scipy.stats import qmc
from xopt.generators.bayesian.mobo import MOBOGenerator

from mobo_tuner.core import Optimizer, Problem
from mobo_tuner.core.hypervolume import hypervolume

N_VARIABLES = 6
REFERENCE = 2.0

Array = np.ndarray
Suggester = Callable[[Array, Array], Array]


def dtlz2(x: Array, n_objectives: int) -> Array:
    """Return DTLZ2 of one point `(d,)` in [0, 1], `(P,)`; its front is on the unit sphere."""
    radius = 1.0 + float(np.square(x[n_objectives - 1 :] - 0.5).sum())
    angles = 0.5 * np.pi * x[: n_objectives - 1]
    values = np.full(n_objectives, radius)
    for i in range(n_objectives):
        values[i] *= np.cos(angles[: n_objectives - 1 - i]).prod()
        if i > 0:
            values[i] *= np.sin(angles[n_objectives - 1 - i])
    return values


def ours(n_objectives: int) -> Suggester:
    """Return this project's optimiser with its default preset; it keeps its models, as in a run."""
    problem = Problem.from_dict(
        {
            "variables": {f"x{j}": {"min": 0.0, "max": 1.0} for j in range(N_VARIABLES)},
            "objectives": {f"y{i}": {"reference": REFERENCE} for i in range(n_objectives)},
        }
    )
    optimizer = Optimizer(problem, initial_evaluations=1)

    def suggest(x: Array, y: Array) -> Array:
        for row in range(len(optimizer.dataset), len(x)):
            optimizer.tell(
                {f"x{j}": v for j, v in enumerate(x[row])},
                {f"y{i}": v for i, v in enumerate(y[row])},
            )
        return np.array(list(optimizer.ask().values()))

    return suggest


def xopt(n_objectives: int) -> Suggester:
    """Return Xopt's MOBO generator with its defaults."""
    vocs = VOCS(
        variables={f"x{j}": [0.0, 1.0] for j in range(N_VARIABLES)},
        objectives={f"y{i}": "MINIMIZE" for i in range(n_objectives)},
    )
    reference = {f"y{i}": REFERENCE for i in range(n_objectives)}
    generator = MOBOGenerator(vocs=vocs, reference_point=reference)

    def suggest(x: Array, y: Array) -> Array:
        told = 0 if generator.data is None else len(generator.data)
        columns = [*(f"x{j}" for j in range(N_VARIABLES)), *(f"y{i}" for i in range(n_objectives))]
        generator.add_data(pd.DataFrame(np.hstack([x, y])[told:], columns=columns))
        candidate = generator.generate(1)[0]
        return np.array([candidate[f"x{j}"] for j in range(N_VARIABLES)])

    return suggest


def botorch(n_objectives: int) -> Suggester:
    """Return BoTorch's qLogEHVI with independent models, as in its tutorial."""
    bounds = torch.tensor([[0.0] * N_VARIABLES, [1.0] * N_VARIABLES], dtype=torch.float64)
    reference = torch.full((n_objectives,), -REFERENCE, dtype=torch.float64)

    def suggest(x: Array, y: Array) -> Array:
        inputs, outputs = torch.tensor(x), -torch.tensor(y)
        model = ModelListGP(
            *(
                SingleTaskGP(inputs, outputs[:, i : i + 1], outcome_transform=Standardize(1))
                for i in range(n_objectives)
            )
        )
        fit_gpytorch_mll(SumMarginalLogLikelihood(model.likelihood, model))
        acquisition = qLogExpectedHypervolumeImprovement(
            model,
            reference,
            FastNondominatedPartitioning(reference, outputs),
            SobolQMCNormalSampler(torch.Size([128])),
        )
        candidate, _ = optimize_acqf(acquisition, bounds, 1, num_restarts=10, raw_samples=512)
        return candidate.detach().numpy()[0]

    return suggest


PEERS: dict[str, Callable[[int], Suggester]] = {"xopt": xopt, "botorch": botorch}


def suggestions(
    suggest: Suggester, n: int, n_objectives: int, limit: float
) -> Iterator[tuple[float, float]]:
    """Yield the CPU time of consecutive suggestions [s] until their sum exceeds a limit.

    The second value is the hypervolume of all points, as a share of that of the true front.

    Args:
        suggest: Optimiser.
        n: Number of initial points.
        n_objectives: Number of objectives.
        limit: Limit of the CPU time [s].
    """
    x = qmc.LatinHypercube(N_VARIABLES, seed=np.random.default_rng(1)).random(n)
    y = np.array([dtlz2(row, n_objectives) for row in x])
    # The true front is the part of the unit sphere with positive coordinates.
    sphere = math.pi ** (n_objectives / 2) / math.gamma(n_objectives / 2 + 1)
    volume = REFERENCE**n_objectives - sphere / 2**n_objectives
    spent = 0.0
    while spent < limit:
        started = time.process_time()
        candidate = suggest(x, y)
        seconds = time.process_time() - started
        spent += seconds
        x, y = np.vstack([x, candidate]), np.vstack([y, dtlz2(candidate, n_objectives)])
        yield seconds, hypervolume(y, np.full(n_objectives, REFERENCE)) / volume


def main() -> None:
    """Time every peer in every case."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--cases",
        nargs="+",
        default=["2:20", "3:20", "3:100", "5:20"],
        help="numbers of objectives and initial points, P:n",
    )
    parser.add_argument(
        "--peers", nargs="+", choices=list(PEERS), default=list(PEERS), help="peers to time"
    )
    parser.add_argument(
        "--suggestions", type=int, default=5, help="highest number of suggestions of each optimiser"
    )
    parser.add_argument(
        "--limit", type=float, default=150.0, help="CPU time limit for each optimiser and case [s]"
    )
    options = parser.parse_args()
    if os.environ.get("OMP_NUM_THREADS") != "1":
        parser.error("OMP_NUM_THREADS must be 1, so that all use one thread")
    warnings.simplefilter("ignore")
    torch.set_num_threads(1)
    torch.set_default_dtype(torch.float64)
    list(zip(range(3), suggestions(ours(2), 8, 2, 60.0), strict=False))  # warm-up: compilation

    names = ["ours", *options.peers]
    print(f"{', '.join(names)}: median CPU time of a suggestion [s], and hypervolume after them")
    for case in options.cases:
        n_objectives, n = (int(word) for word in case.split(":"))
        for make, name in zip((ours, *(PEERS[name] for name in options.peers)), names, strict=True):
            made = suggestions(make(n_objectives), n, n_objectives, options.limit)
            taken = [step for _, step in zip(range(options.suggestions), made, strict=False)]
            seconds = float(np.median([seconds for seconds, _ in taken]))
            print(
                f"P={n_objectives} n={n:3d} {name:>8} {seconds:8.3f} s, "
                f"{taken[-1][1]:.4f} after {len(taken)} suggestions",
                flush=True,
            )


if __name__ == "__main__":
    main()

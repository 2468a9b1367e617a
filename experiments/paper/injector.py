"""Runs on the AWA surrogate, section sec:accelerator: seven objectives of six variables, scaled to [-1, 1].

Runs of the optimiser are those of `run_cache`: one with more evaluations continues one with fewer, so that experiments
share runs.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from experiments.campaign import Record, rounded
from experiments.paper import baselines
from experiments.problems import (
    AWA_OUTPUTS,
    PERFECT,
    Benchmark,
    awa,
    awa_normalised,
    awa_variant,
    first_reaching,
    prior_means,
)
from experiments.run_cache import cached_run
from mobo_tuner.core.arrays import FloatArray
from mobo_tuner.core.hypervolume import hypervolume
from mobo_tuner.core.pareto import is_nondominated

PICTURED = 0  # seed of the single runs in a picture
INITIAL = {"paper": 20, "default": 8}  # points of the initial design, which no model chooses
LIMIT = 0.52  # of dE [MeV]
# Only in quick runs: the paper's are 5000 and 1000.
QUICK: dict[str, Any] = {"adam_steps": 100, "adam_retraining_steps": 20}
CASES: dict[str, Callable[[], Benchmark]] = {
    "nothing": awa,
    "preference": lambda: awa_variant(limit=LIMIT, preferred=True),
    "constraint": lambda: awa_variant(limit=LIMIT),
}


def tune(
    seed: int,
    evaluations: int,
    preset: str,
    case: str = "nothing",
    proximal: float | None = None,
    quick: bool = False,
) -> Record:
    """Return the record of a run of the optimiser.

    Args:
        seed: Seed.
        evaluations: Number of evaluations, including the initial design.
        preset: Preset of the optimiser.
        case: Name in `CASES`: what is asked of dE.
        proximal: Precision of proximal biasing in normalised variables.
        quick: Whether the training is cut short.
    """
    name = "awa" if case == "nothing" else f"awa-{case}"
    settings: dict[str, Any] = {"preset": preset} | (QUICK if quick else {})
    if proximal is not None:
        settings["proximal"] = proximal
    run = cached_run(name, CASES[case](), evaluations, seed, **settings)
    x = run.optimizer.dataset.inputs[:evaluations]
    record = describe(seed, awa().objectives(x), run.hypervolumes)
    record["asked_in"] = round(float(np.median(run.cpu)), 3)
    record["seconds"] = round(float(run.cpu.sum()), 1)  # also of what an earlier call computed
    if case == "nothing":
        record["K1"] = rounded(x[:, 0], 3)
        first = run.optimizer.initial_evaluations - 1
        record["step"] = round(float(np.linalg.norm(np.diff(x[first:], axis=0), axis=1).mean()), 4)
    return record


def tune_perfectly(seed: int, evaluations: int) -> Record:
    """Return the record of the greedy method that knows the true objectives, from the first of the starts."""
    benchmark = awa()
    means = prior_means(benchmark)
    settings = {"initial_evaluations": 1, **PERFECT}
    run = cached_run("awa-perfect", benchmark, evaluations, seed, prior_means=means, **settings)
    return {
        "hypervolumes": rounded(run.hypervolumes),
        "seconds": round(float(run.cpu.sum()), 1),
    }


def search_randomly(seed: int, evaluations: int) -> Record:
    """Return the record of a random search."""
    benchmark = awa()
    objectives = baselines.random_search(benchmark, evaluations, seed)
    return describe(seed, objectives, baselines.hypervolumes(benchmark, objectives))


def evolve(seed: int, evaluations: int, plotted: int) -> Record:
    """Return the record of NSGA-II: its first evaluations, and the hypervolume after more of them."""
    benchmark = awa()
    objectives, last = baselines.nsga2(benchmark, evaluations, seed)
    at = [n for n in (1000, 2000, 4000, 8000, 12_000) if n < evaluations] + [evaluations]
    record = describe(
        seed, objectives[:plotted], baselines.hypervolumes(benchmark, objectives[:plotted])
    )
    later = baselines.hypervolumes_at(benchmark, objectives, at, seed)
    record["later"] = [[n, *rounded([value, error], 4)] for n, value, error in later]
    record["last_population"] = rounded([benchmark.score(last)])[0]
    return record


def iterate_networks(seed: int, evaluations: int) -> Record:
    """Return the record of iterated neural networks, with the hypervolumes that they predicted."""
    benchmark = awa()
    objectives, predicted = baselines.iterated_network(benchmark, evaluations, seed)
    record = describe(seed, objectives, baselines.hypervolumes(benchmark, objectives))
    record["predicted"] = [[n, *rounded([value])] for n, value in predicted]
    return record


def describe(seed: int, objectives: FloatArray, hypervolumes: FloatArray) -> Record:
    """Return the common part of a record.

    It has the hypervolumes, which evaluations violate dE < 0.52 MeV, the share that is on the front at the end, how
    much of the front after 200 evaluations still is, and the areas below the two projected fronts of
    constrain_comparison; for the run that is drawn also the projections.

    Args:
        seed: Seed.
        objectives: All seven objectives of each evaluation `(n, 7)`.
        hypervolumes: Hypervolume after each evaluation `(n,)`.
    """
    scaled = awa_normalised(objectives)
    at = {name: scaled[:, AWA_OUTPUTS.index(name)] for name in ("sigma_x", "eps_x", "dE")}
    energy_spread = objectives[:, AWA_OUTPUTS.index("dE")]
    front = is_nondominated(objectives)
    early = np.flatnonzero(is_nondominated(objectives[:200]))
    met = energy_spread <= LIMIT
    record: Record = {
        "hypervolumes": rounded(hypervolumes),
        "violating": "".join("10"[int(m)] for m in met),
        "on_front": round(float(front.mean()), 3),
        "kept": round(float(front[early].mean()), 3),
        "area_sigma_x_eps_x": _area(at["sigma_x"], at["eps_x"]),
        "area_dE_eps_x": _area(at["dE"][met], at["eps_x"][met], scaled_limit()),
    }
    if seed == PICTURED:
        record |= {name: rounded(values, 4) for name, values in at.items()}
    return record


def scaled_limit() -> float:
    """Return the limit of dE, scaled to [-1, 1]."""
    return float(awa_normalised(np.full((1, len(AWA_OUTPUTS)), LIMIT))[0, AWA_OUTPUTS.index("dE")])


def reached(record: Record, enough: float) -> int | None:
    """Return the number of evaluations after which the hypervolume of a record is at least `enough`."""
    return first_reaching(np.array(record["hypervolumes"]), enough)


def _area(a: FloatArray, b: FloatArray, reference: float = 1.0) -> float:
    """Return the area that points dominate below (reference, 1) in two scaled objectives `(n,)`."""
    if not len(a):
        return 0.0
    return round(hypervolume(np.stack([a, b], axis=1), [reference + 1e-9, 1.0]), 4)

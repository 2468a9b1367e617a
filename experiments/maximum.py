"""Fraction of an acquisition function's maximum that the maximiser finds, and its cost.

For each archive and number of evaluations, the acquisition function is maximised with several seeds. The best known
value is the best of these searches and of one with far more starts, which is kept in experiments/.cache.

    python -m experiments.maximum --archives awa sphere --told 100 500 --acquisitions ehvi
"""

from __future__ import annotations

import argparse
import json
import time

import numpy as np

from experiments.archives import NAMES, archive
from experiments.problems import cached, surrogate_digest
from mobo_tuner.core import Optimizer
from mobo_tuner.core.acquisition_optimizer import Maximizer, MultiStart, ParticleSwarm
from mobo_tuner.core.merit import Merit

THOROUGH = MultiStart(
    screened=4096,
    screened_nearby=4096,
    far_starts=128,
    near_starts=256,
    far_apart=0.3,
    near_apart=0.05,
    steps=15,
    finished=48,
    behind=1.0,
    evaluations=60,
    tolerance=1e-7,
)
MAXIMIZERS: dict[str, Maximizer] = {"multi_start": MultiStart(), "particle_swarm": ParticleSwarm()}


def find(maximizer: Maximizer, optimizer: Optimizer, seed: int) -> tuple[float, float]:
    """Return the logarithm of the largest value found, and the CPU time [s]."""
    merit = Merit(optimizer.archive, optimizer.settings, seed)
    acquisition = merit.acquisition_function()
    assert acquisition is not None, "the models must have been trained"
    rows = [point["index"] for point in optimizer.pareto_front(measured=True)]
    starts = optimizer.dataset.inputs[rows]
    started = time.process_time()
    found = maximizer.maximize(
        acquisition, starts.shape[1], np.random.default_rng(seed), starts=starts
    )
    seconds = time.process_time() - started
    return (-np.inf if found is None else found.log_value), seconds


def main() -> None:
    """Print a row per archive, number of evaluations and acquisition function."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--archives", nargs="+", choices=NAMES, default=NAMES, help="sets of evaluations"
    )
    parser.add_argument(
        "--told", nargs="+", type=int, default=[60, 120, 250, 500], help="numbers of evaluations"
    )
    parser.add_argument(
        "--acquisitions", nargs="+", default=["ehvi", "ucb_hvi"], help="acquisition functions"
    )
    parser.add_argument(
        "--maximizer", choices=list(MAXIMIZERS), default="multi_start", help="maximiser"
    )
    parser.add_argument("--seeds", type=int, default=5, help="number of searches")
    options = parser.parse_args()

    path = cached(f"maxima-{surrogate_digest()}.json")
    best = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    print("fraction of the largest known value: mean, lowest; median CPU time of a search [s]")
    print("archive  told acquis.     mean  lowest   CPU s   thorough s")
    for name in options.archives:
        source = archive(name, 500)
        for told in options.told:
            for acquisition in options.acquisitions:
                optimizer = source.optimizer(told, acquisition=acquisition)
                optimizer.archive.update()
                key, thorough = f"{name} {told} {acquisition}", 0.0
                if key not in best:
                    best[key], thorough = find(THOROUGH, optimizer, 1000)
                searches = [
                    find(MAXIMIZERS[options.maximizer], optimizer, seed)
                    for seed in range(options.seeds)
                ]
                found, seconds = np.array(searches).T
                best[key] = max(best[key], float(found.max()))
                path.write_text(json.dumps(best), encoding="utf-8")
                share = np.exp(found - best[key])
                print(
                    f"{name:8s} {told:4d} {acquisition:8s} {share.mean():8.3f} {share.min():7.3f} "
                    f"{np.median(seconds):7.3f} {thorough:8.1f}",
                    flush=True,
                )


if __name__ == "__main__":
    main()

"""Batches of this project's optimiser beside those of Xopt's MOBO and BoTorch's qLogNEHVI, from the same starts.

    python -m experiments.peers.batches [--problems zdt1 dtlz2_3] [--rounds 5] [--size 4] [--seeds 3]

Finished runs are kept in experiments/results/batch_peers.json. Printed for each problem: the hypervolume at the end,
as a share of the true one where that is known, and the CPU time of a batch, medians of the seeds; then how many runs of
ours end at least as high as a peer's from the same starts. Needs `experiments/requirements.txt`.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

import numpy as np

from experiments.campaign import RESULTS, PlannedRun, Results, compute, require_one_thread
from experiments.peers.methods import installed
from experiments.peers.problems import PROBLEMS
from experiments.peers.race import race

OURS = "default"
PEERS = ("botorch", "xopt")
LEVEL = 1e-3  # share of a hypervolume that counts as level


def plan(
    problems: Sequence[str], methods: Sequence[str], rounds: int, size: int, seeds: int
) -> list[PlannedRun]:
    """Return the runs, seed by seed and the cheap ones first."""
    return [
        PlannedRun(
            f"{problem} {method}",
            seed,
            race,
            {
                "problem": problem,
                "method": method,
                "noise": 0.0,
                "evaluations": 2 * len(PROBLEMS[problem]().problem.variables) + 2 + rounds * size,
                "limit": 1200,
                "batch": size,
            },
            uses_core=method == OURS,
        )
        for seed in range(seeds)
        for problem in problems
        for method in methods
    ]


def report(results: Results, problems: Sequence[str]) -> list[str]:
    """Return a line for each problem and method, and one with the duels."""
    lines, duels = [], []
    for problem in problems:
        curves = {m: results.runs.get(f"{problem} {m}", {}) for m in (OURS, *PEERS)}
        for method, records in curves.items():
            if records:
                ends = [record["hypervolumes"][-1] for record in records.values()]
                times = [record["suggestion"] for record in records.values()]
                lines.append(
                    f"{problem:16s} {method:8s} {np.median(ends):8.4f} ({min(ends):.4f} to "
                    f"{max(ends):.4f})  {np.median(times):7.3f} s a batch, {len(ends)} runs"
                )
        for peer in PEERS:
            for seed in curves[OURS].keys() & curves[peer].keys():
                mine, other = (curves[m][seed]["hypervolumes"][-1] for m in (OURS, peer))
                duels.append(mine >= (1.0 - LEVEL) * other)
    lines.append(f"ahead or level in {sum(duels)} of {len(duels)} duels")
    return lines


def main(arguments: Sequence[str] | None = None) -> int:
    """Compute what is missing, and compare."""
    parser = argparse.ArgumentParser(
        prog="python -m experiments.peers.batches",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "--problems",
        nargs="+",
        choices=PROBLEMS,
        default=["branin_currin", "zdt1", "vehicle_safety", "dtlz2_3"],
    )
    parser.add_argument("--rounds", type=int, default=5, help="batches after the starts")
    parser.add_argument("--size", type=int, default=4, help="set-points of a batch")
    parser.add_argument("--seeds", type=int, default=3)
    options = parser.parse_args(arguments)
    require_one_thread()
    methods = [m for m in (OURS, *PEERS) if m in installed()]
    results = Results(RESULTS / "batch_peers.json")
    runs = plan(options.problems, methods, options.rounds, options.size, options.seeds)
    compute(runs, results, "python -m experiments.peers.batches")
    print("\n".join(report(results, options.problems)))
    return 0


if __name__ == "__main__":
    sys.exit(main())

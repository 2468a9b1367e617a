"""Time and memory of one suggestion in seven objectives, after a given number of evaluations.

The evaluations are a run of the optimiser on the AWA surrogate ("awa": kept in experiments/.cache with the times of
its whole loop, repeated when the surrogate changes), points near a known Pareto set ("smooth"), or points of a concave
sphere ("sphere": the front with the most boxes). Then several consecutive suggestions are timed, including training;
each is evaluated.

    python -m bench.suggestion_time --archive awa --acquisitions ehvi ucb_hvi
"""

from __future__ import annotations

import argparse
import resource

import numpy as np

from experiments.archives import NAMES, archive, awa_record
from experiments.problems import Run, resume


def report(name: str, timed: Run) -> None:
    """Print a row.

    Args:
        name: Name of the acquisition function.
        timed: Run with the timed suggestions.
    """
    front = len(timed.optimizer.pareto_front())
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**10
    print(
        f"{name:8s} {len(timed.optimizer.dataset):5d} {front:6d} {np.median(timed.asks):7.3f} "
        f"{timed.asks.mean():7.3f} {timed.asks.max():7.3f} {np.median(timed.cpu):7.3f} "
        f"{timed.cpu.mean():7.3f} {timed.cpu.max():7.3f} {peak:8.0f}",
        flush=True,
    )


def main() -> None:
    """Print a row for each acquisition function."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--archive", choices=NAMES, default="awa", help="set of evaluations")
    parser.add_argument(
        "--acquisitions", nargs="+", default=["ucb_hvi", "ehvi"], help="acquisition functions"
    )
    parser.add_argument(
        "--evaluations", type=int, default=500, help="number of evaluations before the first timing"
    )
    parser.add_argument("--asks", type=int, default=25, help="number of timed suggestions")
    parser.add_argument("--seed", type=int, default=0, help="seed of evaluations and optimiser")
    options = parser.parse_args()

    if options.archive == "awa":
        record = awa_record(options.evaluations, "default", options.seed)
        asks, cpu = np.array(record["asks"]), np.array(record["cpu"])
        print(
            f"whole loop of {options.evaluations} evaluations: {record['seconds']:.0f} s, CPU {cpu.sum():.0f} s; "
            f"an ask: median {np.median(asks):.3f} s, longest {asks.max():.2f} s; "
            f"hypervolume {record['hypervolumes'][-1]:.2f}"
        )
    source = archive(options.archive, options.evaluations, options.seed)

    print("wall and CPU time of one suggestion [s], peak memory of the process so far [MiB]")
    print("acquis.   told  front  median    mean     max     CPU    mean     max   memory")
    for acquisition in options.acquisitions:
        optimizer = source.optimizer(
            options.evaluations, seed=options.seed, acquisition=acquisition
        )
        first = resume(
            source.benchmark, optimizer, 1
        )  # the first training and possibly compilation
        print(f"first suggestion of {acquisition}, with its first training: {first.asks[0]:.2f} s")
        report(acquisition, resume(source.benchmark, optimizer, options.asks))


if __name__ == "__main__":
    main()

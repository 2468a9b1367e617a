"""Time and memory of one suggestion in seven objectives, with as many evaluations told.

The archive is a run of the optimiser itself on the AWA surrogate ("awa": kept in bench/.cache with the times of its
whole loop, made again when the surrogate changes) or points of a concave sphere ("sphere": the front of most boxes).
Then a number of suggestions in a row is timed, each told what the machine answers; trainings that fall due are
included.

    python bench/suggestion_time.py --archive awa --acquisitions ehvi ucb_hvi
"""

from __future__ import annotations

import argparse
import json
import resource
from typing import Any

import numpy as np
from problems import Benchmark, Run, awa, cached, resume, run, surrogate_digest

from mobo_tuner.core import Optimizer, Problem
from mobo_tuner.core.pareto import FloatArray

N_VARIABLES = 6


def awa_archive(benchmark: Benchmark, evaluations: int, preset: str, seed: int) -> dict[str, Any]:
    """State of a run of so many evaluations and its times, made where there is none yet."""
    path = cached(f"archive-{surrogate_digest()}-{preset}-{evaluations}-{seed}.json")
    if not path.exists():
        made = run(benchmark, evaluations, seed, preset=preset)
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


def sphere(n_objectives: int, points: int) -> tuple[Benchmark, FloatArray]:
    """A machine whose every answer lies on a concave sphere, none dominated, and set-points `(n, d)`."""
    rng = np.random.default_rng(0)
    x = rng.uniform(-1.0, 1.0, (points, N_VARIABLES))
    mixing = rng.standard_normal((N_VARIABLES, n_objectives))

    def objectives(inputs: FloatArray) -> FloatArray:
        share = np.exp(inputs @ mixing)
        return 2.0 * share / np.linalg.norm(share, axis=1, keepdims=True) - 1.0

    problem = Problem.from_dict(
        {
            "variables": {f"x{i}": {"min": -1.0, "max": 1.0} for i in range(N_VARIABLES)},
            "objectives": {f"f{i}": {"reference": 1.0} for i in range(n_objectives)},
        }
    )
    return Benchmark(problem, objectives), x


def report(name: str, timed: Run) -> None:
    """Print a row."""
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
    parser.add_argument("--archive", choices=["awa", "sphere"], default="awa")
    parser.add_argument("--acquisitions", nargs="+", default=["ucb_hvi", "ehvi"])
    parser.add_argument("--evaluations", type=int, default=500, help="told before the first ask")
    parser.add_argument("--asks", type=int, default=25, help="timed suggestions in a row")
    parser.add_argument("--preset", default="default", help="of the run that makes the archive")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()

    if options.archive == "awa":
        benchmark = awa()
        archive = awa_archive(benchmark, options.evaluations, options.preset, options.seed)
        asks, cpu = np.array(archive["asks"]), np.array(archive["cpu"])
        print(
            f"whole loop of {options.evaluations} evaluations: {archive['seconds']:.0f} s, CPU {cpu.sum():.0f} s; "
            f"an ask: median {np.median(asks):.3f} s, longest {asks.max():.2f} s; "
            f"hypervolume {archive['hypervolumes'][-1]:.2f}"
        )
        told = archive["state"]["evaluations"]
    else:
        benchmark, x = sphere(7, options.evaluations)
        names = benchmark.problem.objective_names
        told = [
            {
                "setpoint": benchmark.problem.denormalize(row),
                "outputs": {n: (v, np.nan) for n, v in zip(names, point, strict=True)},
            }
            for row, point in zip(x, benchmark.objectives(x), strict=True)
        ]

    print("wall and CPU time of one suggestion [s], peak memory of the process so far [MiB]")
    print("acquis.   told  front  median    mean     max     CPU    mean     max   memory")
    for acquisition in options.acquisitions:
        optimizer = Optimizer(benchmark.problem, seed=options.seed, acquisition=acquisition)
        for evaluation in told:
            outputs = {n: (pair[0], pair[1]) for n, pair in evaluation["outputs"].items()}
            optimizer.tell(evaluation["setpoint"], outputs)
        first = resume(benchmark, optimizer, 1)  # the first training and, where needed, compilation
        print(f"the first of {acquisition}, with a training from nothing: {first.asks[0]:.2f} s")
        report(acquisition, resume(benchmark, optimizer, options.asks))


if __name__ == "__main__":
    main()

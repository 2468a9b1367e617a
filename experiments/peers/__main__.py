"""Compare this project's optimiser with Xopt's MOBO, BoTorch's qLogNEHVI, pymoo's NSGA-II and random search.

    python -m experiments.peers                           all problems without noise, 3 seeds, 60 evaluations: a day
    python -m experiments.peers zdt1 --noise 0 0.05       one problem, without and with 5 % noise
    python -m experiments.peers well_3_3 --seeds 10       a problem on which starts get stuck
    python -m experiments.peers --quick                   check within seconds that the installed methods work

Finished runs are kept in experiments/results/peers; the same command continues where it stopped. Tables are written
into docs/peers.md, the picture to docs/images. Methods that are not installed are left out (see
`experiments/requirements.txt`), in a quick check also `paper` and `perfect`, which take seconds.
"""

from __future__ import annotations

import argparse
import re
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg

from experiments.campaign import (
    RESULTS,
    ROOT,
    PlannedRun,
    Results,
    Size,
    compute,
    parse_options,
)
from experiments.paper.experiment import STYLE
from experiments.peers.methods import METHODS, installed
from experiments.peers.problems import EVERY, PROBLEMS
from experiments.peers.race import race
from experiments.peers.report import details, draw, label, starts, summary

DOCUMENT = ROOT / "docs" / "peers.md"
NOISES = (0.0, 0.02, 0.05, 0.1)
OURS = ("default", "paper", "perfect")
_PART = re.compile(r"(<!-- (summary|starts|details) ([\d.]+) -->\n).*?(<!-- end -->)", re.DOTALL)


def plan(
    problem: str,
    methods: Sequence[str],
    noises: Sequence[float],
    size: Size,
    evaluations: int,
    limit: float,
) -> list[PlannedRun]:
    """Return the runs on a problem, seed by seed."""
    first = 2 * len(EVERY[problem]().problem.variables) + 2
    shared = {
        "problem": problem,
        "evaluations": size.number(evaluations, first + 2),
        "limit": size.number(round(limit), 10),
    }
    return [
        PlannedRun(
            label(method, noise),
            seed,
            race,
            shared | {"method": method, "noise": noise},
            uses_core=method in OURS,
        )
        for seed in size.seeds_of(3)
        for noise in noises
        for method in methods
    ]


def read(folder: Path) -> dict[str, Results]:
    """Return the results of all problems that have some, in the order of `EVERY`."""
    everything = {name: Results(folder / f"{name}.json") for name in EVERY}
    return {name: results for name, results in everything.items() if results.runs}


def with_parts(text: str, all_results: Mapping[str, Results]) -> str:
    """Return the document's text with all tables as the results say.

    Args:
        text: Text, in which each table lies between two comments.
        all_results: Results by problem.
    """

    def current(match: re.Match[str]) -> str:
        table = {"summary": summary, "starts": starts, "details": details}[match[2]]
        lines = table(all_results, float(match[3]))
        inside = "\n".join(lines) if len(lines) > 2 else "Not computed yet."
        return f"{match[1]}\n{inside}\n\n{match[4]}"

    return _PART.sub(current, text)


def main(arguments: Sequence[str] | None = None) -> int:
    """Compute what is missing on the chosen problems, and compare."""
    parser = argparse.ArgumentParser(
        prog="python -m experiments.peers",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "--methods", nargs="+", choices=list(METHODS), help="methods; by default those installed"
    )
    parser.add_argument(
        "--noise", nargs="+", type=float, choices=NOISES, default=[0.0], help="shares of the range"
    )
    parser.add_argument("--evaluations", type=int, default=60, help="number of evaluations")
    parser.add_argument(
        "--limit", type=float, default=1200.0, help="CPU time after which a run is stopped [s]"
    )
    options = parse_options(parser, arguments, "problems", EVERY)
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary) if options.quick else RESULTS / "peers"
        size = Size(options.quick, options.seeds)
        quick = [name for name in installed() if name not in ("paper", "perfect")]
        methods = options.methods or (quick if options.quick else installed())
        command = f"python -m experiments.peers --evaluations {options.evaluations}"
        for name in options.problems or list(PROBLEMS):
            runs = plan(name, methods, options.noise, size, options.evaluations, options.limit)
            if not options.draw:
                compute(runs, Results(folder / f"{name}.json"), command, options.workers)
        all_results = read(folder)
        for noise in options.noise:
            print("\n".join([*summary(all_results, noise), *details(all_results, noise)]))
        with rc_context(STYLE):
            figure = draw(all_results, 0.0)
            FigureCanvasAgg(figure)
            pictures = Path(temporary) if options.quick else ROOT / "docs" / "images"
            figure.savefig(pictures / "peers.png", metadata={"Software": None})
    if not options.quick:
        text = with_parts(DOCUMENT.read_text(encoding="utf-8"), all_results)
        DOCUMENT.write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())

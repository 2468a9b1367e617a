"""Repeat the experiments of the paper, draw their figures, and lay the paper's claims beside the results.

    python -m experiments.paper                        all of them, as large as in the paper: hours
    python -m experiments.paper convergence --seeds 2  one of them, with fewer runs
    python -m experiments.paper --quick                check within a minute that all of them work

Finished runs are kept in experiments/results/paper, unfinished ones in experiments/.cache: the same command continues
where it stopped. Pictures are written to docs/images, tables into docs/paper.md.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg

from experiments.campaign import RESULTS, ROOT, Results, Size, compute, parse_options
from experiments.paper import (
    constrain_comparison,
    convergence,
    localized_comparison,
    toy_constrained,
    toy_mobo,
    traj,
)
from experiments.paper.document import DOCUMENT, with_tables
from experiments.paper.experiment import STYLE, Experiment

EXPERIMENTS: dict[str, Experiment] = {
    "toy_mobo": toy_mobo.EXPERIMENT,
    "toy_constrained": toy_constrained.EXPERIMENT,
    "traj": traj.EXPERIMENT,
    "convergence": convergence.EXPERIMENT,
    "constrain_comparison": constrain_comparison.EXPERIMENT,
    "localized_comparison": localized_comparison.EXPERIMENT,
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Compute what is missing of the chosen experiments, and draw and compare them."""
    parser = argparse.ArgumentParser(
        prog="python -m experiments.paper",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--only", nargs="+", metavar="LABEL", help="methods or cases to compute")
    options = parse_options(parser, arguments, "names", EXPERIMENTS)
    names = options.names or list(EXPERIMENTS)
    if options.quick:
        with tempfile.TemporaryDirectory() as folder:
            _repeat(names, options, Path(folder), Path(folder))
    else:
        _repeat(names, options, RESULTS / "paper", ROOT / "docs" / "images")
        text = with_tables(DOCUMENT.read_text(encoding="utf-8"), EXPERIMENTS)
        DOCUMENT.write_text(text, encoding="utf-8")
    return 0


def _repeat(names: Sequence[str], options: Any, results_in: Path, pictures_in: Path) -> None:
    """Compute, draw and compare experiments, with results and pictures in these folders."""
    size = Size(options.quick, options.seeds)
    for name in names:
        experiment = EXPERIMENTS[name]
        results = Results(results_in / f"{name}.json")
        plan = [r for r in experiment.plan(size) if not options.only or r.label in options.only]
        if not options.draw:
            command = f"python -m experiments.paper {name}"
            command += f" --seeds {options.seeds}" if options.seeds else ""
            compute(plan, results, command, options.workers)
        if not results.runs:
            continue
        for row in experiment.compare(results):
            print(f"{name}: {row.quantity}: {row.ours}   (paper: {row.paper})", flush=True)
        with rc_context(STYLE):
            figure = experiment.draw(results)
            FigureCanvasAgg(figure)
            # The file does not contain the version of matplotlib.
            figure.savefig(pictures_in / f"paper_{name}.png", metadata={"Software": None})


if __name__ == "__main__":
    sys.exit(main())

"""Several runs in one HTML file: ``python -m mobo_tuner.runs.report.comparison RUN_FOLDER ... --output FILE``."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from itertools import combinations
from pathlib import Path

import numpy as np

from mobo_tuner.core.problem import Objective
from mobo_tuner.core.units import product_of_units, spans_decades
from mobo_tuner.files import replace_file
from mobo_tuner.runs.journal import JournalError
from mobo_tuner.runs.recorded_run import RecordedRun
from mobo_tuner.runs.report.page import environment
from mobo_tuner.runs.report.plots import INDEX, LARGE, MIDDLE, SMALL, label
from mobo_tuner.runs.report.summary import summarize
from mobo_tuner.runs.report.svg import Axis, Plot, render_legend

_LINES = (
    "k-a",
    "k-b dashed",
    "k-c dotted",
    "k-d dashdot",
    "k-e",
    "k-f dashed",
    "k-g dotted",
    "k-h",
)
_MARKS = ("dot", "cross", "triangle", "square", "diamond", "plus")
_COLOURS = tuple(line.split()[0] for line in _LINES)


def render_comparison(runs: Sequence[RecordedRun]) -> str:
    """Return a page that compares runs, the first one being the one that others are measured by."""
    names = _names(runs)
    return (
        environment()
        .get_template("comparison.html")
        .render(
            names=names,
            rows=[(name, run, summarize(run)) for name, run in zip(names, runs, strict=True)],
            objectives=_shared(runs),
            differences=_differences(runs),
            convergence=_convergence(runs, names),
            fronts=_fronts(runs, names),
            best=[_best(run, _shared(runs)) for run in runs],
            legend=render_legend,
        )
    )


def _convergence(runs: Sequence[RecordedRun], names: Sequence[str]) -> Plot:
    top = max(float(np.nanmax([0.0, *run.hypervolumes])) for run in runs)
    longest = max(len(run.indices) for run in runs)
    unit = product_of_units([objective.unit for objective in runs[0].problem.objectives])
    plot = Plot(
        Axis(-0.5, max(longest - 0.5, 1.0), INDEX, integer=True),
        Axis(0.0, 1.08 * top or 1.0),
        f"hypervolume [{unit}]" if unit else "hypervolume",
        size=MIDDLE,
        left=64,
    )
    for number, (run, name) in enumerate(zip(runs, names, strict=True)):
        style = _LINES[number % len(_LINES)]
        plot.line(run.indices, run.hypervolumes, style, name, step=True)
    return plot


def _fronts(runs: Sequence[RecordedRun], names: Sequence[str]) -> list[Plot]:
    """Return the fronts in the plane of each pair of the objectives that all runs have."""
    objectives = _shared(runs)
    pairs = list(combinations(objectives, 2))
    values = [_columns(run, objectives) for run in runs]
    everything = np.vstack(values)
    plots = []
    for pair in pairs:
        columns = [objectives.index(objective) for objective in pair]
        x, y = (
            Axis.around(
                everything[:, column],
                label(objective),
                log=spans_decades(everything[:, column]),
            )
            for column, objective in zip(columns, pair, strict=True)
        )
        plot = Plot(x, y, size=LARGE if len(pairs) == 1 else SMALL)
        for number, (front, name) in enumerate(zip(values, names, strict=True)):
            plot.marks(
                front[:, columns[0]],
                front[:, columns[1]],
                _COLOURS[number % len(_COLOURS)],
                name,
                shape=_MARKS[number % len(_MARKS)],
            )
        plots.append(plot)
    return plots


def _columns(run: RecordedRun, objectives: Sequence[Objective]) -> np.ndarray:
    """Return some objectives of a run's front ``(k, number of objectives)``."""
    names = run.problem.objective_names
    return run.front_objectives[:, [names.index(o.name) for o in objectives]]


def _shared(runs: Sequence[RecordedRun]) -> list[Objective]:
    """Return the objectives that all runs have, in the same unit and sense, as in the first run."""
    first, *others = ({o.name: o for o in run.problem.objectives} for run in runs)

    def alike(one: Objective, other: Objective | None) -> bool:
        return other is not None and (one.unit, one.sign) == (other.unit, other.sign)

    return [o for n, o in first.items() if all(alike(o, each.get(n)) for each in others)]


def _best(run: RecordedRun, objectives: Sequence[Objective]) -> list[float | None]:
    """Return the best value of each objective on a run's front; None without a front."""
    front = _columns(run, objectives)
    if not len(front):
        return [None] * len(objectives)
    signs = np.array([o.sign for o in objectives])
    best: list[float | None] = [*(signs * (signs * front).min(axis=0)).tolist()]
    return best


def _differences(runs: Sequence[RecordedRun]) -> list[str]:
    """Return why the hypervolumes of some runs cannot be compared with that of the first."""
    first = runs[0].problem
    told = []
    for run in runs[1:]:
        problem = run.problem
        if problem.objective_names != first.objective_names:
            told.append(f"{run.run_id} has other objectives than {runs[0].run_id}")
        elif problem.reference_point.tolist() != first.reference_point.tolist():
            told.append(f"{run.run_id} has another reference point than {runs[0].run_id}")
    return told


def _names(runs: Sequence[RecordedRun]) -> list[str]:
    """Return the ids of runs, numbered where several are the same."""
    ids = [run.run_id for run in runs]
    return [
        f"{name} ({ids[:number].count(name) + 1})" if ids.count(name) > 1 else name
        for number, name in enumerate(ids)
    ]


def main(arguments: Sequence[str] | None = None) -> int:
    """Compare runs; return the exit status."""
    parser = argparse.ArgumentParser(prog="mobo_tuner.runs.report.comparison")
    parser.add_argument("run_folders", type=Path, nargs="+", metavar="RUN_FOLDER")
    parser.add_argument("--output", type=Path, required=True, metavar="FILE")
    options = parser.parse_args(arguments)
    try:
        runs = [RecordedRun.load(folder) for folder in options.run_folders]
        replace_file(options.output, render_comparison(runs).encode())
    except JournalError as error:
        print(error, file=sys.stderr)
        return 1
    except OSError as error:
        print(f"'{options.output}' cannot be written: {error.strerror}", file=sys.stderr)
        return 1
    print(options.output)
    return 0


if __name__ == "__main__":
    sys.exit(main())

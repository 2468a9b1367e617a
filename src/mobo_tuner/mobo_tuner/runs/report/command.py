"""The report of a run, made from its journal alone: ``python -m mobo_tuner.runs.report RUN_FOLDER``.

It writes `summary.json`, `report.html`, `hypervolume.png` and `front.png` into the run's folder and
prints the Pareto front.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from mobo_tuner.core.problem import Array
from mobo_tuner.files import replace_file
from mobo_tuner.runs.journal import JournalError
from mobo_tuner.runs.recorded_run import RecordedRun
from mobo_tuner.runs.report.figures import front_figure, hypervolume_figure, write_figure
from mobo_tuner.runs.report.page import render_page
from mobo_tuner.runs.report.summary import choose_points, summarize
from mobo_tuner.wording import counted

SHOWN_POINTS = 12  # of a larger front


def write_report(run_dir: str | Path) -> RecordedRun:
    """Write summary and pictures of a run into its folder.

    Raises:
        JournalError: If its journal cannot be read.
        OSError: If the folder cannot be written.
    """
    folder = Path(run_dir)
    run = RecordedRun.load(folder)
    text = json.dumps(summarize(run), indent=2, ensure_ascii=False, allow_nan=False)
    replace_file(folder / "summary.json", (text + "\n").encode())
    replace_file(folder / "report.html", render_page(run, folder).encode())
    write_figure(hypervolume_figure(run), folder / "hypervolume.png")
    write_figure(front_figure(run), folder / "front.png")
    return run


def print_report(run: RecordedRun, console: Console) -> None:
    """Print what the run reached and its front, or the telling part of a large one."""
    console.print(_headline(run))
    front = run.front
    if not len(front):
        complete = np.isfinite(run.objectives).all(axis=1) & run.valid
        why = "nothing feasible is better than the reference"
        if not complete.any():
            why = f"no evaluation {'measured all objectives' if len(complete) else 'was made'}"
        console.print(f"The Pareto front is empty: {why}.")
        return
    balanced, extremes = choose_points(run, SHOWN_POINTS)
    console.print(_front_table(run, balanced, extremes))
    order = "The most balanced points come first" + (
        ", then those that are best (*) in one objective." if len(extremes) else "; * is the best."
    )
    hidden = len(front) - len(balanced) - len(extremes)
    more = f"{hidden} more points and all" if hidden else "All"
    console.print(f"{order} {more} set-points are in summary.json.", style="dim")


def _front_table(run: RecordedRun, *groups: NDArray[np.int64]) -> Table:
    values = dict(zip(run.front.tolist(), run.front_objectives, strict=True))
    best = (run.front_objectives * run.signs).min(axis=0) * run.signs
    table = Table(box=box.SIMPLE, padding=(0, 1, 0, 0), show_footer=True, footer_style="dim")
    table.add_column("index", footer="reference", justify="right", style="dim", no_wrap=True)
    for objective in run.problem.objectives:
        table.add_column(
            f"{objective.name}\n[dim]{objective.unit}[/dim]",
            footer=f"{objective.reference:.4g} ",
            justify="right",
            no_wrap=True,
        )
    for rows in groups:
        for row in rows:
            table.add_row(str(row), *_cells(values[row], best))
        table.add_section()
    return table


def _cells(values: Array, best: Array) -> list[Text]:
    return [
        Text(f"{value:.4g}*", "bold green") if value == top else Text(f"{value:.4g} ")
        for value, top in zip(values, best, strict=True)
    ]


def _headline(run: RecordedRun) -> Text:
    cost = math.fsum(spent.cost for spent in run.spent)
    spent = f" for the cost of {cost:.3g} at the highest fidelity" if run.spent else ""
    text = Text.assemble(
        ("run ", "dim"),
        (run.run_id, "bold"),
        f"   {counted(len(run.indices), 'evaluation')}{spent}, {np.count_nonzero(run.feasible)} feasible, "
        f"{np.count_nonzero(run.failed)} failed   ({run.stop_reason})\n",
        "hypervolume ",
        (f"{run.hypervolume:.6g}", "bold green"),
        f"   {counted(len(run.front), 'point')} on the Pareto front",
    )
    if run.error_msg:
        text.append(f"\n{run.error_msg}", "red")
    if not run.settings:
        text.append("\nThe settings of the tuner are unknown.", "dim")
    return text


def main(arguments: Sequence[str] | None = None) -> int:
    """Make the report of one run; return the exit status."""
    parser = argparse.ArgumentParser(prog="mobo_tuner.runs.report", description="Report of a run.")
    parser.add_argument("run_folder", type=Path, help="the run's folder, which holds its journal")
    folder = parser.parse_args(arguments).run_folder
    try:
        run = write_report(folder)
    except JournalError as error:
        print(error, file=sys.stderr)
        return 1
    except OSError as error:
        print(f"the report cannot be written to '{folder}': {error.strerror}", file=sys.stderr)
        return 1
    print_report(run, Console())
    return 0

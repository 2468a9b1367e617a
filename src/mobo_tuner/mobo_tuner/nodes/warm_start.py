"""Collect the evaluations of other runs for the run of a parameter file.

`python -m mobo_tuner.nodes.warm_start CONFIG FOLDER SOURCE ...` writes a journal into the folder, which the run
resumes, and prints what was taken, what was left and why. An error of one sentence is on standard error, with exit
status 2.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from mobo_tuner.core.problem import Problem
from mobo_tuner.errors import UserError
from mobo_tuner.files import load_yaml
from mobo_tuner.parameter_file import node_sections
from mobo_tuner.runs.journal import Journal
from mobo_tuner.runs.old_data import read_old_data
from mobo_tuner.runs.records import to_json
from mobo_tuner.runs.warm_start import WarmStart, table
from mobo_tuner.tuner.parameters import check_tuner


def collect(options: argparse.Namespace) -> WarmStart:
    """Collect what the command line names, and write it.

    Raises:
        UserError: If a file cannot be read, or nothing of it fits.
        OSError: If the journal cannot be written.
    """
    content = load_yaml(options.config)
    settings = check_tuner(node_sections(content).get("tuner", {}))
    if options.seed is not None:
        settings["seed"] = options.seed
    made = WarmStart(Problem.from_dict(content), settings)
    for source in options.sources:
        made.add(read_old_data(source))
    if not made.count:
        raise UserError(f"nothing of the old data fits the problem: {'; '.join(table(made.taken))}")
    further = options.evaluations or int(settings["evaluations"])
    records = made.records(options.folder.name, time.time(), further)
    Journal.create(options.folder, [to_json(record) for record in records]).close()
    return made


def main(arguments: Sequence[str] | None = None) -> int:
    """Collect what the command line names; return the exit status."""
    parser = argparse.ArgumentParser(prog="mobo_tuner.nodes.warm_start")
    parser.add_argument("config", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("sources", nargs="+", type=Path)
    parser.add_argument("--evaluations", type=int)
    parser.add_argument("--seed", type=int)
    options = parser.parse_args(arguments)
    try:
        made = collect(options)
    except UserError as error:
        print(error, file=sys.stderr)
        return 2
    except OSError as error:
        print(f"the old data cannot be kept in '{options.folder}': {error}", file=sys.stderr)
        return 2
    print("\n".join(table(made.taken)))
    return 0


if __name__ == "__main__":
    sys.exit(main())

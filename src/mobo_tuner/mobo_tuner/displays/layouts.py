"""Layouts of a parameter file for viewers: ``python -m mobo_tuner.displays.layouts FILE --output FOLDER``."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from mobo_tuner.core.problem import Problem
from mobo_tuner.displays.lichtblick import lichtblick_layout
from mobo_tuner.displays.plotjuggler import plotjuggler_layout
from mobo_tuner.errors import UserError
from mobo_tuner.files import replace_file


def layouts(problem: Problem) -> Mapping[str, str]:
    """Return the layouts for a problem, by the end of the file's name."""
    return {
        "lichtblick_live.json": lichtblick_layout(problem, live=True),
        "lichtblick_bag.json": lichtblick_layout(problem, live=False),
        "plotjuggler.xml": plotjuggler_layout(problem),
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the layouts of one file; return the exit status."""
    parser = argparse.ArgumentParser(prog="mobo_tuner.displays.layouts", description=__doc__)
    parser.add_argument("file", type=Path, help="parameter file")
    parser.add_argument("--output", type=Path, default=Path(), help="folder for the layouts")
    options = parser.parse_args(arguments)
    try:
        problem = Problem.from_yaml(options.file)
        for name, text in layouts(problem).items():
            path = options.output / f"{options.file.stem}_{name}"
            replace_file(path, text.encode())
            print(path)
    except UserError as error:
        print(error, file=sys.stderr)
        return 2
    except OSError as error:
        print(f"the layouts cannot be written to '{options.output}': {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""The evaluations of a run as a table: ``python -m mobo_tuner.runs.export RUN_FOLDER [--format csv|parquet]``.

One row per evaluation, columns by name; moves that are not part of an evaluation are in a second table, `moves`,
if there were any. A readback is `NAME.readback`, a standard deviation
`NAME.stddev`, with which no name of the problem ends. The units are in the CSV's first line, a comment, and in
the metadata of a Parquet file, whole and column by column.
"""

from __future__ import annotations

import argparse
import csv
import io
import json
import math
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from mobo_tuner.core.problem import Variable
from mobo_tuner.errors import UserError
from mobo_tuner.files import replace_file
from mobo_tuner.runs.recorded_run import RecordedRun

FORMATS = ("csv", "parquet")

Column = Sequence[float | int | str | bool]

_SECONDS = ("suggest_seconds", "machine_seconds", "total_seconds")


def columns_of(run: RecordedRun) -> tuple[dict[str, Column], dict[str, str]]:
    """Return the columns of a run's table by their names, and the units of those that have one."""
    records, problem = run.evaluations, run.problem
    on_front = {*run.front.tolist()}
    columns: dict[str, Column] = {
        "index": [r.index for r in records],
        "source": [r.source for r in records],
        "attempts": [r.attempts for r in records],
        "stamp": [r.stamp for r in records],
        "valid": run.valid.tolist(),
        "feasible": run.feasible.tolist(),
        "withdrawn": run.withdrawn.tolist(),
        "on_front": [r.index in on_front for r in records],
        "hypervolume": [r.hypervolume for r in records],
        "hypervolume_measured": [r.hypervolume_measured for r in records],
        "error_code": [r.error_code for r in records],
        "error_msg": [r.error_msg for r in records],
        **{name: [getattr(r, name) for r in records] for name in _SECONDS},
    }
    units = {"stamp": "s", **dict.fromkeys(_SECONDS, "s")}

    def add(name: str, suffix: str, values: Column) -> None:
        column = f"{name}{suffix}"
        if column in columns:  # a diagnostic that is called as one of the columns above
            column = f"{name}.value"
        columns[column] = values
        if problem.units.get(name):
            units[column] = problem.units[name]

    fidelities = problem.fidelity.variables if problem.fidelity else ()
    for variable in (*problem.variables, *fidelities):
        values = [r.setpoint.get(variable.name, math.nan) for r in records]
        add(variable.name, "", _named(variable, values))
    diagnostics = dict.fromkeys(
        [
            *problem.required_diagnostics,
            *(context.name for context in problem.context),
            *(name for r in records for name in r.diagnostics),
        ]
    )
    unknown = (math.nan, math.nan)
    for name in diagnostics:
        add(name, "", [r.diagnostics.get(name, unknown)[0] for r in records])
    for name in diagnostics:
        add(name, ".stddev", [r.diagnostics.get(name, unknown)[1] for r in records])
    for name in problem.variable_names:
        add(name, ".readback", [r.readbacks.get(name, math.nan) for r in records])
    return columns, units


def moves_of(run: RecordedRun) -> tuple[dict[str, Column], dict[str, str]]:
    """Return the columns of the table of moves: what was asked, by whom, which way, and where it ended."""
    moves, problem = run.history.moves, run.problem
    asked, ended = [move.asked for move in moves], [move.ended for move in moves]
    columns: dict[str, Column] = {
        "stamp": [a.stamp for a in asked],
        "evaluations": [a.index for a in asked],
        "purpose": [a.purpose for a in asked],
        "by": [a.by for a in asked],
        "evaluation": [math.nan if a.evaluation is None else float(a.evaluation) for a in asked],
        "anyway": [a.anyway for a in asked],
        "ended": [math.nan if e is None else e.stamp for e in ended],
        "error_msg": ["its end is unknown" if e is None else e.error_msg for e in ended],
    }
    names = problem.variable_names
    columns |= {
        v.name: _named(v, [a.setpoint.get(v.name, math.nan) for a in asked])
        for v in problem.variables
    }
    columns |= {
        f"{name}.via": [(a.via or {}).get(name, math.nan) for a in asked]
        for name in names
        if any(a.via for a in asked)
    }
    columns |= {
        f"{name}.readback": [
            math.nan if e is None else e.readbacks.get(name, math.nan) for e in ended
        ]
        for name in names
    }
    units = {
        name: problem.units[name.removesuffix(".readback").removesuffix(".via")]
        for name in columns
        if problem.units.get(name.removesuffix(".readback").removesuffix(".via"))
    }
    return columns, {"stamp": "s", "ended": "s", **units}


def _named(variable: Variable, values: Sequence[float]) -> Column:
    """Return values of a variable, or the names of its choices if they have names."""
    if not variable.choice_names:
        return values
    return [variable.shown(value) if math.isfinite(value) else "" for value in values]


def as_csv(run_id: str, columns: Mapping[str, Column], units: Mapping[str, str]) -> bytes:
    """Return a table as CSV; its first line is a comment that holds run and units as JSON."""
    text = io.StringIO()
    facts = json.dumps({"run_id": run_id, "units": units}, ensure_ascii=False)
    text.write(f"# {facts}\n")
    # Every text is quoted, so that a reader takes no part of it for a comment.
    table = csv.writer(text, quoting=csv.QUOTE_NONNUMERIC, lineterminator="\n")
    table.writerow(columns)
    table.writerows(map(_row, zip(*columns.values(), strict=True)))
    return text.getvalue().encode()


def as_parquet(run_id: str, columns: Mapping[str, Column], units: Mapping[str, str]) -> bytes:
    """Return a table as Parquet; NaN stands for what is not known.

    Raises:
        UserError: If pyarrow is not installed.
    """
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise UserError(
            "the format is parquet, which needs pyarrow: pip install 'mobo_tuner[export]', or choose csv"
        ) from None
    arrays = {
        name: pyarrow.array(column, _type_of(column, pyarrow)) for name, column in columns.items()
    }
    schema = pyarrow.schema(
        [
            pyarrow.field(
                name, array.type, metadata={"unit": units[name]} if name in units else None
            )
            for name, array in arrays.items()
        ],
        metadata={"run_id": run_id, "units": json.dumps(units, ensure_ascii=False)},
    )
    buffer = io.BytesIO()
    pyarrow.parquet.write_table(pyarrow.table(arrays, schema=schema), buffer)
    return buffer.getvalue()


def _row(values: Sequence[Any]) -> Iterator[Any]:
    """Yield the cells of a row: nothing for what is not known, and words for what is true."""
    for value in values:
        if isinstance(value, float) and not math.isfinite(value):
            yield None
        elif isinstance(value, bool):
            yield str(value)
        else:
            yield value


def _type_of(column: Column, pyarrow: Any) -> Any:
    """Return the type of a column; that of an empty one is that of a number."""
    kinds: Mapping[type, Any] = {
        bool: pyarrow.bool_(),
        int: pyarrow.int64(),
        str: pyarrow.string(),
    }
    return kinds.get(type(column[0]), pyarrow.float64()) if column else pyarrow.float64()


def write_export(run_dir: Path, chosen: str) -> Path:
    """Write `evaluations.csv` or `evaluations.parquet` into a run's folder, and `moves` beside it if there were any.

    Returns:
        The path of the evaluations.

    Raises:
        JournalError: If the journal cannot be read.
        UserError: If the format needs what is not installed.
        OSError: If the file cannot be written.
    """
    run = RecordedRun.load(run_dir)
    write = as_csv if chosen == "csv" else as_parquet
    path = run_dir / f"evaluations.{chosen}"
    replace_file(path, write(run.run_id, *columns_of(run)))
    if run.history.moves:
        replace_file(run_dir / f"moves.{chosen}", write(run.run_id, *moves_of(run)))
    return path


def main(arguments: Sequence[str] | None = None) -> int:
    """Export one run; return the exit status."""
    parser = argparse.ArgumentParser(prog="mobo_tuner.runs.export", description="Table of a run.")
    parser.add_argument("run_folder", type=Path, help="the run's folder, which holds its journal")
    parser.add_argument("--format", choices=FORMATS, default="csv", help="default: csv")
    options = parser.parse_args(arguments)
    try:
        print(write_export(options.run_folder, options.format))
    except UserError as error:
        print(error, file=sys.stderr)
        return 1
    except OSError as error:
        folder = options.run_folder
        print(f"the table cannot be written to '{folder}': {error.strerror}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())

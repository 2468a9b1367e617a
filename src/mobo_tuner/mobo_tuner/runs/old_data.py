"""Evaluations from elsewhere: runs, bags, tables in CSV, and archives of Badger or Xopt in YAML.

Nothing in a file is trusted: what cannot be read is reported in one sentence.
"""

from __future__ import annotations

import csv
import io
import json
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from mobo_tuner.errors import FileError
from mobo_tuner.files import load_yaml
from mobo_tuner.runs.history import History
from mobo_tuner.runs.replay import records_of

LARGEST_FILE = 1 << 28  # [byte]
_UNIT = re.compile(r"(.*\S)\s*[\[(]([^\[\]()]*)[\])]\s*")  # NAME [UNIT] or NAME (UNIT)
_TIMES = ("stamp", "timestamp")  # [s since the epoch]
_FAILED = ("xopt_error",)


@dataclass(frozen=True)
class OldEvaluation:
    """One evaluation from elsewhere.

    Attributes:
        values: Means, set-points and readings alike, by name; NaN = unknown.
        stddevs: Standard deviations by name; NaN = unknown.
        readbacks: Readbacks by the names of their variables.
        stamp: When it was made [s since the epoch].
        error_code: Code of `EvaluateSetpoint.Result`; 0 = none.
        withdrawn: Whether an operator withdrew it.
        words: Texts that stand in place of values, such as names of choices, by name.
    """

    values: Mapping[str, float]
    stamp: float
    stddevs: Mapping[str, float] = field(default_factory=dict)
    readbacks: Mapping[str, float] = field(default_factory=dict)
    error_code: int = 0
    withdrawn: bool = False
    words: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class OldData:
    """Evaluations of one source.

    Attributes:
        source: Name of the source.
        evaluations: The evaluations.
        units: Units of its quantities, as far as it names them.
        gap: Which evaluations a bag lacks, in one sentence; empty if none.
    """

    source: str
    evaluations: Sequence[OldEvaluation]
    units: Mapping[str, str] = field(default_factory=dict)
    gap: str = ""


def read_old_data(path: Path) -> OldData:
    """Read a run's folder, a bag, a table or an archive.

    Args:
        path: Folder or file; the kind of a file is that of its suffix: .csv, .yaml, .yml, or of a bag.

    Raises:
        UserError: If it cannot be read.
    """
    suffix = path.suffix.lower()
    if suffix in (".csv", ".tsv", ".txt"):
        return _table(path)
    if suffix in (".yaml", ".yml") and path.name != "metadata.yaml":
        return _archive(path)
    return _run(path)


def _run(path: Path) -> OldData:
    records, gap = records_of(path)
    history = History.from_records(records)
    withdrawn: dict[int, set[str]] = {}
    for change in history.withdrawals:
        names = withdrawn.setdefault(change.evaluation, set())
        if change.withdrawn:
            names.add(change.diagnostic)
        elif change.diagnostic:
            names.discard(change.diagnostic)
        else:
            names.clear()
    evaluations = []
    for record in history.evaluations:
        lost = withdrawn.get(record.index, set())
        known = {n: pair for n, pair in record.diagnostics.items() if n not in lost}
        evaluations.append(
            OldEvaluation(
                values={**{n: mean for n, (mean, _) in known.items()}, **record.setpoint},
                stamp=record.stamp,
                stddevs={n: stddev for n, (_, stddev) in known.items()},
                readbacks=record.readbacks,
                error_code=record.error_code,
                withdrawn="" in lost,
            )
        )
    return OldData(path.name, evaluations, history.last_problem.units, gap)


def _table(path: Path) -> OldData:
    """Read a table: one row per evaluation, the columns named in the first line that is no comment."""
    text = _text(path)
    units: dict[str, str] = {}
    first, _, rest = text.partition("\n")
    if first.startswith("#"):  # of `export`
        try:
            given = json.loads(first.lstrip("# "))["units"]
            units = {str(name): str(unit) for name, unit in given.items()}
        except (AttributeError, KeyError, TypeError, ValueError):
            units = {}
        text = rest
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    if len(lines) < 2:
        raise FileError(f"the table '{path}' has no line of names with rows below it")
    separator = max(",;\t", key=lines[0].count)
    try:
        header, *rows = csv.reader(io.StringIO("\n".join(lines)), delimiter=separator)
    except csv.Error as error:
        raise FileError(f"the table '{path}' cannot be read: {error}") from None
    names = []
    for column in header:
        found = _UNIT.fullmatch(column.strip())
        name = found[1] if found else column.strip()
        if found:
            units[name] = found[2].strip()
        names.append(name)
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise FileError(f"the table '{path}' has two columns '{twice[0]:.60}'; one is allowed")
    columns = [dict(zip(names, row, strict=False)) for row in rows]
    return OldData(path.name, _evaluations(columns, path), units)


def _archive(path: Path) -> OldData:
    """Read the data of an archive: columns by name, each a list or a mapping of row to value."""
    content = load_yaml(path)
    data = content.get("data")
    try:
        if isinstance(data, str):
            data = json.loads(data)
        if isinstance(data, Mapping):
            columns = {
                str(name): list(column.values() if isinstance(column, Mapping) else column)
                for name, column in data.items()
            }
            rows = [
                dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)
            ]
        elif isinstance(data, list):
            rows = [dict(row) for row in data]
        else:
            rows = []
    except (TypeError, ValueError):
        rows = []
    if not rows:
        raise FileError(
            f"the archive '{path}' has no 'data' with columns of one length, as Badger and Xopt write it"
        )
    return OldData(path.name, _evaluations(rows, path), {})


def _evaluations(rows: Iterable[Mapping[str, object]], path: Path) -> list[OldEvaluation]:
    """Return rows as evaluations; one without a time was made when the file was written."""
    written = path.stat().st_mtime
    found = []
    for row in rows:
        numbers = {name: _number(value) for name, value in row.items()}
        times = [numbers[name] for name in _TIMES if math.isfinite(numbers.get(name, math.nan))]
        failed = any(_is_true(row.get(name)) for name in _FAILED)
        found.append(
            OldEvaluation(
                values={
                    n: v for n, v in numbers.items() if not n.endswith((".stddev", ".readback"))
                },
                stamp=times[0] if times else written,
                stddevs=_with_suffix(numbers, ".stddev"),
                readbacks=_with_suffix(numbers, ".readback"),
                error_code=255 if failed else _code(numbers.get("error_code", 0.0)),
                withdrawn=_is_true(row.get("withdrawn")),
                words={
                    n: v for n, v in row.items() if isinstance(v, str) and math.isnan(numbers[n])
                },
            )
        )
    return found


def _with_suffix(numbers: Mapping[str, float], suffix: str) -> dict[str, float]:
    return {n.removesuffix(suffix): v for n, v in numbers.items() if n.endswith(suffix)}


def _code(value: float) -> int:
    return int(value) if 0.0 <= value < 2**16 else 0


def _is_true(value: object) -> bool:
    return value is True or str(value).strip().lower() in ("true", "1")


def _number(value: object) -> float:
    """Return a cell as a number; NaN if it is none."""
    if isinstance(value, bool) or value is None:
        return math.nan
    try:
        return float(value)  # type: ignore[arg-type]
    except (OverflowError, TypeError, ValueError):
        return math.nan


def _text(path: Path) -> str:
    try:
        if path.stat().st_size > LARGEST_FILE:
            raise FileError(f"the file '{path}' is larger than {LARGEST_FILE} bytes")
        return path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise FileError(f"the file '{path}' cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise FileError(f"the file '{path}' cannot be read: it is not UTF-8") from None

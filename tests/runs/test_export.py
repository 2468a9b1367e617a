"""The table of a run, as pandas and pyarrow read it."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas
import pyarrow.parquet
import pytest

from mobo_tuner.runs.export import main
from tests.support.run_folders import evaluation, write_run

Read = Callable[[Path], pandas.DataFrame]

ODD = '# not a "comment", 1\nbut text'


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A run with a failure, a diagnostic that not every evaluation has, and one with the name of a column."""
    records = [
        evaluation(0, {"f1": 5.0, "f2": 5.0}, diagnostics={"f1": [5.0, 0.25], "f2": [5.0, None]}),
        evaluation(1, {}, valid=False, feasible=False, error_code=3, error_msg=ODD),
        evaluation(2, {"f1": 2.0, "f2": 8.0, "charge": 40.0, "index": 7.0}),
    ]
    return write_run(tmp_path, records)


def read_csv(folder: Path) -> pandas.DataFrame:
    """The table as CSV."""
    assert main([str(folder)]) == 0
    return pandas.read_csv(folder / "evaluations.csv", comment="#")


def read_parquet(folder: Path) -> pandas.DataFrame:
    """The table as Parquet."""
    assert main([str(folder), "--format", "parquet"]) == 0
    return pandas.read_parquet(folder / "evaluations.parquet")


@pytest.mark.parametrize("read", [read_csv, read_parquet])
def test_the_table_has_a_row_per_evaluation_and_columns_by_name(folder: Path, read: Read) -> None:
    table = read(folder)
    assert table["index"].tolist() == [0, 1, 2]
    assert table["x1"].tolist() == [0.0, 0.5, 1.0]
    np.testing.assert_equal(table["f1"].to_numpy(), [5.0, math.nan, 2.0])
    np.testing.assert_equal(table["f1.stddev"].to_numpy(), [0.25, math.nan, math.nan])
    np.testing.assert_equal(table["charge"].to_numpy(), [math.nan, math.nan, 40.0])
    np.testing.assert_equal(table["index.value"].to_numpy(), [math.nan, math.nan, 7.0])
    assert table["x1.readback"].tolist() == [0.0, 0.5, 1.0]
    assert table["valid"].tolist() == [True, False, True]
    assert table["source"].tolist() == ["initial", "initial", "model"]
    assert table["error_msg"][1] == ODD
    assert table["error_code"].tolist() == [0, 3, 0]
    assert table["hypervolume_measured"].tolist() == [0.0, 9.0, 18.0]
    assert table["on_front"].dtype == bool


@pytest.mark.parametrize("form", ["csv", "parquet"])
def test_moves_have_a_table_of_their_own(tmp_path: Path, form: str) -> None:
    asked = {"stamp": 5.0, "index": 1, "setpoint": {"x1": 2.0}}
    moves = [
        {
            "type": "move",
            **asked,
            "purpose": "go",
            "by": "operator",
            "evaluation": 0,
            "via": {"x1": 3.0},
        },
        {"type": "state", "stamp": 6.0, "index": 1, "readbacks": {"x1": 1.5}, "error_msg": ODD},
        {"type": "move", **asked, "purpose": "restore", "by": "on_abort", "anyway": True},
    ]
    write_run(tmp_path, [evaluation(0, {"f1": 5.0, "f2": 5.0}), *moves])
    assert main([str(tmp_path), "--format", form]) == 0
    path = tmp_path / f"moves.{form}"
    table = pandas.read_csv(path, comment="#") if form == "csv" else pandas.read_parquet(path)
    assert table["purpose"].tolist() == ["go", "restore"]
    assert table["by"].tolist() == ["operator", "on_abort"]
    assert table["anyway"].tolist() == [False, True]
    assert table["x1"].tolist() == [2.0, 2.0]
    np.testing.assert_equal(table["evaluation"].to_numpy(), [0.0, math.nan])
    np.testing.assert_equal(table["x1.readback"].to_numpy(), [1.5, math.nan])
    np.testing.assert_equal(table["x1.via"].to_numpy(), [3.0, math.nan])
    assert table["error_msg"].tolist() == [ODD, "its end is unknown"]


def test_the_units_travel_with_the_table(folder: Path) -> None:
    read_csv(folder)
    first = (folder / "evaluations.csv").read_text().splitlines()[0]
    facts = json.loads(first.removeprefix("# "))
    assert facts["run_id"] == "run1"
    assert facts["units"]["f1"] == facts["units"]["f1.stddev"] == "mm"
    assert facts["units"]["x1"] == facts["units"]["x1.readback"] == "A"
    assert "f2" not in facts["units"]
    read_parquet(folder)
    schema = pyarrow.parquet.read_schema(folder / "evaluations.parquet")
    assert schema.field("f1").metadata[b"unit"] == b"mm"
    assert json.loads(schema.metadata[b"units"]) == facts["units"]


@pytest.mark.parametrize("read", [read_csv, read_parquet])
def test_a_run_without_evaluations_is_an_empty_table(tmp_path: Path, read: Read) -> None:
    table = read(write_run(tmp_path, []))
    assert len(table) == 0
    assert {"index", "x1", "f1"} <= set(table.columns)


def test_a_folder_without_a_journal_is_one_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([str(tmp_path)]) == 1
    assert capsys.readouterr().err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_a_table_that_cannot_be_written_is_one_sentence(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "evaluations.csv").mkdir()
    assert main([str(folder)]) == 1
    assert str(folder) in capsys.readouterr().err


def test_choices_have_their_names_in_the_table(tmp_path: Path) -> None:
    problem = {
        "variables": {"sys/q.1:I": {"choices": ["foil", "mesh", "none"], "values": [3, 1, 2]}},
        "objectives": {"f1": {"reference": 10.0}},
    }
    at = [{"sys/q.1:I": value} for value in (3.0, 2.0)]
    records = [evaluation(i, {"f1": 5.0}, setpoint=where) for i, where in enumerate(at)]
    table = read_csv(write_run(tmp_path, records, problem))
    assert table["sys/q.1:I"].tolist() == ["foil", "none"]

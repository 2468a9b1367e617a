"""Evaluations of other runs as the beginning of a new one: what is taken, and what is left and why."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest

from mobo_tuner.core import Problem, ProblemError
from mobo_tuner.errors import UserError
from mobo_tuner.runs.export import write_export
from mobo_tuner.runs.history import History
from mobo_tuner.runs.journal import Journal, read_journal
from mobo_tuner.runs.old_data import read_old_data
from mobo_tuner.runs.records import ForgetRecord, to_json
from mobo_tuner.runs.replay import compare, restore
from mobo_tuner.runs.warm_start import WarmStart, table
from mobo_tuner.tuner.parameters import check_tuner
from robustness.offline_run import TOY, OfflineRun, toy, toy_optimizer

CONFIG = Path(__file__).parents[2] / "config"
UNITS: dict[str, Any] = {
    "variables": {"x1": {"min": -2.0, "max": 2.0, "unit": "mm"}, "x2": {"min": -2.0, "max": 2.0}},
    "limits": {"sum": {"x1": 1.0, "x2": 1.0, "max": 3.0}},
    "objectives": {"f1": {"reference": 4.3, "unit": "m"}, "f2": {"reference": 4.3}},
}


@pytest.fixture(scope="module")
def old_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a run of 8 evaluations, of which some failed and one is withdrawn."""
    folder = tmp_path_factory.mktemp("runs") / "old"
    run = OfflineRun(folder, toy_optimizer(3), toy, seed=12)
    for _ in range(8):
        run.step()
    run.run.withdraw(ForgetRecord(0.0, 8, 1))
    run.log.close()
    return folder


def started(problem: dict[str, Any], *sources: Path, **settings: Any) -> WarmStart:
    made = WarmStart(
        Problem.from_dict(problem), check_tuner({"initial_evaluations": 4, **settings})
    )
    for source in sources:
        made.add(read_old_data(source))
    return made


def test_a_run_is_taken_as_it_was(old_run: Path, tmp_path: Path) -> None:
    made = started(TOY, old_run)
    [taken] = made.taken
    assert taken.left["withdrawn by an operator"] == 1
    assert taken.count + taken.left.total() == 8
    records = made.records("old-data", 1.0, 5)
    Journal.create(tmp_path / "new", [to_json(record) for record in records]).close()
    history = History.from_records(read_journal(tmp_path / "new"))
    history.require_settings()
    assert history.budget == made.count + 5
    before = {r.stamp: r for r in History.from_records(read_journal(old_run)).evaluations}
    for record in history.evaluations:
        assert record.diagnostics.keys() == before[record.stamp].diagnostics.keys()
        assert record.setpoint == before[record.stamp].setpoint
        assert record.valid == before[record.stamp].valid
    optimizer = restore(history)
    assert optimizer.hypervolume == history.evaluations[-1].hypervolume > 0.0
    optimizer.ask()
    assert optimizer.last_source == "model"  # the old ones are the initial design
    assert not any(c.differs for c in compare(history))


def test_a_table_of_the_same_run_is_taken_once(old_run: Path) -> None:
    table_file = write_export(old_run, "csv")
    alone = started(TOY, table_file)
    assert alone.count == started(TOY, old_run).count
    both = started(TOY, old_run, table_file)
    assert both.count == alone.count
    assert both.taken[1].left["taken before, with the same set-point and time"] == alone.count


def test_the_shipped_table_is_a_beginning() -> None:
    problem = Problem.from_yaml(CONFIG / "toy.yaml")
    made = WarmStart(problem, check_tuner({}))
    made.add(read_old_data(CONFIG / "old_data.csv"))
    assert made.count == 8
    assert made.taken[0].left == {
        "outside the bounds of 'x1'": 1,
        "without a value of 'x2'": 1,
    }
    first, *_ = made.records("data", 0.0, 1)[1:]
    assert first.diagnostics["f2"][1] == 0.001  # type: ignore[union-attr]


def test_units_and_limits_are_checked(tmp_path: Path) -> None:
    path = tmp_path / "lab.csv"
    path.write_text("x1 [mm];x2;f1 [cm];f2 (1)\n0,5;0;1;1\n1;1;1;1.5\n2;2;1;1\n1;0;1;\n")
    made = started(UNITS, path)
    assert made.count == 1
    assert made.taken[0].left == {
        "without a value of 'x1'": 1,  # a decimal comma
        "beyond limits.sum": 1,
        "without any objective or constraint": 1,
    }
    assert "'f1' is left out: unit is 'cm', not 'm'" in "\n".join(table(made.taken))
    path.write_text("x1 [m],x2,f1\n0.5,0,1\n")
    assert started(UNITS, path).taken[0].left == {"the unit is 'm', not 'mm' of 'x1'": 1}


@pytest.mark.parametrize("form", ["mappings", "lists", "rows", "text"])
def test_an_archive_of_badger_or_xopt_is_read(tmp_path: Path, form: str) -> None:
    rows = [
        {
            "x1": 0.5,
            "x2": 0.1 * i,
            "f1": 1.0,
            "f2": math.nan if i == 1 else 2.0,
            "timestamp": 5.0 + i,
        }
        | {"xopt_error": i == 2, "xopt_runtime": 0.1, "live": True}
        for i in range(3)
    ]
    columns: dict[str, Any] = {name: [row[name] for row in rows] for name in rows[0]}
    if form != "lists":
        columns = {n: {str(i): v for i, v in enumerate(c)} for n, c in columns.items()}
    data: Any = rows if form == "rows" else columns
    path = tmp_path / "archive.yaml"
    content = {
        "vocs": {"variables": {"x1": [0, 1]}},
        "data": json.dumps(data) if form == "text" else data,
    }
    path.write_text(
        json.dumps(content).replace("NaN", ".nan") if form != "text" else json.dumps(content)
    )
    made = started({**TOY, "constraints": {}}, path)
    assert made.count == 3
    first, second, third = made.records("data", 0.0, 1)[1:]
    assert first.stamp == 5.0
    assert first.diagnostics.keys() == {"f1", "f2"}  # type: ignore[union-attr]
    assert math.isnan(second.diagnostics["f2"][0])  # type: ignore[union-attr]
    assert not third.valid  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("empty.csv", ""),
        ("head.csv", "x1,x2\n"),
        ("twice.csv", "x1,x1\n1,2\n"),
        ("bytes.csv", "\udcff"),
        ("none.yaml", "data: 3"),
        ("uneven.yaml", "data: {x1: [1, 2], x2: [1]}"),
        ("absent.csv", None),
        ("folder", None),
    ],
)
def test_what_cannot_be_read_is_named_in_one_sentence(
    tmp_path: Path, name: str, text: str | None
) -> None:
    path = tmp_path / name
    if text is not None:
        path.write_bytes(text.encode(errors="surrogateescape"))
    with pytest.raises(UserError) as error:
        read_old_data(path)
    assert name in str(error.value)
    assert "\n" not in str(error.value)


def test_bounds_that_nobody_knows_yet_take_no_old_data() -> None:
    problem = {**TOY, "variables": {**TOY["variables"], "x1": {"around": 1.0}}}
    with pytest.raises(ProblemError, match="the bounds of x1"):
        started(problem)


def test_a_derived_objective_is_computed_of_old_parts() -> None:
    problem = {
        **TOY,
        "derived": {"worst": {"formula": "max(f1, f2)"}},
        "objectives": {"worst": {"reference": 5.0}},
        "constraints": {},
    }
    made = started(problem, CONFIG / "old_data.csv")
    assert made.count == 8
    values = [r.diagnostics for r in made.records("d", 0.0, 1)[1:]]  # type: ignore[union-attr]
    assert values[0]["worst"][0] == max(values[0]["f1"][0], values[0]["f2"][0])
    assert math.isnan(values[4]["worst"][0])  # without f1


def test_choices_without_an_order_are_taken_by_their_names(tmp_path: Path) -> None:
    problem = {
        "variables": {
            "LI20:Q1": {"min": 0.0, "max": 1.0},
            "target": {"choices": ["foil", "mesh", "none"], "values": [3, 1, 2]},
        },
        "objectives": {"beam.size/x": {"reference": 4.0}},
    }
    table = tmp_path / "old.csv"
    rows = ["LI20:Q1,target,beam.size/x", "0.5,mesh,1.0", "0.6,3,2.0", "0.7,wire,3.0", "0.8,2.5,1"]
    table.write_text("\n".join(rows))
    made = started(problem, table)
    taken = made.taken[0]
    assert taken.count == 2
    assert taken.left == {"without a value of 'target'": 1, "at none of the choices of 'target'": 1}
    records = made.records("old", 1.0, 2)[1:]
    assert [record.setpoint["target"] for record in records] == [1.0, 3.0]  # type: ignore[union-attr]

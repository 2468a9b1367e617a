"""Runs of experiments are kept, continued and replaced; the tables of docs/paper.md say what the results say."""

from __future__ import annotations

import json
import time
from pathlib import Path

import numpy as np
import pytest

from experiments import campaign
from experiments.campaign import PlannedRun, Record, Results, Size, compute
from experiments.paper.__main__ import EXPERIMENTS
from experiments.paper.document import DOCUMENT, with_tables
from experiments.paper.experiment import projected_front


def made(seed: int, factor: float) -> Record:
    return {"hypervolumes": [factor * seed, factor * seed + 1.0]}


def plan(factor: float, seeds: int = 3) -> list[PlannedRun]:
    return [PlannedRun("method", seed, made, {"factor": factor}) for seed in range(seeds)]


def test_finished_runs_are_kept_and_not_repeated(tmp_path: Path) -> None:
    path = tmp_path / "toy.json"
    compute(plan(2.0, seeds=2), Results(path), "first")
    results = Results(path)
    assert [run.seed for run in results.missing(plan(2.0))] == [2]
    compute(plan(2.0), results, "second")
    np.testing.assert_array_equal(
        Results(path).curves("method"), [[0.0, 1.0], [2.0, 3.0], [4.0, 5.0]]
    )
    about = json.loads(path.read_text(encoding="utf-8"))["about"]
    assert about["command"] == "second"
    assert {"python", "numpy", "scipy"} <= about["versions"].keys()


def test_runs_with_other_arguments_or_another_core_are_replaced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    results = Results(tmp_path / "toy.json")
    compute(plan(2.0), results, "command")
    assert len(results.missing(plan(3.0))) == 3
    monkeypatch.setattr(campaign, "core_digest", lambda: "another")
    assert len(results.missing(plan(2.0))) == 3
    assert results.missing([PlannedRun("method", 0, made, {"factor": 2.0}, uses_core=False)])


def test_a_run_that_fails_leaves_the_others(tmp_path: Path) -> None:
    path = tmp_path / "toy.json"
    with pytest.raises(TypeError):
        compute([*plan(2.0, 1), PlannedRun("method", 1, made, {})], Results(path), "command")
    assert Results(path).curves("method").shape == (1, 2)


def sleep_or_fail(seed: int) -> Record:
    if seed == 1:
        time.sleep(300.0)
    if seed == 2:
        raise ValueError("seed 2 fails")
    return {"hypervolumes": [1.0]}


def test_a_failure_in_one_process_ends_the_others(tmp_path: Path) -> None:
    path = tmp_path / "toy.json"
    runs = [PlannedRun("method", seed, sleep_or_fail) for seed in range(3)]
    with pytest.raises(ValueError, match="seed 2"):  # long before the second run would be over
        compute(runs, Results(path), "command", workers=2)
    assert list(Results(path).runs["method"]) == [0]


def test_every_experiment_plans_different_runs() -> None:
    for name, experiment in EXPERIMENTS.items():
        for size in (Size(), Size(quick=True), Size(seeds=2)):
            runs = [(run.label, run.seed) for run in experiment.plan(size)]
            assert len(runs) == len(set(runs)) > 1, name
        labels = {run.label for run in experiment.plan(Size())}
        assert labels == {run.label for run in experiment.plan(Size(quick=True))}


def test_projected_front() -> None:
    points = np.array([[1.0, 3.0], [2.0, 2.0], [2.0, 3.0], [3.0, 2.0], [3.0, 1.0], [1.0, 4.0]])
    np.testing.assert_array_equal(projected_front(points), [[1.0, 3.0], [2.0, 2.0], [3.0, 1.0]])


def test_the_tables_of_the_document_are_current() -> None:
    text = DOCUMENT.read_text(encoding="utf-8")
    assert with_tables(text, EXPERIMENTS) == text, "run python -m experiments.paper --draw"
    assert [f"<!-- table {name} -->" in text for name in EXPERIMENTS] == [True] * len(EXPERIMENTS)

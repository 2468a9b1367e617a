"""One run without its node: what it learns, keeps and has found."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from mobo_msgs_py.action import EvaluateSetpoint, Tune
from mobo_tuner.core import Optimizer, Problem
from mobo_tuner.runs.export import columns_of
from mobo_tuner.runs.history import History
from mobo_tuner.runs.journal import read_journal
from mobo_tuner.runs.recorded_run import RecordedRun
from mobo_tuner.runs.replay import restore
from mobo_tuner.tuner.machine_client import Answer
from mobo_tuner.tuner.run.run import Findings, Outcome, Suggestion, checked
from mobo_tuner.tuner.run.steering import Change, Steering
from mobo_tuner.tuner.session import Session
from robustness.offline_run import TOY, OfflineRun, toy, toy_optimizer
from tests.support.processes import NodeProcess
from tests.support.tuner import GoalClient


@pytest.fixture
def offline(tmp_path: Path) -> OfflineRun:
    return OfflineRun(tmp_path / "run", toy_optimizer(1), toy, seed=1, events=False)


def test_what_a_run_has_found_is_what_its_optimiser_has(offline: OfflineRun) -> None:
    run = offline.run
    for _ in range(8):
        offline.step()
        assert run.found == Findings.of(run.optimizer)
    assert run.index == 8 == len(run.records)
    assert run.found.hypervolume == run.optimizer.hypervolume > 0.0
    assert [p["index"] for p in run.found.front] == [
        p["index"] for p in run.optimizer.pareto_front()
    ]


def test_what_a_run_has_found_is_read_while_the_optimiser_works(offline: OfflineRun) -> None:
    """A reader on another thread sees the findings of one moment, never a mixture."""
    run = offline.run
    seen: list[Findings] = []
    done = threading.Event()

    def read() -> None:
        while not done.is_set():
            seen.append(run.found)

    reader = threading.Thread(target=read)
    reader.start()
    try:
        for _ in range(7):
            offline.step()
    finally:
        done.set()
        reader.join(10.0)
    assert not reader.is_alive()
    counts = [found.evaluations for found in seen]
    assert counts == sorted(counts)
    by_count = {found.evaluations: found for found in seen}
    assert all(found == by_count[found.evaluations] for found in seen)


def test_a_change_is_kept_and_holds_from_then_on(offline: OfflineRun, tmp_path: Path) -> None:
    run = offline.run
    for _ in range(5):
        offline.step()
    narrower = Problem.from_dict(
        {**TOY, "variables": {**TOY["variables"], "x1": {"min": -1.0, "max": 1.0}}}
    )
    run.apply(Change(narrower, 9), 12.0)
    assert (run.problem, run.budget, run.found.evaluations) == (narrower, 9, 5)
    offline.step()
    assert -1.0 <= run.records[-1][1].setpoint["x1"] <= 1.0
    run.log.close()
    history = History.from_records(read_journal(tmp_path / "run"))
    assert (history.last_problem, history.budget) == (narrower, 9)
    assert [c.index for c in history.changes] == [5]


def test_a_run_is_finished_by_its_budget_or_its_goal(offline: OfflineRun) -> None:
    run = offline.run
    assert not run.finished
    offline.step()
    run.budget = 1
    assert run.finished
    run.budget = 100
    run.hypervolume_goal = run.found.hypervolume + 1.0
    assert not run.finished
    run.hypervolume_goal = run.found.hypervolume / 2.0
    assert run.finished == (run.found.hypervolume > 0.0)


def test_the_first_reason_to_stop_counts(offline: OfflineRun) -> None:
    offline.run.stop("an operator")
    offline.run.stop("somebody else")
    assert offline.run.interrupted
    assert offline.run.interrupt.result() == "an operator"


def test_pause_step_and_resume() -> None:
    steering = Steering()
    assert not steering.waits
    steering.step("single steps")
    steering.step("single steps")
    assert not steering.waits
    steering.take_step()
    steering.take_step()
    assert steering.waits
    steering.resume()
    assert not steering.waits
    assert steering.reason == ""
    steering.pause("an operator")
    assert steering.waits
    steering.pause("the recorder is lost")
    steering.pause("the recorder is lost")
    assert steering.reason == "an operator; the recorder is lost"
    steering.resume()
    assert steering.reason == ""


def test_a_request_wakes_up_who_waits_for_news() -> None:
    steering = Steering()
    news = steering.news
    assert not news.done()
    steering.notify()
    assert news.done()
    assert not steering.news.done()  # the next request


def test_a_tuner_does_one_thing_at_a_time(offline: OfflineRun) -> None:
    session = Session()
    session.check_free()
    with session.running(offline.run):
        assert session.run is offline.run
        with pytest.raises(ValueError, match="run 'run' is active"):
            session.check_free()
    with session.moving():
        with pytest.raises(ValueError, match="moving to a working point"):
            session.check_free()
        with session.running(offline.run):  # the run that holds the point
            assert "moving" in session.occupied
    with session.reading(), pytest.raises(ValueError, match="being read"):
        session.check_free()
    assert session.occupied == ""
    assert session.latest is None
    session.know(offline.run)
    assert session.latest is offline.run


def test_a_derived_quantity_is_measured_kept_replayed_and_exported(
    start_tuner: Callable[..., NodeProcess],
    start_machine: Callable[..., NodeProcess],
    client: GoalClient,
    tmp_path: Path,
) -> None:
    start_machine(config="derived.yaml")
    start_tuner("initial_evaluations:=2", config="derived.yaml")
    client.send(Tune.Goal(run_id="derived", evaluations=3))
    assert client.wait(60.0).error_code == 0
    history = History.from_records(read_journal(tmp_path / "runs" / "derived"))
    assert len(history.evaluations) == 3
    for record, feedback in zip(history.evaluations, client.feedback[-3:], strict=True):
        values = {name: mean for name, (mean, _) in record.diagnostics.items()}
        eps_4d, stddev = record.diagnostics["eps_4d"]
        assert eps_4d == pytest.approx(math.sqrt(values["eps_x"] * values["eps_y"]))
        assert 0.0 < stddev < 0.1 * eps_4d
        assert values["detuning"] == abs(record.setpoint["phi1"] - record.setpoint["phi2"])
        shown = {item.name: item for item in feedback.evaluation.diagnostics}
        assert (shown["eps_4d"].value, shown["eps_4d"].unit) == (eps_4d, "mm mrad")
    assert restore(history, None).hypervolume == history.evaluations[-1].hypervolume
    columns, units = columns_of(RecordedRun.load(tmp_path / "runs" / "derived"))
    assert columns["eps_4d"] == [r.diagnostics["eps_4d"][0] for r in history.evaluations]
    assert units["eps_4d.stddev"] == "mm mrad"


def test_an_undefined_derived_quantity_is_an_invalid_measurement(tmp_path: Path) -> None:
    derived = {"root": {"formula": "sqrt(f1 - 2)"}, "seen": {"formula": "1 / (f2 - f2)"}}
    problem = {**TOY, "derived": derived, "constraints": {"root": {"max": 1.0}}}
    optimizer = Optimizer(Problem.from_dict(problem), initial_evaluations=4)
    run = OfflineRun(tmp_path / "run", optimizer, toy, seed=1, events=False).run
    answer = Answer(0, "", 0.0, diagnostics={"f1": (3.0, 0.0), "f2": (1.0, 0.0)})
    assert checked(run, {"x1": 0.0, "x2": 0.0}, answer, "machine") is answer
    worse = replace(answer, diagnostics={"f1": (1.0, 0.0), "f2": (1.0, 0.0)})
    judged = checked(run, {"x1": 0.0, "x2": 0.0}, worse, "machine")
    assert judged.error_code == EvaluateSetpoint.Result.INVALID_MEASUREMENT
    assert "sqrt(f1 - 2)" in judged.error_msg
    record = run.learn(Suggestion({"x1": 0.0, "x2": 0.0}, "model", 0.0), Outcome(judged, 1))
    assert (record.valid, record.feasible) == (True, False)  # its objectives are learned
    nothing = replace(answer, diagnostics={"g": (1.0, 0.0)})
    assert checked(run, {"x1": 0.0, "x2": 0.0}, nothing, "client").error_code

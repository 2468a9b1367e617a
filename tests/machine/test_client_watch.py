"""Whose heartbeat is heard, when a client counts as lost, and which evaluations are old."""

from __future__ import annotations

import pytest

from mobo_tuner.machine.client_watch import MAX_RUNS, ClientWatch, FinishedEvaluations


def test_a_client_is_lost_when_its_heartbeat_stops_for_longer_than_its_timeout() -> None:
    watch = ClientWatch()
    assert not watch.lost(1e9)
    watch.begin("a", 2.0, [{"x": 1.0}], now=10.0)
    assert not watch.lost(12.0)
    watch.hear("a", 11.5)
    watch.hear("b", 12.9)
    assert not watch.lost(13.5)
    assert watch.lost(13.6)
    watch.end()
    assert not watch.lost(1e9)


def test_the_last_run_that_evaluates_is_the_one_that_is_watched() -> None:
    watch = ClientWatch()
    watch.begin("a", 2.0, [], now=0.0)
    watch.begin("b", 5.0, [], now=1.0)
    watch.hear("a", 5.9)
    assert watch.run_id == "b"
    assert watch.lost(6.1)
    watch.begin("c", 0.0, [], now=1.0)
    assert not watch.active
    assert not watch.lost(1e9)


@pytest.mark.parametrize(
    ("index", "attempt", "kind"),
    [(3, 1, "a duplicate"), (3, 0, "late"), (2, 9, "late"), (3, 2, ""), (4, 0, "")],
)
def test_an_evaluation_must_be_newer_than_the_last_one_of_its_run(
    index: int, attempt: int, kind: str
) -> None:
    finished = FinishedEvaluations()
    finished.add("a", 3, 1)
    refusal = finished.refusal("a", index, attempt)
    assert kind in refusal
    assert bool(refusal) == bool(kind)
    assert finished.refusal("b", index, attempt) == ""
    finished.forget("a")
    assert finished.refusal("a", index, attempt) == ""


def test_evaluations_by_hand_without_a_run_are_never_duplicates() -> None:
    finished = FinishedEvaluations()
    for _ in range(3):
        assert finished.refusal("", 0, 0) == ""
        finished.add("", 0, 0)


def test_only_so_many_runs_are_remembered() -> None:
    finished = FinishedEvaluations()
    for number in range(MAX_RUNS + 1):
        finished.add(f"run {number}", 0, 0)
    assert finished.refusal("run 0", 0, 0) == ""
    assert finished.refusal("run 1", 0, 0) != ""

"""Batches: several set-points that are worth measuring together, pending until they are told."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pytest

from mobo_tuner.core import Optimizer, Problem, ProblemError, batch
from mobo_tuner.core.batch import Pending
from mobo_tuner.core.resolution import SAME
from tests.core.toy_runs import TOY, toy, with_changes

INITIAL = 6
SERIAL = 14.235  # mean hypervolume after 40 evaluations one by one, seeds 0 to 2


def optimizer(seed: int = 0) -> Optimizer:
    return Optimizer(Problem.from_dict(TOY), seed=seed, initial_evaluations=INITIAL)


def run(tuned: Optimizer, evaluations: int, size: int) -> Optimizer:
    """Tune in batches that are told in reverse."""
    while len(tuned.dataset) < evaluations:
        for x in reversed(tuned.ask(size)):
            tuned.tell(x, toy(x))
    return tuned


def are_distinct(setpoints: list[dict[str, float]]) -> bool:
    points = np.array([list(x.values()) for x in setpoints])
    distances = np.abs(points[:, None] - points).max(axis=2)
    return bool((distances[np.triu_indices(len(points), 1)] > SAME).all())


def test_batches_of_one_are_what_is_asked_one_by_one() -> None:
    single, batches = optimizer(), optimizer()
    for _ in range(INITIAL + 4):
        x = single.ask()
        assert batches.ask(1) == [x]
        single.tell(x, toy(x))
        batches.tell(x, toy(x))
    assert single.hypervolume == batches.hypervolume


def test_batches_reach_nearly_what_single_evaluations_reach() -> None:
    reached = [run(optimizer(seed), 40, 8).hypervolume for seed in range(3)]
    assert np.mean(reached) > 0.98 * SERIAL


@pytest.mark.parametrize("told", [0, 3, INITIAL, INITIAL + 4])
def test_pending_setpoints_are_asked_once(told: int) -> None:
    tuned = run(optimizer(), told, 1)
    batch = tuned.ask(5)
    assert tuned.pending == batch
    assert tuned.last_sources == ["initial" if told + i < INITIAL else "model" for i in range(5)]
    single = tuned.ask()
    assert tuned.ask() == single
    further = tuned.ask(4)
    assert further[0] == single
    assert tuned.pending == batch + further
    assert are_distinct(batch + further + [dict(e.setpoint) for e in tuned.dataset.evaluations])


def test_many_pending_setpoints_are_expected_at_once_with_the_same_result(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    tuned = run(optimizer(), INITIAL + 6, 1)
    many = tuned.ask(24)
    x1, x2 = np.random.default_rng(0).uniform(-2.0, 2.0, (2, 50))
    points = np.column_stack([x1, x2]) / 2.0

    def expected() -> tuple[dict[str, float], np.ndarray]:
        archive = Pending(many)._expected(tuned.archive)
        predictions = [p.predict(points) for p in archive.models.by_output.values()]
        return tuned.ask(), np.array(predictions)

    at_once, predicted = expected()
    monkeypatch.setattr(batch, "_FEW", 24)
    one_by_one, same = expected()
    assert predicted == pytest.approx(same, rel=1e-6, abs=1e-6)
    assert at_once == pytest.approx(one_by_one, abs=1e-4)
    assert tuned.last_sources == ["model"]


def test_a_setpoint_is_pending_until_it_was_told_or_cancelled() -> None:
    tuned = run(optimizer(), INITIAL, 1)
    a, b, c = tuned.ask(3)
    tuned.tell(b, toy(b))
    assert tuned.pending == [a, c]
    tuned.tell(c, {}, failed=True)
    assert tuned.pending == [a]
    tuned.tell({"x1": 0.1, "x2": 0.2}, toy({"x1": 0.1, "x2": 0.2}))
    assert tuned.pending == [a]
    tuned.cancel({name: value + 1e-9 for name, value in a.items()})
    assert tuned.pending == []
    with pytest.raises(ProblemError, match="not pending"):
        tuned.cancel(a)


def test_pending_setpoints_leave_no_trace_in_what_is_known() -> None:
    tuned, other = (run(optimizer(), INITIAL + 3, 1) for _ in range(2))
    for x in tuned.ask(4):
        tuned.cancel(x)
    assert tuned.hypervolume == other.hypervolume
    assert tuned.pareto_front() == other.pareto_front()
    assert tuned.ask() == other.ask()


@pytest.mark.parametrize("told", [2, INITIAL + 4])
def test_a_cancelled_setpoint_does_not_let_another_be_asked_twice(told: int) -> None:
    tuned = run(optimizer(), told, 1)
    batch = tuned.ask(3)
    tuned.cancel(batch[0])
    assert are_distinct(batch[1:] + tuned.ask(3))


@pytest.mark.parametrize("told", [2, INITIAL + 4])
def test_pending_setpoints_are_saved(told: int) -> None:
    tuned = run(optimizer(), told, 1)
    batch = tuned.ask(4)
    tuned.tell(batch[2], toy(batch[2]))
    restored = Optimizer.from_state(json.loads(json.dumps(tuned.get_state())))
    assert restored.pending == tuned.pending
    assert restored.ask(3) == tuned.ask(3)
    last = tuned.pending[-1]
    for each in (tuned, restored):
        each.tell(last, toy(last))
    assert restored.ask() == tuned.ask()


def test_pending_setpoints_stay_when_the_problem_changes() -> None:
    tuned = run(optimizer(), INITIAL, 1)
    tuned.ask(3)
    narrower = with_changes(variables=TOY["variables"] | {"x1": {"min": -1.0, "max": 2.0}})
    assert tuned.with_problem(narrower).pending == tuned.pending


def test_a_batch_can_be_told_partly_measured_and_noisy() -> None:
    tuned = run(optimizer(), INITIAL, 1)
    rng = np.random.default_rng(3)
    for _ in range(3):
        batch = tuned.ask(4)
        assert are_distinct(batch)
        for x in batch:
            noisy = {n: (v + rng.normal(0.0, 0.2), 0.2) for n, v in toy(x).items()}
            tuned.tell(x, dict(list(noisy.items())[:1]) if rng.random() < 0.3 else noisy)
    assert tuned.hypervolume > 0.0


def test_nothing_is_pending_where_all_failed() -> None:
    tuned = optimizer()
    for x in tuned.ask(INITIAL):
        tuned.tell(x, {}, failed=True)
    assert are_distinct(tuned.ask(3))


@pytest.mark.parametrize("count", [0, -1, True, 1.0, math.nan, "3", 10**6])
def test_a_size_that_is_not_a_positive_integer_is_refused(count: Any) -> None:
    with pytest.raises(ProblemError, match="count"):
        optimizer().ask(count)

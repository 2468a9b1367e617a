"""Suspected readings: one that is nothing like the rest does not count until another confirms it."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping

import numpy as np
import pytest

from mobo_tuner.core import Optimizer, Problem
from mobo_tuner.core.gaussian_process import GaussianProcess
from mobo_tuner.core.one_hot import OneHot
from mobo_tuner.core.suspects import find_suspects

PROBLEM = Problem.from_dict(
    {
        "variables": {name: {"min": -2.0, "max": 2.0} for name in "xy"},
        "objectives": {name: {"reference": 3.0} for name in "fg"},
    }
)


def truth(x: float, y: float) -> dict[str, float]:
    return {"f": math.hypot(x - 1.0, y - 1.0), "g": math.hypot(x + 1.0, y + 1.0)}


def go_on(
    optimizer: Optimizer, evaluations: int, wrong: Mapping[int, Mapping[str, float]] | None = None
) -> Optimizer:
    """Tune a machine that reads `wrong` outputs in some evaluations, up to a number of them."""
    for i in range(len(optimizer.dataset), evaluations):
        setpoint = optimizer.ask()
        optimizer.tell(setpoint, truth(**setpoint) | dict((wrong or {}).get(i, {})))
    optimizer.catch_up()
    return optimizer


def copy_of(optimizer: Optimizer) -> Optimizer:
    return Optimizer.from_state(json.loads(json.dumps(optimizer.get_state())))


@pytest.fixture(scope="module")
def right() -> dict[int, Optimizer]:
    """The tuning of a machine that reads nothing wrong, by its number of evaluations."""
    optimizer = Optimizer(PROBLEM, seed=0)
    return {n: copy_of(go_on(optimizer, n)) for n in (8, 18, 24, 28, 32, 70)}


def visited(optimizer: Optimizer) -> float:
    """Hypervolume of the true values at all set-points."""
    check = Optimizer(PROBLEM)
    for evaluation in optimizer.dataset.evaluations:
        check.tell(evaluation.setpoint, truth(**evaluation.setpoint))
    return check.hypervolume


def found(x: np.ndarray, y: np.ndarray, former: tuple[int, ...] = ()) -> list[int]:
    rows = np.array(former, dtype=np.intp)
    kept = np.delete(np.arange(len(y)), rows)
    unknown = np.full(len(y), np.nan)
    model = GaussianProcess().fit(x[kept], y[kept])
    return find_suspects(model, x, y, unknown, rows, np.random.default_rng(0)).tolist()


def smooth(n: int) -> tuple[np.ndarray, np.ndarray]:
    x = np.random.default_rng(1).uniform(-1.0, 1.0, (n, 2))
    return x, np.sin(2.0 * x[:, 0]) + x[:, 1]


def test_readings_of_an_instrument_that_has_stopped_are_suspected_but_for_the_first() -> None:
    x, y = smooth(40)
    truth_there = y[20:24].copy()
    y[20:24] = y[19]
    assert found(x, y) == [20, 21, 22, 23]
    assert found(x, y, (20, 21, 22, 23)) == [20, 21, 22, 23]
    y[30:33] = y[29]
    assert found(x, y) == [20, 21, 22, 23, 30, 31, 32]
    y[20:24] = truth_there
    assert found(x, y) == [30, 31, 32]


def test_equal_readings_that_may_be_right_are_not_suspected() -> None:
    x, y = smooth(40)
    at_edge, few_values, there_again = y.copy(), np.round(4.0 * y), y.copy()
    at_edge[20:24] = at_edge.max() + 0.1  # a camera that is clipped
    assert found(x, at_edge) == []
    few_values[20:24] = few_values[19]
    assert found(x, few_values) == []
    x_there = x.copy()
    x_there[20:24], there_again[20:24] = x[19], y[19]
    assert found(x_there, there_again) == []
    along, of_one = x.copy(), np.sin(2.0 * x[:, 0])
    along[20:24, 0], of_one[20:24] = (
        x[19, 0],
        of_one[19],
    )  # the output does not depend on what moved
    assert found(along, of_one) == []


def test_an_instrument_that_has_stopped_for_a_while_costs_next_to_nothing(
    right: dict[int, Optimizer],
) -> None:
    last = right[18].dataset.evaluations[17].values["f"]
    wrong = {i: {"f": last} for i in range(18, 22)}
    stopped = go_on(copy_of(right[18]), 32, wrong)
    assert stopped.suspected == [(i, "f") for i in wrong]
    assert visited(stopped) >= 0.98 * visited(right[28])


@pytest.mark.parametrize("by", [4.0, -4.0, 30.0, 1e6])
def test_a_reading_unlike_all_others_is_suspected(by: float) -> None:
    x, y = smooth(20)
    assert found(x, y) == []
    y[7] += by
    assert found(x, y) == [7]
    assert found(x, y, former=(7,)) == [7]


@pytest.mark.parametrize("by", [1e4, -1e12, 1e30])
def test_readings_that_would_hide_each_other_are_suspected(by: float) -> None:
    x, y = smooth(20)
    y[[2, 7, 15]] = y[[2, 7, 15]] + by * np.array([1.0, 5.0, -0.5])
    assert found(x, y) == [2, 7, 15]
    x[7] = x[2] + 0.1  # beside it: a cliff
    y[7] = y[2]
    assert found(x, y) == [15]


def test_a_quantity_that_spans_decades_is_not_suspected() -> None:
    x, y = smooth(20)
    assert found(x, np.exp(6.0 * y)) == []


def test_a_reading_that_fits_again_is_suspected_no_longer() -> None:
    x, y = smooth(20)
    assert found(x, y, former=(7,)) == []


def test_what_differs_from_a_plateau_is_not_suspected() -> None:
    x, y = smooth(20)
    y = np.minimum(y, -0.2)
    y[7] -= 30.0
    assert found(x, y) == []


def test_readings_that_confirm_each_other_are_not_suspected() -> None:
    x, y = smooth(24)
    x[15] = x[7] + 0.05
    y[[7, 15]] += 30.0
    assert found(x, y) == []
    x[15] = -x[7]
    assert found(x, y) == [7, 15]


def test_readings_of_an_instrument_that_failed_for_a_while_do_not_confirm_each_other() -> None:
    x, y = smooth(24)
    x[8:11] = x[7] + 0.05 * np.arange(1, 4)[:, None]
    y[7:11] = 30.0
    assert found(x, y) == [7, 8, 9, 10]
    x[15], y[15] = x[10] + 0.05, 31.0  # it does so again later: a cliff
    assert 10 not in found(x, y)
    x[16] = x[15] + 0.02  # and not, beside it
    y[16] = math.sin(2.0 * x[16, 0]) + x[16, 1]
    assert 15 in found(x, y)


@pytest.mark.parametrize("wild", [{"f": 10.0}, {"g": 1e6}, {"f": 0.0, "g": 0.0}, {"f": -50.0}])
def test_one_wild_reading_costs_next_to_nothing(
    right: dict[int, Optimizer], wild: dict[str, float]
) -> None:
    optimizer = go_on(copy_of(right[8]), 32, {8: wild})
    assert optimizer.suspected
    assert set(optimizer.suspected) <= {(8, name) for name in wild}
    assert visited(optimizer) >= 0.98 * right[32].hypervolume
    assert optimizer.hypervolume == pytest.approx(visited(optimizer), rel=0.02)
    restored = copy_of(optimizer)
    assert restored.suspected == optimizer.suspected
    assert restored.hypervolume == optimizer.hypervolume
    assert restored.ask() == optimizer.ask()


@pytest.mark.parametrize("n", [24, 70])
def test_a_wild_reading_never_counts_not_even_until_the_next_suggestion(
    right: dict[int, Optimizer], n: int
) -> None:
    optimizer, same = copy_of(right[n]), copy_of(right[n])
    before = optimizer.hypervolume
    setpoint = optimizer.ask()
    for each in (optimizer, same):
        each.tell(setpoint, truth(**setpoint) | {"f": -10.0})
    assert optimizer.suspected == [(n, "f")]
    assert 0.999 * before < optimizer.hypervolume < 1.02 * before
    assert n not in {point["index"] for point in optimizer.pareto_front() if not point["predicted"]}
    assert optimizer.hypervolume_measured > 1.5 * before
    # Whether anybody looked at it makes no difference to what is asked next.
    assert optimizer.ask() == same.ask()


def test_a_withdrawn_reading_counts_nowhere_and_can_be_taken_back(
    right: dict[int, Optimizer],
) -> None:
    optimizer = go_on(copy_of(right[8]), 14, {8: {"f": 0.0, "g": 0.0}})
    assert optimizer.hypervolume_measured == pytest.approx(9.0)
    optimizer.forget(8)
    assert optimizer.hypervolume_measured < 5.0
    assert 8 not in [p["index"] for p in optimizer.pareto_front(measured=True)]
    optimizer.ask()
    assert optimizer.hypervolume < 5.0
    optimizer.unforget(8)
    assert optimizer.hypervolume_measured == pytest.approx(9.0)


def test_other_choices_without_an_order_confirm_nothing() -> None:
    places = np.linspace(-1.0, 1.0, 5)
    rng = np.random.default_rng(1)
    x = np.column_stack([rng.choice(places, 40), rng.uniform(-1.0, 1.0, 40)])
    y = np.sin(3.0 * x[:, 1]) + (x[:, 0] == places[3])
    x[[7, 20]] = [[places[1], 0.1], [places[2], 0.12]]
    y[[7, 20]] = 8.0
    kept = np.delete(np.arange(40), [7, 20])
    suspected = []
    for one_hot in (None, OneHot([places, None])):
        model = GaussianProcess(one_hot=one_hot).fit(x[kept], y[kept])
        rng = np.random.default_rng(0)
        found = find_suspects(model, x, y, np.full(40, np.nan), np.array([7, 20]), rng)
        suspected.append(found.tolist())
    assert suspected == [[], [7, 20]]

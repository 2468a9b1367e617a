"""The comparison with other optimisers: one run, its summary, and the tables of docs/peers.md."""

from __future__ import annotations

from pathlib import Path

import moocore
import numpy as np
import pytest

from experiments.campaign import RESULTS, Results, compute
from experiments.campaign import Size as CampaignSize
from experiments.peers.__main__ import DOCUMENT, plan, read, with_parts
from experiments.peers.methods import METHODS, Suggester
from experiments.peers.problems import PROBLEMS
from experiments.peers.race import race
from experiments.peers.report import details, duels, label, summary
from mobo_tuner.core.arrays import FloatArray
from mobo_tuner.core.initial_design import initial_design


def test_hypervolumes_are_those_of_the_feasible_noiseless_values() -> None:
    noisy, plain = (race(3, "c2_dtlz2", "random", noise, 80, limit=60.0) for noise in (0.05, 0.0))
    assert noisy["hypervolumes"] == plain["hypervolumes"]  # random search reads nothing
    benchmark, rng = PROBLEMS["c2_dtlz2"](), np.random.default_rng([3, 12345])
    assert benchmark.others is not None
    starts = initial_design("latin_hypercube", 10, benchmark.problem.domain, 3)
    x = np.vstack([starts, *(rng.uniform(-1.0, 1.0, (70, 4)))])
    objectives, feasible = benchmark.objectives(x), benchmark.others["g0"](x) <= 0.0
    assert 0 < feasible.sum() < 80
    for n in (10, 40, 80):
        front = objectives[:n][feasible[:n]]
        expected = (
            moocore.hypervolume(front, ref=[1.1, 1.1]) / benchmark.unit if len(front) else 0.0
        )
        assert plain["hypervolumes"][n - 1] == pytest.approx(expected, rel=1e-5)


def test_a_run_that_takes_too_long_is_stopped_and_says_so() -> None:
    record = race(0, "penicillin", "perfect", 0.0, 60, limit=0.5)
    assert record["stopped"] < 60
    assert len(record["hypervolumes"]) == record["stopped"]


def test_a_run_is_stopped_even_if_its_method_swallows_the_first_error(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    swallowed = []

    def stubborn(*_: object) -> Suggester:
        def suggest(x: FloatArray, _: FloatArray) -> FloatArray:
            while True:
                try:
                    np.linalg.norm(x)
                except BaseException as error:
                    swallowed.append(error)
                    if len(swallowed) > 1:
                        raise

        return suggest

    monkeypatch.setitem(METHODS, "stubborn", stubborn)
    record = race(0, "toy", "stubborn", 0.0, 60, limit=0.1)
    assert record["stopped"] == 6
    assert len(swallowed) == 2


@pytest.mark.parametrize(("stopped", "compared"), [(19, []), (25, [25 / 24])])
def test_a_run_that_was_stopped_is_compared_as_far_as_it_came(
    tmp_path: Path, stopped: int, compared: list[float]
) -> None:
    results = Results(tmp_path / "toy.json")
    theirs = {"hypervolumes": [float(n) for n in range(stopped)], "stopped": stopped}
    ours = {"hypervolumes": [float(n + 1) for n in range(60)]}
    results.runs = {"default": {0: ours}, "random": {0: theirs}}
    assert [duel.late for duel in duels({"toy": results}, "random", 0.0)] == compared


@pytest.fixture
def raced(tmp_path: Path) -> dict[str, Results]:
    runs = plan("toy", ["default", "random"], [0.0], CampaignSize(seeds=2), 12, 60.0)
    compute(runs, Results(tmp_path / "toy.json"), "command")
    return read(tmp_path)


def test_duels_and_tables(raced: dict[str, Results]) -> None:
    found = duels(raced, "random", 0.0)
    ends = [raced["toy"].curves(label(method, 0.0))[:, -1] for method in ("default", "random")]
    np.testing.assert_allclose([duel.late for duel in found], ends[0] / ends[1])
    assert all(duel.needed <= 1.0 for duel in found)
    assert "| random | others, 1 | 2 |" in "\n".join(summary(raced, 0.0))
    assert len(details(raced, 0.0)) == 2 + 2


def test_the_tables_of_the_document_are_current() -> None:
    text = DOCUMENT.read_text(encoding="utf-8")
    current = with_parts(text, read(RESULTS / "peers"))
    assert current == text, "run python -m experiments.peers --draw"

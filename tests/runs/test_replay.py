"""Going on with a run: what is asked is what an uninterrupted run would have asked, to the last bit."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from mobo_tuner.core import Optimizer, Problem, ProblemError
from mobo_tuner.runs import replay
from mobo_tuner.runs.history import READBACK, History
from mobo_tuner.runs.journal import FILE_NAME, JournalError, journal_line, read_journal
from mobo_tuner.runs.optimizer_settings import make_optimizer
from mobo_tuner.runs.recorded_run import RecordedRun
from mobo_tuner.runs.records import ForgetRecord, QueuedRecord
from mobo_tuner.runs.saved_state import FILE_NAME as STATE_NAME
from mobo_tuner.runs.saved_state import SavedState
from robustness.offline_run import TOY, OfflineRun, toy, toy_optimizer

LENGTH = 14
SEED = 7  # with failures, an operator's set-points and two changes


@pytest.fixture(scope="module")
def asked_and_kept(tmp_path_factory: pytest.TempPathFactory) -> tuple[list[dict[str, float]], Path]:
    """What an uninterrupted run asks at each evaluation, and its folder after each of them."""
    folder = tmp_path_factory.mktemp("runs") / "run"
    run = OfflineRun(folder, toy_optimizer(SEED), toy, SEED)
    asked = []
    for index in range(LENGTH):
        asked.append(run.ask())
        shutil.copytree(folder, folder.parent / f"after-{index}")
        run.step()
    asked.append(run.ask())
    run.log.close()
    shutil.copytree(folder, folder.parent / f"after-{LENGTH}")
    return asked, folder.parent


def history_of(folder: Path) -> History:
    return History.from_records(read_journal(folder))


def test_the_run_has_everything_that_can_happen(
    asked_and_kept: tuple[list[dict[str, float]], Path],
) -> None:
    records = read_journal(asked_and_kept[1] / "run")
    kinds = {record["type"] for record in records}
    assert kinds == {"start", "evaluation", "change", "queued"}
    assert {r["source"] for r in records if r["type"] == "evaluation"} == {
        "initial",
        "model",
        "operator",
    }
    assert any(not r["valid"] for r in records if r["type"] == "evaluation")


@pytest.mark.parametrize("told", range(LENGTH + 1))
def test_a_restored_run_asks_what_it_would_have_asked(
    asked_and_kept: tuple[list[dict[str, float]], Path], told: int
) -> None:
    asked, folder = asked_and_kept
    kept = folder / f"after-{told}"
    history = history_of(kept)
    saved = SavedState.read(kept)
    assert (saved is None) == (told == 0)
    assert replay.restore(history, None).ask() == asked[told]
    if saved is not None:
        assert saved.revive(history) is not None
        assert replay.restore(history, saved).ask() == asked[told]


def carry_out_and_restore(run: OfflineRun, folder: Path) -> tuple[History, list[Optimizer]]:
    """Make nine evaluations; return the run's history, and it restored without and with its saved state."""
    for _ in range(9):
        run.step()
    run.log.close()
    history, saved = history_of(folder), SavedState.read(folder)
    assert saved is not None
    assert saved.revive(history) is not None
    return history, [replay.restore(history), replay.restore(history, saved)]


def test_a_run_that_learns_from_readbacks_is_restored_with_them(tmp_path: Path) -> None:
    run = OfflineRun(tmp_path / "run", toy_optimizer(SEED), toy, SEED, model_input=READBACK)
    _, both = carry_out_and_restore(run, tmp_path / "run")
    for restored in both:
        assert restored.ask() == run.ask()
        first = restored.dataset.evaluations[0]
        assert first.readbacks == {n: v + 0.01 for n, v in first.setpoint.items()}


def test_a_run_of_a_drifting_machine_is_restored_with_its_times(tmp_path: Path) -> None:
    optimizer = Optimizer(Problem.from_dict(TOY), seed=SEED, initial_evaluations=4, drift="on")
    run = OfflineRun(tmp_path / "run", optimizer, toy, SEED)
    history, both = carry_out_and_restore(run, tmp_path / "run")
    for restored in both:
        assert restored.models.drifts
        assert restored.ask() == run.ask()
        stamps = [record.stamp for record in history.evaluations]
        assert [e.time for e in restored.dataset.evaluations] == stamps


def test_a_run_in_which_something_was_withdrawn_is_restored_and_replayed(tmp_path: Path) -> None:
    offline = OfflineRun(tmp_path / "run", toy_optimizer(SEED), toy, SEED, events=False)
    withdrawals = {
        6: [ForgetRecord(0.0, 0, 5), ForgetRecord(0.0, 0, 2, "f1")],
        9: [ForgetRecord(0.0, 0, 5, withdrawn=False), ForgetRecord(0.0, 0, 8)],
        12: [ForgetRecord(0.0, 0, 3)],
    }
    asked = []
    for index in range(13):
        offline.ask()  # the suggestion that is due is always made first
        for request in withdrawals.get(index, ()):
            offline.run.withdraw(request)
            shutil.rmtree(tmp_path / "before", ignore_errors=True)
            shutil.copytree(tmp_path / "run", tmp_path / "before")  # its state is late
        asked.append(offline.ask())
        if index < 12:
            offline.step()
    assert offline.run.found.withdrawn == {(2, "f1"), (3, None), (8, None)}
    assert offline.run.found.evaluations == 12
    offline.log.close()
    history = history_of(tmp_path / "run")
    assert [record.index for record in history.withdrawals] == [6, 6, 9, 9, 12]
    for comparison, expected in zip(replay.compare(history), asked, strict=False):
        assert comparison.now == expected
        assert not comparison.differs
    for saved in (None, SavedState.read(tmp_path / "run"), SavedState.read(tmp_path / "before")):
        restored = replay.restore(history, saved)
        assert restored.ask() == asked[-1]
        assert set(restored.dataset.withdrawn) == offline.run.found.withdrawn
    recorded = RecordedRun.from_records(read_journal(tmp_path / "run"))
    assert [n for n in range(12) if not recorded.valid[n]] == [3, 8]
    assert not recorded.feasible[2]
    assert set(recorded.indices[recorded.front]) == {p["index"] for p in offline.run.found.front}


@pytest.mark.parametrize("late", [1, 3, 8])
def test_a_state_that_is_late_is_brought_up_to_date(
    asked_and_kept: tuple[list[dict[str, float]], Path], late: int
) -> None:
    asked, folder = asked_and_kept
    saved = SavedState.read(folder / f"after-{LENGTH - late}")
    assert saved is not None
    restored = replay.restore(history_of(folder / "run"), saved)
    assert restored.ask() == asked[LENGTH]
    whole = replay.restore(history_of(folder / "run"), SavedState.read(folder / "run"))
    assert restored.hypervolume == whole.hypervolume


def damaged(text: bytes) -> bytes:
    return text.replace(b'"hypervolume": ', b'"hypervolume": 1', 1)


@pytest.mark.parametrize(
    "spoil",
    [lambda _: b"", lambda text: text[:100], damaged, lambda _: b"[]\n\n", lambda _: b"\xff" * 99],
    ids=["empty", "cut", "altered", "no state", "no text"],
)
def test_a_damaged_state_is_not_believed(
    asked_and_kept: tuple[list[dict[str, float]], Path],
    tmp_path: Path,
    spoil: Callable[[bytes], bytes],
) -> None:
    _, folder = asked_and_kept
    whole = (folder / "run" / STATE_NAME).read_bytes()
    (tmp_path / STATE_NAME).write_bytes(spoil(whole))
    assert SavedState.read(tmp_path) is None


def test_a_state_of_another_run_is_not_believed(
    asked_and_kept: tuple[list[dict[str, float]], Path],
) -> None:
    asked, folder = asked_and_kept
    saved = SavedState.read(folder / f"after-{LENGTH}")
    assert saved is not None
    stranger = SavedState("other", saved.evaluations, saved.changes, saved.state)
    early = SavedState(saved.run_id, LENGTH + 5, saved.changes, saved.state)
    broken = SavedState(saved.run_id, saved.evaluations, saved.changes, {"version": 1})
    history = history_of(folder / "run")
    for state in (stranger, early, broken):
        assert state.revive(history) is None
    assert replay.restore(history, stranger).ask() == asked[LENGTH]


def test_replay_says_whether_the_suggestions_are_the_same(
    asked_and_kept: tuple[list[dict[str, float]], Path],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    _, folder = asked_and_kept
    assert replay.main([str(folder / "run")]) == 0
    said = capsys.readouterr().out
    operators = sum(e.source == "operator" for e in history_of(folder / "run").evaluations)
    count = LENGTH - operators
    assert f"{count} suggestions computed again, {count} identical" in said

    records = read_journal(folder / "run")
    record = next(record for record in records if record.get("source") == "model")
    record["setpoint"]["x1"] += 1e-12
    (tmp_path / FILE_NAME).write_bytes(b"".join(map(journal_line, records)))
    assert replay.main([str(tmp_path)]) == 1
    assert f"{record['index']}: then" in capsys.readouterr().out


def test_set_points_that_wait_survive(tmp_path: Path) -> None:
    run = OfflineRun(tmp_path / "run", toy_optimizer(0), toy, 0, events=False)
    points = [{"x1": 0.1 * i, "x2": -0.1 * i} for i in range(4)]
    for point in points[:3]:
        run.log.append(QueuedRecord(0.0, point))
    run.step()
    _, evaluation = run.run.records[-1]
    # The second is evaluated: the first was dropped, the third waits.
    run.log.append(replace(evaluation, index=1, source="operator", setpoint=points[1]))
    run.log.append(QueuedRecord(0.0, points[3]))
    run.log.close()
    assert list(history_of(tmp_path / "run").waiting) == points[2:]


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"index": 3}, "index is 3"),
        ({"index": True}, "index is not valid: True"),
        ({"source": "guess"}, "source is not valid: 'guess'"),
        ({"setpoint": {"x1": 0.0}}, "'x2'"),
        ({"setpoint": {"x1": 1e999, "x2": 0.0}}, "x1"),
        ({"diagnostics": {"f1": 3.0}}, "diagnostics is not valid: 3.0"),
        ({"diagnostics": []}, "diagnostics is not valid: []"),
        ({"valid": 1}, "valid is not valid: 1"),
        ({"error_code": None}, "error_code is not valid: None"),
        ({"error_code": ...}, "lacks 'error_code'"),
    ],
)
def test_a_journal_that_cannot_be_right_is_refused_in_one_sentence(
    tmp_path: Path, change: dict[str, object], sentence: str
) -> None:
    run = OfflineRun(tmp_path / "run", toy_optimizer(0), toy, 0, events=False)
    run.step()
    run.log.close()
    start, evaluation = read_journal(tmp_path / "run")
    changed = {k: v for k, v in {**evaluation, **change}.items() if v is not ...}
    with pytest.raises(JournalError, match="record 2, 'evaluation'") as caught:
        History.from_records([start, changed])
    assert sentence in str(caught.value)
    assert "\n" not in str(caught.value)


def test_settings_that_cannot_be_right_are_refused(tmp_path: Path) -> None:
    run = OfflineRun(tmp_path / "run", toy_optimizer(0), toy, 0, events=False)
    run.log.close()
    history = history_of(tmp_path / "run")
    for settings, sentence in (
        ({}, "lack 'preset'"),
        ({"preset": "default"}, "lack 'seed'"),
        ({"preset": "default", "seed": []}, "seed is"),
        ({"preset": "default", "seed": 1, "kernel": "cubic"}, "kernel is 'cubic'"),
        ({"preset": "default", "seed": 1, "weights": [1.0]}, "weights is"),
    ):
        with pytest.raises(ProblemError, match=sentence):
            make_optimizer(history.problem, settings)
    with pytest.raises(ProblemError, match="preset is 'none'"):
        make_optimizer(history.problem, {**history.settings, "preset": "none"})

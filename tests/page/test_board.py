"""What is known from the topics, and the words that say it."""

from __future__ import annotations

import math
import time
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from mobo_msgs_py import msg
from mobo_tuner.page.board import PATIENCE, Board, Level, Part
from mobo_tuner.page.words import duration, first_words, measured, number, state_of
from tests.support.tuner_double import make_evaluation


def named(**values: float) -> list[msg.NamedValue]:
    return [msg.NamedValue(name=name, value=value) for name, value in values.items()]


def board_of(*messages: tuple[str, Any], age: float = 0.0) -> Board:
    """A board that has taken messages, some seconds ago."""
    board = Board()
    for topic, message in messages:
        board.take(topic, message, time.monotonic() - age)
    return board


def status(state: int = msg.TunerStatus.EVALUATING, **fields: Any) -> tuple[str, Any]:
    return "status", msg.TunerStatus(state=state, run_id="run", **fields)


def test_what_a_browser_shows_first_is_the_state_and_never_read_as_html() -> None:
    message = status(message="<b>a & b</b>", evaluations=3, budget=7)
    text = first_words(board_of(message), dark=False)
    assert "Running" in text
    assert "3 / 7" in text
    assert "&lt;b&gt;a &amp; b&lt;/b&gt;" in text
    assert "body--light" in text


@pytest.mark.parametrize(
    ("message", "word", "tone"),
    [
        (status(msg.TunerStatus.SUGGESTING), "Running", "busy"),
        (status(msg.TunerStatus.EVALUATING), "Running", "busy"),
        (status(msg.TunerStatus.PAUSED), "Paused", "wait"),
        (status(msg.TunerStatus.WAITING), "Waiting", "wait"),
        (status(msg.TunerStatus.CANCELING), "Stopping", "still"),
        (status(msg.TunerStatus.MOVING, stop_reason="budget"), "Moving", "busy"),
        (status(msg.TunerStatus.IDLE), "Idle", "still"),
        (status(msg.TunerStatus.IDLE, stop_reason="budget"), "Finished", "good"),
        (status(msg.TunerStatus.IDLE, stop_reason="stopped"), "Stopped", "still"),
        (status(msg.TunerStatus.IDLE, stop_reason="error", message="no beam"), "Failed", "bad"),
    ],
)
def test_the_state_is_one_word(message: tuple[str, Any], word: str, tone: str) -> None:
    state = state_of(board_of(message))
    assert (state.word, state.tone) == (word, tone)
    assert state.sentence
    if message[1].message:
        assert state.sentence == message[1].message


def test_every_reason_to_stop_has_a_word() -> None:
    constants = [name for name in dir(msg.TunerStatus) if name.startswith("STOP_REASON_")]
    for name in constants:
        reason = getattr(msg.TunerStatus, name)
        assert state_of(board_of(status(msg.TunerStatus.IDLE, stop_reason=reason))).word != "Idle"


def test_only_the_beginning_of_a_suggestion_is_left_to_the_tuner() -> None:
    suggesting = status(msg.TunerStatus.SUGGESTING)
    assert board_of(suggesting).begins_suggestion
    assert not board_of(suggesting, age=2.0 * PATIENCE).begins_suggestion
    board = board_of(suggesting, age=2.0 * PATIENCE)
    board.take(*suggesting, time.monotonic())  # the status is repeated
    assert not board.begins_suggestion
    board.take(*status(), time.monotonic())
    board.take(*suggesting, time.monotonic())
    assert board.begins_suggestion


def test_silence_counts_more_than_the_last_state() -> None:
    assert state_of(Board()).word == "No tuner"
    old = state_of(board_of(status(), age=12.0))
    assert (old.word, old.tone) == ("Tuner silent", "bad")
    assert "12 s" in old.sentence


def test_an_evaluation_counts_once_and_belongs_to_its_run() -> None:
    board = board_of(
        ("evaluation", make_evaluation("before", 0)),
        status(),
        *(("evaluation", make_evaluation("run", index)) for index in (0, 1, 0, 2)),
    )
    assert board.run is not None
    assert board.run.run_id == "run"
    assert [e.index for e in board.run.evaluations] == [0, 1, 2]
    version = board.version
    board.take("evaluation", make_evaluation("run", 2), time.monotonic())
    assert board.version == version


def test_evaluations_without_a_gain_are_counted() -> None:
    messages = [make_evaluation("run", index) for index in range(5)]
    for message, hypervolume in zip(messages, (1.0, 3.0, 2.0, 3.0, 2.5), strict=True):
        message.hypervolume = hypervolume
    board = board_of(status(), *(("evaluation", message) for message in messages))
    assert board.run is not None
    assert board.run.without_gain == 3


def test_only_the_last_runs_are_kept() -> None:
    board = board_of(*(("evaluation", make_evaluation(f"run{i}", 0)) for i in range(9)))
    board.take("status", msg.TunerStatus(run_id="run8"), time.monotonic())
    assert board.run is not None
    assert len(board.run.evaluations) == 1
    board.take("status", msg.TunerStatus(run_id="run0"), time.monotonic())
    assert len(board.run.evaluations) == 0


def test_a_motion_goes_from_where_the_machine_was() -> None:
    board = board_of(
        ("machine_readbacks", msg.NamedValues(values=named(K1=431.0, K2=5.0))),
        ("machine_setpoint", msg.NamedValues(values=named(K1=447.0, K2=5.0, G1=1.0))),
        ("machine_readbacks", msg.NamedValues(values=named(K1=435.0, K2=5.0))),
    )
    motion = board.motion
    assert (motion.start["K1"], motion.target["K1"], motion.readbacks["K1"]) == (431, 447, 435)
    assert motion.fraction("K1") == pytest.approx(0.25)
    assert motion.fraction("K2") == 1.0
    assert math.isnan(motion.fraction("G1"))
    assert board.here["K1"] == 435.0


def test_the_health_of_a_part_that_falls_silent_is_stale() -> None:
    parts = DiagnosticArray(
        status=[
            DiagnosticStatus(
                name="awa_sim: beam",
                level=DiagnosticStatus.WARN,
                message="a trip",
                values=[KeyValue(key="trips", value="3")],
            )
        ]
    )
    [part] = board_of(("/diagnostics", parts)).parts()
    assert (part.level, part.message, part.values) == ("warning", "a trip", {"trips": "3"})
    [part] = board_of(("/diagnostics", parts), age=60.0).parts()
    assert (part.level, part.message) == ("stale", "silent for 60 s")
    recorder = msg.RecorderStatus(recording=False, message="the disk is full")
    [part] = board_of(("recorder_status", recorder)).parts()
    assert (part.name, part.level, part.message) == ("recorder", "error", "the disk is full")


@pytest.mark.parametrize(
    ("value", "text"), [(431.2, "431.2"), (-0.5, "−0.5"), (math.nan, "–"), (2.978e8, "2.978×10⁸")]
)
def test_numbers_are_short(value: float, text: str) -> None:
    assert number(value) == text


def test_measurements_and_times_are_for_people() -> None:
    assert measured(1.23456, 0.0123, "mm") == "1.235 ± 0.012 mm"
    assert measured(1.23456, math.nan) == "1.235"
    assert [duration(s) for s in (7.2, 75.0, 3725.0, math.nan)] == [
        "7 s",
        "1:15 min",
        "1:02:05 h",
        "?",
    ]


@pytest.mark.parametrize(
    ("level", "free", "disk"),
    [
        ("error", "57.8", ("ok", "57.8 GB free")),
        ("ok", "0.4", ("warning", "0.4 GB free")),
        ("stale", "57.8", ("stale", "57.8 GB free")),
        ("warning", "nan", ("ok", "not in use yet")),
    ],
)
def test_a_disk_is_judged_by_its_own_space(level: Level, free: str, disk: tuple[str, str]) -> None:
    part = Part("tuner: run", level, "the last run failed", {"free disk space [GB]": free})
    assert part.disk == disk
    assert Part("tuner: run", level, "", {}).disk is None

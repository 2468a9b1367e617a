"""Keys of a terminal that steer the run."""

from __future__ import annotations

import os
import termios
from collections.abc import Iterator

import pytest

from mobo_tuner.client import ErrorCode, Status, TunerError
from mobo_tuner.displays.keys import Keys, reading_keys
from tests.support.processes import wait_until


class Tuner:
    """Answers as a client does, and keeps what was asked."""

    def __init__(self) -> None:
        self.asked: list[str] = []
        self.state = "evaluating"

    def status(self) -> Status:
        return Status(self.state)

    def __getattr__(self, name: str) -> object:
        def ask() -> str:
            self.asked.append(name)
            if name == "step":
                raise TunerError(ErrorCode.REFUSED, "the run is not paused")
            return f"{name}: done"

        return ask


@pytest.fixture
def terminal() -> Iterator[tuple[int, int]]:
    """A terminal: its side for people and its side for programs."""
    people, programs = os.openpty()
    yield people, programs
    os.close(people)
    os.close(programs)


def test_keys_ask_the_tuner_and_a_stop_is_confirmed(terminal: tuple[int, int]) -> None:
    people, programs = terminal
    tuner, said = Tuner(), list[str]()
    keys = Keys(tuner, said.append)  # type: ignore[arg-type]
    before = termios.tcgetattr(programs)
    with reading_keys(keys.press, programs) as readable:
        assert readable
        for key, sentence in (
            ("p", "pause: done"),
            ("k", "skip: done"),
            ("s", "the run is not paused"),
            ("x", "press y"),
            ("n", "the run is not stopped"),
            ("x", "press y"),
            ("y", "stop: done"),
        ):
            count = len(said)
            os.write(people, key.encode())
            wait_until(lambda: len(said) > count, f"the answer to {key}")  # noqa: B023
            assert sentence in said[-1]
        tuner.state = "paused"
        os.write(people, b"?p")
        wait_until(lambda: tuner.asked[-1] == "resume", "the run to continue")
    assert tuner.asked == ["pause", "skip", "step", "stop", "resume"]
    assert termios.tcgetattr(programs) == before


def test_what_is_no_terminal_has_no_keys() -> None:
    reading, writing = os.pipe()
    with reading_keys(pytest.fail, reading) as readable:
        assert not readable
    os.close(reading)
    os.close(writing)

"""The order of the requests of several viewers, with a client that answers when it is told to."""

from __future__ import annotations

import asyncio
import threading
from typing import cast

import pytest

from mobo_tuner.client import TunerClient
from mobo_tuner.page import commands
from mobo_tuner.page.commands import Answer, Commands, Turns


class SlowClient:
    """Answers one request at a time, when it may."""

    def __init__(self) -> None:
        self.answers = threading.Event()
        self.made: list[str] = []
        self.at_once = 0

    def pause(self) -> str:
        return self._answer("pause")

    def skip(self) -> str:
        return self._answer("skip")

    def _answer(self, name: str) -> str:
        self.at_once += 1
        assert self.at_once == 1
        assert self.answers.wait(30.0)
        self.made.append(name)
        self.at_once -= 1
        return name


@pytest.fixture
def client() -> SlowClient:
    return SlowClient()


def viewers(client: SlowClient) -> tuple[Commands, Commands]:
    turns = Turns()
    first, second = (Commands(cast("TunerClient", client), turns) for _ in range(2))
    return first, second


def test_another_viewers_request_waits_for_its_turn_and_ones_own_is_not_made_twice(
    client: SlowClient,
) -> None:
    async def ask() -> list[Answer]:
        first, second = viewers(client)
        asked = [asyncio.create_task(request()) for request in (first.skip, second.pause)]
        await asyncio.sleep(0)
        twice = await first.skip()
        client.answers.set()
        return [twice, *await asyncio.gather(*asked), await first.skip()]

    twice, *others = asyncio.run(ask())
    assert not twice.agreed
    assert [answer.sentence for answer in others] == ["skip", "pause", "skip"]
    assert client.made == ["skip", "pause", "skip"]


def test_a_request_that_would_come_too_late_is_not_made(
    client: SlowClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(commands, "TURN_TIMEOUT", 0.05)

    async def ask() -> tuple[Answer, Answer]:
        first, second = viewers(client)
        asked = asyncio.create_task(first.skip())
        await asyncio.sleep(0)
        late = await second.pause()
        client.answers.set()
        return late, await asked

    late, done = asyncio.run(ask())
    assert not late.agreed
    assert "yours was not made" in late.sentence
    assert done.agreed
    assert client.made == ["skip"]

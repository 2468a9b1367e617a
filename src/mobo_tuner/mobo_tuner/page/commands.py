"""What a viewer asks of the tuner, by its public client, off the thread of the page."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from mobo_tuner.client import Arrival, TunerClient, TunerError

LEAST_PERIOD = 0.2  # [s] between two requests of all viewers together
TURN_TIMEOUT = 5.0  # [s] for those of other viewers; later, a request would surprise


class Answer(NamedTuple):
    """Answer to a request.

    Attributes:
        agreed: Whether the tuner did it.
        sentence: Its sentence.
    """

    agreed: bool
    sentence: str


class Turns:
    """The order of the requests of all viewers: one is made at a time, and a move beside it."""

    def __init__(self) -> None:
        self.request = asyncio.Lock()
        self.move = asyncio.Lock()


class Commands:
    """Requests of one viewer to a tuner.

    Those of other viewers are made in their order. A second one of the same viewer is refused until the first was
    answered, so that a double click on Step or Skip counts once.

    Args:
        client: Client of the tuner.
        turns: Order of the requests of all viewers.
    """

    def __init__(self, client: TunerClient, turns: Turns) -> None:
        self._client = client
        self._turns = turns
        self._is_asking = False

    async def pause(self) -> Answer:
        """Pause the run after the current evaluation."""
        return await self._ask(self._client.pause)

    async def resume(self) -> Answer:
        """Continue a paused run."""
        return await self._ask(self._client.resume)

    async def step(self) -> Answer:
        """Do one evaluation of a paused run."""
        return await self._ask(self._client.step)

    async def skip(self) -> Answer:
        """End the current evaluation, or stop the machine on its way."""
        return await self._ask(self._client.skip)

    async def stop(self) -> Answer:
        """End the run after the current evaluation."""
        return await self._ask(self._client.stop)

    async def cancel(self) -> Answer:
        """Cancel the active run or move, ahead of all other requests."""

        def cancel() -> str:
            return "it is being canceled" if self._client.cancel_any() else "nothing is active"

        return await _made(cancel)

    async def queue(self, setpoint: Mapping[str, float]) -> Answer:
        """Add a set-point, which the run evaluates next."""

        def queue() -> str:
            waiting = self._client.queue(setpoint)
            return f"the set-point is queued; {waiting} in the queue"

        return await self._ask(queue)

    async def set(self, values: Mapping[str, Any]) -> Answer:
        """Set parameters of the tuner: all of them, or none."""

        def change() -> str:
            self._client.set(values)
            return "changed: " + ", ".join(f"{name} = {value}" for name, value in values.items())

        return await self._ask(change)

    async def more(self, run_id: str, evaluations: int) -> Answer:
        """Continue a run that has ended in a new one, up to a budget."""

        def more() -> str:
            new = self._client.start(resume_from=run_id, evaluations=evaluations)
            return f"run {new} continues run {run_id} up to {evaluations} evaluations"

        return await self._ask(more)

    async def restore(self, run_id: str) -> Answer:
        """Go to where the machine was before a run, and wait until it has arrived."""

        def restore() -> str:
            self._client.go(before=True, run_id=run_id)
            return f"the machine is where it was before run {run_id}"

        return await self._move(restore)

    async def go(self, index: int, run_id: str, hold: int) -> Answer:
        """Go to a point of the front, and wait until the machine has arrived."""

        def go() -> str:
            arrival: Arrival = self._client.go(index, run_id=run_id, hold=hold)
            count = arrival.evaluations
            held = f" and held it for {count} evaluation{'s' * (count != 1)}" if hold else ""
            there = f"the machine is at the point of evaluation {index}{held}"
            return f"{there}; {arrival.remark}" if arrival.remark else there

        return await self._move(go)

    async def _move(self, request: Callable[[], str]) -> Answer:
        if self._turns.move.locked():
            return Answer(False, "the machine is already on its way; stop it first")
        async with self._turns.move:
            return await _made(request)

    async def _ask(self, request: Callable[[], str]) -> Answer:
        if self._is_asking:
            return Answer(False, "the tuner has not answered your last request yet")
        self._is_asking = True
        try:
            return await self._ask_in_turn(request)
        finally:
            self._is_asking = False

    async def _ask_in_turn(self, request: Callable[[], str]) -> Answer:
        turn = self._turns.request
        try:
            await asyncio.wait_for(turn.acquire(), TURN_TIMEOUT)
        except TimeoutError:
            text = "the tuner has not answered another viewer's request yet; yours was not made"
            return Answer(False, text)
        try:
            answer = await _made(request)
            await asyncio.sleep(LEAST_PERIOD)
        finally:
            turn.release()
        return answer


async def _made(request: Callable[[], str]) -> Answer:
    """Make a request in a thread of its own; a refusal is an answer, too."""
    try:
        return Answer(True, await asyncio.to_thread(request))
    except TunerError as error:
        return Answer(False, str(error))

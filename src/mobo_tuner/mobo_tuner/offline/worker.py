"""A worker of a campaign on any host that shares the folder of the run.

`python -m mobo_tuner.offline.worker FOLDER` waits until the campaign in that folder listens, and then
simulates its points, one at a time, until the campaign ends. It may be started and ended at any time.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import socket
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from multiprocessing import AuthenticationError
from multiprocessing.connection import Connection, answer_challenge, deliver_challenge
from pathlib import Path
from typing import Any, Protocol

from mobo_tuner.errors import ParameterError
from mobo_tuner.offline.hosts import FILE_NAME, keep_alive
from mobo_tuner.offline.simulation import Outcome, Simulation

_POLL = 0.2  # [s] between two looks for the campaign


def join(folder: Path, patience: float) -> Connection:
    """Join the campaign of a folder.

    Args:
        folder: Folder of the run.
        patience: Longest wait for the campaign [s].

    Raises:
        ParameterError: If there is none that can be joined.
    """
    deadline = time.monotonic() + patience
    while True:
        try:
            place = json.loads((folder / FILE_NAME).read_text())
            connected = socket.create_connection((place["host"], place["port"]), timeout=10.0)
            keep_alive(connected)
            campaign = Connection(connected.detach())
            answer_challenge(campaign, bytes.fromhex(place["key"]))
            deliver_challenge(campaign, bytes.fromhex(place["key"]))
        except (OSError, EOFError, ValueError, KeyError, AuthenticationError) as error:
            if time.monotonic() > deadline:
                raise ParameterError(
                    f"no campaign in '{folder}' could be joined within {patience:g} s ({error!r:.200})"
                ) from None
            time.sleep(_POLL)
        else:
            return campaign


Evaluate = Callable[[int, Mapping[str, float]], Outcome | None]
"""Evaluates a point by its number; None gives it back, for another worker."""


class Work(Protocol):
    """What a worker does."""

    def begin(self, task: Mapping[str, Any]) -> Evaluate:
        """Take on the task of a campaign: `command`, `timeout` and `problem`."""

    def stop(self) -> None:
        """End what is being evaluated."""


class Simulations:
    """Work that runs the campaign's command.

    Args:
        folder: Folder of the run.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder / "simulations"
        self._simulation: Simulation | None = None

    def begin(self, task: Mapping[str, Any]) -> Evaluate:
        """Take on the task of a campaign.

        Raises:
            ParameterError: If its command cannot be run on this host.
        """
        self._simulation = Simulation(task["command"], task["timeout"], self._folder)
        return self._simulation.run

    def stop(self) -> None:
        """End the simulation."""
        if self._simulation is not None:
            self._simulation.stop()


def serve(campaign: Connection, work: Work) -> bool:
    """Evaluate the points that a campaign sends, until it ends or a point is given back.

    Args:
        campaign: Connection to it.
        work: What evaluates.

    Returns:
        Whether the campaign has ended.

    Raises:
        UserError: If the work cannot begin.
    """
    evaluate = work.begin(json.loads(_receive(campaign)))
    given_back = threading.Event()

    def answer(message: bytes) -> None:
        point, outcome = json.loads(message), None
        try:
            outcome = evaluate(point["number"], point["point"])
        finally:
            if outcome is None:
                given_back.set()
            with contextlib.suppress(OSError):  # it has ended in between
                text = json.dumps(None if outcome is None else outcome._asdict())
                campaign.send_bytes(text.encode())

    try:
        while True:  # an evaluation does not keep the end of the campaign from being seen
            message = _receive(campaign)
            threading.Thread(target=answer, args=(message,), daemon=True).start()
    except (EOFError, OSError):
        return not given_back.is_set()
    finally:
        work.stop()


def _receive(campaign: Connection) -> bytes:
    """Return the next message, whenever it comes; a lost host is noticed by the kernel."""
    while not campaign.poll(60.0):
        continue
    return campaign.recv_bytes()


def seconds(text: str) -> float:
    """Return the duration [s] that an option gives.

    Raises:
        argparse.ArgumentTypeError: If it is not a number of at least 0.
    """
    with contextlib.suppress(ValueError):
        duration = float(text)
        if duration >= 0.0:
            return duration
    raise argparse.ArgumentTypeError(f"{text!r} is not a number of at least 0")


def main(arguments: Sequence[str] | None = None) -> int:
    """Work for one campaign; return the exit status."""
    parser = argparse.ArgumentParser(
        prog="mobo_tuner.offline.worker", description="A worker of a campaign on several hosts."
    )
    parser.add_argument("folder", type=Path, help="folder of the campaign's run")
    parser.add_argument(
        "--patience", type=seconds, default=300.0, help="longest wait for the campaign [s]"
    )
    options = parser.parse_args(arguments)
    try:
        with join(options.folder, options.patience) as campaign:
            serve(campaign, Simulations(options.folder))
    except (ParameterError, EOFError, OSError) as error:
        print(error, file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())

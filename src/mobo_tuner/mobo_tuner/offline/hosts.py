"""Simulations on other hosts: workers there join a campaign over TCP and simulate its points.

The campaign writes into its folder, which all hosts share, where its workers find it and a secret by which
both sides prove to each other that they know the folder (`multiprocessing.connection`). A worker
(`worker.py`) may join at any time and may be lost at any time: what it simulated is then simulated by another.
All messages are JSON: the campaign's task to a new worker, then points and outcomes, or null from a worker that
gives a point back.
"""

from __future__ import annotations

import contextlib
import json
import os
import queue
import secrets
import socket
import struct
import threading
import time
from collections.abc import Mapping
from multiprocessing import AuthenticationError
from multiprocessing.connection import Connection, answer_challenge, deliver_challenge
from pathlib import Path
from typing import Any

from mobo_tuner.errors import ParameterError
from mobo_tuner.offline.simulation import Outcome

FILE_NAME = "workers.json"
_MOST_TRIES = 3  # workers that are lost with a point before it counts as failed
_GRACE = 30.0  # [s] beside its timeout in which a simulation is answered
_POLL = 1.0  # [s] after which a thread looks whether it shall end
_HANDSHAKE = 10  # [s]
_BACKLOG = 1024  # workers that knock at the same time


class Hosts:
    """What simulates the points of a campaign: workers on any hosts, in place of `Simulation`.

    Args:
        address: Address of this host that the others reach; they find the port in the folder.
        task: What workers are told: `command`, `timeout` [s] and `problem`, which can become JSON.
        folder: Folder of the run, which all hosts share.

    Raises:
        ParameterError: If this host does not have the address.
    """

    def __init__(self, address: str, task: Mapping[str, Any], folder: Path) -> None:
        self._timeout = float(task["timeout"])
        self._welcome = json.dumps(task).encode()
        self._key = secrets.token_bytes(32)
        self._idle: queue.SimpleQueue[Connection] = queue.SimpleQueue()
        self._stopped = threading.Event()
        try:
            self._socket = socket.create_server((address, 0), backlog=_BACKLOG)
        except OSError as error:
            raise ParameterError(
                f"listen is {address!r:.80}; an address of this host is allowed ({error})"
            ) from None
        self._socket.settimeout(_POLL)
        place = {"host": address, "port": self._socket.getsockname()[1], "key": self._key.hex()}
        self._file = folder / FILE_NAME
        with open(os.open(self._file, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w") as file:
            json.dump(place, file)
        threading.Thread(target=self._listen, name="hosts", daemon=True).start()

    def run(self, number: int, point: Mapping[str, float]) -> Outcome:
        """Simulate a point on one of the workers, waiting for one that is idle; see `Simulation.run`."""
        begun, tries = time.monotonic(), 0
        message = json.dumps({"number": number, "point": dict(point)}).encode()
        while tries < _MOST_TRIES:
            if self._stopped.is_set():
                return Outcome({}, time.monotonic() - begun, "the campaign was stopped")
            try:
                worker = self._idle.get(timeout=_POLL)
            except queue.Empty:
                continue
            try:
                if worker.poll():  # only the end of one that is idle can be read
                    raise EOFError
                begun, tries = time.monotonic(), tries + 1
                worker.send_bytes(message)
                outcome = self._answer(worker)
            except (OSError, EOFError, ValueError, TypeError):
                worker.close()
                continue
            self._idle.put(worker)
            return outcome
        seconds = time.monotonic() - begun
        return Outcome({}, seconds, f"{_MOST_TRIES} workers were lost while they simulated it")

    def stop(self) -> None:
        """Let the workers go, which end then; those that simulate end with this process."""
        self._stopped.set()
        self._socket.close()
        self._file.unlink(missing_ok=True)
        with contextlib.suppress(queue.Empty):
            while True:
                self._idle.get_nowait().close()

    def _answer(self, worker: Connection) -> Outcome:
        """Return the outcome that a worker sends.

        Raises:
            OSError, EOFError, ValueError, TypeError: If it is lost, too late or nonsense.
        """
        deadline = time.monotonic() + self._timeout + _GRACE
        while not worker.poll(_POLL):
            if self._stopped.is_set() or time.monotonic() > deadline:
                raise EOFError
        outcome: dict[str, Any] = json.loads(worker.recv_bytes())
        return Outcome(**outcome)

    def _listen(self) -> None:
        """Let workers in until the end."""
        while not self._stopped.is_set():
            with contextlib.suppress(OSError):  # nobody knocked, or this is the end
                knocking, _ = self._socket.accept()
                threading.Thread(target=self._let_in, args=(knocking,), daemon=True).start()

    def _let_in(self, knocking: socket.socket) -> None:
        """Let a worker in that knows the secret."""
        keep_alive(knocking)
        worker = Connection(knocking.detach())
        try:
            deliver_challenge(worker, self._key)
            answer_challenge(worker, self._key)
            worker.send_bytes(self._welcome)
        except (OSError, EOFError, AuthenticationError):
            worker.close()
        else:
            self._idle.put(worker)


def keep_alive(connected: socket.socket) -> None:
    """Let the kernel notice within a minute that the other host is gone, and limit the wait for a message."""
    connected.setblocking(True)
    connected.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, struct.pack("ll", _HANDSHAKE, 0))
    connected.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    for option, value in (("TCP_KEEPIDLE", 30), ("TCP_KEEPINTVL", 10), ("TCP_KEEPCNT", 3)):
        if hasattr(socket, option):  # of Linux
            connected.setsockopt(socket.IPPROTO_TCP, getattr(socket, option), value)

"""Runs of `mobo.py` as a user starts them, and independent readers of what they leave."""

from __future__ import annotations

import contextlib
import subprocess
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from mobo_tuner.runs.journal import FILE_NAME, read_journal

ROOT = Path(__file__).resolve().parents[2]
TIMEOUT = 60.0  # [s] for anything but a whole run


@dataclass
class Run:
    """A run of mobo.py in a folder of its own."""

    process: subprocess.Popen[str]
    runs_dir: Path
    run_id: str

    @property
    def folder(self) -> Path:
        return self.runs_dir / self.run_id

    def wait(self, timeout: float = 150.0) -> tuple[int, str, str]:
        """Exit status, standard output and standard error."""
        out, err = self.process.communicate(timeout=timeout)
        return self.process.returncode, out, err

    def journal(self) -> list[dict[str, Any]]:
        return read_journal(self.folder) if (self.folder / FILE_NAME).exists() else []

    def evaluations(self) -> list[dict[str, Any]]:
        return [r for r in self.journal() if r["type"] == "evaluation"]

    def processes(self) -> dict[int, str]:
        """Command lines of all processes that know of this run, but for mobo.py itself."""
        found = {}
        for path in Path("/proc").glob("[0-9]*/cmdline"):
            with contextlib.suppress(OSError):
                words = path.read_bytes().replace(b"\0", b" ").decode(errors="replace")
                if str(self.folder) in words and int(path.parent.name) != self.process.pid:
                    found[int(path.parent.name)] = words
        return found

    def node(self, module: str) -> int:
        """Process id of one of its nodes."""
        [pid] = [pid for pid, words in self.processes().items() if module in words]
        return pid

    def until(
        self,
        condition: Callable[[], object],
        what: str,
        timeout: float = TIMEOUT,
        period: float = 0.05,
    ) -> None:
        deadline = time.monotonic() + timeout
        while not condition():
            if self.process.poll() is not None:
                pytest.fail(f"the run ended before {what}: {self.wait()}")
            if time.monotonic() > deadline:
                pytest.fail(f"waited {timeout:g} s in vain for {what}")
            time.sleep(period)

    def assert_nothing_left(self, timeout: float = 2.0) -> None:
        deadline = time.monotonic() + timeout
        while self.processes() and time.monotonic() < deadline:
            time.sleep(0.02)
        assert self.processes() == {}


def mcap_messages(bag: Path, topic: str) -> list[Any]:
    """All messages of a topic, read by the mcap libraries."""
    [file] = bag.glob("*.mcap")
    with file.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        return [decoded for *_, decoded in reader.iter_decoded_messages(topics=[topic])]


def rosbags_count(bag: Path, topic: str) -> int:
    with AnyReader([bag]) as reader:
        wanted = [c for c in reader.connections if c.topic == topic]
        return sum(1 for _ in reader.messages(connections=wanted)) if wanted else 0

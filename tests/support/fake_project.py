"""A project folder with the real entry script and, in place of the nodes, programs that play them.

The programs are real processes: what they do at which signal is what the tests are about.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path

from launcher.environment import (
    DEVELOPMENT_STAGES,
    LIVE_STAGES,
    OFFLINE_STAGES,
    PAGE_STAGES,
    STAGES,
    Environment,
)

ROOT = Path(__file__).resolve().parents[2]
TIMEOUT = 20.0  # [s] for anything to happen

PLAYER = """
import json, os, shutil, signal, subprocess, sys, time
module = sys.argv[sys.argv.index("-m") + 1]
name = module.rpartition(".")[2]
name = {"node": "machine", "machine_bridge": "machine"}.get(name, name)
behaviour = os.environ.get(f"PLAY_{name.upper()}", "")

def note(text):
    with open(os.environ["PLAY_EVENTS"], "a") as file:
        file.write(f"{name} {text}\\n")

def ready_file(node):  # of this run: another run's nodes may have been ready before
    return os.path.join(os.environ["ROS_LOG_DIR"], f"{node}.ready")

def events():
    with open(os.environ["PLAY_EVENTS"]) as file:
        return file.read()

def stop(number, frame):
    again = any(event == f"{name} stopping" for event in events().splitlines())
    note("stopping again" if again else "stopping")
    if behaviour == "slow":
        time.sleep(0.7)
    if behaviour == "goes back" and not again:
        time.sleep(2.5)
    note("stopped")
    sys.exit(4 if behaviour == "ends badly" else 0)

signal.signal(signal.SIGINT, signal.SIG_IGN if behaviour == "stubborn" else stop)
signal.signal(signal.SIGTERM, signal.SIG_IGN if behaviour == "stubborn" else stop)
if name == "steer":
    names = ("ROS_DOMAIN_ID", "ROS_AUTOMATIC_DISCOVERY_RANGE")
    print(json.dumps([sys.argv[sys.argv.index("-m") + 2 :], *map(os.environ.get, names)]))
    sys.exit(1 if behaviour == "refuse" else 0)
note(f"started {os.getpid()}")
if name == "resume_config":
    run_folder, out, *options = sys.argv[sys.argv.index(module) + 1 :]
    config = options[1] if options else os.path.join(run_folder, "config.yaml")
    shutil.copy(config, out)
    sys.exit(0)
with open(f"{os.environ['PLAY_EVENTS']}.{name}", "w") as file:
    json.dump(sys.argv[1:], file)
if name == "check_config":
    if behaviour == "refuse":
        sys.exit("reference of eps_x is 1.0; it must lie in its truncation box")
    program = [word for word in sys.argv if word.startswith("--program=")]
    section = "" if program or behaviour == "external" else "awa_sim"
    [copies] = [word.partition("=")[2] for word in sys.argv if word.startswith("--copy-to=")]
    config = next(word for word in sys.argv if word.endswith(".yaml"))
    shutil.copy(config, os.path.join(copies, "config.yaml"))
    on_abort = "restore" if behaviour == "restore" else "hold"
    print(json.dumps({"section": section, "files": [], "on_abort": on_abort}))
    sys.exit(0)
if name == "pytest":
    print(*sys.argv[sys.argv.index("-m") + 2 :], os.environ.get("PYTHONPATH"))
    if behaviour == "wait":
        time.sleep(60)
    sys.exit(5)
if name == "report":
    if behaviour == "crash":
        sys.exit("the journal is damaged")
    print("the front")
    sys.exit(0)
if behaviour == "crash":
    print("one", "two", "the magnet quenched", sep="\\n", file=sys.stderr)
    sys.exit(3)
if name == "campaign":
    with open(os.path.join(sys.argv[sys.argv.index(module) + 1], "journal.jsonl"), "w") as file:
        file.write("{}\\n")
    note("ready")
    if behaviour == "wait":
        time.sleep(60)
    sys.exit("the klystron tripped" if behaviour == "fail" else 0)
if behaviour == "family":
    child = [sys.executable, "-c", "import time; time.sleep(60)"]
    note(f"started {subprocess.Popen(child, start_new_session=True).pid}")
if name == "console":
    with open("journal.jsonl", "w") as file:
        file.write("{}\\n")
    print("tuning")
    # a page that plays a part is waited for too: before it is ready a signal ends it without a word
    nodes = ("tuner", "recorder", *(("page",) if os.environ.get("PLAY_PAGE") in ("wait", "ends badly") else ()))
    for _ in range(600):
        if all(os.path.exists(ready_file(node)) for node in nodes):
            break
        time.sleep(0.05)
    note("ready")
    if behaviour == "fail":
        sys.exit("[INFO] something\\nthe machine refused evaluation 3")
    if behaviour == "canceled":
        sys.exit(130)
    while behaviour == "outlives" and "recorder dies" not in events():
        time.sleep(0.05)
    if behaviour not in ("wait", "stubborn", "goes back"):
        time.sleep(0.3 if behaviour == "outlives" else 0.0)
        sys.exit(0)
note("ready")
if "ROS_LOG_DIR" in os.environ:
    open(ready_file(name), "w").close()
if behaviour == "dies":
    while "console ready" not in events():
        time.sleep(0.05)
    note("dies")
    os.kill(os.getpid(), signal.SIGKILL)
for _ in range(600):
    time.sleep(0.1)
"""


class FakeProject:
    """A temporary project folder; its `.venv` is fresh as far as the entry script can tell."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.events_file = root / "events"
        self.events_file.touch()
        self._started: list[subprocess.Popen[str]] = []
        shutil.copy(ROOT / "mobo.py", root)
        shutil.copytree(ROOT / "launcher", root / "launcher")
        (root / "config").mkdir()
        (root / "config" / "awa.yaml").write_text("/**: {}\n")
        stages = (*STAGES, *PAGE_STAGES, *LIVE_STAGES, *OFFLINE_STAGES, *DEVELOPMENT_STAGES)
        for source in {source for stage in stages for source in stage.sources}:
            (root / source).mkdir(parents=True) if "/" in source else (root / source).touch()
        player = root / "player.py"
        player.write_text(PLAYER)
        environment = Environment(root, stages)
        environment.python.parent.mkdir(parents=True)
        environment.python.write_text(f'#!/bin/sh\nexec "{sys.executable}" "{player}" "$@"\n')
        environment.python.chmod(0o755)
        for stage in stages:
            environment.mark_done(stage, environment.fingerprint(stage))

    def start(
        self,
        *arguments: str,
        folder: Path | None = None,
        variables: Mapping[str, str] | None = None,
        **behaviour: str,
    ) -> subprocess.Popen[str]:
        """Start the entry script; keywords say how programs behave, e.g. machine='crash'."""
        plays = {f"PLAY_{name.upper()}": value for name, value in behaviour.items()}
        process = subprocess.Popen(
            [sys.executable, str(self.root / "mobo.py"), *arguments],
            env={
                **os.environ,
                "PLAY_EVENTS": str(self.events_file),
                **plays,
                **(variables or {}),
            },
            cwd=folder,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        self._started.append(process)
        return process

    def run(
        self,
        *arguments: str,
        folder: Path | None = None,
        variables: Mapping[str, str] | None = None,
        **behaviour: str,
    ) -> tuple[int, str, str]:
        """Run the entry script to its end: exit status, output, errors."""
        process = self.start(*arguments, folder=folder, variables=variables, **behaviour)
        output, errors = process.communicate(timeout=TIMEOUT)
        return process.returncode, output, errors

    @property
    def events(self) -> list[str]:
        """What the programs did, in order."""
        return self.events_file.read_text().splitlines()

    def arguments(self, name: str) -> list[str]:
        """Arguments with which a program was started last."""
        words: list[str] = json.loads(Path(f"{self.events_file}.{name}").read_text())
        return words

    def wait_for_event(self, *events: str) -> None:
        """Wait until all of the events have happened."""
        wait_until(lambda: set(events) <= set(self.events), f"{events} in {self.events}")

    def alive(self) -> list[str]:
        """The programs that are still running."""
        starts = [event.split() for event in self.events if " started " in event]
        return [name for name, _, pid in starts if _is_alive(int(pid))]

    def close(self) -> None:
        """End the entry scripts that a failed test left behind; their watchdogs do the rest."""
        for process in self._started:
            process.kill()
            process.communicate(timeout=TIMEOUT)


def wait_until(condition: Callable[[], bool], what: str) -> None:
    """Wait until a condition holds; fail the test if it does not in time."""
    deadline = time.monotonic() + TIMEOUT
    while not condition():
        assert time.monotonic() < deadline, f"still waiting for {what}"
        time.sleep(0.02)


def _is_alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False

"""Kill the manager and the simulations of a campaign at random moments, and look for lost evaluations.

A campaign of the toy problem with four workers is carried out by real processes. Again and again, after one to five
further evaluations, either its manager or one of its simulations is killed (SIGKILL). After a manager, the next process
continues from the run's folder alone. Counted at each kill of a manager: evaluations of the journal that the next run's
journal lacks or changes; and simulations that had ended half a second before the kill but are in no journal. A killed
simulation must be a failed evaluation, and the campaign must go on.

    python -m robustness.killed_campaign --kills 40 --seed 1
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from mobo_tuner.runs.journal import FILE_NAME
from robustness.two_hosts import evaluations

_WORKERS = 4
_TIMEOUT = 120.0  # [s] for the next evaluations
_SETTLED = 0.5  # [s] after its end in which a simulation may not be in the journal yet
_MANAGERS = 0.5  # share of the kills
# A simulation that takes as long as it says: how long is part of what is tried.
_PROGRAM = """
import json, math, random, sys, time
x = json.load(sys.stdin)
time.sleep(random.uniform(0.05, 0.6))  # the duration of a simulation
outputs = {"f1": math.hypot(x["x1"] - 1, x["x2"] - 1), "f2": math.hypot(x["x1"] + 1, x["x2"] + 1)}
with open("ended", "w") as file:
    json.dump({"point": x, "time": time.time()}, file)
print(json.dumps(outputs))
"""


class KilledCampaign:
    """A campaign in a folder of its own, and what its kills came to.

    Args:
        folder: Folder.
        seed: Seed of the campaign and the kills.

    Attributes:
        lost: Finished evaluations that were lost or changed.
        survived: Killed simulations that are no failed evaluation.
    """

    def __init__(self, folder: Path, seed: int) -> None:
        self._folder = folder
        self._rng = np.random.default_rng(seed)
        self._seed = seed
        self._number = 0
        self.lost = 0
        self.survived = 0
        bounds = {"min": -2.0, "max": 2.0}
        sections = {
            "/**": {
                "variables": {"x1": bounds, "x2": bounds},
                "objectives": {"f1": {"reference": 4.3}, "f2": {"reference": 4.3}},
            },
            "tuner": {"evaluations": 100_000},
            "campaign": {"command": f"python {folder / 'program.py'}", "workers": _WORKERS},
        }
        (folder / "program.py").write_text(_PROGRAM)
        content = {name: {"ros__parameters": section} for name, section in sections.items()}
        (folder / "campaign.yaml").write_text(yaml.safe_dump(content))
        self._process = self._start("--config", folder / "campaign.yaml", "--seed", seed)

    def _start(self, *arguments: object) -> subprocess.Popen[bytes]:
        words = [sys.executable, "-m", "mobo_tuner.offline.campaign", self._run, *arguments]
        return subprocess.Popen([str(word) for word in words], stdout=subprocess.DEVNULL)

    @property
    def _run(self) -> Path:
        return self._folder / f"run-{self._number}"

    def evaluations(self) -> list[dict[str, Any]]:
        """Return the evaluations in the journal so far."""
        return evaluations(self._run / FILE_NAME)

    def wait(self, count: int) -> None:
        """Wait until there are so many evaluations.

        Raises:
            RuntimeError: If the campaign ended or hangs.
        """
        deadline = time.monotonic() + _TIMEOUT
        while len(self.evaluations()) < count:
            if self._process.poll() is not None or time.monotonic() > deadline:
                raise RuntimeError(f"no further evaluation after {len(self.evaluations())}")
            time.sleep(0.02)  # between two looks, until the deadline

    def kill(self) -> str:
        """Let some evaluations be made, and kill something; return what it was."""
        self.wait(len(self.evaluations()) + int(self._rng.integers(1, 6)))
        time.sleep(float(self._rng.uniform(0.0, 0.3)))  # a random moment
        if self._rng.random() < _MANAGERS:
            self._kill_manager()
            return "manager"
        return "simulation" if self._kill_simulation() else "nothing"

    def _kill_manager(self) -> None:
        killed = time.time()
        self._process.kill()
        self._process.wait(_TIMEOUT)
        before, ended = self.evaluations(), self._ended(killed - _SETTLED)
        told = [tuple(e["setpoint"].values()) for e in before]
        self.lost += sum(point not in told for point in ended)
        earlier, self._number = self._run, self._number + 1
        self._process = self._start("--resume", earlier)
        self.wait(len(before) + 1)
        now = self.evaluations()[: len(before)]
        self.lost += sum(a != b for a, b in zip(before, now, strict=True))

    def _kill_simulation(self) -> bool:
        """Kill one of the simulations that run, if there is one."""
        words = ["pgrep", "-P", str(self._process.pid)]
        found = subprocess.run(words, capture_output=True, text=True, timeout=10, check=False)
        for child in map(int, found.stdout.split()):
            try:
                number = Path(os.readlink(f"/proc/{child}/cwd"))
                if number.parent.name != "simulations":  # the watchdog
                    continue
                os.kill(child, signal.SIGKILL)
            except OSError:  # it has ended
                continue
            if not (number / "ended").exists():
                before = len(self.evaluations())
                self.wait(before + _WORKERS)
                failed = [e for e in self.evaluations()[before - 1 :] if not e["valid"]]
                self.survived += not failed
            return True
        return False

    def _ended(self, before: float) -> list[tuple[float, ...]]:
        """Return the set-points of this run's simulations that had ended before a time."""
        points = []
        for path in self._run.glob("simulations/*/ended"):
            ended = json.loads(path.read_text() or "{}")
            if ended and ended["time"] < before:
                points.append(tuple(ended["point"].values()))
        return points

    def close(self) -> None:
        """End the campaign."""
        self._process.terminate()
        self._process.wait(_TIMEOUT)


def main() -> int:
    """Kill so many times, and print what was lost."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--kills", type=int, default=100, metavar="N", help="number of kills")
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="seed of the kills")
    options = parser.parse_args()
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    killed = dict.fromkeys(("manager", "simulation", "nothing"), 0)
    with tempfile.TemporaryDirectory() as scratch:
        campaign = KilledCampaign(Path(scratch), options.seed)
        try:
            while killed["manager"] + killed["simulation"] < options.kills:
                killed[campaign.kill()] += 1
            made = len(campaign.evaluations())
        finally:
            campaign.close()
    print(
        f"{killed['manager']} managers and {killed['simulation']} simulations killed, {made} evaluations: "
        f"{campaign.lost} finished ones lost, {campaign.survived} killed ones not failed"
    )
    return 1 if campaign.lost or campaign.survived else 0


if __name__ == "__main__":
    sys.exit(main())

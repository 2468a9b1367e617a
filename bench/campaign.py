"""What the manager of a campaign takes for an evaluation, with a thousand workers that only wait.

The campaign is that of `mobo.py campaign`, in the loop of libEnsemble, with its journal and its saved state, on the
toy problem. Only its simulations are acted: each worker sleeps for a random time around the given one and then
returns the outputs. Printed for each evaluation: its share of the time of a suggestion, whose models expect all that
is pending; the time to learn it, to write its journal and to save the state; and the CPU time of all the rest, the
loop of libEnsemble and its workers, which is only known as a whole. CPU times do not depend on what else the computer
does. While one batch is suggested, other simulations end: the next batch is for all of these.

    python -m bench.campaign --workers 1000 --evaluations 1500 --seconds 40
"""

from __future__ import annotations

import argparse
import math
import os
import random
import tempfile
import threading
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from unittest.mock import patch

import numpy as np
import yaml

from mobo_tuner.offline import campaign
from mobo_tuner.offline.simulation import Outcome

_BOUNDS = {"min": -2.0, "max": 2.0}
_CONTENT = {
    "/**": {
        "ros__parameters": {
            "variables": {"x1": _BOUNDS, "x2": _BOUNDS},
            "objectives": {"f1": {"reference": 4.3}, "f2": {"reference": 4.3}},
        }
    },
    "campaign": {"ros__parameters": {"command": "true"}},
}


class ActedSimulation:
    """The toy problem, after a sleep.

    Args:
        seconds: Mean duration [s]; each is between half and one and a half of it.
    """

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds
        self._stopped = threading.Event()

    def run(self, number: int, point: Mapping[str, float]) -> Outcome:
        """Simulate a point."""
        seconds = self._seconds * random.Random(number).uniform(0.5, 1.5)
        self._stopped.wait(seconds)
        x1, x2 = point["x1"], point["x2"]
        return Outcome(
            {"f1": math.hypot(x1 - 1, x2 - 1), "f2": math.hypot(x1 + 1, x2 + 1)}, seconds, ""
        )

    def stop(self) -> None:
        """End all simulations."""
        self._stopped.set()


class Call(NamedTuple):
    """Number of evaluations in one call of the generator, its CPU time and its wall time [s]."""

    number: int
    cpu: float
    wall: float


class TimedCampaign(campaign.Campaign):
    """A campaign that notes its times.

    Attributes:
        timed: The last one that was made.
        suggested: Calls that suggested points.
        learned: Calls that learned results.
    """

    timed: TimedCampaign

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        TimedCampaign.timed = self
        self.suggested: list[Call] = []
        self.learned: list[Call] = []

    def suggest(self, num_points: int | None = None) -> list[dict[str, Any]]:
        """Return points to simulate."""
        wall, cpu = time.perf_counter(), time.thread_time()
        points = super().suggest(num_points)
        cpu, wall = time.thread_time() - cpu, time.perf_counter() - wall
        self.suggested.append(Call(len(points), cpu, wall))
        return points

    def ingest(self, results: Sequence[Mapping[str, Any]]) -> None:
        """Learn results."""
        wall, cpu = time.perf_counter(), time.thread_time()
        super().ingest(results)
        cpu, wall = time.thread_time() - cpu, time.perf_counter() - wall
        self.learned.append(Call(len(results), cpu, wall))


def report(name: str, calls: Sequence[Call]) -> None:
    """Print a row: the times of an evaluation, and how many there were in a call.

    Args:
        name: First column.
        calls: Calls of the generator.
    """
    counts = np.array([call.number for call in calls])
    columns = []
    for seconds in ([call.cpu for call in calls], [call.wall for call in calls]):
        each = 1e3 * np.repeat(np.array(seconds) / np.maximum(counts, 1), counts)
        columns += [np.median(each), each.max(), each.mean()]
    print(
        f"{name:16s}"
        + "".join(f"{column:9.2f}" for column in columns)
        + f"{np.median(counts):9.0f}{counts.max():8d}"
    )


def main() -> None:
    """Carry out a campaign, and print its times."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--workers", type=int, default=1000, help="number of workers")
    parser.add_argument("--evaluations", type=int, default=1500, help="number of evaluations")
    parser.add_argument("--seconds", type=float, default=40.0, help="time of a simulation [s]")
    parser.add_argument("--seed", type=int, default=0, help="seed of the optimiser")
    options = parser.parse_args()
    given = {name: getattr(options, name) for name in ("workers", "evaluations", "seed")}
    timing = patch.object(campaign, "Campaign", TimedCampaign)  # which `run` makes
    with timing, tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "run"
        config = Path(scratch) / "campaign.yaml"
        config.write_text(yaml.safe_dump(_CONTENT))
        begun = campaign.start(config, folder, given)
        wall, cpu = time.perf_counter(), time.process_time()
        campaign.run(begun, ActedSimulation(options.seconds))
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    timed = TimedCampaign.timed
    print(
        f"{options.evaluations} evaluations by {options.workers} workers in {wall:.0f} s, "
        f"load {os.getloadavg()[0]:.1f}; hypervolume {begun.optimizer.hypervolume:.3f}"
    )
    print("ms of each       CPU med.     max     mean wall med.     max     mean at once     most")
    report("first batch", timed.suggested[:1])
    report("suggested", timed.suggested[1:])
    report("learned", timed.learned)
    rest = cpu - sum(call.cpu for call in (*timed.suggested, *timed.learned))
    print(f"{'loop':34s}{1e3 * rest / options.evaluations:9.2f}  ({rest / wall:.2f} of a core)")


if __name__ == "__main__":
    main()

"""A day of the simulated machine: three shifts with drift, trips and interlocks, handed from one to the next.

The machine runs `--speed` times as fast as real time in the mode `rough`; everything else, such as suggestions and
journals, takes its real time. So a day has fewer evaluations than on a real machine, in which the machine
needs most of the time. In each shift an operator makes runs one after the other, clears interlocks, goes to the
best point and holds it. At a change of shifts the run is stopped, the tuner and the recorder end and start again, and
the last run is resumed. Prints one line for each simulated hour. Exits with 1 if a run is lost or damaged, an answer
fails, a node ends or has a traceback, or the memory of a node grows by more than `GROWTH` after its first hour.
"""

from __future__ import annotations

import argparse
import itertools
import os
import signal
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from std_srvs.srv import Trigger

from launcher.ros_domain import RosDomain
from mobo_tuner.client import RunResult, Status, TunerClient, TunerError
from mobo_tuner.ros.executor_thread import ExecutorThread
from mobo_tuner.runs.history import History
from mobo_tuner.runs.journal import read_journal
from robustness.integrity import bag_faults
from robustness.processes import NodeProcess, NodeStarter

CONFIG = Path(__file__).parents[1] / "config" / "awa.yaml"
SHIFTS = 3
EVALUATIONS = 40  # of a run
HELD = 3  # evaluations that hold a point
GROWTH = 0.25  # allowed growth of a tuner's memory in a shift, as a fraction
TIMEOUT = 60.0  # [s] for nodes to be there, and to answer
TUNER = ("drift:=auto", "initial_evaluations:=16", "on_abort:=restore", "acquisition:=ucb_hvi")


class Operator:
    """An operator of the machine, who clears its interlocks and counts what was seen.

    Attributes:
        interlocks: Number of interlocks that were cleared.
        waits: Reasons of waits that were seen.
    """

    def __init__(self) -> None:
        self._context = Context()
        rclpy.init(context=self._context)
        self._node = Node("operator", context=self._context)
        executor = SingleThreadedExecutor(context=self._context)
        executor.add_node(self._node)
        self._client = self._node.create_client(Trigger, "clear_interlock")
        self._thread = ExecutorThread(executor, spin=True)
        self.interlocks = 0
        self.waits: set[str] = set()

    def look(self, status: Status) -> None:
        """Look at a status, and clear the interlock that it names."""
        if status.state == "waiting" and status.message:
            self.waits.add(status.message.partition(";")[0])
        if "interlock" in status.message:
            self.interlocks += 1
            self._thread.start(lambda: self._client.call_async(Trigger.Request())).result(TIMEOUT)

    def close(self) -> None:
        """Release everything."""
        self._thread.close()
        self._node.destroy_node()
        self._context.try_shutdown()


class Day:
    """The nodes and the runs of a day.

    Args:
        folder: Folder of its files.
        speed: Simulated seconds per second.
        hours: Length of the day in simulated time [h].

    Attributes:
        faults: What must not have happened, one sentence each.
    """

    def __init__(self, folder: Path, speed: float, hours: float) -> None:
        self._start_node = NodeStarter(folder)
        self._folder = folder
        self._speed = speed
        self._hours = hours
        self._began = time.monotonic()
        self._operator = Operator()
        self._results: list[RunResult] = []
        self._evaluations = self._failed = 0
        self._hour = 0
        self.faults: list[str] = []

    @property
    def now(self) -> float:
        """Simulated time since the beginning [h]."""
        return (time.monotonic() - self._began) * self._speed / 3600.0

    def live(self) -> None:
        """Live through the day."""
        speed = ("-p", f"awa_sim:speed:={self._speed}", "-p", "awa_sim:mode:=rough")
        machine = self._node("awa_sim_node.node", "--params-file", str(CONFIG), *speed)
        try:
            for shift in range(SHIFTS):
                end = self._hours * (shift + 1) / SHIFTS
                with self._nodes(shift) as tuner, TunerClient(timeout=TIMEOUT) as client:
                    self._shift(client, tuner, end)
        finally:
            for process in self._start_node.processes:
                process.kill()
            self._operator.close()
        if "Traceback" in machine.stderr:
            self.faults.append(f"the machine had an error: {machine.stderr[-500:]}")

    def _node(self, module: str, *words: str) -> NodeProcess:
        return self._start_node("-m", module, "--ros-args", *words)

    @contextmanager
    def _nodes(self, shift: int) -> Iterator[NodeProcess]:
        """Have a tuner and a recorder for one shift; check how they end, and what they leave."""
        runs, bag = self._folder / "runs", self._folder / f"bag-{shift}"
        options = (f"runs_dir:={runs}", f"seed:={shift}", *TUNER)
        words = [word for text in options for word in ("-p", f"tuner:{text}")]
        tuner = self._node("mobo_tuner.nodes.tuner", "--params-file", str(CONFIG), *words)
        recorder = self._node("mobo_tuner.nodes.recorder", "-p", f"bag_path:={bag}")
        first = len(self._results)
        yield tuner
        for name, process in (("tuner", tuner), ("recorder", recorder)):
            if not process.running or process.stop(signal.SIGINT, 15.0) != 0:
                self.faults.append(
                    f"the {name} of shift {shift} ended badly: {process.stderr[-500:]}"
                )
            if "Traceback" in process.stderr:
                self.faults.append(
                    f"the {name} of shift {shift} had an error: {process.stderr[-500:]}"
                )
        recorded = [result.run_id for result in self._results[first:]]
        self.faults += bag_faults(bag, runs, recorded)

    def _shift(self, client: TunerClient, tuner: NodeProcess, end: float) -> None:
        client.connect(TIMEOUT)
        memory = 0.0
        for number in itertools.count():
            earlier = self._results[-1] if self._results and number == 0 else None
            self._run(client, earlier, end)
            if number == 1:
                memory = _memory(tuner)
            if self.now >= end:
                break
            self._hold(client)
        if memory and (growth := _memory(tuner) / memory - 1.0) > GROWTH:
            self.faults.append(f"the memory of the tuner grew by {100.0 * growth:.0f} %")

    def _run(self, client: TunerClient, earlier: RunResult | None, end: float) -> None:
        """Make one run, or resume one; it is stopped if the shift ends meanwhile."""
        stopped = False

        def look(status: Status) -> None:
            nonlocal stopped
            self._operator.look(status)
            self._tell_hour()
            if self.now >= end and not stopped and status.evaluations:
                stopped = True
                client.stop()

        before = earlier.evaluations if earlier else 0
        result = client.tune(
            evaluations=before + EVALUATIONS,
            resume_from=earlier.run_id if earlier else "",
            on_status=look,
        )
        self._results.append(result)
        history = History.from_records(read_journal(self._folder / "runs" / result.run_id))
        made = history.evaluations[before:]
        self._evaluations += len(made)
        self._failed += sum(not record.valid for record in made)
        if result.error is not None:
            self.faults.append(f"run {result.run_id} failed: {result.error}")
        if len(history.evaluations) != result.evaluations:
            self.faults.append(
                f"{len(history.evaluations)} of {result.evaluations} evaluations of {result.run_id} are kept"
            )

    def _hold(self, client: TunerClient) -> None:
        """Hold a point of the front for a while; a trip or an interlock may prevent it."""
        points = self._results[-1].front.points
        if not points:
            return
        try:
            client.hold(HELD, points[0].index)
        except TunerError as error:
            self._operator.waits.add(f"not held: {error}")
            self._operator.look(client.status())

    def _tell_hour(self) -> None:
        if self.now >= self._hour:
            self._hour = int(self.now) + 1
            print(f"{self.now:5.1f} h  {self.summary()}", flush=True)

    def summary(self) -> str:
        """Return what happened so far, in one line."""
        return (
            f"{len(self._results)} runs, {self._evaluations} evaluations, {self._failed} failed, "
            f"{self._operator.interlocks} interlocks cleared, {len(self.faults)} faults"
        )

    @property
    def waits(self) -> list[str]:
        """Reasons of the waits and of points that were not held."""
        return sorted(self._operator.waits)


def _memory(process: NodeProcess) -> float:
    """Return the resident memory of a process [MB]."""
    pages = int(Path(f"/proc/{process.popen.pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def main() -> int:
    """Live the day, and print what happened."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--hours", type=float, default=24.0, help="simulated time [h]")
    parser.add_argument("--speed", type=float, default=120.0, help="simulated seconds per second")
    options = parser.parse_args()
    with RosDomain() as domain, tempfile.TemporaryDirectory(prefix="soak-") as folder:
        os.environ.update(domain.environment)
        day = Day(Path(folder), options.speed, options.hours)
        day.live()
        print(f"{day.now:5.1f} h  {day.summary()}")
    for text in [*day.waits, *day.faults]:
        print(f"  {text}")
    return 1 if day.faults else 0


if __name__ == "__main__":
    sys.exit(main())

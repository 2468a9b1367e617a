"""Memory and lag of the page: many evaluations at once, then 20 a second, with a browser that looks at it.

`python -m bench.page_load [--seconds 60] [--evaluations 5000] [--rate 20]`, on a quiet machine. A node of this
program plays the tuner. When a run has twice the evaluations with which it began, the next one begins. The figures are
the server's resident memory, the tab's heap after a collection of garbage, and the time from the publication of an
evaluation to its count on the screen.
"""

from __future__ import annotations

import argparse
import math
import os
import re
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import rclpy
from playwright.sync_api import CDPSession, Page, sync_playwright
from rclpy.context import Context
from rclpy.node import Node

from launcher.ros_domain import RosDomain
from mobo_msgs_py import msg
from mobo_tuner.ros import interfaces
from robustness.processes import NodeProcess, exit_at_sigterm

OBJECTIVES = [f"f{i}" for i in range(7)]
VARIABLES = [f"x{i}" for i in range(6)]
FRONT = 200  # points
START_TIMEOUT = 60.0  # [s]
FLAGS = ("--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking")


class Player:
    """A node that publishes what a tuner publishes."""

    def __init__(self, node: Node, budget: int) -> None:
        self._budget = budget
        self._run_id = ""
        self._runs = 0
        self._status = interfaces.STATUS.publisher(node)
        self._evaluation = interfaces.EVALUATION.publisher(node)
        self._front = interfaces.PARETO_FRONT.publisher(node)
        self._problem = interfaces.PROBLEM.publisher(node)
        self._points: list[msg.ParetoPoint] = []
        self.count = 0

    def begin(self) -> None:
        """Begin a run, and publish its problem."""
        self._runs += 1
        self._run_id = f"load-{self._runs}"
        self._points.clear()
        self.count = 0
        self._problem.publish(
            msg.Problem(
                run_id=self._run_id,
                variables=[msg.Variable(name=name, min=0.0, max=1.0) for name in VARIABLES],
                objectives=[msg.Objective(name=name, reference=2.0) for name in OBJECTIVES],
            )
        )

    def publish(self, *, whole: bool = True) -> None:
        """Publish one evaluation, and with `whole` the front and the status, too."""
        index = self.count
        self.count += 1
        wave = [0.5 + 0.5 * math.sin(0.37 * index + i) for i in range(len(OBJECTIVES))]
        setpoint = [msg.NamedValue(name=n, value=v) for n, v in zip(VARIABLES, wave, strict=False)]
        found = [
            msg.NamedValue(name=n, value=v, stddev=0.01)
            for n, v in zip(OBJECTIVES, wave, strict=True)
        ]
        self._evaluation.publish(
            msg.Evaluation(
                run_id=self._run_id,
                index=index,
                setpoint=setpoint,
                diagnostics=found,
                objectives=found,
                valid=True,
                feasible=True,
                hypervolume=1.0 - 1.0 / (index + 2),
                total_seconds=0.05,
            )
        )
        if index < FRONT:
            self._points.append(msg.ParetoPoint(index=index, setpoint=setpoint, objectives=found))
        if whole:
            self._front.publish(msg.ParetoFront(run_id=self._run_id, points=self._points))
            self._status.publish(
                msg.TunerStatus(
                    state=msg.TunerStatus.EVALUATING,
                    run_id=self._run_id,
                    evaluations=self.count,
                    budget=self._budget,
                )
            )


@contextmanager
def tab(address: str, folder: str) -> Iterator[tuple[Page, CDPSession]]:
    """A browser that shows the page."""
    with sync_playwright() as playwright:
        context = playwright.chromium.launch_persistent_context(
            folder,
            executable_path=shutil.which("chromium"),
            headless=True,
            args=[*FLAGS],
            viewport={"width": 1920, "height": 1080},
        )
        page = context.pages[0]
        page.goto(address)
        page.wait_for_selector(".state-word")
        yield page, context.new_cdp_session(page)
        context.close()


def resident(pid: int) -> float:
    """Resident memory of a process [MB]."""
    fields = Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()
    return int(fields[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def heap(session: CDPSession) -> float:
    """Heap of a tab after a collection of garbage [MB]."""
    session.send("HeapProfiler.collectGarbage")
    return float(session.send("Runtime.getHeapUsage")["usedSize"]) / 1e6


def shown(page: Page) -> int:
    """Number of evaluations on the screen."""
    found = re.match(r"\d+", page.locator(".count").inner_text())
    return int(found[0]) if found else 0


def measure(options: argparse.Namespace, folder: Path) -> None:
    """Carry out the measurement, and print it."""
    context = Context()
    with RosDomain() as domain:
        os.environ.update(domain.environment, ROS_LOG_DIR=str(folder))
        rclpy.init(context=context, domain_id=domain.id)
        player = Player(Node("player", context=context), 2 * options.evaluations)
        process = NodeProcess.start(
            *("-m", "mobo_tuner.nodes.page", "--ros-args", "-p", "port:=0"),
            stdout_path=folder / "page.out",
            stderr_path=folder / "page.err",
        )
        try:
            address = address_of(process)
            player.begin()
            with tab(address, f"{folder}/browser") as (page, session):
                follow(player, page, session, process.popen.pid, options)
            began = time.monotonic()
            process.stop()
            print(f"end after Ctrl-C {time.monotonic() - began:.2f} s")
        finally:
            process.kill()
            context.try_shutdown()


def address_of(page: NodeProcess) -> str:
    """Return the address of a page that was just started, as soon as it can be opened.

    Raises:
        SystemExit: If it does not start.
    """
    deadline = time.monotonic() + START_TIMEOUT
    while "page: " not in page.stdout:
        if time.monotonic() > deadline or not page.running:
            raise SystemExit(f"the page did not start: {page.stderr}")
        time.sleep(0.1)  # between two looks, until the deadline
    return page.stdout.partition("page: ")[2].split()[0]


def fill(player: Player, evaluations: int) -> None:
    """Publish many evaluations at once."""
    while player.count < evaluations:
        player.publish(whole=player.count % 100 == 0)
        time.sleep(0.001)  # so that the messages leave before the next ones


def follow(
    player: Player, page: Page, session: CDPSession, pid: int, options: argparse.Namespace
) -> None:
    """Publish, and print memory and lag every ten seconds."""
    print(f"server {resident(pid):.0f} MB before")
    fill(player, options.evaluations)
    page.wait_for_timeout(5000)
    began = time.monotonic()
    noted, made, lags = 0.0, 0, []
    while (spent := time.monotonic() - began) < options.seconds:
        if player.count >= 2 * options.evaluations:
            player.begin()
            fill(player, options.evaluations)
            page.wait_for_timeout(5000)
        player.publish()
        made += 1
        published = time.monotonic()
        if player.count % 20 == 0:
            while shown(page) < player.count:
                page.wait_for_timeout(20)
            lags.append(time.monotonic() - published)
        page.wait_for_timeout(
            max(0.0, 1000.0 * (1.0 / options.rate - time.monotonic() + published))
        )
        if spent >= noted:
            noted += 10.0
            print(
                f"{spent:4.0f} s: {player.count} evaluations, {made / max(spent, 1.0):.1f} a second, "
                f"server {resident(pid):.0f} MB, "
                f"tab {heap(session):.0f} MB, longest lag {max(lags, default=0.0):.2f} s",
                flush=True,
            )
            lags.clear()


def main() -> None:
    """Read the command line and measure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--evaluations", type=int, default=5000)
    parser.add_argument("--rate", type=float, default=20.0)
    options = parser.parse_args()
    exit_at_sigterm()
    with tempfile.TemporaryDirectory() as folder:
        measure(options, Path(folder))


if __name__ == "__main__":
    main()

"""What a run pays for the page: time of an evaluation with the page and three viewers, and without.

`python -m bench.page_cost [--phases 8] [--evaluations 20]`, on a quiet machine. A real tuner tunes the simulated
injector in one run, in whose phases the page is open or not, in turns: so a computer that is shared with others
is as busy with the page as without, on the average. Evaluations while the page opens or closes are left out.
"""

from __future__ import annotations

import argparse
import os
import shutil
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from itertools import count
from pathlib import Path
from statistics import median
from typing import NamedTuple

from playwright.sync_api import BrowserContext, sync_playwright

from bench.page_load import FLAGS, address_of
from launcher.ros_domain import RosDomain
from mobo_tuner.client import Evaluation, TunerClient
from robustness.processes import NodeProcess, exit_at_sigterm

CONFIG = Path(__file__).resolve().parents[1] / "config" / "awa.yaml"
VIEWERS = 3
EVALUATION_TIMEOUT = 60.0  # [s]


class Noted(NamedTuple):
    """An evaluation of the run.

    Attributes:
        phase: Number of the phase; None while the page opens or closes.
        total: Wall time of the whole step [s].
        suggestion: Wall time of the suggestion [s].
        machine: Wall time that the machine spent on it [s].
    """

    phase: int | None
    total: float
    suggestion: float
    machine: float


class Course:
    """The evaluations of a run, as they come.

    Attributes:
        phase: Number of the active phase; None while the page opens or closes.
    """

    def __init__(self) -> None:
        self.phase: int | None = None
        self.evaluations: list[Noted] = []

    def note(self, evaluation: Evaluation) -> None:
        """Take over an evaluation."""
        self.evaluations.append(
            Noted(
                self.phase,
                evaluation.total_seconds,
                evaluation.suggest_seconds,
                evaluation.machine_seconds,
            )
        )

    def wait_for(self, wanted: int) -> None:
        """Wait until there are so many evaluations in all."""
        deadline = time.monotonic() + EVALUATION_TIMEOUT
        known = len(self.evaluations)
        while len(self.evaluations) < wanted:
            if len(self.evaluations) > known:
                known = len(self.evaluations)
                deadline = time.monotonic() + EVALUATION_TIMEOUT
            if time.monotonic() > deadline:
                raise SystemExit("the run stands still")
            time.sleep(0.05)  # between two looks, until the deadline


@contextmanager
def page(
    browser: BrowserContext, scratch: Path, start: Callable[..., NodeProcess]
) -> Iterator[None]:
    """The page with its viewers."""
    process = start("mobo_tuner.nodes.page", "port:=0", f"runs_dir:={scratch / 'runs'}")
    address = address_of(process)
    tabs = [browser.new_page() for _ in range(VIEWERS)]
    for tab in tabs:
        tab.goto(address)
        tab.wait_for_selector(".state-word")
    yield
    for tab in tabs:
        tab.close()
    process.kill()


def measure(phases: int, evaluations: int, speed: float, scratch: Path) -> list[Noted]:
    """Make the run; its evaluations."""
    course = Course()
    with ExitStack() as stack:
        domain = stack.enter_context(RosDomain())
        os.environ.update(domain.environment, ROS_LOG_DIR=str(scratch))

        numbers = count()  # of the processes, whose files must not be those of an earlier one

        def start(module: str, *parameters: str) -> NodeProcess:
            options = [word for text in parameters for word in ("-p", text)]
            file = () if module.endswith("page") else ("--params-file", str(CONFIG))
            name = f"{module}-{next(numbers)}"
            process = NodeProcess.start(
                *("-m", module, "--ros-args", *file, *options),
                stdout_path=scratch / f"{name}.out",
                stderr_path=scratch / f"{name}.err",
                environment={**domain.environment, "OMP_NUM_THREADS": "1"},
            )
            stack.callback(process.kill)
            return process

        start("awa_sim_node.node", f"awa_sim:speed:={speed}")
        start("mobo_tuner.nodes.tuner", f"tuner:runs_dir:={scratch / 'runs'}")
        playwright = stack.enter_context(sync_playwright())
        browser = playwright.chromium.launch_persistent_context(
            f"{scratch}/browser",
            executable_path=shutil.which("chromium"),
            headless=True,
            args=[*FLAGS],
            viewport={"width": 1920, "height": 1080},
        )
        stack.callback(browser.close)
        client = stack.enter_context(TunerClient(domain_id=domain.id, timeout=60.0))
        runner = threading.Thread(
            target=client.tune,
            kwargs={"evaluations": 100_000, "on_evaluation": course.note},
            daemon=True,
        )
        runner.start()
        for phase in range(phases):
            with ExitStack() as opened:
                if phase % 2:
                    opened.enter_context(page(browser, scratch, start))
                course.wait_for(len(course.evaluations) + 1)
                course.phase = phase
                course.wait_for(len(course.evaluations) + evaluations + 1)
                course.phase = None
            print(f"phase {phase}: {len(course.evaluations)} evaluations in all", flush=True)
        with TunerClient(domain_id=domain.id) as other:
            other.cancel()
        runner.join(EVALUATION_TIMEOUT)
    return course.evaluations


def main() -> None:
    """Read the command line, measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--phases", type=int, default=8, help="without and with the page, in turns")
    parser.add_argument("--evaluations", type=int, default=20, help="evaluations of each phase")
    parser.add_argument("--speed", type=float, default=15.0, help="speed of the simulated machine")
    options = parser.parse_args()
    exit_at_sigterm()
    with tempfile.TemporaryDirectory() as folder:
        noted = measure(options.phases, options.evaluations, options.speed, Path(folder))
    print(f"load {os.getloadavg()[0]:.1f}")
    medians = []
    for with_page, name in ((0, "without the page"), (1, f"with it and {VIEWERS} viewers")):
        part = [e for e in noted if e.phase is not None and e.phase % 2 == with_page]
        medians.append(median(e.total for e in part))
        print(
            f"{name}: {medians[-1]:.4f} s an evaluation (median of {len(part)}), suggestion "
            f"{median(e.suggestion for e in part):.4f} s, machine {median(e.machine for e in part):.4f} s, "
            f"rest {1e3 * median(e.total - e.suggestion - e.machine for e in part):.1f} ms"
        )
    print(f"the page costs {100.0 * (medians[1] / medians[0] - 1.0):+.1f} % of an evaluation")


if __name__ == "__main__":
    main()

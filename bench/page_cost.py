"""What a run pays for the page: time of an evaluation with the page and three viewers, and without.

`python -m bench.page_cost [--rounds 2] [--evaluations 12]`, on a quiet machine. A real tuner tunes the simulated
injector in one run. A round of it has phases without the page, with the page that nobody looks at, with three viewers,
and the same backwards, so that neither a run that becomes slower nor a shared computer counts for one of them.
Evaluations while the page opens or closes are left out.

How long a move takes depends on how far it goes, and no two phases have the same set-points. So the machine is ideal:
how long it needs for an evaluation is known, and what it took beyond that is due to the computer.
"""

from __future__ import annotations

import argparse
import os
import shutil
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from itertools import count
from pathlib import Path
from statistics import mean, median
from typing import NamedTuple

from playwright.sync_api import BrowserContext, sync_playwright

from awa_sim_node.machine import SimulatedMachine
from bench.page_load import FLAGS, address_of
from launcher.ros_domain import RosDomain
from mobo_tuner.client import Evaluation, TunerClient
from robustness.processes import NodeProcess, exit_at_sigterm

CONFIG = Path(__file__).resolve().parents[1] / "config" / "awa.yaml"
VIEWERS = 3
EVALUATION_TIMEOUT = 60.0  # [s]
WARM_UP = 4  # set-points of the models before the first phase
WITHOUT, UNSEEN, SEEN = "without the page", "page, no viewer", f"page, {VIEWERS} viewers"
KINDS = (WITHOUT, UNSEEN, SEEN)
BROWSER = "chrom"  # in the names of its processes
TICKS = os.sysconf("SC_CLK_TCK")  # in a second of the processor


class Noted(NamedTuple):
    """An evaluation of the run.

    Attributes:
        kind: Kind of the phase; None while the page opens or closes.
        total: Wall time of the whole step [s].
        suggestion: Wall time of the suggestion [s].
        machine: Wall time that the machine spent on it [s].
        acted: Wall time that the motion and the shots need [s].
    """

    kind: str | None
    total: float
    suggestion: float
    machine: float
    acted: float

    @property
    def late(self) -> float:
        """Wall time that the machine took beyond what its motion and its shots need [s]."""
        return self.machine - self.acted

    @property
    def rest(self) -> float:
        """Wall time between suggestion and machine [s]."""
        return self.total - self.suggestion - self.machine

    @property
    def overhead(self) -> float:
        """Wall time of everything but motion and shots [s]."""
        return self.total - self.acted


class Course:
    """The evaluations of a run, as they come.

    Args:
        speed: Speed of the simulated machine.

    Attributes:
        kind: Kind of the active phase; None while the page opens or closes.
        suggested: Number of set-points of the models, which the initial design and the time to compile come before.
    """

    def __init__(self, speed: float) -> None:
        self.kind: str | None = None
        self.suggested = 0
        self.evaluations: list[Noted] = []
        self._machine = SimulatedMachine("awa", "ideal", seed=0)
        self._speed = speed

    def note(self, evaluation: Evaluation) -> None:
        """Take over an evaluation."""
        self.suggested += evaluation.source == "model"
        settling = self._machine.move(evaluation.setpoint)
        self._machine.step(settling)
        beam = self._machine.behaviour.beam
        self.evaluations.append(
            Noted(
                self.kind,
                evaluation.total_seconds,
                evaluation.suggest_seconds,
                evaluation.machine_seconds,
                (settling + beam.shots / beam.repetition_rate) / self._speed,
            )
        )

    def wait_for(self, more: int) -> None:
        """Wait until there are so many more evaluations."""
        wanted = len(self.evaluations) + more
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
    browser: BrowserContext, scratch: Path, viewers: int, start: Callable[..., NodeProcess]
) -> Iterator[NodeProcess]:
    """The page with its viewers."""
    process = start("mobo_tuner.nodes.page", "port:=0", f"runs_dir:={scratch / 'runs'}")
    address = address_of(process)
    tabs = [browser.new_page() for _ in range(viewers)]
    for tab in tabs:
        tab.goto(address)
        tab.wait_for_selector(".state-word")
    yield process
    for tab in tabs:
        tab.close()
    process.kill()


def spent(processes: Mapping[str, NodeProcess]) -> dict[str, float]:
    """Return the time of the processor that nodes and browsers have used so far, by name [s]."""
    ticks: dict[int, int] = {}
    parents: dict[int, int] = {}
    browsers: list[int] = []
    for file in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):  # it has ended
            head, _, fields = file.read_text(encoding="utf-8").rpartition(") ")
            pid, _, name = head.partition(" (")
            words = fields.split()
            parents[int(pid)] = int(words[1])
            ticks[int(pid)] = int(words[11]) + int(words[12])  # in the program and in the kernel
            if BROWSER in name:
                browsers.append(int(pid))

    def is_own(pid: int) -> bool:
        return pid == os.getpid() or (pid in parents and is_own(parents[pid]))

    seconds = {name: ticks[process.popen.pid] / TICKS for name, process in processes.items()}
    return seconds | {"browser": sum(ticks[pid] for pid in filter(is_own, browsers)) / TICKS}


class Result(NamedTuple):
    """What was measured.

    Attributes:
        evaluations: Evaluations of the run.
        processor: Time of the processor for an evaluation in each phase, by kind and by name [s].
    """

    evaluations: list[Noted]
    processor: Mapping[str, list[dict[str, float]]]


def measure(rounds: int, evaluations: int, speed: float, scratch: Path) -> Result:
    """Make the run."""
    course = Course(speed)
    processor: dict[str, list[dict[str, float]]] = {kind: [] for kind in KINDS}
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

        nodes = {
            "machine": start("awa_sim_node.node", f"awa_sim:speed:={speed}", "awa_sim:mode:=ideal"),
            "tuner": start("mobo_tuner.nodes.tuner", f"tuner:runs_dir:={scratch / 'runs'}"),
        }
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
        while course.suggested < WARM_UP:
            course.wait_for(1)
        for kind in (*KINDS, *reversed(KINDS)) * rounds:
            with ExitStack() as opened:
                processes = dict(nodes)
                if kind != WITHOUT:
                    viewers = VIEWERS if kind == SEEN else 0
                    opened_page = page(browser, scratch, viewers, start)
                    processes["page"] = opened.enter_context(opened_page)
                course.wait_for(2)
                course.kind, before = kind, spent(processes)
                course.wait_for(evaluations)
                course.kind, after = None, spent(processes)
            each = {name: (after[name] - before[name]) / evaluations for name in after}
            processor[kind].append(each)
            print(f"{kind}: {len(course.evaluations)} evaluations in all", flush=True)
        with TunerClient(domain_id=domain.id) as other:
            other.cancel_any()
        runner.join(EVALUATION_TIMEOUT)
    return Result(course.evaluations, processor)


def report(result: Result) -> None:
    """Print what was measured."""
    print(f"load {os.getloadavg()[0]:.1f}")
    parts = {kind: [e for e in result.evaluations if e.kind == kind] for kind in KINDS}
    for kind, part in parts.items():
        print(
            f"{kind}: {median(e.total for e in part):.4f} s an evaluation (median of {len(part)}), of it "
            f"motion and shots {median(e.acted for e in part):.4f} s, "
            f"suggestion {1e3 * median(e.suggestion for e in part):.1f} ms, "
            f"machine late by {1e3 * median(e.late for e in part):.1f} ms, "
            f"rest {1e3 * median(e.rest for e in part):.1f} ms"
        )
        phases = result.processor[kind]
        processor = {name: mean(phase[name] for phase in phases) for name in phases[0]}
        shares = ", ".join(f"{name} {1e3 * seconds:.0f} ms" for name, seconds in processor.items())
        print(f"    processor for an evaluation: {shares}")
    whole = median(e.total for e in parts[WITHOUT])
    print(f"median of {WITHOUT} = 100 %:")
    for kind in (UNSEEN, SEEN):
        total = median(e.total for e in parts[kind]) - whole
        own = median(e.overhead for e in parts[kind]) - median(e.overhead for e in parts[WITHOUT])
        print(
            f"{kind}: {100.0 * total / whole:+.1f} %; without what motion and shots differ "
            f"{100.0 * own / whole:+.1f} % ({1e3 * own:+.1f} ms)"
        )


def main() -> None:
    """Read the command line, measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=2, help="of all kinds of phases, and back")
    parser.add_argument("--evaluations", type=int, default=12, help="evaluations of each phase")
    parser.add_argument("--speed", type=float, default=15.0, help="speed of the simulated machine")
    options = parser.parse_args()
    exit_at_sigterm()
    with tempfile.TemporaryDirectory() as folder:
        result = measure(options.rounds, options.evaluations, options.speed, Path(folder))
    report(result)


if __name__ == "__main__":
    main()

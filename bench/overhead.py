"""What an evaluation costs beside the suggestion and the machine, and where that time goes.

A real tuner tunes a real simulated machine, each in a process of its own, on the toy problem in ideal mode; the
overhead of an evaluation is its whole time less that of the suggestion and that of the machine. Then the pieces
that are done once per evaluation are timed by themselves in this process.

    python -m bench.overhead --evaluations 100
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from statistics import median

from builtin_interfaces.msg import Time

from launcher.ros_domain import RosDomain
from mobo_tuner.client import TunerClient
from mobo_tuner.runs.journal import Journal
from mobo_tuner.runs.records import StartRecord, to_json
from mobo_tuner.tuner.run.run import Findings
from robustness.offline_run import OfflineRun, toy, toy_optimizer
from robustness.processes import NodeProcess

ROOT = Path(__file__).resolve().parents[1]
CONFIG = ROOT / "config" / "toy.yaml"
NODES = {
    "awa_sim_node.node": ("awa_sim:speed:=1000.0",),
    "mobo_tuner.nodes.tuner": ("tuner:machine_return_timeout:=0.0",),
}


def measured_overheads(evaluations: int, runs_dir: Path) -> list[float]:
    """Return the overhead of each evaluation of a run over ROS [s]."""
    with ExitStack() as stack:
        domain = stack.enter_context(RosDomain())
        os.environ.update(domain.environment)
        for module, parameters in NODES.items():
            given = [*parameters, f"tuner:runs_dir:={runs_dir}"]
            options = [word for text in given for word in ("-p", text)]
            log = runs_dir.with_name(f"{module}.log")
            process = NodeProcess.start(
                *("-m", module, "--ros-args", "--params-file", str(CONFIG), *options),
                stdout_path=log,
                stderr_path=log,
                environment={**domain.environment, "OMP_NUM_THREADS": "1"},
            )
            stack.callback(process.kill)
        overheads: list[float] = []
        with TunerClient(domain_id=domain.id, timeout=30.0) as client:
            client.tune(
                evaluations=evaluations,
                on_evaluation=lambda e: overheads.append(
                    e.total_seconds - e.suggest_seconds - e.machine_seconds
                ),
            )
    return overheads


def pieces(evaluations: int, folder: Path) -> dict[str, float]:
    """Return the median time of what is done once per evaluation, by name [s]."""
    offline = OfflineRun(folder / "run", toy_optimizer(0), toy, seed=0, events=False)
    run = offline.run
    for _ in range(evaluations):
        offline.step()
    problem, record = run.records[-1]
    stamp = Time()
    start = to_json(StartRecord("run", 0.0, problem, {"model_input": "setpoint"}))
    with Journal.create(folder / "journal", [start]) as journal:
        timed: dict[str, Callable[[], object]] = {
            "findings (front, counts)": lambda: Findings.of(run.optimizer),
            "journal line, on disk": lambda: journal.append(to_json(record)),
            "messages of evaluation and front": lambda: (
                run.evaluation_message(record),
                run.front_message(stamp),
            ),
            "state beside the journal (not waited for)": run.save,
        }
        return {name: median(_seconds(piece) for _ in range(50)) for name, piece in timed.items()}


def _seconds(function: Callable[[], object]) -> float:
    started = time.perf_counter()
    function()
    return time.perf_counter() - started


def main() -> None:
    """Measure and print the times."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--evaluations", type=int, default=100, help="evaluations of the run")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        overheads = measured_overheads(options.evaluations, Path(scratch, "runs"))
        print(
            f"overhead of an evaluation: median {1e3 * median(overheads):.1f} ms, "
            f"longest {1e3 * max(overheads):.1f} ms ({len(overheads)} evaluations)"
        )
        for name, seconds in pieces(options.evaluations, Path(scratch)).items():
            print(f"  {1e3 * seconds:6.2f} ms  {name}")


if __name__ == "__main__":
    main()

"""What an evaluation costs beside the suggestion and the machine, and where that time goes.

For each parameter file a real tuner tunes the real simulated machine, each in a process of its own. The overhead of
an evaluation is its whole time less that of the suggestion and that of the machine. CPU times are printed beside it,
because they hardly depend on what else runs on the computer: of the executor's thread of each process, and of what
is done once per evaluation, timed in this process in a run of the same problem.

    python -m bench.overhead --evaluations 60
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, closing, contextmanager
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple
from unittest.mock import patch

import yaml
from builtin_interfaces.msg import Time
from rclpy.task import Future

from awa_sim_node.machine import SimulatedMachine
from launcher.ros_domain import RosDomain
from mobo_msgs_py.action import EvaluateSetpoint
from mobo_tuner.client import TunerClient
from mobo_tuner.core import Optimizer, Problem
from mobo_tuner.runs.records import StartRecord
from mobo_tuner.runs.run_log import RunLog
from mobo_tuner.tuner.machine_client import Answer
from mobo_tuner.tuner.run.run import Findings, Outcome, Run
from robustness.processes import NodeProcess

ROOT = Path(__file__).resolve().parents[1]
NODES = {
    "awa_sim_node.node": ("awa_sim:speed:=1000.0",),
    "mobo_tuner.nodes.tuner": ("tuner:machine_return_timeout:=0.0",),
}


class Measured(NamedTuple):
    """A run over ROS.

    Attributes:
        overheads: Overhead of each evaluation [s].
        executors: CPU time of each process's executor per evaluation, by module [s].
    """

    overheads: list[float]
    executors: dict[str, float]


def measure(config: Path, evaluations: int, scratch: Path) -> Measured:
    """Make a run over ROS."""
    with ExitStack() as stack:
        domain = stack.enter_context(RosDomain())
        os.environ.update(domain.environment)
        processes = {}
        for module, parameters in NODES.items():
            given = [*parameters, f"tuner:runs_dir:={scratch / 'runs'}"]
            options = [word for text in given for word in ("-p", text)]
            log = scratch / f"{module}.log"
            processes[module] = NodeProcess.start(
                *("-m", module, "--ros-args", "--params-file", str(config), *options),
                stdout_path=log,
                stderr_path=log,
                environment={**domain.environment, "OMP_NUM_THREADS": "1"},
            )
            stack.callback(processes[module].kill)
        overheads: list[float] = []
        used: list[dict[str, float]] = []

        def note(evaluation: Any) -> None:
            overheads.append(
                evaluation.total_seconds - evaluation.suggest_seconds - evaluation.machine_seconds
            )
            if evaluation.index in (0, evaluations - 1):
                used.append({m: _thread_seconds(p.popen.pid) for m, p in processes.items()})

        with TunerClient(domain_id=domain.id, timeout=30.0) as client:
            client.tune(evaluations=evaluations, on_evaluation=note)
    first, last = used
    executors = {m: (last[m] - first[m]) / (evaluations - 1) for m in NODES}
    return Measured(overheads, executors)


def _thread_seconds(pid: int) -> float:
    """Return the CPU time of a process's main thread [s]."""
    return 1e-9 * int(Path(f"/proc/{pid}/task/{pid}/schedstat").read_text().split()[0])


class Stopwatch:
    """CPU times of calls, by name [s]."""

    def __init__(self) -> None:
        self.seconds: dict[str, list[float]] = defaultdict(list)

    @contextmanager
    def timing(self, name: str) -> Iterator[None]:
        """Time a block."""
        started = time.process_time()
        yield
        self.seconds[name].append(time.process_time() - started)

    def watching(self, owner: Any, method: str, name: str) -> AbstractContextManager[Any]:
        """Time each call of a method of an object or a class within a block."""
        original: Callable[..., Any] = getattr(owner, method)

        def timed(*args: Any, **kwargs: Any) -> Any:
            with self.timing(name):
                return original(*args, **kwargs)

        return patch.object(owner, method, timed)


def pieces(config: Path, evaluations: int, folder: Path) -> dict[str, float]:
    """Return the median CPU time of what is done once per evaluation, by name [s].

    Args:
        config: Parameter file.
        evaluations: Number of evaluations; those of the initial design are not counted.
        folder: Folder for the run.
    """
    sections = yaml.safe_load(config.read_text(encoding="utf-8"))
    simulated = sections["/**/awa_sim"]["ros__parameters"]
    machine = SimulatedMachine(simulated["model"], simulated["mode"], seed=0)
    problem = Problem.from_yaml(config)
    optimizer = Optimizer(problem, seed=0)
    start = StartRecord(folder.name, 0.0, problem, {"model_input": "setpoint"})
    run = Run(folder.name, evaluations, optimizer, Future(), RunLog(folder, start))
    stopwatch = Stopwatch()
    with (
        closing(run.log),
        stopwatch.watching(optimizer, "tell", "  of that, tell"),
        stopwatch.watching(
            Findings, "of", "  of that, findings: models' means, front, hypervolume"
        ),
        stopwatch.watching(run.log, "keep", "  of that, journal line"),
    ):
        while not run.finished:
            with stopwatch.timing("suggestion (not part of the overhead)"):
                suggestion = run.suggest()
            answer = _answer(machine, suggestion.setpoint)
            with stopwatch.timing("learn"):
                record = run.learn(suggestion, Outcome(answer, 1))
            with stopwatch.timing("messages of evaluation and front (during the next suggestion)"):
                run.evaluation_message(record)
                run.front_message(Time())
            with stopwatch.timing("state beside the journal (while the machine works)"):
                run.save()
    first = optimizer.initial_evaluations
    return {name: median(seconds[first:]) for name, seconds in stopwatch.seconds.items()}


def _answer(machine: SimulatedMachine, setpoint: dict[str, float]) -> Answer:
    evaluation = machine.start_evaluation(setpoint)
    while not evaluation.phase.finished:
        machine.step(1.0)
    result = evaluation.result
    assert result is not None
    codes = EvaluateSetpoint.Result
    return Answer(
        error_code=codes.NONE if result.failure is None else codes.INVALID_MEASUREMENT,
        error_msg="" if result.failure is None else result.failure.message,
        stamp=machine.time,
        readbacks={r.name: r.value for r in result.readbacks},
        diagnostics={r.name: (r.value, r.stddev) for r in result.diagnostics},
    )


def main() -> None:
    """Measure and print the times."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--configs", nargs="+", default=["toy", "awa"], help="names in config/")
    parser.add_argument("--evaluations", type=int, default=60, help="evaluations of each run")
    options = parser.parse_args()
    for name in options.configs:
        config = ROOT / "config" / f"{name}.yaml"
        with tempfile.TemporaryDirectory() as scratch:
            run = measure(config, options.evaluations, Path(scratch))
            print(
                f"{name}: overhead of an evaluation: median {1e3 * median(run.overheads):.1f} ms, "
                f"longest {1e3 * max(run.overheads):.1f} ms ({len(run.overheads)} evaluations)"
            )
            print("CPU time of an evaluation")
            for module, seconds in run.executors.items():
                print(f"  {1e3 * seconds:6.2f} ms  executor of {module}")
            parts = pieces(config, options.evaluations, Path(scratch, "pieces"))
            for part, seconds in parts.items():
                print(f"  {1e3 * seconds:6.2f} ms  {part}", flush=True)


if __name__ == "__main__":
    main()

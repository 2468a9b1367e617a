"""A campaign: a simulation is optimised by many of its processes at once, in the loop of libEnsemble.

`python -m mobo_tuner.offline.campaign FOLDER --config FILE` makes a campaign in a new run folder, with a
journal as every run has one. libEnsemble hands the points to threads of this process, each of which waits
for one simulation at a time, of this host or, with `--listen`, of a worker on any host (`hosts`).
"""

from __future__ import annotations

import argparse
import contextlib
import logging
import os
import shlex
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
from libensemble import Ensemble
from libensemble.alloc_funcs.start_only_persistent import only_persistent_gens
from libensemble.specs import AllocSpecs, ExitCriteria, GenSpecs, LibeSpecs, SimSpecs
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from mobo_tuner.core import Optimizer, Problem
from mobo_tuner.core.values import listed
from mobo_tuner.errors import ParameterError, UserError
from mobo_tuner.files import load_yaml
from mobo_tuner.offline.generator import ID, MoboGenerator
from mobo_tuner.offline.hosts import Hosts
from mobo_tuner.offline.parameters import CAMPAIGN
from mobo_tuner.offline.simulation import Outcome, Simulation, command_of
from mobo_tuner.parameter_file import check_section, check_section_names, node_sections
from mobo_tuner.runs.hints import why_barren
from mobo_tuner.runs.history import INVALID_MEASUREMENT, MACHINE_ERROR, History
from mobo_tuner.runs.journal import read_journal
from mobo_tuner.runs.optimizer_settings import make_optimizer
from mobo_tuner.runs.prior_model import load_prior_model
from mobo_tuner.runs.records import (
    ChangeRecord,
    EndRecord,
    EvaluationRecord,
    Record,
    Source,
    StartRecord,
    StopReason,
)
from mobo_tuner.runs.replay import restore
from mobo_tuner.runs.run_log import RunLog
from mobo_tuner.runs.saved_state import SavedState
from mobo_tuner.tuner.parameters import check_tuner

SECONDS, ERROR = "_seconds", "_error"  # fields of libEnsemble's history beside those of the problem
_MOST_ERROR = 300  # characters
_IMPORT = 300.0  # [s] for the import of a function
_TELLING = 5  # failures without a success, after which they are told
# Least time between two looks at the simulations [s], and the same for each of many of them.
_POLL, _POLL_OF_WORKER = 0.005, 5e-5


@dataclass(frozen=True)
class _Asked:
    """How a point came about: its source, and its share of the wall time of the suggestion [s]."""

    source: Source
    seconds: float


class Campaign(MoboGenerator):
    """A generator whose every result is in the journal before the next point is suggested.

    Args:
        optimizer: Optimiser, which may know earlier evaluations.
        log: Journal of the run.
        budget: Number of evaluations at the end, for the progress that is shown.

    Attributes:
        optimizer: Optimiser.
        records: Evaluations of this campaign itself.
        trouble: First error in `suggest` or `ingest`, of which libEnsemble passes on a text alone; None without one.
    """

    def __init__(self, optimizer: Optimizer, log: RunLog, budget: int) -> None:
        super().__init__(optimizer.given_problem)
        self.optimizer = optimizer
        self.records: list[EvaluationRecord] = []
        self.trouble: Exception | None = None
        self._log = log
        self._asked: dict[int, _Asked] = {}
        self._lock = threading.Lock()  # held while a result is learned and recorded
        self._progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeRemainingColumn(),
            disable=not sys.stdout.isatty(),
        )
        self._task = self._progress.add_task("", total=budget, completed=len(optimizer.dataset))
        self._failed = sum(e.failed for e in optimizer.dataset.evaluations)

    def __enter__(self) -> Campaign:
        self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._progress.stop()

    def suggest(self, num_points: int | None = None) -> list[dict[str, Any]]:
        """Return points to simulate, see `MoboGenerator.suggest`."""
        started = time.perf_counter()
        with self._keeping_trouble():
            points = super().suggest(num_points)
        seconds = (time.perf_counter() - started) / len(points)
        for point, source in zip(points, self.optimizer.last_sources, strict=True):
            self._asked[point[ID]] = _Asked(source, seconds)
        return points

    def ingest(self, results: Sequence[Mapping[str, Any]]) -> None:
        """Learn simulated points and write each into the journal."""
        for result in results:
            with self._keeping_trouble(), self._lock:
                super().ingest([result])
                self.records.append(self._record(result))
                self._log.append(self.records[-1])
            self._failed += self.optimizer.dataset.evaluations[-1].failed
            words = f"hypervolume {self.optimizer.hypervolume:.5g}{self._at_highest()}, {self._failed} failed"
            self._progress.update(self._task, advance=1, description=words)
            if self._failed == len(self.optimizer.dataset) == _TELLING:
                reason = self.records[-1].error_msg
                text = (
                    f"all of the first {_TELLING} simulations failed, the last one because {reason}"
                )
                self._progress.console.print(text, markup=False, highlight=False, soft_wrap=True)
        with self._lock:
            self._log.save(self.optimizer)

    def cancel(self) -> None:
        """End the journal; no result is learned any more."""
        self._lock.acquire()
        self._progress.stop()
        self._log.append(EndRecord(time.time(), StopReason.CANCELED))

    @contextlib.contextmanager
    def _keeping_trouble(self) -> Iterator[None]:
        """Keep the first error that is raised."""
        try:
            yield
        except Exception as error:
            self.trouble = self.trouble or error
            raise

    def _at_highest(self) -> str:
        """Return how many evaluations are of the highest fidelity, in words; nothing without fidelities."""
        if self.optimizer.problem.fidelity is None:
            return ""
        return f", {np.count_nonzero(self.optimizer.dataset.highest)} at the highest fidelity"

    def _no_number(self) -> str:
        """Return what a simulation lacked that gave no number of use, in words."""
        return (
            f"no number was given for any of {listed(self.optimizer.problem.required_diagnostics)}"
        )

    def _record(self, result: Mapping[str, Any]) -> EvaluationRecord:
        """Return the record of the evaluation that was told last."""
        optimizer, asked = self.optimizer, self._asked.pop(int(result[ID]))
        evaluation = optimizer.dataset.evaluations[-1]
        error = str(result[ERROR])
        front = optimizer.pareto_front(probability=False)
        seconds = float(result[SECONDS])
        return EvaluationRecord(
            index=evaluation.index,
            source=asked.source,
            attempts=1,
            stamp=time.time(),
            setpoint=evaluation.setpoint,
            readbacks={},
            diagnostics={n: (v, evaluation.stddevs[n]) for n, v in evaluation.values.items()},
            valid=evaluation.valid,
            feasible=evaluation.feasible,
            non_dominated=any(point["index"] == evaluation.index for point in front),
            hypervolume=optimizer.hypervolume,
            hypervolume_measured=optimizer.hypervolume_measured,
            error_code=INVALID_MEASUREMENT if error or evaluation.failed else 0,
            error_msg=error or (self._no_number() if evaluation.failed else ""),
            suggest_seconds=asked.seconds,
            machine_seconds=seconds,
            total_seconds=asked.seconds + seconds,
        )


class Begun(NamedTuple):
    """A campaign that has begun.

    Attributes:
        optimizer: Optimiser, which may know earlier evaluations.
        log: Journal of the run.
        settings: Budget, and the parameters of the campaign.
    """

    optimizer: Optimizer
    log: RunLog
    settings: Mapping[str, Any]


def start(config: Path, folder: Path, given: Mapping[str, Any]) -> Begun:
    """Begin a new campaign.

    Args:
        config: Parameter file.
        folder: Folder of the run.
        given: Values in place of the file's: `workers`, `evaluations`, `seed`; and `listen`, with which no
            command is needed.

    Raises:
        UserError: If something is wrong.
        OSError: If the journal cannot be written.
    """
    content = load_yaml(config)
    sections = node_sections(content)
    check_section_names(sections, ("tuner", "campaign"), allow_others=True)
    campaign = check_section("campaign", sections.get("campaign", {}), CAMPAIGN)
    campaign["command"] = command_of(campaign, config.parent)
    tuner = check_tuner(sections.get("tuner", {}) | {n: given[n] for n in _OF_TUNER & {*given}})
    if "workers" in given:
        campaign["workers"] = given["workers"]
    problem = Problem.from_dict(content)
    settings = {**tuner, "budget": tuner["evaluations"], "campaign": campaign}
    _check_needs_no_machine(problem, tuner)
    optimizer = make_optimizer(problem, settings, load_prior_model(problem, settings))
    if campaign["command"] or "listen" not in given:  # else the workers know how to evaluate
        _check_command(campaign, folder, here="listen" not in given)
    record = StartRecord(folder.name, time.time(), problem, settings)
    return Begun(optimizer, RunLog(folder, record), settings)


def _check_needs_no_machine(problem: Problem, tuner: Mapping[str, Any]) -> None:
    """Check that nothing depends on where a machine is, or on how a run of the tuner goes on.

    Raises:
        ParameterError: If something does.
    """
    if problem.open_variables:
        raise ParameterError(
            f"the bounds of {listed(problem.open_variables)} depend on where a machine is, and a campaign has none; "
            "'min' and 'max', 'choices', or a number for 'fixed' are allowed"
        )
    for constraint in problem.constraints:
        if constraint.safe:
            raise ParameterError(
                f"constraints.{constraint.name}.safe is {constraint.safe:g}; a campaign has no machine to begin where "
                "it is safe, and allows none"
            )
    for name in _ONLY_OF_RUNS:
        if tuner[name]:
            raise ParameterError(
                f"tuner.{name} is {tuner[name]:g}; a campaign allows none: {_ONLY_OF_RUNS[name]}"
            )


def _check_command(campaign: Mapping[str, Any], folder: Path, *, here: bool) -> None:
    """Check that the command of a campaign can be run, and a function be imported.

    Args:
        campaign: Parameters of the campaign.
        folder: Folder of the run.
        here: Whether this host simulates; another one may have other packages.

    Raises:
        ParameterError: If not.
    """
    command, function = campaign["command"], campaign["function"]
    if not command:
        raise ParameterError(
            "campaign.command and campaign.function are empty; one of them says how a point is simulated"
        )
    Simulation(command, campaign["timeout"], folder)
    if function and here:
        words = [sys.executable, *shlex.split(command)[1:], "--check"]
        try:  # in a folder without packages, as that of a simulation
            done = subprocess.run(
                words, cwd=os.sep, capture_output=True, text=True, timeout=_IMPORT, check=False
            )
            reason = done.stderr.strip().rpartition("\n")[2] if done.returncode else ""
        except subprocess.TimeoutExpired:
            reason = f"its import takes more than {_IMPORT:g} s"
        if reason:
            raise ParameterError(f"campaign.function is {function!r:.80}: {reason}")


def resume(earlier: Path, folder: Path, given: Mapping[str, Any]) -> Begun:
    """Begin a campaign that continues an earlier one, with whose records its journal begins.

    Raises:
        UserError: If the earlier run cannot be read, was no campaign, or has its budget already.
        OSError: If the journal cannot be written.
    """
    history = History.from_records(read_journal(earlier))
    if "campaign" not in history.settings:
        raise UserError(
            f"the run '{history.run_id}' was no campaign; `mobo.py resume` continues it"
        )
    optimizer = restore(history, SavedState.read(earlier), retrain=False)
    for setpoint in optimizer.pending:  # they were never finished
        optimizer.cancel(setpoint)
    made = len(history.evaluations)
    budget = given.get("evaluations", history.budget)
    if budget <= made:
        raise UserError(
            f"evaluations is {budget}; the run '{history.run_id}' has {made} already, more are allowed"
        )
    settings = {**history.settings}
    if "workers" in given:
        settings["campaign"] = {**settings["campaign"], "workers": given["workers"]}
    now = time.time()
    since = {"run_id": history.run_id, "evaluations": made}
    record = StartRecord(folder.name, now, history.problem, settings, resumed_from=since)
    records: list[Record] = list(history.records)
    if budget != history.budget:
        records.append(ChangeRecord(now, made, history.last_problem, budget))
    return Begun(optimizer, RunLog(folder, record, records), {**settings, "budget": budget})


_OF_TUNER = {"evaluations", "seed"}
_ENDS = "it ends when it has made its evaluations"
_ONLY_OF_RUNS = {
    "trust_distance": "it has no machine to begin where it is",
    "hypervolume_goal": _ENDS,
    "stop_after": _ENDS,
    "stop_without_gain": _ENDS,
    "stop_below_expected_gain": _ENDS,
}
"""Parameters of the tuner that a campaign cannot obey, and why."""


class Simulator(Protocol):
    """What simulates the points of a campaign, such as `Simulation`; it is called by many threads."""

    def run(self, number: int, point: Mapping[str, float]) -> Outcome:
        """Simulate a point, see `Simulation.run`."""

    def stop(self) -> None:
        """End all simulations; later ones fail."""


def run(begun: Begun, simulation: Simulator) -> None:
    """Simulate until the budget is used up.

    Args:
        begun: What is known, and where it is recorded.
        simulation: What simulates; it is stopped at the end.

    Raises:
        UserError: If no simulation was of use.
    """
    optimizer, log, settings = begun
    campaign, budget = settings["campaign"], settings["budget"]
    names = optimizer.problem.setpoint_names
    with Campaign(optimizer, log, budget) as generator:
        outputs = [(name, float) for name in generator.vocs.output_names]
        inputs = [*generator.vocs.variable_names, *generator.vocs.constant_names]

        def simulate(rows: Any, persis_info: Any, _specs: Any, info: Any) -> tuple[Any, Any]:
            """Simulate one point, as a worker of libEnsemble."""
            answers = np.zeros(len(rows), dtype=sim_specs.outputs)
            for row, answer in zip(rows, answers, strict=True):
                number = int(info["H_rows"][0])
                outcome = simulation.run(number, {name: float(row[name]) for name in names})
                _fill(answer, outcome, generator.vocs.output_names)
            return answers, persis_info

        sim_specs = SimSpecs(
            sim_f=simulate,
            inputs=inputs,
            outputs=[*outputs, (SECONDS, float), (ERROR, f"U{_MOST_ERROR}")],
        )
        ensemble = Ensemble(
            libE_specs=LibeSpecs(
                gen_on_manager=True,
                comms="threads",
                nworkers=campaign["workers"],
                disable_log_files=True,
                save_H_and_persis_on_abort=False,
                final_gen_send=True,
                # It would look at the nodes of a batch job by a step of that job, which waits for the workers.
                disable_resource_manager=True,
            ),
            gen_specs=GenSpecs(
                generator=generator,
                initial_batch_size=min(campaign["workers"], budget - len(optimizer.dataset)),
                persis_in=[*inputs, *(n for n, _ in outputs), SECONDS, ERROR],
                vocs=generator.vocs,
            ),
            sim_specs=sim_specs,
            alloc_specs=AllocSpecs(alloc_f=_allocate, user={"async_return": True}),
            exit_criteria=ExitCriteria(sim_max=budget - len(optimizer.dataset)),
        )
        _end_at_signals(simulation, generator)
        # Without a handler it prints the tracebacks of what it raises again.
        logging.getLogger("libensemble").addHandler(logging.NullHandler())
        try:
            ensemble.run()
        except Exception:
            if generator.trouble is None:
                raise
            raise generator.trouble from None
        finally:
            simulation.stop()
        reason = why_barren(generator.records, optimizer.problem.required_diagnostics)
        if reason:
            log.append(EndRecord(time.time(), StopReason.ERROR, MACHINE_ERROR, reason))
        else:
            log.append(EndRecord(time.time(), StopReason.BUDGET))
        log.close()
    if reason:
        raise UserError(f"the campaign failed: {reason}")


def _allocate(*state: Any) -> Any:
    """Allocate work as libEnsemble does, and wait a little if there is none.

    Its manager would look for results thousands of times a second, at the cost of the simulations and of
    the thread that suggests.
    """
    work = only_persistent_gens(*state)
    if not work[0]:
        workers, *_ = state
        time.sleep(max(_POLL, _POLL_OF_WORKER * len(workers)))
    return work


def _end_at_signals(simulation: Simulator, generator: Campaign) -> None:
    """End the process at a signal: libEnsemble would wait for its threads, which wait for simulations."""

    def end(number: int, _frame: object) -> None:
        for each in (signal.SIGINT, signal.SIGTERM):
            signal.signal(each, signal.SIG_IGN)
        simulation.stop()
        try:
            generator.cancel()
        finally:
            print("the campaign was canceled", file=sys.stderr, flush=True)
            os._exit(128 + number)

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, end)


def _fill(answer: Any, outcome: Outcome, names: Sequence[str]) -> None:
    """Write an outcome into a row of libEnsemble's history."""
    for name in names:
        answer[name] = outcome.outputs.get(name, np.nan)
    answer[SECONDS], answer[ERROR] = outcome.seconds, outcome.error[:_MOST_ERROR]


def _simulator(begun: Begun, folder: Path, listen: str | None) -> Simulator:
    """Return what simulates, here or on the hosts whose workers join.

    Raises:
        ParameterError: If it cannot be listened there, or the command is not one.
    """
    campaign = begun.settings["campaign"]
    command, timeout = campaign["command"], campaign["timeout"]
    if listen is None:
        return Simulation(command, timeout, folder / "simulations")
    problem = begun.optimizer.given_problem.to_dict()
    hosts = Hosts(listen, {"command": command, "timeout": timeout, "problem": problem}, folder)
    print(f"workers join by: python -m mobo_tuner.offline.worker {folder}", flush=True)
    return hosts


def main(arguments: Sequence[str] | None = None) -> int:
    """Make one campaign; return the exit status."""
    parser = argparse.ArgumentParser(prog="mobo_tuner.offline.campaign", description="A campaign.")
    parser.add_argument("folder", type=Path, help="folder of the new run")
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument("--config", type=Path, help="parameter file with a section 'campaign'")
    source.add_argument("--resume", type=Path, help="folder of the run to continue")
    for name in ("workers", "evaluations", "seed"):
        parser.add_argument(f"--{name}", type=int, help="in place of the file's")
    parser.add_argument("--listen", help="address of this host, for workers on other hosts")
    options = parser.parse_args(arguments)
    given = {
        name: value
        for name in ("workers", "evaluations", "seed", "listen")
        if (value := getattr(options, name)) is not None
    }
    try:
        if options.resume:
            begun = resume(options.resume, options.folder, given)
        else:
            begun = start(options.config, options.folder, given)
        run(begun, _simulator(begun, options.folder, options.listen))
    except (UserError, OSError) as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())

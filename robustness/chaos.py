"""Kill the processes of a run at random moments, and check that nothing is lost.

The seed and the number of a kill determine the process, the scene, the policy and the moment. Afterwards the run
continues to its end, by itself or by `resume`. The script counts evaluations lost in addition to the one in flight,
hangs, damaged journals and bags, machines at a position that contradicts their policy, and suggestions that differ from
those of an uninterrupted run.

Results are kept in experiments/.cache: an interrupted campaign continues where it stopped.
"""

from __future__ import annotations

import argparse
import json
import re
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, field
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from experiments.problems import cached
from mobo_msgs_py.action import Tune
from mobo_tuner.core.focus import largest_box
from mobo_tuner.core.problem import ProblemError
from mobo_tuner.runs.history import History, told_of
from mobo_tuner.runs.journal import JournalError, JsonRecord, read_journal
from mobo_tuner.runs.optimizer_settings import make_optimizer
from robustness.chaos_scene import CLIENT_TIMEOUT, ROOT, TIMEOUT, HangError, Scene
from robustness.integrity import bag_faults, differing_suggestions, evaluations, has_journal
from robustness.processes import end_with_parent

TARGETS = {"tuner": 0.35, "machine": 0.15, "bridge": 0.2, "recorder": 0.15, "entry script": 0.15}
POLICIES = ("hold", "restore", "best")
BUDGET = 9  # evaluations of a run
TOLERANCE = 0.05  # tolerance of a position, in the toy problem's variables
PATIENCE = 25.0  # [s] for a machine to move to the position of its policy
END_LIMIT = 15.0  # [s] for all processes to end after the entry script was killed


@dataclass
class Outcome:
    """Result of one kill.

    Attributes:
        number: Number of the kill.
        target: Process that was killed.
        scene: Kind of machine: "machine", "bridge" or "mobo.py".
        policy: Policy of the machine if its client is lost.
        moment: Time of the kill since the start of the run [s].
        evaluations: Number of evaluations in the journal at the kill.
        lost: Number of evaluations lost in addition to the one in flight.
        hangs: One sentence per hang.
        corrupt: One sentence per damaged file.
        misplaced: One sentence per wrong position of the machine.
        different: One sentence per difference from an uninterrupted run.
    """

    number: int
    target: str
    scene: str
    policy: str
    moment: float
    evaluations: int = 0
    lost: int = 0
    hangs: list[str] = field(default_factory=list)
    corrupt: list[str] = field(default_factory=list)
    misplaced: list[str] = field(default_factory=list)
    different: list[str] = field(default_factory=list)

    @property
    def well(self) -> bool:
        """Whether there is no fault."""
        return not (self.lost or self.hangs or self.corrupt or self.misplaced or self.different)


class Chaos:
    """A series of kills in scenes that are reused.

    Args:
        folder: Folder of the scenes.
        seed: Seed of the campaign.
    """

    def __init__(self, folder: Path, seed: int) -> None:
        self._folder = folder
        self._seed = seed
        self._scenes: dict[bool, Scene] = {}
        self._script: subprocess.Popen[bytes] | None = None
        self._durations = {"machine": 3.0, "bridge": 8.0, "entry script": 12.0}  # [s] of a run

    def __enter__(self) -> Chaos:
        return self

    def __exit__(self, *error: object) -> None:
        for scene in self._scenes.values():
            scene.__exit__(None, None, None)

    def abandon(self) -> None:
        """Kill everything that was started, from any thread."""
        for scene in list(self._scenes.values()):
            scene.abandon()
        if self._script is not None:
            self._script.kill()

    def kill(self, number: int) -> Outcome:
        """Carry out one kill and return its result.

        Args:
            number: Number of the kill.
        """
        rng = np.random.default_rng([self._seed, number])
        target = str(rng.choice(list(TARGETS), p=list(TARGETS.values())))
        bridged = target == "bridge" or (target != "machine" and bool(rng.random() < 0.4))
        policy = str(rng.choice(POLICIES))
        speed = float(10.0 ** rng.uniform(1.5, 2.5))
        share = float(rng.uniform(0.0, 1.05))
        if target == "entry script":
            return self._kill_entry_script(number, share, speed)
        outcome = Outcome(number, target, "bridge" if bridged else "machine", policy, 0.0)
        scene = self._scenes.get(bridged)
        if scene is None:
            place = self._folder / f"{outcome.scene}-from-{number}"
            shutil.rmtree(place, ignore_errors=True)
            scene = self._scenes[bridged] = Scene(place, bridged=bridged)
        try:
            self._kill_in_scene(scene, outcome, share, speed, rng)
        except HangError as error:
            outcome.hangs.append(str(error))
        outcome.hangs += [f"the {name} ended unexpectedly" for name in scene.dead()]
        outcome.corrupt += [f"a traceback in the log of {name}" for name in scene.tracebacks()]
        if not outcome.well:
            self._scenes.pop(bridged).__exit__(None, None, None)  # its folder stays for inspection
        return outcome

    # ------------------------------------------------------------------ nodes by themselves

    def _kill_in_scene(
        self, scene: Scene, outcome: Outcome, share: float, speed: float, rng: np.random.Generator
    ) -> None:
        if scene.bag_is_old:
            if scene.stop("recorder"):
                outcome.corrupt.append("the recorder ended with an error")
            outcome.corrupt += bag_faults(
                scene.bag, scene.runs_dir, scene.recorded, whole=scene.recorded
            )
        scene.start_missing(outcome.policy, speed)
        outcome.policy = scene.on_client_lost
        before = scene.client.where()
        run_id = f"run-{outcome.number}"
        folder = scene.runs_dir / run_id
        started = time.monotonic()
        scene.begin(Tune.Goal(run_id=run_id, evaluations=BUDGET))
        scene.client.spin(share * self._durations[outcome.scene])
        if outcome.target == "recorder":
            scene.client.spin(0.3 * float(rng.random()))  # between two flushes
        scene.kill(outcome.target)
        killed = time.monotonic()
        outcome.moment = killed - started
        if outcome.target == "tuner":
            where, places = self._judge_tuner(scene, outcome, folder, before, killed)
            scene.start_missing(str(rng.choice(POLICIES)), speed)
            if has_journal(folder):
                self._resume(scene, outcome, folder, before, where, places)
            return
        outcome.evaluations = len(scene.client.heard)
        if outcome.target == "recorder":
            outcome.corrupt += bag_faults(scene.bag, scene.runs_dir, scene.recorded)
        else:
            scene.start_machine(speed)
        result = scene.client.result()
        if result.error_code != Tune.Result.NONE:
            outcome.hangs.append(f"the run did not continue: {result.error_msg}")
        elif outcome.target == "recorder":
            self._durations[outcome.scene] = time.monotonic() - started
        self._judge_kept(outcome, read_journal(folder), scene.client.heard, scene.client.started)

    def _judge_tuner(
        self,
        scene: Scene,
        outcome: Outcome,
        folder: Path,
        before: Mapping[str, float],
        killed: float,
    ) -> tuple[Mapping[str, float], list[Mapping[str, float]]]:
        """Judge the journal and the machine's position after the tuner was killed.

        Returns:
            The position of the machine, and the positions allowed by its policy; none if it holds.
        """
        scene.client.spin(0.5)
        records = read_journal(folder) if has_journal(folder) else []
        outcome.evaluations = len(evaluations(records))
        self._judge_kept(outcome, records, scene.client.heard, scene.client.started)
        places = self._places(records, outcome.policy, before)
        # With "hold", the machine is at rest as soon as it has noticed the loss.
        noticed = killed + CLIENT_TIMEOUT + 1.0
        where = scene.client.watch_until(
            lambda now: not places or _near_any(now, places), noticed, PATIENCE
        )
        if places and not _near_any(where, places):
            outcome.misplaced.append(f"the machine is at {where}, not at {places}")
        return where, places

    def _resume(
        self,
        scene: Scene,
        outcome: Outcome,
        folder: Path,
        before: Mapping[str, float],
        where: Mapping[str, float],
        places: list[Mapping[str, float]],
    ) -> None:
        """Resume the killed run, and compare it; only now the evaluation in flight is known."""
        told = evaluations(read_journal(folder))
        after = f"{folder.name}-on"
        scene.begin(Tune.Goal(run_id=after, resume_from=folder.name, evaluations=BUDGET + 2))
        result = scene.client.result()
        if result.error_code != Tune.Result.NONE:
            outcome.different.append(f"the run could not be resumed: {result.error_msg}")
            return
        resumed = read_journal(folder.parent / after)
        outcome.different += _differences(told, resumed)
        visited = [record["setpoint"] for record in evaluations(resumed)[: len(told) + 1]]
        start, end = [before, *visited][-2:]
        if not places and not _between(where, start, end):
            outcome.misplaced.append(f"the machine holds at {where}, not between {start} and {end}")

    def _judge_kept(
        self, outcome: Outcome, records: list[JsonRecord], heard: list[Any], begun: set[bytes]
    ) -> None:
        """Count evaluations that were published, or begun by the machine, but are not in the journal.

        One evaluation may be in flight.
        """
        told = evaluations(records)
        missing = {(m.index, m.hypervolume) for m in heard} - {
            (record["index"], record["hypervolume"]) for record in told
        }
        attempts = sum(record["attempts"] for record in told)
        outcome.lost += len(missing) + max(0, len(begun) - attempts - 1)

    def _places(
        self, records: list[JsonRecord], policy: str, before: Mapping[str, float]
    ) -> list[Mapping[str, float]]:
        """Return the positions allowed by the policy; none if the machine holds."""
        told = evaluations(records)
        if policy == "hold" or any(record["type"] == "end" for record in records):
            return []
        if policy == "restore":
            return [before]
        # The best point when the evaluation in flight began, or the previous one.
        counts = (len(told), len(told) - 1)
        bests = [_best(records, count) for count in counts if count >= 0]
        return [] if None in bests else [best for best in bests if best is not None]

    # ------------------------------------------------------------------ the entry script

    def _kill_entry_script(self, number: int, share: float, speed: float) -> Outcome:
        outcome = Outcome(number, "entry script", "mobo.py", "hold", 0.0)
        place = self._folder / f"mobo-{number}"
        shutil.rmtree(place, ignore_errors=True)
        run_id = f"run-{number}"
        folder = place / run_id
        config = ("--config", str(ROOT / "config" / "toy.yaml"))
        budget = ("--evaluations", str(BUDGET), "--speed", f"{speed:.3g}")
        started = time.monotonic()
        process = self._script = _mobo(
            "run", *config, *budget, "--runs-dir", str(place), "--run-id", run_id
        )
        try:
            process.wait(share * self._durations["entry script"])
            self._durations["entry script"] = time.monotonic() - started
        except subprocess.TimeoutExpired:
            process.kill()
        process.communicate()
        outcome.moment = time.monotonic() - started
        deadline = time.monotonic() + END_LIMIT
        while (left := _mentioning(str(place))) and time.monotonic() < deadline:
            time.sleep(0.1)  # between two looks, until the deadline
        if left:
            outcome.hangs.append(f"{len(left)} processes did not end: {left[0]}")
        try:
            self._judge_mobo(outcome, folder)
        except JournalError as error:
            outcome.corrupt.append(str(error))
        if outcome.well:
            shutil.rmtree(place, ignore_errors=True)  # missing if the script was killed early
        return outcome

    def _judge_mobo(self, outcome: Outcome, folder: Path) -> None:
        kept = has_journal(folder)
        told = evaluations(read_journal(folder)) if kept else []
        outcome.evaluations = len(told)
        if (folder / "bag").exists():
            outcome.corrupt += bag_faults(folder / "bag", folder.parent, [folder.name])
        words = ("resume", folder.name, "--runs-dir", str(folder.parent))
        process = self._script = _mobo(*words, "--evaluations", str(BUDGET + 2))
        try:
            _, said = process.communicate(timeout=TIMEOUT)
        except subprocess.TimeoutExpired:
            process.send_signal(signal.SIGTERM)
            process.communicate()
            outcome.hangs.append("mobo.py resume did not end")
            return
        text = said.decode(errors="replace")
        if "Traceback" in text:
            outcome.corrupt.append(text[-300:])
        if not kept:
            if process.returncode == 0:
                outcome.different.append("a run without a journal was resumed")
        elif process.returncode:
            outcome.different.append(f"the run could not be resumed: {text[-300:]}")
        else:
            after = folder.with_name(f"{folder.name}-2")
            outcome.different += _differences(told, read_journal(after))
            names = [after.name]
            outcome.corrupt += bag_faults(after / "bag", folder.parent, names, whole=names)


def _differences(told: list[JsonRecord], resumed: list[JsonRecord]) -> list[str]:
    """Return how a resumed run differs from an uninterrupted one."""
    faults = []
    if evaluations(resumed)[: len(told)] != told:
        faults.append("the resumed run does not begin with the evaluations of the killed run")
    if different := differing_suggestions(resumed):
        faults.append(f"suggestions differ from those of an uninterrupted run: {different}")
    return faults


def _best(records: list[JsonRecord], count: int) -> Mapping[str, float] | None:
    """Return the best point of the first `count` evaluations, or None."""
    history = History.from_records([records[0], *evaluations(records)[:count]])
    try:
        optimizer = make_optimizer(history.problem, history.settings)
        for step in history.evaluations:
            optimizer.tell(*told_of(step, history.problem, history.model_input))
    except ProblemError as error:
        raise JournalError(str(error)) from None
    best = largest_box(history.problem, optimizer.pareto_front())
    return dict(best["setpoint"]) if best else None


def _near_any(now: Mapping[str, float], places: Sequence[Mapping[str, float]]) -> bool:
    return any(
        all(abs(now[name] - value) <= TOLERANCE for name, value in place.items())
        for place in places
    )


def _between(
    now: Mapping[str, float], start: Mapping[str, float], end: Mapping[str, float]
) -> bool:
    return all(
        min(start[name], end[name]) - TOLERANCE <= value <= max(start[name], end[name]) + TOLERANCE
        for name, value in now.items()
    )


def _mobo(*words: str) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [sys.executable, str(ROOT / "mobo.py"), *words],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        start_new_session=True,
    )


def _mentioning(text: str) -> list[str]:
    """Return the command lines of running processes that contain a text."""
    found = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            words = path.read_bytes().replace(b"\0", b" ").decode(errors="replace").strip()
        except OSError:
            continue
        if text in words:
            found.append(words)
    return found


def summary(outcomes: list[Outcome]) -> str:
    """Return a summary of all results for people."""
    targets = Counter(outcome.target for outcome in outcomes)
    policies = Counter(outcome.policy for outcome in outcomes if outcome.target == "tuner")
    lines = [
        f"{len(outcomes)} kills: " + ", ".join(f"{n} {name}" for name, n in targets.items()),
        f"  under the policies {dict(policies)}; "
        f"{sum(o.evaluations for o in outcomes)} evaluations before the kills",
        f"evaluations lost besides the one in flight  {sum(o.lost for o in outcomes)}",
        f"hangs                                       {sum(bool(o.hangs) for o in outcomes)}",
        f"corrupt runs                                {sum(bool(o.corrupt) for o in outcomes)}",
        f"machines at a wrong position                {sum(bool(o.misplaced) for o in outcomes)}",
        f"runs that continued differently             {sum(bool(o.different) for o in outcomes)}",
    ]
    return "\n".join(lines)


def make_kills(numbers: Sequence[int], seed: int, worker: int, end: float) -> None:
    """Carry out some of the kills, and save the result of each.

    Args:
        numbers: Numbers of the kills.
        seed: Seed of the campaign.
        worker: Number of this process.
        end: Time after which no more kills are started, by `time.time` [s].
    """
    folder = cached(f"chaos-{seed}") / f"worker-{worker}"
    with Chaos(folder, seed) as chaos, _results(seed).open("a", encoding="utf-8") as file:
        end_with_parent(chaos.abandon)
        for number in numbers:
            if time.time() > end:
                return
            outcome = chaos.kill(number)
            print(json.dumps(asdict(outcome)), file=file, flush=True)
            verdict = "well" if outcome.well else re.sub(r"\s+", " ", str(asdict(outcome)))
            print(
                f"{number:4d} {outcome.target:<12} {outcome.policy:<8} at {outcome.moment:5.1f} s, "
                f"{outcome.evaluations} evaluations: {verdict}",
                flush=True,
            )


def kept_outcomes(seed: int) -> dict[int, Outcome]:
    """Return the saved results by the numbers of the kills."""
    path = _results(seed)
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    return {outcome.number: outcome for outcome in (Outcome(**json.loads(line)) for line in lines)}


def _results(seed: int) -> Path:
    return cached(f"chaos-{seed}.jsonl")


def main() -> int:
    """Carry out the missing kills, and print the summary of all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=200, metavar="N", help="number of kills")
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="seed of the campaign")
    parser.add_argument("--workers", type=int, default=2, help="number of simultaneous kills")
    parser.add_argument(
        "--minutes", type=float, default=600.0, help="time after which no kill is started [min]"
    )
    parser.add_argument("--fresh", action="store_true", help="discard the saved results")
    options = parser.parse_args()
    if options.fresh:
        _results(options.seed).unlink(missing_ok=True)
    end = time.time() + 60.0 * options.minutes
    missing = sorted(set(range(options.kills)) - set(kept_outcomes(options.seed)))
    with ProcessPoolExecutor(options.workers, mp_context=get_context("spawn")) as pool:
        workers = [
            pool.submit(make_kills, missing[n :: options.workers], options.seed, n, end)
            for n in range(options.workers)
        ]
        for worker in workers:
            worker.result()
    outcomes = [o for n, o in sorted(kept_outcomes(options.seed).items()) if n < options.kills]
    print(summary(outcomes))
    return 0 if len(outcomes) == options.kills and all(o.well for o in outcomes) else 1


if __name__ == "__main__":
    sys.exit(main())

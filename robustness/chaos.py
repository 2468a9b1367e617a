"""Kill what makes up a run, at random moments, and see that nothing is lost.

Each kill is drawn from the seed and its number: which process, in which scene, under which policy, when. Afterwards
the run goes on, by itself or by `resume`, to its end. Counted are evaluations lost beyond the one in flight, waits
without end, journals and bags that are not whole, machines that are not where the policy says, and suggestions that
an uninterrupted run would not have made.

Results are kept in robustness/.cache as they come: what was stopped goes on where it was.
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
from mobo_tuner.runs.history import History
from mobo_tuner.runs.journal import JournalError, Record, read_journal
from mobo_tuner.runs.optimizer_settings import make_optimizer
from robustness.chaos_scene import CLIENT_TIMEOUT, ROOT, TIMEOUT, HangError, Scene
from robustness.kept_runs import bag_faults, differing_suggestions, evaluations, has_journal

TARGETS = {"tuner": 0.35, "machine": 0.15, "bridge": 0.2, "recorder": 0.15, "entry script": 0.15}
POLICIES = ("hold", "restore", "best")
BUDGET = 9  # evaluations of a run
TOLERANCE = 0.05  # of a set-point of the toy problem
PATIENCE = 25.0  # [s] for a machine to go where its policy says
END_LIMIT = 15.0  # [s] for everything to end after the entry script was killed


@dataclass
class Outcome:
    """What came of one kill.

    Attributes:
        number: of the kill.
        target: what was killed.
        scene: around which machine.
        policy: of the machine, when its client is lost.
        moment: after the beginning of the run [s].
        evaluations: that the run had when the kill came, by its journal.
        lost: evaluations lost beyond the one in flight.
        hangs, corrupt, misplaced, different: one sentence for each fault of that kind.
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
        """Whether nothing is wrong."""
        return not (self.lost or self.hangs or self.corrupt or self.misplaced or self.different)


class Chaos:
    """Makes kills one after another, in scenes that live on between them."""

    def __init__(self, folder: Path, seed: int) -> None:
        self._folder = folder
        self._seed = seed
        self._scenes: dict[bool, Scene] = {}
        self._durations = {"machine": 3.0, "bridge": 8.0, "entry script": 12.0}  # [s] of a run

    def __enter__(self) -> Chaos:
        return self

    def __exit__(self, *error: object) -> None:
        for scene in self._scenes.values():
            scene.__exit__(None, None, None)

    def kill(self, number: int) -> Outcome:
        """Make one kill and see what comes of it."""
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
        outcome.hangs += [f"the {name} ended of itself" for name in scene.dead()]
        outcome.corrupt += [f"a traceback in the log of {name}" for name in scene.tracebacks()]
        if not outcome.well:
            self._scenes.pop(bridged).__exit__(
                None, None, None
            )  # its folder stays, to be looked at
        return outcome

    # ------------------------------------------------------------------ nodes by themselves

    def _kill_in_scene(
        self, scene: Scene, outcome: Outcome, share: float, speed: float, rng: np.random.Generator
    ) -> None:
        if scene.bag_is_old:
            if scene.stop("recorder"):
                outcome.corrupt.append("the recorder did not end well")
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
                self._go_on(scene, outcome, folder, before, where, places)
            return
        outcome.evaluations = len(scene.client.heard)
        if outcome.target == "recorder":
            outcome.corrupt += bag_faults(scene.bag, scene.runs_dir, scene.recorded)
        else:
            scene.start_machine(speed)
        result = scene.client.result()
        if result.error_code != Tune.Result.NONE:
            outcome.hangs.append(f"the run did not go on: {result.error_msg}")
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
        """After the tuner was killed: what is kept, where the machine is, and where it should be."""
        scene.client.spin(0.5)
        records = read_journal(folder) if has_journal(folder) else []
        outcome.evaluations = len(evaluations(records))
        self._judge_kept(outcome, records, scene.client.heard, scene.client.started)
        places = self._places(records, outcome.policy, before)
        # Where it holds it is at rest anyway, once it has noticed.
        noticed = killed + CLIENT_TIMEOUT + 1.0
        where = scene.client.watch_until(
            lambda now: not places or _near_any(now, places), noticed, PATIENCE
        )
        if places and not _near_any(where, places):
            outcome.misplaced.append(f"it is at {where}, not at {places}")
        return where, places

    def _go_on(
        self,
        scene: Scene,
        outcome: Outcome,
        folder: Path,
        before: Mapping[str, float],
        where: Mapping[str, float],
        places: list[Mapping[str, float]],
    ) -> None:
        """Resume the run that was killed, and compare; only now is known what was in flight."""
        told = evaluations(read_journal(folder))
        after = f"{folder.name}-on"
        scene.begin(Tune.Goal(run_id=after, resume_from=folder.name, evaluations=BUDGET + 2))
        result = scene.client.result()
        if result.error_code != Tune.Result.NONE:
            outcome.different.append(f"it did not go on: {result.error_msg}")
            return
        resumed = read_journal(folder.parent / after)
        outcome.different += _differences(told, resumed)
        visited = [record["setpoint"] for record in evaluations(resumed)[: len(told) + 1]]
        start, end = [before, *visited][-2:]
        if not places and not _between(where, start, end):
            outcome.misplaced.append(f"it holds at {where}, not between {start} and {end}")

    def _judge_kept(
        self, outcome: Outcome, records: list[Record], heard: list[Any], begun: set[bytes]
    ) -> None:
        """Whether the journal has all that was told, and all that the machine began but one."""
        told = evaluations(records)
        missing = {(m.index, m.hypervolume) for m in heard} - {
            (record["index"], record["hypervolume"]) for record in told
        }
        attempts = sum(record["attempts"] for record in told)
        outcome.lost += len(missing) + max(0, len(begun) - attempts - 1)

    def _places(
        self, records: list[Record], policy: str, before: Mapping[str, float]
    ) -> list[Mapping[str, float]]:
        """Where the machine may be by its policy; nowhere in particular where it holds."""
        told = evaluations(records)
        if policy == "hold" or any(record["type"] == "end" for record in records):
            return []
        if policy == "restore":
            return [before]
        # The best there was when the evaluation in flight began, or the one before.
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
        process = _mobo("run", *config, *budget, "--runs-dir", str(place), "--run-id", run_id)
        try:
            process.wait(share * self._durations["entry script"])
            self._durations["entry script"] = time.monotonic() - started
        except subprocess.TimeoutExpired:
            process.kill()
        process.communicate()
        outcome.moment = time.monotonic() - started
        deadline = time.monotonic() + END_LIMIT
        while (left := _mentioning(str(place))) and time.monotonic() < deadline:
            time.sleep(0.1)
        if left:
            outcome.hangs.append(f"{len(left)} processes are left: {left[0]}")
        try:
            self._judge_mobo(outcome, folder)
        except JournalError as error:
            outcome.corrupt.append(str(error))
        if outcome.well:
            shutil.rmtree(place, ignore_errors=True)  # where it was killed before it made any
        return outcome

    def _judge_mobo(self, outcome: Outcome, folder: Path) -> None:
        kept = has_journal(folder)
        told = evaluations(read_journal(folder)) if kept else []
        outcome.evaluations = len(told)
        if (folder / "bag").exists():
            outcome.corrupt += bag_faults(folder / "bag", folder.parent, [folder.name])
        words = ("resume", folder.name, "--runs-dir", str(folder.parent))
        process = _mobo(*words, "--evaluations", str(BUDGET + 2))
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
                outcome.different.append("a run that was not kept was resumed")
        elif process.returncode:
            outcome.different.append(f"it did not go on: {text[-300:]}")
        else:
            after = folder.with_name(f"{folder.name}-2")
            outcome.different += _differences(told, read_journal(after))
            names = [after.name]
            outcome.corrupt += bag_faults(after / "bag", folder.parent, names, whole=names)


def _differences(told: list[Record], resumed: list[Record]) -> list[str]:
    """How a resumed run differs from what an uninterrupted one would have been."""
    faults = []
    if evaluations(resumed)[: len(told)] != told:
        faults.append("the resumed run does not begin as the one that was killed")
    if different := differing_suggestions(resumed):
        faults.append(f"other suggestions than an uninterrupted run's: {different}")
    return faults


def _best(records: list[Record], count: int) -> Mapping[str, float] | None:
    """The best point that the first `count` evaluations know; None where they know none."""
    history = History.from_records([records[0], *evaluations(records)[:count]])
    try:
        optimizer = make_optimizer(history.problem, history.settings)
        for step in history.evaluations:
            optimizer.tell(step.setpoint, step.outputs)
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
    """Command lines of living processes that mention a folder."""
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
    """What came of all kills, for a person to read."""
    targets = Counter(outcome.target for outcome in outcomes)
    policies = Counter(outcome.policy for outcome in outcomes if outcome.target == "tuner")
    lines = [
        f"{len(outcomes)} kills: " + ", ".join(f"{n} {name}" for name, n in targets.items()),
        f"  under the policies {dict(policies)}; "
        f"{sum(o.evaluations for o in outcomes)} evaluations were there when the kills came",
        f"evaluations lost beyond the one in flight   {sum(o.lost for o in outcomes)}",
        f"hangs                                       {sum(bool(o.hangs) for o in outcomes)}",
        f"corrupt runs                                {sum(bool(o.corrupt) for o in outcomes)}",
        f"machines not where the policy says          {sum(bool(o.misplaced) for o in outcomes)}",
        f"runs that went on otherwise                 {sum(bool(o.different) for o in outcomes)}",
    ]
    return "\n".join(lines)


def make_kills(numbers: Sequence[int], seed: int, worker: int, end: float) -> None:
    """Make some of the kills, and keep what comes of each.

    Args:
        numbers: of the kills.
        seed: from which they are drawn.
        worker: number of this process.
        end: after which no more is begun, by `time.time` [s].
    """
    folder = cached(f"chaos-{seed}") / f"worker-{worker}"
    with Chaos(folder, seed) as chaos, _results(seed).open("a", encoding="utf-8") as file:
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
    """What came of the kills that were made already, by their numbers."""
    path = _results(seed)
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    return {outcome.number: outcome for outcome in (Outcome(**json.loads(line)) for line in lines)}


def _results(seed: int) -> Path:
    return cached(f"chaos-{seed}.jsonl")


def main() -> int:
    """Make the kills that are missing, and print what came of all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=200, metavar="N")
    parser.add_argument("--seed", type=int, default=0, metavar="S")
    parser.add_argument("--workers", type=int, default=2, help="kills at a time")
    parser.add_argument("--minutes", type=float, default=600.0, help="after which none is begun")
    parser.add_argument("--fresh", action="store_true", help="forget what was kept")
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

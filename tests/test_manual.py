"""Every command of the operators' manual does what it says, over one run of permanent nodes."""

from __future__ import annotations

import itertools
import re
import shlex
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

import mobo
from launcher.command_line import STEERING, make_parser
from mobo_tuner.client import Evaluation, RunResult, TunerClient
from mobo_tuner.nodes import steer
from mobo_tuner.runs.history import History
from mobo_tuner.runs.journal import read_journal
from mobo_tuner.runs.rebuild import records_of_bag
from tests.support.processes import NodeProcess, NodeStarter, wait_until
from tests.support.tuner import EASY

MANUAL = Path(__file__).parents[1] / "docs" / "operations.md"
ROOT = MANUAL.parents[1]
CONFIG = f"""{EASY}
    constraints:
      transmission: {{min: 0.0}}
/**/awa_sim:
  ros__parameters: {{speed: 1000.0, mode: ideal}}
"""
REST = "phi1=-5 phi2=-5 G1=70 G2=20"  # of the set-point that the manual abbreviates
ENDING = ("stop", "cancel")  # verbs that end the run, and `watch` with it
AFTERWARDS = ("points", "go")  # verbs for working points
EVALUATIONS = 14  # of a run before it is steered: the manual withdraws number 12
BUDGET = 10_000


def shell_commands() -> list[tuple[list[str], str]]:
    """The words of each command after `python3 mobo.py`, and the line that follows it in the manual."""
    found = []
    for block in re.findall(r"^```\w*\n(.*?)^```", MANUAL.read_text(), re.MULTILINE | re.DOTALL):
        for line, following in itertools.pairwise([*block.splitlines(), ""]):
            if line.startswith("python3 mobo.py "):
                found.append((shlex.split(line, comments=True)[2:], following))
    return found


def table_commands() -> list[list[str]]:
    """The words of each verb in the table of the section about steering."""
    section = MANUAL.read_text().partition("\n## Steer\n")[2].partition("\n## ")[0]
    rows = [line.split(" | ") for line in section.splitlines() if line.startswith("| ")]
    verbs = [text for row in rows for text in re.findall(r"`([^`]+)`", row[1])]
    return [shlex.split(verb.replace("...", REST)) for verb in verbs]


def steering_commands() -> list[list[str]]:
    """All verbs for a running tuner, those of the table first."""
    known = table_commands()
    return [*known, *(words for words, _ in shell_commands() if words[0] in STEERING)]


def test_the_manual_names_every_verb_for_a_running_tuner() -> None:
    named = {words[0] for words in steering_commands()}
    assert named | {"unforget"} == set(STEERING)  # that one is in the text of `forget`


@pytest.mark.parametrize(
    "words", [words for words, _ in shell_commands() if words[0] not in STEERING], ids=" ".join
)
def test_a_command_that_needs_no_tuner_is_understood(words: list[str]) -> None:
    """They are carried out by the tests in tests/system."""
    options = make_parser("", ROOT, mobo.VERBS).parse_args(words)
    assert options.act is mobo.VERBS[words[0]]
    if words[0] == "run":
        assert (ROOT / options.config).is_file()


def permanent_nodes() -> list[list[str]]:
    """The words of each command of the section about permanent nodes."""
    block = MANUAL.read_text().partition("**Permanent nodes**")[2].partition("```\n")[2]
    lines = block.partition("```")[0].splitlines()
    return [shlex.split(line, comments=True) for line in lines if not line.startswith("export ")]


def test_a_shift_by_hand(start_node: NodeStarter, tmp_path: Path) -> None:
    """The nodes of the manual, a run, the way back, and the end in the order that it names."""
    modules = {"awa_sim": "awa_sim_node.node"}

    def start(words: list[str]) -> NodeProcess:
        name = Path(words[0]).name
        options = [
            word.replace("evaluations:=60", "evaluations:=6")
            .replace("config/", f"{ROOT}/config/")
            .replace(":=runs", f":={tmp_path}/runs")
            .replace(":=bags", f":={tmp_path}/bags")
            for word in words[1:]
        ]
        return start_node("-m", modules.get(name, f"mobo_tuner.nodes.{name}"), *options)

    *permanent, console = permanent_nodes()
    machine, tuner, recorder = map(start, permanent)
    wait_until(lambda: "ready" in machine.stderr and "ready" in tuner.stderr, "the nodes", 60.0)
    assert start(console).wait(120.0) == 0
    [run_dir] = (tmp_path / "runs").iterdir()
    assert len(History.from_records(read_journal(run_dir)).evaluations) == 6
    assert steer.run(["go", "--before"]) == 0
    for node in (tuner, recorder, machine):
        assert node.stop() == 0, node.stderr
    recorded = records_of_bag(tmp_path / "bags" / "shift-1", run_dir.name)
    assert len(History.from_records(recorded).evaluations) == 6


class Tuning:
    """Runs that end when a verb ends them, one after the other."""

    def __init__(self) -> None:
        self._thread: threading.Thread | None = None
        self._paused = threading.Event()
        self.results: list[RunResult] = []

    def begin(self) -> None:
        """Begin a run unless one is active, and wait until it is paused after some evaluations."""
        if self._thread is not None and self._thread.is_alive():
            return
        self._paused.clear()
        self._thread = threading.Thread(target=self._tune, daemon=True)
        self._thread.start()
        assert self._paused.wait(120.0)

    def end(self) -> None:
        """Wait for the end of the run."""
        if self._thread is not None:
            self._thread.join(60.0)
            assert not self._thread.is_alive()

    def _tune(self) -> None:
        with TunerClient() as client:

            def pause(evaluation: Evaluation) -> None:
                """Pause at once: a slow computer would only notice when many more are made."""
                if evaluation.index == EVALUATIONS - 1:
                    client.pause()
                    self._paused.set()

            self.results.append(client.tune(evaluations=BUDGET, on_evaluation=pause))


@pytest.fixture
def tuning(
    start_machine: Callable[..., NodeProcess],
    start_tuner: Callable[..., NodeProcess],
    tmp_path: Path,
) -> Tuning:
    config = tmp_path / "manual.yaml"
    config.write_text(CONFIG)
    start_machine(config=config)
    start_tuner("initial_evaluations:=500", "proximal:=costs", config=config)
    return Tuning()


def test_the_verbs_of_the_manual_do_what_it_says(
    tuning: Tuning, capsys: pytest.CaptureFixture[str]
) -> None:
    def carry_out(*words: str) -> int:
        capsys.readouterr()
        return steer.run(words)

    expected = {tuple(words): line for words, line in shell_commands()}
    for words in steering_commands():
        verb = words[0]
        if verb in AFTERWARDS:
            continue
        tuning.begin()
        assert carry_out("pause") == 0  # so that the run stays where it is
        if verb == "watch":  # it ends with the run
            watching = threading.Thread(target=steer.run, args=(words,), daemon=True)
            watching.start()
            assert carry_out("continue") == 0
            assert carry_out("stop") == 0
            watching.join(60.0)
            assert not watching.is_alive()
            tuning.end()
        elif verb == "skip":
            assert carry_out("continue") == 0
            wait_until(lambda: carry_out("skip") == 0, "an evaluation in flight", 30.0, 0.0)
        elif expected.get(tuple(words), "").startswith("refused: "):
            assert carry_out(*words) == 1
            assert capsys.readouterr().err.strip() == expected[tuple(words)]
        else:
            assert carry_out(*words) == 0, (words, capsys.readouterr().err)
        if verb in ENDING:
            tuning.end()
        if any(word.startswith("evaluations=") for word in words):
            # So that the run does not end by itself between two of the verbs that follow.
            assert carry_out("set", f"evaluations={BUDGET}") == 0
    tuning.begin()
    easy = ("objectives.dE.reference=1000", "constraints.transmission.min=0.0")
    wide = ("variables.K1.min=400", "variables.K1.max=550")
    assert carry_out("set", *easy, *wide) == 0, capsys.readouterr().err
    assert carry_out("stop") == 0
    tuning.end()
    index = str(tuning.results[-1].front.points[0].index)
    for words in steering_commands():
        if words[0] in AFTERWARDS:
            told = [index if word == "31" else "1" if word == "30" else word for word in words]
            assert carry_out(*told) == 0, (told, capsys.readouterr().err)
            assert capsys.readouterr().out

"""Steering from the shell: each verb with a real tuner at the other end."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from collections.abc import Callable

import pytest

from mobo_tuner.nodes import steer
from tests.support.processes import NodeProcess, NodeStarter, wait_until

Start = Callable[..., NodeProcess]
ENDLESS = "100000"


class Shell:
    """The commands of an operator; those that take long are processes."""

    def __init__(self, start: NodeStarter, output: pytest.CaptureFixture[str]) -> None:
        self._start = start
        self._output = output

    def __call__(self, *words: str, status: int = 0) -> str:
        """Return what a command prints."""
        assert steer.run(words) == status, self._output.readouterr().err
        printed = self._output.readouterr()
        return printed.err if status else printed.out

    def refused(self, *words: str) -> str:
        """Return the sentence of a command that is refused."""
        [sentence] = self(*words, status=1).splitlines()
        assert sentence.startswith("refused: ")
        return sentence

    def begin(self, *words: str) -> NodeProcess:
        """Start a command as a process."""
        return self._start("-u", "-m", "mobo_tuner.nodes.steer", *words)

    def tune(self) -> NodeProcess:
        """Start a run that does not end by itself."""
        parameters = ("-p", f"evaluations:={ENDLESS}", "-p", "wait_for_recorder:=false")
        return self._start("-m", "mobo_tuner.nodes.console", "--ros-args", *parameters)


@pytest.fixture
def shell(
    request: pytest.FixtureRequest,
    start_node: NodeStarter,
    start_machine: Start,
    start_tuner: Start,
    capsys: pytest.CaptureFixture[str],
) -> Shell:
    """A shell where a tuner and a machine of the toy problem are running, which may be a slow one."""
    start_machine(f"speed:={getattr(request, 'param', 2.0)}")
    start_tuner("initial_evaluations:=4")
    return Shell(start_node, capsys)


def test_a_run_is_steered(shell: Shell) -> None:
    assert shell("status") == "idle\n"
    for verb in ("pause", "continue", "step", "skip", "stop", "watch", "cancel"):
        shell.refused(verb)
    console = shell.tune()
    wait_until(lambda: len(console.stdout.splitlines()) >= 6, "evaluations", 60.0)
    assert "evaluation" in shell("pause")
    wait_until(
        lambda: shell("status").startswith("paused; run "),
        "the end of the evaluation",
        period=0.3,  # [s]; each call is a node of its own
    )
    assert shell("queue", "x1=0.5", "x2=-1e-1") == "set-points in the queue: 1\n"
    view = shell.begin("watch")
    wait_until(lambda: "evaluation" in view.stdout, "the view")
    changed = shell("set", "variables.x1.max=1.5", "evaluations=900", "objectives.f1.reference=4")
    assert changed == "set: variables.x1.max, evaluations, objectives.f1.reference\n"
    assert "objectives.f1.truncation" in shell(
        "set", "objectives.f1.truncation=[0, 5.5]", "objectives.f2.truncation=[0,6]"
    )
    assert "variables.x1.min" in shell.refused("set", "variables.x1.max=-9")
    meant = "'variables.y.max'; did you mean 'variables.x"
    assert meant in shell.refused("set", "variables.y.max=1")
    assert "did you mean 'variables.x2.min'?" in shell.refused("set", "x2.min=1")
    assert "evaluations" in shell.refused("set", 'evaluations={"a": 1}')
    assert "seed is read when the tuner starts" in shell.refused("set", "seed=3")
    assert "x2" in shell.refused("queue", "x1=0.5")
    assert "x1 is given twice" in shell.refused("queue", "x1=0.5", "x2=0.5", "x1=0.4")
    assert "'high'" in shell.refused("queue", "x1=high", "x2=0")
    assert "evaluation" in shell("step")
    wait_until(lambda: " of 900 done" in view.stdout, "the step")
    assert "paused: " in view.stdout
    shell("continue")
    assert "evaluation" in shell("stop")
    assert console.wait(30.0) == 0
    assert view.wait(30.0) == 0
    assert re.search(r"run \S+ has ended \(stopped\): \d+ of 900", view.stdout.splitlines()[-1])
    indices = [int(i) for i in re.findall(r"^evaluation +(\d+),", view.stdout, re.MULTILINE)]
    assert indices == list(range(len(indices)))


@pytest.mark.parametrize("shell", [0.001], indirect=True)  # an evaluation takes ten seconds
def test_an_evaluation_in_flight_is_skipped(shell: Shell) -> None:
    console = shell.tune()
    wait_until(lambda: shell("status").startswith("evaluating"), "an evaluation", period=0.3)
    assert shell("skip") == "evaluation 0 is skipped, which counts as failed\n"
    wait_until(lambda: re.search(r"^evaluation +0,", console.stdout, re.MULTILINE), "its line")
    assert "canceled" in shell("cancel")
    assert console.wait() == 130


def test_a_run_is_watched_for_a_while_and_canceled_from_elsewhere(shell: Shell) -> None:
    console = shell.tune()
    wait_until(lambda: len(console.stdout.splitlines()) >= 3, "evaluations", 60.0)
    view = shell.begin("watch")
    wait_until(lambda: "evaluation" in view.stdout, "the view")
    view.popen.send_signal(signal.SIGINT)
    assert view.wait() == 0
    assert view.stdout.splitlines()[-1].endswith("continues")
    # So does a view that nobody reads any more, as in `mobo.py watch | head -1`.
    command = (sys.executable, "-u", "-m", "mobo_tuner.nodes.steer", "watch")
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as unread:
        assert unread.stdout is not None
        assert unread.stderr is not None
        unread.stdout.readline()
        unread.stdout.close()
        assert unread.wait(60.0) == 0
        assert unread.stderr.read() == b""
    assert shell("status").startswith(("evaluating", "suggesting"))
    assert "canceled" in shell("cancel")
    assert console.wait() == 130
    assert "idle" in shell("status")


def test_working_points_are_listed_and_gone_to(shell: Shell) -> None:
    assert "no front" in shell.refused("points")
    console = shell.tune()
    wait_until(lambda: len(console.stdout.splitlines()) >= 9, "evaluations", 60.0)
    shell("stop")
    assert console.wait() == 0
    lines = shell("points", "--sort", "f2", "--predict", "--top", "0").splitlines()
    run_id = re.search(r"points of run (\S+), measured; hypervolume ", lines[0])
    assert run_id
    assert lines[1].split() == ["index", "f1", "f2"]
    measured = [line.split() for line in lines[2 : lines.index("")]]
    assert [float(row[2]) for row in measured] == sorted(float(row[2]) for row in measured)
    assert "predicted" in lines[lines.index("") + 1]
    assert lines[-1].split()[0] == "-"
    top = shell("points", "--sort", "x1", "--top", "1").splitlines()
    assert top[0].startswith(f"1 of {len(measured)} points")
    assert top[1].split() == ["index", "f1", "f2", "x1"]
    assert len(top) == 4
    assert "--top 0" in top[-1]
    whole = shell("points", "--top", "0").splitlines()
    assert len(whole) == 2 + len(measured)
    wanted = dict(zip(lines[1].split()[1:], measured[-1][1:], strict=True))
    near = shell("points", "--near", *(f"{name}={value}" for name, value in wanted.items()))
    assert near.splitlines()[2].split()[0] == measured[-1][0]
    assert "'f3'" in shell.refused("points", "--sort", "f3")
    assert "'f3'" in shell.refused("points", "--near", "f3=1")
    assert "--near" in shell.refused("points", "--sort", "f1", "--near", "f2=1")

    index = measured[0][0]
    at = shell("go", index, "--hold", "2")
    assert at.startswith(f"at point {index} of run {run_id[1]}, held with 2 evaluations: x1 = ")
    promised = [line.split() for line in at.splitlines()[1:]]
    assert promised[0] == ["promised", "measured", "now", "difference"]
    assert [row[0] for row in promised[1:]] == ["f1", "f2"]
    for row in promised[1:]:
        assert float(row[3]) == pytest.approx(float(row[2]) - float(row[1]), abs=2e-3)
    unmeasured = shell("go", "--weights", "f2=2", "--no-measurement")
    assert unmeasured.startswith("at point ")
    assert len(unmeasured.splitlines()) == 1
    before = shell("go", "--before")
    assert before.startswith(f"at the state before run {run_id[1]}: x1 = ")
    assert before.splitlines()[2].split()[:2] == ["f1", "-"]  # nothing is promised there
    assert "4000" in shell.refused("go", "4000", "--run", run_id[1])
    assert "index" in shell.refused("go")


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["queue", "x1"], "'x1'"),
        (["go", "--weights", "f1=high"], "'high'"),
        (["queue", f"x1=1{'0' * 400}"], "x1"),
        (["go", "-1"], "-1"),
        (["go", "4294967296"], "'4294967296'"),
        (["halt"], "halt"),
    ],
)
def test_a_slip_on_the_command_line_is_named(
    start_node: NodeStarter, words: list[str], named: str
) -> None:
    process = start_node("-m", "mobo_tuner.nodes.steer", *words)
    assert process.wait() == 2
    assert named in process.stderr
    assert "Traceback" not in process.stderr


def test_the_nearest_points_of_an_empty_front_are_none() -> None:
    assert steer._nearest([], {"f1": 1.0}) == []


def test_a_slip_on_the_command_line_is_one_sentence(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        steer.run(["go", "-1"])
    assert ended.value.code == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("steer go: ")
    assert "'-1' is not an integer of at least 0" in line

"""The console: one run from its goal to its exit status."""

from __future__ import annotations

import os
import pty
import re
import signal
import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from rclpy.node import Node

from mobo_msgs_py.msg import RecorderStatus
from mobo_tuner.ros.qos import LATCHED
from tests.support.processes import NodeProcess, NodeStarter
from tests.support.tuner_double import Behaviour, TunerDouble

SpinUntil = Callable[..., None]
RECORDED = ["/evaluation", "/pareto_front", "/problem", "/run_records", "/status"]


class Session:
    """A console process beside a tuner double."""

    def __init__(self, start: NodeStarter, node: Node, spin_until: SpinUntil) -> None:
        self._start = start
        self._node = node
        self._spin_until = spin_until
        self.process: NodeProcess
        self._tuner: TunerDouble | None = None
        self._recorder = node.create_publisher(RecorderStatus, "recorder_status", LATCHED)

    def tuner_behaves(self, **behaviour: Any) -> None:
        """Offer the `tune` action."""
        self._tuner = TunerDouble(self._node, Behaviour(**behaviour))

    @property
    def tuner(self) -> TunerDouble:
        """The tuner double."""
        assert self._tuner is not None
        return self._tuner

    def close(self) -> None:
        """Take the tuner double away."""
        if self._tuner is not None:
            self._tuner.close()

    def recorder_says(self, **status: Any) -> None:
        """Publish a recorder's status."""
        self._recorder.publish(RecorderStatus(**status))

    def start(
        self,
        run_id: str = "run1",
        evaluations: int = 4,
        recorder: bool = False,
        ready_timeout: float = 15.0,
        use_sim_time: bool = False,
        **options: Any,
    ) -> None:
        """Start the console."""
        parameters = {
            "run_id": run_id,
            "evaluations": evaluations,
            "wait_for_recorder": str(recorder).lower(),
            "ready_timeout": ready_timeout,
        }
        if use_sim_time:
            parameters["use_sim_time"] = "true"
        arguments = [a for k, v in parameters.items() for a in ("-p", f"{k}:={v}")]
        self.process = self._start(
            "-m", "mobo_tuner.nodes.console", "--ros-args", *arguments, **options
        )

    def spin_until(self, condition: Callable[[], object], what: str, timeout: float = 20.0) -> None:
        """Let the double live until something happens."""
        self._spin_until(condition, what, timeout)

    def ends_with(self, status: int, timeout: float = 20.0) -> None:
        """Check the console's exit status; the double lives on until then."""
        self._spin_until(lambda: not self.process.running, "the console to end", timeout)
        assert self.process.wait() == status, self.process.stderr

    @property
    def lines(self) -> list[str]:
        """What the console printed."""
        return self.process.stdout.splitlines()


@pytest.fixture
def session(start_node: NodeStarter, node: Node, spin_until: SpinUntil) -> Iterator[Session]:
    """A console to be, and a tuner to be."""
    session = Session(start_node, node, spin_until)
    yield session
    session.close()


def test_a_run_is_shown_line_by_line_and_ends_with_0(session: Session) -> None:
    session.tuner_behaves()
    session.start(evaluations=4)
    session.ends_with(0)
    assert [(g.run_id, g.evaluations) for g in session.tuner.goals] == [("run1", 4)]
    shown = [line for line in session.lines if line.startswith("evaluation")]
    assert shown == [
        "evaluation 0, 1 of 4 done: hypervolume 100, eps_x 30 mm mrad, yield 0.5, suggested in 0.25 s",
        "evaluation 1, 2 of 4 done: hypervolume 101, eps_x not measured, yield 0.51, suggested in 0.25 s, "
        "failed: the beam was lost",
        "evaluation 2, 3 of 4 done: hypervolume 102, eps_x 28 mm mrad, yield 0.52, suggested in 0.25 s, "
        "infeasible",
        "evaluation 3, 4 of 4 done: hypervolume 103, eps_x 27 mm mrad, yield 0.53, suggested in 0.25 s",
    ]
    assert session.lines[-1] == (
        "run run1 is finished (budget): 4 evaluations, hypervolume 103, 4 on the Pareto front"
    )
    assert session.process.stderr == ""


def test_a_run_is_shown_while_simulated_time_stands(session: Session) -> None:
    session.tuner_behaves()
    session.start(evaluations=2, use_sim_time=True)
    session.ends_with(0)
    shown = [line[:12] for line in session.lines if line.startswith("evaluation")]
    assert shown == ["evaluation 0", "evaluation 1"]


@pytest.mark.parametrize("way", ["publishes_topic", "publishes_feedback"])
def test_one_way_of_hearing_of_evaluations_is_enough(session: Session, way: str) -> None:
    ways = {"publishes_topic": False, "publishes_feedback": False} | {way: True}
    session.tuner_behaves(**ways)
    session.start(evaluations=3)
    session.ends_with(0)
    assert len([line for line in session.lines if line.startswith("evaluation")]) == 3


def test_without_parameters_the_run_gets_a_name_and_the_tuners_budget(session: Session) -> None:
    session.tuner_behaves()
    session.start(run_id="''", evaluations=0)
    session.ends_with(0)
    (goal,) = session.tuner.goals
    assert re.fullmatch(r"\d{8}-\d{6}-run-[0-9a-f]{8}", goal.run_id)
    assert goal.evaluations == 0
    assert len([line for line in session.lines if " of 4 done: " in line]) == 4


def test_it_waits_until_the_recorder_records_the_run(session: Session) -> None:
    session.tuner_behaves()
    session.recorder_says(recording=True, topics=RECORDED[:2])
    session.start(recorder=True)
    session.spin_until(
        lambda: "waiting for the recorder" in session.process.stdout, "the console to wait"
    )
    assert session.tuner.goals == []
    session.recorder_says(recording=True, topics=RECORDED)
    session.ends_with(0)
    assert len(session.tuner.goals) == 1


@pytest.mark.parametrize(
    ("status", "message"),
    [
        (None, "no recorder was found within 4 s"),
        (
            {"recording": False, "message": "the disk is full"},
            "the recorder does not record: the disk is full",
        ),
        (
            {"recording": True, "topics": RECORDED[:-1]},
            "the recorder did not take up /status within 4 s",
        ),
    ],
)
def test_a_recorder_that_is_not_ready_is_an_error(
    session: Session, status: dict[str, Any] | None, message: str
) -> None:
    session.tuner_behaves()
    if status is not None:
        session.recorder_says(**status)
    session.start(recorder=True, ready_timeout=4.0)
    session.ends_with(1)
    assert session.process.stderr.strip() == message
    assert session.tuner.goals == []


def test_a_missing_tuner_is_an_error(session: Session) -> None:
    session.start(ready_timeout=1.0)
    session.ends_with(1)
    [sentence] = session.process.stderr.splitlines()
    assert "'/status'" in sentence
    assert "1 s" in sentence


def test_a_goal_that_is_refused_is_an_error(session: Session) -> None:
    session.tuner_behaves(accepts=False)
    session.start()
    session.ends_with(1)
    assert session.process.stderr.strip() == "the tuner refused the goal"


def test_an_error_of_the_run_is_one_sentence_after_what_was_reached(session: Session) -> None:
    session.tuner_behaves(fail_after=2)
    session.start()
    session.ends_with(1)
    assert session.process.stderr.strip() == "the machine is gone"
    assert session.lines[-1] == (
        "run run1 ended with an error: 2 evaluations, hypervolume 101, 2 on the Pareto front"
    )


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_cancels_the_run_and_shows_what_was_reached(
    session: Session, number: signal.Signals
) -> None:
    session.tuner_behaves(seconds=0.2)
    session.start(evaluations=1000)
    session.spin_until(lambda: "evaluation    1," in session.process.stdout, "two evaluations")
    session.process.popen.send_signal(number)
    session.ends_with(130, timeout=4.0)
    assert session.tuner.cancels == 1
    assert re.fullmatch(
        r"run run1 was canceled: \d+ evaluations, hypervolume \d+, \d+ on the Pareto front",
        session.lines[-1],
    )
    assert session.lines[-2] == "the run was stopped: a client canceled it"
    assert session.process.stderr == ""


def test_a_signal_before_the_goal_sends_none(session: Session) -> None:
    session.tuner_behaves()
    session.start(recorder=True)
    session.spin_until(
        lambda: "waiting for the recorder" in session.process.stdout, "the console to wait"
    )
    session.process.popen.send_signal(signal.SIGINT)
    session.ends_with(130, timeout=4.0)
    assert session.tuner.goals == []


def test_a_tuner_that_does_not_heed_the_cancel_is_not_waited_for(session: Session) -> None:
    session.tuner_behaves(seconds=0.1, heeds_cancel=False)
    session.start(evaluations=1000)
    session.spin_until(lambda: "evaluation    0," in session.process.stdout, "an evaluation")
    session.process.popen.send_signal(signal.SIGINT)
    session.ends_with(130, timeout=4.0)
    assert session.lines[-1] == "canceled, but the tuner did not answer within 1.5 s"


def canceled_session(session: Session, return_seconds: float) -> None:
    """Let a run be canceled by a Ctrl-C; the machine is on its way back then."""
    session.tuner_behaves(seconds=0.1, return_seconds=return_seconds)
    session.start(evaluations=1000)
    session.spin_until(lambda: "evaluation    0," in session.process.stdout, "an evaluation")
    session.process.popen.send_signal(signal.SIGINT)
    session.spin_until(lambda: "ramping" in session.process.stdout, "the way back")


def test_ctrl_c_waits_until_the_machine_has_gone_back(session: Session) -> None:
    canceled_session(session, return_seconds=4.0)  # longer than any stop may take
    session.ends_with(130)
    assert session.lines[-1].startswith("run run1 was canceled: ")
    assert any("Ctrl-C again" in line for line in session.lines)
    assert session.tuner.skips == 0


def test_a_second_ctrl_c_stops_the_machine_on_its_way_back(session: Session) -> None:
    canceled_session(session, return_seconds=3600.0)
    session.process.popen.send_signal(signal.SIGINT)
    session.ends_with(130, timeout=4.0)
    assert session.lines[-1].startswith("run run1 was canceled: ")
    assert session.tuner.skips == 1


def test_a_tuner_that_falls_silent_is_an_error(session: Session) -> None:
    session.tuner_behaves(silent_after=1)
    session.start()
    session.ends_with(1)
    [sentence] = session.process.stderr.splitlines()
    assert "silent for 5 s" in sentence


def test_a_run_id_that_is_no_folder_name_is_refused(session: Session) -> None:
    session.start(run_id="../etc")
    session.ends_with(2)
    assert session.process.stderr.startswith("cannot start: run_id is '../etc'; letters")


def test_the_terminal_view(session: Session) -> None:
    session.tuner_behaves(seconds=0.3)
    ours, theirs = pty.openpty()
    screen = bytearray()

    def read() -> None:
        while True:
            try:
                screen.extend(os.read(ours, 4096))
            except OSError:  # the other side is closed
                return

    reader = threading.Thread(target=read)
    reader.start()
    try:
        session.start(evaluations=4, terminal=theirs, TERM="xterm-256color", COLUMNS="100")
        os.close(theirs)
        session.ends_with(0)
    finally:
        session.process.kill()
        reader.join(5.0)
        os.close(ours)
    text = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", screen.decode())
    assert "waiting for the tuner" in text
    assert "run run1   machine: settling 40%" in text
    assert "evaluation 3, 4 of 4 done" in text
    assert "hypervolume 103   4 on the front" in text
    assert "3 feasible   1 failed" in text
    last = text[text.rindex("objective") :]
    assert re.search(r"eps_x +27 ± 0\.2 +27 +mm mrad +3 ", last)
    assert re.search(r"yield +0\.53 +0\.53 +3 ", last)
    assert "run run1 is finished (budget): 4 evaluations" in last
    assert screen.endswith(b"\n")
    assert b"\x1b[?25h" in screen[screen.rindex(b"\x1b[?25l") :], "the cursor must be shown again"

"""What a run does when its recorder is lost or its journal cannot be written."""

from __future__ import annotations

import resource
from collections.abc import Callable
from pathlib import Path

import pytest
from rclpy.node import Node

from mobo_msgs_py.action import Tune
from mobo_msgs_py.msg import RecorderStatus, TunerStatus
from mobo_tuner.ros.qos import LATCHED
from mobo_tuner.runs.journal import FILE_NAME
from mobo_tuner.tuner.recording import SILENCE, Heard, Recorders, free_space, judge_recorders
from tests.support.processes import NodeProcess
from tests.support.tuner import GoalClient, Listener, Services, journal, toy_machine

SpinUntil = Callable[..., None]


def heard(path: str, time: float, *, recording: bool = True, message: str = "") -> Heard:
    return Heard(RecorderStatus(recording=recording, path=path, message=message), time)


def test_a_tuner_without_a_recorder_misses_none() -> None:
    assert judge_recorders({}, 100.0) == Recorders("", lost=False)


def test_a_recorder_is_lost_once_it_is_silent_or_says_so() -> None:
    now = 100.0
    one = heard("a", now - SILENCE + 0.1)
    assert not judge_recorders({"a": one}, now).lost
    assert "a" in judge_recorders({"a": one}, now).text
    silent = judge_recorders({"a": one}, now + 0.2)
    assert silent.lost
    assert f"{SILENCE:g} s" in silent.text
    full = heard("a", now, recording=False, message="the bag cannot be written: disk full")
    stopped = judge_recorders({"a": full}, now)
    assert stopped.lost
    assert "disk full" in stopped.text


def test_one_of_two_recorders_is_enough() -> None:
    both = {"a": heard("a", 0.0), "b": heard("b", 99.0)}
    assert not judge_recorders(both, 100.0).lost
    assert judge_recorders(both, 200.0).lost


def test_free_space_is_that_of_the_nearest_folder_that_exists(tmp_path: Path) -> None:
    assert free_space(tmp_path / "not" / "there") > 0.0


class Watched:
    """A run with a recorder that the test plays, and what the tuner says."""

    def __init__(self, node: Node, spin_until: SpinUntil) -> None:
        self.machine = toy_machine(node)
        self.node = node
        self.spin_until = spin_until
        self.statuses = Listener(node, TunerStatus, "status", LATCHED)
        self._recorder = node.create_publisher(RecorderStatus, "recorder_status", LATCHED)
        self._recorded = RecorderStatus()
        node.create_timer(0.5, self._publish)

    @property
    def status(self) -> TunerStatus:
        return self.statuses.messages[-1] if self.statuses.messages else TunerStatus()

    def record(self, message: str = "") -> None:
        """Publish that the recorder records, or why it does not."""
        self._recorded = RecorderStatus(recording=not message, path="/bags/1", message=message)
        self._publish()

    def _publish(self) -> None:
        if self._recorded.path:
            # The tuner waits a moment for a recorder that has not taken up its topics.
            self._recorded.topics = [name for name, _ in self.node.get_topic_names_and_types()]
            self._recorder.publish(self._recorded)

    def wait_for(self, condition: Callable[[TunerStatus], bool], what: str) -> TunerStatus:
        self.spin_until(lambda: condition(self.status), what, 60.0)
        return self.status


@pytest.fixture
def watched(node: Node, spin_until: SpinUntil) -> Watched:
    return Watched(node, spin_until)


@pytest.mark.parametrize("policy", ["continue", "pause"])
def test_a_lost_recorder_is_said_at_once_and_the_run_does_what_its_policy_says(
    start_tuner: Callable[..., NodeProcess],
    client: GoalClient,
    services: Services,
    watched: Watched,
    tmp_path: Path,
    policy: str,
) -> None:
    watched.record()
    start_tuner(f"on_recorder_lost:={policy}")
    client.send(Tune.Goal(run_id="run", evaluations=300))
    watched.wait_for(lambda s: s.evaluations > 2 and "/bags/1" in s.recorder, "the recorder")
    watched.wait_for(lambda s: s.free_space > 0.0, "the free space")
    watched.record("the bag cannot be written: No space left on device")
    status = watched.wait_for(lambda s: "lost" in s.recorder, "the loss")
    assert "No space left" in status.recorder
    assert any("bag_path" in hint for hint in status.hints)
    assert status.last_failure == ""  # of an evaluation, which is not replaced
    if policy == "pause":
        status = watched.wait_for(lambda s: s.state == TunerStatus.PAUSED, "the pause")
        assert "No space left" in status.message
        assert services.trigger("resume").success
    else:
        made = watched.status.evaluations
        watched.wait_for(lambda s: s.evaluations > made, "the next evaluation")
    watched.record()
    watched.wait_for(lambda s: "lost" not in s.recorder and not s.hints, "the recorder's return")
    assert services.trigger("stop_after_this").success
    assert client.wait(60.0).error_code == 0
    assert journal(tmp_path, "run")[-1]["stop_reason"] == "stopped"


@pytest.mark.parametrize("policy", ["continue", "pause"])
def test_a_full_disk_loses_no_evaluation(
    start_tuner: Callable[..., NodeProcess],
    client: GoalClient,
    services: Services,
    watched: Watched,
    tmp_path: Path,
    policy: str,
) -> None:
    tuner = start_tuner(f"on_recorder_lost:={policy}")
    client.send(Tune.Goal(run_id="run", evaluations=300))
    watched.wait_for(lambda s: s.evaluations > 2, "evaluations")
    pid = tuner.popen.pid
    unlimited = resource.prlimit(pid, resource.RLIMIT_FSIZE)
    size = (tmp_path / "runs" / "run" / FILE_NAME).stat().st_size
    resource.prlimit(pid, resource.RLIMIT_FSIZE, (size, unlimited[1]))
    waits = TunerStatus.PAUSED if policy == "pause" else TunerStatus.WAITING
    status = watched.wait_for(lambda s: s.state == waits, "the run to wait")
    assert "cannot be written: File too large" in status.message
    assert "cannot be written" in status.last_failure
    refused = services.set(evaluations=1)
    assert not refused.successful  # steering goes on while it waits
    resource.prlimit(pid, resource.RLIMIT_FSIZE, unlimited)
    if policy == "pause":
        assert services.trigger("resume").success
    made = status.evaluations
    watched.wait_for(lambda s: s.evaluations > made, "the run to go on")
    assert services.trigger("stop_after_this").success
    result = client.wait(60.0)
    assert result.error_code == 0
    records = [r for r in journal(tmp_path, "run") if r["type"] == "evaluation"]
    assert [r["index"] for r in records] == list(range(result.evaluations))


def test_a_run_that_is_stopped_on_a_full_disk_says_what_its_journal_lacks(
    start_tuner: Callable[..., NodeProcess],
    client: GoalClient,
    services: Services,
    watched: Watched,
    tmp_path: Path,
) -> None:
    tuner = start_tuner()
    client.send(Tune.Goal(run_id="run", evaluations=300))
    watched.wait_for(lambda s: s.evaluations > 2, "evaluations")
    pid, path = tuner.popen.pid, tmp_path / "runs" / "run" / FILE_NAME
    hard = resource.prlimit(pid, resource.RLIMIT_FSIZE)[1]
    resource.prlimit(pid, resource.RLIMIT_FSIZE, (path.stat().st_size, hard))
    watched.wait_for(lambda s: s.state == TunerStatus.WAITING, "the run to wait")
    assert services.trigger("stop_after_this").success
    result = client.wait(60.0)
    kept = [r["index"] for r in journal(tmp_path, "run") if r["type"] == "evaluation"]
    assert result.error_code == Tune.Result.INTERNAL
    assert "File too large" in result.error_msg
    assert result.error_msg.endswith(f"it lacks evaluation {len(kept)}")
    assert result.evaluations == len(kept) + 1

"""The client of the tuner, with a real tuner and the simulated machine at the other end."""

from __future__ import annotations

import doctest
import math
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from mobo_tuner.client import (
    ErrorCode,
    Evaluation,
    Front,
    Movement,
    RunResult,
    Status,
    TunerClient,
    TunerError,
    tuner_client,
)
from mobo_tuner.core.problem import Problem
from tests.support.paths import CONFIG
from tests.support.processes import TIMEOUT, NodeProcess, NodeStarter, wait_until

Start = Callable[..., NodeProcess]
ENDLESS = 100_000  # evaluations
HERE = {"x1": 0.5, "x2": -0.1}


@pytest.fixture
def nodes(start_tuner: Start, start_machine: Start) -> None:
    """A tuner and a machine of the toy problem."""
    start_machine()
    start_tuner("initial_evaluations:=4")


@pytest.fixture
def client(ros_domain: int) -> Iterator[TunerClient]:
    """A client in the test's domain."""
    del ros_domain  # has set the environment
    with TunerClient(timeout=30.0) as client:
        yield client


@pytest.fixture
def background() -> Iterator[Callable[..., Future[Any]]]:
    """Call a function in a thread of its own."""
    with ThreadPoolExecutor(max_workers=2) as pool:
        yield pool.submit


def refusal(call: Callable[[], object]) -> TunerError:
    """Return the error that a call raises."""
    with pytest.raises(TunerError) as caught:
        call()
    return caught.value


def indices(front: Front) -> list[int | None]:
    """Return the indices of the points of a front."""
    return [point.index for point in front.points]


@pytest.mark.usefixtures("nodes")
def test_the_example_of_the_class_runs_as_it_is_shown(client: TunerClient) -> None:
    client.connect()
    [example] = doctest.DocTestFinder(recurse=False).find(
        tuner_client.TunerClient, "TunerClient", globs={}
    )
    printed: list[str] = []
    runner = doctest.DocTestRunner()
    assert runner.run(example, out=printed.append).failed == 0, "".join(printed)
    assert runner.tries >= 3


@pytest.mark.usefixtures("nodes")
def test_a_run_tells_everything_once_on_the_calling_thread(client: TunerClient) -> None:
    evaluations: list[Evaluation] = []
    statuses: list[Status] = []
    fronts: list[Front] = []
    problems: list[Problem] = []
    threads: set[int] = set()

    def keep(evaluation: Evaluation) -> None:
        threads.add(threading.get_ident())
        evaluations.append(evaluation)
        assert client.status().run_id == "first"  # the client may be called in a callback

    result = client.tune(
        evaluations=7,
        run_id="first",
        on_evaluation=keep,
        on_status=statuses.append,
        on_front=fronts.append,
        on_problem=problems.append,
    )
    assert threads == {threading.get_ident()}
    assert (result.run_id, result.evaluations, result.stop_reason) == ("first", 7, "budget")
    assert result.error is None
    assert [e.index for e in evaluations] == list(range(7))
    assert [e.source for e in evaluations] == ["initial"] * 4 + ["model"] * 3
    for evaluation in evaluations:
        x1, x2 = (evaluation.setpoint[name] for name in ("x1", "x2"))
        assert evaluation.objectives["f1"] == pytest.approx(math.hypot(x1 - 1.0, x2 - 1.0))
        assert evaluation.objectives["f2"] == pytest.approx(math.hypot(x1 + 1.0, x2 + 1.0))
        assert evaluation.valid
        assert evaluation.error_msg == ""
    last = evaluations[-1]
    assert result.front.hypervolume == last.hypervolume == fronts[-1].hypervolume
    assert [p.index for p in result.front.points] == [p.index for p in fronts[-1].points]
    assert result.front.reference_point == {"f1": 4.3, "f2": 4.3}
    by_index = {e.index: e for e in evaluations}
    for point in result.front.points:
        assert point.index is not None
        assert point.objectives == by_index[point.index].objectives
    assert {s.run_id for s in statuses} == {"first"}
    assert "evaluating" in {s.state for s in statuses}
    assert problems[0].variable_names == ("x1", "x2")
    assert [o.reference for o in problems[0].objectives] == [4.3, 4.3]

    # A run that begins with its evaluations tells of those, too.
    again: list[int] = []
    resumed = client.tune(
        resume_from="first", evaluations=9, on_evaluation=lambda e: again.append(e.index)
    )
    assert sorted(again) == list(range(9))
    assert resumed.evaluations == 9
    unknown = refusal(lambda: client.tune(resume_from="never"))
    assert unknown.code == ErrorCode.INVALID_GOAL
    assert "never" in str(unknown)
    assert refusal(lambda: client.tune(run_id="../etc")).code == ErrorCode.INVALID_GOAL


@pytest.mark.usefixtures("nodes")
def test_parameters_are_set_together_or_not_at_all(client: TunerClient) -> None:
    client.set({"variables.x1.max": 1.5, "variables.x2.min": -1}, evaluations=30)
    assert (client.get("variables.x1.max"), client.get("evaluations")) == (1.5, 30)
    assert client.get("variables.x2.min") == -1

    wrong = refusal(lambda: client.set({"variables.x1.min": -1.5, "variables.x1.max": -9.0}))
    assert wrong.code == ErrorCode.REFUSED
    assert "variables.x1.m" in str(wrong)
    assert "-9" in str(wrong)
    assert client.get("variables.x1.min") == -2.0, "nothing of what was refused may be taken"

    # Whole and other numbers in one list, as people type a box; numbers of numpy, too.
    client.set({"objectives.f1.reference": 4, "objectives.f1.truncation": [0, 5.5]})
    assert client.get("objectives.f1.truncation") == [0.0, 5.5]
    client.set({"objectives.f2.truncation": np.array([0.0, 6.0]), "evaluations": np.int64(31)})
    assert client.get("evaluations") == 31

    unknown = refusal(lambda: client.set({"variables.x1.max": 1.0, "variables.y.max": 1.0}))
    assert "'variables.y.max'" in str(unknown)
    assert "variables.x1.max" not in str(unknown)
    assert "'nothing'" in str(refusal(lambda: client.get("nothing")))
    for value in ({}, [], [1, "two"], object(), 2**63):
        error = refusal(lambda: client.set({"evaluations": value}))  # noqa: B023
        assert error.code == ErrorCode.INVALID_VALUE
        assert "evaluations" in str(error)


@pytest.mark.usefixtures("nodes")
def test_a_run_is_canceled_from_another_thread_by_an_error_and_at_the_end(
    client: TunerClient, background: Callable[..., Future[RunResult]]
) -> None:
    indices: list[int] = []

    def tune(run_id: str) -> Future[RunResult]:
        indices.clear()
        running = background(
            client.tune,
            run_id=run_id,
            evaluations=ENDLESS,
            on_evaluation=lambda e: indices.append(e.index),
        )
        wait_until(lambda: len(indices) > 2 or running.done(), "evaluations", 60.0)
        assert not running.done(), running.exception()
        return running

    def ended(running: Future[RunResult]) -> RunResult:
        result = running.result(10.0)
        assert result.stop_reason == "canceled"
        assert result.error is not None
        assert result.error.code == ErrorCode.CANCELED
        assert result.evaluations >= len(result.front.points) > 0
        return result

    running = tune("by-thread")
    client.cancel()
    assert ended(running).run_id == "by-thread"

    with TunerClient() as other:
        running = tune("by-another-client")
        other.cancel()  # concerns what that client asked for
        assert client.status().state != "canceling"
        assert other.cancel_any()
        assert ended(running).run_id == "by-another-client"
        wait_until(lambda: client.status().state == "idle", "the end of the run")
        assert not other.cancel_any()

    def interrupt(evaluation: Evaluation) -> None:
        if evaluation.index == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        client.tune(run_id="by-error", evaluations=ENDLESS, on_evaluation=interrupt)
    assert client.status().stop_reason == "canceled"

    running = tune("by-exit")
    client.close()
    assert ended(running).run_id == "by-exit"
    with pytest.raises(RuntimeError, match="closed"):
        client.status()


@pytest.mark.usefixtures("nodes")
def test_a_run_is_steered_and_watched_by_other_clients(
    client: TunerClient, background: Callable[..., Future[Any]]
) -> None:
    for steer in (client.pause, client.resume, client.step, client.skip, client.stop):
        assert refusal(steer).code == ErrorCode.REFUSED
    assert refusal(lambda: client.queue(HERE)).code == ErrorCode.REFUSED
    assert refusal(client.watch).code == ErrorCode.REFUSED

    with TunerClient() as operator, TunerClient() as viewer:
        running = background(client.tune, run_id="steered", evaluations=ENDLESS)
        wait_until(lambda: operator.status().evaluations > 2, "evaluations")
        assert "evaluation" in operator.pause()
        wait_until(lambda: operator.status().state == "paused", "the pause")
        before = operator.status().evaluations

        seen: list[Evaluation] = []
        watching = background(viewer.watch, on_evaluation=seen.append)
        wait_until(lambda: len(seen) == before, "the evaluations before the viewer came")
        assert refusal(lambda: operator.queue({"x1": 0.5})).code == ErrorCode.REFUSED
        assert refusal(lambda: operator.queue({"x1": 9.0, "x2": 0.0})).code == ErrorCode.REFUSED
        assert operator.queue(HERE) == 1
        operator.step()
        wait_until(lambda: len(seen) == before + 1, "one more evaluation")
        assert (seen[-1].index, seen[-1].source, seen[-1].setpoint) == (before, "operator", HERE)
        operator.resume()
        wait_until(lambda: len(seen) > before + 3, "more evaluations")
        wait_until(lambda: "skipped" in skipped(operator), "an evaluation in flight")
        operator.stop()
        result = running.result(20.0)
        assert (result.stop_reason, result.error) == ("stopped", None)
        last = watching.result(20.0)
        assert (last.run_id, last.state, last.stop_reason) == ("steered", "idle", "stopped")
        assert [e.index for e in seen] == list(range(result.evaluations))


def skipped(operator: TunerClient) -> str:
    try:
        return operator.skip()
    except TunerError as error:
        return str(error)


@pytest.mark.usefixtures("nodes")
def test_working_points_are_listed_gone_to_and_held(client: TunerClient) -> None:
    assert refusal(client.working_points).code == ErrorCode.REFUSED
    assert refusal(lambda: client.go(0)).code == ErrorCode.REFUSED
    old = client.tune(evaluations=6, run_id="old").front
    new = client.tune(evaluations=8, run_id="new").front
    points = client.working_points()
    assert points.predicted is None
    assert (points.measured.run_id, indices(points.measured)) == ("new", indices(new))
    assert points.measured.hypervolume == new.hypervolume
    assert indices(client.working_points("old").measured) == indices(old)
    assert client.working_points().measured.run_id == "new", "a query must change nothing"
    predicted = client.working_points(predict=True).predicted
    assert predicted is not None
    assert all(p.index is None and min(p.stddevs.values()) > 0.0 for p in predicted.points)

    movements: list[Movement] = []
    chosen = min(old.points, key=lambda p: p.objectives["f1"])
    arrival = client.go(weights={"f1": 1.0}, run_id="old", on_feedback=movements.append)
    assert (arrival.run_id, arrival.point.index) == ("old", chosen.index)
    assert arrival.point.setpoint == chosen.setpoint
    assert arrival.readbacks == pytest.approx(chosen.setpoint)
    other = max(old.points, key=lambda p: p.objectives["f1"])
    deadline = time.monotonic() + TIMEOUT
    while not movements:  # a short way may be over before its feedback has found the client
        assert time.monotonic() < deadline
        for point in (other, chosen):
            client.go(point.index, run_id="old", on_feedback=movements.append)
    assert {m.phase for m in movements} <= {"ramping", "settling"}
    held = client.hold(2, chosen.index, run_id="old", radius=0.05)
    assert (held.run_id, held.evaluations) == ("old", 2)
    for call in (
        lambda: client.go(),
        lambda: client.go(1, weights={"f1": 1.0}),
        lambda: client.go(-1),
        lambda: client.go(1, hold=2**32),
        lambda: client.go(weights={"f1": "heavy"}),  # type: ignore[dict-item]
        lambda: client.tune(evaluations=1.5),  # type: ignore[arg-type]
    ):
        assert refusal(call).code == ErrorCode.INVALID_VALUE
    missing = refusal(lambda: client.go(77, run_id="new"))
    assert missing.code == ErrorCode.INVALID_GOAL
    assert "77" in str(missing)


def test_a_loop_of_ones_own_needs_no_machine(client: TunerClient, start_tuner: Start) -> None:
    start_tuner()
    first = client.ask()
    assert first == client.ask()
    assert (first.index, first.source, set(first.setpoint)) == (0, "initial", {"x1", "x2"})
    kept = client.tell(first, {"f1": 1.5, "f2": (2.5, 0.25)}, readbacks={"x1": 0.25})
    assert (kept.run_id, kept.index, kept.setpoint) == (first.run_id, 0, first.setpoint)
    assert kept.objectives == {"f1": 1.5, "f2": 2.5}
    assert kept.diagnostics["f2"] == (2.5, 0.25)
    assert math.isnan(kept.stddev("f1"))
    assert kept.readbacks == {"x1": 0.25}
    assert refusal(lambda: client.tell(first, {"f1": 1.0})).code == ErrorCode.REFUSED
    own = client.tell(HERE, {"f1": 1.0})  # what was measured is learned
    assert (own.index, own.valid, own.feasible, own.source) == (1, True, False, "operator")
    failed = client.tell(HERE, {"f1": math.nan})
    assert (failed.index, failed.valid) == (2, False)
    assert "f1, f2" in failed.error_msg


def test_two_tuners_in_namespaces_are_kept_apart(start_node: NodeStarter, tmp_path: Path) -> None:
    for space, seed in (("left", 1), ("right", 2)):
        start_node(
            *("-m", "mobo_tuner.nodes.tuner", "--ros-args", "-r", f"__ns:=/{space}"),
            *("--params-file", str(CONFIG / "toy.yaml"), "-p", f"seed:={seed}"),
            *("-p", f"runs_dir:={tmp_path / space}"),
        )
    with TunerClient("left", timeout=30.0) as left, TunerClient("/right", timeout=30.0) as right:
        asked = [left.ask(), right.ask()]
        assert asked[0].setpoint != asked[1].setpoint
        left.set(evaluations=17)
        assert (left.get("evaluations"), right.get("seed")) == (17, 2)
        assert right.get("evaluations") != 17


def test_a_tuner_that_is_missing_or_dies_is_named(
    client: TunerClient,
    ros_domain: int,
    start_tuner: Start,
    start_machine: Start,
    background: Callable[..., Future[Any]],
) -> None:
    missing = refusal(lambda: client.connect(timeout=0.5))
    assert missing.code == ErrorCode.NO_TUNER
    assert "'/status'" in str(missing)
    assert str(ros_domain) in str(missing)

    start_machine()
    tuner = start_tuner()
    running = background(client.tune, evaluations=ENDLESS)
    wait_until(lambda: client.status().evaluations > 2, "evaluations")
    tuner.kill()
    assert refusal(lambda: running.result(20.0)).code == ErrorCode.TUNER_LOST
    start_tuner()  # another one serves the same client
    assert client.tune(evaluations=3).stop_reason == "budget"


def test_a_node_of_ones_own_serves_as_well(
    node: Node, executor: SingleThreadedExecutor, start_tuner: Start
) -> None:
    start_tuner()
    client = TunerClient(node=node, timeout=30.0)
    errors: list[Exception] = []

    def call_where_it_would_block() -> None:
        try:
            client.status()
        except RuntimeError as error:
            errors.append(error)

    def spin() -> None:
        while not done.is_set():
            executor.spin_once(timeout_sec=0.1)

    done = threading.Event()
    spinner = threading.Thread(target=spin)
    spinner.start()
    try:
        assert client.status().state == "idle"
        client.set(evaluations=9)
        timer = node.create_timer(0.05, call_where_it_would_block)
        wait_until(lambda: errors, "the timer")
        node.destroy_timer(timer)
        client.close()
        wait_until(lambda: not list(node.subscriptions), "the end of the subscriptions")
    finally:
        done.set()
        spinner.join(5.0)
    assert "executor" in str(errors[0])
    lonely = Node("lonely", context=node.context)
    with pytest.raises(ValueError, match="executor"):
        TunerClient(node=lonely)
    lonely.destroy_node()

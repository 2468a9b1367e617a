"""Two suites in one domain, renamed nodes, and a second tuner where one is there already."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node

from mobo_msgs_py import msg
from mobo_msgs_py.action import Tune
from mobo_tuner.ros.qos import LATCHED, STREAM
from tests.support.processes import NodeProcess, NodeStarter
from tests.support.tuner import CONFIG, GoalClient, Listener

Spin = Callable[..., None]
TOY = ["--ros-args", "--params-file", str(CONFIG / "toy.yaml")]


def start_suite(start_node: NodeStarter, namespace: str, runs: Path) -> NodeProcess:
    """A simulated machine with another name, and a tuner that keeps its runs by the default."""
    names = ["-r", f"__ns:={namespace}"]
    start_node("-m", "awa_sim_node.node", *TOY, *names, "-r", "__node:=injector")
    return start_node(
        "-m",
        "mobo_tuner.nodes.tuner",
        *TOY,
        *names,
        "-p",
        f"tuner:runs_dir:={runs}",
        "-p",
        "seed:=3",
    )


def test_two_suites_live_in_one_domain_with_one_file(
    start_node: NodeStarter, node: Node, spin_until: Spin, tmp_path: Path
) -> None:
    suites = {name: start_suite(start_node, f"/{name}", tmp_path / name) for name in "AB"}
    health = Listener(node, DiagnosticArray, "/diagnostics", STREAM)
    results = {}
    for name in suites:
        client = GoalClient(node, spin_until, Tune, f"{name}/tune")
        client.send(Tune.Goal(run_id="run", evaluations=4))
        results[name] = client.wait()
    for name, result in results.items():
        # The variables and the budget are those of the file, on its machine: the toy problem.
        assert (result.error_code, result.error_msg, result.evaluations) == (0, "", 4)
        assert (tmp_path / name / "run" / "journal.jsonl").exists()
        ready = re.search(r"ready: 2 objectives of 2 variables .* (\S+/tune)", suites[name].stderr)
        assert ready
        assert ready[1] == f"/{name}/tune"
        assert "also publish" not in suites[name].stderr
    front_a, front_b = (
        [[v.value for v in p.setpoint] for p in results[n].pareto_front.points] for n in "AB"
    )
    assert front_a == front_b  # one seed, two machines

    latest = Listener(node, msg.Evaluation, "A/latest_evaluation", LATCHED)
    spin_until(lambda: latest.messages, "the newest evaluation, by a late subscriber")
    assert [m.index for m in latest.messages] == [3]

    def parts() -> dict[str, Any]:
        return {s.name: s for m in health.messages for s in m.status}

    wanted = {f"{n}/{part}" for n in "AB" for part in ("tuner: run", "injector: machine")}
    spin_until(lambda: wanted <= {*parts()}, "the health of both")
    # The latest may still be of the wait for the machine, at the start of the run.
    spin_until(lambda: parts()["A/tuner: run"].level == DiagnosticStatus.OK, "that all is well")


def test_a_renamed_tuner_has_the_section_and_its_budget(
    start_node: NodeStarter, node: Node, spin_until: Spin, tmp_path: Path
) -> None:
    start_node("-m", "awa_sim_node.node", *TOY)
    options = ["-r", "__node:=tuner2", "-p", f"runs_dir:={tmp_path}", "-p", "journal:=false"]
    start_node("-m", "mobo_tuner.nodes.tuner", *TOY, *options)
    client = GoalClient(node, spin_until, Tune, "tune")
    client.send(Tune.Goal(run_id="run"))
    spin_until(lambda: client.feedback, "an evaluation")
    assert client.feedback[0].budget == 25  # as the section `tuner` of the file says
    client.cancel()
    client.wait()
    assert not (tmp_path / "run").exists()  # as asked for


def test_two_tuners_tell_of_each_other(
    start_tuner: Callable[..., NodeProcess],
    start_node: NodeStarter,
    node: Node,
    spin_until: Spin,
    tmp_path: Path,
) -> None:
    health = Listener(node, DiagnosticArray, "/diagnostics", STREAM)

    def levels(name: str) -> set[bytes]:
        return {s.level for m in health.messages for s in m.status if s.name == name}

    statuses = Listener(node, msg.TunerStatus, "status", LATCHED)
    first = start_tuner()
    spin_until(lambda: "ready" in first.stderr, "the first tuner")
    spin_until(lambda: levels("tuner: machine"), "its health")
    assert levels("tuner: machine") == {DiagnosticStatus.STALE}  # there is none
    assert levels("tuner: run") == {DiagnosticStatus.OK}
    program = ["-m", "mobo_tuner.nodes.tuner", *TOY, "-p", f"runs_dir:={tmp_path}"]
    second = start_node(*program, "-r", "__node:=tuner2")
    # Of another namespace, but for the same machine.
    third = start_node(*program, "-r", "__ns:=/B", "-r", "/B/heartbeat:=/heartbeat")
    for tuner, rivals in (
        (first, "/B/tuner, /tuner2"),
        (second, "/B/tuner, /tuner"),
        (third, "/tuner, /tuner2"),
    ):
        spin_until(
            lambda: f"other tuners, {rivals}, also publish " in tuner.stderr,  # noqa: B023
            f"the warning of {rivals}",
        )
    spin_until(
        lambda: all(DiagnosticStatus.WARN in levels(f"{n}: run") for n in ("tuner", "B/tuner")),
        "the warning on /diagnostics",
    )
    spin_until(lambda: "other tuners" in statuses.messages[-1].message, "the warning in the status")
    start_node("-m", "awa_sim_node.node", *TOY)
    spin_until(
        lambda: (
            "3 tuners send /heartbeat; a machine serves one at a time"
            in [
                s.message for m in health.messages for s in m.status if s.name == "awa_sim: machine"
            ]
        ),
        "the warning of the machine",
    )
    assert DiagnosticStatus.WARN in levels("awa_sim: machine")
    for tuner in (second, third):
        tuner.kill()
    spin_until(lambda: statuses.messages[-1].message == "", "the end of the warning", 40.0)

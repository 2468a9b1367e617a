"""Fixtures of tests with real ROS: a domain of one's own, and nodes in it."""

from __future__ import annotations

import os
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from launcher import watchdog
from launcher.ros_domain import RosDomain
from tests.support.processes import (
    TIMEOUT,
    NodeForker,
    NodeProcess,
    NodeStarter,
    end_with_this_process,
)
from tests.support.tuner import CONFIG, GoalClient, Services, tune_client

# Loading the support of a ROS type imports lark, whose deprecated imports we cannot change.
with warnings.catch_warnings():
    warnings.simplefilter("ignore", DeprecationWarning)
    import lark  # noqa: F401


def pytest_configure(config: pytest.Config) -> None:
    """Let no process outlive the tests, however they end."""
    config.add_cleanup(NodeForker.server.close)
    process = end_with_this_process()
    if process is None:
        return

    def wait() -> None:
        process.communicate(timeout=watchdog.PATIENCE + 10.0)
        os.environ.pop(watchdog.MARKER, None)

    config.add_cleanup(wait)


TIME_LIMIT = pytest.StashKey[Any]()
LONGEST = (
    "system/test_resume.py",
    "core/test_belief.py",
    "system/test_machines.py",
    "core/test_hints.py",
    "offline/test_campaign.py",
    "core/test_context.py",
    "system/test_run.py",
)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the files that take longest, so that no process is left alone with one of them."""
    places = {Path(__file__).parent / name: place for place, name in enumerate(LONGEST)}
    items.sort(key=lambda item: places.get(item.path, len(LONGEST)))


@pytest.hookimpl(tryfirst=True)
def pytest_timeout_set_timer(item: pytest.Item, settings: Any) -> None:
    """Keep a test's limit of time; pytest-timeout sets its timer."""
    item.stash[TIME_LIMIT] = settings


@pytest.hookimpl(trylast=True)
def pytest_exception_interact(node: pytest.Item | pytest.Collector) -> None:
    """Limit the end and the second try of a test that failed, too: its failure has stopped its timer."""
    if isinstance(node, pytest.Item) and TIME_LIMIT in node.stash:
        node.ihook.pytest_timeout_set_timer(item=node, settings=node.stash[TIME_LIMIT])


@pytest.fixture
def ros_domain(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """A ROS domain id that no other test and no run on this machine uses, set for this process."""
    with RosDomain() as domain:
        for name, value in domain.environment.items():
            monkeypatch.setenv(name, value)
        monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path / "ros_log"))
        yield domain.id


@pytest.fixture
def context(ros_domain: int) -> Iterator[Context]:
    """An rclpy context in the test's domain."""
    context = Context()
    rclpy.init(context=context, domain_id=ros_domain)
    yield context
    context.try_shutdown()


@pytest.fixture
def executor(context: Context) -> Iterator[SingleThreadedExecutor]:
    """An executor of the test's context; the test spins it."""
    executor = SingleThreadedExecutor(context=context)
    yield executor
    executor.shutdown(timeout_sec=1.0)


@pytest.fixture
def node(context: Context, executor: SingleThreadedExecutor) -> Iterator[Node]:
    """A node of the test process, on the executor."""
    node = Node("test_node", context=context)
    executor.add_node(node)
    yield node
    executor.remove_node(node)
    node.destroy_node()


@pytest.fixture
def spin_until(
    executor: SingleThreadedExecutor,
) -> Callable[..., None]:
    """Spin the executor until a condition holds: ``spin_until(condition, what, timeout)``."""

    def spin(condition: Callable[[], object], what: str, timeout: float = TIMEOUT) -> None:
        deadline = time.monotonic() + timeout
        while not condition():
            if time.monotonic() > deadline:
                pytest.fail(f"waited {timeout:g} s in vain for {what}")
            executor.spin_once(timeout_sec=0.05)

    return spin


@pytest.fixture
def start_node(ros_domain: int, tmp_path: Path) -> Iterator[NodeStarter]:
    """Start ``python ARGUMENTS...`` in the test's domain; whatever still runs is killed after it."""
    del ros_domain  # has set the environment
    starter = NodeForker(tmp_path)
    yield starter
    for process in starter.processes:
        process.kill()


@pytest.fixture
def start_tuner(start_node: NodeStarter, tmp_path: Path) -> Callable[..., NodeProcess]:
    """Start the tuner with parameters such as ``seed:=3``; runs are kept in ``tmp_path/runs``."""

    def start(*parameters: str, config: str | Path = "toy.yaml") -> NodeProcess:
        settings = (f"runs_dir:={tmp_path / 'runs'}", *parameters)
        options = [word for text in settings for word in ("-p", f"tuner:{text}")]
        file = ["--params-file", str(CONFIG / config)]
        return start_node("-m", "mobo_tuner.nodes.tuner", "--ros-args", *file, *options)

    return start


@pytest.fixture
def start_machine(start_node: NodeStarter) -> Callable[..., NodeProcess]:
    """Start the simulated machine with parameters such as ``speed:=10.0``."""

    def start(*parameters: str, config: str | Path = "toy.yaml") -> NodeProcess:
        options = [word for text in parameters for word in ("-p", f"awa_sim:{text}")]
        file = ["--params-file", str(CONFIG / config)]
        return start_node("-m", "awa_sim_node.node", "--ros-args", *file, *options)

    return start


@pytest.fixture
def client(node: Node, spin_until: Callable[..., None]) -> GoalClient:
    """A client of the `tune` action."""
    return tune_client(node, spin_until)


@pytest.fixture
def services(node: Node, spin_until: Callable[..., None]) -> Services:
    """Calls the tuner's services."""
    return Services(node, spin_until)

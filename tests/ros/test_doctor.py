"""The checks for `ros2 doctor`, found, loaded and run as it does."""

from __future__ import annotations

from collections.abc import Callable
from importlib.metadata import entry_points
from typing import Any

import pytest

from tests.support.processes import NodeProcess

Start = Callable[..., NodeProcess]


def run_checks() -> tuple[set[str], int, int]:
    """The categories of failed checks, and the numbers of errors and warnings, of our checks alone."""
    failed, errors, warnings = set(), 0, 0
    for entry in entry_points(group="ros2doctor.checks"):
        if not entry.value.startswith("mobo_tuner."):
            continue
        check: Any = entry.load()()
        result = check.check()
        if result.error or result.warning:
            failed.add(check.category())
        errors += result.error
        warnings += result.warning
    return failed, errors, warnings


def test_a_missing_machine_and_a_second_tuner_are_found(
    start_tuner: Start,
    start_machine: Start,
    spin_until: Callable[..., None],
    capsys: pytest.CaptureFixture[str],
) -> None:
    names = {e.name for e in entry_points(group="ros2doctor.checks") if "mobo" in e.name}
    assert names == {"mobo_machine", "mobo_tuner"}
    assert run_checks() == (set(), 0, 0)  # nothing is there

    tuner = start_tuner()
    spin_until(lambda: "ready" in tuner.stderr, "the tuner")
    spin_until(lambda: run_checks() == ({"mobo_tuner"}, 1, 0), "the error")
    assert "/tuner has no machine: nothing serves /describe_machine" in capsys.readouterr().err

    machine = start_machine()
    spin_until(lambda: "ready" in machine.stderr, "the machine")
    spin_until(lambda: run_checks() == (set(), 0, 0), "the end of the error")
    (entry,) = entry_points(group="ros2doctor.report", name="mobo_tuner")
    report = entry.load()().report()
    assert report.name == "MOBO TUNERS"
    assert ("tuner", "/tuner") in report.items
    assert ("machines", "1 on /describe_machine") in report.items

    start_tuner()
    start_machine()
    spin_until(lambda: run_checks() == ({"mobo_tuner"}, 2, 1), "both, for each tuner")
    said = capsys.readouterr().err
    assert "/tuner has 2 machines that serve /describe_machine" in said
    assert "2 tuners send /heartbeat: /tuner, /tuner" in said

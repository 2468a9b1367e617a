"""What a terminal shows of a run."""

from __future__ import annotations

import errno
import io
import math
import re
from dataclasses import replace
from typing import Any

import pytest
from rich.console import Console

from mobo_tuner.client import Evaluation, Front, Point, Status
from mobo_tuner.client.values import ContextReading
from mobo_tuner.core.problem import Constraint, Objective, Problem
from mobo_tuner.displays.console_view import (
    LiveView,
    PlainView,
    evaluation_line,
    render,
    sparkline,
)
from mobo_tuner.displays.progress import RunProgress, contexts_text

EVALUATION = Evaluation(
    run_id="run",
    index=31,
    source="model",
    attempts=1,
    stamp=0.0,
    setpoint={"K1": 480.0},
    readbacks={},
    diagnostics={"eps_x": (32.5, 0.25), "yield": (0.5, math.nan)},
    objectives={"eps_x": 32.5, "yield": 0.5},
    units={"K1": "A", "eps_x": "mm mrad"},
    valid=True,
    feasible=True,
    non_dominated=True,
    hypervolume=1234.5,
    hypervolume_measured=1234.5,
    error_code=0,
    error_msg="",
    suggest_seconds=0.25,
    machine_seconds=1.0,
    total_seconds=2.0,
)


class Gone(io.StringIO):
    """A terminal that was closed."""

    def isatty(self) -> bool:
        return True

    def write(self, text: str) -> int:
        del text
        raise OSError(errno.EIO, "Input/output error")


@pytest.mark.parametrize("kind", [LiveView, PlainView])
def test_a_view_knows_that_nobody_reads_it(
    kind: type[LiveView | PlainView], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TERM", "xterm")
    stream = Gone()
    view = kind("run", 60, None if kind is LiveView else stream)
    if isinstance(view, LiveView):
        view._live.console.file = stream
    assert not view.unseen
    view.evaluation(EVALUATION)
    assert view.unseen
    view.close()


def shown(progress: RunProgress, stage: str = "", width: int = 100) -> str:
    """Return the live view as text."""
    console = Console(file=io.StringIO(), width=width)
    with console.capture() as capture:
        console.print(render("run", progress, stage))
    return capture.get()


@pytest.mark.parametrize(
    ("change", "end"),
    [
        ({}, "suggested in 0.25 s"),
        ({"feasible": False}, "suggested in 0.25 s, infeasible"),
        (
            {"valid": False, "feasible": False, "error_msg": "no beam"},
            "suggested in 0.25 s, failed: no beam",
        ),
    ],
)
def test_a_line_counts_from_0_as_the_tuner_does(change: dict[str, Any], end: str) -> None:
    line = evaluation_line(replace(EVALUATION, **change), 60)
    assert line.startswith("evaluation 31, 32 of 60 done: hypervolume 1234.5, eps_x 32.5 mm mrad")
    assert line.endswith(end)


def test_the_live_view_shows_figures_of_the_run_and_why_it_waits() -> None:
    progress = RunProgress(60)
    assert "looking" in shown(progress, "looking")
    progress.set_problem(
        Problem((), (Objective("eps_x", 150.0, goal=35.0), Objective("yield", 0.0, "maximize")))
    )
    progress.add(replace(EVALUATION, index=30, objectives={"eps_x": 40.0, "yield": 0.75}))
    progress.add(replace(EVALUATION, index=31))
    progress.add(replace(EVALUATION, index=32, valid=False, feasible=False))
    progress.set_front(Front("run", (), 0.0, 0.0, {}, {}))
    progress.set_status(Status("paused", budget=60, message="paused: a limit was violated"))
    text = shown(progress)
    assert "evaluation 32, 3 of 60 done" in text
    assert "a limit was violated" in text
    assert re.search(r"0 on the front *\n2 feasible   1 failed", text)
    assert "about 1:54 left" in text  # 57 evaluations of 2 s
    rows = {line.split()[0]: line for line in text.splitlines() if line.strip()}
    assert rows["eps_x"].split()[-1] == "31"
    assert "35 ✓" in rows["eps_x"]  # good enough
    assert rows["yield"].split()[-2:] == ["0.75", "30"]


@pytest.mark.parametrize("width", [60, 80, 200])
def test_the_live_view_fits_the_width_of_the_terminal(width: int) -> None:
    progress = RunProgress(60)
    names = [f"eps_{i}" for i in range(7)]
    values = {name: 1234.5 + i for i, name in enumerate(names)}
    spreads = {name: (value, 34.5) for name, value in values.items()}
    for index in range(40):
        volume = math.nan if index == 5 else float(index)
        made = replace(
            EVALUATION, index=index, objectives=values, diagnostics=spreads, hypervolume=volume
        )
        progress.add(made)
    points = [Point(i, {}, {n: v * (1 + i) for n, v in values.items()}, {}) for i in (0, 1)]
    progress.set_front(Front("run", tuple(points), 0.0, 0.0, {}, {}))
    lines = shown(progress, width=width).splitlines()
    assert max(map(len, lines)) <= width
    assert "evaluation 39, 40 of 60 done" in " ".join(lines)
    [spark] = [line.strip() for line in lines if "█" in line]
    assert spark == sparkline(progress.hypervolumes, min(width - 1, 60))
    [row] = [line for line in lines if line.startswith("eps_6")]
    assert "1.24e+03 to 2.48e+03" in row
    assert ("± 30" in row) == (width > 60)
    assert "left" in " ".join(lines)
    assert len(lines) == 6 + 8  # no value goes on in a second line


def test_a_sparkline_shows_the_whole_run_in_its_width() -> None:
    assert sparkline([], 10) == ""
    assert sparkline([0.0, 0.0], 10) == "▁▁"
    assert sparkline([0.0, math.nan, 8.0], 10) == "▁ █"
    long = sparkline([float(i) for i in range(5000)], 40)
    assert (len(long), long[-1]) == (40, "█")


def test_the_plain_view_says_once_why_the_run_waits() -> None:
    stream = io.StringIO()
    view = PlainView("run", 60, stream)
    waits = [
        Status("waiting", message=f"the machine is not there; up to 300 s, {left} s are left")
        for left in (300, 299)
    ]
    for status in (*waits, Status("evaluating"), Status("paused", message="by hand")):
        view.status(status)
    view.evaluation(EVALUATION)
    view.close()
    view.evaluation(EVALUATION)
    assert stream.getvalue().splitlines() == [
        "waiting: the machine is not there; up to 300 s, 300 s are left",
        "paused: by hand",
        evaluation_line(EVALUATION, 60),
    ]


def test_figures_are_those_of_the_problem_as_it_is_now() -> None:
    progress = RunProgress(60)
    objectives = (Objective("eps_x", 150.0), Objective("yield", 0.0, "maximize"))
    progress.set_problem(Problem((), objectives))
    good = replace(
        EVALUATION, objectives={"eps_x": 9.0, "yield": 0.25}, diagnostics={"yield": (0.25, 0.1)}
    )
    progress.add(good)
    progress.add(replace(EVALUATION, index=32))
    assert progress.best("eps_x") == (9.0, 31)
    progress.set_problem(Problem((), objectives, (Constraint("yield", minimum=0.4),)))
    assert progress.best("eps_x") == (32.5, 32)
    assert progress.feasible == 1
    progress.set_status(Status("paused", "run", 2, feasible=1, failed=1, hypervolume=7.5))
    assert (progress.feasible, progress.failed, progress.hypervolume) == (1, 1, 7.5)
    assert "hypervolume 7.5" in shown(progress)


def test_hints_are_shown_once_and_stay_in_the_live_view() -> None:
    hint = "x reads in steps of 0.25 A"
    stream = io.StringIO()
    view = PlainView("run", 60, stream)
    for status in (Status("evaluating", hints=(hint,)), Status("paused", hints=(hint,))):
        view.status(status)
    assert stream.getvalue().splitlines() == [f"hint: {hint}"]
    progress = RunProgress(60)
    progress.set_status(Status("evaluating", hints=(hint,)))
    assert hint in shown(progress)


def test_contexts_are_shown_with_what_is_not_fresh() -> None:
    readings = (
        ContextReading("hall", 22.456, "degC"),
        ContextReading("charge", 1.02, "nC", stale=True),
        ContextReading("flow", math.nan, "l/s", stale=True),
    )
    assert contexts_text(Status("idle")) == ""
    status = Status("suggesting", contexts=readings)
    text = contexts_text(status)
    assert text == "hall 22.46 degC; charge 1.02 nC (stale); flow not measured yet"
    progress = RunProgress(60)
    progress.add(EVALUATION)
    assert "context" not in shown(progress)
    progress.set_status(status)
    assert "charge 1.02 nC (stale)" in shown(progress)

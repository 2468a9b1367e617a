"""What the console shows of a run: a view that is redrawn, or one line per evaluation."""

from __future__ import annotations

import math
import os
import sys
import time
from typing import TextIO

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from mobo_msgs_py.msg import Evaluation, NamedValue, TunerStatus
from mobo_tuner.displays.progress import RunProgress

_STATES = {
    TunerStatus.IDLE: "idle",
    TunerStatus.WAITING: "waiting for the machine",
    TunerStatus.SUGGESTING: "computing the next candidate",
    TunerStatus.EVALUATING: "the machine is at work",
    TunerStatus.CANCELING: "stopping",
    TunerStatus.PAUSED: "paused",
    TunerStatus.MOVING: "the machine is sent to a set-point",
}


class LiveView:
    """One view in the terminal, drawn over and over."""

    def __init__(self, progress: RunProgress, stream: TextIO | None = None) -> None:
        self._progress = progress
        self._stage = ""
        self._live = Live(console=Console(file=stream), auto_refresh=False)
        self._live.start()

    def stage(self, text: str) -> None:
        """Say what is waited for; empty while the run goes on."""
        self._stage = text
        self.refresh()

    def evaluation(self, evaluation: Evaluation) -> None:
        """Nothing to do: the next refresh shows it."""

    def refresh(self) -> None:
        """Draw what is known now."""
        if self._live.is_started:
            self._live.update(render(self._progress, self._stage), refresh=True)

    def close(self) -> None:
        """Leave the last view standing."""
        self.refresh()
        self._live.stop()


class PlainView:
    """One line per evaluation, for logs and pipes."""

    def __init__(self, progress: RunProgress, stream: TextIO | None = None) -> None:
        self._progress = progress
        self._stream = stream

    def stage(self, text: str) -> None:
        """Say what is waited for."""
        if text:
            print(text, file=self._stream, flush=True)

    def evaluation(self, evaluation: Evaluation) -> None:
        """Print the line of an evaluation."""
        print(evaluation_line(evaluation, self._progress.budget), file=self._stream, flush=True)

    def refresh(self) -> None:
        """Nothing to do: lines are not drawn twice."""

    def close(self) -> None:
        """Nothing to do."""


def make_view(progress: RunProgress) -> LiveView | PlainView:
    """A live view where standard output is a terminal, lines elsewhere."""
    drawable = sys.stdout.isatty() and os.environ.get("TERM", "dumb") != "dumb"
    return LiveView(progress) if drawable else PlainView(progress)


def evaluation_line(evaluation: Evaluation, budget: int) -> str:
    """An evaluation in one line."""
    parts = [f"hypervolume {evaluation.hypervolume:.6g}"]
    parts += [_quantity(item) for item in evaluation.objectives]
    parts.append(f"suggested in {evaluation.suggest_seconds:.2f} s")
    if not evaluation.valid:
        parts.append(f"failed: {evaluation.error_msg or 'not fully measured'}")
    elif not evaluation.feasible:
        parts.append("infeasible")
    number = f"{evaluation.index + 1:>{len(str(budget))}}"
    return f"evaluation {number} of {budget}: {', '.join(parts)}"


def render(progress: RunProgress, stage: str = "") -> RenderableType:
    """The live view."""
    head = Text.assemble(("run ", "dim"), (progress.run_id, "bold"))
    head.append(f"   {stage or _activity(progress.status)}", "cyan")
    if progress.last is None:
        return head
    return Group(head, _bar(progress), _figures(progress), Text(), _objectives(progress))


def _activity(status: TunerStatus) -> str:
    if status.state == TunerStatus.EVALUATING and status.phase:
        return f"machine: {status.phase} {status.fraction:.0%}"
    return _STATES.get(status.state, "")


def _bar(progress: RunProgress) -> RenderableType:
    elapsed = time.monotonic() - progress.started
    left = elapsed / progress.evaluations * max(progress.budget - progress.evaluations, 0)
    row = Table.grid(padding=(0, 2, 0, 0))
    row.add_row(
        f"evaluation [bold]{progress.evaluations}[/bold] of {progress.budget}",
        ProgressBar(total=max(progress.budget, 1), completed=progress.evaluations, width=30),
        f"[dim]{_duration(elapsed)}, about {_duration(left)} left[/dim]",
    )
    return row


def _figures(progress: RunProgress) -> RenderableType:
    assert progress.last is not None
    failed_style = "red" if progress.failed else "dim"
    return Text.assemble(
        "hypervolume ",
        (f"{progress.hypervolume:.5g}", "bold green"),
        (f"   {progress.front_size} on the front", "dim"),
        (f"   {progress.feasible} feasible", "dim"),
        (f"   {progress.failed} failed", failed_style),
        (
            f"\nsuggestion {progress.last.suggest_seconds:.2f} s,"
            f" median {progress.suggest_median:.2f} s",
            "dim",
        ),
    )


def _objectives(progress: RunProgress) -> RenderableType:
    assert progress.last is not None
    table = Table(box=None, padding=(0, 3, 0, 0), header_style="dim")
    table.add_column("objective")
    table.add_column("last", justify="right")
    table.add_column("best", justify="right")
    table.add_column("unit", style="dim")
    table.add_column("best at", justify="right", style="dim")
    for item in progress.last.objectives:
        best = progress.best(item.name)
        newest = best is not None and best[1] == progress.last.index
        table.add_row(
            item.name,
            _value(item),
            Text("—" if best is None else f"{best[0]:.4g}", "bold green" if newest else "bold"),
            item.unit,
            "" if best is None else f"index {best[1]}",
        )
    return table


def _value(item: NamedValue) -> str:
    if math.isnan(item.value):
        return "—"
    spread = "" if math.isnan(item.stddev) else f" ± {item.stddev:.1g}"
    return f"{item.value:.4g}{spread}"


def _quantity(item: NamedValue) -> str:
    value = "not measured" if math.isnan(item.value) else f"{item.value:.4g} {item.unit}".rstrip()
    return f"{item.name} {value}"


def _duration(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}" if hours else f"{minutes}:{rest:02}"

"""What a terminal shows of a run: a view that is redrawn, or one line per evaluation."""

from __future__ import annotations

import math
import os
import re
import sys
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from typing import TextIO, TypedDict

from rich.console import Console, ConsoleOptions, Group, RenderableType, RenderResult
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from mobo_tuner.client import Evaluation, Front, Status, TunerClient
from mobo_tuner.client.follower import OnEvaluation, OnFront, OnProblem, OnStatus
from mobo_tuner.core.problem import Problem
from mobo_tuner.displays.keys import HELP, Keys, reading_keys
from mobo_tuner.displays.progress import RunProgress, contexts_text

BAR_WIDTH, SPARK_WIDTH = 30, 60  # at most
ROOMY = 70  # columns from which on standard deviations are shown
BARS = "▁▂▃▄▅▆▇█"
_COUNTDOWN = re.compile(r", \d+ s are left$")
_STATES = {
    "idle": "idle",
    "waiting": "waiting for the machine",
    "suggesting": "computing the next candidate",
    "evaluating": "the machine is at work",
    "canceling": "stopping",
    "paused": "paused",
    "moving": "the machine is sent to a set-point",
}


class Callbacks(TypedDict):
    """What `TunerClient.tune` and `TunerClient.watch` take."""

    on_evaluation: OnEvaluation
    on_status: OnStatus
    on_front: OnFront
    on_problem: OnProblem


class RunView:
    """A view of one run; what it shows, and when, is up to its kinds.

    Args:
        run_id: Id of the run.
        budget: Number of evaluations asked for; 0 until it is known.

    Attributes:
        unseen: Whether nobody reads it any more: its terminal or pipe was closed.
    """

    def __init__(self, run_id: str, budget: int = 0) -> None:
        self.run_id = run_id
        self.unseen = False
        self.progress = RunProgress(budget)

    @property
    def callbacks(self) -> Callbacks:
        """What keeps the view up to date."""
        return {
            "on_evaluation": self.evaluation,
            "on_status": self.status,
            "on_front": self.front,
            "on_problem": self.problem,
        }

    def stage(self, text: str) -> None:
        """Say what is waited for before the run; empty once it has begun."""

    def hint(self, text: str) -> None:
        """Say what the user can do now."""

    def keys(self, client: TunerClient) -> AbstractContextManager[None]:
        """Let keys steer the run until the end of the block, if this is the view of a terminal.

        Args:
            client: Client of the tuner.
        """
        del client
        return nullcontext()

    def evaluation(self, evaluation: Evaluation) -> None:
        """Show an evaluation."""
        self.progress.add(evaluation)

    def status(self, status: Status) -> None:
        """Show what the tuner does."""
        self.progress.set_status(status)

    def front(self, front: Front) -> None:
        """Show the front."""
        self.progress.set_front(front)

    def problem(self, problem: Problem) -> None:
        """Take note of what is tuned."""
        self.progress.set_problem(problem)

    def close(self) -> None:
        """Release the terminal; what was shown stays."""


class LiveView(RunView):
    """A view that is drawn again and again in one place of the terminal."""

    def __init__(self, run_id: str, budget: int = 0, stream: TextIO | None = None) -> None:
        super().__init__(run_id, budget)
        self._stage = ""
        self._hint = ""
        self._live = Live(console=Console(file=stream), auto_refresh=False)
        self._live.start()

    def stage(self, text: str) -> None:
        """Show what is waited for."""
        self._stage = text
        self._draw()

    def hint(self, text: str) -> None:
        """Show what the user can do now."""
        self._hint = text
        self._draw()

    def evaluation(self, evaluation: Evaluation) -> None:
        """Show an evaluation."""
        super().evaluation(evaluation)
        self._draw()

    def status(self, status: Status) -> None:
        """Show what the tuner does; it comes at least once a second."""
        super().status(status)
        self._draw()

    @contextmanager
    def keys(self, client: TunerClient) -> Iterator[None]:
        """Let keys steer the run until the end of the block."""
        with reading_keys(Keys(client, self.hint).press) as readable:
            if readable:
                self.hint(HELP)
            yield

    def close(self) -> None:
        """Leave the last view in the terminal."""
        self._draw()
        with suppress(OSError):
            self._live.stop()

    def _draw(self) -> None:
        if not self._live.is_started:
            return
        try:
            self._live.update(
                render(self.run_id, self.progress, self._stage, self._hint), refresh=True
            )
        except OSError:  # what the view follows goes on
            self.unseen = True


class PlainView(RunView):
    """One line per evaluation, for each reason to wait and for each second of a move."""

    def __init__(self, run_id: str, budget: int = 0, stream: TextIO | None = None) -> None:
        super().__init__(run_id, budget)
        self._stream = stream
        self._wait = ""
        self._hints: tuple[str, ...] = ()
        self._closed = False

    def stage(self, text: str) -> None:
        """Print what is waited for."""
        if text:
            self._print(text)

    def hint(self, text: str) -> None:
        """Print what the user can do now."""
        self._print(text)

    def evaluation(self, evaluation: Evaluation) -> None:
        """Print the line of an evaluation."""
        super().evaluation(evaluation)
        self._print(evaluation_line(evaluation, self.progress.budget))

    def status(self, status: Status) -> None:
        """Print why the run waits, once, and how far the machine has moved after a run."""
        super().status(status)
        wait = status.message if status.state in ("waiting", "paused") else ""
        if status.state == "moving":
            wait = status.message or _STATES["moving"]
            wait += f", {status.phase} {status.fraction:.0%}" if status.phase else ""
        reason = _COUNTDOWN.sub("", wait)
        if reason and reason != self._wait:
            self._print(f"{status.state}: {wait}")
        self._wait = reason
        for text in status.hints:
            if text not in self._hints:
                self._print(f"hint: {text}")
        self._hints = status.hints

    def close(self) -> None:
        """Print no more."""
        self._closed = True

    def _print(self, text: str) -> None:
        if self._closed:
            return
        try:
            print(text, file=self._stream, flush=True)
        except OSError:  # as above
            self.unseen = True


def make_view(run_id: str, budget: int = 0) -> RunView:
    """Return a live view where standard output is a terminal, lines elsewhere."""
    drawable = sys.stdout.isatty() and os.environ.get("TERM", "dumb") != "dumb"
    return (LiveView if drawable else PlainView)(run_id, budget)


def evaluation_line(evaluation: Evaluation, budget: int) -> str:
    """Return an evaluation in one line."""
    parts = [f"hypervolume {evaluation.hypervolume:.6g}"]
    parts += [_quantity(evaluation, name) for name in evaluation.objectives]
    parts.append(f"suggested in {evaluation.suggest_seconds:.2f} s")
    if not evaluation.valid:
        parts.append(f"failed: {evaluation.error_msg or 'not measured'}")
    elif not evaluation.feasible:
        parts.append("infeasible")
    width = len(str(budget))
    where = f"evaluation {evaluation.index:>{width}}, {evaluation.index + 1:>{width}} of {budget}"
    return f"{where} done: {', '.join(parts)}"


def render(run_id: str, progress: RunProgress, stage: str = "", hint: str = "") -> RenderableType:
    """Return the live view."""
    head = Text.assemble(("run ", "dim"), (run_id, "bold"))
    head.append(f"   {stage or _activity(progress.status)}", "cyan")
    if progress.status.message:
        head.append(f"\n{progress.status.message}", "yellow")
    for text in progress.status.hints:
        head.append(f"\nhint: {text}", "yellow")
    if hint:
        head.append(f"\n{hint}", "bold")
    if progress.last is None:
        return head
    return Group(
        head,
        _Bar(progress),
        _figures(progress),
        _Sparkline(progress),
        Text(),
        _Objectives(progress),
    )


def _activity(status: Status) -> str:
    if status.state in ("evaluating", "moving") and status.phase:
        return f"machine: {status.phase} {status.fraction:.0%}"
    return _STATES.get(status.state, "")


class _Bar:
    """How far the run is; the bar gets the room that the texts leave, if it is enough."""

    def __init__(self, progress: RunProgress) -> None:
        self._progress = progress

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        progress = self._progress
        assert progress.last is not None
        done = progress.evaluations
        texts = (
            f"evaluation {progress.last.index}, {done} of {progress.budget} done",
            f"{_duration(progress.seconds)}, about {_duration(progress.seconds_left)} left",
        )
        room = options.max_width - sum(map(len, texts)) - 2 * len(texts)
        bar = ProgressBar(
            total=max(progress.budget, 1), completed=done, width=min(max(room, 8), BAR_WIDTH)
        )
        row = Table.grid(padding=(0, 2, 0, 0))
        row.add_row(
            Text(texts[0], no_wrap=True),
            *([] if room < 8 else [bar]),
            Text(texts[1], "dim", no_wrap=True),
        )
        yield row


class _Sparkline:
    """The hypervolume over the evaluations, in one line."""

    def __init__(self, progress: RunProgress) -> None:
        self._values = progress.hypervolumes

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        yield Text(sparkline(self._values, min(options.max_width - 1, SPARK_WIDTH)), "green")


def sparkline(values: Sequence[float], width: int) -> str:
    """Return values as one line of bars, from 0 to the largest; unknown ones are gaps.

    Args:
        values: Values in their order.
        width: Most characters; of more values, the last of each group is shown.

    Example:
        >>> sparkline([0.0, 1.0, 2.0, 4.0, 8.0], 10)
        '▁▂▃▅█'
    """
    count = min(len(values), max(width, 1))
    shown = [values[(i + 1) * len(values) // count - 1] for i in range(count)]
    top = max((value for value in shown if math.isfinite(value)), default=0.0)
    if top <= 0.0:
        return BARS[0] * count
    steps = len(BARS) - 1
    return "".join(
        BARS[math.ceil(max(value, 0.0) / top * steps)] if math.isfinite(value) else " "
        for value in shown
    )


def _figures(progress: RunProgress) -> RenderableType:
    assert progress.last is not None
    failed_style = "red" if progress.failed else "dim"
    return Text.assemble(
        "hypervolume ",
        (f"{progress.hypervolume:.5g}", "bold green"),
        (f"   {progress.front_size} on the front", "dim"),
        (f"\n{progress.feasible} feasible", "dim"),
        (f"   {progress.failed} failed", failed_style),
        (
            f"   suggestion {progress.last.suggest_seconds:.2f} s,"
            f" median {progress.suggest_median:.2f} s",
            "dim",
        ),
        (f"\ncontext {contexts}" if (contexts := contexts_text(progress.status)) else "", "dim"),
    )


class _Objectives:
    """Last and best value of every objective; a narrow terminal has no room for the standard deviations."""

    def __init__(self, progress: RunProgress) -> None:
        self._progress = progress

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        progress, last = self._progress, self._progress.last
        assert last is not None
        table = Table(box=None, padding=(0, 2, 0, 0), header_style="dim")
        table.add_column("objective", no_wrap=True)
        table.add_column("last", justify="right", no_wrap=True)
        table.add_column("best", justify="right")
        goals = progress.goals
        if goals:
            table.add_column("good enough", justify="right", style="dim")
        table.add_column("unit", style="dim")
        table.add_column("at", justify="right", style="dim")
        table.add_column("on the front", style="dim", no_wrap=True)
        for name in last.objectives:
            best, ends = progress.best(name), progress.front_range(name)
            newest = best is not None and best[1] == last.index
            table.add_row(
                name,
                _value(last, name, with_stddev=options.max_width >= ROOMY),
                Text("—" if best is None else f"{best[0]:.4g}", "bold green" if newest else "bold"),
                *([_goal(progress, name)] if goals else []),
                last.units.get(name, ""),
                "" if best is None else f"{best[1]}",
                "" if ends is None else f"{ends[0]:.3g} to {ends[1]:.3g}",
            )
        yield table


def _goal(progress: RunProgress, name: str) -> Text:
    """Return what is good enough for an objective, and whether the best reading is."""
    goal = progress.goals.get(name)
    if goal is None:
        return Text("")
    return Text(f"{goal:.4g} ✓", "green") if progress.is_reached(name) else Text(f"{goal:.4g}")


def _value(evaluation: Evaluation, name: str, *, with_stddev: bool) -> str:
    value, stddev = evaluation.objectives[name], evaluation.stddev(name)
    if math.isnan(value):
        return "—"
    shown = with_stddev and math.isfinite(stddev)
    spread = f" ± {float(f'{stddev:.1g}'):g}" if shown else ""  # 30 rather than 3e+01
    return f"{value:.4g}{spread}"


def _quantity(evaluation: Evaluation, name: str) -> str:
    value = evaluation.objectives[name]
    if math.isnan(value):
        return f"{name} not measured"
    return f"{name} {value:.4g} {evaluation.units.get(name, '')}".rstrip()


def _duration(seconds: float) -> str:
    if not math.isfinite(seconds):
        return "?"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}" if hours else f"{minutes}:{rest:02}"

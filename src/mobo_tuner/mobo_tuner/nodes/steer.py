"""Steer a tuner from the shell: watch, pause, change and end its run, and go to working points."""

from __future__ import annotations

import argparse
import json
import math
import os
import signal
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NoReturn, TextIO

from mobo_tuner.client import (
    Arrival,
    ErrorCode,
    Front,
    Movement,
    Point,
    Status,
    TunerClient,
    TunerError,
)
from mobo_tuner.displays.console_view import make_view
from mobo_tuner.displays.progress import contexts_text
from mobo_tuner.errors import ParameterError
from mobo_tuner.wording import counted

POLL_PERIOD = 0.1  # [s]
CANCEL_TIMEOUT = 900.0  # [s] for the machine to be back where `on_abort` sends it
EXIT_ERROR = 1
EXIT_INTERRUPTED = 130
TOP = 20  # points of a front that are listed
REFUSALS = (ErrorCode.REFUSED, ErrorCode.INVALID_GOAL, ErrorCode.INVALID_VALUE)

Act = Callable[[TunerClient, argparse.Namespace], str]


def status(client: TunerClient, _: argparse.Namespace) -> str:
    """Print the state of the tuner."""
    now = client.status()
    text = f"{now.state} {now.phase}".rstrip()
    if now.run_id:
        text += f"; run {now.run_id}: {_counts(now)}"
    if now.message:
        text += f"; {now.message}"
    if now.last_failure:
        text += f"\nlast failure: {now.last_failure}"
    if now.contexts:
        text += f"\ncontext: {contexts_text(now)}"
    if now.recorder and not any(now.recorder in hint for hint in now.hints):
        text += f"\n{now.recorder}"
    if math.isfinite(now.free_space):
        text += f"\ndisk of the runs: {now.free_space / 1e9:.1f} GB are left"
    return text + "".join(f"\nhint: {hint}" for hint in now.hints)


def watch(client: TunerClient, _: argparse.Namespace) -> str:
    """Show the active run until it ends; keys steer it, and Ctrl-C only ends the view."""
    now = client.status()
    view = make_view(now.run_id, now.budget)

    def show(status: Status) -> None:
        view.status(status)
        if view.unseen:  # the signal of a closed terminal may be lost in an error of writing to it
            raise KeyboardInterrupt

    callbacks = view.callbacks
    callbacks["on_status"] = show
    try:
        with view.keys(client):
            last = client.watch(**callbacks)
    except KeyboardInterrupt:
        return f"run {now.run_id} continues"
    finally:
        view.close()
    text = f"run {last.run_id} has ended ({last.stop_reason}): {_counts(last)}"
    return f"{text}; {last.message}" if last.message else text


def cancel(client: TunerClient, _: argparse.Namespace) -> str:
    """Cancel the active run or move."""
    if not client.cancel_any():
        raise TunerError(ErrorCode.REFUSED, "no run or move is active")
    deadline = time.monotonic() + CANCEL_TIMEOUT
    while (now := client.status()).state != "idle":
        if time.monotonic() > deadline:
            raise TunerError(
                ErrorCode.NO_ANSWER,
                f"the tuner is still {now.state} {CANCEL_TIMEOUT:g} s after the cancel",
            )
        time.sleep(POLL_PERIOD)
    return now.message or "canceled"


def pause(client: TunerClient, _: argparse.Namespace) -> str:
    """Pause the run before its next evaluation."""
    return client.pause()


def continue_(client: TunerClient, _: argparse.Namespace) -> str:
    """Continue a paused run."""
    return client.resume()


def step(client: TunerClient, _: argparse.Namespace) -> str:
    """Do one more evaluation, then pause."""
    return client.step()


def skip(client: TunerClient, _: argparse.Namespace) -> str:
    """End the current evaluation, which counts as failed."""
    return client.skip()


def stop(client: TunerClient, _: argparse.Namespace) -> str:
    """End the run after the current evaluation."""
    return client.stop()


def queue(client: TunerClient, options: argparse.Namespace) -> str:
    """Evaluate a set-point of your own next."""
    return f"set-points in the queue: {client.queue(_numbers(client, _once(options.values)))}"


def forget(client: TunerClient, options: argparse.Namespace) -> str:
    """Have an evaluation, or one diagnostic of it, count as never measured."""
    return client.forget(options.index, options.diagnostic)


def unforget(client: TunerClient, options: argparse.Namespace) -> str:
    """Have an evaluation that was withdrawn count again."""
    return client.unforget(options.index, options.diagnostic)


def set_(client: TunerClient, options: argparse.Namespace) -> str:
    """Set parameters of the tuner: all of them, or none."""
    values = _once(options.values)
    client.set(values)
    return f"set: {', '.join(values)}"


def points(client: TunerClient, options: argparse.Namespace) -> str:
    """List the Pareto front of a run."""
    found = client.working_points(options.run, predict=options.predict)
    fronts = [("measured", found.measured)]
    if found.predicted is not None:
        fronts.append(("predicted", found.predicted))
    if options.sort and options.near:
        raise TunerError(ErrorCode.INVALID_VALUE, "give either --sort or --near")
    near = _numbers(client, _once(options.near or ()))
    descending = bool(options.sort) and _is_maximized(client, options.sort)
    tables = []
    for title, front in fronts:
        names = near or ([options.sort] if options.sort else [])
        _check_names(front, names, "--near" if near else "--sort")
        listed = list(front.points)
        if near:
            listed = _nearest(listed, near)
        elif options.sort:
            listed.sort(key=lambda point: _values(point)[options.sort], reverse=descending)
        shown = {name: _choices(client, name) for name in names}
        tables.append(_table(front, listed, title, shown, options.top))
    return "\n\n".join(tables)


def go(client: TunerClient, options: argparse.Namespace) -> str:
    """Go to a point of a run; Ctrl-C stops the machine where it is."""

    def show(movement: Movement) -> None:
        held = f", {counted(movement.evaluations, 'evaluation')}" if movement.evaluations else ""
        _say(f"{movement.phase}{held}", sys.stderr)

    arrival = client.go(
        options.index,
        weights=_once(options.weights) if options.weights else None,
        before=options.before,
        run_id=options.run,
        hold=options.hold,
        radius=options.radius,
        anyway=options.anyway,
        measure=not options.no_measurement,
        on_feedback=show,
    )
    where = ", ".join(
        f"{name} = {_shown(value, _choices(client, name))} {arrival.units.get(name, '')}".rstrip()
        for name, value in arrival.readbacks.items()
    )
    held = f", held with {counted(arrival.evaluations, 'evaluation')}" if options.hold else ""
    index = arrival.point.index
    place = "the state before" if index is None else f"point {index} of"
    text = f"at {place} run {arrival.run_id}{held}: {where}"
    return "\n".join(filter(None, (text, _comparison(arrival), arrival.remark)))


VERBS: dict[str, Act] = {
    "status": status,
    "watch": watch,
    "pause": pause,
    "continue": continue_,
    "step": step,
    "skip": skip,
    "stop": stop,
    "cancel": cancel,
    "queue": queue,
    "forget": forget,
    "unforget": unforget,
    "set": set_,
    "points": points,
    "go": go,
}


class Parser(argparse.ArgumentParser):
    """A parser whose errors are one sentence, without the usage."""

    def error(self, message: str) -> NoReturn:
        """Print the error and end the process with status 2."""
        self.exit(2, f"{self.prog}: {message}; see --help\n")


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = Parser(prog="steer", description=(__doc__ or "").splitlines()[0], allow_abbrev=False)
    verbs = parser.add_subparsers(dest="verb", required=True, metavar="VERB")
    parsers = {}
    for name, act in VERBS.items():
        what = (act.__doc__ or "").splitlines()[0]
        verb = verbs.add_parser(name, help=what, description=what, allow_abbrev=False)
        verb.add_argument(
            "--namespace", metavar="NAME", default="", help="namespace of the tuner (default: none)"
        )
        parsers[name] = verb
    for name, kind, metavar in (
        ("queue", _named_number_or_choice, "NAME=VALUE"),
        ("set", _named_value, "NAME=VALUE"),
    ):
        parsers[name].add_argument("values", nargs="+", type=kind, metavar=metavar)
    for name in ("forget", "unforget"):
        parsers[name].add_argument(
            "index", type=_count, metavar="INDEX", help="index of the evaluation"
        )
        parsers[name].add_argument(
            "diagnostic", nargs="?", default="", metavar="NAME", help="diagnostic (default: all)"
        )
    for name in ("points", "go"):
        parsers[name].add_argument(
            "--run", metavar="ID", default="", help="id of the run (default: the last one)"
        )
    parsers["points"].add_argument(
        "--top",
        type=_count,
        default=TOP,
        metavar="N",
        help=f"number of points to list; 0 = all (default: {TOP})",
    )
    parsers["points"].add_argument(
        "--near",
        nargs="+",
        type=_named_number_or_choice,
        metavar="NAME=VALUE",
        help="list the points nearest to these variables and objectives first",
    )
    parsers["points"].add_argument(
        "--sort", default="", metavar="NAME", help="objective or variable; the best comes first"
    )
    parsers["points"].add_argument(
        "--predict", action="store_true", help="also list the front that the models predict"
    )
    parsers["go"].add_argument(
        "index",
        nargs="?",
        type=_count,
        metavar="INDEX",
        help="index of an evaluation, on the front or not",
    )
    parsers["go"].add_argument(
        "--before",
        action="store_true",
        help="instead of an index: go where the machine was before the run",
    )
    parsers["go"].add_argument(
        "--weights",
        nargs="+",
        type=_named_number,
        metavar="OBJECTIVE=WEIGHT",
        help="instead of an index: go to the point with the least weighted sum [1/unit]",
    )
    parsers["go"].add_argument(
        "--hold",
        type=_count,
        default=0,
        metavar="N",
        help="number of evaluations that then track drift around the point (default: 0)",
    )
    parsers["go"].add_argument(
        "--radius",
        type=float,
        default=0.0,
        metavar="SHARE",
        help="radius of the search around it as a fraction of each range (default: 0.1)",
    )
    parsers["go"].add_argument(
        "--no-measurement",
        action="store_true",
        help="do not measure there (default: measure once, and compare with what was promised)",
    )
    parsers["go"].add_argument(
        "--anyway",
        action="store_true",
        help="go there even if the point is outside the bounds as they are now, or violated a critical "
        "limit",
    )
    return parser


def run(arguments: Sequence[str]) -> int:
    """Carry out one verb and print its result; return 0, or 1 after printing an error."""
    options = make_parser().parse_args(arguments)
    try:
        with TunerClient(options.namespace) as client:
            _say(VERBS[options.verb](client, options), sys.stdout)
    except TunerError as error:
        _say(f"refused: {error}" if error.code in REFUSALS else str(error), sys.stderr)
        return EXIT_ERROR
    except ParameterError as error:
        _say(str(error), sys.stderr)
        return EXIT_ERROR
    except KeyboardInterrupt:
        _say("stopped", sys.stderr)
        return EXIT_INTERRUPTED
    return 0


def main() -> None:
    """Carry out the command line; SIGTERM and a closed terminal stop a move like Ctrl-C."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, signal.default_int_handler)
    sys.exit(run(sys.argv[1:]))


def _say(text: str, stream: TextIO) -> None:
    """Print a text, if anybody reads it: the terminal or the pipe may be closed."""
    try:
        print(text, file=stream, flush=True)
    except OSError:  # nothing more is written there, also when this process ends
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def _comparison(arrival: Arrival) -> str:
    """Return what a point promises beside what was measured there, one objective per line; empty if nothing was."""
    if not arrival.measured:
        return ""
    rows = [["", "promised", "measured now", "difference"]]
    promises = arrival.point.objectives or dict.fromkeys(arrival.measured, math.nan)
    for name, promised in promises.items():
        measured = arrival.measured.get(name, math.nan)
        label = f"{name} {arrival.units.get(name, '')}".strip()
        numbers = (promised, measured, measured - promised)
        rows.append([label, *(f"{n:.4g}" if math.isfinite(n) else "-" for n in numbers)])
    return _aligned(rows)


def _aligned(rows: Sequence[Sequence[str]]) -> str:
    """Return rows as a table whose columns are aligned on the right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return "\n".join("  ".join(map(str.rjust, row, widths)) for row in rows)


def _once(pairs: Iterable[tuple[str, Any]]) -> dict[str, Any]:
    """Return values by name.

    Raises:
        TunerError: If a name is given twice.
    """
    values: dict[str, Any] = {}
    for name, value in pairs:
        if name in values:
            raise TunerError(ErrorCode.INVALID_VALUE, f"{name} is given twice")
        values[name] = value
    return values


def _counts(now: Status) -> str:
    """Return the counts of a run as text."""
    done = counted(now.budget or now.evaluations, "evaluation")
    if now.budget:
        done = f"{now.evaluations} of {done}"
    return (
        f"{done}, {now.feasible} feasible, {now.failed} failed, hypervolume {now.hypervolume:.6g}"
    )


def _is_maximized(client: TunerClient, name: str) -> bool:
    try:
        return bool(client.get(f"objectives.{name}.direction") == "maximize")
    except TunerError as error:
        if error.code != ErrorCode.REFUSED:
            raise
        return False  # not set, or not an objective


def _check_names(front: Front, names: Iterable[str], option: str) -> None:
    """Check that all names are objectives or variables of a front.

    Raises:
        TunerError: If one is not.
    """
    known = [*front.reference_point, *(front.points[0].setpoint if front.points else ())]
    for name in names:
        if front.points and name not in known:
            raise TunerError(
                ErrorCode.INVALID_VALUE, f"{option} names '{name}'; allowed are {', '.join(known)}"
            )


def _values(point: Point) -> dict[str, float]:
    """Return variables and objectives of a point by name."""
    return {**point.setpoint, **point.objectives}


def _choices(client: TunerClient, name: str) -> dict[str, float]:
    """Return the names of a variable's choices with what stands for them; empty if they have none."""
    found = []
    for leaf in ("choices", "values"):
        try:
            found.append(client.get(f"variables.{name}.{leaf}"))
        except TunerError as error:
            if error.code != ErrorCode.REFUSED:
                raise
            found.append(None)
    names, values = found
    if not names or not isinstance(names[0], str):
        return {}
    return dict(zip(names, map(float, values or range(len(names))), strict=False))


def _numbers(client: TunerClient, given: Mapping[str, float | str]) -> dict[str, float]:
    """Return values by name as numbers, also those that are given by the names of choices.

    Raises:
        TunerError: If there is no choice of such a name.
    """
    numbers = {}
    for name, value in given.items():
        if isinstance(value, str):
            choices = _choices(client, name)
            if value not in choices:
                allowed = ", ".join(choices) or "a number"
                text = f"{name} is '{value}'; allowed is {allowed}"
                raise TunerError(ErrorCode.INVALID_VALUE, text)
            value = choices[value]
        numbers[name] = value
    return numbers


def _shown(value: float, choices: Mapping[str, float], digits: int = 6) -> str:
    """Return a value as text: the name of the nearest choice if there are any, else so many digits."""
    if choices and math.isfinite(value):
        return min(choices, key=lambda name: abs(choices[name] - value))
    return f"{value:.{digits}g}"


def _nearest(points: Sequence[Point], near: Mapping[str, float]) -> list[Point]:
    """Return points from the nearest to the farthest; each name counts by its span over the front."""
    if not points:
        return []
    columns = {name: [_values(point)[name] for point in points] for name in near}
    spans = {name: (max(column) - min(column)) or 1.0 for name, column in columns.items()}

    def distance(point: Point) -> float:
        values = _values(point)
        return math.hypot(*((values[name] - near[name]) / spans[name] for name in near))

    return sorted(points, key=distance)


def _table(
    front: Front,
    listed: Sequence[Point],
    title: str,
    further: Mapping[str, Mapping[str, float]],
    top: int,
) -> str:
    """Return points of a front, one per line; a predicted point has no index.

    Args:
        front: Front of the points.
        listed: Points in the order to list them.
        title: Kind of the front.
        further: Names of variables to list beside the objectives, each with its choices that have names.
        top: Number of points to list; 0 = all.
    """
    shown = listed[: top or None]
    count = counted(len(listed), "point")
    if len(shown) < len(listed):
        count = f"{len(shown)} of {count}"
    lines = [f"{count} of run {front.run_id}, {title}; hypervolume {front.hypervolume:.6g}"]
    names = list(dict.fromkeys([*front.reference_point, *further]))
    rows = [["index", *(f"{name} {front.units.get(name, '')}".strip() for name in names)]]
    for point in shown:
        values = _values(point)
        index = "-" if point.index is None else str(point.index)
        rows.append([index, *(_shown(values[name], further.get(name, {}), 4) for name in names)])
    lines.append(_aligned(rows))
    if len(shown) < len(listed):
        lines.append(f"{len(listed) - len(shown)} more: --top 0 lists all")
    return "\n".join(lines)


def _named_value(text: str) -> tuple[str, Any]:
    """Return NAME=VALUE; the value is a number, true, false, a list of these, or text."""
    name, equals, value = text.partition("=")
    if not (name and equals and value):
        raise argparse.ArgumentTypeError(f"{text!r} is not NAME=VALUE")
    try:
        return name, json.loads(value)
    except ValueError:
        return name, value


def _named_number(text: str) -> tuple[str, float]:
    """Return NAME=NUMBER."""
    name, value = _named_value(text)
    try:
        number = math.nan if isinstance(value, bool | str | list | dict) else float(value)
    except (OverflowError, TypeError):  # a huge integer, or null
        number = math.nan
    if not math.isfinite(number):
        raise argparse.ArgumentTypeError(f"{value!r} in {text!r} is not a number")
    return name, number


def _named_number_or_choice(text: str) -> tuple[str, float | str]:
    """Return NAME=NUMBER, or NAME=CHOICE for a variable whose choices have names."""
    name, value = _named_value(text)
    return (name, value) if isinstance(value, str) else _named_number(text)


def _count(text: str) -> int:
    """Return an integer of at least 0."""
    if not (text.isdecimal() and int(text) < 2**32):
        raise argparse.ArgumentTypeError(f"{text!r} is not an integer of at least 0")
    return int(text)


if __name__ == "__main__":
    main()

"""The report of a run as one HTML file without outside addresses, for screen, phone and paper."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined

from mobo_tuner.core.hints import is_surely_met
from mobo_tuner.core.problem import Constraint, Problem
from mobo_tuner.core.units import product_of_units, raised
from mobo_tuner.runs.recorded_run import UNFINISHED, RecordedRun
from mobo_tuner.runs.records import StopReason
from mobo_tuner.runs.report import plots
from mobo_tuner.runs.report.models import ModelFacts, model_facts
from mobo_tuner.runs.report.summary import recommend, summarize, timestamp
from mobo_tuner.runs.report.svg import render_legend

MAX_TEXT = 200_000  # characters of a file that are shown
_SHOWN_INDICES = 12
_PLAIN = {
    StopReason.BUDGET: "it made all the evaluations that were asked for",
    StopReason.HYPERVOLUME_GOAL: "it reached its hypervolume goal",
    StopReason.TIME: "its time was over",
    StopReason.STAGNATION: "its last evaluations gained next to nothing",
    StopReason.LITTLE_EXPECTED: "the next evaluation was expected to gain next to nothing",
    StopReason.STOPPED: "it was stopped",
    StopReason.CANCELED: "it was canceled",
    StopReason.ERROR: "an error ended it",
    UNFINISHED: "it has not ended, or was killed",
}
_DRIVES = 0.3  # least share of an output's variance that is worth a word
_PREDICTIVE = 0.5  # least skill of a model that is worth following


class Failure(NamedTuple):
    """One cause of failures: its sentence, how often, and the first evaluations."""

    cause: str
    times: int
    indices: str


def render_page(run: RecordedRun, folder: Path) -> str:
    """Return the report of a run.

    Args:
        run: Run that is reported.
        folder: Its folder, whose `run.json` and `config.yaml` are shown where they are there.
    """
    recommended, facts = recommend(run), model_facts(run)
    problem = run.problem
    return (
        environment()
        .get_template("report.html")
        .render(
            run=run,
            problem=problem,
            summary=summarize(run),
            volume_unit=product_of_units([o.unit for o in problem.objectives]),
            words=list(_in_words(run, facts)),
            hints=[] if len(run.front) else run.optimizer.hints(),
            recommended=recommended,
            recommended_rows=[(r.row, ", ".join(r.reasons)) for r in recommended],
            all_rows=[(row, "") for row in range(len(run.front))],
            uncertainty=_uncertainty(run),
            convergence=plots.convergence(run),
            fronts=plots.fronts(run, recommended),
            parallel=plots.parallel_coordinates(run, recommended),
            trajectories=plots.trajectories(run),
            constraints=[(c, *_satisfaction(run, c)) for c in problem.constraints],
            constraint_plots=plots.constraints(run),
            context_plots=plots.contexts(run),
            failures=failures(run),
            facts=facts,
            quality=plots.quality(facts),
            changes=_changes(run),
            settings={
                k: json.dumps(v, ensure_ascii=False) for k, v in sorted(run.settings.items())
            },
            config=_text(folder / "config.yaml"),
            facts_of_run=_json(folder / "run.json"),
            now=timestamp(datetime.now(UTC).timestamp()),
            limits=limits,
            legend=render_legend,
        )
    )


def environment() -> Environment:
    """Return the templates; what is put into them is escaped."""
    templates = Environment(
        loader=FileSystemLoader(Path(__file__).parent / "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    templates.filters |= {"number": number, "share": share, "duration": duration, "time": time}
    return templates


def number(value: float | None, digits: int = 4) -> str:
    """Return a number for people; a dash for one that is not known."""
    if value is None or not math.isfinite(value):
        return "–"
    mantissa, _, exponent = f"{value:.{digits}g}".partition("e")
    text = f"{mantissa}×10{raised(int(exponent))}" if exponent else mantissa
    return text.replace("-", "−")


def share(value: float) -> str:
    """Return a share in percent."""
    return f"{100.0 * value:.0f} %".replace("-", "−") if math.isfinite(value) else "–"


def time(stamp: str) -> str:
    """Return a time in ISO 8601, which is in UTC, for people."""
    return stamp.replace("T", " ").replace("+00:00", " UTC")


def duration(seconds: float) -> str:
    """Return a time span in its natural unit."""
    if not math.isfinite(seconds):
        return "–"
    if seconds < 100.0:
        return f"{seconds:.2g} s"
    if seconds < 6000.0:
        return f"{seconds / 60.0:.0f} min"
    return f"{seconds / 3600.0:.1f} h"


def limits(constraint: Constraint) -> str:
    """Return the limits of a constraint as text."""
    low, high = constraint.minimum, constraint.maximum
    if math.isfinite(low) and math.isfinite(high):
        return f"{number(low)} to {number(high)}"
    return f"at least {number(low)}" if math.isfinite(low) else f"at most {number(high)}"


def failures(run: RecordedRun) -> list[Failure]:
    """Return the causes of failed evaluations, the most frequent first."""
    causes: dict[str, list[int]] = {}
    for index in np.flatnonzero(run.failed):
        record = run.evaluations[index]
        cause = record.error_msg or "nothing was measured, and the machine gave no reason"
        causes.setdefault(cause, []).append(int(index))
    ordered = sorted(causes.items(), key=lambda item: -len(item[1]))
    return [Failure(cause, len(rows), _listed(rows)) for cause, rows in ordered]


def _listed(indices: list[int]) -> str:
    shown = ", ".join(map(str, indices[:_SHOWN_INDICES]))
    return shown + (", …" if len(indices) > _SHOWN_INDICES else "")


def _in_words(run: RecordedRun, facts: list[ModelFacts]) -> Iterator[str]:
    """Yield the summary, sentence by sentence."""
    n = len(run.indices)
    took = run.finished - run.started
    within = f" in {duration(took)}" if math.isfinite(took) and took > 0.0 else ""
    why = _PLAIN.get(run.stop_reason, run.stop_reason)
    yield f"The run made {_count(n, 'evaluation')}{within}; {why}."
    if run.error_msg:
        yield f"The error was: {run.error_msg}."
    if not n:
        return
    feasible, failed, withdrawn = (
        int(np.count_nonzero(rows)) for rows in (run.feasible, run.failed, run.withdrawn)
    )
    cheaper = int(np.count_nonzero(run.cheaper & run.valid))
    if run.spent:
        each = [
            f"{_count(spent.evaluations, 'evaluation')} with "
            f"{', '.join(f'{name} {value:g}' for name, value in spent.level.items())} ({spent.cost:.3g})"
            for spent in run.spent
        ]
        yield (
            f"They cost as much as {math.fsum(s.cost for s in run.spent):.3g} evaluations at the highest fidelity, "
            f"which alone count: {', '.join(each)}."
        )
    yield (
        f"{_count(feasible, 'evaluation')} met every constraint, {failed} failed, and "
        f"{n - feasible - failed - withdrawn - cheaper} broke a constraint or were incomplete."
    )
    if withdrawn:
        yield f"An operator withdrew {_count(withdrawn, 'evaluation')}; nothing was learned from it."
    if len(run.front):
        yield f"The Pareto front has {_count(len(run.front), 'point')}."
        yield from _progress(run)
    driven: dict[str, list[str]] = {}
    for fact in facts:
        strongest = int(fact.indices.argmax())
        if fact.skill >= _PREDICTIVE and not fact.is_noise and fact.indices[strongest] >= _DRIVES:
            name = run.problem.variable_names[strongest]
            driven.setdefault(name, []).append(f"{fact.name} ({share(fact.indices[strongest])})")
    if driven:
        each = [f"{name} drives {', '.join(outputs)}" for name, outputs in driven.items()]
        yield f"{'; '.join(each)}: the share of the variance that it explains alone."
    alike = [fact.name for fact in facts if fact.is_noise]
    if alike:
        yield f"The readings of {', '.join(alike)} differ by no more than their noise: there is nothing to predict."
    weak = [fact.name for fact in facts if _is_weak(fact, run.problem)]
    if weak:
        yield f"The models do not predict {', '.join(weak)} well; distrust what they say of it."


def _is_weak(fact: ModelFacts, problem: Problem) -> bool:
    """Return whether a model predicts badly what matters: an objective, or a constraint that may be broken."""
    if fact.is_noise or fact.skill >= _PREDICTIVE:
        return False
    is_constraint = fact.name not in problem.objective_names
    return not (is_constraint and is_surely_met(problem, fact.name, fact.predicted, fact.stddevs))


def _progress(run: RecordedRun) -> Iterator[str]:
    """Yield how the hypervolume grew towards the end."""
    volumes = run.hypervolumes
    gains = np.flatnonzero(np.diff(volumes, prepend=0.0) > 1e-9 * volumes[-1])
    if not len(gains) or not volumes[-1] > 0.0:
        return
    n, last = len(volumes), int(gains[-1])
    tail = max(n // 10, 1)
    before = volumes[-tail - 1] if n > tail else 0.0
    text = f"The hypervolume last grew at evaluation {last}"
    if n > 2 and 0.0 <= before <= volumes[-1]:
        added = number(100.0 * (1.0 - before / volumes[-1]), 2)
        text += f"; the last {_count(tail, 'evaluation')} added {added} % of it"
    yield f"{text}."


def _uncertainty(run: RecordedRun) -> list[dict[str, float]]:
    """Return the standard deviation of each objective of each point of the front.

    It is that of what is believed or, where a reading is trusted, that of the reading.
    """
    return [
        {
            name: stddev
            or run.evaluations[point["index"]].diagnostics.get(name, (0.0, math.nan))[1]
            for name, stddev in point["stddevs"].items()
        }
        for point in run.pareto_front
    ]


def _satisfaction(run: RecordedRun, constraint: Constraint) -> tuple[int, int, str]:
    """Return how many readings of a constrained diagnostic meet it, how many there are, and its unit."""
    values = run.readings(constraint.name)[0][run.valid]
    known = values[np.isfinite(values)]
    met = int(np.count_nonzero((known >= constraint.minimum) & (known <= constraint.maximum)))
    return met, len(known), constraint.unit or run.problem.units.get(constraint.name, "")


def _changes(run: RecordedRun) -> list[tuple[int, list[str]]]:
    """Return for each change its evaluation and what it changed."""
    changes = []
    problem, budget = run.history.problem, int(run.settings.get("budget", 0))
    for change in run.history.changes:
        texts = list(_differences(problem, change.problem))
        if change.budget != budget:
            texts.append(f"budget: {budget} → {change.budget}")
        changes.append((change.index, texts or ["nothing"]))
        problem, budget = change.problem, change.budget
    return changes


def _differences(before: Problem, after: Problem) -> Iterator[str]:
    old, new = dict(_flat(before.to_dict())), dict(_flat(after.to_dict()))
    for key in dict.fromkeys([*old, *new]):
        if old.get(key) != new.get(key):
            yield f"{key}: {old.get(key, 'none')} → {new.get(key, 'none')}"


def _flat(mapping: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in mapping.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield prefix + key, value


def _count(n: int, noun: str) -> str:
    return f"{n} {noun}" if n == 1 else f"{n} {noun}s"


def _text(path: Path) -> str:
    """Return what a file of the run's folder holds, up to a limit; empty if it cannot be read."""
    try:
        with path.open(encoding="utf-8", errors="replace") as file:
            return file.read(MAX_TEXT)
    except OSError:
        return ""


def _json(path: Path) -> dict[str, Any]:
    """Return what a JSON file of the run's folder holds; empty if it cannot be read."""
    try:
        content = json.loads(_text(path) or "{}")
    except (ValueError, RecursionError):
        return {}
    return content if isinstance(content, dict) else {}

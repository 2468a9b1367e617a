"""What keeps a run from getting anywhere, each in a sentence with what to do; few at a time.

What concerns the problem and its front is found by the optimiser (`core.hints`). Here is what the records
show of the machine: set-points that it does not reach, readings that are clipped, a best point at a bound.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise, takewhile

from mobo_tuner.core.problem import Problem, Variable
from mobo_tuner.runs.history import CANCELED
from mobo_tuner.runs.records import EvaluationRecord
from mobo_tuner.wording import counted

MOST = 3  # hints at a time
PERIOD = 10  # evaluations until a hint's figures are brought up to date
FAILING = 5  # evaluations that failed in a row
SILENT = 3  # evaluations in a row without a reading of a context
FEWEST = 8  # evaluations before anything is said
RECENT = 50  # evaluations that are looked at
CLIPPED = 0.5  # least share of readings that are exactly the largest or the least
AT_BOUND = 0.01  # distance from a bound, as a share of the range, that counts as being there
MOSTLY = 0.5  # least share of the front's points at one bound
STEP_ERROR = 1e-3  # largest deviation of readbacks from multiples of a step, as a share of it
FINEST_STEP = 1e-4  # least step that matters, as a share of the variable's range


def run_hints(
    problem: Problem,
    records: Sequence[EvaluationRecord],
    front: Iterable[Mapping[str, float]],
    limits: Mapping[str, tuple[float, float]],
    general: Sequence[str] = (),
) -> list[str]:
    """Return what to tell the operator of a run, the most important first.

    Args:
        problem: Problem as it is now.
        records: Evaluations of the run.
        front: Set-points of the points on its front.
        limits: Limits of the machine's variables; empty if they are unknown.
        general: What the optimiser says of the problem and its front.
    """
    urgent = [*_failing(records), *_silent_contexts(problem, records)]
    if len(records) < FEWEST:
        return urgent[:MOST]
    recent = records[-RECENT:]
    found = [
        *urgent,
        *general,
        *_quantised(problem, recent),
        *_clipped(problem, recent),
        *_at_bounds(problem, list(front), limits),
    ]
    return found[:MOST]


class Hints:
    """The hints of one run, whose figures are brought up to date only now and then."""

    def __init__(self) -> None:
        self._shown: dict[str, tuple[str, int]] = {}  # text and number of evaluations, by kind

    def update(self, found: Iterable[str], evaluations: int) -> tuple[str, ...]:
        """Return the hints to show: those that are still found, with figures of at most `PERIOD` ago.

        Args:
            found: Hints as they are now.
            evaluations: Number of finished evaluations.
        """
        shown = {}
        for text in found:
            kind = re.sub(r"-?[\d.]+(e[+-]?\d+)?|inf|nan", "#", text)
            before = self._shown.get(kind, (text, evaluations))
            fresh = evaluations - before[1] < PERIOD
            shown[kind] = before if fresh else (text, evaluations)
        self._shown = shown
        return tuple(text for text, _ in shown.values())


def _failing(records: Sequence[EvaluationRecord]) -> list[str]:
    """Say how many evaluations have failed in a row; those that were skipped do not count."""
    made = [record for record in records if record.error_code != CANCELED]
    failed = len([*takewhile(lambda record: record.failed, reversed(made))])
    if failed < FAILING:
        return []
    return [
        f"the last {failed} evaluations failed, the last one because {made[-1].error_msg}: pause the run and "
        "check the machine"
    ]


def _silent_contexts(problem: Problem, records: Sequence[EvaluationRecord]) -> list[str]:
    """Say which contexts are not measured any more, and what the models take for them."""
    hints = []
    for context in problem.context:
        readings = [r.diagnostics.get(context.name, (math.nan, math.nan))[0] for r in records]
        known = [n for n, value in enumerate(readings) if math.isfinite(value)]
        missing = len(records) - 1 - (known[-1] if known else -1)
        if missing < SILENT:
            continue
        taken = (
            f"the models take its last reading, {readings[known[-1]]:.4g} {context.unit}".rstrip()
            + f" of evaluation {records[known[-1]].index}, for the present one"
            if known
            else "the models do without it"
        )
        hints.append(
            f"the context {context.name} was not measured in the last {missing} evaluations: {taken}; "
            "check its source"
        )
    return hints


def _quantised(problem: Problem, records: Sequence[EvaluationRecord]) -> list[str]:
    """Say which variables read in steps that are coarser than what is asked for."""
    hints = []
    for v in problem.variables:
        pairs = [
            (r.setpoint[v.name], r.readbacks[v.name])
            for r in records
            if v.name in r.setpoint and math.isfinite(r.readbacks.get(v.name, math.nan))
        ]
        step = _step(pairs, v)
        if step is not None:
            hints.append(
                f"{v.name} reads in steps of {step:g} {v.unit}".rstrip()
                + ", which its set-points are not: let the models learn where it was "
                "(model_input: readback), and give it a tolerance of half a step"
            )
    return hints


def _step(pairs: Sequence[tuple[float, float]], variable: Variable) -> float | None:
    """Return the step of which all readbacks are multiples, where the set-points are not."""
    values = sorted({readback for _, readback in pairs})
    if len(pairs) < FEWEST or len(values) < 3:
        return None
    extent = variable.maximum - variable.minimum
    gaps = [b - a for a, b in pairwise(values) if b - a > 1e-9 * extent]
    step = min(gaps, default=0.0)
    if step < FINEST_STEP * extent:
        return None

    def is_multiple(value: float) -> bool:
        steps = (value - values[0]) / step
        return abs(steps - round(steps)) <= STEP_ERROR

    quantised = all(is_multiple(readback) for _, readback in pairs)
    asked_between = sum(not is_multiple(setpoint) for setpoint, _ in pairs)
    return step if quantised and asked_between > len(pairs) / 2 else None


def _clipped(problem: Problem, records: Sequence[EvaluationRecord]) -> list[str]:
    """Say which diagnostics read their largest or least value much too often."""
    hints = []
    for name in problem.required_diagnostics:
        means = [r.diagnostics[name][0] for r in records if name in r.diagnostics]
        values = [value for value in means if math.isfinite(value)]
        if len(values) < FEWEST:
            continue
        value, count = Counter(values).most_common(1)[0]
        if count == len(values):  # the optimiser says so while there is no front
            hints.append(
                f"all of the last {count} readings of {name} are {value:.6g}: check whether the "
                "diagnostic is alive"
            )
        elif count >= CLIPPED * len(values) and value in (min(values), max(values)):
            hints.append(
                f"{count} of the last {len(values)} readings of {name} are exactly {value:.6g}: it may "
                "be clipped; widen its range, or list that value as 'invalid' of it"
            )
    return hints


def _at_bounds(
    problem: Problem,
    front: Sequence[Mapping[str, float]],
    limits: Mapping[str, tuple[float, float]],
) -> list[str]:
    """Say at which bounds most of the front is, where the machine could go farther."""
    hints = []
    for v in problem.variables:
        if v.fixed is not None or v.choices:
            continue
        low, high = limits.get(v.name, (-math.inf, math.inf))
        margin = AT_BOUND * (v.maximum - v.minimum)
        for key, bound, farther in (
            ("min", v.minimum, low < v.minimum),
            ("max", v.maximum, high > v.maximum),
        ):
            there = sum(abs(setpoint[v.name] - bound) <= margin for setpoint in front)
            if farther and there >= max(2.0, MOSTLY * len(front)):
                hints.append(
                    f"{there} of {counted(len(front), 'point')} of the front are at the {key} of {v.name}, "
                    f"{bound:g} {v.unit}".rstrip()
                    + f": better ones may lie beyond it; widen "
                    f"variables.{v.name}.{key} if you may"
                )
    return hints


def why_barren(records: Sequence[EvaluationRecord], required: Sequence[str]) -> str:
    """Return why evaluations are of no use; empty if one is, or there are none.

    Args:
        records: Evaluations.
        required: Diagnostics of the objectives and constraints.
    """
    if not records or any(record.feasible for record in records):
        return ""
    if all(record.failed for record in records):
        last = records[-1].error_msg
        if len(records) == 1:
            return f"its only evaluation failed: {last}"
        return f"all of its {len(records)} evaluations failed, the last one because {last}"
    unknown = (math.nan, math.nan)
    missing = [
        name
        for name in required
        if not any(math.isfinite(r.diagnostics.get(name, unknown)[0]) for r in records)
    ]
    if not missing:
        return ""
    return f"in {counted(len(records), 'evaluation')} it never measured {' and '.join(missing)}"

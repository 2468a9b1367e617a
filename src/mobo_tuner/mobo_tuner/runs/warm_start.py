"""The evaluations of other runs as the beginning of a new one: a journal that the new run resumes.

The models know how old each evaluation is by its stamp, so that with `drift` an old one counts for as much as it
still says; without, it counts as a new one.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from mobo_tuner.core import Problem, ProblemError
from mobo_tuner.runs.history import told_of
from mobo_tuner.runs.old_data import OldData, OldEvaluation
from mobo_tuner.runs.optimizer_settings import make_optimizer
from mobo_tuner.runs.records import EvaluationRecord, Record, StartRecord
from mobo_tuner.wording import counted


@dataclass
class Taken:
    """What became of the evaluations of one source.

    Attributes:
        source: Name of the source.
        count: Number of evaluations that were taken.
        left: Number of those that were left, by the reason.
        notes: What was left of those that were taken, and what the source lacks.
    """

    source: str
    count: int = 0
    left: Counter[str] = field(default_factory=Counter)
    notes: list[str] = field(default_factory=list)


class WarmStart:
    """Collects old evaluations for a problem.

    Args:
        problem: Problem of the new run.
        settings: Settings of its tuner.

    Raises:
        ProblemError: If the problem depends on where the machine is, so that nobody knows which of them fit.
    """

    def __init__(self, problem: Problem, settings: Mapping[str, Any]) -> None:
        if problem.open_variables:
            names = ", ".join(problem.open_variables)
            raise ProblemError(
                f"the bounds of {names} depend on where the machine is; give min and max (and fixed a "
                "number) to take evaluations of other runs"
            )
        self._problem, self._settings = problem, settings
        self._optimizer = make_optimizer(problem, settings)
        self._records: list[EvaluationRecord] = []
        self._seen: set[tuple[float, ...]] = set()
        self.taken: list[Taken] = []

    @property
    def count(self) -> int:
        """Number of evaluations that were taken."""
        return len(self._records)

    def records(self, run_id: str, stamp: float, evaluations: int) -> list[Record]:
        """Return the records of a journal that a run resumes.

        Args:
            run_id: Name under which they are kept.
            stamp: Time now [s since the epoch].
            evaluations: Number of further evaluations that the run may make.
        """
        settings = {**self._settings, "budget": self.count + evaluations}
        return [StartRecord(run_id, stamp, self._problem, settings), *self._records]

    def add(self, data: OldData) -> None:
        """Take what fits of one source, in the order of their times."""
        problem = self._problem
        taken = Taken(data.source, notes=[data.gap] if data.gap else [])
        self.taken.append(taken)
        wrong = self._wrong_units(data)
        lacking = [n for n in wrong if n in problem.variable_names]
        taken.notes += [f"'{n}' is left out: {why}" for n, why in wrong.items() if n not in lacking]
        for evaluation in sorted(map(self._numbered, data.evaluations), key=lambda e: e.stamp):
            reason = f"the {wrong[lacking[0]]} of '{lacking[0]}'" if lacking else ""
            reason = reason or self._misfit(evaluation, wrong)
            if reason:
                taken.left[reason] += 1
            else:
                self._take(evaluation, wrong)
                taken.count += 1

    def _numbered(self, evaluation: OldEvaluation) -> OldEvaluation:
        """Return an evaluation with what stands for the choices that it names."""
        numbers = {}
        for variable in self._problem.variables:
            number = variable.number(evaluation.words.get(variable.name))
            if isinstance(number, float):
                numbers[variable.name] = number
        return replace(evaluation, values={**evaluation.values, **numbers})

    def _wrong_units(self, data: OldData) -> dict[str, str]:
        """Return the quantities whose units differ from the problem's, with both."""
        known = self._problem.units
        return {
            name: f"unit is '{unit}', not '{known[name]}'"
            for name, unit in data.units.items()
            if unit and known.get(name, unit) != unit
        }

    def _misfit(self, evaluation: OldEvaluation, wrong: Mapping[str, str]) -> str:
        """Return why an evaluation cannot be taken; empty if it can."""
        if evaluation.withdrawn:
            return "withdrawn by an operator"
        problem = self._problem
        values = evaluation.values
        for variable in problem.variables:
            value = values.get(variable.name, math.nan)
            if not math.isfinite(value):
                return f"without a value of '{variable.name}'"
            if not variable.minimum <= value <= variable.maximum:
                return f"outside the bounds of '{variable.name}'"
            if variable.choice_names and value not in variable.choices:
                return f"at none of the choices of '{variable.name}'"
        try:
            problem.fidelity_of(values)
        except ProblemError as error:
            return str(error)
        for limit in problem.limits:
            if not limit.is_met(values):
                return f"beyond limits.{limit.name}"
        names = [*problem.measured_diagnostics, *problem.required_diagnostics]
        readings = (values.get(n, math.nan) for n in names if n not in wrong)
        if not evaluation.error_code and not any(map(math.isfinite, readings)):
            return "without any objective or constraint"
        if self._key(evaluation) in self._seen:
            return "taken before, with the same set-point and time"
        return ""

    def _key(self, evaluation: OldEvaluation) -> tuple[float, ...]:
        at = (evaluation.values[n] for n in self._problem.variable_names)
        reading = self._problem.measured_diagnostics[0]
        return (*at, evaluation.stamp, evaluation.values.get(reading, -math.inf))

    def _take(self, old: OldEvaluation, wrong: Mapping[str, str]) -> None:
        self._seen.add(self._key(old))
        problem, names = self._problem, self._problem.variable_names
        quantities = {
            *problem.measured_diagnostics,
            *problem.required_diagnostics,
            *(o.name for o in problem.observables),
            *(n for d in problem.derived for n in d.names),
        }
        known = [n for n in old.values if n in quantities and n not in names and n not in wrong]
        record = EvaluationRecord(
            index=self.count,
            source="operator",  # no suggestion of this run, so that a replay compares none
            attempts=1,
            stamp=old.stamp,
            setpoint={n: v for n, v in old.values.items() if n in problem.setpoint_names},
            readbacks={n: v for n, v in old.readbacks.items() if n in names},
            diagnostics={n: (old.values[n], old.stddevs.get(n, math.nan)) for n in known},
            valid=True,
            feasible=False,
            non_dominated=False,
            hypervolume=0.0,
            hypervolume_measured=0.0,
            error_code=old.error_code,
            error_msg="it failed in the run that it is from" if old.error_code else "",
            suggest_seconds=0.0,
            machine_seconds=0.0,
            total_seconds=0.0,
        )
        self._records.append(self._told(record))

    def _told(self, record: EvaluationRecord) -> EvaluationRecord:
        """Return a record with what the optimiser says of it."""
        before = self._optimizer.hypervolume_measured
        model_input = str(self._settings["model_input"])
        made = self._optimizer.tell(*told_of(record, self._optimizer.problem, model_input))
        volume = self._optimizer.hypervolume_measured
        return replace(
            record,
            diagnostics={n: (v, made.stddevs[n]) for n, v in made.values.items()},
            valid=made.valid,
            feasible=made.feasible,
            non_dominated=volume > before,
            hypervolume=volume,
            hypervolume_measured=volume,
        )


def table(taken: Sequence[Taken]) -> list[str]:
    """Return what was taken of each source, and what was left and why, in lines for people."""
    lines = []
    for source in taken:
        total = source.count + source.left.total()
        lines.append(f"{source.source}: {source.count} of {counted(total, 'evaluation')} taken")
        lines += [f"  {count} left: {reason}" for reason, count in source.left.most_common()]
        lines += [f"  {note}" for note in source.notes]
    return lines

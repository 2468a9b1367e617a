"""What the models of a run say, as JSON: ``python -m mobo_tuner.runs.report.insight RUN_FOLDER [--index N]``.

The page asks this program, which only reads the run's folder, so that neither the tuner nor the page waits for it. The
run may be active.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mobo_tuner.core.problem import Array, Variable
from mobo_tuner.core.slices import slices
from mobo_tuner.errors import UserError
from mobo_tuner.runs.recorded_run import RecordedRun
from mobo_tuner.runs.report.models import ModelFacts, model_facts
from mobo_tuner.wording import counted

DIGITS = 5


def insight(run: RecordedRun, index: int | None = None) -> dict[str, Any]:
    """Return what the models say: slices, which variable drives what, how well they predict.

    Args:
        run: Run whose models are asked.
        index: Index of the evaluation through whose set-point the slices go; None for the last one.

    Raises:
        UserError: If there is no such evaluation.
    """
    evaluations = run.evaluations
    index = len(evaluations) - 1 if index is None else index
    if not 0 <= index < len(evaluations):
        raise UserError(
            f"the index is {index}; the run {run.run_id} has {counted(len(evaluations), 'evaluation')}"
        )
    setpoint = evaluations[index].setpoint
    facts = model_facts(run)
    known = {fact.name for fact in facts}
    through = slices(run.optimizer, setpoint) if facts else {}
    highest = max((_highest(s.acquisition) for s in through.values()), default=math.nan)
    variables = run.problem.variables
    return {
        "run_id": run.run_id,
        "evaluations": len(evaluations),
        "index": index,
        "setpoint": dict(setpoint),
        "contexts": _contexts(run),
        "outputs": [_fact(fact, variables) for fact in facts],
        "slices": {
            name: {
                "values": _rounded(s.values),
                "means": {n: _rounded(mean) for n, mean in s.means.items() if n in known},
                "stddevs": {n: _rounded(stddev) for n, stddev in s.stddevs.items() if n in known},
                "acquisition": _rounded(np.exp(s.acquisition - highest)),
            }
            for name, s in through.items()
        },
    }


def _contexts(run: RecordedRun) -> dict[str, float | None]:
    """Return the readings of the contexts for which the models speak; None for one that was never measured."""
    data = run.optimizer.dataset
    readings = {c.name: data.last_reading(c.name) for c in run.problem.context}
    return {name: None if reading is None else reading[1] for name, reading in readings.items()}


def _fact(fact: ModelFacts, variables: Sequence[Variable]) -> dict[str, Any]:
    """Return what is known of a model; a fixed variable drives nothing."""

    def by_name(values: Array) -> dict[str, float | None]:
        pairs = zip(variables, _rounded(values), strict=True)
        return {v.name: value for v, value in pairs if v.fixed is None}

    return {
        "name": fact.name,
        "unit": fact.unit,
        "measured": _rounded(fact.measured),
        "predicted": _rounded(fact.predicted),
        "stddevs": _rounded(fact.stddevs),
        "noise": _json(float(np.median(fact.noise))),
        "is_noise": fact.is_noise,
        "skill": _json(fact.skill),
        "error": _json(fact.error),
        "coverage": _json(fact.coverage),
        "drivers": by_name(fact.indices),
        "length_scales": by_name(fact.length_scales),
    }


def _highest(values: Array) -> float:
    """Return the largest of the finite values; NaN if there is none."""
    finite = values[np.isfinite(values)]
    return float(finite.max()) if len(finite) else math.nan


def _rounded(values: Array) -> list[float | None]:
    return [_json(float(f"{value:.{DIGITS}g}")) for value in values]


def _json(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def main(arguments: Sequence[str] | None = None) -> int:
    """Print what the models of one run say; return the exit status."""
    parser = argparse.ArgumentParser(prog="mobo_tuner.runs.report.insight", description=__doc__)
    parser.add_argument("run_folder", type=Path, help="the run's folder, which holds its journal")
    parser.add_argument("--index", type=int, help="evaluation for the slices (default: the last)")
    options = parser.parse_args(arguments)
    try:
        answer = insight(RecordedRun.load(options.run_folder), options.index)
    except UserError as error:
        print(error, file=sys.stderr)
        return 1
    print(json.dumps(answer, ensure_ascii=False, allow_nan=False))
    return 0


if __name__ == "__main__":
    sys.exit(main())

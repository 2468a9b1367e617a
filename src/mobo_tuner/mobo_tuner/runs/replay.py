"""Replay of a run: the optimiser after any step, and a comparison of all suggestions.

`python -m mobo_tuner.runs.replay RUN` computes every suggestion of a run again, from its folder or its
bag, and prints whether they are the same bit for bit.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from mobo_tuner.core import Optimizer
from mobo_tuner.errors import UserError
from mobo_tuner.runs.bag_messages import is_bag
from mobo_tuner.runs.history import History, Step, told_of
from mobo_tuner.runs.journal import JsonRecord, read_journal
from mobo_tuner.runs.optimizer_settings import make_optimizer
from mobo_tuner.runs.prior_model import load_prior_model
from mobo_tuner.runs.rebuild import run_of_bag
from mobo_tuner.runs.records import EvaluationRecord, ForgetRecord
from mobo_tuner.runs.saved_state import SavedState
from mobo_tuner.wording import counted


def restore(
    history: History,
    saved: SavedState | None = None,
    *,
    retrain: bool = True,
    with_prior: bool = True,
) -> Optimizer:
    """Return the optimiser of a run as it was after its last step; with the default settings if they are unknown.

    Args:
        history: History of the run.
        saved: State at some step, from where on the history is replayed; without it, or if it does
            not suit the history, that is from the start.
        retrain: Whether to train the models as often as the run did, so that the optimiser asks what it
            would have asked then. Without it, they are trained when they are needed, which is much faster.
        with_prior: Whether to load the prior model that the settings name, which runs its code. Without
            it, the models are those of a run without one.

    Raises:
        ProblemError: If the history cannot have happened.
    """
    prior = load_prior_model(history.problem, history.settings) if with_prior else None
    optimizer, position = (saved.revive(history, prior) if saved else None) or (None, 0)
    if optimizer is None and history.settings:
        optimizer = make_optimizer(history.problem, history.settings, prior)
    elif optimizer is None:  # the run was rebuilt from a bag without run_records
        optimizer = Optimizer(history.problem)
    for step in history.steps[position:]:
        if retrain and isinstance(step, EvaluationRecord):
            optimizer.catch_up()
        optimizer = take_step(optimizer, step, history.model_input)
    return optimizer


def take_step(optimizer: Optimizer, step: Step, model_input: str) -> Optimizer:
    """Return the optimiser after one more step of a history."""
    if isinstance(step, EvaluationRecord):
        optimizer.tell(*told_of(step, optimizer.problem, model_input))
    elif isinstance(step, ForgetRecord):
        withdraw(optimizer, step)
    elif step.problem != optimizer.given_problem:
        return optimizer.with_problem(step.problem)
    return optimizer


def withdraw(optimizer: Optimizer, record: ForgetRecord) -> None:
    """Have an optimiser forget an evaluation or a diagnostic of it, or learn it again.

    The suggestion that was due has been computed before, so that a replay finds the same.

    Raises:
        ProblemError: there is no such evaluation, or it has no such diagnostic.
    """
    optimizer.catch_up()
    act = optimizer.forget if record.withdrawn else optimizer.unforget
    act(record.evaluation, record.diagnostic or None)


@dataclass(frozen=True)
class Comparison:
    """Suggestion of a run, and the suggestion of its replay.

    Attributes:
        index: Index of the evaluation.
        source: Source of the set-point.
        then: Set-point in the run; an operator's is not compared.
        now: Set-point in the replay.
    """

    index: int
    source: str
    then: Mapping[str, float]
    now: Mapping[str, float]

    @property
    def differs(self) -> bool:
        """Whether the set-points differ."""
        return self.source != "operator" and dict(self.then) != dict(self.now)


def compare(history: History) -> list[Comparison]:
    """Replay a run and compute each of its suggestions.

    Raises:
        JournalError: If the settings are unknown.
        ProblemError: If the history is contradictory.
    """
    history.require_settings()
    prior = load_prior_model(history.problem, history.settings)
    optimizer = make_optimizer(history.problem, history.settings, prior)
    comparisons = []
    for step in history.steps:
        if isinstance(step, EvaluationRecord):
            if (
                step.source == "operator"
            ):  # not compared; a search that must be safe may have no start yet
                optimizer.catch_up()
                asked = dict(step.setpoint)
            else:
                asked = optimizer.ask()
            comparisons.append(Comparison(step.index, step.source, step.setpoint, asked))
        optimizer = take_step(optimizer, step, history.model_input)
    return comparisons


def records_of(path: Path, run_id: str | None = None) -> tuple[list[JsonRecord], str]:
    """Return the records of a run, and which of its evaluations are missing in a bag, in one sentence.

    Args:
        path: Run folder, journal, folder of a bag, or one of its files.
        run_id: Name of the run; may be None if the path holds only one.

    Raises:
        JournalError, BagError: If it is none of these, or cannot be read.
    """
    if not is_bag(path):
        return read_journal(path), ""
    run = run_of_bag(path, run_id)
    return run.journal(), run.gap


def main(arguments: Sequence[str] | None = None) -> int:
    """Compare one run; return 0 if every suggestion is the same, else 1."""
    parser = argparse.ArgumentParser(prog="mobo_tuner.runs.replay", description="Replay of a run.")
    parser.add_argument("run", type=Path, help="run folder, journal, folder or file of a bag")
    parser.add_argument("--of", help="name of the run, if the bag holds several")
    options = parser.parse_args(arguments)
    try:
        records, gap = records_of(options.run, options.of)
        comparisons = compare(History.from_records(records))
    except UserError as error:
        print(error, file=sys.stderr)
        return 1
    compared = [c for c in comparisons if c.source != "operator"]
    different = [c for c in compared if c.differs]
    print(
        f"{counted(len(comparisons), 'evaluation')}, {counted(len(compared), 'suggestion')} computed again, "
        f"{len(compared) - len(different)} identical bit for bit"
    )
    if gap:
        print(gap)
    for comparison in different[:5]:
        print(f"  {comparison.index}: then {dict(comparison.then)}")
        print(f"  {comparison.index}: now  {dict(comparison.now)}")
    if different:
        print(f"{len(different)} of {len(compared)} suggestions differ", file=sys.stderr)
    return 1 if different else 0


if __name__ == "__main__":
    sys.exit(main())

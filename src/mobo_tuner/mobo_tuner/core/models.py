"""Models of a run: a Gaussian process for each objective and each constrained diagnostic, and validity."""

from __future__ import annotations

import math
import time
from copy import copy
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mobo_tuner.core.composition import (
    ComposedProcess,
    better_by_parts,
    composed_processes,
    compositions,
)
from mobo_tuner.core.context import ContextInputs
from mobo_tuner.core.dataset import BoolArray, Dataset
from mobo_tuner.core.gaussian_process import GaussianProcess
from mobo_tuner.core.jump import find_jump
from mobo_tuner.core.output_model import OutputModel
from mobo_tuner.core.prior_mean import Prior, PriorMeans
from mobo_tuner.core.problem import Array, Problem, ProblemError
from mobo_tuner.core.selection import Selection
from mobo_tuner.core.settings import OptimizerSettings
from mobo_tuner.core.steadiness import Steadiness
from mobo_tuner.core.validity import ValidityModel

_FEW_NEW = 10  # evaluations since the last update that may surprise
_TRAINING_SHARE = 0.4  # of the time budget
_NEWS = 1e-3  # of the readings' spread
_NEWS_OF_NOISE = 0.4  # of the noise: about that of six readings' average
_FEW = 60  # evaluations up to which every training weighs the evidence


class Models:
    """Independent Gaussian processes over the evaluations, [Roussel2021]_ section subsec:MOBO.

    Each learns from the evaluations in which its output was measured. Objectives are modelled as
    they are minimised. A constraint on an objective shares its model.

    Args:
        problem: Problem whose quantities are modelled.
        settings: Settings of the optimiser.
        seed: Seed of the random starts of training.
        prior_means: Model or functions that predict some quantities, see `prior_mean`, or the `means` of
            models of a problem that differs in its reference point only.

    Raises:
        ProblemError: If a prior mean is of a quantity that is not modelled, or not a function of the
            variables.

    Attributes:
        means: Prior means of the quantities.
    """

    def __init__(
        self,
        problem: Problem,
        settings: OptimizerSettings,
        seed: int,
        prior_means: Prior | PriorMeans | None = None,
    ) -> None:
        self._problem = problem
        self._one_hot = problem.one_hot
        self._refit_every = settings.refit_every
        self._seconds = (
            math.inf if settings.suggestion_seconds is None else settings.suggestion_seconds
        )
        self._selection = Selection(self._seconds)
        self._seed = seed
        if not isinstance(prior_means, PriorMeans):
            prior_means = PriorMeans(problem, {} if prior_means is None else prior_means)
        self.means = prior_means
        self._compositions = compositions(problem, self.means)
        self._settings = settings
        self._steadiness = Steadiness(settings.noise, settings.drift)
        self._context = ContextInputs.of(Dataset(problem), self.drifts, settings.drift_time)
        signs = {o.name: o.sign for o in problem.objectives}
        self._outputs = {
            name: OutputModel(name, signs.get(name, 1.0), process, self._selection)
            for name, process in self._untrained().items()
        }
        self.by_parts: frozenset[str] = frozenset()  # derived quantities predicted by their parts
        self._composed: dict[str, ComposedProcess] = {}
        self.validity = ValidityModel(self._one_hot, self._context.fidelities)
        self._judged = 0  # number of evaluations that the model of validity holds
        self._trained = 0  # number of evaluations with an output at the last training
        self._trained_rows = 0  # number of all evaluations at the last training
        self._held = 0  # number of all evaluations that the models hold
        self._outdated = False  # whether some of these were withdrawn or taken back

    def _untrained(self) -> dict[str, GaussianProcess]:
        """Return the process of every output, without observations."""
        process = self._settings.gaussian_process
        # The probability to exceed a limit comes out too low under a logarithm, and one about the limit
        # says little of improvements and of what a formula makes of it, and serves one limit only.
        plain = replace(process, transform="none") if process.transform == "auto" else process
        limits = {
            c.name: [end for end in (c.minimum, c.maximum) if math.isfinite(end)]
            for c in self._problem.constraints
        }
        processes = {
            o.name: GaussianProcess(
                plain if o.name in limits else process,
                # One that is not inferred yet: no model is used before it is.
                o.sign * o.reference if math.isfinite(o.reference) else 0.0,
                mean=self.means.mean(o.name),
                mean_gradient=self.means.gradient(o.name),
                contexts=self._context.count,
                one_hot=self._one_hot,
            )
            for o in self._problem.objectives
        }
        # A constrained diagnostic has no reference point; its mean is that of the data.
        mean = "data" if process.mean == "reference" else process.mean
        parts = [name for c in self._compositions.values() for name in c.parts]
        for name in dict.fromkeys([*self._problem.required_diagnostics, *parts]):
            if name not in processes:
                single = len(limits.get(name, ())) == 1 and name not in parts
                processes[name] = GaussianProcess(
                    replace(process if single else plain, mean=mean),
                    limit=limits[name][0] if single else None,
                    mean=self.means.mean(name),
                    mean_gradient=self.means.gradient(name),
                    contexts=self._context.count,
                    one_hot=self._one_hot,
                )
        return processes

    @property
    def ready(self) -> bool:
        """Whether there is any output to learn from."""
        return bool(self.learned)

    @property
    def trained_rows(self) -> int:
        """Number of evaluations, failed ones included, at the last training."""
        return self._trained_rows

    @property
    def known(self) -> BoolArray:
        """Whether each objective was measured at least once ``(P,)``."""
        return np.array([model.n > 0 for model in self.objectives], dtype=bool)

    @property
    def objectives(self) -> list[GaussianProcess]:
        """Models of the minimised objectives, in the problem's order."""
        return [self._predictor(name) for name in self._problem.objective_names]

    def _predictor(self, name: str) -> GaussianProcess:
        """Return what predicts an output: its process, or those of the parts of its formula."""
        return self._composed.get(name) or self._outputs[name].process

    def expects_news(self, x: Array, nearest: Array) -> bool:
        """Return whether some output may read differently at x than at a measured point.

        The news may be a better average, where there is noise: as long as it is not that of several
        readings already.

        Args:
            x: Point ``(d,)``.
            nearest: Measured point ``(d,)`` near it.
        """
        for output in self.learned:
            process = output.process
            mean, stddev = process.predict(np.vstack([x, nearest]))
            least = _NEWS * process.spread
            if abs(mean[0] - mean[1]) > least:
                return True
            if stddev[0] > max(least, _NEWS_OF_NOISE * process.noise_at(x)):
                return True
        return False

    @property
    def by_output(self) -> dict[str, GaussianProcess]:
        """Models of every objective, as it is minimised, and of every constrained diagnostic, by name."""
        return {name: self._predictor(name) for name in self._problem.required_diagnostics}

    @property
    def learned(self) -> list[OutputModel]:
        """Models of the outputs that were measured at least once."""
        return [output for output in self._outputs.values() if output.process.n]

    @property
    def limited(self) -> list[tuple[str, GaussianProcess, float, float]]:
        """Name, model, lower and upper limit of what it models, of each constraint."""
        limits = []
        for constraint in self._problem.constraints:
            ends = (constraint.minimum, constraint.maximum)
            output = self._outputs[constraint.name]
            if output.sign < 0.0:
                ends = (-ends[1], -ends[0])
            limits.append((output.name, self._predictor(output.name), *ends))
        return limits

    @property
    def constraints(self) -> list[tuple[GaussianProcess, float, float]]:
        """Model, lower and upper limit of each constraint on what was measured at least once."""
        return [(model, lower, upper) for _, model, lower, upper in self.limited if model.n]

    @property
    def drifts(self) -> bool:
        """Whether the machine changes with time: as the settings say, or by the evidence."""
        return self._steadiness.drifts

    @property
    def jumps(self) -> tuple[float, ...]:
        """When the machine changed at once: the time of the first evaluation after each change [s]."""
        return self._steadiness.jumps

    @property
    def varies(self) -> bool:
        """Whether the machine changes with what nobody sets, so that old readings are not those of now."""
        return self.drifts or bool(self._problem.context)

    def trusts_readings(self, data: Dataset) -> bool:
        """Return whether a reading counts as it is: the machine neither varies nor is noisy."""
        return not (self.varies or self._steadiness.is_noisy(data, self._outputs))

    def should_repeat(self, data: Dataset) -> bool:
        """Return whether a set-point should be measured again to find out whether the machine is noisy."""
        return not (self.varies or self._problem.fidelity) and self._steadiness.should_repeat(data)

    def extended(self, data: Dataset, at_once: bool = False) -> Models:
        """Return models that know all of `data`, with the hyperparameters of the last training.

        These models themselves stay as they are. Without a training so far, the new ones are trained.

        Args:
            data: Evaluations.
            at_once: Whether what is new is learned at once and not one after the other, which changes the
                models' rounding errors only.
        """
        if self._held == len(data) and self._trained:
            return self
        other = copy(self)
        other.validity = ValidityModel(self._one_hot, self._context.fidelities)
        other._outputs = {name: output.copy() for name, output in self._outputs.items()}
        if self._trained and not self.is_surprised(data):
            other._learn(data, train=False, restarts=0, at_once=at_once)
        else:
            other._judged = len(data)
            other.update(data)
        return other

    def predicted(self, x: Array, lacks: Array) -> dict[str, Array]:
        """Return the means ``(m,)`` of every output measured at least once, in its unit.

        Args:
            x: Points ``(m, d)``.
            lacks: Distances of their fidelities from the highest ``(m, f)``.
        """
        inputs = self.inputs_at(x, lacks)
        return {
            output.name: output.sign * output.process.predict(inputs)[0] for output in self.learned
        }

    def inputs_at(self, x: Array, lacks: Array) -> Array:
        """Return the inputs of the models at points x ``(m, d)`` of some fidelities ``(m, f)``, now."""
        if not self._context.fidelities:
            return x
        now = [self._context.at(self.objectives[0].now, lack) for lack in lacks]
        return np.column_stack([np.broadcast_to(x, (len(now), x.shape[1])), now])

    def expecting(self, data: Dataset) -> Models:
        """Return models that also hold the last evaluations of `data`, which are predictions.

        The hyperparameters stay, and so does what is known of failures, of which they say nothing.
        """
        other = copy(self.extended(data, at_once=True))
        other.validity, other._judged = self.validity, len(data)
        return other

    def drawn(self, count: int, rng: np.random.Generator) -> list[Models]:
        """Return models that know every output at its observations, one for each draw of these; O(n^3).

        Args:
            count: Number of draws, a power of two; those of an output are evenly spread.
            rng: Random number generator.
        """
        draws = {output.name: output.process.drawn(count, rng) for output in self.learned}
        models = []
        for i in range(count):
            other = copy(self)
            other._outputs = {name: copy(output) for name, output in self._outputs.items()}
            for name, processes in draws.items():
                other._outputs[name].process = processes[i]
            other._compose()
            models.append(other)
        return models

    def update(self, data: Dataset) -> bool:
        """Learn the evaluations that are new, training when it is time to.

        What it does depends on `data` and on when it was called before, on nothing else.

        Returns:
            Whether any process was trained; otherwise the new models are those of `extended`.
        """
        if len(data) > self._judged or self._outdated:
            self._judged = len(data)
            judged = self._selection.of_failures(data, self._judged)
            if len(judged):  # not all were withdrawn
                self.validity.fit(_located(data)[judged], ~data.failed[judged])
        count = self._count(data)
        if count == 0 or (count == self._count(data, self._held) and not self._outdated):
            return False
        patience = self._refit_every or 1 + self._trained // 25
        is_first = self._trained == 0 or self._outdated
        surprised = not is_first and self.is_surprised(data)
        train = is_first or surprised or count - self._trained >= patience
        restarts = None if self._outdated or _is_time_to_restart(self._trained, count) else 0
        trained = self._learn(data, train, restarts, look=surprised)
        self._outdated = False
        if train:
            self._trained, self._trained_rows = count, len(data)
        return trained

    def _learn(
        self,
        data: Dataset,
        train: bool,
        restarts: int | None,
        again: bool = False,
        look: bool = False,
        at_once: bool = False,
    ) -> bool:
        """Give every process the rows of its output, by training or one after the other.

        Args:
            data: Evaluations.
            train: Whether to train.
            restarts: Number of random starts in place of the settings'.
            again: Whether this is done once more because of what the training before has shown.
            look: Whether to look for suspected readings even if there are many evaluations.
            at_once: Whether rows that are added without training are added at once.

        Returns:
            Whether any process was trained.
        """
        if train:
            former, drift_time = self._context, self._settings.drift_time
            self._context = context = ContextInputs.of(
                data, self.drifts, drift_time, self._steadiness.jumps
            )
            if (context.timed, context.jumps) != (former.timed, former.jumps):
                restarts = None
                for name, process in self._untrained().items():
                    self._outputs[name].process = process
        count, inputs = self._count(data), self._context.inputs(data)
        trained = train
        begin = time.monotonic()
        noisy = self._steadiness.learns_noise(data)
        look = train and (look or restarts is None or count <= _FEW)
        for position, output in enumerate(self._outputs.values()):
            if train and self._context.fidelities:
                output.judge_fidelities(data, inputs, noisy, [self._seed, 9, count, position])
            rows = output.counted(data)
            if len(rows) == 0:
                continue
            if train or output.process.n == 0:
                trained = True
                share = _TRAINING_SHARE * (position + 1) / len(self._outputs)
                output.train(
                    data,
                    inputs,
                    output.selected(data, inputs) if train else rows,
                    seed=[self._seed, 1, count, position],
                    restarts=restarts,
                    seconds=max(begin + share * self._seconds - time.monotonic(), 0.0),
                    noisy=noisy,
                )
                if look and not self._is_hurried:
                    output.suspect(data, inputs, noisy, [self._seed, 6, count, position])
            else:
                output.add(data, inputs, rows[rows >= self._held], at_once)
        self._held = len(data)
        self._set_now(data)
        if look and self.has_suspects:
            # Others may be wrong, too, in an evaluation of which an output is suspected.
            doubted = {int(row) for output in self._outputs.values() for row in output.suspects}
            for position, output in enumerate(self._outputs.values()):
                seed = [self._seed, 7, count, position]
                output.suspect_doubtful(data, inputs, doubted, noisy, seed)
        thorough = train and (restarts is None or count <= _FEW)
        deadline = begin + _TRAINING_SHARE * self._seconds
        if train and self._settings.drift != "none" and not again:
            before = self._steadiness
            self._look_for_drift(data, thorough, deadline)
            changed = (before.drifts, before.jumps) != (self.drifts, self._steadiness.jumps)
            if changed and not self._is_hurried:
                return self._learn(data, train, restarts, again=True)
        if thorough:
            self._steadiness = self._steadiness.with_noise_of(
                [output.process for output in self._outputs.values()], deadline
            )
            if self._steadiness.learns_noise(data) and not noisy and not self._is_hurried:
                return self._learn(data, train, restarts, again=True)
        if train:
            self.by_parts = better_by_parts(self._compositions, self._outputs, data, inputs)
        self._compose()
        return trained

    def _compose(self) -> None:
        """Let those derived quantities be predicted by their parts that are better so."""
        self._composed = composed_processes(self._compositions, self.by_parts, self._outputs)

    def _look_for_drift(self, data: Dataset, thorough: bool, deadline: float) -> None:
        """Find out whether the machine changes with time, and whether it changed at once.

        Args:
            data: Evaluations.
            thorough: Whether to look for slow changes if there is no jump.
            deadline: Time by which that must be known [s], of `time.monotonic`.
        """
        times, timed = self._context.times(data), self._context.timed
        outputs = self._trained_outputs(data)
        jump = None
        if not self._is_hurried:
            evidence = [(p.jump_evidence(times[rows], timed), rows) for p, rows in outputs]
            jump = find_jump(self._context, data, evidence)
        if self._settings.drift == "auto" and (thorough or jump is not None):
            timed_outputs = [(process, times[rows]) for process, rows in outputs]
            self._steadiness = self._steadiness.with_drift_of(timed_outputs, timed, deadline)
        # What changes slowly is explained by a jump, too: the next training says which it is.
        if jump is not None and self.drifts == timed:
            self._steadiness = self._steadiness.with_jump(jump)

    def _trained_outputs(self, data: Dataset) -> list[tuple[GaussianProcess, NDArray[np.intp]]]:
        """Return the process of each output, and which evaluations it was trained with."""
        inputs = self._context.inputs(data)
        outputs = [(output.process, output.selected(data, inputs)) for output in self.learned]
        return [(process, rows) for process, rows in outputs if len(rows) == process.n]

    def _set_now(self, data: Dataset) -> None:
        """Let the processes predict for the latest contexts and time that they hold."""
        if self._context.count:
            now = self._context.now(data, self._held)
            for output in self._outputs.values():
                output.process.now = now

    def suspects(self, name: str) -> NDArray[np.intp]:
        """Return the evaluations whose reading of an output is suspected, in their order."""
        return self._outputs[name].suspects

    def is_surprised(self, data: Dataset) -> bool:
        """Return whether a reading that is not learned yet is ruled out by the models.

        The models are then trained at once, to find out whether it is suspected.
        """
        if not self._trained or self._is_hurried or self._settings.training == "adam":
            return False
        if len(data) - self._held > _FEW_NEW:  # a training is due anyway
            return False
        inputs = self._context.inputs(data)
        return any(o.is_surprised(data, inputs, self._held) for o in self._outputs.values())

    @property
    def has_suspects(self) -> bool:
        """Whether any reading is suspected."""
        return any(len(output.suspects) for output in self._outputs.values())

    @property
    def _is_hurried(self) -> bool:
        return math.isfinite(self._seconds)

    def _count(self, data: Dataset, first: int | None = None) -> int:
        """Return how many of all or the first evaluations have any of the outputs."""
        measured = [np.isfinite(data.column(name)[:first]) for name in self._outputs]
        return int(np.count_nonzero(np.any(measured, axis=0)))

    def forget(self, data: Dataset) -> None:
        """Drop what was withdrawn from `data` and learn what was taken back; `update` trains next."""
        if self._judged:
            judged = self._selection.of_failures(data, self._judged)
            self.validity = ValidityModel(self._one_hot, self._context.fidelities)
            if len(judged):
                self.validity.fit(_located(data)[judged], ~data.failed[judged])
        inputs = self._context.inputs(data)
        for output in self._outputs.values():
            output.learn_again(
                data, inputs, output.held(data, inputs, self._held, self._trained_rows)
            )
        self.by_parts = frozenset()  # until the next training
        self._set_now(data)
        self._compose()
        self._outdated = self._judged > 0

    def get_state(self) -> dict[str, Any]:
        """Return what `set_state` needs beside the data, as plain data."""
        return {
            "trained": self._trained,
            "trained_rows": self._trained_rows,
            "held": self._held,
            "judged": self._judged,
            "outdated": self._outdated,
            "noisy": self._steadiness.is_noisy_by_evidence,
            "may_be_noisy": self._steadiness.may_be_noisy,
            "drift_evidence": self._steadiness.drift_evidence,
            "context": self._context.get_state(),
            "apart": sorted(name for name, output in self._outputs.items() if output.is_apart),
            "suspects": {
                name: output.suspects.tolist()
                for name, output in self._outputs.items()
                if len(output.suspects)
            },
            "validity": self.validity.get_state(),
            "by_parts": sorted(self.by_parts),
            "processes": {name: o.process.get_state() for name, o in self._outputs.items()},
        }

    def set_state(self, state: dict[str, Any], data: Dataset) -> None:
        """Become the models that `get_state` came from, given the data that they had learned from.

        Raises:
            ProblemError: If the state does not suit the data.
        """
        self._trained, self._trained_rows = int(state["trained"]), int(state["trained_rows"])
        self._held, self._judged = int(state["held"]), int(state["judged"])
        self._outdated = bool(state["outdated"])
        self._steadiness = replace(
            self._steadiness,
            is_noisy_by_evidence=bool(state["noisy"]),
            may_be_noisy=bool(state.get("may_be_noisy", False)),
            drift_evidence=float(state["drift_evidence"]),
        )
        for name, output in self._outputs.items():
            output.suspects = np.array(state["suspects"].get(name, ()), dtype=np.intp)
            output.is_apart = name in state.get("apart", ())
            if (output.suspects < 0).any() or (output.suspects >= len(data)).any():
                raise ProblemError("the state suspects evaluations that there are not")
        if not (
            0 <= self._trained <= self._trained_rows <= self._held <= len(data)
            and 0 <= self._judged <= len(data)
        ):
            raise ProblemError(
                f"the state's models were trained with {self._trained} of {self._trained_rows} "
                f"evaluations and hold {self._held}, those of failures {self._judged}, "
                f"but there are {len(data)}"
            )
        self._context = ContextInputs.from_state(state["context"], self._problem)
        self._steadiness = replace(self._steadiness, jumps=self._context.jumps)
        judged = self._selection.of_failures(data, self._judged)
        self.validity = ValidityModel.from_state(
            state["validity"],
            _located(data)[judged],
            ~data.failed[judged],
            self._one_hot,
            self._context.fidelities,
        )
        inputs = self._context.inputs(data)
        for name, output in self._outputs.items():
            y, stddev = output.observations(data)
            rows = output.held(data, inputs, self._held, self._trained_rows)
            process = output.process = GaussianProcess.from_state(
                state["processes"][name],
                inputs[rows],
                y[rows],
                stddev[rows],
                mean=self.means.mean(name),
                mean_gradient=self.means.gradient(name),
                one_hot=self._one_hot,
                limit=output.process.limit,
            )
            if process.n != len(rows) or process.contexts != self._context.count:
                raise ProblemError(f"the state lacks what the model of '{name}' was fitted to")
        self.by_parts = frozenset(state.get("by_parts", ()))
        if not self.by_parts <= self._compositions.keys():
            raise ProblemError("the state predicts quantities by parts that there are not")
        self._set_now(data)
        self._compose()


def _located(data: Dataset) -> Array:
    """Return where each evaluation was, and its distance from the highest fidelity ``(n, d + f)``."""
    return np.hstack([data.inputs, data.lacks])


def _is_time_to_restart(trained: int, count: int) -> bool:
    """Return whether a training of `count` evaluations, the last one of `trained`, tries random starts.

    If the last optimum is a poor one, a few more evaluations seldom show it, and a random start costs
    more than to continue from there: it is tried whenever there are a fifth more evaluations.
    """
    return trained == 0 or int(_log_in_fifths(count)) > int(_log_in_fifths(trained))


def _log_in_fifths(count: int) -> float:
    return math.log(count) / math.log(1.2)

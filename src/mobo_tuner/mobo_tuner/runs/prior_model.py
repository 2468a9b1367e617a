"""The model of the machine that a parameter file names as prior mean: a function, a file of torch, or another run."""

from __future__ import annotations

import importlib
import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mobo_tuner.core import Optimizer, Problem, ProblemError
from mobo_tuner.core.gaussian_process import GaussianProcess
from mobo_tuner.core.prior_mean import PriorMeans, PriorModel
from mobo_tuner.core.problem import Array
from mobo_tuner.core.settings import method_of
from mobo_tuner.errors import UserError
from mobo_tuner.python_functions import load_function
from mobo_tuner.runs.history import INPUTS, MODEL, OUTPUTS, History, told_of
from mobo_tuner.runs.journal import FILE_NAME, read_journal
from mobo_tuner.runs.records import EvaluationRecord, ForgetRecord

_TORCHSCRIPT, _EXPORTED = (".pt", ".ts"), ".pt2"
_TRIED = 64  # set-points at which a model is tried before the run

Function = Callable[[Mapping[str, Array]], Mapping[str, Any]]


def load_prior_model(problem: Problem, settings: Mapping[str, Any]) -> PriorModel | None:
    """Return the prior model that the settings of a tuner name; None if they name none.

    It is tried at set-points all over the bounds.

    Args:
        problem: Problem that is tuned.
        settings: Settings of the tuner.

    Raises:
        ProblemError: If the model cannot be loaded, lacks a quantity, or does not give finite numbers.
    """
    name = str(settings.get(MODEL, ""))
    if not name:
        return None
    try:
        model = _load(name, problem, settings)
        PriorMeans(problem, model).values(_points(problem))
    except UserError as error:
        raise ProblemError(f"{MODEL} is '{name}': {error}") from None
    except Exception as error:  # of the user's own model
        raise ProblemError(f"{MODEL} is '{name}': {type(error).__name__}: {error}") from error
    return model


def _points(problem: Problem) -> Array:
    """Return set-points ``(m, d)`` all over the bounds, with both ends of every variable."""
    d = len(problem.variables)
    inside = np.random.default_rng(0).uniform(-1.0, 1.0, (_TRIED, d))
    return np.vstack([inside, -np.ones(d), np.ones(d)])


def _load(name: str, problem: Problem, settings: Mapping[str, Any]) -> PriorModel:
    """Return the model of a name, see `load_prior_model`."""
    outputs = _outputs(problem, str(settings.get(OUTPUTS, "")))
    inputs = _Inputs.parse(problem, str(settings.get(INPUTS, "")))
    place, _, function = name.rpartition(":")
    path = Path(name)
    if place and not path.exists():
        return FunctionModel(load_function(place, function), outputs, inputs)
    if not path.exists():
        raise ProblemError(
            "there is no such file or folder; a file of torch, the folder of a run, PACKAGE:FUNCTION and "
            "FILE.py:FUNCTION are allowed"
        )
    if (path / FILE_NAME).exists():
        if settings.get(INPUTS):
            raise ProblemError(f"{INPUTS} is given, but the inputs of a run have names")
        return RunModel.read(path, problem, outputs)
    if path.suffix in (*_TORCHSCRIPT, _EXPORTED):
        return TorchModel.read(path, outputs, inputs)
    raise ProblemError(
        f"a file of torch ({', '.join((*_TORCHSCRIPT, _EXPORTED))}) or the folder of a run is allowed; a "
        "function (FILE.py:FUNCTION) can read any other file"
    )


def _outputs(problem: Problem, text: str) -> tuple[str, ...]:
    """Return the names of the quantities that a model predicts: all that are modelled, if none is named."""
    modelled = problem.required_diagnostics
    names = tuple(text.replace(",", " ").split())
    for name in names:
        if name not in modelled or names.count(name) > 1:
            raise ProblemError(
                f"{OUTPUTS} names '{name}'; each of {', '.join(modelled)} is allowed once"
            )
    return names or modelled


@dataclass(frozen=True)
class _Inputs:
    """The inputs of a model, in its order.

    Attributes:
        names: Names of the inputs.
        constants: Values of those that are not variables.
    """

    names: tuple[str, ...]
    constants: Mapping[str, float]

    @classmethod
    def parse(cls, problem: Problem, text: str) -> _Inputs:
        """Return the inputs that a text names: all variables, if it names none.

        Raises:
            ProblemError: If one is neither a variable nor has a value.
        """
        names, constants = [], {}
        for word in text.replace(",", " ").split():
            name, given, value = word.partition("=")
            if given:
                try:
                    constants[name] = float(value)
                except ValueError:
                    constants[name] = math.nan
                if not math.isfinite(constants[name]):
                    raise ProblemError(f"{INPUTS} has '{word}'; NAME=NUMBER is allowed")
            elif name not in problem.variable_names:
                raise ProblemError(
                    f"{INPUTS} names '{name}'; {', '.join(problem.variable_names)} and NAME=NUMBER are allowed"
                )
            names.append(name)
        if len(names) == len(constants):  # only constants, beside all variables
            names = [*problem.variable_names, *names]
        return cls(tuple(names), constants)

    def complete(self, columns: Mapping[str, Array]) -> dict[str, Array]:
        """Return one array ``(n,)`` per input, from one per variable."""
        n = len(next(iter(columns.values())))
        return {
            name: np.full(n, self.constants[name]) if name in self.constants else columns[name]
            for name in self.names
        }


@dataclass(frozen=True)
class FunctionModel:
    """A Python function of arrays by name that returns arrays by name.

    Attributes:
        function: Function; it may return more than the outputs.
        outputs: Names of the quantities that are used.
        inputs: Inputs of the function.
    """

    function: Function
    outputs: tuple[str, ...]
    inputs: _Inputs

    def predict(self, columns: Mapping[str, Array]) -> Array:
        """Return the outputs ``(n, Q)``, see `PriorModel`.

        Raises:
            ProblemError: If one is missing or is not an array of numbers.
        """
        with np.errstate(all="ignore"):  # what is not finite is refused
            predicted = self.function(self.inputs.complete(columns))
        if not isinstance(predicted, Mapping):
            raise ProblemError(f"it must return arrays by name, not {predicted!r:.60}")
        missing = [name for name in self.outputs if name not in predicted]
        if missing:
            raise ProblemError(
                f"it does not predict '{missing[0]}'; {OUTPUTS} may name fewer than all"
            )
        n = len(next(iter(columns.values())))
        values = np.empty((n, len(self.outputs)))
        for j, name in enumerate(self.outputs):
            try:
                values[:, j] = np.broadcast_to(np.asarray(predicted[name], dtype=float), n)
            except (TypeError, ValueError):
                raise ProblemError(f"its '{name}' must be {n} numbers") from None
        return values


class TorchModel:
    """A network of torch from an array ``(n, inputs)`` to one ``(n, outputs)``, in physical units.

    Args:
        network: Network.
        outputs: Names of its outputs, in their order.
        inputs: Its inputs, in their order.
    """

    def __init__(self, network: Any, outputs: tuple[str, ...], inputs: _Inputs) -> None:
        self._network, self.outputs, self._inputs = network, outputs, inputs
        parameter = next(iter(network.parameters()), None)
        self._torch = importlib.import_module("torch")
        self._type = self._torch.float64 if parameter is None else parameter.dtype

    @classmethod
    def read(cls, path: Path, outputs: tuple[str, ...], inputs: _Inputs) -> TorchModel:
        """Read a file that torch.jit.save or torch.export.save wrote.

        Raises:
            ProblemError: If it cannot be read, or torch is not installed.
        """
        try:
            torch = importlib.import_module("torch")
        except ImportError:
            raise ProblemError("the package torch is not installed, which reads it") from None
        try:
            with warnings.catch_warnings():  # TorchScript is deprecated, but there are files of it
                warnings.simplefilter("ignore")
                if path.suffix == _EXPORTED:
                    network = torch.export.load(path).module()
                else:
                    network = torch.jit.load(str(path), map_location="cpu").eval()
        except Exception as error:
            raise ProblemError(f"torch cannot read it: {error}") from error
        return cls(network, outputs, inputs)

    def predict(self, columns: Mapping[str, Array]) -> Array:
        """Return the outputs ``(n, Q)``, see `PriorModel`."""
        with self._torch.no_grad():
            return np.asarray(self._outputs_at(self._tensor(columns)).double().numpy())

    def predict_with_gradient(
        self, columns: Mapping[str, Array]
    ) -> tuple[Array, Mapping[str, Array]]:
        """Return the outputs and their derivatives, see `SmoothPriorModel`.

        Each point is given once for each output, so that one pass back gives all derivatives.
        """
        x, count = self._tensor(columns), len(self.outputs)
        repeated = x.repeat(count, 1).requires_grad_()
        n = len(x)
        predicted = self._outputs_at(repeated).reshape(count, n, count)
        chosen = predicted.diagonal(dim1=0, dim2=2)
        (slopes,) = self._torch.autograd.grad(chosen.sum(), repeated)
        by_input = slopes.reshape(count, n, -1).permute(2, 1, 0).double().numpy()
        values = np.asarray(chosen.detach().double().numpy())
        return values, {
            name: by_input[i]
            for i, name in enumerate(self._inputs.names)
            if name not in self._inputs.constants
        }

    def _tensor(self, columns: Mapping[str, Array]) -> Any:
        """Return the inputs ``(n, inputs)``."""
        inputs = np.column_stack([*self._inputs.complete(columns).values()])
        return self._torch.as_tensor(inputs, dtype=self._type)

    def _outputs_at(self, inputs: Any) -> Any:
        """Return the outputs ``(n, Q)`` at inputs ``(n, inputs)``.

        Raises:
            ProblemError: If they are not as many as are named.
        """
        predicted = self._network(inputs)
        if tuple(getattr(predicted, "shape", ())) != (len(inputs), len(self.outputs)):
            raise ProblemError(
                f"it must return {len(self.outputs)} outputs for each point ({', '.join(self.outputs)}), not "
                f"{tuple(getattr(predicted, 'shape', ()))} for {len(inputs)}; {OUTPUTS} may name others"
            )
        return predicted


@dataclass(frozen=True)
class RunModel:
    """The models of another run or campaign.

    Attributes:
        problem: Problem of that run.
        outputs: Names of the quantities that are used.
        processes: Gaussian process of each.
        signs: Sign of each in the other run, where it may have been maximised.
    """

    problem: Problem
    outputs: tuple[str, ...]
    processes: Sequence[GaussianProcess]
    signs: Array

    @classmethod
    def read(cls, folder: Path, problem: Problem, outputs: tuple[str, ...]) -> RunModel:
        """Read a run's journal and train its models once.

        Raises:
            UserError: If it cannot be read, or lacks a quantity or a variable.
        """
        optimizer = _optimizer_of(History.from_records(read_journal(folder)))
        other = optimizer.problem
        fixed = {v.name for v in other.variables if v.fixed is not None}
        for name in other.variable_names:
            if name not in problem.variable_names and name not in fixed:
                raise ProblemError(
                    f"that run has the variable '{name}', which is not one of this problem"
                )
        processes = optimizer.archive.extended_models.by_output
        for name in outputs:
            if name not in processes or not processes[name].n:
                raise ProblemError(
                    f"that run has no model of '{name}'; {OUTPUTS} may name fewer than all"
                )
        signs = {o.name: o.sign for o in other.objectives}
        return cls(
            other,
            outputs,
            [processes[name] for name in outputs],
            np.array([signs.get(name, 1.0) for name in outputs]),
        )

    def predict(self, columns: Mapping[str, Array]) -> Array:
        """Return the outputs ``(n, Q)``, see `PriorModel`."""
        x, _ = self._inputs(columns)
        return self.signs * np.column_stack([p.predict(x)[0] for p in self.processes])

    def predict_with_gradient(
        self, columns: Mapping[str, Array]
    ) -> tuple[Array, Mapping[str, Array]]:
        """Return the outputs and their derivatives, see `SmoothPriorModel`."""
        x, slopes = self._inputs(columns)
        predicted = [p.predict_with_gradient(x) for p in self.processes]
        gradients = np.stack([p.mean_gradient for p in predicted], axis=1)  # (n, Q, d)
        return self.signs * np.column_stack([p.mean for p in predicted]), {
            v.name: self.signs * gradients[:, :, j] * slopes[:, j, None]
            for j, v in enumerate(self.problem.variables)
            if v.name in columns
        }

    def _inputs(self, columns: Mapping[str, Array]) -> tuple[Array, Array]:
        """Return set-points as that run normalised them, and the derivatives by their units ``(n, d)``."""
        n = len(next(iter(columns.values())))
        x, slopes = (
            np.zeros((n, len(self.problem.variables))),
            np.zeros((n, len(self.problem.variables))),
        )
        for j, v in enumerate(self.problem.variables):
            if v.name not in columns or v.fixed is not None:
                continue
            value = columns[v.name]
            if v.scale == "log":
                ratio = np.log(v.maximum / v.minimum)
                x[:, j] = 2.0 * np.log(value / v.minimum) / ratio - 1.0
                slopes[:, j] = 2.0 / (ratio * value)
            else:
                x[:, j] = 2.0 * (value - v.minimum) / (v.maximum - v.minimum) - 1.0
                slopes[:, j] = 2.0 / (v.maximum - v.minimum)
        return x, slopes


def _optimizer_of(history: History) -> Optimizer:
    """Return an optimiser that knows the evaluations of a run and what was withdrawn, by its last problem."""
    problem = history.last_problem
    if history.settings:
        model = load_prior_model(problem, history.settings)
        method = method_of(history.settings).to_dict()
        optimizer = Optimizer(problem, prior_means=model, **method)
    else:
        optimizer = Optimizer(problem)
    for record in history.records:
        if isinstance(record, EvaluationRecord):
            optimizer.tell(*told_of(record, problem, history.model_input))
        elif isinstance(record, ForgetRecord):
            act = optimizer.forget if record.withdrawn else optimizer.unforget
            act(record.evaluation, record.diagnostic or None)
    return optimizer

"""Models of the machine that are known before a run, such as a simulation, as prior means of the processes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol, runtime_checkable

import numpy as np

from mobo_tuner.core.gaussian_process_settings import MeanFunction
from mobo_tuner.core.problem import LARGEST, Array, Problem, ProblemError

PriorMean = Callable[[Mapping[str, Array]], Array]
"""Predicts one quantity in its own unit, shape ``(n,)``, from one array ``(n,)`` per variable."""

_STEP = 1e-5  # of numerical gradients, where a variable spans 2


@runtime_checkable
class PriorModel(Protocol):
    """Predicts quantities of a machine at any set-points."""

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the Q quantities that it predicts."""

    def predict(self, columns: Mapping[str, Array]) -> Array:
        """Return the quantities in their own units ``(n, Q)``, from one array ``(n,)`` per variable."""


@runtime_checkable
class SmoothPriorModel(PriorModel, Protocol):
    """A model that knows its exact gradients."""

    def predict_with_gradient(
        self, columns: Mapping[str, Array]
    ) -> tuple[Array, Mapping[str, Array]]:
        """Return what `predict` does, and its derivatives by each variable in its unit ``(n, Q)``.

        A variable that is missing has no influence.
        """


@dataclass(frozen=True)
class SeparateModels:
    """A function for each quantity, as one model.

    Attributes:
        functions: Function of each quantity.
    """

    functions: Mapping[str, PriorMean]

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the quantities."""
        return tuple(self.functions)

    def predict(self, columns: Mapping[str, Array]) -> Array:
        """Return the quantities, see `PriorModel`."""
        n = len(next(iter(columns.values())))
        predicted = np.empty((n, len(self.functions)))
        for j, (name, function) in enumerate(self.functions.items()):
            # What one does to its arguments is no business of the others.
            values = function({variable: column.copy() for variable, column in columns.items()})
            try:
                predicted[:, j] = _as_reals(values).reshape(n)
            except (TypeError, ValueError):
                raise ProblemError(
                    f"the prior mean of '{name}' must return {n} numbers for as many set-points, "
                    f"not {values!r:.60}"
                ) from None
        return predicted


Prior = PriorModel | Mapping[str, PriorMean]
"""A model, or a function for each quantity."""


class PriorMeans:
    """The prior means of a problem's quantities, as functions of normalised set-points.

    The model is asked for all quantities at once and only within the bounds, for what is outside at
    the nearest place within; what it answered last is kept, because the processes ask one after the
    other for the same set-points.

    Args:
        problem: Problem.
        model: Model, of which quantities that the problem does not model are ignored, or a function for
            each quantity.

    Raises:
        ProblemError: If there is a function for a quantity that is not modelled, or the model fails or does
            not give finite numbers.
    """

    def __init__(self, problem: Problem, model: Prior) -> None:
        if isinstance(model, Mapping):
            for name, function in model.items():
                if not callable(function):
                    raise ProblemError(f"the prior mean of '{name}' must be a function")
            model = SeparateModels(model)
        if not isinstance(model, PriorModel) or isinstance(model, type):
            raise ProblemError(
                f"prior_means must be a model or a mapping of names, not {model!r:.60}"
            )
        names = model.outputs
        if not isinstance(names, Sequence) or len(set(map(str, names))) < len(names):
            raise ProblemError(
                f"the outputs of the prior mean's model are {names!r:.60}; different names are allowed"
            )
        modelled = problem.required_diagnostics
        for name in model.outputs if isinstance(model, SeparateModels) else ():
            if name not in modelled:
                raise ProblemError(
                    f"a prior mean is given for '{name}'; allowed are {', '.join(modelled)}"
                )
        self._problem, self._model = problem, model
        signs = {o.name: o.sign for o in problem.objectives}
        self._signs = np.array([signs.get(name, 1.0) for name in model.outputs])
        self._columns = {name: j for j, name in enumerate(model.outputs)}
        self._valued: tuple[Array, Array] | None = None
        self._differentiated: tuple[Array, Array] | None = None
        if model.outputs:
            self.values(np.zeros((2, len(problem.variables))))

    def mean(self, name: str) -> MeanFunction | None:
        """Return the prior mean of a quantity as it is minimised; None if there is none."""
        return None if name not in self._columns else partial(self._column, self._columns[name])

    def gradient(self, name: str) -> MeanFunction | None:
        """Return the gradient of `mean`, in the shape of its input: none by time."""
        return None if name not in self._columns else partial(self._slope, self._columns[name])

    def _column(self, j: int, x: Array) -> Array:
        return np.asarray(self.values(x)[:, j])

    def _slope(self, j: int, x: Array) -> Array:
        gradients = self.gradients(x)[:, j]
        return np.pad(gradients, ((0, 0), (0, x.shape[1] - gradients.shape[1])))

    def values(self, x: Array) -> Array:
        """Return the predictions ``(m, Q)`` at x ``(m, d)``, of minimised quantities."""
        for known in (self._valued, self._differentiated):
            if known is not None and np.array_equal(known[0], x):
                return known[1][..., 0] if known[1].ndim == 3 else known[1]
        values = self._predict(self._within(x))
        self._valued = x.copy(), values
        return values

    def gradients(self, x: Array) -> Array:
        """Return the gradients ``(m, Q, d)`` of `values`."""
        if self._differentiated is None or not np.array_equal(self._differentiated[0], x):
            self._differentiated = x.copy(), self._differentiate(self._within(x))
        return self._differentiated[1][..., 1:]

    def _within(self, x: Array) -> Array:
        """Return the set-points within the bounds, without time if that is an input."""
        return np.clip(x[:, : len(self._problem.variables)], -1.0, 1.0)

    def _predict(self, x: Array) -> Array:
        return self._checked(_answer(self._model.predict, self._problem.columns(x)), len(x))

    def _checked(self, predicted: object, n: int) -> Array:
        """Return predictions or derivatives ``(n, Q)`` of minimised quantities.

        Raises:
            ProblemError: If they are not as many finite numbers.
        """
        names = self._model.outputs
        try:
            values = _as_reals(predicted)
        except (TypeError, ValueError):
            values = np.empty(0)
        if values.shape != (n, len(names)):
            raise ProblemError(
                f"the prior means of {', '.join(names)} must be {n} by {len(names)} numbers, "
                f"not {predicted!r:.60}"
            )
        wrong = ~(np.abs(values) <= LARGEST).all(axis=0)
        if wrong.any():
            name = names[int(wrong.argmax())]
            raise ProblemError(f"the prior mean of '{name}' is not a finite number everywhere")
        return np.asarray(self._signs * values)

    def _differentiate(self, x: Array) -> Array:
        """Return values and gradients ``(m, Q, 1 + d)`` at x ``(m, d)``."""
        m, d = x.shape
        both = np.zeros((m, len(self._signs), 1 + d))
        if isinstance(self._model, SmoothPriorModel):
            columns = self._problem.columns(x)
            answer = _answer(self._model.predict_with_gradient, columns)
            if not (
                isinstance(answer, tuple) and len(answer) == 2 and isinstance(answer[1], Mapping)
            ):
                raise ProblemError(
                    "predict_with_gradient of the prior mean's model must return predictions and a mapping of "
                    f"derivatives, not {answer!r:.60}"
                )
            values, slopes = answer
            both[..., 0] = self._checked(values, m)
            for j, variable in enumerate(self._problem.variables):
                if variable.name in slopes:
                    step = 0.5 * (variable.maximum - variable.minimum)
                    if variable.scale == "log":
                        ratio = np.log(variable.maximum / variable.minimum)
                        step = 0.5 * ratio * columns[variable.name][:, None]
                    both[..., 1 + j] = step * self._checked(slopes[variable.name], m)
            return both
        steps = _STEP * np.eye(d)[:, None]
        ahead, behind = np.minimum(x + steps, 1.0), np.maximum(x - steps, -1.0)
        predicted = self._predict(np.concatenate([x, *ahead, *behind]))
        both[..., 0] = predicted[:m]
        further = predicted[m:].reshape(2, d, m, -1)
        widths = (ahead - behind).sum(axis=2)[..., None]
        both[..., 1:] = np.moveaxis((further[0] - further[1]) / widths, 0, 2)
        return both


def _answer(function: Callable[[Mapping[str, Array]], Any], columns: Mapping[str, Array]) -> Any:
    """Return what a model answers.

    Raises:
        ProblemError: If it fails, whatever the reason.
    """
    try:
        return function(columns)
    except ProblemError:
        raise
    except Exception as error:
        reason = f"{type(error).__name__}: {error}"
        raise ProblemError(f"the model of the prior mean failed: {reason:.200}") from error


def _as_reals(values: object) -> Array:
    """Return numbers as an array.

    Raises:
        TypeError: If they are complex.
        ValueError: If they are not numbers.
    """
    array = np.asarray(values)
    if array.dtype.kind == "c":
        raise TypeError("complex numbers")
    return np.asarray(array, dtype=float)

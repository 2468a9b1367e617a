"""Gaussian process regression of one output, `[Roussel2021]_` Appendix (sec:regression)."""

from __future__ import annotations

import time
from copy import copy
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtri

from mobo_tuner.core.arrays import FloatArray
from mobo_tuner.core.context_kernel import Contextual
from mobo_tuner.core.domain import sobol
from mobo_tuner.core.evidence import NoiseEvidence, drift_evidence, noise_evidence
from mobo_tuner.core.gaussian_process_settings import GaussianProcessSettings, MeanFunction
from mobo_tuner.core.jump import JumpEvidence
from mobo_tuner.core.kernels import Kernel, as_inputs
from mobo_tuner.core.linear_algebra import single_blas_thread
from mobo_tuner.core.one_hot import OneHot
from mobo_tuner.core.output_scaling import LARGEST_OUTPUT, OutputScaling, is_constant
from mobo_tuner.core.output_transform import Logarithm
from mobo_tuner.core.posterior import Gradients, Posterior
from mobo_tuner.core.scaling_choice import ScalingChoice
from mobo_tuner.core.training import Task, train, train_optional

__all__ = ["GaussianProcess", "GaussianProcessSettings", "LeaveOneOut", "Prediction"]

_LEAST_QUANTILE = 1e-6  # of a draw


class Prediction(NamedTuple):
    """Posterior of the latent function in the output's units: `(m,)` twice, then `(m, d)` twice."""

    mean: FloatArray
    stddev: FloatArray
    mean_gradient: FloatArray
    stddev_gradient: FloatArray


class LeaveOneOut(NamedTuple):
    """Each observation predicted from all others, `(n,)` each, in the output's units.

    The standard deviation is that of an observation, its noise included; the log density is that
    of the observation under its prediction.
    """

    mean: FloatArray
    stddev: FloatArray
    residual: FloatArray
    log_density: FloatArray


class _Model(NamedTuple):
    """One way to model the output, trained: name, scaling and hyperparameters `(k + 2,)`."""

    name: str
    scaling: OutputScaling
    parameters: FloatArray


class _State(NamedTuple):
    """A trained model conditioned on outputs y `(n,)` at x `(n, d)`, of known standard deviations `(n,)`."""

    model: _Model
    posterior: Posterior
    y: FloatArray
    stddev: FloatArray
    x: FloatArray


class _WithTime(NamedTuple):
    """What the evidence of time takes, see `evidence.drift_evidence`."""

    settings: GaussianProcessSettings
    kernel: Contextual
    x: FloatArray
    z: FloatArray
    known: FloatArray
    parameters: FloatArray


class GaussianProcess:
    """One output, in its own units, as a Gaussian process over inputs normalised to [-1, 1].

    `fit` trains the hyperparameters; `add` then takes single observations in O(n^2), with the
    hyperparameters and the standardisation of the last `fit`, until the next one. Predictions after
    `add` are those of a model built from all observations with the same hyperparameters
    (`condition`), to rounding.

    Same calls, same numbers: `fit` is a function of the data, the last hyperparameters and the
    generator. To continue a saved model with bitwise the same numbers, `from_state` factorises
    what the last `fit` or `condition` had and then repeats the `add` calls.

    Many small predictions in a row are cheaper inside one `single_blas_thread` block.

    Args:
        settings: Settings of the model.
        reference: Component of the reference point, needed by mean="reference".
        mean: Function from inputs `(n, d)` to outputs `(n,)`. The prior mean is the function and its
            best offset, the same with its best factor, or that of the settings, whichever predicts
            left-out observations best.
        mean_gradient: Gradient of `mean`, from inputs `(m, d)` to `(m, d)`; by default central
            differences.
        contexts: Number of the last inputs that nobody sets, such as time. Predictions at inputs
            without them are for the values in `now`.
        one_hot: How the kernel sees unordered inputs; None if there are none.
        limit: Limit to keep, about which transform="auto" takes a signed logarithm; None for the logarithm
            itself.

    Attributes:
        settings: Settings of the model.
        contexts: Number of the last inputs that nobody sets.
        now: Their values for predictions `(contexts,)`, in the units of the inputs.

    Raises:
        ValueError: If the reference is missing or not finite, or a gradient is given without a mean.
    """

    def __init__(
        self,
        settings: GaussianProcessSettings | None = None,
        reference: float | None = None,
        *,
        mean: MeanFunction | None = None,
        mean_gradient: MeanFunction | None = None,
        contexts: int = 0,
        one_hot: OneHot | None = None,
        limit: float | None = None,
    ) -> None:
        self.settings = settings or GaussianProcessSettings()
        self.contexts = contexts
        self._one_hot = one_hot
        self.now = np.zeros(contexts)
        self._choice = ScalingChoice(self.settings, reference, mean, mean_gradient, limit)
        self._is_plain = False
        self._trained: dict[str, FloatArray] = {}
        self._state: _State | None = None

    # Observations.

    def fit(
        self,
        x: ArrayLike,
        y: ArrayLike,
        stddev: ArrayLike | None = None,
        *,
        rng: np.random.Generator | None = None,
        restarts: int | None = None,
        most_trained: int | None = None,
        seconds: float = np.inf,
        noisy: bool = False,
        decisive: NDArray[np.bool_] | None = None,
    ) -> GaussianProcess:
        """Train on the observations and condition on them; O(n^3) for each step of the training.

        The training starts from the last hyperparameters where there are some.

        Args:
            x: Normalised inputs `(n, d)`, n >= 1.
            y: Outputs `(n,)`.
            stddev: Known standard deviations of the outputs `(n,)`; NaN where unknown.
            rng: Random number generator of the random starts; by default one of fixed seed.
            restarts: Number of random starts in place of the settings'.
            most_trained: Highest number of observations to train on; by default all.
            seconds: Time budget of the training [s], which then ends with the best so far.
            noisy: Whether the machine is known to be noisy, which widens the prior of the noise.
            decisive: Which observations what is optional for the kernel must predict better, too `(n,)`;
                None for all.

        Returns:
            The model itself.

        Raises:
            ValueError: If an argument has the wrong shape or a value that is not finite.
        """
        d = None if self._state is None else self._d
        inputs, outputs, noise = _checked_data(x, y, stddev, d)
        seen = self.seen(inputs)
        kernel = self.settings.make_kernel(seen.shape[1], self.contexts)
        generator = np.random.default_rng(0) if rng is None else rng
        starts = self.settings.restarts if restarts is None else restarts
        part = slice(None, None, -(-len(outputs) // (most_trained or len(outputs))))
        deciding = None if decisive is None else decisive[part]
        states, tasks = [], {}
        with single_blas_thread():
            scalings = self._choice.allowed(inputs, outputs)
            begin = time.monotonic()
            for i, (name, scaling) in enumerate(scalings):
                deadline = begin + seconds * (i + 1) / (len(scalings) + 1)
                z = scaling.standardise(inputs, outputs)[part]
                known = self._known_noise(scaling, outputs, noise)[part]
                task = Task(
                    self.settings, kernel, scaling.scale, seen[part], z, known, noisy, deciding
                )
                tasks[name] = task
                parameters = train(task, self._trained.get(name), generator, starts, deadline)
                self._trained[name] = parameters
                model = _Model(name, scaling, parameters)
                states.append(self._condition(kernel, model, inputs, outputs, noise))
            in_use = None if self._state is None else self._state.model.parameters
            scores = []
            for state in states if len(states) > 1 else ():
                self._state = state
                density = self.leave_one_out().log_density.sum()
                name, scaling, _ = state.model
                scores.append(
                    self._choice.score(name, scaling, density, noisy or bool(noise.any()))
                )
            self._state = states[int(np.argmax(scores))] if scores else states[0]
            if not self._is_plain:
                model = self._state.model
                parameters = train_optional(
                    tasks[model.name], model.parameters, in_use, begin + seconds
                )
                if parameters is not model.parameters:
                    model = model._replace(parameters=parameters)
                    self._state = self._condition(kernel, model, inputs, outputs, noise)
        return self

    def copy(self) -> GaussianProcess:
        """Return a model with the same observations; what it learns later is its own."""
        other = copy(self)
        other._trained = dict(self._trained)
        if self._state is not None:
            other._state = self._state._replace(posterior=copy(self._state.posterior))
        return other

    def condition(
        self, x: ArrayLike, y: ArrayLike, stddev: ArrayLike | None = None
    ) -> GaussianProcess:
        """Take these observations in place of all former ones, without training; O(n^3).

        Hyperparameters and standardisation stay those of the last `fit`; only where the logarithm is
        modelled and an output is not positive, the model is fitted again. Arguments and errors are
        those of `fit`.
        """
        model, posterior, *_ = self._fitted
        inputs, outputs, noise = _checked_data(x, y, stddev, self._d)
        if not model.scaling.allows(outputs):
            return self.fit(inputs, outputs, noise, restarts=0)
        with single_blas_thread():
            self._state = self._condition(posterior.kernel, model, inputs, outputs, noise)
        return self

    def add(self, x: ArrayLike, y: float, stddev: float | None = None) -> GaussianProcess:
        """Add one observation without training; O(n^2).

        Only if the logarithm is modelled and y is not positive, the model is fitted again.

        Args:
            x: Normalised input `(d,)`.
            y: Output.
            stddev: Known standard deviation of the output; None or NaN if unknown.

        Returns:
            The model itself.

        Raises:
            ValueError: If an argument is not finite or has the wrong shape.
        """
        return self.add_all(np.asarray(x)[None], [y], None if stddev is None else [stddev])

    def add_all(
        self, x: ArrayLike, y: ArrayLike, stddev: ArrayLike | None = None
    ) -> GaussianProcess:
        """Add m observations as `add` adds each, to rounding; many are added faster at once.

        Args:
            x: Normalised inputs `(m, d)`.
            y: Outputs `(m,)`.
            stddev: Known standard deviations of the outputs `(m,)`; NaN where unknown.

        Returns:
            The model itself.

        Raises:
            ValueError: If an argument is not finite or has the wrong shape.
        """
        model, posterior, former, former_noise, former_inputs = self._fitted
        inputs, outputs, noise = _checked_data(x, y, stddev, self._d)
        all_inputs = np.vstack([former_inputs, inputs])
        all_outputs, all_noise = np.append(former, outputs), np.append(former_noise, noise)
        if not model.scaling.allows(outputs):
            return self.fit(all_inputs, all_outputs, all_noise, restarts=0)
        with single_blas_thread():
            z = model.scaling.standardise(inputs, outputs)
            add = posterior.add if len(outputs) == 1 else posterior.add_all
            add(self.seen(inputs), z, self._noise(model, outputs, noise))
        self._state = _State(model, posterior, all_outputs, all_noise, all_inputs)
        return self

    # Predictions.

    def predict(self, x: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return mean and standard deviation `(m,)` of the latent function at x `(m, d)`; O(m n^2).

        In the output's units and without the noise of an observation.
        """
        model, posterior, *_ = self._fitted
        inputs = self._whole_inputs(x)
        with single_blas_thread():
            mean, stddev = posterior.predict(self.seen(inputs))
        return model.scaling.to_output(*model.scaling.unstandardise(inputs, mean, stddev))

    def predict_with_gradient(self, x: ArrayLike) -> Prediction:
        """Return the results of `predict` and their gradients in x; O(m n^2), about twice the time."""
        (_, scaling, _), posterior, *_ = self._fitted
        inputs = self._whole_inputs(x)
        d = np.shape(x)[1]
        with single_blas_thread():
            mean, stddev, gradients = posterior.predict_with_gradient(self.seen(inputs))
        if self._one_hot is not None:
            gradients = Gradients(*map(self._one_hot.pull_back, gradients))
        # The gradient comes first: most models give their values with it.
        mean_gradient = scaling.prior_mean_gradient(inputs) + scaling.scale * gradients.mean
        mean, stddev = scaling.unstandardise(inputs, mean, stddev)
        by_mean, by_stddev = scaling.gradients_to_output(
            mean, stddev, mean_gradient, scaling.scale * gradients.stddev
        )
        return Prediction(*scaling.to_output(mean, stddev), by_mean[:, :d], by_stddev[:, :d])

    def leave_one_out(self) -> LeaveOneOut:
        """Predict every observation from all others with the same hyperparameters; O(n^2)."""
        (_, scaling, _), posterior, y, _, x = self._fitted
        excess, variance = posterior.leave_one_out()
        latent = scaling.unstandardise(x, posterior.z - excess, np.sqrt(variance))
        mean, stddev = scaling.to_reading(*latent, y)
        log_density = posterior.leave_one_out_log_density
        return LeaveOneOut(mean, stddev, y - mean, log_density + scaling.log_slope(y))

    def sample(self, x: ArrayLike, normals: FloatArray) -> FloatArray:
        """Return draws `(s, m)` of the latent function at x `(m, d)`; O(m n^2 + m^3).

        Args:
            x: Normalised inputs `(m, d)`.
            normals: Independent standard normal numbers `(s, m)`.
        """
        model, posterior, *_ = self._fitted
        inputs = self._whole_inputs(x)
        with single_blas_thread():
            mean, root = posterior.joint(self.seen(inputs))
            drawn = model.scaling.prior_mean(inputs) + model.scaling.scale * (
                mean + normals @ root.T
            )
        return model.scaling.output(drawn)

    def drawn(self, count: int, rng: np.random.Generator) -> list[GaussianProcess]:
        """Return models that know the function at the observations, one for each draw of it there; O(n^3).

        Args:
            count: Number of draws, a power of two; they are evenly spread.
            rng: Random number generator.
        """
        state = self._fitted
        uniform = sobol(self.n, count, rng)
        normals = ndtri(np.clip(uniform, _LEAST_QUANTILE, 1.0 - _LEAST_QUANTILE))
        with single_blas_thread():
            posteriors = state.posterior.drawn(normals)
        models = []
        for posterior in posteriors:
            model = self.copy()
            model._state = state._replace(posterior=posterior)
            models.append(model)
        return models

    def correlations(self, x: FloatArray, others: FloatArray) -> FloatArray:
        """Return the correlations of the function at x `(d,)` with observations at others `(m, d)`; `(m,)`."""
        model, posterior, *_ = self._fitted
        inputs = np.vstack([self._whole_inputs(x[None]), self._whole_inputs(others)])
        with single_blas_thread():
            _, root = posterior.joint(self.seen(inputs))
        covariance = root @ root.T
        variances = np.diagonal(covariance) + float(np.exp(model.parameters[-1]))
        return np.asarray(covariance[0, 1:] / np.sqrt(covariance[0, 0] * variances[1:]))

    def prior_correlations(self, x: FloatArray) -> FloatArray:
        """Return the correlations of the function at the first of x `(m, d)` with the others, without observations."""
        _, posterior, *_ = self._fitted
        scaled = self.seen(self._whole_inputs(x)) @ posterior.factor
        distances = np.square(scaled[1:] - scaled[0]).sum(axis=1)
        return posterior.kernel.profile(distances)[0]

    def noise_evidence(self) -> NoiseEvidence:
        """Return the evidence that the readings are noisy, see `evidence.noise_evidence`."""
        model, posterior, y, stddev, _ = self._fitted
        known = self._known_noise(model.scaling, y, stddev)
        with single_blas_thread():
            return noise_evidence(
                self.settings, posterior.kernel, posterior.x, posterior.z, known, model.parameters
            )

    def drift_evidence(self, times: FloatArray, timed: bool) -> float:
        """Return the log evidence that the function changes with time, see `evidence.drift_evidence`.

        Args:
            times: Times of the observations `(n,)`, in the unit of time.
            timed: Whether the last input is time.
        """
        with single_blas_thread():
            return drift_evidence(*self._with_time(times, timed))

    def jump_evidence(self, times: FloatArray, timed: bool) -> JumpEvidence:
        """Return what tells whether the function changed at once, see `jump.JumpEvidence`.

        Args:
            times: Times of the observations `(n,)`, in the unit of time.
            timed: Whether the last input is time.
        """
        with single_blas_thread():
            return JumpEvidence(*self._with_time(times, timed), timed)

    def _with_time(self, times: FloatArray, timed: bool) -> _WithTime:
        """Return what the evidence of time takes; the time scale is any if time is no input."""
        model, posterior, y, stddev, _ = self._fitted
        d, others = posterior.kernel.d - timed, self.contexts - timed
        kernel = Contextual(self.settings.make_kernel(d - others), others + 1)
        x = np.column_stack([posterior.x[:, :d], times])
        shape = posterior.shape if timed else np.append(posterior.shape, 0.0)
        parameters = np.concatenate([shape, model.parameters[-2:]])
        known = self._known_noise(model.scaling, y, stddev)
        return _WithTime(self.settings, kernel, x, posterior.z, known, parameters)

    def plain(self) -> GaussianProcess:
        """Return a model of the same observations that leaves out what is optional for the kernel, now and later."""
        other = self.copy()
        other._is_plain = True
        model, posterior, y, stddev, x = self._fitted
        parameters = self._trained[model.name]
        if not np.array_equal(parameters, model.parameters):
            model = model._replace(parameters=parameters)
            other._state = self._condition(posterior.kernel, model, x, y, stddev)
        return other

    def untrained(self) -> GaussianProcess:
        """Return a model with the same settings and no observations."""
        model = GaussianProcess(
            self.settings,
            self.reference,
            mean=self._choice.mean,
            mean_gradient=self._choice.mean_gradient,
            contexts=self.contexts,
            one_hot=self._one_hot,
            limit=self.limit,
        )
        model.now = self.now
        model._is_plain = self._is_plain
        return model

    # What was learned.

    @property
    def reference(self) -> float | None:
        """Component of the reference point; None if there is none."""
        return self._choice.reference

    @property
    def limit(self) -> float | None:
        """Limit to keep; None if there is none or another one."""
        return self._choice.limit

    @property
    def n(self) -> int:
        """Number of observations; 0 before the first `fit`."""
        return 0 if self._state is None else len(self._state.y)

    @property
    def log_marginal_likelihood(self) -> float:
        """Log density of the observations in the output's units, without the priors."""
        (_, scaling, _), posterior, y, *_ = self._fitted
        return posterior.log_marginal_likelihood + float(scaling.log_slope(y).sum())

    @property
    def model(self) -> str:
        """Prior mean in use: data, reference, constant, function or scaled function.

        With " log" or " signed log" where that is modelled.
        """
        return self._fitted.model.name

    @property
    def precision(self) -> FloatArray:
        """Precision matrix Lambda `(d, d)` of what is set; length-scales are `1 / sqrt` of its diagonal."""
        factor = self._fitted.posterior.factor
        d = len(factor) - self.contexts
        settable = np.asarray(factor @ factor.T)[:d, :d]
        return settable if self._one_hot is None else self._one_hot.fold(settable)

    @property
    def variance(self) -> float:
        """Signal variance s^2 in the output's units squared (its logarithm's, where modelled)."""
        model, posterior, *_ = self._fitted
        return posterior.variance * model.scaling.scale**2

    @property
    def noise(self) -> float:
        """Learned standard deviation of one observation, in the units of `variance`' root."""
        model = self._fitted.model
        return float(np.exp(0.5 * model.parameters[-1])) * model.scaling.scale

    @property
    def range(self) -> tuple[float, float]:
        """Least and greatest output."""
        y = self._fitted.y
        return float(y.min()), float(y.max())

    @property
    def is_constant(self) -> bool:
        """Whether all outputs are alike, to rounding."""
        return is_constant(self._fitted.y)

    @property
    def known_noise(self) -> FloatArray:
        """Known standard deviation of each observation `(n,)`; 0 where it is unknown."""
        return np.hypot(self._fitted.stddev, self._fixed_noise)

    @property
    def skill(self) -> float:
        """Share of the outputs' variance that is explained by predicting each from all others."""
        residual = self.leave_one_out().residual
        return 1.0 - float(np.mean(residual**2) / np.var(self._fitted.y))

    @property
    def spread(self) -> float:
        """Half the range of the middle 68 % of the outputs; their standard deviation where it is 0."""
        y = self._fitted.y
        low, high = np.quantile(y, [0.16, 0.84])
        return 0.5 * float(high - low) or float(np.std(y))

    def noise_at(self, x: FloatArray) -> float:
        """Return the standard deviation of one observation near x `(d,)`: learned, and known at the nearest one."""
        model, posterior, y, stddev, _ = self._fitted
        here = self.seen(self._whole_inputs(x[None]))
        nearest = int(np.square(posterior.x - here).sum(axis=1).argmin())
        is_log = isinstance(model.scaling.transform, Logarithm)
        learned = 0.0 if is_log else self.noise * float(model.scaling.unit(y[[nearest]])[0])
        return float(np.sqrt(learned**2 + stddev[nearest] ** 2 + self._fixed_noise**2))

    # State.

    def get_state(self) -> dict[str, Any]:
        """Return settings and hyperparameters as data for JSON, without the observations."""
        state: dict[str, Any] = {
            "settings": self.settings.to_dict(),
            "reference": self.reference,
            "mean_function": self._choice.mean is not None,
            "contexts": self.contexts,
            "trained": {name: parameters.tolist() for name, parameters in self._trained.items()},
            "fitted": None,
        }
        if self._state is not None:
            model, posterior, *_ = self._state
            state["fitted"] = {
                "d": self._d,
                "model": model.name,
                "parameters": model.parameters.tolist(),
                **model.scaling.get_state(),
                "factorised": posterior.factorised,
            }
        return state

    @classmethod
    def from_state(
        cls,
        state: dict[str, Any],
        x: ArrayLike = (),
        y: ArrayLike = (),
        stddev: ArrayLike | None = None,
        *,
        mean: MeanFunction | None = None,
        mean_gradient: MeanFunction | None = None,
        one_hot: OneHot | None = None,
        limit: float | None = None,
    ) -> GaussianProcess:
        """Return the model that `get_state` came from, bitwise, given its observations in their order.

        Args:
            state: State from `get_state`, also after a conversion to JSON and back.
            x: Normalised inputs `(n, d)` of all observations, including those of `add`.
            y: Outputs `(n,)`.
            stddev: Known standard deviations of the outputs, as in `fit`.
            mean: The prior mean function again, if there was one.
            mean_gradient: The gradient of `mean` again, if there was one.
            one_hot: How the kernel sees unordered inputs, again.
            limit: Limit to keep, again.

        Raises:
            ValueError: If the observations do not suit the state, or a mean function is missing.
        """
        if state["mean_function"] != (mean is not None):
            raise ValueError("mean must be given if and only if the model was made with one")
        settings = GaussianProcessSettings.from_dict(state["settings"])
        contexts = int(state["contexts"])
        restored = cls(
            settings,
            state["reference"],
            mean=mean,
            mean_gradient=mean_gradient,
            contexts=contexts,
            one_hot=one_hot,
            limit=limit,
        )
        fitted = state["fitted"]
        if fitted is None:
            return restored
        if not fitted["d"] > contexts >= 0:
            raise ValueError(f"the state has {fitted['d']} inputs, of which nobody sets {contexts}")
        inputs, outputs, noise = _checked_data(x, y, stddev, fitted["d"])
        kernel = settings.make_kernel(restored.seen(inputs).shape[1], contexts)
        restored._trained = {
            name: _hyperparameters(values, kernel) for name, values in state["trained"].items()
        }
        m = fitted["factorised"]
        if len(outputs) < m:
            raise ValueError(
                f"x must have at least the {m} observations of the state, got {len(outputs)}"
            )
        scaling = restored._choice.restored(fitted["model"], fitted)
        model = _Model(fitted["model"], scaling, _hyperparameters(fitted["parameters"], kernel))
        with single_blas_thread():
            restored._state = restored._condition(kernel, model, inputs[:m], outputs[:m], noise[:m])
            for i in range(m, len(outputs)):
                restored.add(inputs[i], outputs[i], noise[i])
        return restored

    # Inside.

    def _whole_inputs(self, x: ArrayLike) -> FloatArray:
        """Return the inputs of predictions with the contexts of `now`, if they lack them."""
        d = self._d
        if not self.contexts or np.shape(x)[-1] == d:
            return as_inputs(x, d)
        inputs = as_inputs(x, d - self.contexts)
        return np.column_stack([inputs, np.tile(self.now, (len(inputs), 1))])

    def seen(self, x: FloatArray) -> FloatArray:
        """Return inputs as the kernel sees them, with a column for each unordered choice."""
        return x if self._one_hot is None else self._one_hot.expand(x)

    @property
    def _d(self) -> int:
        """Number of inputs, time included."""
        return int(self._fitted.x.shape[1])

    @property
    def _fitted(self) -> _State:
        if self._state is None:
            raise ValueError("the model has no observations yet: call fit first")
        return self._state

    @property
    def _fixed_noise(self) -> float:
        """Known standard deviation of every observation, beside its own; 0 where it is learned."""
        noise = self.settings.noise
        return 0.0 if isinstance(noise, str) else noise

    def _condition(
        self, kernel: Kernel, model: _Model, x: FloatArray, y: FloatArray, stddev: FloatArray
    ) -> _State:
        if not model.scaling.allows(y):
            raise ValueError(f"y must be positive where its logarithm is modelled, got {y.min()}")
        variance = float(np.exp(model.parameters[-2]))
        z = model.scaling.standardise(x, y)
        noise = self._noise(model, y, stddev)
        posterior = Posterior(kernel, model.parameters[:-2], variance, self.seen(x), z, noise)
        return _State(model, posterior, y, stddev, x)

    def _noise(self, model: _Model, y: FloatArray, stddev: FloatArray) -> FloatArray:
        """Return the variances `(n,)` of the standardised observations, learned plus known parts."""
        learned = float(np.exp(model.parameters[-1]))
        return learned + self._known_noise(model.scaling, y, stddev)

    def _known_noise(self, scaling: OutputScaling, y: FloatArray, stddev: FloatArray) -> FloatArray:
        return scaling.noise_variances(y, np.hypot(stddev, self._fixed_noise))


def _hyperparameters(values: object, kernel: Kernel) -> FloatArray:
    """Return the hyperparameters `(k + 2,)` of a state."""
    parameters = np.array(values, dtype=np.float64)
    if parameters.shape != (kernel.size + 2,) or not (np.abs(parameters) <= 700.0).all():
        raise ValueError(f"hyperparameters must be {kernel.size + 2} logarithms, got {values}")
    return parameters


def _checked_data(
    x: ArrayLike, y: ArrayLike, stddev: ArrayLike | None, d: int | None
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return copies of the observations `(n, d)`, `(n,)` and `(n,)`, the last with 0 where unknown."""
    inputs = as_inputs(x, d).copy()
    outputs = np.array(y, dtype=np.float64)
    if outputs.ndim != 1 or len(outputs) != len(inputs) or len(outputs) == 0:
        raise ValueError(
            f"y must have one value for each of {len(inputs)} rows of x, got shape {outputs.shape}"
        )
    if not (np.abs(outputs) <= LARGEST_OUTPUT).all():
        raise ValueError(
            f"y must be finite and at most {LARGEST_OUTPUT:g} in magnitude, got {outputs}"
        )
    noise = np.zeros_like(outputs) if stddev is None else np.array(stddev, dtype=np.float64)
    if noise.shape != outputs.shape:
        raise ValueError(f"stddev must have the shape {outputs.shape} of y, got {noise.shape}")
    noise[np.isnan(noise)] = 0.0
    if not ((noise >= 0.0) & (noise <= LARGEST_OUTPUT)).all():
        raise ValueError(f"stddev must be at least 0 and finite, or NaN where unknown, got {noise}")
    return inputs, outputs, noise

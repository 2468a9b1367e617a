"""Maximising an acquisition function over the box [-1, 1]^d.

An acquisition function is cheap next to a measurement but not smooth: far from every interesting
region it is zero, and it has many separate peaks. `ParticleSwarm` is what the paper used;
`MultiStart` follows gradients from starts that are spread out, and finds much more.

.. [Biscani2020] F. Biscani, D. Izzo, "A parallel global multiobjective framework for optimization:
   pagmo", Journal of Open Source Software 5, 2338 (2020).
.. [Roussel2021] R. Roussel, A. Hanuka, A. Edelen, "Multiobjective Bayesian optimization for online
   accelerator tuning", Phys. Rev. Accel. Beams 24, 062801 (2021).
"""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from mobo_tuner.core.acquisition import AcquisitionFunction
from mobo_tuner.core.arrays import FloatArray
from mobo_tuner.core.ascent import climb_by_curvature, climb_by_signs
from mobo_tuner.core.domain import SMALL, Domain, sobol
from mobo_tuner.core.registry import Registry
from mobo_tuner.errors import ParameterError
from mobo_tuner.parameter_spec import check_fields, parameter, specs_of, unknown

_CHUNK = 128
_KEPT = 128  # points between those of a grid that are rounded
_POLISHES = 50  # most moves to better neighbours


@dataclass(frozen=True)
class Maximum:
    """The best candidate that was found.

    Attributes:
        x: Candidate `(d,)` in [-1, 1]^d.
        log_value: Logarithm of the acquisition function there, finite.
        complete: Whether the search was not cut short by the time budget.
    """

    x: FloatArray
    log_value: float
    complete: bool


@dataclass(frozen=True)
class Maximizer(ABC):
    """A way of looking for the maximum of an acquisition function.

    The fields of a subclass, a frozen dataclass, are the settings that a parameter file may give
    as `maximizer_settings`.

    Raises:
        ParameterError: If a setting is of another type or not allowed.
    """

    def __post_init__(self) -> None:
        """Check the settings."""
        check_fields(self)

    def maximize(
        self,
        acquisition: AcquisitionFunction,
        n_variables: int,
        rng: np.random.Generator,
        *,
        starts: ArrayLike | None = None,
        excluded: ArrayLike | None = None,
        tolerance: ArrayLike = 1e-6,
        seconds: float | None = None,
        domain: Domain | None = None,
    ) -> Maximum | None:
        """Look for the largest value of an acquisition function.

        Args:
            acquisition: Acquisition function.
            n_variables: Number of variables d, at least 1.
            rng: Random number generator; the same state gives the same result, unless a time budget
                cuts the search short.
            starts: Promising points `(k, d)`, such as the set-points of the Pareto front.
            excluded: Points that must not be proposed `(k, d)`, such as failed evaluations.
            tolerance: Largest difference to an excluded point that still counts as the same point,
                in any variable or, as `(k, d)`, in each variable for each point; variables span 2.
            seconds: Time budget [s], None for no limit. The first few points are evaluated in any
                case.
            domain: Points that may be proposed; None for all of the box.

        Returns:
            The best candidate, or None if the acquisition function was zero wherever it was
            evaluated. Then the candidate must come from elsewhere, for example from exploration.

        Raises:
            ValueError: If an argument does not fit.
        """
        seeds = _as_rows(starts, "starts", n_variables)
        if domain is None or domain.is_box:
            search = Search(acquisition, n_variables, excluded, tolerance, seconds)
            return search.run(lambda: self.explore(search, seeds, rng))
        within = DomainSearch(acquisition, domain, excluded, tolerance, seconds)
        if domain.size <= SMALL:
            return within.run(within.look_everywhere)

        def round_and_polish() -> None:
            self.explore(within, seeds, rng)
            within.polish()

        return within.run(round_and_polish)

    @abstractmethod
    def explore(self, search: Search, seeds: FloatArray, rng: np.random.Generator) -> None:
        """Evaluate points by `search`, which keeps the best; `seeds` `(k, d)` are promising ones."""


MAXIMIZERS = Registry[Maximizer]("maximizer", "mobo_tuner.maximizers", Maximizer)


@MAXIMIZERS.register("particle_swarm")
@dataclass(frozen=True)
class ParticleSwarm(Maximizer):
    """Generational particle swarm, as in `[Roussel2021]_`: 64 individuals, 10 generations.

    Velocities follow the canonical rule with constriction; every particle is drawn to its own best
    point and to the best of its neighbours on a ring. The coefficients are the defaults of the
    paper's tool `[Biscani2020]_`.
    """

    population: int = parameter(
        64,
        "Particles; set-points of the front take the places of at most half of them.",
        minimum=2,
        maximum=100_000,
    )
    generations: int = parameter(10, "Moves of the whole swarm.", minimum=0, maximum=100_000)
    constriction: float = parameter(0.7298, "Factor of the velocity.", minimum=0.0, maximum=1.0)
    attraction: float = parameter(
        2.05,
        "Weight of a particle's own best point and of its neighbours'.",
        minimum=0.0,
        maximum=10.0,
    )
    largest_step: float = parameter(
        0.5, "Largest step in any variable, as a share of its range.", minimum=1e-6, maximum=1.0
    )
    neighbours: int = parameter(
        4, "Neighbours on the ring, half of them to either side.", minimum=0, maximum=100_000
    )

    def explore(self, search: Search, seeds: FloatArray, rng: np.random.Generator) -> None:
        """Move the swarm for all generations."""
        shape = (self.population, search.n_variables)
        fastest = 2.0 * self.largest_step
        x = rng.uniform(-1.0, 1.0, shape)
        velocity = rng.uniform(-fastest, fastest, shape)
        if len(seeds):
            kept = rng.permutation(len(seeds))[: self.population // 2]
            x[: len(kept)] = np.clip(seeds[kept], -1.0, 1.0)
        own_best, own_value = x.copy(), search.values(x)
        reach = np.arange(-(self.neighbours // 2), self.neighbours // 2 + 1)
        ring = (np.arange(self.population)[:, None] + reach) % self.population
        for _ in range(self.generations):
            best_of_ring = own_best[ring[np.arange(len(ring)), own_value[ring].argmax(axis=1)]]
            to_own = self.attraction * rng.random(shape) * (own_best - x)
            to_ring = self.attraction * rng.random(shape) * (best_of_ring - x)
            velocity = self.constriction * (velocity + to_own + to_ring)
            velocity = np.clip(velocity, -fastest, fastest)
            moved = x + velocity
            x = np.clip(moved, -1.0, 1.0)
            velocity[x != moved] = 0.0
            value = search.values(x)
            better = value > own_value
            own_best[better], own_value[better] = x[better], value[better]


@MAXIMIZERS.register("multi_start")
@dataclass(frozen=True)
class MultiStart(Maximizer):
    """Gradient ascent from many starts that are far from each other.

    The best points by value alone all lie in one basin. Therefore the screened points are thinned
    out before a few common steps along the signs of their gradients, and thinned out again before
    the best ones climb to their maxima, on the logarithm of the acquisition function.
    """

    screened: int = parameter(
        512,
        "Quasi-random points over the whole box, rounded up to a power of two.",
        minimum=1,
        maximum=1_000_000,
    )
    overshoot: float = parameter(
        1.5,
        "Factor by which these reach beyond the box before they are moved to its edge; at 1.5 a "
        "third of the values are at a bound, where maxima often lie.",
        minimum=1.0,
        maximum=100.0,
    )
    screened_nearby: int = parameter(
        512, "Random points around the front's set-points.", minimum=1, maximum=1_000_000
    )
    nearby: float = parameter(
        0.15, "Standard deviation of these, where a variable spans 2.", minimum=0.0, maximum=2.0
    )
    far_starts: int = parameter(
        16, "Starts kept of the quasi-random points.", minimum=1, maximum=100_000
    )
    near_starts: int = parameter(
        32, "Starts kept of the points around the front's.", minimum=0, maximum=100_000
    )
    far_apart: float = parameter(
        0.5,
        "Least difference of the former in some variable, where a variable spans 2.",
        minimum=0.0,
        maximum=2.0,
    )
    near_apart: float = parameter(
        0.1,
        "Least difference of the latter in some variable, where a variable spans 2.",
        minimum=0.0,
        maximum=2.0,
    )
    steps: int = parameter(
        6,
        "Common steps of all starts along the signs of their gradients.",
        minimum=0,
        maximum=10_000,
    )
    finished: int = parameter(8, "Starts that climb on to a maximum.", minimum=1, maximum=10_000)
    behind: float = parameter(
        0.1,
        "Greatest lag of a start's logarithm behind the best one's to climb on.",
        minimum=0.0,
        maximum=1e6,
    )
    evaluations: int = parameter(
        30, "Most evaluations of each start that climbs on.", minimum=1, maximum=100_000
    )
    tolerance: float = parameter(
        1e-4, "Tolerance of the logarithm at a maximum.", minimum=1e-15, maximum=1.0
    )

    def explore(self, search: Search, seeds: FloatArray, rng: np.random.Generator) -> None:
        """Screen, step along signs, and climb."""
        d = search.n_variables
        x = np.empty((0, d))
        if len(seeds):
            origins = seeds[rng.integers(len(seeds), size=self.screened_nearby)]
            around = origins + self.nearby * rng.standard_normal(origins.shape)
            around = np.clip(around, -1.0, 1.0)
            x = _spread_out(around, search.values(around), self.near_starts, self.near_apart)[0]
        spread = sobol(d, 2 ** math.ceil(math.log2(self.screened)), rng)
        spread = np.clip(self.overshoot * (2.0 * spread - 1.0), -1.0, 1.0)
        far = _spread_out(spread, search.values(spread), self.far_starts, self.far_apart)[0]
        x = np.vstack([far, x])
        if len(x) == 0:
            return
        best, values = climb_by_signs(search.values_with_gradient, x, self.steps)
        best, values = _spread_out(best, values, self.finished, self.near_apart)
        best = best[values >= values.max(initial=-np.inf) - self.behind]
        if len(best):
            climb_by_curvature(search.values_with_gradient, best, self.evaluations, self.tolerance)


def make_maximizer(name: str, settings: Mapping[str, Any]) -> Maximizer:
    """Return the maximiser of a name with some of its settings.

    Raises:
        ParameterError: If the name or a setting is unknown, or a setting is not allowed.
    """
    kind = MAXIMIZERS.find(name)
    specs = {spec.name: spec for spec in specs_of(kind)}
    for setting in settings:
        if setting not in specs:
            raise ParameterError(unknown(setting, specs, f"maximizer_settings of '{name}'"))
    return kind(**{n: specs[n].check(v, "maximizer_settings.") for n, v in settings.items()})


class _OutOfTimeError(Exception):
    """The time budget is spent."""


class Search:
    """The evaluation of points by a `Maximizer`.

    It evaluates an acquisition function, watches the clock and keeps the best allowed candidate.
    """

    def __init__(
        self,
        acquisition: AcquisitionFunction,
        n_variables: int,
        excluded: ArrayLike | None,
        tolerance: ArrayLike,
        seconds: float | None,
    ) -> None:
        if n_variables < 1:
            raise ValueError(f"n_variables must be at least 1, not {n_variables}")
        if not (np.asarray(tolerance) >= 0.0).all():
            raise ValueError(f"tolerance must be at least 0, not {tolerance!r}")
        if seconds is not None and not seconds >= 0.0:
            raise ValueError(f"seconds must be at least 0 or None, not {seconds}")
        self.n_variables = n_variables
        self._acquisition = acquisition
        self._excluded = _as_rows(excluded, "excluded", n_variables)
        self._reach = np.broadcast_to(np.asarray(tolerance), self._excluded.shape)
        self._deadline = math.inf if seconds is None else time.monotonic() + seconds
        self._started = False
        self._best: FloatArray | None = None
        self._best_value = -math.inf

    def run(self, method: Callable[[], None]) -> Maximum | None:
        """Run `method` to its end or to the deadline, and return the best candidate."""
        complete = True
        try:
            method()
        except _OutOfTimeError:
            complete = False
        if self._best is None:
            return None
        return Maximum(self._best, self._best_value, complete)

    def values(self, x: FloatArray) -> FloatArray:
        """Return the values `(m,)`, minus infinity at excluded points."""
        values = [np.empty(0)]
        for i in range(0, len(x), _CHUNK):
            self._check_time()
            chunk = x[i : i + _CHUNK]
            values.append(self._allow(chunk, self._acquisition.log_value(chunk)))
        return np.concatenate(values)

    def values_with_gradient(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the values `(m,)` as `values` does, and their gradients `(m, d)`."""
        self._check_time()
        value, gradient = self._acquisition.log_value_with_gradient(x)
        return self._allow(x, value), gradient

    def _check_time(self) -> None:
        if self._started and time.monotonic() > self._deadline:
            raise _OutOfTimeError
        self._started = True

    def _allow(self, x: FloatArray, value: FloatArray) -> FloatArray:
        """Rule out excluded points and values that are not numbers, and note the best."""
        allowed = np.where(np.isnan(value), -np.inf, value)
        for point, reach in zip(self._excluded, self._reach, strict=True):
            allowed[(np.abs(x - point) <= reach).all(axis=1)] = -np.inf
        i = int(allowed.argmax())
        if allowed[i] > self._best_value:
            self._best, self._best_value = x[i].copy(), float(allowed[i])
        return allowed


class DomainSearch(Search):
    """A search whose candidates are on the grids and within the limits of a domain.

    Values are those of the nearest allowed points, the only ones that are kept. Gradients lead through
    the points in between, so that a grid has a slope; where they lead is rounded and polished.
    """

    def __init__(
        self,
        acquisition: AcquisitionFunction,
        domain: Domain,
        excluded: ArrayLike | None,
        tolerance: ArrayLike,
        seconds: float | None,
    ) -> None:
        super().__init__(acquisition, len(domain.values), excluded, tolerance, seconds)
        self._domain = domain
        self._between = np.empty((0, self.n_variables))
        self._between_values = np.empty(0)

    def values(self, x: FloatArray) -> FloatArray:
        """Return the values `(m,)` at the nearest allowed points, minus infinity at excluded ones."""
        return super().values(self._domain.nearest(x))

    def values_with_gradient(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the values `(m,)` and gradients `(m, d)` within the limits, whatever the grids."""
        self._check_time()
        x = self._domain.project(x)
        value, gradient = self._acquisition.log_value_with_gradient(x)
        value = np.where(np.isnan(value), -np.inf, value)
        points = np.vstack([self._between, x])
        values = np.concatenate([self._between_values, value])
        best = np.argsort(-values, kind="stable")[:_KEPT]
        self._between, self._between_values = points[best], values[best]
        return value, gradient

    def look_everywhere(self) -> None:
        """Evaluate every point of a finite domain."""
        self.values(self._domain.points())

    def polish(self) -> None:
        """Round the best points in between, and move the best allowed ones to better neighbours."""
        self.values(self._between)
        for _ in range(_POLISHES):
            if self._best is None:
                return
            before = self._best_value
            self.values(self._domain.neighbours(self._best))
            if self._best_value <= before:
                return


def _spread_out(
    x: FloatArray, values: FloatArray, count: int, apart: float
) -> tuple[FloatArray, FloatArray]:
    """Choose at most `count` rows, best value first, that differ by `apart` in some component."""
    chosen: list[int] = []
    for i in np.argsort(-values, kind="stable"):
        if len(chosen) == count or np.isneginf(values[i]):
            break
        if (np.abs(x[chosen] - x[i]).max(axis=1, initial=0.0) > apart).all():
            chosen.append(int(i))
    return x[chosen], values[chosen]


def _as_rows(values: ArrayLike | None, name: str, n_variables: int) -> FloatArray:
    if values is None or np.size(values) == 0:
        return np.empty((0, n_variables))
    rows = np.array(values, dtype=np.float64)
    if rows.ndim != 2 or rows.shape[1] != n_variables:
        raise ValueError(f"{name} must have shape (k, {n_variables}), not {rows.shape}")
    if not np.isfinite(rows).all():
        raise ValueError(f"{name} must be finite")
    return rows

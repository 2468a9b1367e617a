"""The trained surrogate: nine outputs at the screen as a function of eight inputs."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from awa_sim_node.surrogate.ensemble import Ensemble
from awa_sim_node.surrogate.metadata import (
    DEFAULT_CHARGE,
    DEFAULT_COUPLER_KICK,
    INPUTS,
    OUTPUTS,
)

WEIGHTS_FILE: Final = "weights.npz"

_NAMES: Final = tuple(quantity.name for quantity in INPUTS)


class Surrogate:
    """The AWA-like injector as a function: the mean over an ensemble of networks.

    Inputs outside the training range are refused.

    Example:
        >>> surrogate = Surrogate.load()
        >>> point = {"K1": 475.0, "K2": 230.0, "phi1": -5.0, "phi2": -5.0, "G1": 67.5, "G2": 20.0}
        >>> beam = surrogate.predict(point)
        >>> print(f"{beam['sigma_x']:.1f} mm, {beam['energy']:.1f} MeV")
        12.3 mm, 15.1 MeV
        >>> surrogate.predict(point | {"G1": [62.0, 67.5, 73.0]})["energy"].round(1)
        array([14.5, 15.1, 15.7])
    """

    defaults: Final[Mapping[str, float]] = {
        "charge": DEFAULT_CHARGE,
        "coupler_kick": DEFAULT_COUPLER_KICK,
    }
    """Defaults of the optional inputs."""

    def __init__(self, weights: Mapping[str, NDArray[Any]]) -> None:
        """Wrap a trained network.

        Args:
            weights: Weights of the network by name, as in ``weights.npz``.
        """
        self._ensemble = Ensemble(weights)
        self._low, self._high = np.array([quantity.training_range for quantity in INPUTS]).T

    @classmethod
    def load(cls, folder: Path = Path(__file__).parent) -> Surrogate:
        """Load a trained surrogate.

        Args:
            folder: Folder with ``weights.npz``; by default that of the project's own surrogate.
        """
        with np.load(folder / WEIGHTS_FILE, allow_pickle=False) as file:
            return cls({name: file[name] for name in file.files})

    def predict(self, inputs: Mapping[str, ArrayLike]) -> dict[str, Any]:
        """Predict the beam at the screen.

        Args:
            inputs: Floats, or arrays of equal length, in physical units (A, deg, MV/m, nC, mT);
                ``charge`` and ``coupler_kick`` are optional.

        Returns:
            ``sigma_x``, ``sigma_y``, ``sigma_z`` [mm], ``eps_x``, ``eps_y``, ``eps_z`` [mm mrad],
            ``dE``, ``energy`` [MeV] and ``transmission`` [1]: floats, or arrays if an input is one.

        Raises:
            ValueError: If an input is missing, unknown, not finite or outside its training range.
        """
        points, scalar = self._points(inputs)
        return _by_name(self.predict_array(points), scalar)

    def spread(self, inputs: Mapping[str, ArrayLike]) -> dict[str, Any]:
        """Return the standard deviation between the members of the ensemble.

        It is an estimate of the model's uncertainty.

        Args:
            inputs: Same as for ``predict``.

        Returns:
            The standard deviation of each output, in its unit: floats, or arrays if an input is
            one.

        Raises:
            ValueError: In the same cases as ``predict``.
        """
        points, scalar = self._points(inputs)
        return _by_name(self._members(points).std(axis=0, ddof=1), scalar)

    def predict_with_spread(
        self, inputs: Mapping[str, ArrayLike]
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Return the results of ``predict`` and ``spread`` from one evaluation of the network."""
        points, scalar = self._points(inputs)
        members = self._members(points)
        return _by_name(_average(members), scalar), _by_name(members.std(axis=0, ddof=1), scalar)

    def predict_array(self, inputs: NDArray[np.float64]) -> NDArray[np.float64]:
        """Predict the beam at the screen for n points at once.

        Args:
            inputs: Values of all eight inputs, in the order of ``metadata.INPUTS``, ``(n, 8)``.

        Returns:
            The nine outputs, in the order of ``metadata.OUTPUTS``, ``(n, 9)``.

        Raises:
            ValueError: If the shape is wrong, or a value not finite or outside its training range.
        """
        return _average(self._members(inputs))

    def _points(self, inputs: Mapping[str, ArrayLike]) -> tuple[NDArray[np.float64], bool]:
        """Return the inputs as an array ``(n, 8)``, and whether all of them are scalars."""
        unknown = sorted(set(inputs) - set(_NAMES))
        if unknown:
            raise ValueError(f"input {unknown[0]!r} must be one of {', '.join(_NAMES)}")
        given = {**self.defaults, **inputs}
        missing = [name for name in _NAMES if name not in given]
        if missing:
            raise ValueError(f"input {missing[0]!r} must be given")
        columns = [np.asarray(given[name], dtype=np.float64) for name in _NAMES]
        lengths = sorted({column.size for column in columns if column.ndim > 0})
        if any(column.ndim > 1 for column in columns) or len(lengths) > 1:
            raise ValueError("inputs must be numbers or one-dimensional arrays of equal length")
        points = np.stack(np.broadcast_arrays(*columns), axis=-1).reshape(-1, len(_NAMES))
        return points, not lengths

    def _members(self, inputs: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the outputs of each member, ``(M, n, 9)``."""
        inputs = np.asarray(inputs, dtype=np.float64)
        if inputs.ndim != 2 or inputs.shape[1] != len(INPUTS):
            raise ValueError(
                f"inputs of shape {inputs.shape} must have the shape (n, {len(INPUTS)})"
            )
        self._refuse_extrapolation(inputs)
        return self._ensemble.outputs(inputs)

    def _refuse_extrapolation(self, inputs: NDArray[np.float64]) -> None:
        outside = ~((inputs >= self._low) & (inputs <= self._high))
        if not outside.any():
            return
        row, column = np.argwhere(outside)[0]
        quantity = INPUTS[column]
        raise ValueError(
            f"{quantity.name} = {inputs[row, column]:g} {quantity.unit} is outside the training "
            f"range of the surrogate, {self._low[column]:g} to {self._high[column]:g} "
            f"{quantity.unit}"
        )


@cache
def _own() -> Surrogate:
    return Surrogate.load()


def predict(inputs: Mapping[str, ArrayLike]) -> dict[str, Any]:
    """Predict the beam by the project's own surrogate, see `Surrogate.predict`; a prior model of a run."""
    return _own().predict(inputs)


def _average(members: NDArray[np.float64]) -> NDArray[np.float64]:
    """Average the members of an ensemble.

    Args:
        members: Outputs of each member, ``(M, n, 9)``.

    Returns:
        The geometric mean of the first eight outputs and the mean of the transmission, ``(n, 9)``.
    """
    mean = np.exp(np.log(members).mean(axis=0))
    mean[:, 8] = members[:, :, 8].mean(axis=0)
    return np.asarray(mean, dtype=np.float64)


def _by_name(outputs: NDArray[np.float64], scalar: bool) -> dict[str, Any]:
    """Return the columns of ``(n, 9)`` by name, as floats if ``scalar``."""
    if scalar:
        return {o.name: float(outputs[0, j]) for j, o in enumerate(OUTPUTS)}
    return {o.name: outputs[:, j].copy() for j, o in enumerate(OUTPUTS)}

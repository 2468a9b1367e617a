"""The trained network as numpy evaluates it: the beam at the screen, for every member of the ensemble.

`network.EnsembleNetwork` is the same function for the training, with torch, and explains it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

WIDTH_FLOOR: Final = math.exp(-1.5)
"""Initial ratio of the narrowest waist to the typical width."""

SIZE_POWER: Final = 4.0
"""Exponent of the mean of the two widths that determines the losses: nearly the maximum."""

LINAC_ENERGY: Final = 0.402
"""Energy per gradient of the linac on crest [MeV / (MV/m)]."""

GUN_ENERGY: Final = 0.1055
"""Energy per gradient of the gun [MeV / (MV/m)]."""

REST_ENERGY: Final = 0.05
"""Energy that the estimate of linac plus gun is too large by [MeV]."""

_PERCEPTRONS: Final = ("widths", "emittances", "lengths")
_SCREEN_OUTPUTS: Final = (2, 1, 4)  # outputs of each perceptron that the beam at the screen needs
_BLOCK: Final = 512  # points that are evaluated at once: their hidden layers fit the caches
_SOFTPLUS_LIMIT: Final = 20.0  # beyond it torch's softplus is linear


class Ensemble:
    """M networks of one shape, evaluated at once in double precision.

    The three perceptrons of each network have hidden layers of one shape, so that 3 M of them are
    evaluated by one product for each layer.
    """

    def __init__(self, weights: Mapping[str, NDArray[Any]]) -> None:
        """Arrange the weights.

        Args:
            weights: Weights by the names that they have in `network.EnsembleNetwork`.
        """
        state = {name: np.asarray(value, dtype=np.float64) for name, value in weights.items()}
        layers = sum(name.startswith("widths.weights.") for name in state)

        def stacked(kind: str, layer: int) -> NDArray[np.float64]:
            return np.concatenate([state[f"{name}.{kind}.{layer}"] for name in _PERCEPTRONS])

        self._hidden = [
            (stacked("weights", layer), stacked("biases", layer)) for layer in range(layers - 1)
        ]
        self._last = _screen([state[f"{name}.weights.{layers - 1}"] for name in _PERCEPTRONS])
        self._bias = _screen([state[f"{name}.biases.{layers - 1}"] for name in _PERCEPTRONS])
        self._linear = _screen([state[f"{name}.linear"] for name in _PERCEPTRONS])
        self._threshold = state["loss_threshold"]
        self._softness = np.exp(state["loss_log_softness"])
        self._slope = np.exp(state["loss_log_slope"])
        # Derivatives of the first eight logs by the log of the transmission; the energy has none.
        exponents = state["loss_exponents"][:, [0, 0, 1, 2, 2, 3, 4]]
        self._exponents = np.pad(exponents, ((0, 0), (0, 1)))[:, None, :]
        self._centre, self._half_width = state["centre"], state["half_width"]
        self._mean, self._scale = state["log_mean"][0], state["log_scale"][0]

    def outputs(self, inputs: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the nine outputs of each member, ``(M, n, 9)``.

        Args:
            inputs: Eight inputs in their units, ``(n, 8)``.
        """
        starts = range(0, max(len(inputs), 1), _BLOCK)
        blocks = [self._outputs(inputs[start : start + _BLOCK]) for start in starts]
        return blocks[0] if len(blocks) == 1 else np.concatenate(blocks, axis=1)

    def _outputs(self, inputs: NDArray[np.float64]) -> NDArray[np.float64]:
        n = len(inputs)
        turned = inputs.copy()
        turned[:, -1] *= -1.0  # the rotated beam has the opposite kick
        values = self._perceptrons(self._features(np.concatenate([inputs, turned])))
        widths, emittances, lengths = np.split(values, len(_PERCEPTRONS))
        logs = np.empty((len(widths), n, 9))
        # The two halves of the rows are the two transverse planes.
        log_widths = self._mean[0] + _log_width(widths[..., 0], widths[..., 1])
        logs[..., 0], logs[..., 1] = log_widths[:, :n], log_widths[:, n:]
        log_emittances = self._mean[3] + self._scale[3] * emittances[..., 0]
        logs[..., 3], logs[..., 4] = log_emittances[:, :n], log_emittances[:, n:]
        columns = [2, 5, 6, 7]
        even = 0.5 * (lengths[:, :n] + lengths[:, n:])
        logs[..., columns] = even * self._scale[columns] + self._mean[columns]
        linac = LINAC_ENERGY * inputs[:, 5] * np.cos(np.deg2rad(inputs[:, 3]))
        logs[..., 7] += np.log(linac + GUN_ENERGY * inputs[:, 4] - REST_ENERGY)
        log_transmission = self._log_transmission(logs[..., 0], logs[..., 1])
        logs[..., :8] += self._exponents * log_transmission[..., None]
        logs[..., 8] = log_transmission
        return np.exp(logs, out=logs)

    def _perceptrons(self, features: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return ``(3 M, n, 4)`` for the features ``(n, 12)``."""
        values = features[None]
        for weight, bias in self._hidden:
            values = values @ weight
            values += bias
            np.tanh(values, out=values)
        return values @ self._last + self._bias + features @ self._linear

    def _features(self, inputs: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the scaled inputs and four ratios to the gun gradient, ``(n, 12)``."""
        centre, half_width = self._centre, self._half_width
        features = np.empty((len(inputs), 12))
        np.divide(inputs - centre, half_width, out=features[:, :8])
        gun = inputs[:, 4] / centre[4]
        features[:, 8] = 2.0 * ((inputs[:, 1] / centre[1] / gun) ** 2 - 1.0)
        features[:, 9] = 2.0 * ((inputs[:, 0] / centre[0] / gun) ** 2 - 1.0)
        features[:, 10] = 2.0 * (inputs[:, 6] / centre[6] / gun - 1.0)
        features[:, 11] = inputs[:, 7] / half_width[7] / gun
        return features

    def _log_transmission(
        self, log_width: NDArray[np.float64], log_height: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return the log of the transmission, ``(M, n)``, from the logs of widths and heights."""
        summed = np.logaddexp(SIZE_POWER * log_width, SIZE_POWER * log_height) - math.log(2.0)
        excess = (2.0 / SIZE_POWER * summed - self._threshold) / self._softness
        excess = np.where(excess > _SOFTPLUS_LIMIT, excess, np.logaddexp(0.0, excess))
        return np.asarray(-self._slope * self._softness * excess)


def _screen(parts: list[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Stack the outputs of the perceptrons that the screen needs, padded to equal numbers."""
    most = max(_SCREEN_OUTPUTS)
    return np.concatenate(
        [
            np.pad(part[..., :count], ((0, 0), (0, 0), (0, most - count)))
            for part, count in zip(parts, _SCREEN_OUTPUTS, strict=True)
        ]
    )


def _log_width(focus: NDArray[np.float64], log_floor: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return 0.5 log((1 + focus)^2 + floor^2)."""
    floor = WIDTH_FLOOR * np.exp(log_floor)
    return np.asarray(0.5 * np.log((1.0 + focus) ** 2 + floor**2))

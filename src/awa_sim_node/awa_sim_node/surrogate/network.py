"""The network as torch trains it: three perceptrons with known physics built in.

* The machine is symmetric about its axis except for the quadrupole kick k of the linac coupler, and
  a rotation of the beam by 90 degrees changes the sign of k. So one function f gives both transverse
  planes, sigma_x = f(k) and sigma_y = f(-k), and all longitudinal quantities are even in k.
* The strength of a lens is proportional to the square of its field over the momentum, so such
  ratios are inputs in addition to the settings.
* Near a waist, sigma^2 is the square of a quantity that passes through zero, plus a small rest. The
  network predicts these two, which are smooth, instead of sigma, which has a kink.
* The mean energy is nearly the sum of the contributions of gun and linac; only the rest is learnt.
* Beam is lost where it is wider than the aperture. The network predicts the width that the beam
  would have without an aperture; eight parameters shared by all rows convert it to the transmission
  and its effect on the other outputs.
* Widths, emittances and lengths have one perceptron each. All of them also learn the beam half-way
  to the screen, and that of the emittances also learns the widths: these auxiliary targets only
  serve to improve the inner representation.

`ensemble.Ensemble` evaluates the trained network at the screen, without torch.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from awa_sim_node.surrogate.ensemble import (
    GUN_ENERGY,
    LINAC_ENERGY,
    REST_ENERGY,
    SIZE_POWER,
    WIDTH_FLOOR,
)
from awa_sim_node.surrogate.metadata import INPUTS

_PLANES: Final = 2
_LOGS: Final = 8  # sigma_x, sigma_y, sigma_z, eps_x, eps_y, eps_z, dE, energy
_FEATURES: Final = 12
_DEPTH: Final = 4  # hidden layers

_INITIAL_LIMIT: Final = 23.5  # initial value of the rms width at which losses start [mm]


class Beam(NamedTuple):
    """Prediction of the network for n beams by each of M members.

    The logarithms are those of the first eight outputs, at the screen and half-way to it.

    Attributes:
        logs: Natural logarithms of the outputs, ``(M, n, 2, 8)``.
        hints: Natural logarithms of the widths as predicted by the perceptron of the emittances,
            used in training only, ``(M, n, 2, 2)``.
        log_transmission: Natural logarithm of the transmission to the screen, ``(M, n)``.
    """

    logs: Tensor
    hints: Tensor
    log_transmission: Tensor


class Perceptrons(nn.Module):
    """M perceptrons of one shape, with a linear path parallel to the hidden layers."""

    def __init__(self, members: int, hidden: int, outputs: int, generator: torch.Generator) -> None:
        """Create perceptrons with random weights.

        Args:
            members: Number of perceptrons, M.
            hidden: Number of units in each hidden layer.
            outputs: Number of outputs.
            generator: Random number generator of the weights.
        """
        super().__init__()
        sizes = (_FEATURES, *[hidden] * _DEPTH, outputs)
        self.weights = nn.ParameterList(
            torch.randn(members, inner, outer, generator=generator) / math.sqrt(inner)
            for inner, outer in pairwise(sizes)
        )
        self.biases = nn.ParameterList(
            0.3 * torch.randn(members, 1, outer, generator=generator) for outer in sizes[1:-1]
        )
        self.biases.append(torch.zeros(members, 1, outputs))
        self.linear = nn.Parameter(torch.zeros(members, _FEATURES, outputs))

    def forward(self, features: Tensor) -> Tensor:
        """Return ``(M, n, outputs)`` for the features ``(n, 12)``."""
        features = features.expand(len(self.linear), -1, -1)
        values = features
        *hidden, (last, bias) = zip(self.weights, self.biases, strict=True)
        for weight, shift in hidden:
            values = torch.tanh(torch.baddbmm(shift, values, weight))
        return torch.baddbmm(bias, values, last) + torch.bmm(features, self.linear)


class EnsembleNetwork(nn.Module):
    """M networks of one shape, evaluated at once."""

    def __init__(self, members: int, hidden: int, seed: int = 0) -> None:
        """Create a network with random weights.

        Args:
            members: Number of networks, M.
            hidden: Number of units in each hidden layer.
            seed: Seed of the random weights.
        """
        super().__init__()
        generator = torch.Generator().manual_seed(seed)
        self.widths = Perceptrons(members, hidden, 2 * _PLANES, generator)
        self.emittances = Perceptrons(members, hidden, 2 * _PLANES, generator)
        self.lengths = Perceptrons(members, hidden, 4 * _PLANES, generator)
        self.loss_threshold = nn.Parameter(torch.full((members, 1), 2.0 * math.log(_INITIAL_LIMIT)))
        self.loss_log_softness = nn.Parameter(torch.full((members, 1), -3.0))
        self.loss_log_slope = nn.Parameter(torch.zeros(members, 1))
        # Derivatives of the logs of sigma, sigma_z, eps, eps_z and dE by the log of the transmission.
        exponents = torch.zeros(members, 5)
        exponents[:, 0] = 0.5
        self.loss_exponents = nn.Parameter(exponents)
        bounds = torch.tensor([quantity.training_range for quantity in INPUTS])
        bounds[-1, 0] = -bounds[-1, 1]  # the rotated beam has the opposite kick
        self.register_buffer("centre", bounds.mean(dim=1))
        self.register_buffer("half_width", 0.5 * (bounds[:, 1] - bounds[:, 0]))
        self.register_buffer("log_mean", torch.zeros(_PLANES, _LOGS))
        self.register_buffer("log_scale", torch.ones(_PLANES, _LOGS))
        self.centre: Tensor
        self.half_width: Tensor
        self.log_mean: Tensor
        self.log_scale: Tensor

    def groups(self) -> tuple[list[nn.Parameter], list[nn.Parameter]]:
        """Return the parameters of the layers, and those of the beam loss."""
        parameters = dict(self.named_parameters())
        losses = [name for name in parameters if name.startswith("loss_")]
        return (
            [parameters[name] for name in parameters if name not in losses],
            [parameters[name] for name in losses],
        )

    def matrices(self) -> list[nn.Parameter]:
        """Return the matrices of all hidden and output layers."""
        return [*self.widths.weights, *self.emittances.weights, *self.lengths.weights]

    def arrays(self) -> dict[str, NDArray[np.float64]]:
        """Return all weights by name, as `ensemble.Ensemble` takes them."""
        return {name: value.detach().numpy() for name, value in self.state_dict().items()}

    def standardise(self, inputs: NDArray[np.float64], logs: NDArray[np.float64]) -> None:
        """Set mean and scale of the outputs from the training data.

        Args:
            inputs: Eight inputs in their units, ``(n, 8)``.
            logs: Logarithms of the first eight outputs at both planes, ``(n, 2, 8)``.
        """
        logs = logs.copy()
        logs[:, :, 7] -= _log_energy(torch.as_tensor(inputs)).numpy()[:, None]
        mean, scale = logs.mean(axis=0), logs.std(axis=0)
        # One function gives both transverse planes, so they share mean and scale.
        mean[:, [1, 4]], scale[:, [1, 4]] = mean[:, [0, 3]], scale[:, [0, 3]]
        self.log_mean.copy_(torch.as_tensor(mean))
        self.log_scale.copy_(torch.as_tensor(scale))

    def forward(self, inputs: Tensor) -> Beam:
        """Evaluate all members for the eight inputs in their units, ``(n, 8)``."""
        turned = torch.cat([inputs[:, :-1], -inputs[:, -1:]], dim=1)
        features = torch.cat([self._features(inputs), self._features(turned)])
        widths = self._transverse(_log_width(_planes(self.widths(features))), 0, 1.0)
        emittances = _planes(self.emittances(features))
        own = self._transverse(emittances[..., 0], 3, self.log_scale[:, 3])
        hints = self._transverse(emittances[..., 1], 0, self.log_scale[:, 0])
        one, other = _planes(self.lengths(features)).chunk(2, dim=1)
        lengths = 0.5 * (one + other) * self.log_scale[:, [2, 5, 6, 7]]
        lengths = lengths + self.log_mean[:, [2, 5, 6, 7]]
        energy = lengths[..., 3:] + _log_energy(inputs)[:, None, None]
        columns = [widths, lengths[..., :1], own, lengths[..., 1:3], energy]
        logs = torch.cat(columns, dim=-1)
        log_transmission = self._log_transmission(logs[:, :, 0, :2])
        changes = self._changes()[:, None, :] * log_transmission[..., None]
        logs = torch.stack([logs[:, :, 0] + changes, logs[:, :, 1]], dim=2)
        return Beam(logs, hints, log_transmission)

    def _features(self, inputs: Tensor) -> Tensor:
        """Return the scaled inputs and four ratios to the gun gradient, ``(n, 12)``."""
        gun = inputs[:, 4] / self.centre[4]
        ratios = [
            2.0 * ((inputs[:, 1] / self.centre[1] / gun) ** 2 - 1.0),
            2.0 * ((inputs[:, 0] / self.centre[0] / gun) ** 2 - 1.0),
            2.0 * (inputs[:, 6] / self.centre[6] / gun - 1.0),
            inputs[:, 7] / self.half_width[7] / gun,
        ]
        scaled = (inputs - self.centre) / self.half_width
        return torch.cat([scaled, torch.stack(ratios, dim=1)], dim=1)

    def _transverse(self, values: Tensor, column: int, scale: Tensor | float) -> Tensor:
        """Return the logs of one transverse quantity, with x and y on the last axis.

        Args:
            values: Scaled logs for k and -k, ``(M, 2 n, 2)``.
            column: Column of the quantity in ``log_mean``.
            scale: Scale of the logs at both planes.

        Returns:
            The logs, ``(M, n, 2, 2)``.
        """
        logs = self.log_mean[:, column] + scale * values
        return torch.stack(logs.chunk(2, dim=1), dim=-1)

    def _changes(self) -> Tensor:
        """Return the derivative of each log by the log of the transmission, ``(M, 8)``."""
        exponents = self.loss_exponents
        unchanged = torch.zeros_like(exponents[:, :1])  # the mean energy
        return torch.cat([exponents[:, [0, 0, 1, 2, 2, 3, 4]], unchanged], dim=1)

    def _log_transmission(self, log_widths: Tensor) -> Tensor:
        """Return the log of the transmission, ``(M, n)``.

        It is 0 for small beams, and decreases linearly with the logarithm of the beam's area beyond
        the threshold.

        Args:
            log_widths: Logs of the widths without losses, ``(M, n, 2)``.
        """
        summed = torch.logsumexp(SIZE_POWER * log_widths, dim=-1) - math.log(2.0)
        log_area = 2.0 / SIZE_POWER * summed
        softness = torch.exp(self.loss_log_softness)
        excess = softness * nn.functional.softplus((log_area - self.loss_threshold) / softness)
        return -torch.exp(self.loss_log_slope) * excess


def _planes(values: Tensor) -> Tensor:
    """Split the last axis into the two planes along the beam: ``(M, n, 2, q)``."""
    return values.reshape(*values.shape[:2], _PLANES, -1)


def _log_width(values: Tensor) -> Tensor:
    """Return 0.5 log((1 + focus)^2 + floor^2); the last axis of ``values`` gives both."""
    focus, floor = values[..., 0], WIDTH_FLOOR * torch.exp(values[..., 1])
    return 0.5 * torch.log((1.0 + focus) ** 2 + floor**2)


def _log_energy(inputs: Tensor) -> Tensor:
    """Return the log of an estimate of the energy, linac plus gun, ``(n,)``."""
    linac = LINAC_ENERGY * inputs[:, 5] * torch.cos(torch.deg2rad(inputs[:, 3]))
    return torch.log(linac + GUN_ENERGY * inputs[:, 4] - REST_ENERGY)

"""The network: several small perceptrons side by side, with what is known of the physics built in.

* The machine is symmetric about its axis but for the quadrupole kick k of the linac coupler, and turning the beam
  by 90 degrees changes the sign of k. So one function f gives both planes, sigma_x = f(k) and sigma_y = f(-k), and
  everything longitudinal is even in k.
* Near a waist, sigma^2 is the square of something that passes through zero, plus a small rest. The network gives
  these two, which are smooth, and not sigma, which has a kink.
* Beam is lost where it outgrows the aperture. The network gives the width the beam would have without an
  aperture; six parameters shared by all rows turn that into the transmission and into the effect on the rest.
* A coarse mesh shifts the results a little and smoothly: the kind of mesh is an input.
* The beam half-way to the screen is learnt as well, only because it helps to find the right inner representation.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from awa_sim_node.surrogate.metadata import INPUTS

_PLANES: Final = 2
_RAW: Final = 7  # focus, floor, eps, sigma_z, eps_z, dE, energy
_LOGS: Final = 8  # sigma_x, sigma_y, sigma_z, eps_x, eps_y, eps_z, dE, energy
_KICK: Final = 7  # column of the coupler kick

_FLOOR_OFFSET: Final = -1.5  # waists start out narrow against the usual beam
_SIZE_POWER: Final = (
    4.0  # of the mean of the two widths that decides about losses: nearly their maximum
)
_INITIAL_LIMIT: Final = 23.5  # rms width at which losses start [mm]


class Beam(NamedTuple):
    """What the network says of n beams, for each of M members.

    Attributes:
        logs: Natural logarithms of the first eight outputs at the screen and half-way to it, ``(M, n, 2, 8)``.
        log_transmission: Natural logarithm of the transmission to the screen, at most 0, ``(M, n)``.
    """

    logs: Tensor
    log_transmission: Tensor


class EnsembleNetwork(nn.Module):
    """M networks of one shape, evaluated at once."""

    def __init__(self, members: int, hidden: int, seed: int = 0) -> None:
        """Create a network with random weights.

        Args:
            members: Number of networks.
            hidden: Units in each of the two hidden layers.
            seed: Seed of the random weights.
        """
        super().__init__()
        generator = torch.Generator().manual_seed(seed)
        sizes = (len(INPUTS) + 1, hidden, hidden, _PLANES * _RAW)
        self.weights = nn.ParameterList(
            torch.randn(members, inner, outer, generator=generator) / math.sqrt(inner)
            for inner, outer in pairwise(sizes)
        )
        self.biases = nn.ParameterList(
            0.3 * torch.randn(members, 1, outer, generator=generator) for outer in sizes[1:]
        )
        self.loss_threshold = nn.Parameter(torch.full((members, 1), 2.0 * math.log(_INITIAL_LIMIT)))
        self.loss_log_softness = nn.Parameter(torch.full((members, 1), -3.0))
        self.loss_log_slope = nn.Parameter(torch.zeros(members, 1))
        # How sigma, sigma_z, eps, eps_z and dE change with the logarithm of the transmission.
        exponents = torch.zeros(members, 5)
        exponents[:, 0] = 0.5
        self.loss_exponents = nn.Parameter(exponents)
        bounds = torch.tensor([quantity.training_range for quantity in INPUTS])
        bounds[_KICK, 0] = -bounds[_KICK, 1]
        self.register_buffer("centre", bounds.mean(dim=1))
        self.register_buffer("half_width", 0.5 * (bounds[:, 1] - bounds[:, 0]))
        self.register_buffer("log_mean", torch.zeros(_PLANES, _LOGS))
        self.register_buffer("log_scale", torch.ones(_PLANES, _LOGS))
        self.centre: Tensor
        self.half_width: Tensor
        self.log_mean: Tensor
        self.log_scale: Tensor

    def standardise(self, logs: NDArray[np.float64]) -> None:
        """Take mean and scale of the outputs from ``logs``, ``(n, 2, 8)``."""
        mean, scale = logs.mean(axis=0), logs.std(axis=0)
        # The two transverse planes are one function, so they share theirs.
        mean[:, [1, 4]], scale[:, [1, 4]] = mean[:, [0, 3]], scale[:, [0, 3]]
        self.log_mean.copy_(torch.as_tensor(mean))
        self.log_scale.copy_(torch.as_tensor(scale))

    def forward(self, inputs: Tensor, fine: Tensor) -> Beam:
        """Evaluate all members.

        Args:
            inputs: The eight inputs in their units, ``(n, 8)``.
            fine: 1 for the fine mesh, -1 for the coarse one, ``(n,)``.
        """
        count = len(inputs)
        scaled = (inputs - self.centre) / self.half_width
        turned = torch.cat([scaled[:, :_KICK], -scaled[:, _KICK:]], dim=1)
        features = torch.cat([torch.cat([scaled, turned]), torch.cat([fine, fine])[:, None]], dim=1)
        raw = self._perceptrons(features)
        raw = raw.reshape(*raw.shape[:2], _PLANES, _RAW)
        logs = self._logs(raw[:, :count], raw[:, count:])
        log_transmission = self._log_transmission(logs[:, :, 0, :2])
        exponents = self.loss_exponents[:, None, :]
        changes = torch.cat(
            [
                exponents[..., [0, 0, 1, 2, 2, 3, 4]],
                torch.zeros_like(exponents[..., :1]),  # the mean energy stays
            ],
            dim=-1,
        )
        at_screen = logs[:, :, 0] + changes * log_transmission[..., None]
        return Beam(torch.stack([at_screen, logs[:, :, 1]], dim=2), log_transmission)

    def _perceptrons(self, features: Tensor) -> Tensor:
        """Return ``(M, n, 14)`` raw outputs for the features ``(n, 9)``."""
        values = features.expand(len(self.loss_threshold), -1, -1)
        *hidden, last = zip(self.weights, self.biases, strict=True)
        for weight, bias in hidden:
            values = torch.tanh(torch.baddbmm(bias, values, weight))
        return torch.baddbmm(last[1], values, last[0])

    def _logs(self, raw: Tensor, turned: Tensor) -> Tensor:
        """Return the logarithms ``(M, n, 2, 8)`` before losses from the raw outputs at k and at -k."""
        mean, scale = self.log_mean, self.log_scale
        even = 0.5 * (raw[..., 3:] + turned[..., 3:])
        columns = [
            mean[:, 0] + _log_width(raw),
            mean[:, 1] + _log_width(turned),
            mean[:, 2] + scale[:, 2] * even[..., 0],
            mean[:, 3] + scale[:, 3] * raw[..., 2],
            mean[:, 4] + scale[:, 4] * turned[..., 2],
            mean[:, 5] + scale[:, 5] * even[..., 1],
            mean[:, 6] + scale[:, 6] * even[..., 2],
            mean[:, 7] + scale[:, 7] * even[..., 3],
        ]
        return torch.stack(columns, dim=-1)

    def _log_transmission(self, log_widths: Tensor) -> Tensor:
        """Return the log of the transmission, ``(M, n)``, for the log widths without losses, ``(M, n, 2)``.

        It is 0 for small beams, and falls in proportion to the logarithm of the beam's area for those beyond
        the threshold.
        """
        summed = torch.logsumexp(_SIZE_POWER * log_widths, dim=-1) - math.log(2.0)
        log_area = 2.0 / _SIZE_POWER * summed
        softness = torch.exp(self.loss_log_softness)
        excess = softness * nn.functional.softplus((log_area - self.loss_threshold) / softness)
        return -torch.exp(self.loss_log_slope) * excess


def _log_width(raw: Tensor) -> Tensor:
    """Return the log of the width against its mean: of the root of (1 + focus)^2 + floor^2."""
    focus, log_floor = raw[..., 0], raw[..., 1] + _FLOOR_OFFSET
    return 0.5 * torch.log((1.0 + focus) ** 2 + torch.exp(2.0 * log_floor))

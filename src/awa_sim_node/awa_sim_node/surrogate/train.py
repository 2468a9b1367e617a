"""Train the surrogate: ``python -m awa_sim_node.surrogate.train``.

Trains on all rows of the table except the held-out ones, computes the errors on the held-out rows,
and writes ``weights.npz`` and ``trained.json``. It takes ten minutes on one thread; equal seeds give
equal weights on equal computers.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.stats import qmc
from torch import Tensor

from awa_sim_node.surrogate.metadata import INPUTS, OUTPUTS, TRAINED_FILE
from awa_sim_node.surrogate.network import Beam, EnsembleNetwork
from awa_sim_node.surrogate.predictor import WEIGHTS_FILE, Surrogate
from awa_sim_node.surrogate.simulations import SIMULATIONS_FILE, Simulations

_LAST_LEARNING_RATE: Final = 1e-5
_LOSS_LEARNING_RATE: Final = 3e-3
_TRANSMISSION_SCALE: Final = (
    0.05  # a transmission error of 5 % has the weight of one scale of the other outputs
)
_NOISE: Final = 0.02  # noise of the simulation in the hard corner, as a fraction of the scale


@dataclass(frozen=True)
class Recipe:
    """Settings of the training.

    Attributes:
        members: Number of networks in the ensemble.
        hidden: Number of units in each hidden layer.
        steps: Number of steps of the Adam optimiser.
        batch: Number of rows in each step.
        learning_rate: Initial learning rate; it decreases to nearly 0 along a cosine.
        weight_decay: Weight of the sum of squares of all weights.
        early_weight: Weight of the beam half-way to the screen relative to that at the screen.
        seed: Seed of the initial weights and of the order of the rows.
    """

    members: int = 4
    hidden: int = 48
    steps: int = 8000
    batch: int = 256
    learning_rate: float = 0.01
    weight_decay: float = 2e-6
    early_weight: float = 0.3
    seed: int = 0


def fit(table: Simulations, recipe: Recipe) -> EnsembleNetwork:
    """Train a network and return it in double precision.

    Args:
        table: Training data.
        recipe: Settings of the training.
    """
    network = EnsembleNetwork(recipe.members, recipe.hidden, recipe.seed)
    logs_at_planes = np.log(table.outputs[:, :, :8])
    network.standardise(table.inputs, logs_at_planes)
    inputs, logs = _tensor(table.inputs), _tensor(logs_at_planes)
    log_transmission = _tensor(np.log(table.outputs[:, 0, 8]))
    layers, losses = network.groups()
    optimiser = torch.optim.Adam(
        [
            {"params": layers, "lr": recipe.learning_rate},
            {"params": losses, "lr": min(_LOSS_LEARNING_RATE, recipe.learning_rate)},
        ]
    )
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(
        optimiser, recipe.steps, eta_min=_LAST_LEARNING_RATE
    )
    generator = torch.Generator().manual_seed(recipe.seed)
    order = torch.empty(0, dtype=torch.int64)
    for _ in range(recipe.steps):
        if len(order) < min(recipe.batch, len(inputs)):
            order = torch.randperm(len(inputs), generator=generator)
        rows, order = order[: recipe.batch], order[recipe.batch :]
        optimiser.zero_grad()
        beam = network(inputs[rows])
        errors = _errors(beam, logs[rows], network.log_scale, recipe.early_weight)
        lost = (beam.log_transmission - log_transmission[rows]) / _TRANSMISSION_SCALE
        # Summed over the members, so that each is trained independently.
        loss = (errors + 0.5 * lost**2).mean(dim=1).sum()
        loss = loss + recipe.weight_decay * sum((weight**2).sum() for weight in network.matrices())
        loss.backward()
        optimiser.step()
        schedule.step()
    return network.double()


def _errors(beam: Beam, logs: Tensor, scale: Tensor, early_weight: float) -> Tensor:
    """Return the sum over the three perceptrons of their mean errors, ``(M, n)``.

    Args:
        beam: Prediction of the network.
        logs: Logarithms of the simulated outputs, ``(n, 2, 8)``.
        scale: Scale of the logarithms, ``(2, 8)``.
        early_weight: Weight of the beam half-way to the screen.
    """
    planes = torch.tensor([1.0, early_weight])
    differences = (beam.logs - logs) / scale
    hints = _robust((beam.hints - logs[..., :2]) / scale[:, :2]).mean(dim=-1)
    widths = (differences[..., [0, 1]] ** 2).mean(dim=-1)
    emittances = _robust(differences[..., [3, 4]]).mean(dim=-1)
    lengths = _robust(differences[..., [2, 5, 6, 7]]).mean(dim=-1)
    emittances = 0.5 * (emittances * planes + hints)
    return (
        (widths * planes).mean(dim=-1) + emittances.mean(dim=-1) + (lengths * planes).mean(dim=-1)
    )


def _robust(differences: Tensor) -> Tensor:
    """Return an error that is quadratic for small differences and linear for large ones.

    So rows with much noise do not outweigh the others. (The widths have little noise, and are
    learnt better with squares.)
    """
    return 2.0 * _NOISE**2 * (torch.sqrt(1.0 + (differences / _NOISE) ** 2) - 1.0)


def error_table(
    predicted: NDArray[np.float64], simulated: NDArray[np.float64]
) -> dict[str, dict[str, float]]:
    """Return median, 95th percentile and maximum of the error of each output.

    Errors are relative, except for the transmission, whose error is absolute.

    Args:
        predicted: Outputs of the surrogate, ``(n, 9)``.
        simulated: Outputs of the simulation, ``(n, 9)``.
    """
    errors = np.abs(predicted - simulated)
    errors[:, :8] /= simulated[:, :8]
    return {
        quantity.name: {
            "median": float(np.median(column)),
            "p95": float(np.percentile(column, 95.0)),
            "max": float(column.max()),
        }
        for quantity, column in zip(OUTPUTS, errors.T, strict=True)
    }


def held_out_errors(surrogate: Surrogate, table: Simulations) -> dict[str, Any]:
    """Return the errors on the held-out rows of a table, for the whole box and for the corner."""
    held_out = table.where(table.held_out)
    predicted, simulated = surrogate.predict_array(held_out.inputs), held_out.outputs[:, 0]
    parts = {"box": np.ones(len(held_out), dtype=bool), "corner": held_out.corner}
    return {
        name: {"rows": int(rows.sum()), "errors": error_table(predicted[rows], simulated[rows])}
        for name, rows in parts.items()
    }


def output_ranges(surrogate: Surrogate) -> dict[str, list[float]]:
    """Return the lowest and highest prediction of each output within the machine's limits.

    They are taken over 65 536 space-filling points, half of which lie on random faces and edges of
    the box, where the extremes are; charge and coupler kick have their defaults.
    """
    settings = [quantity for quantity in INPUTS if quantity.name not in surrogate.defaults]
    points = qmc.Sobol(2 * len(settings), seed=0).random(2**16)
    settings_points, snap = np.split(points, 2, axis=1)
    on_faces = np.where(snap < 0.25, 0.0, np.where(snap > 0.75, 1.0, settings_points))
    unit = np.where(np.arange(len(points))[:, None] % 2 == 0, settings_points, on_faces)
    low, high = np.array([quantity.machine_limits for quantity in settings]).T
    fixed = np.tile(list(surrogate.defaults.values()), (len(unit), 1))
    predicted = surrogate.predict_array(np.hstack([low + unit * (high - low), fixed]))
    return {
        quantity.name: [float(column.min()), float(column.max())]
        for quantity, column in zip(OUTPUTS, predicted.T, strict=True)
    }


def train(
    recipe: Recipe, folder: Path, say: Callable[[str], None], file: Path = SIMULATIONS_FILE
) -> dict[str, Any]:
    """Train the surrogate, and write ``weights.npz`` and ``trained.json``.

    Args:
        recipe: Settings of the training.
        folder: Folder to write to.
        say: Callable that receives progress messages.
        file: Table of simulations.

    Returns:
        The content of ``trained.json``.

    Raises:
        ValueError: If the table has no training rows or no held-out rows.
    """
    torch.set_num_threads(1)
    table = Simulations.read(file)
    held_out = table.held_out
    if held_out.all() or not held_out.any():
        raise ValueError(
            f"{file} must have training rows and held-out rows, but has {(~held_out).sum()} and "
            f"{held_out.sum()}"
        )
    say(f"training {recipe.members} networks on {(~held_out).sum()} rows")
    network = fit(table.where(~held_out), recipe).float()
    weights: dict[str, Any] = network.arrays()
    np.savez(folder / WEIGHTS_FILE, **weights)
    surrogate = Surrogate(weights)
    content = {
        "recipe": asdict(recipe),
        "rows": int((~held_out).sum()),
        "held_out": held_out_errors(surrogate, table),
        "output_ranges": output_ranges(surrogate),
    }
    (folder / TRAINED_FILE.name).write_text(json.dumps(content, indent=1) + "\n")
    return content


def _tensor(values: NDArray[np.float64]) -> Tensor:
    return torch.as_tensor(values, dtype=torch.float32)


def tables(content: dict[str, Any]) -> list[str]:
    """Return the tables of the data card: the ranges of the outputs and the held-out errors.

    Args:
        content: Content of ``trained.json``.
    """
    ranges = [
        f"| `{q.name}` | {q.unit or '1'} | {low:.4g} to {high:.4g} | {q.meaning} |"
        for q, (low, high) in zip(OUTPUTS, content["output_ranges"].values(), strict=True)
    ]
    errors = []
    for quantity in OUTPUTS:
        cells = [
            f"{100.0 * content['held_out'][part]['errors'][quantity.name][key]:.2f} %"
            for part in ("box", "corner")
            for key in ("median", "p95", "max")
        ]
        errors.append(f"| {quantity.name} | " + " | ".join(cells) + " |")
    return [
        "| output at 3.1 m | unit | over the machine's limits | meaning |\n|---|---|---|---|\n"
        + "\n".join(ranges),
        "| output | box median | box 95 % | box max | corner median | corner 95 % | corner max |\n"
        "|---|---|---|---|---|---|---|\n" + "\n".join(errors),
    ]


def main() -> None:
    """Train with the settings from the command line."""
    parser = argparse.ArgumentParser(description="Train the AWA-like surrogate.")
    usual = Recipe()
    parser.add_argument(
        "--members", type=int, default=usual.members, help="number of networks in the ensemble"
    )
    parser.add_argument(
        "--steps", type=int, default=usual.steps, help="number of steps of the Adam optimiser"
    )
    parser.add_argument("--seed", type=int, default=usual.seed, help="seed of the training")
    parser.add_argument(
        "--folder", type=Path, default=TRAINED_FILE.parent, help="folder to write to"
    )
    parser.add_argument(
        "--table", type=Path, default=SIMULATIONS_FILE, help="CSV file with the training data"
    )
    arguments = parser.parse_args()
    recipe = Recipe(members=arguments.members, steps=arguments.steps, seed=arguments.seed)
    content = train(recipe, arguments.folder, print, arguments.table)
    print("\n\n".join(tables(content)))


if __name__ == "__main__":
    main()

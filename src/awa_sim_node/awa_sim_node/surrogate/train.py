"""Train the surrogate: ``python -m awa_sim_node.surrogate.train``.

It first finds the held-out errors by cross-validation, then trains the network on all rows, and
writes ``weights.npz`` and ``trained.json``. One thread, a quarter of an hour; equal seeds
give equal weights on equal machines.
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
from awa_sim_node.surrogate.predictor import WEIGHTS_FILE, Surrogate, average, outputs_of
from awa_sim_node.surrogate.simulations import Simulations

FOLDS: Final = 8
_LAST_LEARNING_RATE: Final = 1e-5
_LOSS_LEARNING_RATE: Final = 3e-3
_TRANSMISSION_SCALE: Final = (
    0.05  # an error of 5 % in transmission weighs as much as one scale elsewhere
)


@dataclass(frozen=True)
class Recipe:
    """How the network is trained.

    Attributes:
        members: Networks in the ensemble.
        hidden: Units in each hidden layer.
        iterations: Steps of the Adam optimiser, each over all rows.
        learning_rate: Its first learning rate; it falls to nearly 0 along a cosine.
        weight_decay: Weight of the sum of squares of all weights.
        coarse_weight: Weight of a row of the coarse mesh against one of the fine mesh.
        early_weight: Weight of the beam half-way to the screen against that at the screen.
        seed: Seed of the initial weights and of the division into folds.
    """

    members: int = 4
    hidden: int = 32
    iterations: int = 6000
    learning_rate: float = 0.01
    weight_decay: float = 1e-5
    coarse_weight: float = 0.3
    early_weight: float = 0.3
    seed: int = 0


def fit(table: Simulations, weights: NDArray[np.float64], recipe: Recipe) -> EnsembleNetwork:
    """Train one network for each row of weights.

    Args:
        table: The n simulations.
        weights: Weight of each simulation for each network, 0 where it must not see it, ``(M, n)``.
        recipe: How to train; the number of members is that of ``weights``.

    Returns:
        The trained networks, in double precision.
    """
    network = EnsembleNetwork(len(weights), recipe.hidden, recipe.seed)
    outputs = _symmetric(table)
    network.standardise(table.inputs, np.log(outputs[:, :, :8]))
    inputs, fine = _tensor(table.inputs), _mesh(table)
    logs = _tensor(np.log(outputs[:, :, :8]))
    log_transmission = _tensor(np.log(outputs[:, 0, 8]))
    row_weights = _tensor(weights / weights.sum(axis=1, keepdims=True))

    layers, losses = network.groups()
    optimiser = torch.optim.Adam(
        [
            {"params": layers, "lr": recipe.learning_rate},
            {"params": losses, "lr": min(_LOSS_LEARNING_RATE, recipe.learning_rate)},
        ]
    )
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(
        optimiser, recipe.iterations, eta_min=_LAST_LEARNING_RATE
    )
    for _ in range(recipe.iterations):
        optimiser.zero_grad()
        beam = network(inputs, fine)
        errors = _errors(beam, logs, network.log_scale, recipe.early_weight)
        lost = (beam.log_transmission - log_transmission) / _TRANSMISSION_SCALE
        # Sums over members, so that each is trained as if it were alone.
        loss = ((errors + 0.5 * lost**2) * row_weights).sum()
        loss = loss + recipe.weight_decay * sum((weight**2).sum() for weight in network.matrices())
        loss.backward()
        optimiser.step()
        schedule.step()
    return network.double()


def _errors(beam: Beam, logs: Tensor, scale: Tensor, early_weight: float) -> Tensor:
    """Return the sum over the three perceptrons of their mean squared errors, ``(M, n)``.

    Args:
        beam: What the network says.
        logs: What it should say, ``(n, 2, 8)``.
        scale: Scale of the logs, ``(2, 8)``.
        early_weight: Weight of the beam half-way to the screen.
    """
    planes = torch.tensor([1.0, early_weight])
    squares = ((beam.logs - logs) / scale) ** 2
    hints = ((beam.hints - logs[..., :2]) / scale[:, :2]) ** 2
    widths = squares[..., [0, 1]].mean(dim=-1)
    emittances = squares[..., [3, 4]].mean(dim=-1)
    lengths = squares[..., [2, 5, 6, 7]].mean(dim=-1)
    emittances = 0.5 * (emittances * planes + hints.mean(dim=-1))
    return (
        (widths * planes).mean(dim=-1) + emittances.mean(dim=-1) + (lengths * planes).mean(dim=-1)
    )


def cross_validate(table: Simulations, recipe: Recipe, folds: int = FOLDS) -> NDArray[np.float64]:
    """Predict every row of the fine mesh with networks that never saw it.

    Returns:
        The predicted outputs at the screen, ``(number of fine rows, 9)``.
    """
    fine = np.flatnonzero(table.fine)
    fold = np.random.default_rng(recipe.seed).permutation(len(fine)) % folds
    weights = np.tile(_row_weights(table, recipe), (folds * recipe.members, 1))
    for number in range(folds):
        members = slice(number * recipe.members, (number + 1) * recipe.members)
        weights[members, fine[fold == number]] = 0.0
    network = fit(table, weights, recipe)
    with torch.no_grad():
        points = torch.as_tensor(table.inputs[fine])
        outputs = outputs_of(network(points, torch.ones(len(fine), dtype=torch.float64)))
    predicted = np.empty((len(fine), len(OUTPUTS)))
    for number in range(folds):
        members = slice(number * recipe.members, (number + 1) * recipe.members)
        rows = np.flatnonzero(fold == number)
        predicted[rows] = average(outputs[members][:, rows])
    return predicted


def error_table(
    predicted: NDArray[np.float64], simulated: NDArray[np.float64]
) -> dict[str, dict[str, float]]:
    """Return median, 95th percentile and maximum of the error of each output.

    Errors are relative, but for the transmission, whose error is absolute.

    Args:
        predicted: ``(n, 9)``.
        simulated: ``(n, 9)``.
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


def output_ranges(surrogate: Surrogate) -> dict[str, list[float]]:
    """Return the least and greatest prediction of each output over the machine's limits.

    They are taken over 65 536 space-filling points, half of which lie on random faces and edges of
    the box, where the extremes are; charge and coupler kick have their usual values.
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
    recipe: Recipe, folder: Path, say: Callable[[str], None], folds: int = FOLDS
) -> dict[str, Any]:
    """Cross-validate, train, and write ``weights.npz`` and ``trained.json`` into ``folder``.

    Returns:
        The content of ``trained.json``.
    """
    torch.set_num_threads(1)
    table = Simulations.read()
    simulated = table.outputs[table.fine, 0]
    corner = table.corner[table.fine]
    say(f"cross-validating: {folds} times {recipe.members} networks")
    predicted = cross_validate(table, recipe, folds)
    held_out = {
        "folds": folds,
        "box": {"rows": len(simulated), "errors": error_table(predicted, simulated)},
        "corner": {
            "rows": int(corner.sum()),
            "errors": error_table(predicted[corner], simulated[corner]),
        },
    }
    say(f"training: {recipe.members} networks on all rows")
    weights = np.tile(_row_weights(table, recipe), (recipe.members, 1))
    network = fit(table, weights, recipe).float()
    state = {name: value.numpy() for name, value in network.state_dict().items()}
    np.savez(folder / WEIGHTS_FILE, **state)
    content = {
        "recipe": asdict(recipe),
        "rows": {"fine": int(table.fine.sum()), "coarse": int((~table.fine).sum())},
        "held_out": held_out,
        "output_ranges": output_ranges(Surrogate(network.double())),
    }
    (folder / TRAINED_FILE.name).write_text(json.dumps(content, indent=1) + "\n")
    return content


def _symmetric(table: Simulations) -> NDArray[np.float64]:
    """Return the outputs with x and y averaged where the beam is round, against noise."""
    outputs = table.outputs.copy()
    round_beam = table.inputs[:, 7] == 0.0
    for x, y in ((0, 1), (3, 4)):
        mean = np.sqrt(outputs[round_beam][:, :, x] * outputs[round_beam][:, :, y])
        outputs[round_beam, :, x] = outputs[round_beam, :, y] = mean
    return outputs


def _row_weights(table: Simulations, recipe: Recipe) -> NDArray[np.float64]:
    return np.where(table.fine, 1.0, recipe.coarse_weight)


def _mesh(table: Simulations) -> Tensor:
    return _tensor(np.where(table.fine, 1.0, -1.0))


def _tensor(values: NDArray[np.float64]) -> Tensor:
    return torch.as_tensor(values, dtype=torch.float32)


def print_errors(held_out: dict[str, Any], say: Callable[[str], None]) -> None:
    """Print the held-out errors as the table of the data card."""
    say("| output | box median | box 95 % | corner median | corner 95 % |")
    say("|---|---|---|---|---|")
    for quantity in OUTPUTS:
        cells = [
            f"{100.0 * held_out[part]['errors'][quantity.name][key]:.2f} %"
            for part in ("box", "corner")
            for key in ("median", "p95")
        ]
        say(f"| {quantity.name} | " + " | ".join(cells) + " |")


def main() -> None:
    """Train with the recipe from the command line."""
    parser = argparse.ArgumentParser(description="Train the AWA-like surrogate.")
    usual = Recipe()
    parser.add_argument("--members", type=int, default=usual.members)
    parser.add_argument("--iterations", type=int, default=usual.iterations)
    parser.add_argument("--folds", type=int, default=FOLDS)
    parser.add_argument("--seed", type=int, default=usual.seed)
    parser.add_argument("--folder", type=Path, default=TRAINED_FILE.parent, help="where to write")
    arguments = parser.parse_args()
    recipe = Recipe(members=arguments.members, iterations=arguments.iterations, seed=arguments.seed)
    content = train(recipe, arguments.folder, print, arguments.folds)
    print_errors(content["held_out"], print)


if __name__ == "__main__":
    main()

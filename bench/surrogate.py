"""Time of a prediction of the AWA surrogate: of one point, as for each shot, and of many at once.

One thread. The time of one point is the median of many calls, with random set-points within the machine's limits. The
network as torch evaluates it is timed beside it.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from awa_sim_node.surrogate import metadata
from awa_sim_node.surrogate.ensemble import Ensemble
from awa_sim_node.surrogate.network import EnsembleNetwork
from awa_sim_node.surrogate.predictor import WEIGHTS_FILE


def main() -> None:
    """Measure and print the times."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--calls", type=int, default=1000, help="number of predictions of one point"
    )
    parser.add_argument(
        "--points", type=int, default=10_000, help="number of points predicted at once"
    )
    options = parser.parse_args()
    torch.set_num_threads(1)
    low, high = np.array([quantity.machine_limits for quantity in metadata.INPUTS]).T
    points = np.random.default_rng(0).uniform(low, high, (options.points, len(low)))
    for name, predict in evaluators().items():
        times = []
        for i in range(options.calls):
            point = points[i % len(points)][None]
            begin = time.perf_counter()
            predict(point)
            times.append(time.perf_counter() - begin)
        print(f"{name}: one point: {1e3 * median(times):.3f} ms, median of {options.calls}")
        begin = time.perf_counter()
        predict(points)
        each = (time.perf_counter() - begin) / len(points)
        print(f"{name}: {options.points} points at once: {1e6 * each:.1f} us each")


def evaluators() -> dict[str, Callable[[NDArray[np.float64]], Any]]:
    """Return the committed network as numpy and as torch evaluate it."""
    with np.load(Path(metadata.__file__).with_name(WEIGHTS_FILE), allow_pickle=False) as file:
        weights = {name: file[name] for name in file.files}
    members, _, hidden = weights["widths.weights.0"].shape
    network = EnsembleNetwork(members, hidden)
    network.load_state_dict({name: torch.as_tensor(value) for name, value in weights.items()})
    network.double()

    def by_torch(points: NDArray[np.float64]) -> Any:
        with torch.inference_mode():
            return network(torch.from_numpy(points))

    return {"numpy": Ensemble(weights).outputs, "torch": by_torch}


if __name__ == "__main__":
    main()

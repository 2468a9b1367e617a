"""Time of a prediction of the AWA surrogate: of one point, as for each shot, and of many at once.

One thread. The time of one point is the median of many calls, with random set-points within the machine's limits.
"""

from __future__ import annotations

import argparse
import time
from statistics import median

import numpy as np
import torch

from awa_sim_node.surrogate import Surrogate, metadata


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
    surrogate = Surrogate.load()
    low, high = np.array([quantity.machine_limits for quantity in metadata.INPUTS]).T
    points = np.random.default_rng(0).uniform(low, high, (options.points, len(low)))
    names = [quantity.name for quantity in metadata.INPUTS]
    times = []
    for i in range(options.calls):
        inputs = dict(zip(names, points[i % len(points)].tolist(), strict=True))
        begin = time.perf_counter()
        surrogate.predict(inputs)
        times.append(time.perf_counter() - begin)
    print(f"one point: {1e3 * median(times):.3f} ms, median of {options.calls}")
    begin = time.perf_counter()
    surrogate.predict_array(points)
    each = (time.perf_counter() - begin) / len(points)
    print(f"{options.points} points at once: {1e6 * each:.1f} us each")


if __name__ == "__main__":
    main()

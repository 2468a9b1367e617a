"""Time of fits and predictions of seven Gaussian processes over six inputs, on one thread.

    python -m bench.gaussian_process [--sizes 20 100 300 500] [--scikit-learn]

Prints the processor time [s] for all seven outputs together, for each number of evaluations: a first
training, another training after ten more evaluations, adding one evaluation, and predictions of 640
candidates, of 64 with gradients, and of one with gradients.
"""

from __future__ import annotations

import argparse
import time
import warnings
from collections.abc import Callable
from functools import partial

import numpy as np

from mobo_tuner.core.arrays import FloatArray
from mobo_tuner.core.gaussian_process import GaussianProcess
from mobo_tuner.core.linear_algebra import single_blas_thread

D, P = 6, 7
COLUMNS = ("fit", "refit", "add", "predict 640", "gradient 64", "gradient 1")


def outputs(x: FloatArray) -> FloatArray:
    """Return seven smooth functions `(n, 7)`, each of all inputs `(n, 6)`."""
    rng = np.random.default_rng(3)
    frequencies, phases = rng.normal(size=(P, 4, D)), rng.uniform(0.0, 2.0 * np.pi, (P, 4))
    return np.asarray(np.sin(np.einsum("nd,pkd->npk", x, frequencies) + phases).sum(axis=-1))


def seconds(action: Callable[[], object], repeats: int = 1) -> float:
    """Return the processor time of one call [s]."""
    start = time.process_time()
    for _ in range(repeats):
        action()
    return (time.process_time() - start) / repeats


def _predict_with_gradients(models: list[GaussianProcess], x: FloatArray) -> None:
    for model in models:
        model.predict_with_gradient(x)


def times(n: int) -> list[float]:
    """Return the times of COLUMNS with n evaluations [s]."""
    rng = np.random.default_rng(n)
    x = rng.uniform(-1.0, 1.0, (n + 11, D))
    y = outputs(x)
    new = rng.uniform(-1.0, 1.0, (640, D))
    models = [GaussianProcess() for _ in range(P)]

    def fit(m: int) -> None:
        for model, column in zip(models, y.T, strict=True):
            model.fit(x[:m], column[:m], restarts=0)

    def add() -> None:
        for model, column in zip(models, y.T, strict=True):
            model.add(x[-1], column[-1])

    result = [seconds(lambda: fit(n)), seconds(lambda: fit(n + 10)), seconds(add)]
    with single_blas_thread():
        result.append(seconds(lambda: [m.predict(new) for m in models], 5))
        for m, repeats in ((64, 10), (1, 50)):
            gradients = partial(_predict_with_gradients, models, new[:m])
            result.append(seconds(gradients, repeats))
    return result


def scikit_learn_times(n: int) -> list[float]:
    """Return the times of scikit-learn for a fit and 640 predictions, same kernel and data [s]."""
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import ConstantKernel, Matern, WhiteKernel

    rng = np.random.default_rng(n)
    x = rng.uniform(-1.0, 1.0, (n, D))
    y = outputs(x)
    new = rng.uniform(-1.0, 1.0, (640, D))
    kernel = ConstantKernel(1.0, (1e-3, 1e4)) * Matern(np.full(D, 2.0), (0.05, 100.0), 2.5)
    kernel += WhiteKernel(1e-4, (1e-9, 1.0))
    models = [GaussianProcessRegressor(kernel, normalize_y=True) for _ in range(P)]

    def fit() -> None:
        for model, column in zip(models, y.T, strict=True):
            model.fit(x, column)

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # length-scales at their bounds
        return [seconds(fit), seconds(lambda: [m.predict(new, return_std=True) for m in models])]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--sizes", type=int, nargs="+", default=[20, 100, 300, 500], help="numbers of evaluations"
    )
    parser.add_argument(
        "--scikit-learn",
        action="store_true",
        help="also time scikit-learn, which takes minutes at 500",
    )
    arguments = parser.parse_args()
    print("seconds for 7 outputs, 6 inputs, one thread")
    print(f"{'n':>5}" + "".join(f"{name:>13}" for name in COLUMNS))
    with single_blas_thread():
        times(20)  # warm-up: imports and compiled code
        for n in arguments.sizes:
            print(f"{n:>5}" + "".join(f"{value:>13.5f}" for value in times(n)), flush=True)
            if arguments.scikit_learn:
                fit, predict = scikit_learn_times(n)
                print(f"      scikit-learn: fit {fit:.3f}, predict 640 {predict:.4f}", flush=True)


if __name__ == "__main__":
    main()

"""What several fidelities of a simulation save: the cost for the hypervolume that a run at the highest one reaches.

Of each seed, a run at the highest fidelity alone makes a number of evaluations. Then the optimiser chooses among
fidelities, until it reaches the same hypervolume; only what is measured at the highest one counts. Costs are in
evaluations at the highest fidelity.

    branin    Branin and Currin, two variables; the cheap one is biased, correlation 0.73 and 0.99
    dtlz2     three objectives of six variables; bias in all of them, correlation 0.97 to 0.98
    toy       the paper's toy problem; warped and scaled, correlation 0.92 and 0.97
    beam      the surrogate of the injector, which cheap evaluations take for one with 36 instead of 40 nC
    injector  the particle-in-cell simulation with meshes of 8, 12 and 24 nodes and their numbers of particles
    i_beam, truss, dtlz7, osy   published problems; one smooth wave is the bias of each objective and constraint

No choice of the strategy was made on the last four.
With `--hostile`, what is cheap has nothing to do with the objectives.

    python -m experiments.fidelity branin dtlz2 --seeds 5
    python -m experiments.fidelity dtlz2 --hostile --seeds 3
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from awa_sim_node.simulation.injector import SCREEN, Injector, Resolution, Settings
from awa_sim_node.surrogate import Surrogate
from experiments.peers.problems import PROBLEMS as PUBLISHED
from mobo_tuner.core import Optimizer, Problem
from mobo_tuner.core.arrays import FloatArray

CONFIG = Path(__file__).resolve().parent.parent / "config" / "fidelity.yaml"
_SHARE = 0.1  # cost of the cheapest fidelity of the analytic problems
_BIAS = 0.15  # of a published problem, as a share of the spread
_MOST = 1.5  # of the cost of the run at the highest fidelity, after which a run is given up

Function = Callable[[FloatArray, float], FloatArray]
"""Objectives `(P,)` at x `(d,)` in [0, 1] and a fidelity from 0 to 1."""


@dataclass(frozen=True)
class Simulated:
    """A problem with fidelities and its simulation.

    Attributes:
        problem: Problem.
        simulate: Function from a set-point with its fidelity to the outputs.
        evaluations: Number of evaluations of a run at the highest fidelity.
    """

    problem: Problem
    simulate: Callable[[Mapping[str, float]], Mapping[str, float]]
    evaluations: int


def branin_currin(x: FloatArray, s: float) -> FloatArray:
    """Return Branin and Currin, with a bias that is largest at s = 0."""
    a, b = 15.0 * x[0] - 5.0, 15.0 * x[1]
    curve = b - (5.1 / (4.0 * np.pi**2) - 0.1 * (1.0 - s)) * a**2 + 5.0 / np.pi * a - 6.0
    branin = curve**2 + 10.0 * (1.0 - 1.0 / (8.0 * np.pi)) * np.cos(a) + 10.0
    share = 1.0 - 0.1 * (1.0 - s) * np.exp(-0.5 / max(x[1], 1e-9))
    above = 2300.0 * x[0] ** 3 + 1900.0 * x[0] ** 2 + 2092.0 * x[0] + 60.0
    below = 100.0 * x[0] ** 3 + 500.0 * x[0] ** 2 + 4.0 * x[0] + 20.0
    return np.array([branin, share * above / below])


def dtlz2(x: FloatArray, s: float) -> FloatArray:
    """Return DTLZ2 with three objectives; at s < 1 its angles, its optimum and its values are shifted."""
    lack = 1.0 - s
    radius = 1.0 + float(np.square(x[2:] - 0.5 - 0.1 * lack * np.sin(3.0 * x[0])).sum())
    a, b = 0.5 * np.pi * x[:2] + 0.15 * lack * np.sin(4.0 * x[2])
    unit = np.array([np.cos(a) * np.cos(b), np.cos(a) * np.sin(b), np.sin(a)])
    return np.asarray(radius * unit + 0.1 * lack * (1.0 + x[2]))


def toy(x: FloatArray, s: float) -> FloatArray:
    """Return the paper's toy problem; at s < 1 it is warped and scaled."""
    a, b = 4.0 * x - 2.0
    bias = 0.5 * (1.0 - s)
    first = np.hypot(a - 1.0 + bias * np.sin(b), b - 1.0) + 0.3 * bias * a
    second = np.hypot(a + 1.0, b + 1.0 - bias * np.cos(a)) * (1.0 + 0.2 * bias)
    return np.array([first, second])


def unrelated(function: Function, d: int) -> Function:
    """Return a function whose lower fidelities are waves of about the same mean and spread."""
    drawn = np.random.default_rng(0).random((500, d))
    values = np.array([function(x, 1.0) for x in drawn])
    means, spreads = values.mean(axis=0), values.std(axis=0)
    rng = np.random.default_rng(5)
    waves = 3.0 * rng.standard_normal((len(means), 10, d))
    phases = rng.uniform(0.0, 2.0 * np.pi, (len(means), 10))

    def simulated(x: FloatArray, s: float) -> FloatArray:
        if s == 1.0:
            return function(x, 1.0)
        return np.asarray(means + spreads * np.cos(waves @ x + phases).sum(axis=1) / np.sqrt(5.0))

    return simulated


def analytic(
    function: Function, d: int, references: list[float], evaluations: int, hostile: bool
) -> Simulated:
    """Return an analytic problem whose fidelity is 0 or 1."""
    problem = Problem.from_dict(
        {
            "variables": {f"x{i}": {"min": 0.0, "max": 1.0} for i in range(d)},
            "objectives": {f"f{j}": {"reference": r} for j, r in enumerate(references)},
            "fidelity": {"s": {"choices": [0.0, 1.0]}, "cost": f"{_SHARE} + {1.0 - _SHARE} * s"},
        }
    )
    simulated = unrelated(function, d) if hostile else function

    def simulate(setpoint: Mapping[str, float]) -> Mapping[str, float]:
        x = np.array([setpoint[f"x{i}"] for i in range(d)])
        return {f"f{j}": float(f) for j, f in enumerate(simulated(x, setpoint["s"]))}

    return Simulated(problem, simulate, evaluations)


def injector(hostile: bool) -> Simulated:
    """Return the problem of config/fidelity.yaml and the particle-in-cell simulation."""
    if hostile:
        raise SystemExit("injector has no hostile fidelity")

    def simulate(setpoint: Mapping[str, float]) -> Mapping[str, float]:
        settings = {name: value for name, value in setpoint.items() if name != "mesh"}
        resolution = Resolution.of_mesh(int(setpoint["mesh"]))
        [moments] = Injector(Settings(**settings)).track([SCREEN], resolution)
        return asdict(moments)

    return Simulated(Problem.from_yaml(CONFIG), simulate, 30)


def beam(hostile: bool) -> Simulated:
    """Return the problem of config/fidelity.yaml and the surrogate, whose fidelity is the charge [nC]."""
    if hostile:
        raise SystemExit("beam has no hostile fidelity")
    definition: dict[str, Any] = Problem.from_yaml(CONFIG).to_dict()
    definition["fidelity"] = {
        "charge": {"choices": [36.0, 40.0]},
        "cost": f"1 - {(1.0 - _SHARE) / 4.0} * (40 - charge)",
    }
    return Simulated(Problem.from_dict(definition), Surrogate.load().predict, 40)


def published(name: str, hostile: bool) -> Simulated:
    """Return a published problem whose fidelity is 0 or 1; at 0, each output has a wave as its bias.

    The wave is as high as a share of the spread of the output at random points, and smooth.
    """
    if hostile:
        raise SystemExit(f"{name} has no hostile fidelity")
    benchmark = PUBLISHED[name]()
    plain, rng = benchmark.problem, np.random.default_rng(0)
    definition: dict[str, Any] = plain.to_dict()
    definition["fidelity"] = {
        "s": {"choices": [0.0, 1.0]},
        "cost": f"{_SHARE} + {1.0 - _SHARE} * s",
    }
    d, names = len(plain.variables), plain.required_diagnostics
    drawn = [benchmark.measure(plain.denormalize(x)) for x in rng.uniform(-1.0, 1.0, (500, d))]
    spreads = {n: np.subtract(*np.quantile([m[n] for m in drawn], [0.75, 0.25])) for n in names}
    waves = {n: (rng.standard_normal(d), rng.uniform(0.0, 2.0 * np.pi)) for n in names}

    def simulate(setpoint: Mapping[str, float]) -> Mapping[str, float]:
        place = {n: v for n, v in setpoint.items() if n != "s"}
        outputs, x = benchmark.measure(place), plain.normalize(place)
        if setpoint["s"] == 1.0:
            return outputs
        return {
            n: outputs[n] + _BIAS * spreads[n] * math.sin(float(wave @ x) + phase)
            for n, (wave, phase) in waves.items()
        }

    return Simulated(Problem.from_dict(definition), simulate, 30)


PROBLEMS: Mapping[str, Callable[[bool], Simulated]] = {
    "branin": partial(analytic, branin_currin, 2, [300.0, 18.0], 15),
    "dtlz2": partial(analytic, dtlz2, 6, [2.0, 2.0, 2.0], 40),
    "toy": partial(analytic, toy, 2, [4.3, 4.3], 15),
    "beam": beam,
    "injector": injector,
    **{name: partial(published, name) for name in ("i_beam", "truss", "dtlz7", "osy")},
}


def play(simulated: Simulated, several: bool, seed: int, most: float, enough: float) -> FloatArray:
    """Return cost so far, hypervolume and whether it is of the highest fidelity, of each evaluation `(n, 3)`.

    Args:
        simulated: Problem.
        several: Whether the optimiser may choose among the fidelities.
        seed: Seed of the optimiser.
        most: Cost at which the run ends.
        enough: Hypervolume at which the run ends.
    """
    fidelity = simulated.problem.fidelity
    assert fidelity is not None
    definition: dict[str, Any] = simulated.problem.to_dict()
    if not several:
        del definition["fidelity"]
    optimizer = Optimizer(Problem.from_dict(definition), seed=seed)
    spent, steps = 0.0, []
    while spent < most - 1e-9 and optimizer.hypervolume_measured < enough:
        setpoint = optimizer.ask()
        whole = fidelity.highest | setpoint
        optimizer.tell(setpoint, simulated.simulate(whole))
        spent += fidelity.share(whole)
        steps.append((spent, optimizer.hypervolume_measured, float(fidelity.is_highest(whole))))
    return np.array(steps)


def cost(steps: FloatArray, enough: float) -> float:
    """Return the cost for a hypervolume; infinite if it was not reached."""
    reached = np.flatnonzero(steps[:, 1] >= enough)
    return float(steps[reached[0], 0]) if len(reached) else math.inf


def main() -> None:
    """Print the costs of each seed and problem."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("problems", nargs="+", choices=PROBLEMS)
    parser.add_argument("--seeds", type=int, default=5, help="number of seeds")
    parser.add_argument("--hostile", action="store_true", help="what is cheap is of no use")
    options = parser.parse_args()
    for name in options.problems:
        simulated = PROBLEMS[name](options.hostile)
        print(f"{name}{', hostile' if options.hostile else ''}:", flush=True)
        ratios = []
        for seed in range(options.seeds):
            alone = play(simulated, False, seed, simulated.evaluations, math.inf)
            reached = (1.0 - 1e-9) * float(alone[-1, 1])
            steps = play(simulated, True, seed, _MOST * simulated.evaluations, reached)
            ratios.append(
                [cost(steps, r) / cost(alone, r) for r in (reached, 0.99 * reached, 0.95 * reached)]
            )
            highest = int(steps[:, 2].sum())
            print(
                f"  seed {seed}: {cost(alone, reached):.0f} for {alone[-1, 1]:.5g}; with fidelities "
                f"{highest} + {len(steps) - highest} cheaper; ratio of the costs {ratios[-1][0]:.2f}, for 99 % of "
                f"it {ratios[-1][1]:.2f}, for 95 % {ratios[-1][2]:.2f}",
                flush=True,
            )
        for words, each in (
            ("median", np.median(ratios, axis=0)),
            ("worst", np.max(ratios, axis=0)),
        ):
            print(f"  {words}: {each[0]:.2f}, {each[1]:.2f}, {each[2]:.2f}", flush=True)


if __name__ == "__main__":
    main()

"""Convergence of the particle-in-cell simulation at the screen in mesh, particles and steps.

One beam is tracked with different meshes, numbers of particles, step lengths and seeds. Each line is the difference
from the result at the data set's resolution in per cent; the last line is the standard deviation over the seeds.

    python -m experiments.simulation_convergence
    python -m experiments.simulation_convergence --K2 270 --G1 61
"""

from __future__ import annotations

import argparse
import time
from dataclasses import asdict, replace

import numpy as np

from awa_sim_node.simulation.injector import SCREEN, Injector, Resolution, Settings
from awa_sim_node.simulation.moments import Moments

USUAL = {"K1": 475.0, "K2": 230.0, "phi1": -5.0, "phi2": -5.0, "G1": 67.5, "G2": 20.0}
BASE = Resolution()
MESHES = [
    ((16, 16, 32), 5_000),
    ((16, 16, 32), 30_000),
    ((24, 24, 48), 5_000),
    ((24, 24, 48), 30_000),
    ((32, 32, 64), 10_000),
    ((32, 32, 64), 80_000),
]
STEPS = {"steps twice as long": 2.0, "steps half as long": 0.5, "steps a quarter as long": 0.25}
SHOWN = ("sigma_x", "sigma_z", "eps_x", "eps_z", "dE", "energy")


def stepped(factor: float) -> Resolution:
    """Return the data set's resolution with all its steps multiplied by a factor."""
    return replace(
        BASE,
        emission_steps=round(BASE.emission_steps / factor),
        growth=factor * BASE.growth,
        longest_step=factor * BASE.longest_step,
        refresh=factor * BASE.refresh,
        longest_refresh=factor * BASE.longest_refresh,
    )


def tracked(settings: Settings, resolution: Resolution, seed: int = 0) -> tuple[Moments, float]:
    """Return the moments at the screen, and the processor time [s]."""
    start = time.process_time()
    (beam,) = Injector(settings).track([SCREEN], resolution, seed=seed)
    return beam, time.process_time() - start


def main() -> None:
    """Track the beams and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    for name, value in {**USUAL, "charge": 40.0, "coupler_kick": 0.0}.items():
        parser.add_argument(f"--{name}", type=float, default=value)
    parser.add_argument("--seeds", type=int, default=8, help="number of seeds of the bunch")
    options = vars(parser.parse_args())
    seeds = options.pop("seeds")
    settings = Settings(**options)
    tracked(settings, Resolution(mesh=(8, 8, 8), particles=100))  # warm-up: compilation
    base, seconds = tracked(settings, BASE)
    print(" " * 32 + "".join(f"{name:>9}" for name in SHOWN) + "    CPU s")

    def show(label: str, values: list[float], seconds: float, form: str) -> None:
        cells = "".join(f"{value:{form}}" for value in values)
        print(f"{label:32}{cells}{seconds:9.1f}", flush=True)

    def differences(beam: Moments) -> list[float]:
        return [100.0 * (getattr(beam, name) / getattr(base, name) - 1.0) for name in SHOWN]

    show(f"{BASE.mesh} {BASE.particles}", [getattr(base, name) for name in SHOWN], seconds, "9.4g")
    for mesh, particles in MESHES:
        beam, seconds = tracked(settings, replace(BASE, mesh=mesh, particles=particles))
        show(f"{mesh} {particles}", differences(beam), seconds, "+9.2f")
    for label, factor in STEPS.items():
        beam, seconds = tracked(settings, stepped(factor))
        show(label, differences(beam), seconds, "+9.2f")
    beam, seconds = tracked(settings, replace(BASE, image_until=0.08))
    show("image included up to 80 mm", differences(beam), seconds, "+9.2f")
    beams = [asdict(tracked(settings, BASE, seed)[0]) for seed in range(seeds)]
    spread = [100.0 * np.std([b[name] for b in beams], ddof=1) / beams[0][name] for name in SHOWN]
    show(f"spread of {seeds} seeds", spread, 0.0, "9.2f")


if __name__ == "__main__":
    main()

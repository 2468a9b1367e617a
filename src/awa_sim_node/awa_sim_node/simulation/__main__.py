"""The simulation as a command: ``python -m awa_sim_node.simulation beam | evaluate | table``."""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Sequence
from dataclasses import MISSING, asdict, fields
from pathlib import Path

from awa_sim_node.simulation.injector import HALF_WAY, SCREEN, Injector, Resolution, Settings
from awa_sim_node.simulation.samples import ROWS
from awa_sim_node.simulation.table import make_table


def main(arguments: Sequence[str] | None = None) -> None:
    """Track one beam, or compute the table of simulations.

    Args:
        arguments: Command line; by default that of the process.
    """
    parser = argparse.ArgumentParser(
        prog="python -m awa_sim_node.simulation",
        description="Particle-in-cell simulation of an AWA-like injector.",
    )
    commands = parser.add_subparsers(dest="command", required=True)
    beam = commands.add_parser("beam", help="track one beam and print its moments")
    usual = {"K1": 475.0, "K2": 230.0, "phi1": -5.0, "phi2": -5.0, "G1": 67.5, "G2": 20.0}
    for field in fields(Settings):
        default = usual[field.name] if field.default is MISSING else field.default
        beam.add_argument(f"--{field.name}", type=float, default=default)
    beam.add_argument("--seed", type=int, default=0, help="seed of the particles")
    beam.add_argument(
        "--planes",
        type=float,
        nargs="+",
        default=[HALF_WAY, SCREEN],
        help="positions of the printed moments [m from the cathode]",
    )
    commands.add_parser(
        "evaluate",
        help="track one beam for a campaign: settings as a JSON object on standard input, with 'mesh' for "
        "other than 24 nodes across the bunch, the moments on the screen as one on standard output, null "
        "where there is no beam",
    )
    table = commands.add_parser("table", help="compute or complete the surrogate's training data")
    table.add_argument("file", type=Path, help="CSV file")
    table.add_argument("--rows", type=int, default=ROWS, help="number of rows in the table")
    table.add_argument("--workers", type=int, default=2, help="number of processes")
    options = vars(parser.parse_args(arguments))
    try:
        command = options.pop("command")
        if command == "evaluate":
            _evaluate(sys.stdin.read())
        elif command == "table":
            if options["rows"] < 1:
                raise ValueError(f"rows = {options['rows']} must be 1 or more")
            make_table(options["file"], range(options["rows"]), options["workers"])
        else:
            _show_beam(sorted(options.pop("planes")), options.pop("seed"), Settings(**options))
    except (OSError, ValueError) as error:
        sys.exit(f"{parser.prog}: {error}")


def _show_beam(planes: list[float], seed: int, settings: Settings) -> None:
    for plane, moments in zip(planes, Injector(settings).track(planes, seed=seed), strict=True):
        print(f"{plane:g} m: " + ", ".join(f"{k} {v:.5g}" for k, v in asdict(moments).items()))


def _evaluate(text: str) -> None:
    """Print the moments of a beam whose settings are a JSON object.

    Raises:
        ValueError: If it is not one, or a setting is unknown, missing or not allowed.
    """
    try:
        point = json.loads(text)
        resolution = Resolution.of_mesh(int(point.pop("mesh", Resolution().mesh[0])))
        settings = Settings(**point)
    except (TypeError, AttributeError) as error:
        raise ValueError(f"the settings are not complete: {error}") from None
    [moments] = Injector(settings).track([SCREEN], resolution)
    values = asdict(moments)
    print(json.dumps({n: v if math.isfinite(v) else None for n, v in values.items()}))


if __name__ == "__main__":
    main()

"""Draw the pictures of docs/method.md and docs/machine.md with the optimiser, the simulation and the surrogate.

    python docs/make_pictures.py [FOLDER]

The same arguments give the same pictures. `python -m experiments.paper` draws those of the paper's experiments.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from cartoons import draw_acquisition, draw_boxes
from machine_pictures import draw_beam, draw_beamline, draw_front, draw_knobs
from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

ROOT = Path(__file__).resolve().parent.parent

STYLE: dict[Any, Any] = {
    "figure.dpi": 130,
    "figure.constrained_layout.use": True,
    "font.size": 10,
    "axes.titlesize": 10.5,
    "axes.titlelocation": "left",
    "axes.titlepad": 8.0,
    "legend.frameon": False,
    "legend.fontsize": 9,
}


def main(arguments: Sequence[str] | None = None) -> None:
    """Draw all pictures."""
    parser = argparse.ArgumentParser(
        description="Draw the pictures of docs/method.md and docs/machine.md."
    )
    parser.add_argument(
        "folder", type=Path, nargs="?", default=ROOT / "docs" / "images", help="folder to write to"
    )
    parser.add_argument("--seed", type=int, default=2, help="seed of the run on the machine")
    parser.add_argument(
        "--particles", type=int, default=10_000, help="number of particles of a simulated beam"
    )
    parser.add_argument("--samples", type=int, default=2**17, help="number of random set-points")
    parser.add_argument(
        "--evaluations", type=int, default=60, help="number of evaluations of a run on the machine"
    )
    parser.add_argument(
        "--only", nargs="+", choices=PICTURES, default=list(PICTURES), help="pictures to draw"
    )
    options = parser.parse_args(arguments)
    options.folder.mkdir(parents=True, exist_ok=True)
    with rc_context(STYLE):
        for name in options.only:
            figure = PICTURES[name](options)
            FigureCanvasAgg(figure)
            # The file does not contain the version of matplotlib.
            figure.savefig(options.folder / f"{name}.png", metadata={"Software": None})


PICTURES: dict[str, Callable[[argparse.Namespace], Figure]] = {
    "method_boxes": lambda _: draw_boxes(),
    "method_acquisition": lambda _: draw_acquisition(),
    "machine_beamline": lambda _: draw_beamline(),
    "machine_beam": lambda options: draw_beam(options.particles),
    "machine_knobs": lambda _: draw_knobs(),
    "machine_front": lambda options: draw_front(options.samples, options.evaluations, options.seed),
}

if __name__ == "__main__":
    main()

"""Making the table of simulations: in parallel, and going on where it was stopped.

Each row is appended as soon as it is done. When all are there the table is sorted, so that the
same version makes the same file.
"""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Iterable
from dataclasses import astuple, fields
from pathlib import Path
from typing import Final

from awa_sim_node.simulation.constants import VERSION
from awa_sim_node.simulation.injector import HALF_WAY, SCREEN, Injector, Resolution, Settings
from awa_sim_node.simulation.moments import Moments
from awa_sim_node.simulation.samples import Sample, sample
from awa_sim_node.simulation.space_charge import SpaceCharge

PLANES: Final = (HALF_WAY, SCREEN)

HEADER: Final = ",".join(
    [
        "version",
        "sample",
        "region",
        *[field.name for field in fields(Settings)],
        *[f"{field.name}@{plane:g}" for plane in PLANES for field in fields(Moments)],
    ]
)

_DIGITS: Final = 5  # significant digits of the outputs

_solvers: dict[tuple[int, int, int], SpaceCharge] = {}  # of this process


def simulate(point: Sample, resolution: Resolution) -> str:
    """Return the row of one sample, without the end of the line. Its number is the seed."""
    solver = _solvers.setdefault(resolution.mesh, SpaceCharge(resolution.mesh))
    injector = Injector(point.settings)
    beams = injector.track(PLANES, resolution, seed=point.number, solver=solver)
    cells = [VERSION, str(point.number), point.region]
    cells += [f"{value:.10g}" for value in astuple(point.settings)]
    cells += [f"{value:.{_DIGITS}g}" for beam in beams for value in astuple(beam)]
    return ",".join(cells)


def read_rows(path: Path) -> dict[int, str]:
    """Return the whole rows of a table by number; a line that was cut off does not count.

    Raises:
        ValueError: If the table is another one, or was made by another version.
    """
    if not path.exists() or path.stat().st_size == 0:
        return {}
    lines = path.read_text().split("\n")[:-1]
    if lines and lines[0] != HEADER:
        raise ValueError(f"{path} must start with the columns {HEADER}")
    rows = {}
    for line in lines[1:]:
        version, number, _ = line.split(",", 2)
        if version != VERSION:
            raise ValueError(
                f"row {number} of {path} is of version {version} of the simulation, "
                f"and must be of version {VERSION} to go on"
            )
        rows[int(number)] = line
    return rows


def write_rows(path: Path, rows: dict[int, str]) -> None:
    """Write a table sorted by number, in one go."""
    part = path.with_name(path.name + ".part")
    part.write_text("\n".join([HEADER, *[rows[number] for number in sorted(rows)]]) + "\n")
    part.replace(path)


def make_table(
    path: Path,
    numbers: Iterable[int],
    workers: int,
    resolution: Resolution | None = None,
    say: Callable[[str], None] = print,
) -> None:
    """Simulate the samples that a table lacks, and leave it sorted.

    Args:
        path: The table; made where it is missing.
        numbers: The samples wanted.
        workers: Processes.
        resolution: How finely; by default that of the data set.
        say: Gets a line now and then.

    Raises:
        ValueError: If there is no such sample, the number of workers makes no sense, or the table
            is another one or of another version.
    """
    if workers < 1:
        raise ValueError(f"workers is {workers}, and must be 1 or more")
    rows = read_rows(path)
    missing = [number for number in numbers if number not in rows]
    for number in missing:
        sample(number)  # refuses what does not exist before anything is written
    write_rows(path, rows)  # without what was cut off
    say(f"{len(rows)} rows are there, {len(missing)} are missing")
    tasks = [(number, resolution or Resolution()) for number in missing]
    with path.open("a") as file:
        for count, line in enumerate(_computed(tasks, workers), start=1):
            file.write(line + "\n")
            file.flush()
            os.fsync(file.fileno())
            if count % 50 == 0 or count == len(tasks):
                say(f"{count} of {len(tasks)} done")
    write_rows(path, read_rows(path))


def _computed(tasks: list[tuple[int, Resolution]], workers: int) -> Iterable[str]:
    if workers == 1 or len(tasks) <= 1:
        yield from map(_row, tasks)
        return
    with multiprocessing.get_context("spawn").Pool(min(workers, len(tasks))) as pool:
        yield from pool.imap_unordered(_row, tasks)


def _row(task: tuple[int, Resolution]) -> str:
    number, resolution = task
    return simulate(sample(number), resolution)

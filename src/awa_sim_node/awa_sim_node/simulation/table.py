"""The table of simulations, computed in parallel; an interrupted computation can be continued.

Each row is appended as soon as it is computed. The complete table is sorted, so that the same
version of the simulation always gives the same file.
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

_solvers: dict[tuple[int, int, int], SpaceCharge] = {}  # by mesh, in this process


def simulate(point: Sample, resolution: Resolution) -> str:
    """Return the row of one sample, without the line break.

    Args:
        point: Sample; its number is also the seed of the particles.
        resolution: Resolution of the simulation.
    """
    solver = _solvers.setdefault(resolution.mesh, SpaceCharge(resolution.mesh))
    injector = Injector(point.settings)
    beams = injector.track(PLANES, resolution, seed=point.number, solver=solver)
    cells = [VERSION, str(point.number), point.region]
    cells += [f"{value:.10g}" for value in astuple(point.settings)]
    cells += [f"{value:.{_DIGITS}g}" for beam in beams for value in astuple(beam)]
    return ",".join(cells)


def read_rows(path: Path) -> dict[int, str]:
    """Return the complete rows of a table by number; an incomplete last line is ignored.

    Args:
        path: CSV file; a missing or empty file has no rows.

    Raises:
        ValueError: If the columns differ, or the table was computed by another version.
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
                f"but must be of version {VERSION} to continue the table"
            )
        rows[int(number)] = line
    return rows


def write_rows(path: Path, rows: dict[int, str]) -> None:
    """Write a table sorted by number; the file is replaced at once."""
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
    """Simulate the missing samples of a table, and sort it.

    Args:
        path: CSV file; created if it is missing.
        numbers: Numbers of the samples that the table should have.
        workers: Number of processes.
        resolution: Resolution of the simulation; by default that of the data set.
        say: Callable that receives progress messages.

    Raises:
        ValueError: If there is no such sample, ``workers`` is less than 1, or the columns or the
            version of an existing table differ.
    """
    if workers < 1:
        raise ValueError(f"workers = {workers} must be 1 or more")
    rows = read_rows(path)
    missing = [number for number in numbers if number not in rows]
    for number in missing:
        sample(number)  # refuses unknown numbers before anything is written
    write_rows(path, rows)  # drops an incomplete last line
    say(f"{len(rows)} rows exist, {len(missing)} are missing")
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

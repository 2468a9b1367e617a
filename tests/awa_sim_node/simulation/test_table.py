"""The table of simulations: it can be stopped at any time, and does not depend on who computes it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from dataclasses import astuple
from pathlib import Path

import pytest

from awa_sim_node.simulation.constants import VERSION
from awa_sim_node.simulation.injector import Resolution
from awa_sim_node.simulation.samples import sample
from awa_sim_node.simulation.table import HEADER, make_table, read_rows, simulate
from tests.support.paths import ROOT

ROUGH = Resolution(mesh=(8, 8, 12), particles=100, growth=0.05, longest_step=15e-12)


def quiet(_: str) -> None:
    pass


@pytest.fixture(scope="module")
def reference(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The text of a table of five rows, made in one go by one process."""
    path = tmp_path_factory.mktemp("table") / "reference.csv"
    make_table(path, range(5), 1, ROUGH, quiet)
    return path.read_text()


def test_every_row_carries_version_number_and_settings(reference: str) -> None:
    header, *lines = reference.splitlines()
    columns = header.split(",")
    assert len(lines) == 5
    for number, line in enumerate(lines):
        row = dict(zip(columns, line.split(","), strict=True))
        point = sample(number)
        assert row["version"] == VERSION
        assert int(row["sample"]) == number
        assert row["region"] == point.region
        assert tuple(float(row[name]) for name in columns[3:11]) == astuple(point.settings)
        assert 10.0 < float(row["energy@3.1"]) < 20.0
        assert 0.5 < float(row["transmission@3.1"]) <= 1.0


def test_two_processes_make_the_same_table_in_any_order(reference: str, tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    make_table(path, reversed(range(5)), 2, ROUGH, quiet)
    assert path.read_text() == reference


def test_it_goes_on_where_a_line_was_cut_off(reference: str, tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    said: list[str] = []
    path.write_text(reference[:-60])
    make_table(path, range(5), 1, ROUGH, said.append)
    assert path.read_text() == reference
    assert said[0].startswith("4 rows ")
    assert "1 are missing" in said[0]


def test_it_computes_only_what_is_missing(reference: str, tmp_path: Path) -> None:
    # A row that is there is left as it is, even where it is another one.
    path = tmp_path / "table.csv"
    header, *lines = reference.splitlines()
    foreign = lines[2].replace("space", "SPACE")
    path.write_text("\n".join([header, foreign, lines[0]]) + "\n")
    make_table(path, range(3), 1, ROUGH, quiet)
    assert path.read_text().splitlines() == [header, lines[0], lines[1], foreign]


def test_it_goes_on_after_a_kill(reference: str, tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    program = (
        "import sys; from pathlib import Path; sys.path.insert(0, sys.argv[2]);"
        "from tests.awa_sim_node.simulation.test_table import ROUGH, quiet;"
        "from awa_sim_node.simulation.table import make_table;"
        "make_table(Path(sys.argv[1]), range(5000), 1, ROUGH, quiet)"
    )
    folder = str(ROOT)
    process = subprocess.Popen([sys.executable, "-c", program, str(path), folder])
    try:
        deadline = time.monotonic() + 100.0
        while not path.exists() or path.read_text().count("\n") < 4:
            assert process.poll() is None
            assert time.monotonic() < deadline
            time.sleep(0.05)
    finally:
        os.kill(process.pid, signal.SIGKILL)
        process.wait(10.0)
    before = read_rows(path)
    assert len(before) >= 3
    make_table(path, range(5), 1, ROUGH, quiet)
    assert path.read_text().startswith(reference)
    assert before.items() <= read_rows(path).items()


def test_a_table_of_another_version_is_refused(reference: str, tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    text = reference.replace(f"\n{VERSION},1,", "\n0,1,")
    path.write_text(text)
    message = rf"row 1 of {path} is of version 0 .* version {VERSION}"
    with pytest.raises(ValueError, match=message):
        make_table(path, range(6), 1, ROUGH, quiet)
    assert path.read_text() == text


def test_another_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "notes.txt"
    path.write_text("dear diary\n")
    with pytest.raises(ValueError, match=rf"^{path} .* version,sample,region,K1"):
        make_table(path, range(2), 1, ROUGH, quiet)
    assert path.read_text() == "dear diary\n"


def test_bad_requests_write_nothing(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    with pytest.raises(ValueError, match=r"^workers = 0 .* 1 "):
        make_table(path, range(2), 0, ROUGH, quiet)
    with pytest.raises(ValueError, match=r"^sample = -1 .* from 0 to "):
        make_table(path, [-1], 1, ROUGH, quiet)
    assert not path.exists()


def test_the_number_is_the_seed() -> None:
    point = sample(1)
    other = type(point)(2, point.region, point.settings)
    assert simulate(point, ROUGH) == simulate(point, ROUGH)
    assert simulate(point, ROUGH).split(",")[3:11] == simulate(other, ROUGH).split(",")[3:11]
    assert simulate(point, ROUGH).split(",")[11:] != simulate(other, ROUGH).split(",")[11:]


def test_no_table_and_an_empty_one_have_no_rows(tmp_path: Path) -> None:
    assert read_rows(tmp_path / "none.csv") == {}
    (tmp_path / "empty.csv").touch()
    assert read_rows(tmp_path / "empty.csv") == {}
    (tmp_path / "header.csv").write_text(HEADER + "\n")
    assert read_rows(tmp_path / "header.csv") == {}

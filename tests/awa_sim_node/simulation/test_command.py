"""The simulation as a command."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from awa_sim_node.simulation.__main__ import main
from awa_sim_node.simulation.table import HEADER

NUMBERS = re.compile(r"(\w+) (nan|[-+.e\d]+)")


def test_beam(capsys: pytest.CaptureFixture[str]) -> None:
    main(["beam", "--charge", "0", "--planes", "0.7", "0.5", "--G1", "60"])
    lines = capsys.readouterr().out.splitlines()
    assert [line.split(":")[0] for line in lines] == ["0.5 m", "0.7 m"]
    first = {name: float(value) for name, value in NUMBERS.findall(lines[0].split(":")[1])}
    assert list(first) == [
        *("sigma_x", "sigma_y", "sigma_z", "eps_x", "eps_y", "eps_z"),
        *("dE", "energy", "transmission"),
    ]
    assert first["energy"] == pytest.approx(6.25, abs=0.03)
    assert first["transmission"] == 1.0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["beam", "--K1", "nan"], "K1 = nan must be "),
        (["beam", "--charge", "-3"], "charge = -3 must be "),
        (["beam", "--G1", "0"], "G1 = 0 must be "),
        (["beam", "--planes", "3", "3"], "planes = 3, 3 m must be "),
        (["beam", "--seed", "-1"], "seed = -1 must be "),
        (["table", "t.csv", "--rows", "0"], "rows = 0 must be "),
        (["table", "t.csv", "--rows", "20000"], "sample = 11702 must be "),
        (["table", "t.csv", "--workers", "0"], "workers = 0 must be "),
        (["table", "missing/t.csv", "--rows", "1"], "No such file or directory"),
    ],
)
def test_bad_input_gets_one_sentence(
    arguments: list[str], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as stopped:
        main(arguments)
    text = str(stopped.value)
    assert text.startswith("python -m awa_sim_node.simulation: ")
    assert message in text
    assert "\n" not in text
    assert list(tmp_path.iterdir()) == []


def test_a_finished_table_is_left_as_it_is(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    row = ",".join(["1", "0", *["1"] * (HEADER.count(",") - 1)])
    path.write_text(f"{HEADER}\n{row}\n")
    command = [sys.executable, "-m", "awa_sim_node.simulation", "table", str(path), "--rows", "1"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=100, check=True)
    assert done.stdout.startswith("1 rows ")
    assert "0 are missing" in done.stdout
    assert path.read_text() == f"{HEADER}\n{row}\n"

"""A simulation as a command: what it answers, and what becomes of one that fails or hangs."""

from __future__ import annotations

import json
import math
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from unittest.mock import ANY

import pytest

from mobo_tuner.errors import ParameterError
from mobo_tuner.offline.simulation import Simulation, command_of
from mobo_tuner.offline.watchdog import GRACE

TIMEOUT = 20.0


MPI_PROGRAM = """
import json, os, sys, time
from mpi4py import MPI

world = MPI.COMM_WORLD
point = json.loads(sys.stdin.readline()) if world.rank == 0 else None
x = world.bcast(point)["x"]
open(f"rank-{os.getpid()}", "w").close()
if x > 1.0:
    time.sleep(60)
total = world.allreduce(x + world.rank)
if world.rank == 0:
    print(json.dumps({"f": total}))
"""

Make = Callable[..., Simulation]


@pytest.fixture
def simulation(tmp_path: Path) -> Iterator[Make]:
    """Makes a simulation by a Python program, to which the point is known as x."""
    made: list[Simulation] = []

    def make(program: str, timeout: float = TIMEOUT) -> Simulation:
        script = tmp_path / "program.py"
        script.write_text(f"import json, os, sys, time\nx = json.load(sys.stdin)\n{program}\n")
        made.append(Simulation(f"python {script}", timeout, tmp_path / "simulations"))
        return made[-1]

    yield make
    for each in made:
        each.stop()


def test_the_last_line_has_the_outputs(simulation: Make) -> None:
    program = "print('words'); print(json.dumps({'f': 2 * x['x'], 'g': None, 'h': 1}))"
    outcome = simulation(program).run(3, {"x": 0.5})
    assert outcome.error == ""
    assert outcome.outputs["f"] == 1.0
    assert math.isnan(outcome.outputs["g"])
    assert 0.0 < outcome.seconds < TIMEOUT


def test_each_has_a_folder_in_which_its_files_stay(simulation: Make, tmp_path: Path) -> None:
    program = "open('beam', 'w').write(sys.executable); print('{}')"
    simulation(program).run(12, {"x": 0.5})
    [folder] = (tmp_path / "simulations").iterdir()
    assert folder.name == "000012"
    assert (folder / "beam").read_text() == sys.executable
    assert (folder / "output").read_text() == "{}\n"


@pytest.mark.parametrize(
    ("program", "words"),
    [
        ("sys.exit('the beam is lost')", "the beam is lost"),
        ("os.kill(os.getpid(), 9)", "status -9"),
        ("", "JSON"),
        ("print('[1.0]')", "JSON"),
        ("print('{')", "JSON"),
        ("print('[' * 100_000)", "JSON"),
        ("print(json.dumps({'f': 'large'}))", "'f'"),
        ("print(json.dumps({'f': True}))", "'f'"),
        ("print(json.dumps({'f': 10**400}))", "'f', which is too large"),
    ],
)
def test_what_goes_wrong_is_said(simulation: Make, program: str, words: str) -> None:
    outcome = simulation(program).run(0, {"x": 0.5})
    assert words in outcome.error
    assert outcome.outputs == {}


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("raise ValueError('the mesh is too coarse\\nfor this bunch')", "the mesh is too coarse"),
        ("return {'f': 'large'}", "'f'"),
        ("return {'f': [1.0, 2.0]}", "'f'"),
        ("return 1.0", "1.0"),
    ],
)
def test_what_goes_wrong_in_a_function_is_said(tmp_path: Path, body: str, words: str) -> None:
    file = tmp_path / "beam.py"
    file.write_text(f"def simulate(point):\n    {body}\n")
    command = command_of({"command": "", "function": "beam.py:simulate"}, tmp_path)
    made = Simulation(command, TIMEOUT, tmp_path / "simulations")
    try:
        outcome = made.run(0, {"x": 0.5})
    finally:
        made.stop()
    assert words in outcome.error
    assert outcome.outputs == {}


def test_what_takes_too_long_is_killed_with_its_children(simulation: Make, tmp_path: Path) -> None:
    program = (
        f"pid = os.fork(); open('{tmp_path}/pids', 'a').write(f'{{os.getpid()}} '); time.sleep(60)"
    )
    outcome = simulation(program, timeout=1.0).run(0, {"x": 0.5})
    assert "1 s" in outcome.error
    pids = [int(word) for word in (tmp_path / "pids").read_text().split()]
    assert len(pids) == 2
    deadline = time.monotonic() + TIMEOUT
    while any(is_alive(pid) for pid in pids):
        assert time.monotonic() < deadline
        time.sleep(0.02)


def test_one_that_does_not_end_when_asked_is_killed(simulation: Make) -> None:
    program = "import signal; signal.signal(signal.SIGTERM, signal.SIG_IGN); time.sleep(60)"
    outcome = simulation(program, timeout=1.0).run(0, {"x": 0.5})
    assert "1 s" in outcome.error
    assert outcome.seconds < 1.0 + GRACE + TIMEOUT


def test_one_that_takes_too_long_is_asked_first(simulation: Make, tmp_path: Path) -> None:
    program = (
        "import signal; signal.signal(signal.SIGTERM, lambda *_: sys.exit(open('asked', 'w').close()));"
        "time.sleep(60)"
    )
    assert "2 s" in simulation(program, timeout=2.0).run(0, {"x": 0.5}).error
    assert (tmp_path / "simulations" / "000000" / "asked").exists()


def test_no_process_of_mpi_outlives_a_stop(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("OMPI_ALLOW_RUN_AS_ROOT", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM"):
        monkeypatch.setenv(name, "1")
    (tmp_path / "program.py").write_text(MPI_PROGRAM)
    command = f"mpirun --oversubscribe -n 3 {sys.executable} {tmp_path / 'program.py'}"
    made = Simulation(command, TIMEOUT, tmp_path / "simulations")
    assert made.run(0, {"x": 0.5}) == ({"f": 4.5}, ANY, "")
    thread = threading.Thread(target=made.run, args=(1, {"x": 2.0}))
    thread.start()
    deadline = time.monotonic() + TIMEOUT
    while len(paths := [*tmp_path.glob("simulations/000001/rank-*")]) < 3:
        assert time.monotonic() < deadline
        time.sleep(0.02)
    made.stop()
    thread.join(TIMEOUT)
    assert not thread.is_alive()
    ranks = [int(path.name.split("-")[1]) for path in paths]
    while any(is_alive(rank) for rank in ranks):
        assert time.monotonic() < deadline
        time.sleep(0.02)


def test_a_stop_ends_what_runs_and_starts_nothing_more(simulation: Make, tmp_path: Path) -> None:
    made = simulation(f"open('{tmp_path}/started', 'w').close(); time.sleep(60)")
    errors: list[str] = []
    thread = threading.Thread(target=lambda: errors.append(made.run(0, {"x": 0.5}).error))
    thread.start()
    deadline = time.monotonic() + TIMEOUT
    while not (tmp_path / "started").exists():
        assert time.monotonic() < deadline
        time.sleep(0.02)
    made.stop()
    thread.join(TIMEOUT)
    assert len(errors) == 1
    assert "status -15" in errors[0]
    assert "stopped" in made.run(1, {"x": 0.5}).error


@pytest.mark.parametrize("command", ["", "no_such_program_anywhere --fast", "python 'unclosed"])
def test_a_command_that_cannot_be_is_refused_by_name(tmp_path: Path, command: str) -> None:
    with pytest.raises(ParameterError, match=r"campaign\.command"):
        Simulation(command, 1.0, tmp_path)


def test_the_injector_s_simulation_answers(tmp_path: Path) -> None:
    point = {"K1": 475.0, "K2": 230.0, "phi1": -5.0, "phi2": -5.0, "G1": 67.5, "G2": 20.0}
    made = Simulation("python -m awa_sim_node.simulation evaluate", 120.0, tmp_path)
    beam, lost = made.run(0, point), made.run(1, point | {"K1": math.inf})
    made.stop()
    assert beam.error == ""
    assert {"sigma_x", "eps_x", "dE", "transmission"} <= {*beam.outputs}
    assert beam.outputs["energy"] == pytest.approx(15.1, abs=0.1)
    assert "K1" in lost.error


def is_alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def test_a_point_goes_in_as_json(simulation: Make, tmp_path: Path) -> None:
    point = {"a": 0.1, "b": -1e300}
    outcome = simulation("print(json.dumps(x))").run(0, point)
    assert outcome.outputs == point
    assert json.loads((tmp_path / "simulations" / "000000" / "output").read_text()) == point
    assert os.listdir(tmp_path / "simulations") == ["000000"]

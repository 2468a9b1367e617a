"""The examples do what they say, with the real tuner between them."""

from __future__ import annotations

from pathlib import Path

from ros_support import NodeStarter

ROOT = Path(__file__).resolve().parents[2]


def test_a_machine_and_a_client_of_ones_own_tune(start_node: NodeStarter) -> None:
    machine = start_node(str(ROOT / "examples" / "my_machine.py"))
    config = str(ROOT / "config" / "toy.yaml")
    start_node("-m", "mobo_tuner.nodes.tuner", "--ros-args", "--params-file", config)
    client = start_node("-u", str(ROOT / "examples" / "tune_client.py"), "9")
    assert client.wait(60.0) == 0, client.stderr
    lines = client.stdout.splitlines()
    assert [line.split(":")[0] for line in lines[:9]] == [str(i) for i in range(9)]
    assert lines[9].startswith("9 evaluations, ")
    assert lines[10].strip() == "stopped by budget"
    assert machine.stop() == 0


def test_a_loop_of_ones_own_asks_and_tells(start_node: NodeStarter) -> None:
    config = str(ROOT / "config" / "toy.yaml")
    start_node("-m", "mobo_tuner.nodes.tuner", "--ros-args", "--params-file", config)
    client = start_node("-u", str(ROOT / "examples" / "ask_tell_client.py"), "9")
    assert client.wait(60.0) == 0, client.stderr
    lines = client.stdout.splitlines()
    assert [line.split(":")[0] for line in lines[:9]] == [str(i) for i in range(9)]
    hypervolumes = [float(line.split()[-1]) for line in lines[:9]]
    assert hypervolumes == sorted(hypervolumes)
    assert len(lines) > 11
    assert all(line.startswith("f1 = ") for line in lines[9:])

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

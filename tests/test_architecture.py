"""The house rules that a reader of one file cannot see: what may import what."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import mobo_tuner

CORE = Path(mobo_tuner.__file__).parent / "core"
ROS_PACKAGES = ("rclpy", "rcl_interfaces", "mobo_msgs_py", "std_msgs", "builtin_interfaces")


def test_the_core_works_where_ros_cannot_be_imported() -> None:
    program = f"""
import sys
class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {(*ROS_PACKAGES, "torch")!r}:
            raise ModuleNotFoundError(name + " must not be imported")
sys.meta_path.insert(0, Absent())
from mobo_tuner.core import Optimizer, Problem
problem = Problem.from_dict({{
    "variables": {{"x": {{"min": 0.0, "max": 1.0}}}},
    "objectives": {{"f": {{"reference": 2.0}}, "g": {{"reference": 2.0}}}},
}})
optimizer = Optimizer(problem, seed=1, initial_evaluations=4)
for _ in range(6):
    x = optimizer.ask()
    optimizer.tell(x, {{"f": x["x"], "g": (1.0 - x["x"]) ** 2}})
assert optimizer.hypervolume > 3.0, optimizer.hypervolume
"""
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr


def test_the_core_imports_nothing_of_the_packages_around_it() -> None:
    for path in CORE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom):
                assert node.level <= 1, f"{path.name} imports from outside the core"
                names = [node.module or ""]
            elif isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            else:
                continue
            for name in names:
                package = name.split(".")[0]
                assert package not in (*ROS_PACKAGES, "torch", "awa_sim_node"), path
                assert package != "mobo_tuner" or name.startswith("mobo_tuner.core"), path

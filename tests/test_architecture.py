"""The house rules that a reader of one file cannot see: what may import what."""

from __future__ import annotations

import ast
import subprocess
import sys
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import awa_sim_node
import mobo_tuner

PACKAGE = Path(mobo_tuner.__file__).parent
SIMULATOR = Path(awa_sim_node.__file__).parent
ROS_PACKAGES = ("rclpy", "rcl_interfaces", "mobo_msgs_py", "std_msgs", "builtin_interfaces")
# From the bottom to the top: each imports itself and those before it.
LAYERS = ("core", "ros", "machine", "bridge", "runs", "tuner", "client", "displays", "nodes")
WITHOUT_ROS = ("core", "runs")


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


def imports(path: Path) -> set[str]:
    """Every module that a file names in an import, also where only types are checked."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path} has a relative import"
            assert node.module
            names |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
        elif isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
    return names


def module_name(path: Path) -> str:
    """Of a file of the package, with its dots."""
    name = ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts)
    return name.removesuffix(".__init__")


def test_what_knows_no_ros_imports_none() -> None:
    for layer in WITHOUT_ROS:
        for path in (PACKAGE / layer).rglob("*.py"):
            foreign = {name.split(".")[0] for name in imports(path)} & {*ROS_PACKAGES}
            assert not foreign, f"{path} imports {foreign}"


def test_each_layer_imports_only_those_below_it() -> None:
    assert {p.parent.name for p in PACKAGE.glob("*/__init__.py")} == {*LAYERS}
    for path in PACKAGE.glob("*/*.py"):
        layer = LAYERS.index(path.parent.name)
        for name in imports(path):
            package, *rest = name.split(".")
            assert package not in ("awa_sim_node", "torch"), f"{path} imports {name}"
            if package == "mobo_tuner" and rest and rest[0] in LAYERS:
                assert LAYERS.index(rest[0]) <= layer, f"{path} imports {name}"


def test_modules_import_each_other_in_one_direction() -> None:
    modules = {module_name(path): path for path in PACKAGE.rglob("*.py")}
    graph = {
        name: {other for other in imports(path) if other in modules and other != name}
        for name, path in modules.items()
    }
    # An __init__ that offers what its modules make is no more than another name for them.
    graph = {name: found for name, found in graph.items() if modules[name].stem != "__init__"}
    assert len(graph) > 50
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        raise AssertionError("a circle of imports: " + " -> ".join(error.args[1])) from None


def test_the_simulated_machine_works_without_the_simulation_and_what_that_needs() -> None:
    program = """
import sys
class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.startswith(("awa_sim_node.simulation", "scipy", "numba")):
            raise ModuleNotFoundError(name + " must not be imported")
sys.meta_path.insert(0, Absent())
import awa_sim_node.node
from awa_sim_node.surrogate import Surrogate
from awa_sim_node.surrogate.metadata import INPUTS
middle = {q.name: sum(q.training_range) / 2.0 for q in INPUTS}
assert Surrogate.load().predict(middle)["energy"] > 10.0
"""
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr


def test_the_simulation_needs_neither_ros_nor_torch() -> None:
    program = f"""
import sys
class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {(*ROS_PACKAGES, "torch", "mobo_tuner")!r}:
            raise ModuleNotFoundError(name + " must not be imported")
sys.meta_path.insert(0, Absent())
from awa_sim_node.simulation import injector, table
settings = injector.Settings(475.0, 230.0, -5.0, -5.0, 67.5, 0.0, charge=0.0)
(beam,) = injector.Injector(settings).track([0.5], injector.Resolution(particles=50))
assert 6.9 < beam.energy < 7.3, beam
"""
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr


def test_only_training_may_import_the_simulation() -> None:
    for path in SIMULATOR.rglob("*.py"):
        name = path.relative_to(SIMULATOR)
        if name.parts[0] != "simulation" and name != Path("surrogate", "train.py"):
            found = {module for module in imports(path) if "simulation" in module.split(".")}
            assert not found, f"{path} imports {found}"

"""The house rules that a reader of one file cannot see: what may import what."""

from __future__ import annotations

import ast
import functools
import subprocess
import sys
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

import awa_sim_node
import mobo_tuner
from mobo_tuner.core import Problem

PACKAGE = Path(mobo_tuner.__file__).parent
SIMULATOR = Path(awa_sim_node.__file__).parent
ROS_PACKAGES = ("rclpy", "rcl_interfaces", "mobo_msgs_py", "std_msgs", "builtin_interfaces")
ROOT = Path(__file__).resolve().parents[1]
# What each room of the package may import besides itself; all may import the modules beside the rooms.
ROOMS = {
    "core": (),
    "ros": (),
    "machine": ("ros",),
    "bridge": ("ros", "machine"),
    "runs": ("core",),
    "tuner": ("core", "ros", "runs"),
    "offline": ("core", "runs", "tuner"),
    "client": ("core", "ros", "runs"),
    "displays": ("core", "machine", "client"),
    "page": ("core", "ros", "client", "displays"),
    "nodes": (
        "core",
        "ros",
        "machine",
        "bridge",
        "runs",
        "tuner",
        "offline",
        "client",
        "displays",
        "page",
    ),
}
WITHOUT_ROS = ("core", "runs", "offline")
# Modules of others that are not made for everybody, and the one module that may use each.
WRAPPED = {
    "rosbags.rosbag2.storage_mcap": "mobo_tuner/runs/bag.py",
    "rosbags.rosbag2.metadata": "mobo_tuner/runs/bag.py",
    "rclpy.impl.implementation_singleton": "mobo_tuner/ros/lifecycle.py",
    "rosbag2_py._storage": "mobo_tuner/nodes/bags.py",
}
PUBLIC = {"_asdict", "_exit", "_fields", "_make", "_replace"}  # in spite of their underscore
SHIPPED = [  # files of the packages and of the entry script
    *PACKAGE.rglob("*.py"),
    *SIMULATOR.rglob("*.py"),
    *(ROOT / "launcher").rglob("*.py"),
    *(ROOT / "tools").rglob("*.py"),
    ROOT / "mobo.py",
]


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


@functools.cache
def parsed(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


@functools.cache
def imports(path: Path) -> frozenset[str]:
    """Every module that a file names in an import, also where only types are checked."""
    names = set()
    for node in ast.walk(parsed(path)):
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path} has a relative import"
            assert node.module
            names |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
        elif isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
    return frozenset(names)


def module_name(path: Path) -> str:
    """Of a file of the package, with its dots."""
    name = ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts)
    return name.removesuffix(".__init__")


def test_what_knows_no_ros_imports_none() -> None:
    for layer in WITHOUT_ROS:
        for path in (PACKAGE / layer).rglob("*.py"):
            foreign = {name.split(".")[0] for name in imports(path)} & {*ROS_PACKAGES}
            assert not foreign, f"{path} imports {foreign}"


def rooms_of(names: frozenset[str]) -> set[str]:
    """The rooms of the package that some modules are in."""
    parts = [name.split(".") for name in names if name.startswith("mobo_tuner.")]
    return {part[1] for part in parts if part[1] in ROOMS}


def test_each_room_imports_only_those_below_it() -> None:
    assert {p.parent.name for p in PACKAGE.glob("*/__init__.py")} == {*ROOMS}
    for room, below in ROOMS.items():
        for path in (PACKAGE / room).rglob("*.py"):
            found = imports(path)
            assert rooms_of(found) <= {room, *below}, f"{path} imports {rooms_of(found)}"
            assert not {n.split(".")[0] for n in found} & {"awa_sim_node", "torch"}, path


def test_what_stands_beside_the_rooms_imports_none_of_them() -> None:
    for path in {*PACKAGE.glob("*.py")} - {PACKAGE / "warmup.py"}:
        assert not rooms_of(imports(path)), path


def test_the_core_reads_no_files_but_a_problem_from_yaml() -> None:
    for path in (PACKAGE / "core").rglob("*.py"):
        found = imports(path)
        assert "yaml" not in found, path
        assert "mobo_tuner.files" not in found or path.name == "problem.py", path


def test_the_simulator_imports_the_machines_side_alone() -> None:
    for path in SIMULATOR.rglob("*.py"):
        assert rooms_of(imports(path)) <= {"machine", "ros"}, path


def test_the_package_knows_no_machine_by_name() -> None:
    quantities = set(Problem.from_yaml(ROOT / "config" / "awa.yaml").objective_names)
    assert quantities >= {"dE", "eps_x"}
    for path in PACKAGE.rglob("*.py"):
        values = {node.value for node in ast.walk(parsed(path)) if isinstance(node, ast.Constant)}
        assert not quantities & {v for v in values if isinstance(v, str)}, path


def is_private(name: str) -> bool:
    return name.startswith("_") and not name.endswith("__") and name not in PUBLIC


def private_uses(tree: ast.AST) -> list[str]:
    """Private names of other modules, and private attributes of objects of other classes."""
    found = []
    own: dict[ast.AST, set[str]] = {}  # private names that the class around a node defines
    for outer in ast.walk(tree):
        if isinstance(outer, ast.ClassDef):
            names = {_own_attribute(n) for n in ast.walk(outer)} - {""}
            names |= {n.name for n in outer.body if isinstance(n, ast.FunctionDef)}
            names |= {n.name for n in outer.body if isinstance(n, ast.AsyncFunctionDef)}
            for inner in ast.walk(outer):
                own[inner] = names
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom):
            parts = [*(node.module or "").split("."), *(alias.name for alias in node.names)]
            found += [part for part in parts if is_private(part) and part != "__future__"]
        elif isinstance(node, ast.Import):
            found += [part for a in node.names for part in a.name.split(".") if is_private(part)]
        elif (
            isinstance(node, ast.Attribute)
            and is_private(node.attr)
            and not _own_attribute(node)
            and node.attr not in own.get(node, set())
        ):
            found.append(ast.unparse(node))
    return found


def _own_attribute(node: ast.AST) -> str:
    """Name of an attribute of `self` or `cls`; empty for anything else."""
    if (
        isinstance(node, ast.Attribute)
        and isinstance(node.value, ast.Name)
        and node.value.id in ("self", "cls")
    ):
        return node.attr
    return ""


def test_private_names_stay_in_their_module_and_class() -> None:
    for path in SHIPPED:
        found = private_uses(parsed(path))
        wrapped = {name.split(".")[-1] for name, by in WRAPPED.items() if path.match(by)}
        assert not {*found} - wrapped, f"{path} uses {found}"


@pytest.mark.parametrize(
    "code",
    [
        "from a import _b",
        "import a._b",
        "from a._b import c",
        "a._b()",
        "class A:\n def f(self, other): return other._x",
    ],
)
def test_a_private_use_is_found(code: str) -> None:
    assert private_uses(ast.parse(code))
    assert not private_uses(
        ast.parse("class A:\n def f(self, other): self._x = other._x; return point._asdict()")
    )


def test_what_others_may_change_is_used_in_one_module() -> None:
    users = {
        (name, path.relative_to(PACKAGE.parent).as_posix())
        for path in PACKAGE.rglob("*.py")
        for name in WRAPPED
        if name in imports(path)
    }
    assert users == {*WRAPPED.items()}


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

"""What the ament_python packages hold, whether pip or colcon installs them."""

from __future__ import annotations

import ast
import email
import importlib.metadata
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path
from xml.etree import ElementTree

import pytest

from launcher.environment import clean_environment

SOURCE = Path(__file__).resolve().parents[2] / "src"
MOBO_TUNER = SOURCE / "mobo_tuner" / "mobo_tuner"
EXECUTABLES = {
    "mobo_tuner": [
        "console",
        "live_server",
        "machine_bridge",
        "page",
        "recorder",
        "steer",
        "tuner",
    ],
    "awa_sim_node": ["awa_sim"],
}


@pytest.fixture(scope="module")
def wheels(tmp_path_factory: pytest.TempPathFactory) -> dict[str, zipfile.ZipFile]:
    """A wheel of each package, built from a copy as the entry script does."""
    folder = tmp_path_factory.mktemp("project")
    ignored = shutil.ignore_patterns("__pycache__", "build", "*.egg-info")
    shutil.copytree(SOURCE, folder / "src", ignore=ignored)
    built = {}
    for package in EXECUTABLES:
        subprocess.run(
            [
                *(sys.executable, "-m", "pip", "wheel", "--quiet", "--no-index", "--no-deps"),
                *("--no-build-isolation", "--wheel-dir", str(folder), f"./src/{package}"),
            ],
            cwd=folder,
            env=clean_environment(PIP_DISABLE_PIP_VERSION_CHECK="1"),
            check=True,
            timeout=100,
        )
        (wheel,) = folder.glob(f"{package}-*.whl")
        built[package] = zipfile.ZipFile(wheel)
    return built


@pytest.mark.parametrize("package", EXECUTABLES)
def test_ros_finds_the_package(wheels: dict[str, zipfile.ZipFile], package: str) -> None:
    names = wheels[package].namelist()
    data = f"{package}-1.0.0.data/data"
    assert f"{data}/share/ament_index/resource_index/packages/{package}" in names
    assert f"{data}/share/{package}/package.xml" in names
    assert f"{package}/py.typed" in names
    for name in EXECUTABLES[package]:
        wrapper = wheels[package].getinfo(f"{data}/lib/{package}/{name}")
        assert wrapper.external_attr >> 16 & 0o111 == 0o111


@pytest.mark.parametrize("package", EXECUTABLES)
def test_every_source_file_is_packed(wheels: dict[str, zipfile.ZipFile], package: str) -> None:
    names = wheels[package].namelist()
    for path in (SOURCE / package / package).rglob("*"):
        if path.is_file() and "__pycache__" not in path.parts:
            assert str(path.relative_to(SOURCE / package)) in names


@pytest.mark.parametrize("package", EXECUTABLES)
def test_every_executable_leads_to_a_main(wheels: dict[str, zipfile.ZipFile], package: str) -> None:
    text = wheels[package].read(f"{package}-1.0.0.dist-info/entry_points.txt").decode()
    scripts = dict(re.findall(r"^(\S+) = ([\w.]+):main$", text, flags=re.MULTILINE))
    assert sorted(scripts) == EXECUTABLES[package]
    for module in scripts.values():
        source = SOURCE / package / f"{module.replace('.', '/')}.py"
        assert "\ndef main(" in source.read_text()


def test_the_configurations_are_shared(wheels: dict[str, zipfile.ZipFile]) -> None:
    names = wheels["mobo_tuner"].namelist()
    for path in (SOURCE.parent / "config").glob("*.yaml"):
        assert f"mobo_tuner-1.0.0.data/data/share/mobo_tuner/config/{path.name}" in names


def test_all_packages_have_one_version() -> None:
    versions = {
        ElementTree.parse(path).findtext("version") for path in SOURCE.glob("*/package.xml")
    }
    with (SOURCE / "mobo_msgs_py" / "pyproject.toml").open("rb") as file:
        versions.add(tomllib.load(file)["project"]["version"])
    assert versions == {"1.0.0"}


# ------------------------------------------------------------------ imports and what is declared

MODULES = {
    "Jinja2": "jinja2",
    "MarkupSafe": "markupsafe",
    "PyYAML": "yaml",
    "backports.zstd": "backports",
    "foxglove-sdk": "foxglove",
    "gest-api": "gest_api",
}
"""Top-level module of each package of PyPI whose name differs."""
ROSDEP = {
    "jinja2": "python3-jinja2",
    "matplotlib": "python3-matplotlib",
    "numba": "python3-numba",
    "numpy": "python3-numpy",
    "rich": "python3-rich",
    "rosbags": "python3-rosbags-pip",
    "scipy": "python3-scipy",
    "yaml": "python3-yaml",
}
"""rosdep's key of each module."""
WITHOUT_KEY = {
    "threadpoolctl": "python3-threadpoolctl",
    "pyarrow": "pip install pyarrow",
    "simpleeval": 'pip install "simpleeval>=1.0.5"',
    "torch": "awa_sim_node[training]",
    "nicegui": "pip install nicegui==3.18.0",
    "foxglove": "pip install foxglove-sdk==0.30.3",
    "gest_api": "pip install gest-api==0.2",
    "libensemble": "libensemble==1.6.1",
}
"""How each is installed, in README.md of the package."""
WITH_OTHERS = {  # rosbags, Jinja2 and NiceGUI require them
    *("backports", "lz4", "markupsafe", "fastapi", "starlette", "uvicorn"),
}
# Which extra a part of a package needs; the longest prefix counts, nothing is needed without one.
EXTRA_OF = {
    "mobo_tuner": {
        "core": ["tuner"],
        "tuner": ["tuner"],
        "runs": ["tuner"],
        "runs/bag.py": ["recorder"],
        "runs/bag_messages.py": ["tuner", "recorder"],
        "runs/definitions.py": ["tuner", "recorder"],
        "runs/mcap_records.py": ["tuner", "recorder"],
        "runs/rebuild.py": ["tuner", "recorder"],
        "runs/export.py": ["tuner", "export"],
        "runs/report": ["report"],
        "displays": ["console"],
        "offline": ["tuner", "offline"],
        "nodes/bags.py": ["recorder"],
        "page": ["page"],
        "nodes/recorder.py": ["recorder"],
        "nodes/live_server.py": ["live"],
        "warmup.py": ["tuner"],
    },
    "awa_sim_node": {
        "simulation": ["simulation"],
        "surrogate/network.py": ["training"],
        "surrogate/train.py": ["training"],
    },
}
OF_ROS = {
    "action_msgs",
    "builtin_interfaces",
    "diagnostic_msgs",
    "lifecycle_msgs",
    "mobo_msgs_py",
    "rcl_interfaces",
    "rclpy",
    "rosbag2_py",
    "rosgraph_msgs",
    "rosidl_parser",
    "sensor_msgs",
    "std_msgs",
    "std_srvs",
}


def foreign_imports(path: Path) -> set[str]:
    """Top-level modules that a file imports from outside the standard library and its package."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module:
            names.add(node.module.split(".")[0])
        elif isinstance(node, ast.Import):
            names |= {alias.name.split(".")[0] for alias in node.names}
    return names - sys.stdlib_module_names


def declared(wheel: zipfile.ZipFile, package: str) -> dict[str, set[str]]:
    """Modules that a wheel requires, by extra; "" for those that it always does."""
    text = wheel.read(f"{package}-1.0.0.dist-info/METADATA").decode()
    found: dict[str, set[str]] = {"": set()}
    for line in email.message_from_string(text).get_all("Requires-Dist", []):
        name = re.match(r"[\w.-]+", line)
        extra = re.search(r'extra == "(\w+)"', line)
        assert name
        module = MODULES.get(name[0], name[0])
        found.setdefault(extra[1] if extra else "", set()).add(module)
    return found


def extras_of(package: str, file: str) -> list[str]:
    """The extras that a file of a package needs."""
    fitting = [p for p in EXTRA_OF[package] if file == p or file.startswith(f"{p}/")]
    return EXTRA_OF[package][max(fitting, key=len)] if fitting else []


def test_the_page_is_tied_to_one_version_of_nicegui(wheels: dict[str, zipfile.ZipFile]) -> None:
    metadata = wheels["mobo_tuner"].read("mobo_tuner-1.0.0.dist-info/METADATA").decode()
    pinned = f"nicegui=={importlib.metadata.version('nicegui')}"
    assert f"Requires-Dist: {pinned};" in metadata
    requirements = (SOURCE.parent / "requirements-page.txt").read_text(encoding="utf-8")
    assert pinned in requirements.splitlines()


def test_the_templates_of_the_report_are_there(wheels: dict[str, zipfile.ZipFile]) -> None:
    templates = {path.name for path in (MOBO_TUNER / "runs/report/templates").iterdir()}
    names = {Path(n).name for n in wheels["mobo_tuner"].namelist() if "/report/templates/" in n}
    assert templates == names


@pytest.mark.parametrize("package", EXECUTABLES)
def test_every_import_is_declared_for_pip_and_for_ros(
    wheels: dict[str, zipfile.ZipFile], package: str
) -> None:
    for_pip = declared(wheels[package], package)
    assert for_pip.pop("test") == {"pytest"}  # by which colcon test finds the tests
    manifest = ElementTree.parse(SOURCE / package / "package.xml")
    for_ros = {e.text for e in manifest.iter() if e.tag in ("depend", "exec_depend")}
    for_tests = {e.text for e in manifest.iter() if e.tag == "test_depend"}
    readme = (SOURCE / package / "README.md").read_text(encoding="utf-8")
    used: set[str] = set()
    for path in (SOURCE / package / package).rglob("*.py"):
        file = path.relative_to(SOURCE / package / package).as_posix()
        extras = extras_of(package, file)
        allowed = for_pip[""].union(*(for_pip[extra] for extra in extras))
        names = foreign_imports(path) - {package}
        used |= names
        assert names - OF_ROS <= allowed, f"{file} imports more than setup.py declares"
        for name in names & OF_ROS:
            assert name in for_ros, f"{file} imports {name}; package.xml does not declare it"
        for name in names - OF_ROS - WITH_OTHERS:
            key = ROSDEP.get(name, name)
            known = key in for_ros or (package == "awa_sim_node" and extras and key in for_tests)
            assert known or WITHOUT_KEY.get(name, "nowhere") in readme, (file, name)
    assert set().union(*for_pip.values()) <= used, "setup.py declares what nothing imports"
    keys = {ROSDEP.get(name, name) for name in used}
    # By the files in launch/, which import nothing, and by rosbag2_py.
    launched = {"launch_ros", "launch_xml", "rosbag2_storage_mcap"}
    assert {name for name in for_ros if name} - launched <= keys, (
        "package.xml declares what nothing imports"
    )


def test_the_recorder_is_tied_to_one_version_of_rosbags(wheels: dict[str, zipfile.ZipFile]) -> None:
    metadata = wheels["mobo_tuner"].read("mobo_tuner-1.0.0.dist-info/METADATA").decode()
    pinned = f"rosbags=={importlib.metadata.version('rosbags')}"
    assert re.search(rf"^Requires-Dist: {re.escape(pinned)};", metadata, flags=re.MULTILINE)
    requirements = (SOURCE.parent / "requirements.txt").read_text(encoding="utf-8")
    assert pinned in requirements.splitlines()


def test_the_oldest_versions_allowed_are_those_that_are_tested(
    wheels: dict[str, zipfile.ZipFile],
) -> None:
    lines = (SOURCE.parent / "requirements-oldest.txt").read_text(encoding="utf-8").splitlines()
    tested = dict(re.findall(r"^([\w.-]+)==(\S+)$", "\n".join(lines), flags=re.MULTILINE))
    for package, wheel in wheels.items():
        text = wheel.read(f"{package}-1.0.0.dist-info/METADATA").decode()
        required = re.findall(r"^Requires-Dist: ([\w.-]+)(.*?)(?:;|$)", text, flags=re.MULTILINE)
        for name, bound in required:
            if name in ("mobo_tuner", "pytest", "torch"):  # ours, a tool, unused
                continue
            if name in (
                "foxglove-sdk",
                "gest-api",
                "libensemble",
                "nicegui",
                "rosbags",
            ):  # one version alone
                continue
            assert bound.startswith(">="), f"setup.py of {package} has no lower bound of {name}"
            if name in tested:
                assert f"{tested[name]}.".startswith(f"{bound.removeprefix('>=').strip()}."), name


def test_what_is_tested_with_the_oldest_libraries_is_there() -> None:
    script = (SOURCE.parent / "tools" / "oldest_libraries.sh").read_text(encoding="utf-8")
    tested = re.findall(r"tests/[\w/]+(?:\.py)?", script)
    assert len(tested) > 10
    for path in tested:
        assert (SOURCE.parent / path).exists(), path


def run_without(absent: set[str], program: str) -> None:
    """Run a program in which some modules cannot be imported."""
    hook = f"""
import sys
class Absent:
    def find_spec(self, name, path=None, target=None):
        if any(name == a or name.startswith(a + ".") for a in {sorted(absent)!r}):
            raise ModuleNotFoundError(name + " must not be imported")
sys.meta_path.insert(0, Absent())
"""
    done = subprocess.run(
        [sys.executable, "-c", hook + program],
        capture_output=True,
        text=True,
        timeout=100,
        check=False,
    )
    assert done.returncode == 0, done.stderr


OPTIONAL = {
    *("numba", "scipy", "threadpoolctl", "torch", "matplotlib", "jinja2", "markupsafe", "pyarrow"),
    *(
        "rosbags",
        "lz4",
        "backports",
        "rich",
        "nicegui",
        "fastapi",
        "starlette",
        "uvicorn",
        "foxglove",
    ),
}
OPTIMISER = {"mobo_tuner.core", "mobo_tuner.runs", "mobo_tuner.tuner"}


def test_the_machines_side_runs_without_the_optimiser() -> None:
    modules = [
        f"mobo_tuner.{path.relative_to(MOBO_TUNER).with_suffix('').as_posix().replace('/', '.')}"
        for room in ("machine", "bridge", "ros")
        for path in (MOBO_TUNER / room).glob("*.py")
    ]
    modules += ["mobo_tuner.nodes.machine_bridge", "awa_sim_node.node"]
    program = "\n".join(f"import {name.removesuffix('.__init__')}" for name in modules)
    program += """
from awa_sim_node.machine import SimulatedMachine
for name in ("awa", "toy"):
    assert SimulatedMachine(name, "ideal", 0).readbacks()
"""
    run_without(OPTIONAL | OPTIMISER, program)


@pytest.mark.parametrize(
    ("node", "extras"),
    [("tuner", {"tuner"}), ("recorder", {"recorder"}), ("console", {"console"})],
)
def test_each_node_starts_with_its_own_extra(
    wheels: dict[str, zipfile.ZipFile], node: str, extras: set[str]
) -> None:
    for_pip = declared(wheels["mobo_tuner"], "mobo_tuner")
    given = set().union(*(for_pip[extra] for extra in extras))
    run_without(OPTIONAL - given, f"import mobo_tuner.nodes.{node}")


def test_the_recorder_needs_no_rosbags_where_ros_has_rosbag2_py() -> None:
    run_without(OPTIONAL, "import mobo_tuner.nodes.recorder")


@pytest.mark.parametrize("package", [*EXECUTABLES, "mobo_msgs_py"])
def test_each_package_can_stand_alone(package: str) -> None:
    folder = SOURCE / package
    assert (folder / "LICENSE").read_bytes() == (SOURCE.parent / "LICENSE").read_bytes()
    changelog = (folder / "CHANGELOG.rst").read_text(encoding="utf-8")
    assert changelog.splitlines()[1] == f"Changelog for package {package}"
    readme = (folder / "README.md").read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)#]+)\)", readme):
        assert (folder / target).exists(), target


def test_the_numerics_call_nothing_that_ubuntus_libraries_lack() -> None:
    """SciPy 1.11 has `seed` in place of `rng`, numpy 1.26 has no `trapezoid`."""
    for path in SOURCE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and ast.unparse(node.func).startswith("qmc."):
                assert "rng" not in {keyword.arg for keyword in node.keywords}, path
            if isinstance(node, ast.Attribute):
                assert ast.unparse(node) != "np.trapezoid", path


def test_the_configuration_of_the_project_is_the_packages() -> None:
    assert (SOURCE.parent / "config").resolve() == SOURCE / "mobo_tuner" / "config"


@pytest.mark.parametrize("package", [*EXECUTABLES, "mobo_msgs_py"])
def test_colcon_test_finds_tests_that_pass(package: str) -> None:
    manifest = ElementTree.parse(SOURCE / package / "package.xml")
    needed = {e.text for e in manifest.iter("test_depend")}
    if package == "mobo_msgs_py":
        build = (SOURCE / package / "CMakeLists.txt").read_text(encoding="utf-8")
        assert "ament_add_pytest_test(" in build
        assert "ament_cmake_pytest" in needed
    else:
        assert "python3-pytest" in needed
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-c", "/dev/null", "test"],
        cwd=SOURCE / package,
        capture_output=True,
        text=True,
        timeout=100,
        check=False,
    )
    assert done.returncode == 0, done.stdout
    assert " passed" in done.stdout


@pytest.mark.parametrize("package", [*EXECUTABLES, "mobo_msgs_py"])
def test_each_package_declares_its_quality(package: str) -> None:
    text = (SOURCE / package / "QUALITY_DECLARATION.md").read_text(encoding="utf-8")
    assert "quality level 4" in text
    for target in re.findall(r"\]\(([^)#:]+)\)", text):
        assert (SOURCE / package / target).exists(), target

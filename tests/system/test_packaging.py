"""What the ament_python packages hold, whether pip or colcon installs them."""

from __future__ import annotations

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
EXECUTABLES = {
    "mobo_tuner": ["console", "machine_bridge", "recorder", "steer", "tuner"],
    "awa_sim_node": ["awa_sim"],
}


@pytest.fixture(scope="module")
def wheels(tmp_path_factory: pytest.TempPathFactory) -> dict[str, zipfile.ZipFile]:
    """A wheel of each package, built from a copy as the entry script does."""
    folder = tmp_path_factory.mktemp("project")
    ignored = shutil.ignore_patterns("__pycache__", "build", "*.egg-info")
    shutil.copytree(SOURCE, folder / "src", ignore=ignored)
    shutil.copytree(SOURCE.parent / "config", folder / "config")
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
    data = f"{package}-0.1.0.data/data"
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
    text = wheels[package].read(f"{package}-0.1.0.dist-info/entry_points.txt").decode()
    scripts = dict(re.findall(r"^(\S+) = ([\w.]+):main$", text, flags=re.MULTILINE))
    assert sorted(scripts) == EXECUTABLES[package]
    for module in scripts.values():
        source = SOURCE / package / f"{module.replace('.', '/')}.py"
        assert "\ndef main(" in source.read_text()


def test_the_configurations_are_shared(wheels: dict[str, zipfile.ZipFile]) -> None:
    names = wheels["mobo_tuner"].namelist()
    for path in (SOURCE.parent / "config").glob("*.yaml"):
        assert f"mobo_tuner-0.1.0.data/data/share/mobo_tuner/config/{path.name}" in names


def test_all_packages_have_one_version() -> None:
    versions = {
        ElementTree.parse(path).findtext("version") for path in SOURCE.glob("*/package.xml")
    }
    with (SOURCE / "mobo_msgs_py" / "pyproject.toml").open("rb") as file:
        versions.add(tomllib.load(file)["project"]["version"])
    assert versions == {"0.1.0"}

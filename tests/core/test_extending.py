"""The examples of docs/extending.md, run as a package of one's own that is installed."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from mobo_tuner.core.kernels import KERNELS, Kernel
from mobo_tuner.core.registry import Registry
from mobo_tuner.errors import ParameterError

MANUAL = (Path(__file__).parents[2] / "docs" / "extending.md").read_text(encoding="utf-8")

PROGRAM = """
import json, math
import numpy as np
from mobo_tuner.core import Optimizer, Problem
from mobo_tuner.core.acquisition import ACQUISITION_FUNCTIONS
from mobo_tuner.core.merit import Merit
from mobo_tuner.core.kernels import KERNELS
from mobo_tuner.tuner.parameters import check_tuner, tuner_specs
import yaml

section = yaml.safe_load(SECTION)["/**/tuner"]["ros__parameters"]
values = check_tuner(section)
assert values["maximizer_settings"] == {"points": 500, "spread": 0.1}
(points,) = (s for s in tuner_specs(section) if s.name == "maximizer_settings.points")
assert points.range_text == "1 to 1000000"
assert "matern32" in KERNELS and list(KERNELS)[-1] == "matern32"

problem = Problem.from_dict({
    "variables": {"x": {"min": -2.0, "max": 2.0}, "y": {"min": -2.0, "max": 2.0}},
    "objectives": {"f": {"reference": 4.3}, "g": {"reference": 4.3}},
})
optimizer = Optimizer(problem, seed=1, initial_evaluations=5, **section)
for _ in range(15):
    x = optimizer.ask()
    f, g = (math.hypot(x["x"] - c, x["y"] - c) for c in (1.0, -1.0))
    optimizer.tell(x, {"f": f, "g": g})
assert optimizer.last_source == "model"
assert optimizer.hypervolume > 11.0, optimizer.hypervolume

state = json.loads(json.dumps(optimizer.get_state()))
assert Optimizer.from_state(state).ask() == optimizer.ask()

# The gradient of the acquisition function and the slope of the kernel, by finite differences.
kernel = KERNELS.find("matern32")(2)
r2 = np.linspace(0.1, 4.0, 20)
by_r2 = (kernel.profile(r2 + 1e-6)[0] - kernel.profile(r2 - 1e-6)[0]) / 2e-6
np.testing.assert_allclose(kernel.profile(r2)[1], -2.0 * by_r2, rtol=1e-6)
function = Merit(optimizer.archive, optimizer.settings, 0).acquisition_function()
at = np.random.default_rng(0).uniform(-0.6, 0.6, (30, 2))
value, gradient = function.log_value_with_gradient(at)
step = 1e-6 * np.eye(2)
up, down = (np.stack([function.log_value(at + s * e) for e in step], axis=1) for s in (1, -1))
smooth = np.isfinite(up).all(axis=1) & np.isfinite(down).all(axis=1) & np.isfinite(value)
assert smooth.sum() > 3
slope = (up[smooth] - down[smooth]) / 2e-6
np.testing.assert_allclose(gradient[smooth], slope, rtol=1e-4, atol=1e-4)
"""


def installed(folder: Path, module: str, entry_points: str) -> dict[str, str]:
    """Put a module and the metadata of its package into a folder; return the environment."""
    (folder / "my_method.py").write_text(module, encoding="utf-8")
    metadata = folder / "my_method-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: my-method\nVersion: 1.0\n")
    (metadata / "entry_points.txt").write_text(entry_points)
    path = os.pathsep.join([str(folder), *filter(None, [os.environ.get("PYTHONPATH")])])
    return {**os.environ, "PYTHONPATH": path}


def test_the_examples_of_the_manual_work_as_an_installed_package(tmp_path: Path) -> None:
    blocks = re.findall(r"^```python (\w+)\n(.*?)^```", MANUAL, flags=re.MULTILINE | re.DOTALL)
    assert [name for name, _ in blocks] == ["kernel", "acquisition", "maximizer"]
    groups = re.findall(r'entry-points\."([\w.]+)"\]\n *(\w+) = "([\w.:]+)"', MANUAL)
    assert len(groups) == 3
    (section,) = re.findall(
        r"^```yaml\n(/\*\*/tuner:.*?)^```", MANUAL, flags=re.MULTILINE | re.DOTALL
    )
    environment = installed(
        tmp_path,
        "\n\n".join(code for _, code in blocks),
        "\n".join(f"[{group}]\n{name} = {target}" for group, name, target in groups),
    )
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", f"SECTION = {section!r}\n{PROGRAM}"],
        env=environment,
        capture_output=True,
        text=True,
        timeout=100,
        check=False,
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("module", "target", "words"),
    [
        ("", "my_method:Absent", "AttributeError"),
        ("1 / 0", "my_method:Kernel", "ZeroDivisionError"),
        ("Kernel = int", "my_method:Kernel", "must be a Kernel"),
        ("Kernel = 3", "my_method:Kernel", "must be a Kernel"),
    ],
)
def test_a_package_that_cannot_be_loaded_is_named_in_one_sentence(
    tmp_path: Path, module: str, target: str, words: str
) -> None:
    environment = installed(tmp_path, module, f"[mobo_tuner.kernels]\nmine = {target}\n")
    program = (
        "from mobo_tuner.core.settings import make_settings\n"
        "try:\n"
        "    make_settings('default', {'kernel': 'mine'})\n"
        "except ValueError as error:\n"
        "    print(type(error).__name__, error)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program],
        env=environment,
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    assert done.stdout.startswith("ProblemError kernel is 'mine'")
    assert words in done.stdout
    assert done.stdout.count("\n") == 1


def test_a_class_of_another_kind_cannot_be_registered() -> None:
    registry = Registry[Kernel]("kernel", "nothing.of.this.name", Kernel)
    with pytest.raises(ParameterError, match="must be a Kernel"):
        registry.register("number")(int)
    with pytest.raises(ParameterError, match="kernel is 'number'"):
        registry.find("number")
    assert list(registry) == []
    assert len(KERNELS) == len(list(KERNELS))

"""What the machines say about themselves, and the toy problem."""

from __future__ import annotations

import math
import subprocess
import sys

import pytest

from awa_sim_node.machine import MODEL_NAMES, Mode, describe
from awa_sim_node.machine.models import AwaModel, Model, ToyModel, create_model
from awa_sim_node.surrogate import Surrogate, metadata


def test_awa_has_the_limits_of_the_paper() -> None:
    limits = {v.name: (v.minimum, v.maximum, v.unit) for v in describe("awa").variables}
    assert limits == {
        "K1": (400.0, 550.0, "A"),
        "K2": (180.0, 280.0, "A"),
        "phi1": (-10.0, 0.0, "deg"),
        "phi2": (-10.0, 0.0, "deg"),
        "G1": (60.0, 75.0, "MV/m"),
        "G2": (15.0, 25.0, "MV/m"),
    }


def test_awa_measures_the_objectives_and_more() -> None:
    units = {d.name: d.unit for d in describe("awa").diagnostics}
    assert units == {
        "sigma_x": "mm",
        "sigma_y": "mm",
        "sigma_z": "mm",
        "eps_x": "mm mrad",
        "eps_y": "mm mrad",
        "eps_z": "mm mrad",
        "dE": "MeV",
        "energy": "MeV",
        "transmission": "",
        "charge": "nC",
    }


@pytest.mark.parametrize("model", [AwaModel, ToyModel])
def test_a_model_speaks_of_the_same_names_throughout(model: type[Model]) -> None:
    description = model.description
    assert {variable.name for variable in description.variables} <= set(model.kinds)
    assert set(model.ranges) <= set(model.kinds)
    assert {name for image in model.images for name in image} <= set(model.noise)
    assert set(model.modes) == set(Mode)
    assert set(model.noise) == {diagnostic.name for diagnostic in description.diagnostics}
    for variable in description.variables:
        assert variable.minimum <= variable.initial <= variable.maximum
        assert description.variable(variable.name) is variable
    for diagnostic in description.diagnostics:
        assert description.diagnostic(diagnostic.name) is diagnostic


@pytest.mark.parametrize("name", MODEL_NAMES)
def test_a_model_gives_every_diagnostic(name: str) -> None:
    model = create_model(name)
    initial = {variable.name: variable.initial for variable in model.description.variables}
    values = model.true_values(initial)
    assert set(values) == {diagnostic.name for diagnostic in model.description.diagnostics}
    assert all(math.isfinite(value) for value in values.values())


@pytest.mark.parametrize(
    ("x", "expected"),
    [
        ((1.0, 1.0), (0.0, 2.0 * math.sqrt(2.0), 1.0)),
        ((-1.0, -1.0), (2.0 * math.sqrt(2.0), 0.0, -1.0)),
        ((0.0, 0.0), (math.sqrt(2.0), math.sqrt(2.0), 0.0)),
        ((-2.0, 2.0), (math.sqrt(10.0), math.sqrt(10.0), -2.0)),
    ],
)
def test_toy_is_exact(x: tuple[float, float], expected: tuple[float, float, float]) -> None:
    values = ToyModel().true_values({"x1": x[0], "x2": x[1]})
    assert (values["f1"], values["f2"], values["g"]) == pytest.approx(expected, abs=1e-15)


def test_the_machine_stays_within_what_the_surrogate_knows() -> None:
    for quantity in metadata.INPUTS:
        assert quantity.training_range[0] <= quantity.machine_limits[0]
        assert quantity.machine_limits[1] <= quantity.training_range[1]


@pytest.mark.parametrize("name", ["", "AWA", "lhc"])
def test_an_unknown_machine_is_refused(name: str) -> None:
    with pytest.raises(ValueError, match=rf"^machine = '{name}' must be one of awa, toy$"):
        describe(name)
    with pytest.raises(ValueError, match=r"must be one of awa, toy$"):
        create_model(name)


def test_a_machine_needs_no_torch() -> None:
    code = (
        "import sys; sys.modules['torch'] = None\n"
        "from awa_sim_node.machine.models import create_model\n"
        "model = create_model('awa')\n"
        "assert model.true_values({v.name: v.initial for v in model.description.variables})\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


def test_the_surrogate_says_how_uncertain_it_is_and_the_toy_is_exact() -> None:
    awa = create_model("awa")
    inputs = {variable.name: variable.initial for variable in awa.description.variables}
    spread = awa.spread(inputs | {"charge": 41.0})
    assert spread == Surrogate.load().spread(inputs | {"charge": 41.0})
    assert {d.name for d in awa.description.diagnostics} == set(spread) | {"charge"}
    assert create_model("toy").spread({"x1": 0.0, "x2": 0.0}) == {}

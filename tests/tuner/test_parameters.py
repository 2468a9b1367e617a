"""The method in the tuner's section: every choice by its own name, presets as files."""

from __future__ import annotations

from typing import Any

import pytest

from mobo_tuner.core.acquisition_optimizer import ParticleSwarm
from mobo_tuner.core.settings import CHOICES, PRESETS, method_of
from mobo_tuner.errors import UserError
from mobo_tuner.files import load_yaml
from mobo_tuner.parameter_file import node_sections
from mobo_tuner.tuner.parameters import TUNER, check_tuner, tuner_specs
from tests.support.tuner import CONFIG


@pytest.mark.parametrize("name", list(PRESETS))
def test_a_preset_as_a_file_is_the_preset(name: str) -> None:
    content = load_yaml(CONFIG / "presets" / f"{name}.yaml")
    section = node_sections(content)["tuner"]
    assert section.keys() == {*CHOICES}
    assert method_of(check_tuner(section)) == PRESETS[name]
    other = next(preset for preset in PRESETS if preset != name)
    assert method_of(check_tuner({**section, "preset": other})) == PRESETS[name]


@pytest.mark.parametrize("name", list(PRESETS))
def test_what_is_not_given_is_as_the_preset_says(name: str) -> None:
    values = check_tuner({"preset": name})
    assert method_of(values) == PRESETS[name]
    assert values.keys() == {*CHOICES, *(spec.name for spec in TUNER)}
    defaults = {spec.name: spec.default for spec in tuner_specs({"preset": name})}
    assert defaults["kernel"] == PRESETS[name].kernel


def test_choices_replace_those_of_the_preset() -> None:
    section = {
        "preset": "paper",
        "kernel": "matern52_full",
        "beta": "schedule",
        "noise": 1,
        "proximal": [1, 2, 3],
        "maximizer_settings": {"generations": 20},
        "suggestion_seconds": None,
    }
    method = method_of(check_tuner(section))
    assert (method.kernel, method.beta, method.noise) == ("matern52_full", "schedule", 1.0)
    assert method.proximal == (1.0, 2.0, 3.0)
    assert method.make_maximizer() == ParticleSwarm(generations=20)
    assert method.training == "adam"
    another = method_of(check_tuner({"preset": "paper", "maximizer": "multi_start"}))
    assert another.maximizer_settings == PRESETS["default"].maximizer_settings


@pytest.mark.parametrize(
    ("section", "name", "value"),
    [
        ({"preset": "best"}, "tuner.preset", "'best'"),
        ({"preset": 1}, "tuner.preset", "1"),
        ({"kernel": "cubic"}, "tuner.kernel", "'cubic'"),
        ({"maximizer": "climb"}, "tuner.maximizer", "'climb'"),
        ({"maximizer": ["climb"]}, "tuner.maximizer", "['climb']"),
        ({"kernl": "rbf"}, "'kernl' is unknown in tuner", "'kernel'"),
        ({"maximizer_settings": {"population": 5}}, "'maximizer_settings.population'", "unknown"),
        ({"maximizer_settings": {"screened": 0}}, "tuner.maximizer_settings.screened", "0"),
        ({"precision": [1.0, 0.0, 0.0, 1.0], "length_scales": 1.0}, "precision", "length_scales"),
        ({"proximal": True}, "tuner.proximal", "True"),
    ],
)
def test_a_mistake_is_named(section: dict[str, Any], name: str, value: str) -> None:
    with pytest.raises(UserError) as error:
        check_tuner(section)
    assert str(error.value).startswith(name)
    assert value in str(error.value)

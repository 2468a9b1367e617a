"""The check that runs before anything starts: every mistake one sentence, and exit status 2."""

from __future__ import annotations

import copy
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

from awa_sim_node.check_config import check
from mobo_tuner.errors import UserError
from mobo_tuner.files import load_yaml

CONFIG = Path(__file__).parents[2] / "config"
SHIPPED = sorted(
    {path.name for path in CONFIG.glob("*.yaml")} - {p.name for p in CONFIG.glob("bridge_*")}
)


@pytest.fixture
def config() -> dict[str, Any]:
    return copy.deepcopy(load_yaml(CONFIG / "awa.yaml"))


@pytest.mark.parametrize("name", SHIPPED)
def test_every_shipped_configuration_is_good(name: str) -> None:
    assert check(str(CONFIG / name)).objectives


@pytest.mark.parametrize(
    ("section", "path", "value", "sentence"),
    [
        ("/**", "variables.K1.min", 300.0, "variables.K1.min is 300 A, outside the machine's"),
        ("/**", "constraints.halo", {"max": 1.0}, "constraint 'halo' is not measured"),
        ("/**", "objectives.dE.truncation", [0.0, 0.52], "outside its truncation box"),
        ("/**", "objectives.dE.truncation", [0.9, 0.5], "upside down"),
        ("/**", "variables.K1.unit", "mA", "the unit of the variable 'K1'"),
        ("/**", "tuner", {}, "'tuner' is unknown in the problem"),
        ("tuner", "sede", 1, "'sede' is unknown in tuner"),
        ("tuner", "seed", 1.5, "tuner.seed must be a whole number, not 1.5"),
        ("tuner", "seed", -1, "tuner.seed is -1; 0 to 2147483647 is allowed"),
        ("tuner", "preset", "best", "tuner.preset is 'best'; allowed are default, paper"),
        ("awa_sim", "model", "lcls", "awa_sim.model is 'lcls'; allowed are"),
        ("awa_sim", "speed", 0, "awa_sim.speed is 0"),
        ("awa_sim", "speed", "fast", "awa_sim.speed must be a number, not 'fast'"),
        ("awa_sim", "mode", "awful", "awa_sim.mode is 'awful'; allowed are ideal, nominal, rough"),
        ("awa_sim", "jitter_charge", 0.6, "awa_sim.jitter_charge is 0.6; 0 to 0.5 is allowed"),
        ("awa_sim", "interlock_shots", 1.5, "awa_sim.interlock_shots must be a whole number"),
        ("awa_sim", "trip_recovery_min", 90, "awa_sim.trip_recovery_min = 90 must be at most"),
        ("awa_sim", "speed", True, "awa_sim.speed must be a number, not True"),
    ],
)
def test_a_mistake_is_named_in_one_sentence(
    config: dict[str, Any], tmp_path: Path, section: str, path: str, value: Any, sentence: str
) -> None:
    branch = config[section]["ros__parameters"]
    *parents, leaf = path.split(".")
    for key in parents:
        branch = branch[key]
    branch[leaf] = value
    file = tmp_path / "bad.yaml"
    file.write_text(yaml.safe_dump(config))
    with pytest.raises(UserError, match=sentence) as error:
        check(str(file))
    assert "\n" not in str(error.value)


def test_an_unknown_section_is_named(config: dict[str, Any], tmp_path: Path) -> None:
    config["tunner"] = config.pop("tuner")
    file = tmp_path / "bad.yaml"
    file.write_text(yaml.safe_dump(config))
    with pytest.raises(UserError, match="the section 'tunner' is unknown"):
        check(str(file))


def test_the_command_says_it_and_exits_with_2(tmp_path: Path) -> None:
    file = tmp_path / "bad.yaml"
    file.write_text("a: 1")
    done = subprocess.run(
        [sys.executable, "-m", "awa_sim_node.check_config", str(file)],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 2
    assert done.stdout == ""
    assert "lacks the section '/**'" in done.stderr
    assert done.stderr.count("\n") == 1

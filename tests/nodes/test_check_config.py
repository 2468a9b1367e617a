"""The check that runs before anything starts: every mistake one sentence, and exit status 2."""

from __future__ import annotations

import copy
import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

from mobo_tuner.displays.configuration import Configuration
from mobo_tuner.errors import UserError
from mobo_tuner.files import load_yaml
from mobo_tuner.machine.description import DescriptionError, MachineDescription, VariableLimits
from mobo_tuner.nodes import check_config
from mobo_tuner.nodes.check_config import copy_to, describe_by

CONFIG = Path(__file__).parents[2] / "config"
SHIPPED = {
    "awa.yaml": "awa_sim",
    "toy.yaml": "awa_sim",
    "shift.yaml": "awa_sim",
    "derived.yaml": "awa_sim",
    "prior.yaml": "awa_sim",
    "safe.yaml": "awa_sim",
    "context.yaml": "awa_sim",
    "foreign.yaml": "machine_bridge",
    "laboratory.yaml": "machine_bridge",
    "my_machine.yaml": "",
    "campaign.yaml": "",
    "fidelity.yaml": "",
}
MODULES = {"awa_sim": "awa_sim_node.describe", "machine_bridge": "mobo_tuner.bridge.describe"}
MACHINES = {section: describe_by(module) for section, module in MODULES.items()}


def check(path: Path, **options: Any) -> Configuration:
    return check_config.check(path, MACHINES, **options)


def written(content: object, path: Path) -> Path:
    path.write_text(yaml.safe_dump(content))
    return path


@pytest.fixture
def config() -> dict[str, Any]:
    return copy.deepcopy(load_yaml(CONFIG / "awa.yaml"))


def test_every_shipped_file_is_good_and_chooses_its_machine() -> None:
    others = {"analyzers.yaml", *(path.name for path in CONFIG.glob("bridge_*"))}
    assert {path.name for path in CONFIG.glob("*.yaml")} - others == {*SHIPPED}
    for name, section in SHIPPED.items():
        configuration = check(CONFIG / name)
        assert configuration.problem.objectives
        assert configuration.section == section
        assert (configuration.machine is None) == (not section)
        assert bool(configuration.simulation) == (name in ("campaign.yaml", "fidelity.yaml"))


def test_a_check_needs_none_of_what_the_models_need() -> None:
    """Every run begins with one, and these take longer to import than all the rest of it."""
    program = """
import sys
from mobo_tuner.nodes.check_config import main
assert main() == 0
print(*({"numba", "scipy", "matplotlib"} & set(sys.modules)))
"""
    done = subprocess.run(
        [
            sys.executable,
            "-c",
            program,
            str(CONFIG / "toy.yaml"),
            "--machine-node=awa_sim=awa_sim_node.describe",
        ],
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    assert done.stdout.splitlines()[1:] == [""]


def test_a_function_of_a_campaign_is_a_simulation(tmp_path: Path) -> None:
    content = load_yaml(CONFIG / "fidelity.yaml")
    name = next(name for name in content if name.endswith("campaign"))
    content[name]["ros__parameters"] |= {"command": "", "function": "beam.py:simulate"}
    path = written(content, tmp_path / "beam.yaml")
    with pytest.raises(UserError, match=r"campaign\.function .*no file 'beam\.py'"):
        check(path)
    (tmp_path / "beam.py").touch()
    assert check(path).simulation == "beam.py:simulate"


@pytest.mark.parametrize(
    ("section", "path", "value", "sentence"),
    [
        ("/**", "variables.K1.min", 300.0, "variables.K1.min is 300 A, outside the machine's"),
        ("/**", "constraints.halo", {"max": 1.0}, "constraint 'halo' is not measured"),
        ("/**", "objectives.dE.truncation", [0.0, 0.52], "outside its truncation box"),
        ("/**", "objectives.dE.truncation", [0.9, 0.5], "upside down"),
        ("/**", "variables.K1.unit", "mA", "the unit of the variable 'K1'"),
        ("/**", "tuner", {}, "'tuner' is unknown in the problem"),
        ("/**", "fidelity", {"s": {"choices": [1.0, 2.0]}, "cost": "s"}, "'fidelity' is given"),
        ("tuner", "sede", 1, "'sede' is unknown in tuner"),
        ("tuner", "kernel", "cubic", "tuner.kernel is 'cubic'; allowed are rbf"),
        ("tuner", "beta", "big", "tuner.beta is 'big'"),
        ("tuner", "acquisition", "ei", "acquisition is 'ei'.*weights must be given"),
        ("tuner", "length_scales", [1.0, 2.0], "length_scales must be one number or 6"),
        ("tuner", "maximizer_settings", {"screen": 5}, "'maximizer_settings.screen' is unknown"),
        ("tuner", "maximizer_settings", 5, "'maximizer_settings' is unknown"),
        ("tuner", "seed", 1.5, "tuner.seed must be an integer, not 1.5"),
        ("tuner", "seed", -1, "tuner.seed is -1; 0 to 2147483647 is allowed"),
        ("tuner", "preset", "best", "tuner.preset is 'best'; allowed are default, paper"),
        ("awa_sim", "model", "lcls", "awa_sim.model is 'lcls'; allowed are"),
        ("awa_sim", "speed", 0, "awa_sim.speed is 0"),
        ("awa_sim", "speed", "fast", "awa_sim.speed must be a number, not 'fast'"),
        ("awa_sim", "mode", "awful", "awa_sim.mode is 'awful'; allowed are ideal, nominal, rough"),
        ("awa_sim", "jitter_charge", 0.6, "awa_sim.jitter_charge is 0.6; 0 to 0.5 is allowed"),
        ("awa_sim", "interlock_shots", 1.5, "awa_sim.interlock_shots must be an integer"),
        ("awa_sim", "trip_recovery_min", 90, "awa_sim.trip_recovery_min = 90 must be at most"),
        ("awa_sim", "speed", True, "awa_sim.speed must be a number, not True"),
    ],
)
def test_a_mistake_is_named_in_one_sentence(
    config: dict[str, Any], tmp_path: Path, section: str, path: str, value: Any, sentence: str
) -> None:
    branch = config[section if section == "/**" else f"/**/{section}"]["ros__parameters"]
    *parents, leaf = path.split(".")
    for key in parents:
        branch = branch[key]
    branch[leaf] = value
    with pytest.raises(UserError, match=sentence) as error:
        check(written(config, tmp_path / "bad.yaml"))
    assert "\n" not in str(error.value)


# ------------------------------------------------------------------ which machine


@pytest.fixture
def foreign(tmp_path: Path) -> dict[str, Any]:
    """A parameter file's content with a bridge whose mapping is in another folder."""
    (tmp_path / "mappings").mkdir()
    shutil.copy(CONFIG / "bridge_foreign.yaml", tmp_path / "mappings" / "lab.yaml")
    content = load_yaml(CONFIG / "foreign.yaml")
    content["/**/machine_bridge"]["ros__parameters"]["mapping"] = "mappings/lab.yaml"
    return content


def test_the_mapping_of_a_bridge_is_relative_to_the_parameter_file(
    foreign: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path.parent)
    machine = check(written(foreign, tmp_path / "foreign.yaml")).machine
    assert machine is not None
    assert machine.name == "foreign machine"
    assert machine.variables == {"x1": VariableLimits(-2.0, 2.0), "x2": VariableLimits(-2.0, 2.0)}
    assert machine.files == {"mapping": str(tmp_path / "mappings" / "lab.yaml")}


@pytest.mark.parametrize(
    ("mapping", "named"),
    [("nowhere.yaml", "nowhere.yaml' cannot be read"), ("", "mapping is empty"), (3, "mapping")],
)
def test_a_bridge_without_a_good_mapping_is_refused(
    foreign: dict[str, Any], tmp_path: Path, mapping: object, named: str
) -> None:
    foreign["/**/machine_bridge"]["ros__parameters"]["mapping"] = mapping
    with pytest.raises(UserError, match=named):
        check(written(foreign, tmp_path / "bad.yaml"))


def test_a_problem_must_fit_the_machine_of_a_bridge(
    foreign: dict[str, Any], tmp_path: Path
) -> None:
    foreign["/**"]["ros__parameters"]["variables"]["x2"]["max"] = 3.0
    with pytest.raises(UserError, match=r"variables.x2.max is 3, outside the machine's limits"):
        check(written(foreign, tmp_path / "bad.yaml"))


def test_the_problem_translated_from_xopt_means_the_same(tmp_path: Path) -> None:
    text = (CONFIG.parent / "docs" / "from_badger_or_xopt.md").read_text(encoding="utf-8")
    vocs = yaml.safe_load("vocs:" + text.split("```\nvocs:")[1].split("```")[0])
    path = tmp_path / "translated.yaml"
    path.write_text(text.split("```yaml\n")[1].split("```")[0], encoding="utf-8")
    configuration = check(path)
    problem = configuration.problem
    bounds = {v.name: [v.minimum, v.maximum] for v in problem.variables}
    assert bounds == vocs["vocs"]["variables"]
    directions = {o.name: o.direction.upper() for o in problem.objectives}
    assert directions == vocs["vocs"]["objectives"]
    references = {o.name: o.reference for o in problem.objectives}
    assert references == vocs["generator"]["reference_point"]
    limits = {c.name: ["LESS_THAN", c.maximum] for c in problem.constraints}
    assert limits == vocs["vocs"]["constraints"]
    assert [o.name for o in problem.observables] == vocs["vocs"]["observables"]
    assert configuration.tuner["evaluations"] == vocs["max_evaluations"]


def test_two_machines_are_refused(foreign: dict[str, Any], tmp_path: Path) -> None:
    file = written(foreign, tmp_path / "file.yaml")
    with pytest.raises(UserError, match=r"'machine_bridge'.*'python mine.py' of --machine"):
        check(file, program="python mine.py")
    assert check(file, program="python mine.py", program_yields=True).section == "machine_bridge"
    both = {**foreign, "/**/awa_sim": {"ros__parameters": {"model": "toy"}}}
    with pytest.raises(UserError, match=r"two machines.*'awa_sim'.*'machine_bridge'"):
        check(written(both, tmp_path / "both.yaml"))


def test_an_unknown_section_is_named(config: dict[str, Any], tmp_path: Path) -> None:
    config["tunner"] = config.pop("/**/tuner")
    file = written(config, tmp_path / "bad.yaml")
    with pytest.raises(UserError, match="the section 'tunner' is unknown; allowed are"):
        check(file)
    del config["/**/awa_sim"]
    file = written(config, tmp_path / "bad.yaml")
    with pytest.raises(UserError, match="'tunner' is unknown; did you mean 'tuner'"):
        check(file, program="python mine.py")


def test_a_program_may_have_a_section_of_its_own(config: dict[str, Any], tmp_path: Path) -> None:
    config["my_machine"] = config.pop("/**/awa_sim")
    file = written(config, tmp_path / "file.yaml")
    configuration = check(file, program="python mine.py")
    assert (configuration.section, configuration.program) == ("", "python mine.py")
    with pytest.raises(UserError, match="'my_machine' is unknown"):
        check(file)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        "{}",
        "null",
        '{"name": "a", "variables": {"x": {"min": "low"}}, "diagnostics": {}}',
    ],
)
def test_what_is_not_a_description_is_refused(text: str) -> None:
    with pytest.raises(DescriptionError):
        MachineDescription.from_json(text)


def test_a_description_is_read_as_it_was_written() -> None:
    machine = MachineDescription(
        "a", {"x": VariableLimits(-1.0, 2.5, "mm")}, {"f": "MeV"}, 0.25, {"mapping": "/lab/m.yaml"}
    )
    assert MachineDescription.from_json(machine.to_json()) == machine


# ------------------------------------------------------------------ copies for a run


def test_a_file_is_copied_byte_by_byte_with_what_stands_beside_it(tmp_path: Path) -> None:
    assert copy_to(tmp_path, check(CONFIG / "foreign.yaml")) == ["bridge_foreign.yaml"]
    for name, original in (("config", "foreign"), ("bridge_foreign", "bridge_foreign")):
        content = (tmp_path / f"{name}.yaml").read_bytes()
        assert content == (CONFIG / f"{original}.yaml").read_bytes()


@pytest.mark.parametrize("elsewhere", ["mappings/lab.yaml", "mappings/config.yaml", "{0}/lab.yaml"])
def test_a_copy_names_the_copies_of_files_from_elsewhere(
    foreign: dict[str, Any], tmp_path: Path, elsewhere: str
) -> None:
    mapping = tmp_path / elsewhere.format(tmp_path)
    shutil.copy(CONFIG / "bridge_foreign.yaml", mapping)
    foreign["/**/machine_bridge"]["ros__parameters"]["mapping"] = elsewhere.format(
        tmp_path / "mappings"
    )
    shutil.copy(CONFIG / "bridge_foreign.yaml", tmp_path / "mappings" / "lab.yaml")
    before = check(written(foreign, tmp_path / "file.yaml"))
    copies = tmp_path / "copies"
    copies.mkdir()
    assert copy_to(copies, before) == ["mapping.yaml"]
    after = check(copies / "config.yaml")
    assert after.machine is not None
    assert after.machine.files == {"mapping": str(copies / "mapping.yaml")}
    assert after.problem == before.problem


# ------------------------------------------------------------------ the program


def run_program(*words: str) -> subprocess.CompletedProcess[str]:
    nodes = [f"--machine-node={section}={module}" for section, module in MODULES.items()]
    return subprocess.run(
        [sys.executable, "-m", "mobo_tuner.nodes.check_config", *nodes, *words],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


def test_the_program_says_what_is_wrong_and_exits_with_2(tmp_path: Path) -> None:
    file = tmp_path / "bad.yaml"
    file.write_text("a: 1")
    for words in ([str(file)], [str(file), "--explain"], [str(tmp_path / "nowhere")]):
        done = run_program(*words)
        assert done.returncode == 2
        assert done.stdout == ""
        assert done.stderr.count("\n") == 1
        assert str(tmp_path) in done.stderr


def test_the_program_tells_a_run_what_it_must_know(tmp_path: Path) -> None:
    done = run_program(str(CONFIG / "foreign.yaml"), f"--copy-to={tmp_path}")
    assert json.loads(done.stdout) == {
        "section": "machine_bridge",
        "machine": "foreign machine",
        "files": ["bridge_foreign.yaml"],
        "on_abort": "hold",
    }
    assert (tmp_path / "config.yaml").exists()

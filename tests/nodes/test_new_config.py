"""Parameter files that are written from what a machine has: they are good, and a run with one begins."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml

from mobo_msgs_py.action import Tune
from mobo_tuner.core.problem import Problem
from mobo_tuner.displays.template import template
from mobo_tuner.errors import UserError
from mobo_tuner.machine.description import MachineDescription, VariableLimits
from mobo_tuner.nodes import new_config
from mobo_tuner.nodes.check_config import check, describe_by
from tests.support.processes import NodeProcess, NodeStarter
from tests.support.tuner import CONFIG, GoalClient

ROOT = CONFIG.parent
MODULES = {"awa_sim": "awa_sim_node.describe", "machine_bridge": "mobo_tuner.bridge.describe"}
MACHINE = MachineDescription(
    name="my\ninjector",
    variables={"K1": VariableLimits(-1.0, 2.0, "A"), "yes": VariableLimits(0.0, 1e-9)},
    diagnostics={"dE": "MeV", "no": "%", "charge": ""},
)


def write(monkeypatch: pytest.MonkeyPatch, path: Path, *arguments: str, expected: int = 0) -> None:
    nodes = [f"--machine-node={name}={module}" for name, module in MODULES.items()]
    monkeypatch.setattr(sys, "argv", ["new_config", str(path), *nodes, *arguments])
    assert new_config.main() == expected


@pytest.mark.parametrize("source", ["awa.yaml", "toy.yaml", "foreign.yaml"])
def test_a_file_like_another_one_is_good(
    source: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "mine.yaml"
    write(monkeypatch, path, f"--like={CONFIG / source}")
    machines = {name: describe_by(module) for name, module in MODULES.items()}
    made, given = check(path, machines), check(CONFIG / source, machines)
    assert made.section == given.section
    assert made.machine is not None
    assert given.machine is not None
    assert made.machine.diagnostics == given.machine.diagnostics
    assert {v.name for v in made.problem.variables} == {*given.machine.variables}
    assert len(made.problem.objectives) == 1
    assert not made.problem.has_references


def test_every_comment_that_is_uncommented_is_good() -> None:
    text = template(MACHINE, minimize=["no"], maximize=["charge"])
    problem = Problem.from_dict(_read(text))
    assert [(o.name, o.direction) for o in problem.objectives] == [
        ("no", "minimize"),
        ("charge", "maximize"),
    ]
    assert problem.variables[1].maximum == 1e-9
    lines = text.replace("    # constraints:", "    constraints:").splitlines()
    lines = [
        line.replace("# ", "", 1) if line.startswith("    #   dE: {") else line for line in lines
    ]
    more = Problem.from_dict(_read("\n".join(lines)))
    assert [o.name for o in more.objectives][-1] == "dE"
    assert [c.name for c in more.constraints] == ["dE"]


def test_ranges_may_be_relative() -> None:
    shares = Problem.from_dict(_read(template(MACHINE, around="10 %")))
    assert [v.around for v in shares.variables] == ["10 %", "10 %"]
    assert Problem.from_dict(_read(template(MACHINE, around="2"))).variables[0].around == 2.0


def _read(text: str) -> dict[str, object]:
    content: dict[str, object] = yaml.safe_load(text)
    return content


@pytest.mark.parametrize(
    ("minimize", "maximize", "name"), [(["eps"], [], "eps"), (["dE"], ["dE"], "dE")]
)
def test_objectives_are_diagnostics(minimize: list[str], maximize: list[str], name: str) -> None:
    with pytest.raises(UserError, match=f"the objective '{name}'"):
        template(MACHINE, minimize=minimize, maximize=maximize)


def test_nothing_is_written_over_a_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text("mine")
    write(monkeypatch, path, f"--like={CONFIG / 'awa.yaml'}", expected=2)
    assert "mine.yaml' exists already" in capsys.readouterr().err
    assert path.read_text() == "mine"
    write(monkeypatch, tmp_path / "a.yaml", f"--like={CONFIG / 'my_machine.yaml'}", expected=2)
    assert "0 sections" in capsys.readouterr().err


def test_a_run_with_the_file_of_a_machine_begins(
    start_node: NodeStarter,
    start_tuner: Callable[..., NodeProcess],
    client: GoalClient,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    write(monkeypatch, tmp_path / "none.yaml", "--timeout=0.3", expected=2)
    assert "no machine answered" in capsys.readouterr().err
    start_node(str(ROOT / "examples" / "my_machine.py"))
    path = tmp_path / "mine.yaml"
    write(monkeypatch, path, "--minimize", "f1", "f2", "--how=--machine 'python mine.py'")
    assert "--config FILE --machine 'python mine.py'" in path.read_text()
    start_tuner("initial_evaluations:=3", config=path)
    client.send(Tune.Goal(evaluations=4))
    result = client.wait(60.0)
    assert (result.error_code, result.evaluations) == (0, 4)
    assert result.pareto_front.reference_point[0].value > 0.0  # inferred

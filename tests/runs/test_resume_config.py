"""The configuration of a resumed run: that of the earlier run's end, or another."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml

from mobo_tuner.core import Problem, ProblemError
from mobo_tuner.core.settings import method_of
from mobo_tuner.errors import UserError
from mobo_tuner.files import load_yaml
from mobo_tuner.parameter_file import node_sections
from mobo_tuner.runs.journal import JournalError
from mobo_tuner.runs.records import ChangeRecord
from mobo_tuner.runs.resume_config import main, resume_config
from mobo_tuner.tuner.parameters import check_tuner
from robustness.offline_run import TOY, OfflineRun, toy, toy_optimizer

OTHERS = {"awa_sim": {"ros__parameters": {"speed": 100.0}}, "tuner": {"ros__parameters": {}}}
CONFIG = {"/**": {"ros__parameters": TOY}, **OTHERS}
NARROW = {"x1": {"min": -1.0, "max": 1.5}, "x2": {"min": -2.0, "max": 2.0}}


@pytest.fixture
def run(tmp_path: Path) -> OfflineRun:
    """A run of three evaluations that has not ended, with its configuration."""
    folder = tmp_path / "earlier"
    run = OfflineRun(folder, toy_optimizer(1), toy, seed=1, events=False)
    for _ in range(3):
        run.step()
    (folder / "config.yaml").write_text("# by hand\n" + yaml.safe_dump(CONFIG))
    return run


@pytest.fixture
def folder(run: OfflineRun, tmp_path: Path) -> Path:
    run.log.close()
    return tmp_path / "earlier"


def written(folder: Path, **sections: Any) -> Path:
    """Another configuration."""
    path = folder / "other.yaml"
    path.write_text(yaml.safe_dump({**CONFIG, **sections}))
    return path


def test_a_run_that_was_not_changed_goes_on_with_its_own_file(folder: Path) -> None:
    own = (folder / "config.yaml").read_bytes()
    assert resume_config(folder, None, None) == resume_config(folder, None, 4) == own


@pytest.mark.parametrize("layout", [CONFIG, TOY], ids=["sections", "plain"])
def test_a_run_that_was_changed_goes_on_with_the_problem_as_it_was_in_the_end(
    run: OfflineRun, tmp_path: Path, layout: dict[str, Any]
) -> None:
    folder = tmp_path / "earlier"
    (folder / "config.yaml").write_text(yaml.safe_dump(layout))
    last = replace(Problem.from_dict({**TOY, "variables": NARROW}), constraints=())
    run.log.append(ChangeRecord(0.0, 3, last, 9))
    run.log.close()
    content = resume_config(folder, None, None)
    assert content.startswith(b"# As run earlier was in the end.\n")
    (tmp_path / "config.yaml").write_bytes(content)
    again = load_yaml(tmp_path / "config.yaml")
    assert Problem.from_dict(again) == last
    assert {name: again.get(name) for name in OTHERS} == {name: layout.get(name) for name in OTHERS}


def test_another_file_is_taken_as_it_is(folder: Path) -> None:
    other = written(folder, **{"/**": {"ros__parameters": {**TOY, "variables": NARROW}}})
    assert resume_config(folder, other, None) == other.read_bytes()


@pytest.mark.parametrize(
    "tuner",
    [
        {},
        {"seed": 5},
        {"preset": "default"},
        {"kernel": "matern52_full", "proximal": None, "beta": 0.01, "max_attempts": 7},
        {"maximizer_settings": {"screened": 512, "overshoot": 1.5}},
    ],
    ids=str,
)
def test_settings_that_a_run_keeps_may_be_given_again(folder: Path, tuner: dict[str, Any]) -> None:
    other = written(folder, tuner={"ros__parameters": tuner})
    assert resume_config(folder, other, 10) == other.read_bytes()


@pytest.mark.parametrize(
    ("sections", "sentence"),
    [
        (
            {"/**": {"ros__parameters": {**TOY, "variables": {"x1": {"min": 0.0, "max": 1.0}}}}},
            "the variables are x1; a run that resumes 'earlier' must have x1, x2",
        ),
        (
            {"tuner": {"ros__parameters": {"preset": "paper"}}},
            "tuner.preset is 'paper'; a run that resumes 'earlier' keeps its \"default\"",
        ),
        (
            {"tuner": {"ros__parameters": {"proximal": "costs"}}},
            "tuner.proximal is 'costs'; a run that resumes 'earlier' keeps its null",
        ),
        (
            {"/**/tuner": {"ros__parameters": {"maximizer_settings": {"screened": 64}}}},
            "tuner.maximizer_settings.screened is 64; a run that resumes 'earlier' keeps its 512",
        ),
        ({"tuner": {"ros__parameters": {"kernel": 3}}}, "tuner.kernel must be text, not 3"),
        ({"/**": {"ros__parameters": {"variables": {}}}}, "variables"),
    ],
)
def test_what_cannot_change_is_named(folder: Path, sections: dict[str, Any], sentence: str) -> None:
    with pytest.raises(UserError) as caught:
        resume_config(folder, written(folder, **sections), None)
    assert sentence in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_budget_that_is_used_up_is_refused(folder: Path) -> None:
    with pytest.raises(ProblemError, match="evaluations is 3, and the run 'earlier' has 3 eval"):
        resume_config(folder, None, 3)


def test_a_run_of_nodes_that_stay_has_its_problem_and_method_in_its_journal(
    run: OfflineRun, folder: Path, tmp_path: Path
) -> None:
    (folder / "config.yaml").unlink()
    made = tmp_path / "made.yaml"
    made.write_bytes(resume_config(folder, None, None))
    content = load_yaml(made)
    assert Problem.from_dict(content) == run.run.problem
    checked = check_tuner(node_sections(content)["tuner"])
    assert method_of(checked) == run.optimizer.settings
    assert checked["seed"] == 1
    assert checked["runs_dir"] == "runs"  # not that of the run
    assert resume_config(folder, made, None) == made.read_bytes()


def test_what_is_no_run_is_refused(tmp_path: Path) -> None:
    with pytest.raises(JournalError, match="cannot be read"):
        resume_config(tmp_path, None, None)


def test_the_command_writes_the_file_or_one_sentence(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out.yaml"
    assert main([str(folder), str(out), "--evaluations", "5"]) == 0
    assert out.read_bytes() == (folder / "config.yaml").read_bytes()
    out.unlink()
    for words in (
        [folder, out, "--evaluations", 2],
        [tmp_path / "none", out],
        [folder, tmp_path / "no" / "out.yaml"],
        [folder, out, "--config", tmp_path],
    ):
        capsys.readouterr()
        assert main([str(word) for word in words]) == 2
        [sentence] = capsys.readouterr().err.splitlines()
        assert len(sentence) > 20
        assert not out.exists()

"""The parameter file of a run that resumes an earlier one.

`python -m mobo_tuner.runs.resume_config RUN_FOLDER OUT [--config FILE] [--evaluations N]` writes it, or
prints one sentence and exits with status 2 if the run cannot be resumed this way.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from mobo_tuner.core.problem import SECTIONS, Problem, ProblemError
from mobo_tuner.core.settings import OptimizerSettings, method_of
from mobo_tuner.errors import UserError
from mobo_tuner.files import load_yaml
from mobo_tuner.parameter_file import flat, node_sections
from mobo_tuner.parameter_spec import specs_of
from mobo_tuner.runs.history import History
from mobo_tuner.runs.journal import read_journal
from mobo_tuner.runs.optimizer_settings import kept_settings
from mobo_tuner.wording import counted

CONFIG_FILE = "config.yaml"
_OF_ONE_RUN = ("runs_dir", "journal", "budget", "hypervolume_goal", "holds")  # recorded settings


def resume_config(run_dir: Path, config: Path | None, evaluations: int | None) -> bytes:
    """Return the content of the parameter file.

    Args:
        run_dir: Folder of the earlier run.
        config: Parameter file with other bounds, objectives or constraints; None for that of the
            earlier run, with the problem of its end.
        evaluations: Budget; None for that of the earlier run.

    Raises:
        JournalError: If the earlier run cannot be read.
        ProblemError: If it cannot be resumed this way.
    """
    history = History.from_records(read_journal(run_dir))
    history.require_settings()
    told = len(history.evaluations)
    if (evaluations or history.budget) <= told:
        has = f"the run '{history.run_id}' has {counted(told, 'evaluation')} already"
        raise ProblemError(
            f"evaluations is {evaluations}, and {has}; more are allowed"
            if evaluations
            else f"{has}, as many as it was allowed; --evaluations allows more"
        )
    if config is not None:
        content = load_yaml(config)
        _check(content, history)
        return config.read_bytes()
    path = run_dir / CONFIG_FILE
    if not path.is_file():  # a run of nodes that stay, or one that was rebuilt from its bag
        return _config_of(history)
    content = load_yaml(path)
    if Problem.from_dict(content) == history.last_problem:
        return path.read_bytes()
    parameters = content["/**"]["ros__parameters"] if "/**" in content else content
    for section in SECTIONS:
        parameters.pop(section, None)
    sections = history.last_problem.to_dict()
    parameters.update({name: entries for name, entries in sections.items() if entries})
    note = f"# As run {history.run_id} was in the end.\n"
    return (note + yaml.safe_dump(content, sort_keys=False, allow_unicode=True)).encode()


def _config_of(history: History) -> bytes:
    """Return a parameter file with what the journal of a run says of its problem and settings."""
    settings = {
        name: value
        for name, value in history.settings.items()
        if name not in _OF_ONE_RUN and value is not None
    }
    problem = {name: entries for name, entries in history.last_problem.to_dict().items() if entries}
    content = {
        "/**": {"ros__parameters": problem},
        "/**/tuner": {"ros__parameters": settings},
    }
    note = f"# From the journal of run {history.run_id}.\n"
    return (note + yaml.safe_dump(content, sort_keys=False, allow_unicode=True)).encode()


def _check(content: Mapping[str, Any], history: History) -> None:
    """Reject changes that are not possible."""
    problem = Problem.from_dict(content)
    names, allowed = problem.variable_names, history.problem.variable_names
    if set(names) != set(allowed):
        raise ProblemError(
            f"the variables are {', '.join(names)}; a run that resumes '{history.run_id}' "
            f"must have {', '.join(allowed)}"
        )
    given = dict(flat(node_sections(content).get("tuner", {})))
    _check_kept(given, history)


def _check_kept(given: Mapping[str, Any], history: History) -> None:
    """Reject another method or another input of the models."""
    recorded = kept_settings(history.settings)
    recorded |= method_of(history.settings).to_dict()
    recorded.update(flat({"maximizer_settings": recorded.pop("maximizer_settings")}))
    specs = {spec.name: spec for spec in specs_of(OptimizerSettings)}
    for name, value in given.items():
        if name == "seed" or name not in recorded:
            continue
        wanted = specs[name].check(value, "tuner.") if name in specs else value
        if wanted != recorded[name]:
            raise ProblemError(
                f"tuner.{name} is {value!r}; a run that resumes '{history.run_id}' keeps its "
                f"{json.dumps(recorded[name])}"
            )


def main(arguments: Sequence[str] | None = None) -> int:
    """Write one parameter file; return the exit status."""
    parser = argparse.ArgumentParser(prog="mobo_tuner.runs.resume_config", description=__doc__)
    parser.add_argument("run_folder", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--config", type=Path)
    parser.add_argument("--evaluations", type=int)
    options = parser.parse_args(arguments)
    try:
        content = resume_config(options.run_folder, options.config, options.evaluations)
        options.out.write_bytes(content)
    except UserError as error:
        print(error, file=sys.stderr)
        return 2
    except (OSError, ValueError) as error:
        print(f"the parameter file cannot be written: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())

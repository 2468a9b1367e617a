"""A campaign: a simulation is optimised in place of a machine, without ROS."""

from __future__ import annotations

import argparse
import os
import shutil
from collections.abc import Mapping
from pathlib import Path

from launcher.environment import OFFLINE_STAGES, STAGES
from launcher.errors import UsageError
from launcher.processes import Interrupted
from launcher.programs import Project, open_project
from launcher.run import now
from launcher.run_folder import CONFIG_FILE, RunFolder, process_start

_FOREVER = 10 * 365 * 86_400.0  # [s]


def campaign(options: argparse.Namespace) -> None:
    """Optimise the simulation of a parameter file, or continue a campaign in a new run.

    The last line that is printed is the folder's path.

    Raises:
        UsageError, SetupError, RunFolderError, Interrupted, OSError
    """
    runs_dir: Path = options.runs_dir.resolve()
    arguments: list[object] = []
    facts: dict[str, object] = {}
    for name in ("workers", "evaluations", "seed", "listen"):
        if getattr(options, name) is not None:
            arguments.append(f"--{name}={getattr(options, name)}")
    with open_project(options.root, (*STAGES, *OFFLINE_STAGES)) as project:
        if options.resume:
            earlier = RunFolder.find(options.resume, runs_dir)
            if earlier.facts().get("state") == "running":
                raise UsageError(f"the run '{earlier.run_id}' is active; stop it first")
            folder = RunFolder.create_after(earlier, options.run_id)
            config = earlier.path / CONFIG_FILE
            arguments.append(f"--resume={earlier.path}")
            facts["resumed_from"] = earlier.run_id
        else:
            config = options.config.resolve()
            if not config.is_file():
                raise UsageError(f"the configuration '{options.config}' is not a file")
            folder = RunFolder.create(runs_dir, options.run_id, config.stem)
            arguments.append(f"--config={config}")
        facts["arguments"] = {"config": str(config), "seed": options.seed}
        if config.is_file():
            shutil.copyfile(config, folder.path / CONFIG_FILE)
        _carry_out(project, folder, arguments, facts)


def _carry_out(
    project: Project, folder: RunFolder, arguments: list[object], how: Mapping[str, object]
) -> None:
    """Simulate until the budget is used up, and create the report."""
    facts = {
        "run_id": folder.run_id,
        "state": "running",
        "started": now(),
        "pid": os.getpid(),
        "pid_started": process_start(os.getpid()),
        **how,
    }
    folder.record(facts)
    state, reason = "failed", "mobo.py met an error of its own"
    try:
        project.ask(
            "mobo_tuner.offline.campaign", folder.path, *arguments, show=True, timeout=_FOREVER
        )
        state, reason = "finished", ""
    except Interrupted as interruption:
        state, reason = "interrupted", f"the campaign was {interruption}"
        raise
    except UsageError as error:
        reason = str(error)
        if folder.has_journal:
            project.ask("mobo_tuner.runs.report", folder.path, show=True)
        else:  # refused before anything was simulated
            shutil.rmtree(folder.path)
        raise
    finally:
        if folder.path.exists():
            folder.record({**facts, "state": state, "reason": reason, "ended": now()})
            if state != "finished":
                print(folder.path, flush=True)
    project.ask("mobo_tuner.runs.report", folder.path, show=True)
    print(folder.path, flush=True)

"""The laboratory's own logbook: a command that gets a run's folder and its summary, at the end or on request."""

from __future__ import annotations

import json
import os
import tempfile
from pathlib import Path

from launcher.errors import RunFolderError
from launcher.machine import split_command
from launcher.processes import Interrupted, Processes, describe_status
from launcher.run_folder import RunFolder

ON_RUN_END, ON_REQUEST = "on_run_end", "on_request"
VARIABLES = {ON_RUN_END: "MOBO_ON_RUN_END", ON_REQUEST: "MOBO_ON_REQUEST"}
"""Environment variable with the command of each event; a run's own files never name one."""
TIMEOUT = 60.0  # [s] for a command to end; then it is killed
AWAITED_TIMEOUT = 10.0  # [s] the same after a Ctrl-C
_PATIENCE = 1.0  # [s] for it to end when it is asked to
_LOG_FILE = "logbook.log"  # in the log folder of the run


def enter(
    processes: Processes, command: str, event: str, folder: RunFolder, timeout: float = TIMEOUT
) -> str:
    """Have a command write about a run; the run does not depend on it.

    Args:
        processes: Processes of the entry script.
        command: Command line. It gets one JSON object on its standard input: `event`, `run_id`, `run_folder`,
            `state`, `reason`, `summary` (the content of `summary.json`) and `report` (its path, or null).
        event: ON_RUN_END or ON_REQUEST.
        folder: Folder of the run.
        timeout: Longest time that it may take [s].

    Returns:
        What went wrong, in one sentence; empty if nothing did.
    """
    try:
        content = _content(event, folder)
        log = folder.path / "log" / _LOG_FILE
        log.parent.mkdir(exist_ok=True)
        with tempfile.TemporaryFile() as given, log.open("ab") as output:
            given.write(json.dumps(content, ensure_ascii=False).encode())
            given.seek(0)
            process = processes.start(
                split_command(command),
                environment=dict(os.environ),
                cwd=Path.cwd(),
                stdin=given.fileno(),
                stdout=output,
                stderr=output,
            )
            status = processes.wait(process, timeout)
            if status is None:
                processes.stop([process], patience=_PATIENCE)
    except (OSError, RunFolderError) as error:
        return f"the command '{command}' for the logbook cannot be used: {error}"
    except Interrupted:
        return f"the command '{command}' for the logbook was interrupted"
    if status is None:
        return f"the command '{command}' for the logbook was stopped after {timeout:g} s"
    if status != 0:
        return f"the command '{command}' for the logbook {describe_status(status)}; see {log}"
    return ""


def _content(event: str, folder: RunFolder) -> dict[str, object]:
    facts, path = folder.facts(), folder.path.resolve()
    report = path / "report.html"
    return {
        "event": event,
        "run_id": folder.run_id,
        "run_folder": str(path),
        "state": facts.get("state", ""),
        "reason": facts.get("reason", ""),
        "summary": folder.summary(),
        "report": str(report) if report.is_file() else None,
    }

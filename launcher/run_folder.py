"""The folder of a run: its creation, `run.json`, and its description for the user."""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import re
import shutil
from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

from launcher.errors import RunFolderError

RUN_ID = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,99}")
RUN_ID_RULE = "letters, digits, '_', '.' and '-', a letter or digit first, 100 characters at most"

# The names and the rule are also defined in `mobo_tuner.runs`, which this script cannot import; a test
# compares them.
RUN_FILE = "run.json"
CONFIG_FILE = "config.yaml"
SUMMARY_FILE = "summary.json"
JOURNAL_FILE = "journal.jsonl"
RUN_FILE_ROOM = 4000  # characters of a run.json at least
SUMMARY_HEAD = 1 << 13  # bytes of a summary in which its front begins
LAST_BYTES = 1 << 18  # of a journal that are read for its last records
SHOWN_POINTS = 8  # of the front, so that a run fits a screen
BAG_FILE = "metadata.yaml"
BAG_SUFFIXES = (".mcap", ".db3", ".mcap.zstd", ".db3.zstd")


class RunFolder:
    """The folder of one run.

    Attributes:
        path: Absolute path of the folder.
    """

    def __init__(self, path: Path) -> None:
        self.path = path.resolve()

    @classmethod
    def create(cls, runs_dir: Path, run_id: str | None, label: str) -> RunFolder:
        """Create the folder of a new run.

        Args:
            runs_dir: Folder of the runs; created if it is missing.
            run_id: Name of the run; None for one from the time and the label.
            label: End of a name from the time.

        Raises:
            RunFolderError: If the run exists already, or the folder cannot be created.
        """
        return cls._make(runs_dir, [run_id] if run_id else _new_names(label))

    @classmethod
    def create_after(cls, earlier: RunFolder, run_id: str | None) -> RunFolder:
        """Create the folder of a run that resumes an earlier one, beside it.

        Args:
            earlier: Folder of the earlier run.
            run_id: Name of the run; None for the earlier name with the next free number.

        Raises:
            RunFolderError: If the run exists already, or the folder cannot be created.
        """
        numbered = re.fullmatch(r"(.+)-[0-9]+", earlier.run_id)
        stem = numbered[1] if numbered and "resumed_from" in earlier.facts() else earlier.run_id
        names = [run_id] if run_id else [f"{stem[:95]}-{number}" for number in range(2, 1000)]
        return cls._make(earlier.path.parent, names)

    @classmethod
    def _make(cls, runs_dir: Path, names: Sequence[str]) -> RunFolder:
        """Create the first of the folders that does not exist."""
        try:
            runs_dir.mkdir(parents=True, exist_ok=True)
            for name in names:
                try:
                    (runs_dir / name).mkdir()
                except FileExistsError:
                    continue
                folder = cls(runs_dir / name)
                (folder.path / "log").mkdir()
                return folder
        except OSError as error:
            raise RunFolderError(
                f"the run folder cannot be made in '{runs_dir}': {error.strerror}"
            ) from None
        raise RunFolderError(
            f"the run '{names[0]}' exists already in '{runs_dir}', and no run is ever overwritten"
        )

    @classmethod
    def find(cls, run: str, runs_dir: Path) -> RunFolder:
        """Return the folder of a run that is given by its id or by a path.

        Raises:
            RunFolderError: If there is no such run.
        """
        candidates = [Path(run)] if os.sep in run else [runs_dir / run, Path(run)]
        for path in candidates:
            if any((path / name).is_file() for name in (RUN_FILE, SUMMARY_FILE, JOURNAL_FILE)):
                return cls(path)
        raise RunFolderError(f"there is no run '{run}' in '{runs_dir}'")

    @classmethod
    def all(cls, runs_dir: Path) -> list[RunFolder]:
        """Return the runs in a folder, by name; none if the folder does not exist.

        Raises:
            RunFolderError: If the folder cannot be read.
        """
        try:
            with os.scandir(runs_dir) as entries:
                found = sorted(entry.path for entry in entries if _is_run(entry.path))
        except FileNotFoundError:
            return []
        except OSError as error:
            raise RunFolderError(f"'{runs_dir}' cannot be read: {error.strerror}") from None
        return [cls(Path(path)) for path in found]

    @property
    def run_id(self) -> str:
        """Id of the run, the folder's name."""
        return self.path.name

    @property
    def has_journal(self) -> bool:
        """Whether the run has a journal to report on."""
        return (self.path / JOURNAL_FILE).is_file()

    def adopt(self, folder: Path) -> None:
        """Take over copies of the files of a folder.

        Raises:
            RunFolderError: If they cannot be written.
        """
        try:
            shutil.copytree(folder, self.path, dirs_exist_ok=True)
        except OSError as error:  # shutil.Error is one; its text is a list
            raise RunFolderError(f"'{self.path}' cannot be written: {error}") from None

    def record(self, facts: Mapping[str, Any]) -> None:
        """Write `run.json` atomically; in place on a full disk or in a read-only folder.

        Raises:
            RunFolderError: If it cannot be written.
        """
        path, draft = self.path / RUN_FILE, self.path / f".{RUN_FILE}.draft"
        # The blanks keep room on the disk for what is recorded at the end.
        text = (json.dumps(facts, indent=2, ensure_ascii=False) + "\n").ljust(RUN_FILE_ROOM)
        try:
            draft.write_text(text)
            draft.replace(path)
        except OSError as error:
            with contextlib.suppress(OSError):
                draft.unlink()
            try:
                with path.open("r+") as file:
                    file.write(text)
                    file.truncate()
            except OSError:
                raise RunFolderError(f"'{path}' cannot be written: {error.strerror}") from None

    def facts(self) -> dict[str, Any]:
        """Return the content of `run.json`, or what the journal says, with the current state.

        Raises:
            RunFolderError: If it cannot be read.
        """
        facts = self._read(RUN_FILE)
        if not facts and self.has_journal:  # a run of nodes that stay
            return self._journal_facts()
        if facts.get("state") == "running" and not _is_alive(facts):
            facts["state"] = "died"
        return facts

    def summary(self) -> dict[str, Any]:
        """Return the content of `summary.json`, or what the last evaluation in a newer journal says; may be empty.

        Raises:
            RunFolderError: If it cannot be read.
        """
        summary = self._read(SUMMARY_FILE)
        if self.is_summary_current or not self.has_journal:
            return summary
        last = next((r for r in self._last_records() if r.get("type") == "evaluation"), None)
        if last is None:
            return summary
        count = {"evaluations": last.get("index", -1) + 1}
        return {**summary, **count, "hypervolume": last.get("hypervolume")}

    @property
    def has_summary(self) -> bool:
        """Whether the run has a summary."""
        return (self.path / SUMMARY_FILE).is_file()

    @property
    def is_summary_current(self) -> bool:
        """Whether the run has a summary, and nothing came into its journal since."""
        with contextlib.suppress(OSError):
            summary = (self.path / SUMMARY_FILE).stat().st_mtime_ns
            return not self.has_journal or summary >= (self.path / JOURNAL_FILE).stat().st_mtime_ns
        return False

    def row(self) -> list[str]:
        """Return the row of a table: id, state, evaluations, hypervolume, start.

        Raises:
            RunFolderError: If it cannot be read.
        """
        facts = self.facts()
        summary = (self.is_summary_current and self._summary_head()) or self.summary()
        return [
            self.run_id,
            _text(facts.get("state")),
            _text(summary.get("evaluations")),
            _text(summary.get("hypervolume")),
            _text(facts.get("started")),
        ]

    def description(self) -> str:
        """Return the main facts of the run and its Pareto front, for people.

        Raises:
            RunFolderError: If it cannot be read.
        """
        facts, summary = self.facts(), self.summary()
        lines = [f"run {self.run_id}"]
        names = ("state", "reason", "resumed_from", "started", "ended")
        shown = {name: facts.get(name) for name in names}
        arguments = facts.get("arguments")
        if isinstance(arguments, Mapping):
            shown |= {name: arguments.get(name) for name in ("config", "seed")}
        shown["machine"] = _machine(facts)
        names = ("evaluations", "failed", "feasible", "hypervolume", "stop_reason")
        shown |= {name: summary.get(name) for name in names}
        lines += [
            f"  {name.replace('_', ' '):<12} {_text(value)}"
            for name, value in shown.items()
            if value not in (None, "")
        ]
        lines.append(f"  {'folder':<12} {self.path}")
        if not self.has_summary:
            lines.append(
                f"There is no summary of this run: 'mobo.py report {self.run_id}' makes it."
            )
            return "\n".join(lines)
        try:
            front = summary["pareto_front"]
            tables = {
                title: [{"index": point["index"], **point[key]} for point in front]
                for title, key in (("objectives", "objectives"), ("set-points", "setpoint"))
            }
        except (KeyError, TypeError, ValueError):
            raise RunFolderError(
                f"'{self.path / SUMMARY_FILE}' holds no Pareto front that can be read"
            ) from None
        lines.append(f"Pareto front, {len(front)} {'point' if len(front) == 1 else 'points'}")
        for title, points in tables.items():
            if points:
                columns = list(points[0])
                rows = [[_text(point.get(n)) for n in columns] for point in points[:SHOWN_POINTS]]
                lines += [f"  {title}", *(f"  {line}" for line in table(columns, rows))]
        if len(front) > SHOWN_POINTS:
            lines.append(
                f"  and {len(front) - SHOWN_POINTS} more: {SUMMARY_FILE} has all of them, report.html "
                "the most balanced ones"
            )
        return "\n".join(lines)

    def _journal_facts(self) -> dict[str, Any]:
        """Return the facts of a run whose nodes stay, as far as its journal has them."""
        try:
            with (self.path / JOURNAL_FILE).open("rb") as file:
                start = json.loads(file.readline())
                try:
                    fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
                    state = "died"
                except OSError:
                    state = "running"
            facts = {"started": _local_time(start["stamp"])}
        except OSError as error:
            path = self.path / JOURNAL_FILE
            raise RunFolderError(f"'{path}' cannot be read: {error.strerror}") from None
        except (KeyError, OverflowError, TypeError, ValueError):
            path = self.path / JOURNAL_FILE
            raise RunFolderError(f"'{path}' does not begin with a start record") from None
        end = next((r for r in self._last_records() if r.get("type") == "end"), None)
        if end is not None:
            stop_reason = str(end.get("stop_reason"))
            state = {"canceled": "canceled", "error": "failed"}.get(stop_reason, "finished")
            facts |= {"reason": end.get("error_msg"), "ended": _local_time(end.get("stamp"))}
        earlier = start.get("resumed_from")
        if isinstance(earlier, Mapping):
            facts["resumed_from"] = earlier.get("run_id")
        return {"state": state, **facts}

    def _last_records(self) -> list[dict[str, Any]]:
        """Return the last records of the journal, the newest first."""
        with contextlib.suppress(OSError), (self.path / JOURNAL_FILE).open("rb") as file:
            file.seek(max(0, file.seek(0, os.SEEK_END) - LAST_BYTES))
            records = []
            for line in reversed(file.read().splitlines()):
                with contextlib.suppress(ValueError):  # the first may be cut
                    record = json.loads(line)
                    if isinstance(record, dict):
                        records.append(record)
            return records
        return []

    def _summary_head(self) -> dict[str, Any]:
        """Return the content of `summary.json` before its front, which is most of it; empty if that is not clear."""
        with (
            contextlib.suppress(OSError, ValueError),
            (self.path / SUMMARY_FILE).open("rb") as file,
        ):
            head, front, _ = file.read(SUMMARY_HEAD).partition(b'"pareto_front":')
            if front:
                content = json.loads(head.rstrip().rstrip(b",") + b"}")
                return content if isinstance(content, dict) else {}
        return {}

    def _read(self, name: str) -> dict[str, Any]:
        path = self.path / name
        try:
            content = json.loads(path.read_text())
        except FileNotFoundError:
            return {}
        except OSError as error:
            raise RunFolderError(f"'{path}' cannot be read: {error.strerror}") from None
        except (ValueError, RecursionError):
            raise RunFolderError(f"'{path}' is broken: it is not JSON") from None
        if not isinstance(content, dict):
            raise RunFolderError(f"'{path}' is broken: it holds no JSON object")
        return content


def _is_run(folder: str) -> bool:
    return any(os.path.isfile(f"{folder}/{name}") for name in (RUN_FILE, JOURNAL_FILE))


def is_bag(path: Path) -> bool:
    """Return whether a path is that of a bag's folder or of one of its files."""
    if not path.is_dir():
        return path.is_file() and path.name.endswith(BAG_SUFFIXES)
    return any(file.name == BAG_FILE or file.name.endswith(BAG_SUFFIXES) for file in path.iterdir())


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Return the lines of a table: the first column left-aligned, the others right-aligned."""
    widths = [max(map(len, column)) for column in zip(header, *rows, strict=True)]
    return [
        "  ".join(
            cell.rjust(width) if number else cell.ljust(width)
            for number, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in (header, *rows)
    ]


def process_start(pid: int) -> str | None:
    """Return the start time of a process in kernel ticks, which identifies it together with its id.

    None if there is no such process.
    """
    try:
        content = Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return None
    # The start is the 20th field after the program's name, which is in brackets.
    state, *fields = content.rpartition(")")[2].split()
    return None if state == "Z" else fields[18]


def _local_time(stamp: Any) -> str | None:
    """Return a time [s since the epoch] as `run.json` has it; None if it is unknown."""
    if not isinstance(stamp, int | float):
        return None
    return datetime.fromtimestamp(stamp).astimezone().isoformat(timespec="seconds")


def _is_alive(facts: Mapping[str, Any]) -> bool:
    pid, started = facts.get("pid"), facts.get("pid_started")
    return isinstance(pid, int) and isinstance(started, str) and process_start(pid) == started


def _machine(facts: Mapping[str, Any]) -> str | None:
    """Return the machine of a run in a few words; None if it is not recorded."""
    machine = facts.get("machine")
    if not isinstance(machine, Mapping):
        return None
    if "section" in machine:
        return f"{machine['section']}, started by the run"
    if "command" in machine:
        return f"{machine['command']}, started by the run"
    return f"already running, in ROS domain {facts.get('domain_id')}"


def _new_names(label: str) -> list[str]:
    harmless = re.sub(r"[^A-Za-z0-9_.-]", "-", label)[:60]
    stem = f"{datetime.now():%Y%m%d-%H%M%S}-{harmless}"
    return [stem, *(f"{stem}-{number}" for number in range(2, 100))]


def _text(value: object) -> str:
    """Return a value of a JSON file for people; '-' if there is none."""
    if value is None:
        return "-"
    if isinstance(value, float):
        return f"{value:.6g}"
    return str(value)

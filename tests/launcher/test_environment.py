"""The set-up of the virtual environment: which stages are done when, and what interrupts do."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest

from launcher.environment import (
    DEVELOPMENT_STAGES,
    LIVE_STAGES,
    OFFLINE_STAGES,
    PAGE_STAGES,
    STAGES,
    Environment,
    Stage,
    clean_environment,
)
from launcher.errors import SetupError
from launcher.processes import Processes
from tests.support.fake_project import ROOT, TIMEOUT, wait_until

VENV = 'mkdir -p "{venv}/bin" && touch "{venv}/bin/python"'
NOBODY = 65534  # id of the account that owns nothing
FAKE_STAGES = (
    Stage("venv", "making", None, ("sh", "-c", f'{VENV} && echo venv >> "{{venv}}/../done"')),
    Stage("deep", "deep", "venv", ("sh", "-c", 'echo deep >> "{venv}/../done"'), ("deep.txt",)),
    Stage(
        "package",
        "package",
        "deep",
        ("sh", "-c", 'echo package >> "{venv}/../done"; cat src/code.py config/x.yaml'),
        ("src",),
        companions=("config",),
    ),
    Stage("last", "last", "package", ("sh", "-c", 'echo last >> "{venv}/../done"')),
)


@pytest.fixture
def root(tmp_path: Path) -> Path:
    root = tmp_path / "project"
    (root / "src").mkdir(parents=True)
    (root / "config").mkdir()
    (root / "deep.txt").write_text("1")
    (root / "src" / "code.py").write_text("1")
    (root / "config" / "x.yaml").write_text("1")
    return root


def set_up(root: Path, stages: tuple[Stage, ...] = FAKE_STAGES) -> list[str]:
    """Set up; the stages that were done."""
    done = root / "done"
    done.unlink(missing_ok=True)
    with Processes() as processes:
        Environment(root, stages).set_up(processes)
    return done.read_text().split() if done.exists() else []


def test_everything_is_done_once(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert set_up(root) == ["venv", "deep", "package", "last"]
    assert "[3/4] package ... 0 s" in capsys.readouterr().out.splitlines()
    assert set_up(root) == []
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize(
    ("changed", "redone"),
    [
        ("deep.txt", ["deep", "package", "last"]),
        ("src/code.py", ["package", "last"]),
        ("src/new.py", ["package", "last"]),
        ("config/x.yaml", []),
        ("src/__pycache__/code.pyc", []),
        ("src/build/lib/code.py", []),
        ("src/code.egg-info/PKG-INFO", []),
    ],
)
def test_a_change_makes_stale_what_builds_on_it(
    root: Path, changed: str, redone: list[str]
) -> None:
    set_up(root)
    path = root / changed
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("2")
    assert set_up(root) == redone


def test_a_removed_file_is_a_change(root: Path) -> None:
    (root / "src" / "old.py").touch()
    set_up(root)
    (root / "src" / "old.py").unlink()
    assert set_up(root) == ["package", "last"]


def test_a_touched_file_is_no_change(root: Path) -> None:
    set_up(root)
    os.utime(root / "src" / "code.py", (0, 0))
    assert set_up(root) == []


def test_a_moved_project_starts_anew(root: Path) -> None:
    set_up(root)
    moved = root.rename(root.with_name("moved"))
    assert set_up(moved) == ["venv", "deep", "package", "last"]


def test_a_lost_interpreter_starts_anew(root: Path) -> None:
    set_up(root)
    python = root / ".venv" / "bin" / "python"
    other = root / "other-python"
    other.touch()
    python.unlink()
    python.symlink_to(other)
    assert set_up(root)[0] == "venv"


def test_a_failed_stage_shows_its_log_and_is_done_again(root: Path) -> None:
    failing = replace(FAKE_STAGES[2], command=("sh", "-c", "seq 100; echo no room >&2; exit 5"))
    stages = (*FAKE_STAGES[:2], failing, FAKE_STAGES[3])
    with pytest.raises(SetupError) as caught:
        set_up(root, stages)
    lines = str(caught.value).splitlines()
    assert "while package: the command ended with status 5" in lines[0]
    assert lines[-2:] == ["    100", "    no room"]
    assert len(lines) == 21
    assert set_up(root) == ["package", "last"]


def test_a_missing_folder_is_named(root: Path) -> None:
    shutil.rmtree(root / "src")
    with pytest.raises(SetupError, match=re.escape(f"{root / 'src'} is missing")):
        set_up(root)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_an_interrupted_stage_is_done_again(root: Path, number: signal.Signals) -> None:
    pid_file = root / "pid"
    waiting = (
        "sh",
        "-c",
        f'echo $$ > "{pid_file}.draft"; mv "{pid_file}.draft" "{pid_file}"; sleep 60',
    )
    program = f"""
import sys
from dataclasses import replace
from pathlib import Path
sys.path[:0] = [{str(ROOT)!r}]
from tests.launcher.test_environment import FAKE_STAGES, set_up
set_up(Path({str(root)!r}), (*FAKE_STAGES[:2], replace(FAKE_STAGES[2], command={waiting!r})))
"""
    process = subprocess.Popen(
        [sys.executable, "-c", program],
        env={**os.environ, "TMPDIR": str(root)},  # a killed one leaves its build folder there
        stderr=subprocess.DEVNULL,
    )
    try:
        wait_until(pid_file.exists, "the stage")
        process.send_signal(number)
        process.wait(timeout=TIMEOUT)
    finally:
        process.kill()
        process.wait(timeout=TIMEOUT)
    command = Path(f"/proc/{pid_file.read_text().strip()}/cmdline")
    wait_until(lambda: not command.exists() or not command.read_bytes(), "the end of the stage")
    assert set_up(root) == ["package", "last"]


def test_two_at_once_set_up_once(root: Path) -> None:
    slow = replace(FAKE_STAGES[1], command=("sh", "-c", 'echo deep >> "{venv}/../done"; sleep 1'))
    program = f"""
import sys
from pathlib import Path
sys.path[:0] = [{str(ROOT)!r}]
from tests.launcher.test_environment import FAKE_STAGES, Environment, Processes, Stage
with Processes() as processes:
    Environment(Path({str(root)!r}), (FAKE_STAGES[0], {slow!r})).set_up(processes)
"""
    both = [subprocess.Popen([sys.executable, "-c", program]) for _ in range(2)]
    assert [process.wait(timeout=TIMEOUT) for process in both] == [0, 0]
    assert (root / "done").read_text().split() == ["venv", "deep"]


@contextmanager
def another_account(folder: Path) -> Iterator[None]:
    """Be somebody who can read a folder and not write it."""
    folder.chmod(0o555)
    superuser = os.geteuid() == 0
    if superuser:
        os.seteuid(NOBODY)
    try:
        yield
    finally:
        if superuser:
            os.seteuid(0)
        folder.chmod(0o755)


def test_another_account_s_folder_is_used_as_it_is_or_its_owner_is_named() -> None:
    # Not pytest's folder, which other accounts cannot enter.
    with Processes() as processes, tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        (root / "deep.txt").write_text("1")
        owner = root.owner()
        with another_account(root):
            with pytest.raises(SetupError) as caught:
                Environment(root, FAKE_STAGES[:2]).set_up(processes)
            Environment(root, ()).set_up(processes)  # there is nothing to do
        python = root / ".venv" / "bin" / "python"
        python.parent.mkdir(parents=True)
        python.symlink_to(root / "private-python")
        with another_account(root), pytest.raises(SetupError, match="private-python"):
            Environment(root, FAKE_STAGES[:2]).set_up(processes)
    message = str(caught.value)
    assert folder in message
    assert owner in message
    assert "\n" not in message


def test_the_project_s_own_stages_build_on_each_other_and_have_their_sources() -> None:
    names: set[str | None] = {None}
    for stage in (*STAGES, *PAGE_STAGES, *LIVE_STAGES, *OFFLINE_STAGES, *DEVELOPMENT_STAGES):
        assert stage.after in names
        names.add(stage.name)
        for source in (*stage.sources, *stage.companions):
            assert (ROOT / source).exists()


def test_requirements_are_pinned_to_one_version() -> None:
    for part in ("", "-page", "-live", "-offline", "-torch", "-dev"):
        name = f"requirements{part}.txt"
        lines = (ROOT / name).read_text().splitlines()
        pins = [line for line in lines if not line.startswith(("#", "-r "))]
        assert pins
        for pin in pins:
            assert re.fullmatch(r"[A-Za-z0-9._-]+(\[[a-z]+\])?==[A-Za-z0-9.]+", pin), pin


def test_other_pythons_and_ros_installations_are_kept_out(monkeypatch: pytest.MonkeyPatch) -> None:
    misleading = ("PYTHONPATH", "VIRTUAL_ENV", "LD_LIBRARY_PATH", "RMW_IMPLEMENTATION")
    for name in (*misleading, "AMENT_PREFIX_PATH", "_ROS_WHEELS_BOOTSTRAP_COMPLETE", "HARMLESS"):
        monkeypatch.setenv(name, "x")
    clean = clean_environment(ROS_DOMAIN_ID="7")
    assert clean["HARMLESS"] == "x"
    assert clean["ROS_DOMAIN_ID"] == "7"
    assert not set(misleading) & set(clean)
    assert "_ROS_WHEELS_BOOTSTRAP_COMPLETE" not in clean


def test_a_run_needs_no_torch() -> None:
    assert "torch" not in (ROOT / "requirements.txt").read_text()
    assert "torch" not in {stage.name for stage in STAGES}
    assert "torch" in {stage.name for stage in DEVELOPMENT_STAGES}

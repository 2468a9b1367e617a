"""The virtual environment beside `mobo.py`: created if missing, updated if stale.

The set-up has stages. A complete stage leaves a stamp in `.venv/.stamps`: a hash of its sources, its
command and the stamp of the stage before. The stamp is written last and atomically, so that the next
call repeats an interrupted stage.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import shutil
import subprocess
import sys
import sysconfig
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from launcher.errors import SetupError
from launcher.processes import Processes, describe_status

_STAGE_TIMEOUT = 3600.0  # [s]
_LOCK_TIMEOUT = 3600.0  # [s] for another set-up of the same folder to finish
_LOG_TAIL = 20  # lines shown of the log of a stage that failed
_IGNORED = {"__pycache__", "build", ".pytest_cache", ".mypy_cache", ".ruff_cache"}
# Variables by which Python would find packages of other installations, or ROS nodes foreign nodes.
_SCRUBBED = {"VIRTUAL_ENV", "LD_LIBRARY_PATH", "LD_PRELOAD", "_ROS_WHEELS_BOOTSTRAP_COMPLETE"}
_SCRUBBED_PREFIXES = (
    "AMENT_",
    "CMAKE_PREFIX_PATH",
    "COLCON_",
    "FASTDDS_",
    "FASTRTPS_",
    "PYTHON",
    "RCUTILS_",
    "RMW_",
    "ROS_",
)


@dataclass(frozen=True)
class Stage:
    """One step of the set-up.

    Attributes:
        name: Name of its stamp.
        label: Text for the user while it runs.
        after: Name of the stage before.
        command: Command, run in a copy of the sources; `{venv}` is replaced by the environment's folder.
        sources: Files and folders, relative to the project's root, whose change makes the stage stale.
        companions: Files and folders that are also copied, but whose change does not make it stale.
        compiles: Whether it needs a compiler and Python's headers.
    """

    name: str
    label: str
    after: str | None
    command: tuple[str, ...]
    sources: tuple[str, ...] = ()
    companions: tuple[str, ...] = ()
    compiles: bool = False


_PIP = ("{venv}/bin/python", "-m", "pip", "install", "--no-input")
_LOCAL = (*_PIP, "--no-index", "--no-deps", "--no-build-isolation")

STAGES = (
    Stage("venv", "creating .venv", None, (sys.executable, "-m", "venv", "--clear", "{venv}")),
    Stage(
        "requirements",
        "installing ROS 2 (rclpy) and the numerics",
        "venv",
        (*_PIP, "-r", "requirements.txt"),
        sources=("requirements.txt",),
    ),
    Stage(
        "mobo_msgs_py",
        "building the ROS interfaces (one to two minutes)",
        "requirements",
        (*_PIP, "--no-deps", "./src/mobo_msgs_py"),
        sources=("src/mobo_msgs_py",),
        compiles=True,
    ),
    Stage(
        "awa_sim_node",
        "installing the simulated machine",
        "requirements",
        (*_LOCAL, "./src/awa_sim_node"),
        sources=("src/awa_sim_node",),
    ),
    Stage(
        "mobo_tuner",
        "installing the tuner",
        "requirements",
        (*_LOCAL, "./src/mobo_tuner"),
        sources=tuple(
            f"src/mobo_tuner/{name}"
            for name in (
                "mobo_tuner",
                "launch",
                "resource",
                "wrappers",
                "package.xml",
                "pyproject.toml",
                "setup.cfg",
                "setup.py",
            )
        ),
        # Goes to share/ for `ros2 run`; runs here read the file they name, which users change.
        companions=("src/mobo_tuner/config",),
    ),
    Stage(
        "warmup",
        "compiling the numeric core",
        "mobo_tuner",
        ("{venv}/bin/python", "-P", "-m", "mobo_tuner.warmup"),
    ),
)
PAGE_STAGES = (
    Stage(
        "page",
        "installing the page for the browser (NiceGUI)",
        "requirements",
        (*_PIP, "-r", "requirements-page.txt"),
        sources=("requirements-page.txt", "requirements.txt"),
    ),
)
LIVE_STAGES = (
    Stage(
        "live",
        "installing the live server (foxglove-sdk)",
        "requirements",
        (*_PIP, "-r", "requirements-live.txt"),
        sources=("requirements-live.txt", "requirements.txt"),
    ),
)
OFFLINE_STAGES = (
    Stage(
        "offline",
        "installing what campaigns of simulations need (libEnsemble)",
        "requirements",
        (*_PIP, "-r", "requirements-offline.txt"),
        sources=("requirements-offline.txt", "requirements.txt"),
    ),
)
# Beside the stages of a run. No run needs torch, which is as large as all the rest.
DEVELOPMENT_STAGES = (
    Stage(
        "torch",
        "installing PyTorch, which trains the simulated machine's surrogate",
        "requirements",
        (*_PIP, "-r", "requirements-torch.txt"),
        sources=("requirements-torch.txt", "requirements.txt"),
    ),
    Stage(
        "development",
        "installing what the tests need",
        "torch",
        (*_PIP, "-r", "requirements-dev.txt"),
        sources=("requirements-dev.txt", "requirements-torch.txt", "requirements.txt"),
    ),
)


def clean_environment(**extra: str) -> dict[str, str]:
    """Return this process's environment variables without those that mislead Python or ROS."""
    kept = {
        name: value
        for name, value in os.environ.items()
        if name not in _SCRUBBED and not name.startswith(_SCRUBBED_PREFIXES)
    }
    return {**kept, **extra}


class Environment:
    """The virtual environment in `root/.venv`."""

    def __init__(self, root: Path, stages: Sequence[Stage]) -> None:
        self.folder = root / ".venv"
        self.python = self.folder / "bin" / "python"
        self._root = root
        self._stages = {stage.name: stage for stage in stages}
        self._log = root / ".venv-setup.log"

    def stale_stages(self) -> list[Stage]:
        """Return the stale stages in order; none if the environment is ready."""
        stale: list[Stage] = []
        for stage in self._stages.values():
            follows_stale = any(stage.after == earlier.name for earlier in stale)
            if follows_stale or self._stamped(stage) != self.fingerprint(stage):
                stale.append(stage)
        return stale

    def set_up(self, processes: Processes) -> None:
        """Do the stale stages; fast if there are none.

        Raises:
            SetupError: If a stage failed.
            Interrupted: If a signal arrived.
        """
        if not self.stale_stages():
            return
        with self._lock(processes):
            stale = self.stale_stages()  # someone else may have set it up meanwhile
            for number, stage in enumerate(stale, start=1):
                self._do(stage, f"[{number}/{len(stale)}] {stage.label}", processes)

    def fingerprint(self, stage: Stage) -> str:
        """Return the content of the stage's stamp if it is complete and current."""
        digest = hashlib.sha256()
        if stage.after is None:
            # A moved folder and an exchanged interpreter each make an environment useless.
            command: Sequence[str] = (str(self.folder), str(self.python.resolve()))
        else:
            command = (self.fingerprint(self._stages[stage.after]), *stage.command)
        digest.update(repr(tuple(command)).encode())
        for source in stage.sources:
            for file in _files(self._root / source):
                content = hashlib.sha256(file.read_bytes()).hexdigest()
                digest.update(f"{file.relative_to(self._root)} {content}\n".encode())
        return digest.hexdigest()

    def mark_done(self, stage: Stage, fingerprint: str) -> None:
        """Write a stage's stamp atomically."""
        stamp = self._stamp(stage)
        stamp.parent.mkdir(exist_ok=True)
        draft = stamp.with_suffix(".draft")
        draft.write_text(fingerprint)
        draft.replace(stamp)

    def _do(self, stage: Stage, label: str, processes: Processes) -> None:
        if stage.compiles:
            _check_compilers()
        self._stamp(stage).unlink(missing_ok=True)
        fingerprint = self.fingerprint(stage)
        command = [part.format(venv=self.folder) for part in stage.command]
        with tempfile.TemporaryDirectory(prefix="mobo-setup-") as build:
            # Building in a copy keeps the tree clean, and a stale `build` folder out of the wheel.
            for source in (*stage.sources, *stage.companions):
                for file in _files(self._root / source):
                    copy = Path(build, file.relative_to(self._root))
                    copy.parent.mkdir(parents=True, exist_ok=True)
                    shutil.copy2(file, copy)
            with self._log.open("wb") as log, _Progress(label) as progress:
                process = processes.start(
                    command,
                    environment=clean_environment(PIP_USER="0", PIP_DISABLE_PIP_VERSION_CHECK="1"),
                    cwd=Path(build),
                    stdout=log,
                    stderr=subprocess.STDOUT,
                )
                deadline = time.monotonic() + _STAGE_TIMEOUT
                while processes.wait(process, timeout=1.0) is None:
                    progress.show()
                    if time.monotonic() >= deadline:
                        raise SetupError(f"{stage.label}: not done after {_STAGE_TIMEOUT:.0f} s")
        if process.returncode != 0:
            raise SetupError(self._failure(stage, process.returncode))
        if stage.name == "venv":
            fingerprint = self.fingerprint(stage)  # there is a python to take it from only now
        self.mark_done(stage, fingerprint)

    def _failure(self, stage: Stage, status: int) -> str:
        lines = self._log.read_text(errors="replace").splitlines()[-_LOG_TAIL:]
        tail = "\n".join(f"    {line}" for line in lines)
        return (
            f"setting up .venv failed while {stage.label}: the command "
            f"{describe_status(status)}; the end of {self._log}:\n{tail}"
        )

    def _stamp(self, stage: Stage) -> Path:
        return self.folder / ".stamps" / stage.name

    def _stamped(self, stage: Stage) -> str:
        try:
            return self._stamp(stage).read_text()
        except OSError:
            return ""

    @contextmanager
    def _lock(self, processes: Processes) -> Iterator[None]:
        """Prevent other set-ups of this folder; the lock ends with the process that holds it."""
        with self._lock_file().open("w") as file:
            if not _try_lock(file.fileno()):
                print("waiting for another mobo.py that is setting up .venv", flush=True)
                if not processes.wait_until(lambda: _try_lock(file.fileno()), _LOCK_TIMEOUT):
                    raise SetupError("another mobo.py has been setting up .venv for too long")
            yield

    def _lock_file(self) -> Path:
        """Return the lock file, which is writable.

        Raises:
            SetupError: If it is not, for example because the folder belongs to another user.
        """
        path = self._root / ".venv-setup.lock"
        try:
            path.open("w").close()
        except OSError as error:
            owner = path.owner() if path.exists() else self._root.owner()
            if self.folder.is_dir() and not os.access(self.python, os.X_OK):
                raise SetupError(
                    f"'{self.folder}' was made with {os.path.realpath(self.python)}, which this account cannot run: "
                    "use a copy of the folder that is your own"
                ) from None
            raise SetupError(
                f"'{self._root}' needs a set-up, and its lock file cannot be written "
                f"({error.strerror}): let its owner, {owner}, run mobo.py once, or use a copy of "
                "the folder that is your own"
            ) from None
        return path


class _Progress:
    """Display of a stage and its seconds: in place on a terminal, otherwise as two lines."""

    def __init__(self, label: str) -> None:
        self._label = label
        self._started = time.monotonic()
        self._live = sys.stdout.isatty()

    def __enter__(self) -> _Progress:
        print(f"{self._label} ...", end="" if self._live else "\n", flush=True)
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            self.show(end="\n")
        elif self._live:
            print(flush=True)

    def show(self, end: str = "") -> None:
        """Update the seconds."""
        if self._live or end:
            start = "\r" if self._live else ""
            seconds = time.monotonic() - self._started
            print(f"{start}{self._label} ... {seconds:.0f} s", end=end, flush=True)


def _files(path: Path) -> list[Path]:
    """Return the source files in a folder, sorted and without build results, or the file itself.

    Raises:
        SetupError: If there is no such file or folder.
    """
    if path.is_file():
        return [path]
    if not path.is_dir():
        raise SetupError(f"{path} is missing: the project's folder is incomplete")
    files = []
    for folder, folders, names in os.walk(path):
        folders[:] = [f for f in folders if f not in _IGNORED and not f.endswith(".egg-info")]
        files += [Path(folder, name) for name in names if not name.endswith(".pyc")]
    return sorted(files)


def _check_compilers() -> None:
    """Check the compilers and headers that the interface package needs.

    Raises:
        SetupError: If one is missing.
    """
    compilers: Mapping[str, Sequence[str]] = {
        "a C compiler": ("cc", "gcc", "clang"),
        "a C++ compiler": ("c++", "g++", "clang++"),
    }
    for what, names in compilers.items():
        if not any(map(shutil.which, names)):
            raise SetupError(
                f"{what} is needed to build the ROS interfaces, and none of "
                f"{', '.join(names)} was found: install gcc and g++"
            )
    header = Path(sysconfig.get_path("include"), "Python.h")
    if not header.is_file():
        raise SetupError(
            f"Python's header files are needed to build the ROS interfaces, and {header} is "
            "missing: install Python's development package (python3-dev)"
        )


def _try_lock(descriptor: int) -> bool:
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True

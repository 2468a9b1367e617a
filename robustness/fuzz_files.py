"""Fuzz all file readers with corrupted input; each must accept it or reject it with a one-line error.

Configurations, mapping files of the bridge, journals, states and bags of runs, and the files read by `mobo.py list` and
`show` are altered at random in their bytes or their values. Prints the number of files of each kind, and every other
result: a different exception, a message with several lines, or more than 20 s.
"""

from __future__ import annotations

import argparse
import copy
import json
import math
import shutil
import signal
import sys
import tempfile
import traceback
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import rosbags.convert
import yaml

from awa_sim_node.describe import describe_file as describe_simulator
from launcher.errors import RunFolderError
from launcher.run_folder import RunFolder
from mobo_tuner.bridge.describe import describe_file as describe_bridge
from mobo_tuner.bridge.mapping import load_mapping
from mobo_tuner.displays.configuration import explanation
from mobo_tuner.errors import UserError
from mobo_tuner.nodes.check_config import check, copy_to
from mobo_tuner.runs.history import History
from mobo_tuner.runs.journal import FILE_NAME, read_journal
from mobo_tuner.runs.rebuild import records_of_bag, runs_of_bag
from mobo_tuner.runs.recorded_run import RecordedRun
from mobo_tuner.runs.records import EndRecord
from mobo_tuner.runs.replay import restore
from mobo_tuner.runs.report.page import render_page
from mobo_tuner.runs.report.summary import summarize
from mobo_tuner.runs.resume_config import resume_config
from mobo_tuner.runs.saved_state import FILE_NAME as STATE_NAME
from mobo_tuner.runs.saved_state import SavedState, checksum
from robustness.offline_run import OfflineRun, toy, toy_optimizer
from robustness.synthetic_bag import write_bag

ROOT = Path(__file__).resolve().parents[1]
MACHINES = {"awa_sim": describe_simulator, "machine_bridge": describe_bridge}
REFUSALS = (UserError, RunFolderError)
TIME_LIMIT = 20  # [s] for one file
LONGEST = 2000  # characters of an error message
SHARES = {
    "configuration": 0.35,
    "mapping": 0.15,
    "resumed configuration": 0.05,
    "journal": 0.15,
    "state": 0.1,
    "bag": 0.17,
    "run.json": 0.03,
}
_VALUES: tuple[Any, ...] = (
    *(None, True, False, 0, -1, 1, 2**31, -(2**63), 10**400, 0.0, -1.0, 1e308, 5e-324),
    *(math.nan, math.inf, -math.inf, "", " ", "x", "x" * 5000, "\n", "1.0", "nan", "µ\U0001f600"),
    *([], {}, [[]], [1.0, 2.0], [None], {"": None}, {"min": 1.0}, {1: 2}, b"\x00\xff", "../x"),
)
_SNIPPETS = (
    *(b"\x00", b"\xff\xfe", b"\t", b"---\n", b"...\n", b"{", b"}", b"[", b"'", b'"', b"&a ", b"*a"),
    *(b"<<: *a\n", b"? ", b": ", b"#", b"|\n", b"!!python/object/apply:os.system ['true']"),
    *(b"!!binary x", b"!!timestamp 2001-99-99", b"1e999", b"0x", b"1_000", b"\xf0\x9f\x98\x80"),
    *(b"=", b"!!set {a, b}", b"~", b"%YAML 9.9\n", b"[" * 2000, b"{a: " * 500, b"2001-02-30"),
)
# A list of ten lists of ten lists, and so on: expanding it would never end.
_BOMB = "[x]"
for _level in range(20):
    _BOMB = f"[&a{_level} {_BOMB}, {', '.join([f'*a{_level}'] * 9)}]"


class SlowError(Exception):
    """A file that took too long."""


@dataclass
class Report:
    """Results of the fuzzing.

    Attributes:
        read: Number of files of each kind.
        refused: Number of refused files of each kind.
        wrong: Descriptions of all other results.
    """

    read: Counter[str] = field(default_factory=Counter)
    refused: Counter[str] = field(default_factory=Counter)
    wrong: list[str] = field(default_factory=list)


class Fuzzer:
    """A fuzzer of the file readers.

    Args:
        scratch: Empty folder for the files.
        seed: Seed of the random changes.
    """

    def __init__(self, scratch: Path, seed: int) -> None:
        self._rng = np.random.default_rng(seed)
        self._scratch = scratch
        shutil.copy(ROOT / "config" / "bridge_foreign.yaml", scratch)
        self.report = Report()
        self._run = scratch / "run"
        run = OfflineRun(self._run, toy_optimizer(3), toy, 3)
        for _ in range(9):
            run.step()
        run.log.append(EndRecord(1.0, "budget"))
        run.log.close()
        self._records = read_journal(self._run)
        self._history = History.from_records(self._records)
        (self._run / "config.yaml").write_bytes((ROOT / "config/toy.yaml").read_bytes())
        write_bag(scratch / "bag", self._records)
        [bag] = (scratch / "bag").glob("*.mcap")
        rosbags.convert.convert(
            [scratch / "bag"],
            scratch / "sqlite",
            dst_storage="sqlite3",
            dst_version=9,
            compress=None,
            compress_mode="none",
            default_typestore=None,
            typestore=None,
            exclude_topics=(),
            include_topics=(),
            exclude_msgtypes=(),
            include_msgtypes=(),
        )
        [database] = (scratch / "sqlite").glob("*.db3")
        self._bags = {".mcap": bag.read_bytes(), ".db3": database.read_bytes()}
        self._state = (self._run / STATE_NAME).read_bytes()
        recorded = RecordedRun.from_records(self._records)
        self._facts = {"run_id": "run", "state": "finished", "pid": 1, "arguments": {"seed": 1}}
        self._summary = summarize(recorded)

    def run(self, count: int) -> Report:
        """Test `count` corrupted files."""
        readers: dict[str, Callable[[], None]] = {
            "configuration": self._configuration,
            "mapping": self._mapping,
            "resumed configuration": self._resumed,
            "journal": self._journal,
            "state": self._saved_state,
            "bag": self._rebuilt,
            "run.json": self._listed,
        }
        signal.signal(signal.SIGALRM, _too_slow)
        for kind in self._rng.choice(list(SHARES), count, p=list(SHARES.values())):
            self.report.read[kind] += 1
            signal.alarm(TIME_LIMIT)
            try:
                readers[kind]()
            except REFUSALS as error:
                self.report.refused[kind] += 1
                text = str(error)
                if not text or "\n" in text or len(text) > LONGEST:
                    self.report.wrong.append(f"{kind}: not a one-line error: {text[:300]!r}")
            except Exception:  # a bug of the reader
                self.report.wrong.append(f"{kind}: {traceback.format_exc()}")
            finally:
                signal.alarm(0)
        return self.report

    # ------------------------------------------------------------------ the readers

    def _configuration(self) -> None:
        name = str(self._rng.choice(["awa.yaml", "toy.yaml", "foreign.yaml"]))
        configuration = check(self._altered_yaml(ROOT / "config" / name), MACHINES)
        explanation(configuration)
        copies = self._scratch / "copies"
        copies.mkdir(exist_ok=True)
        copy_to(copies, configuration)

    def _mapping(self) -> None:
        load_mapping(str(self._altered_yaml(ROOT / "config" / "bridge_foreign.yaml")))

    def _resumed(self) -> None:
        path = self._altered_yaml(ROOT / "config" / "toy.yaml")
        resume_config(self._run, path, int(self._rng.integers(0, 30)))

    def _journal(self) -> None:
        folder = self._scratch / "altered"
        folder.mkdir(exist_ok=True)
        if self._rng.random() < 0.4:
            content = self._altered_bytes((self._run / FILE_NAME).read_bytes())
        else:
            records = copy.deepcopy(self._records)
            number = int(self._rng.integers(len(records)))
            records[number] = self._altered(records[number])
            if self._rng.random() < 0.2:
                records.insert(number, records[int(self._rng.integers(len(records)))])
            content = "".join(
                json.dumps(record, default=repr) + "\n" for record in records
            ).encode()
        (folder / FILE_NAME).write_bytes(content)
        records = read_journal(folder)
        recorded = RecordedRun.from_records(records)
        summarize(recorded)
        render_page(recorded, folder)
        history = History.from_records(records)
        if self._rng.random() < 0.05:
            restore(history, SavedState.read(self._run))

    def _saved_state(self) -> None:
        folder = self._scratch / "altered"
        folder.mkdir(exist_ok=True)
        text, _ = self._state.strip().split(b"\n")
        if self._rng.random() < 0.3:
            content = self._altered_bytes(self._state)
        else:  # a valid checksum over invalid content
            text = json.dumps(self._altered(json.loads(text)), default=repr).encode()
            content = text + b"\n" + checksum(text) + b"\n"
        (folder / STATE_NAME).write_bytes(content)
        saved = SavedState.read(folder)
        if saved is not None:
            saved.revive(self._history)

    def _rebuilt(self) -> None:
        suffix = str(self._rng.choice(list(self._bags)))
        path = self._scratch / f"altered{suffix}"
        path.write_bytes(self._altered_bytes(self._bags[suffix]))
        runs_of_bag(path)
        records_of_bag(path)

    def _listed(self) -> None:
        folder = self._scratch / "listed"
        folder.mkdir(exist_ok=True)
        for name, content in (("run.json", self._facts), ("summary.json", self._summary)):
            text = json.dumps(self._altered(copy.deepcopy(content)), default=repr).encode()
            altered = self._altered_bytes(text) if self._rng.random() < 0.2 else text
            (folder / name).write_bytes(altered)
        run = RunFolder(folder)
        run.row()
        run.description()

    # ------------------------------------------------------------------ the changes

    def _altered_yaml(self, path: Path) -> Path:
        altered = self._scratch / "altered.yaml"
        content = path.read_bytes()
        kind = self._rng.random()
        if kind < 0.4:
            content = self._altered_bytes(content)
        elif kind < 0.97:
            structure = yaml.safe_load(content)
            for _ in range(int(self._rng.integers(1, 3))):
                structure = self._altered(structure)
            content = yaml.safe_dump(structure, allow_unicode=True).encode("utf-8", "replace")
        else:
            text = content.decode()
            words = [w for w in text.split() if w.replace(".", "").strip("-,{}").isdigit()]
            word = str(self._rng.choice(words)).strip("{},")
            content = text.replace(f" {word}", f" {_BOMB}", 1).encode()
        altered.write_bytes(content)
        return altered

    def _altered_bytes(self, content: bytes) -> bytes:
        """Return the content with some bytes changed, removed, repeated or inserted."""
        data = bytearray(content)
        for _ in range(int(self._rng.integers(1, 5))):
            place = int(self._rng.integers(len(data) + 1))
            length = min(int(10.0 ** self._rng.uniform(0.0, 3.5)), len(data) - place)
            kind = int(self._rng.integers(5))
            if kind == 0:
                del data[place:]
            elif kind == 1:
                del data[place : place + length]
            elif kind == 2:
                data[place:place] = data[place : place + length]
            elif kind == 3:
                data[place:place] = _SNIPPETS[int(self._rng.integers(len(_SNIPPETS)))]
            elif length:
                data[place : place + 1] = self._rng.bytes(1)
        return bytes(data)

    def _altered(self, structure: Any) -> Any:
        """Return the structure with one value replaced, removed, duplicated or renamed."""
        place = self._place(structure)
        if place is None:
            return _VALUES[int(self._rng.integers(len(_VALUES)))]
        parent, key = place
        kind = int(self._rng.integers(5))
        if kind == 0:
            del parent[key]
        elif kind == 1 and isinstance(parent, dict):
            parent[str(_VALUES[int(self._rng.integers(len(_VALUES)))])] = parent.pop(key)
        elif kind == 2 and isinstance(parent, list):
            parent.insert(key, copy.deepcopy(parent[key]))
        else:
            parent[key] = copy.deepcopy(_VALUES[int(self._rng.integers(len(_VALUES)))])
        return structure

    def _place(self, structure: Any) -> tuple[Any, Any] | None:
        """Return a random place in a structure: its container, and its key or index."""
        parent, key = None, None
        while isinstance(structure, dict | list) and structure:
            keys = list(structure) if isinstance(structure, dict) else range(len(structure))
            parent, key = structure, keys[int(self._rng.integers(len(keys)))]
            structure = parent[key]
            if self._rng.random() < 0.2:
                break
        return None if parent is None else (parent, key)


def _too_slow(*_: object) -> None:
    raise SlowError(f"not done after {TIME_LIMIT} s")


def main() -> int:
    """Fuzz the readers, and print the results."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=10_000, help="number of files")
    parser.add_argument("--seed", type=int, default=0, help="seed of the random changes")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        report = Fuzzer(Path(scratch), options.seed).run(options.count)
    print(f"{report.read.total()} files read, {len(report.wrong)} wrong")
    for kind, number in sorted(report.read.items()):
        print(f"{number:6d}  {kind}, {report.refused[kind]} refused")
    kinds: dict[str, list[str]] = {}
    for text in report.wrong:
        kinds.setdefault(" ".join(text.strip().splitlines()[-3:])[-300:], []).append(text)
    for texts in kinds.values():
        print(f"{len(texts)} like this: {texts[0]}")
    return 1 if report.wrong else 0


if __name__ == "__main__":
    sys.exit(main())

"""The pictures of docs/method.md and docs/machine.md can be drawn; the table of presets says what the presets are."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

from mobo_tuner.core.settings import PRESETS

DOCS = Path(__file__).resolve().parents[1] / "docs"
METHOD = (DOCS / "method.md").read_text(encoding="utf-8")
MACHINE = (DOCS / "machine.md").read_text(encoding="utf-8")


def test_the_script_draws_the_pictures_of_the_documents(tmp_path: Path) -> None:
    quick = ["--particles", "200", "--samples", "100", "--evaluations", "12"]
    done = subprocess.run(
        [sys.executable, "-W", "error", str(DOCS / "make_pictures.py"), str(tmp_path), *quick],
        capture_output=True,
        text=True,
        timeout=100,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    drawn = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    shown = set(re.findall(r"\]\(images/([^)]+)\)", METHOD + MACHINE))
    assert set(drawn) == {name for name in shown if not name.startswith("paper_")}
    assert all(content.startswith(b"\x89PNG\r\n\x1a\n") for content in drawn.values())


def test_the_table_of_presets_is_current() -> None:
    rows = re.findall(r"^\| `(\w+)` \| `([^`]+)` \| `([^`]+)` \|", METHOD, flags=re.MULTILINE)
    default, paper = PRESETS["default"].to_dict(), PRESETS["paper"].to_dict()
    told = {name: values for name, *values in rows}
    assert told == {name: [repr(default[name]), repr(paper[name])] for name in told}
    differing = {name for name in default if default[name] != paper[name]}
    assert differing <= told.keys() | {"maximizer_settings"}  # those of the maximiser

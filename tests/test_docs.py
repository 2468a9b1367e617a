"""The generated documents are current, and the links in all documents lead somewhere."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
INTERFACES = sorted((ROOT / "src" / "mobo_msgs_py").glob("[ams]*/*.[ams]*"))
DOCUMENTS = [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")]


def test_the_generated_documents_are_current() -> None:
    done = subprocess.run(
        [sys.executable, str(ROOT / "tools" / "generate_docs.py"), "--check"],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_relative_links_lead_somewhere(path: Path) -> None:
    for target in re.findall(r"\]\(([^)#]+)[^)]*\)", path.read_text(encoding="utf-8")):
        if "://" not in target:
            assert (path.parent / target).exists(), f"{path.name} links to {target}"


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_every_table_has_a_head(path: Path) -> None:
    text = re.sub(r"^ *```.*?^ *```", "", path.read_text(encoding="utf-8"), flags=re.M | re.S)
    for table in re.findall(r"(?:^ *\|.*\n)+", text, flags=re.MULTILINE):
        assert re.match(r".*\n *\|[-:| ]+\|\n", table), (
            f"{table.splitlines()[0]} belongs to no table"
        )


@pytest.mark.parametrize("path", INTERFACES, ids=lambda path: path.name)
def test_every_field_and_constant_is_described_and_every_number_has_its_unit(path: Path) -> None:
    lines = path.read_text(encoding="utf-8").splitlines()
    assert lines[0].startswith("# ")
    for line in lines:
        declaration, _, description = (part.strip() for part in line.partition("#"))
        if declaration and declaration != "---":
            assert description.endswith("."), f"{line} has no description"
            if declaration.startswith("float"):
                assert re.search(r"\[.+\]", description), f"{line} has no unit"


def test_one_evaluation_passes_through_the_listed_files() -> None:
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    section = text.split("## One evaluation")[1].split("\n## ")[0]
    listed = re.findall(r"^\|[^|`]*\| `([^`]+)` \|", section, flags=re.MULTILINE)
    assert 15 < len(listed) <= 24
    assert len({*listed}) == len(listed)
    folders = [ROOT / "src" / name for name in ("mobo_tuner/mobo_tuner", "mobo_msgs_py", "")]
    for file in {*listed, *re.findall(r"`((?:\w+/)+\w+\.\w+)`", section)} - {"tests/test_docs.py"}:
        assert any((folder / file).is_file() for folder in folders), f"{file} does not exist"

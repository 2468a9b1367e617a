"""Each row of the page about what can go wrong is produced by the test that it names."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "troubleshooting.md"


def rows() -> list[list[str]]:
    """Cells of the table's rows."""
    lines = [line for line in PAGE.read_text().splitlines() if line.startswith("| ")]
    return [[cell.strip() for cell in line.strip("|").split(" | ")] for line in lines[1:]]


@pytest.mark.parametrize("row", rows(), ids=[row[0] for row in rows()])
def test_a_row_says_what_to_do_and_names_a_test(row: list[str]) -> None:
    assert len(row) == 4
    assert all(row)
    file, _, name = row[3].strip("`").partition("::")
    tree = ast.parse((ROOT / file).read_text(encoding="utf-8"))
    assert name in {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}


def test_every_row_has_a_case_of_its_own() -> None:
    cases = [row[0] for row in rows()]
    assert len(cases) > 20
    assert len(set(cases)) == len(cases)

"""A name in the glossary that is to be changed is in the code: who changes it takes its row out."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "explanation" / "glossary.md").read_text(encoding="utf-8")
PACKAGE = ROOT / "smarttac_can"
WORDS = {
    word for path in PACKAGE.rglob("*.py") for word in re.findall(r"\w+", path.read_text("utf-8"))
}
ROWS = [
    [cell.strip() for cell in line.strip("|").split("|")]
    for line in PAGE.split("\n## Names to be changed\n")[1].splitlines()
    if line.startswith("| ") and not line.startswith("| Old")
]
DEFINED = [
    word
    for line in PAGE.split("\n## Names to be changed\n")[0].splitlines()
    if line.startswith("| **")
    for word in re.findall(r"\*\*(.+?)\*\*", line.split("|")[1])
]


@pytest.mark.parametrize("row", ROWS, ids=lambda row: str(row[0]))
def test_an_old_name_is_where_the_table_says(row: list[str]) -> None:
    old, new, where, order = row
    for name in re.findall(r"`([\w.]+)[()]*`", old):
        assert set(name.split(".")) <= WORDS
    for file in re.findall(r"`([\w/]+\.py)`", where):
        assert any(path.as_posix().endswith(f"/{file}") for path in PACKAGE.rglob("*.py")), file
    assert new
    assert order in ("steps", "record", "any")


def test_a_name_is_changed_once() -> None:
    renamed = [(name, row[2]) for row in ROWS for name in re.findall(r"`([\w.]+)[()]*`", row[0])]
    assert len(renamed) == len(set(renamed)) > 0


def test_a_word_has_one_meaning() -> None:
    assert len(DEFINED) == len(set(DEFINED)) > 50

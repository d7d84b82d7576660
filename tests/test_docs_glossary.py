"""A word in the glossary has one meaning."""

import re
from pathlib import Path

PAGE = Path(__file__).parents[1] / "docs" / "explanation" / "glossary.md"
DEFINED = [
    word
    for line in PAGE.read_text(encoding="utf-8").splitlines()
    if line.startswith("| **")
    for word in re.findall(r"\*\*(.+?)\*\*", line.split("|")[1])
]


def test_a_word_has_one_meaning() -> None:
    assert len(DEFINED) == len(set(DEFINED)) > 50

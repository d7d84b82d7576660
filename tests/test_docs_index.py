"""A reader of the index, or of the site, finds every page, and once."""

import re
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[1] / "docs"
INDEX = (DOCS / "index.md").read_text(encoding="utf-8")
HISTORY = (DOCS / "dev" / "history.md").read_text(encoding="utf-8")
CONTENTS = (DOCS / "_toc.yml").read_text(encoding="utf-8")
PAGES = sorted(
    page.relative_to(DOCS).as_posix()
    for folder in ("how-to", "explanation", "reference", "dev", "dev/history")
    for page in (DOCS / folder).glob("*.md")
)


@pytest.mark.parametrize("page", PAGES)
def test_each_page_is_in_the_index_and_in_the_contents(page: str) -> None:
    assert f"]({page})" in INDEX or f"]({page.removeprefix('dev/')})" in HISTORY
    folder, _, _ = page.rpartition("/")
    assert f"glob: {folder}/*\n" in CONTENTS or f"file: {page.removesuffix('.md')}\n" in CONTENTS


def test_a_reader_has_one_row() -> None:
    readers = re.findall(r"^\| ([a-z].*?) \|", INDEX, re.MULTILINE)
    assert len(readers) > 5
    assert len(set(readers)) == len(readers)


def test_records_of_decisions_stand_in_numeric_order() -> None:
    numbers = re.findall(r"^\| \[(\d{4})\]", HISTORY, re.MULTILINE)
    assert len(numbers) > 5
    assert numbers == sorted(set(numbers))


def test_extras_are_installed_by_name_but_for_the_first_time() -> None:
    """``".[record]"`` is for a reader in a clone, which the tutorial alone explains."""
    pages = [
        page for page in PAGES if re.search(r"install .?\.\[", (DOCS / page).read_text("utf-8"))
    ]
    assert pages == []

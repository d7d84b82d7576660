"""A reader of the index, or of the site, finds every page, and once."""

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

"""``tools/pages/check_docs.py`` judges a small tree that was made up."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

TOOLS = Path(__file__).parents[2] / "tools" / "pages"
PAGE = """# A title that is no sentence at all

Two words. This one has six words, `a name` included: and [four](README.md) after a colon.

| a | table with many words that nobody counts |
|---|---|

* An item of five words.
* Another one.

```sh
no sentence either
```
"""


def judged(tree: Path, page: str, *options: str) -> tuple[int, str]:
    """Exit code and output for a README of its own."""
    (tree / "tools" / "pages").mkdir(parents=True)
    for name in ("check_docs.py", "pages.py"):
        shutil.copy(TOOLS / name, tree / "tools" / "pages")
    (tree / "README.md").write_text(page, encoding="utf-8")
    command = [sys.executable, str(tree / "tools" / "pages" / "check_docs.py"), *options]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert not done.stderr
    return done.returncode, done.stdout


def test_code_tables_and_headings_are_no_sentences(tmp_path: Path) -> None:
    code, printed = judged(tmp_path, PAGE, "--words")
    assert code == 0
    assert printed.splitlines()[-1] == "user pages: 5.2 words a sentence, 0.0% of 4 over 30"


@pytest.mark.parametrize(
    ("lengths", "refused"),
    [
        ([18] * 100, 0),
        ([18] * 99 + [19], 1),
        ([10] * 97 + [31] * 3, 0),
        ([10] * 96 + [31] * 4, 1),
    ],
)
def test_long_sentences_are_refused(tmp_path: Path, lengths: list[int], refused: int) -> None:
    page = " ".join("Word " * (n - 1) + "end." for n in lengths)
    code, printed = judged(tmp_path, page)
    assert code == refused
    assert ("user pages" in printed) == bool(refused)


def test_a_link_to_nowhere_is_refused(tmp_path: Path) -> None:
    code, printed = judged(tmp_path, "See [this](nowhere.md), it is short.")
    assert code == 1
    assert "nowhere.md" in printed


def test_a_long_page_is_refused(tmp_path: Path) -> None:
    most = 1200
    file = tmp_path / "docs" / "how-to" / "a.md"
    file.parent.mkdir(parents=True)
    row = "| a |\n"  # a word, and two strokes that are none
    for count, refused in ((most, 0), (most + 1, 1)):
        file.write_text(row * count, encoding="utf-8")
        shutil.rmtree(tmp_path / "tools", ignore_errors=True)
        code, printed = judged(tmp_path, PAGE)
        assert code == refused
        assert (f"{count} words, at most {most}" in printed) == bool(refused)

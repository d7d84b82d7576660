"""Check the pages: links lead to files of the repository, sentences and pages are short.

In the pages that users read (README, tutorial, how-to, explanation) a sentence has 18 words on
average at most, and 3 in 100 have more than 30. Code, tables and headings are not counted. A page
of how-to has 1200 words at most; here code and tables count, and a word has a letter or a digit.

Example: python tools/pages/check_docs.py --words
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from pages import parser_of

ROOT = Path(__file__).resolve().parents[2]
LINK = re.compile(r"\[[^\]]*\]\(([^)#\s]+)(?:#[^)]*)?\)")
MEAN_WORDS: Final = 18
LONG_WORDS: Final = 30
LONG_SHARE: Final = 0.03
MOST_WORDS: Final = 1200
_NOT_FOR_USERS: Final = {"reference", "dev"}
_ITEM: Final = r"[ \t]*(?:[*-]|\d+\.) "
_BLOCKS: Final = re.compile(rf"\n\s*\n|\n(?={_ITEM})")
_NO_PROSE: Final = ("|", "#", ":::", "<", "![")
_CODE: Final = re.compile(r"```.*?```", re.DOTALL)
_NOT_READ: Final = re.compile(r"<!--.*?-->")
"""Marks of the fields that tools fill."""
_END: Final = re.compile(r"(?<=[.!?:;])\s+(?=[A-Z*`0-9\"(])")


def broken_links(document: Path) -> list[str]:
    """Return the relative link targets in a document that do not exist."""
    targets: list[str] = LINK.findall(document.read_text(encoding="utf-8"))
    return [
        target
        for target in targets
        if "://" not in target
        and not target.startswith("mailto:")
        and not (document.parent / target).exists()
    ]


def sentence_lengths(text: str) -> Iterator[int]:
    """Yield the words of each sentence of a page; a word alone, like a label, is none."""
    for block in _BLOCKS.split(_NOT_READ.sub("", _CODE.sub("\n\n", text))):
        lines = [line.strip() for line in block.splitlines()]
        prose = " ".join(line for line in lines if not line.startswith(_NO_PROSE))
        prose = re.sub(rf"^{_ITEM}", "", prose)
        prose = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", prose)
        prose = re.sub(r"`[^`]*`", "X", prose)
        for sentence in _END.split(prose):
            words = len(re.findall(r"[\w'%./-]+", sentence))
            if words > 1:
                yield words


def words(page: Path) -> int:
    """Count the words of a page, code and tables with it."""
    text = _NOT_READ.sub("", page.read_text(encoding="utf-8"))
    return sum(any(map(str.isalnum, word)) for word in text.split())


def too_long() -> Iterator[str]:
    """Name each page with too many words."""
    for page in sorted((ROOT / "docs" / "how-to").glob("*.md")):
        count = words(page)
        if count > MOST_WORDS:
            yield f"how-to/{page.name}: {count} words, at most {MOST_WORDS}"


def user_pages() -> list[Path]:
    """Return the pages that users read."""
    docs = ROOT / "docs"
    pages = [p for p in docs.rglob("*.md") if p.relative_to(docs).parts[0] not in _NOT_FOR_USERS]
    return [ROOT / "README.md", *sorted(pages)]


def main() -> int:
    """Print the errors, and return 1 if there are any."""
    parser = parser_of(__doc__)
    parser.add_argument("--words", action="store_true", help="print the figures of each page")
    arguments = parser.parse_args()
    documents = [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")]
    broken = [(document, target) for document in documents for target in broken_links(document)]
    for document, target in broken:
        print(f"{document.relative_to(ROOT)}: no such file: {target}")
    long = list(too_long())
    print("\n".join(long), end="\n" if long else "")
    found: list[int] = []
    for page in user_pages():
        lengths = list(sentence_lengths(page.read_text(encoding="utf-8")))
        found += lengths
        if arguments.words and lengths:
            print(f"{page.relative_to(ROOT)}: {_figures(lengths)}")
    wordy = sum(found) / len(found) > MEAN_WORDS or _long_share(found) > LONG_SHARE
    if wordy or arguments.words:
        print(f"user pages: {_figures(found)}")
    return 1 if broken or long or wordy else 0


def _long_share(lengths: list[int]) -> float:
    return sum(words > LONG_WORDS for words in lengths) / len(lengths)


def _figures(lengths: list[int]) -> str:
    mean = sum(lengths) / len(lengths)
    share = _long_share(lengths)
    return f"{mean:.1f} words a sentence, {share:.1%} of {len(lengths)} over {LONG_WORDS}"


if __name__ == "__main__":
    sys.exit(main())

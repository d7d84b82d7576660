"""Common parts of the tools that make pages: the command line, --check, and fields of a page."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from difflib import unified_diff
from pathlib import Path
from typing import Final

from smarttac_can.canopen.od.object_reference import table

DOCS: Final = Path(__file__).resolve().parents[2] / "docs"
EXPLANATION: Final = DOCS / "explanation"
REFERENCE: Final = DOCS / "reference"
_FIELD: Final = re.compile(r"(<!-- (\w+) -->)(.*?)(<!-- / -->)", re.DOTALL)
Pages = Mapping[Path, str]
"""Text of each page."""


def parser_of(text: str | None) -> argparse.ArgumentParser:
    """Return a parser whose help is the docstring of a tool."""
    return argparse.ArgumentParser(
        description=text, formatter_class=argparse.RawDescriptionHelpFormatter
    )


def differences(pages: Pages) -> list[str]:
    """Return how the files differ from the pages, a line each; none if they are the same."""
    lines: list[str] = []
    for path, text in pages.items():
        old = path.read_text(encoding="utf-8") if path.exists() else ""
        lines += unified_diff(
            old.splitlines(), text.splitlines(), path.name, "now", lineterm="", n=0
        )
        if not lines and old != text:
            lines.append(f"{path.name} ends in another way")
    return lines


def write(pages: Pages) -> None:
    """Write all pages anew, and say where they are."""
    for path, text in pages.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
        print(f"written: {path}", file=sys.stderr)


def made(text: str | None, pages: Callable[..., Pages], seed: int | None = None) -> int:
    """Be a tool that writes pages; with --check it compares them alone.

    Parameters
    ----------
    text
        Docstring of the tool.
    pages
        Makes the pages, and draws their figures where it is asked to.
    seed
        Default of an option --seed, which is handed on by its name; None for no option.

    Returns
    -------
    int
        Exit code: 1 if a page is out of date.
    """
    parser = parser_of(text)
    parser.add_argument("--check", action="store_true", help="write nothing, compare")
    if seed is not None:
        parser.add_argument("--seed", type=int, default=seed, help="of what is drawn")
    options = vars(parser.parse_args())
    print(f"{parser.prog}: {(text or '').splitlines()[0]}", file=sys.stderr, flush=True)
    if options.pop("check"):
        stale = differences(pages(False, **options))
        print("\n".join(stale), end="\n" if stale else "")
        return 1 if stale else 0
    write(pages(True, **options))
    return 0


def columns(head: str, rows: Iterable[Iterable[str]]) -> Iterator[str]:
    """Yield the lines of a table; its head gives the columns, divided by |."""
    return table(tuple(cell.strip() for cell in head.split("|")), *map(tuple, rows))


def renewed(page: Path, fields: Mapping[str, str | Iterable[str]]) -> Pages:
    """Return a page with its fields made anew; the text between them is written by hand.

    Parameters
    ----------
    page
        Has each field as ``<!-- name -->text<!-- / -->``.
    fields
        New text of each, by name; one of lines is a table.

    Raises
    ------
    KeyError, ValueError
        If the page has a field that is not given, or lacks one that is.
    """
    names = set()

    def anew(field: re.Match[str]) -> str:
        names.add(name := field[2])
        value = fields[name]
        text = value if isinstance(value, str) else "\n".join(["", *value]).rstrip() + "\n"
        return f"{field[1]}{text}{field[4]}"

    text = _FIELD.sub(anew, page.read_text(encoding="utf-8"))
    if missing := fields.keys() - names:
        raise ValueError(f"{page.name} has no field {', '.join(sorted(missing))}")
    return {page: text}

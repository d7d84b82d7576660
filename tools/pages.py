"""What the tools share that make pages: the command line, --check, and templates."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Iterator, Mapping
from difflib import unified_diff
from pathlib import Path
from typing import Final

from smarttac_can.od.object_reference import table

DOCS: Final = Path(__file__).resolve().parent.parent / "docs"
EXPLANATION: Final = DOCS / "explanation"
REFERENCE: Final = DOCS / "reference"
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
    """Write all pages anew."""
    for path, text in pages.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")


def made(text: str | None, pages: Callable[[bool], Pages]) -> int:
    """Be a tool that writes pages; with --check it compares them alone.

    Parameters
    ----------
    text
        Docstring of the tool.
    pages
        Makes the pages, and draws their figures where it is asked to.

    Returns
    -------
    int
        Exit code: 1 if a page is not what would be written.
    """
    parser = parser_of(text)
    parser.add_argument("--check", action="store_true", help="write nothing, compare")
    if parser.parse_args().check:
        stale = differences(pages(False))
        print("\n".join(stale), end="\n" if stale else "")
        return 1 if stale else 0
    write(pages(True))
    return 0


def columns(head: str, rows: Iterable[Iterable[str]]) -> Iterator[str]:
    """Yield the lines of a table; its head gives the columns, divided by |."""
    return table(tuple(cell.strip() for cell in head.split("|")), *map(tuple, rows))


def filled(tool: str, fields: Mapping[str, str | Iterable[str]]) -> str:
    """Return the template beside a tool with its fields; one of lines is a table.

    Parameters
    ----------
    tool
        Path of the tool: ``__file__``.
    fields
        What stands for ``{name}`` in the template.
    """
    texts = {
        name: value if isinstance(value, str) else "\n".join(value).strip()
        for name, value in fields.items()
    }
    return Path(tool).with_suffix(".md").read_text(encoding="utf-8").format(**texts)

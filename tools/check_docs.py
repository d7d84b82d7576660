"""Check that every relative link in the Markdown files leads to a file of the repository.

Example: python tools/check_docs.py
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

from pages import parser_of

ROOT = Path(__file__).resolve().parent.parent
LINK = re.compile(r"\[[^\]]*\]\(([^)#\s]+)(?:#[^)]*)?\)")


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


def main() -> int:
    """Print the broken links and return 1 if there are any."""
    parser_of(__doc__).parse_args()
    documents = [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")]
    broken = [(document, target) for document in documents for target in broken_links(document)]
    for document, target in broken:
        print(f"{document.relative_to(ROOT)}: no such file: {target}")
    return 1 if broken or not documents else 0


if __name__ == "__main__":
    sys.exit(main())

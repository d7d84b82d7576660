"""The folder of a campaign: its results, a table of all fingers, and a picture."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Final

from smarttac_can.campaign.chunk import COLUMNS, Rows
from smarttac_can.campaign.summary import lines

RESULTS, FINGERS, PICTURE = "campaign.json", "fingers.csv", "campaign.png"
_DPI: Final = 110


def write_folder(folder: Path, results: dict[str, Any], rows: Rows) -> Path:
    """Write a folder, and return the path of the picture; the same results make the same bytes.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    from smarttac_can.campaign.figures import distributions  # noqa: PLC0415  # matplotlib is an extra

    folder.mkdir(parents=True, exist_ok=True)
    text = json.dumps(results, indent=2) + "\n"
    (folder / RESULTS).write_text(text, encoding="utf-8")
    with (folder / FINGERS).open("w", encoding="ascii", newline="") as file:
        file.write(",".join(("finger", *COLUMNS)) + "\n")
        for number, row in enumerate(rows):
            file.write(",".join((str(number), *map(repr, row.tolist()))) + "\n")
    picture = folder / PICTURE
    distributions(rows, lines(results)[0]).savefig(picture, dpi=_DPI)
    return picture

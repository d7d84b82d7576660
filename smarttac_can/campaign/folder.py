"""The folder of a campaign: its results, a table of all fingers, and a picture as PNG and SVG."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Final

from smarttac_can.campaign.chunk import COLUMNS, Rows
from smarttac_can.campaign.summary import lines

RESULTS, FINGERS, PICTURE = "campaign.json", "fingers.csv", "campaign.png"
FILES: Final = (RESULTS, FINGERS, PICTURE, "campaign.svg")
"""All that `write_folder` writes."""


def write_folder(folder: Path, results: dict[str, Any], rows: Rows) -> Path:
    """Write a folder, and return the path of the PNG; the same results make the same bytes.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    # matplotlib is an extra.
    from smarttac_can.bench.drawing import save  # noqa: PLC0415
    from smarttac_can.campaign.figures import distributions  # noqa: PLC0415

    folder.mkdir(parents=True, exist_ok=True)
    text = json.dumps(results, indent=2) + "\n"
    (folder / RESULTS).write_text(text, encoding="utf-8")
    with (folder / FINGERS).open("w", encoding="ascii", newline="") as file:
        file.write(",".join(("finger", *COLUMNS)) + "\n")
        for number, row in enumerate(rows):
            file.write(",".join((str(number), *map(repr, row.tolist()))) + "\n")
    picture = folder / PICTURE
    save(distributions(rows, lines(results)[0]), picture)
    return picture

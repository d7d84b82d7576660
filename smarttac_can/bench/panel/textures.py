"""Textures of a page: made of what a person enters, and drawn for the plate."""

from __future__ import annotations

import threading
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final, TypeVar

from smarttac_can.bench import Texture
from smarttac_can.vocabulary.textures import Axis

_BINS: Final = 380
"""Columns of a drawing: 0.2 mm of the plate each."""
_PLACES: Final = 4
"""Places of a column at which the COF is looked up."""
_HALF_NM: Final = 38_000_000
_ONE_BY_ONE = threading.Lock()
_Result = TypeVar("_Result")


def made(form: Mapping[str, str], file: Path | None) -> Texture:
    """Make a texture from the fields of a form, and a file for a picture or a table.

    Raises
    ------
    ValueError
        If a field is missing, or what `Texture` refuses.
    OSError, BenchError
        If the file cannot be read.
    """
    kind = form.get("kind", "")
    if kind == "grating":
        duty = _number(form, "duty") / 100.0
        levels = _number(form, "low"), _number(form, "high")
        return Texture.grating(_number(form, "period"), *levels, duty, form.get("shape", ""))
    if file is None:
        raise ValueError("choose a file")
    if kind == "picture":
        levels = _number(form, "low"), _number(form, "high")
        row = round(_number(form, "row"))
        return Texture.from_picture(file, row, *levels, _number(form, "width"))
    if kind == "csv":
        place, cof = form.get("place", ""), form.get("cof", "")
        if form.get("over") == "time":
            return Texture.from_csv(file, time=place, cof=cof)
        return Texture.from_csv(file, position=place, cof=cof)
    raise ValueError(f"kind {kind!r} is none of grating, picture, csv")


def _number(form: Mapping[str, str], name: str) -> float:
    try:
        return float(form[name])
    except (KeyError, ValueError):
        raise ValueError(f"{name} {form.get(name, '')!r} is no number") from None


def drawn(texture: Texture, label: str) -> dict[str, Any]:
    """Return a texture as the page draws it.

    Returns
    -------
    dict
        ``label``; ``over``, mm or s; ``bins``, a list of place, least and greatest COF.
    """
    table = texture.table
    over_place = table.axis is Axis.POSITION
    begin = -_HALF_NM if over_place else 0
    length = 2 * _HALF_NM if over_place else table.step * len(table.values)
    bins = []
    for number in range(_BINS):
        places = [begin + (number + k / _PLACES) * length / _BINS for k in range(_PLACES + 1)]
        values = [round(table.at(place), 4) for place in places]
        bins.append((round((begin + number * length / _BINS) * 1e-6, 3), min(values), max(values)))
    return {"label": label, "over": "mm" if over_place else "s", "bins": bins}


def with_warnings(do: Callable[[], _Result]) -> tuple[_Result, str]:
    """Call a function; return its result, and what it warned of, as one text.

    The filter of warnings is that of the process, so one call waits for another.
    """
    with _ONE_BY_ONE, warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        result = do()
    return result, "; ".join(str(each.message) for each in caught)

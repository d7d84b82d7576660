"""What the steps of an object make of a quantity that a person gives."""

from __future__ import annotations

from smarttac_can.od.entry import Entry
from smarttac_can.od.units import Quantity


def require_kept(entry: Entry, raw: int, given: str) -> None:
    """Refuse a quantity of which rounding leaves nothing.

    Parameters
    ----------
    entry
        Object that it is for.
    raw
        What it is rounded to.
    given
        Such as ``80 V``.

    Raises
    ------
    ValueError
        If it is not 0, and 0 would go over the wire; names it and the step of the object, or the
        lowest value if it is below that.
    """
    quantity = Quantity.parse(given)
    if raw == 0 and quantity.number:
        if quantity.over(entry.unit) < entry.low:
            lowest = f"{entry.low * float(entry.unit.number):.12g} {entry.unit.symbol}".rstrip()
            raise ValueError(f"{entry.name} {given} is below {lowest}, its lowest value")
        step = f"{entry.unit.number:f} {entry.unit.symbol}".rstrip()
        raise ValueError(f"{entry.name} {given} would become 0: it goes in steps of {step}")

"""Object dictionary: EDS loading, data types, units, limits, and the timing of its PDOs."""

from __future__ import annotations

from typing import TYPE_CHECKING

from smarttac_can._faces import lazily

if TYPE_CHECKING:
    from smarttac_can.od.dictionary import ObjectDictionary
    from smarttac_can.od.eds import load_eds
    from smarttac_can.od.entry import Entry
    from smarttac_can.od.units import Quantity

__all__ = ["Entry", "ObjectDictionary", "Quantity", "load_eds"]

__getattr__ = lazily(
    __name__,
    {
        "Entry": "entry",
        "ObjectDictionary": "dictionary",
        "load_eds": "eds",
        "Quantity": "units",
    },
)

"""Object dictionary: EDS loading, data types, units, limits, and the timing of its PDOs."""

from smarttac_can.canopen.od.dictionary import ObjectDictionary
from smarttac_can.canopen.od.eds import load_eds
from smarttac_can.canopen.od.entry import Entry
from smarttac_can.canopen.od.units import Quantity

__all__ = ["Entry", "ObjectDictionary", "Quantity", "load_eds"]

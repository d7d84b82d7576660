"""The public TPDOs of a stimulator, as a listener decodes them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Final

from smarttac_can.bench.link import PUBLIC, PublishedPdo, published_pdos
from smarttac_can.device.frame import Frame
from smarttac_can.od.cia import PDO_COB_ID, TPDO_COMMUNICATION, TPDO_MAPPING
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.od.entry import Entry

OLD_S: Final = 2.0
"""A value that has not come for so long is not shown: 20 event times by default."""
_PLACES: Final = range(9)


def mapping_entries(od: ObjectDictionary) -> Iterator[Entry]:
    """Yield the entries that say what the public TPDOs carry."""
    for number in PUBLIC:
        yield od.entry(TPDO_COMMUNICATION + number - 1, PDO_COB_ID)
        for place in _PLACES:
            yield od.entry(TPDO_MAPPING + number - 1, place)


class PublishedValues:
    """What the public TPDOs brought last; decoded by the defaults of the EDS until told otherwise.

    Parameters
    ----------
    od
        EDS of the stimulator, loaded for its node-ID.
    """

    def __init__(self, od: ObjectDictionary) -> None:
        self._od = od
        self._pdos: dict[int, PublishedPdo] = {}
        self._ill: set[int] = set()
        self._since = 0.0
        self.remap({}, 0.0)

    def remap(self, told: Mapping[Entry, int], now: float) -> None:
        """Decode by what the node has told of its mapping; by the EDS where it has not.

        Parameters
        ----------
        told
            Raw values of entries of `mapping_entries`.
        now
            Time in s.
        """
        pdos = published_pdos(self._od, lambda entry: told.get(entry, int(entry.default)))
        self._pdos = {pdo.can_id: pdo for pdo in pdos}
        self._ill = set()
        self._since = now

    def take(self, now: float, frame: Frame) -> bool:
        """Take any frame of the bus; return whether it was one of the TPDOs."""
        pdo = self._pdos.get(frame.can_id)
        if pdo is None or frame.rtr:
            return False
        if pdo.take(frame.data, now):
            self._ill.discard(pdo.number)
        else:
            self._ill.add(pdo.number)
        return True

    def at(self, now: float) -> dict[str, int]:
        """Return the raw values, by name, that are not old at a time in s."""
        return {
            name: value
            for pdo in self._pdos.values()
            if pdo.received is not None and now - pdo.received <= OLD_S
            for name, value in zip(pdo.names, pdo.values, strict=True)
        }

    def last(self, name: str) -> tuple[float, int] | None:
        """Return when an object came last, in s, and its raw value; None if it has not."""
        for pdo in self._pdos.values():
            if pdo.received is not None and name in pdo.names:
                return pdo.received, pdo.values[pdo.names.index(name)]
        return None

    def complaints(self, now: float) -> Iterator[str]:
        """Say which TPDOs have another length than their mapping, or do not come."""
        if not self._pdos:
            yield "none of the TPDOs 1 to 4 is valid: nothing is published"
        for pdo in self._pdos.values():
            last = self._since if pdo.received is None else pdo.received
            if pdo.number in self._ill:
                yield f"TPDO {pdo.number} is not as long as its mapping: it is not decoded"
            elif now - last > OLD_S:
                yield f"TPDO {pdo.number} has not come for {now - last:.0f} s"

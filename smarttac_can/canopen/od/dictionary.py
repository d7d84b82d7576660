"""The object dictionary: the entries of a device by index, sub-index and name."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from smarttac_can.canopen.od import cia
from smarttac_can.canopen.od.cia import Abort, AbortCode, ObjectType
from smarttac_can.canopen.od.data_types import bounds
from smarttac_can.canopen.od.entry import Entry
from smarttac_can.canopen.od.units import split_name


@dataclass(frozen=True, slots=True)
class Object:
    """One index of the object dictionary."""

    index: int
    name: str
    object_type: ObjectType
    entries: dict[int, Entry]
    """Entries by sub-index; a VAR has only 0."""

    @property
    def structure(self) -> int:
        """Content of sub-index FFh (CiA 301, 7.4.7.3): data type above object code."""
        if self.object_type is ObjectType.RECORD:
            found = (data for first, last, data in cia.RECORD_TYPES if first <= self.index <= last)
            data_type = next(found, 0)
        else:
            # An ARRAY has the type of its elements, of which the EDS may describe only some.
            elements = [entry for entry in self.entries.values() if entry.subindex]
            data_type = (elements or list(self.entries.values()))[0].data_type
        return data_type << 8 | self.object_type


class ObjectDictionary:
    """All objects of one device.

    Entries are found by index and sub-index, or by name without the unit: ``od["Mode"]`` for a
    VAR, ``od["Setpoint.Voltage"]`` for a member of an array or record. Iteration is by index.

    Parameters
    ----------
    node_id
        Node-ID for which ``$NODEID`` was replaced, 1..127; see `renumber`.
    objects
        Objects in any order.
    dummies
        Data types that an RPDO may map as a dummy.
    info
        Keys of ``[DeviceInfo]`` in lower case.
    warnings
        Ambiguities and errors of the EDS that were corrected, one line each.
    text
        Content of the EDS.
    """

    def __init__(
        self,
        node_id: int,
        objects: list[Object],
        dummies: frozenset[int] = frozenset(),
        info: dict[str, str] | None = None,
        warnings: list[str] | None = None,
        text: str = "",
    ) -> None:
        self.node_id = node_id
        self.objects = {item.index: item for item in sorted(objects, key=lambda item: item.index)}
        self.dummies = dummies
        self.info = info or {}
        self.warnings = warnings or []
        self.text = text
        self._names: dict[str, Entry | None] = {}
        for entry in self:
            # None marks a name that several entries have.
            self._names[entry.name] = None if entry.name in self._names else entry

    def __iter__(self) -> Iterator[Entry]:
        for item in self.objects.values():
            yield from item.entries.values()

    def __contains__(self, name: str) -> bool:
        return self._names.get(name) is not None

    def __getitem__(self, name: str) -> Entry:
        entry = self._names.get(name)
        if entry is None:
            what = "stands for several entries" if name in self._names else "is not in the EDS"
            raise KeyError(f"{name!r} {what}")
        return entry

    def find(self, name: str) -> Entry | None:
        """Return the entry with a name; None if there is none or more than one."""
        return self._names.get(name)

    def called(self, name: str) -> Entry | None:
        """Return the entry that a person calls by a name; None if there is none or more than one.

        Besides its own name, it takes the spellings that `smarttac_can.canopen.od.units` lists.
        """
        if (entry := self.find(name)) is not None:
            return entry
        try:
            title, unit = split_name(name)
        except ValueError:
            return None
        bracketed = title != name
        if bracketed and (entry := self.find(title)) is not None:
            return entry if entry.unit == unit else None
        found = [
            entry
            for entry in self
            if entry.name.rpartition(".")[2] == title and not (bracketed and entry.unit != unit)
        ]
        return found[0] if len(found) == 1 else None

    def entry(self, index: int, subindex: int = 0) -> Entry:
        """Return the entry at an index and sub-index.

        Raises
        ------
        Abort
            NO_OBJECT or NO_SUBINDEX if it is not in the EDS.
        """
        item = self.objects.get(index)
        if item is None:
            raise Abort(AbortCode.NO_OBJECT)
        entry = item.entries.get(subindex)
        if entry is None:
            raise Abort(AbortCode.NO_SUBINDEX)
        return entry

    def get(self, index: int, subindex: int = 0) -> Entry | None:
        """Return the entry at an index and sub-index; None if it is not in the EDS."""
        item = self.objects.get(index)
        return None if item is None else item.entries.get(subindex)

    def number(self, index: int, subindex: int = 0, absent: int = 0) -> int:
        """Return the value of an integer entry, or ``absent`` if it is not in the EDS."""
        entry = self.get(index, subindex)
        return absent if entry is None else int(entry.read())

    @property
    def sync_id(self) -> int:
        """Present CAN-ID of SYNC."""
        return self.number(cia.SYNC_COB_ID, absent=cia.SYNC_ID) & cia.CAN_ID_MASK

    def write(self, name: str, raw: Any, ask: Callable[[Entry, Any], None]) -> None:
        """Write a raw value to an entry by its name, as an SDO download does.

        Parameters
        ----------
        name, raw
            Name of the entry, and its new raw value.
        ask
            Function that is called after `Entry.check` and before the write; it may raise `Abort`.

        Raises
        ------
        Abort
            The value is refused; the entry is then unchanged.
        """
        entry = self[name]
        entry.check(raw)
        ask(entry, raw)
        entry.value = raw

    def renumber(self, node_id: int) -> None:
        """Set the node-ID, 1..127, in the defaults and limits that contain ``$NODEID``."""
        for entry in self:
            least, most = bounds(entry.data_type)
            for attribute in entry.per_node:
                value = getattr(entry, attribute) - self.node_id + node_id
                setattr(entry, attribute, min(max(value, least), most))
        self.node_id = node_id

    def reset(self, first: int = 0, last: int = 0xFFFF) -> None:
        """Set the objects first..last to their defaults, except computed entries."""
        for entry in self:
            if first <= entry.index <= last and entry.source is None:
                entry.value = entry.default

"""The object dictionary: entries with type, access, limits, unit and value."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Final

from smarttac_can.od.cia import RECORD_TYPES, Abort, AbortCode, DataType, ObjectType
from smarttac_can.od.data_types import REAL, SIGNED, SIZES, TEXT, UNSIGNED, bounds, pack, unpack
from smarttac_can.od.units import ONE, Quantity

ACCESS: Final = ("ro", "wo", "rw", "rwr", "rww", "const")
MAX_BYTES: Final = 1 << 20
"""Longest string or domain an entry takes."""

_INTEGER: Final = frozenset({*SIGNED, *UNSIGNED, DataType.BOOLEAN})


class Entry:
    """One sub-index of the object dictionary.

    Parameters
    ----------
    low, high
        Limits of the EDS, or else the bounds of the data type; 0 where values have no order.
    default
        Value after a reset.
    pdo
        Whether the EDS says PDOMapping=1.

    Attributes
    ----------
    value
        Raw value as on the wire: int, float, bytes or str by data type. Who writes it directly
        keeps it within the limits; `quantise` does. An entry with a source has none.
    source
        Computes the raw value when it is read; None where `value` holds it.
    size
        Bytes on the wire, 0 for a type of variable length.
    per_node
        Which of `default`, `low` and `high` hold the node-ID plus something (``$NODEID``).
    unit, si
        What one count stands for, with the displayed unit, and in SI base units.
    """

    __slots__ = (
        "access",
        "data_type",
        "default",
        "high",
        "index",
        "low",
        "name",
        "pdo",
        "per_node",
        "readable",
        "si",
        "size",
        "source",
        "subindex",
        "unit",
        "value",
        "writable",
    )
    __deletable__ = ("value",)  # asked for by mypyc

    def __init__(
        self,
        index: int,
        subindex: int,
        name: str,
        data_type: DataType,
        access: str,
        *,
        low: float | None = None,
        high: float | None = None,
        default: Any = 0,
        pdo: bool = False,
        unit: Quantity = ONE,
    ) -> None:
        least, most = bounds(data_type)
        self.index = index
        self.subindex = subindex
        self.name = name
        self.data_type = data_type
        self.access = access
        self.low = least if low is None else low
        self.high = most if high is None else high
        self.default: Any = default
        self.value: Any = default
        self.source: Callable[[], Any] | None = None
        self.pdo = pdo
        self.per_node: tuple[str, ...] = ()
        self.size = SIZES.get(data_type, 0)
        self.unit, self.si = unit, unit.si
        self.readable = access != "wo"
        self.writable = access not in ("ro", "const")

    def __repr__(self) -> str:
        return f"<Entry {self.index:04X}:{self.subindex:02X} {self.name} = {self.read()!r}>"

    @property
    def tpdo_mappable(self) -> bool:
        """Whether a TPDO may carry the entry (rww is for RPDOs alone, CiA 306)."""
        return self.pdo and self.access in ("ro", "rw", "rwr")

    @property
    def rpdo_mappable(self) -> bool:
        """Whether an RPDO may carry the entry."""
        return self.pdo and self.access in ("wo", "rw", "rww")

    @property
    def si_value(self) -> float:
        """Value in SI base units."""
        return float(self.read() * self.si)

    def read(self) -> Any:
        """Return the raw value as it is now, held or computed."""
        return self.value if self.source is None else self.source()

    @property
    def reader(self) -> Callable[[], Any]:
        """What does the same as `read`, without asking each time whether there is a source."""
        return self.read if self.source is None else self.source

    def compute(self, source: Callable[[], Any]) -> None:
        """Have the raw value computed whenever it is read.

        `value` is gone then: who forgets to `read` finds nothing, rather than what is out of date.
        """
        self.source = source
        del self.value

    def counts(self, text: str) -> int:
        """Nearest raw value to a quantity such as ``80 V``, ties to even, whatever the limits.

        Raises
        ------
        ValueError
            The text is not a number with a unit of this kind.
        """
        try:
            return round(Quantity.parse(text).over(self.unit))
        except (ValueError, OverflowError):
            like = self.unit.symbol and f" with a unit like {self.unit.symbol}"
            raise ValueError(f"{self.name} {text!r} is not a number{like}") from None

    def quantise(self, si: float) -> int:
        """Return the raw value nearest to a quantity in SI base units, within the limits.

        Ties go to the even value; what is outside of the limits is clipped to them.

        Raises
        ------
        ValueError
            The quantity is not a number.
        TypeError
            The entry is no integer.
        """
        if self.data_type not in _INTEGER:
            raise TypeError(f"{self.name} is {self.data_type.name}, not an integer")
        raw = si / self.si
        if raw <= self.low:
            return int(self.low)
        if raw >= self.high:
            return int(self.high)
        return round(raw)

    def count(self, more: int = 1) -> None:
        """Add to a counter, which begins anew above the largest value of its type."""
        self.value = (self.value + more) % (1 << 8 * self.size)

    def check(self, value: Any) -> None:
        """Refuse a value of the wrong type or outside the limits.

        Raises
        ------
        Abort
            LENGTH for a wrong type, TOO_LOW, TOO_HIGH, VALUE (not a number), TOO_LONG.
        """
        if self.data_type in _INTEGER or self.data_type in REAL:
            if not isinstance(value, int if self.data_type in _INTEGER else int | float):
                raise Abort(AbortCode.LENGTH)
            if value < self.low:
                raise Abort(AbortCode.TOO_LOW)
            if value > self.high:
                raise Abort(AbortCode.TOO_HIGH)
            if value != value:  # noqa: PLR0124 - NaN would slip through both limits
                raise Abort(AbortCode.VALUE)
        elif not isinstance(value, str if self.data_type in TEXT else bytes):
            raise Abort(AbortCode.LENGTH)
        elif len(value) > MAX_BYTES:
            raise Abort(AbortCode.TOO_LONG)

    def pack(self) -> bytes:
        """Return the present value as bytes on the wire."""
        return pack(self.data_type, self.read())

    def unpack(self, data: bytes) -> Any:
        """Return the value of bytes from the wire; the entry does not change.

        Raises
        ------
        Abort
            As for `check`, or if the bytes are no value of the type.
        """
        value = unpack(self.data_type, data)
        self.check(value)
        return value


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
            found = (data for first, last, data in RECORD_TYPES if first <= self.index <= last)
            data_type = next(found, 0)
        else:
            subindex = 1 if self.object_type is ObjectType.ARRAY and 1 in self.entries else 0
            data_type = self.entries[subindex].data_type
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
        Data types that may stand in an RPDO as a dummy.
    info
        Keys of ``[DeviceInfo]`` in lower case.
    warnings
        What was odd about the EDS, one line each.
    text
        The EDS.
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
            # None marks a name that stands for several entries.
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
        """Find an entry by its name; None if there is none or more than one."""
        return self._names.get(name)

    def entry(self, index: int, subindex: int = 0) -> Entry:
        """Find an entry by index and sub-index.

        Raises
        ------
        Abort
            NO_OBJECT or NO_SUBINDEX if the EDS has none.
        """
        item = self.objects.get(index)
        if item is None:
            raise Abort(AbortCode.NO_OBJECT)
        entry = item.entries.get(subindex)
        if entry is None:
            raise Abort(AbortCode.NO_SUBINDEX)
        return entry

    def get(self, index: int, subindex: int = 0) -> Entry | None:
        """Find an entry by index and sub-index; None if the EDS has none."""
        item = self.objects.get(index)
        return None if item is None else item.entries.get(subindex)

    def number(self, index: int, subindex: int = 0, absent: int = 0) -> int:
        """Return the value of an integer entry, or ``absent`` where the EDS has none."""
        entry = self.get(index, subindex)
        return absent if entry is None else int(entry.read())

    def write(self, entry: Entry, value: Any) -> None:
        """Set the value of an entry, if it passes `Entry.check`."""
        entry.check(value)
        entry.value = value

    def renumber(self, node_id: int) -> None:
        """Change the node-ID, 1..127, in the defaults and limits that hold ``$NODEID``."""
        for entry in self:
            least, most = bounds(entry.data_type)
            for attribute in entry.per_node:
                value = getattr(entry, attribute) - self.node_id + node_id
                setattr(entry, attribute, min(max(value, least), most))
        self.node_id = node_id

    def reset(self, first: int = 0, last: int = 0xFFFF) -> None:
        """Set the entries of the objects first..last to their defaults; computed ones go on."""
        for entry in self:
            if first <= entry.index <= last and entry.source is None:
                entry.value = entry.default

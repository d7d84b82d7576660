"""PDO mapping: the content of a PDO, and the procedure to change it (CiA 301, 7.5.2.36 and .38)."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Any, Final, NamedTuple

from smarttac_can.canopen.device.service import settable
from smarttac_can.canopen.od import cia
from smarttac_can.canopen.od.cia import Abort, AbortCode, DataType
from smarttac_can.canopen.od.data_types import (
    REAL,
    SIZES,
    STRUCT_CODES,
    TIME,
    bounds,
    pack,
    unpack,
)
from smarttac_can.canopen.od.dictionary import ObjectDictionary
from smarttac_can.canopen.od.entry import Entry

PDO_BITS: Final = 64


class Direction(Enum):
    """Direction of a PDO, seen from the device."""

    RECEIVE = "RPDO"
    TRANSMIT = "TPDO"


class Bounded(NamedTuple):
    """A mapped entry with limits narrower than its type."""

    position: int
    entry: Entry
    low: Any
    high: Any


@dataclass(frozen=True, slots=True)
class Mapping:
    """Compiled content of a PDO.

    Attributes
    ----------
    size
        Size of the PDO in bytes.
    entries
        Mapped entries, without dummies.
    bounded
        Mapped entries whose limits are narrower than their type.
    odd
        Positions of the integers of 24, 40, 48 or 56 bits, for which `struct` has no code.
    readers
        Functions that read the entries; empty if no entry is computed.
    pack, unpack
        Functions of the `struct` format; odd fields are bytes in it.
    """

    size: int
    entries: tuple[Entry, ...]
    bounded: tuple[Bounded, ...]
    odd: tuple[int, ...]
    readers: tuple[Callable[[], Any], ...]
    pack: Callable[..., bytes]
    unpack: Callable[[bytes], tuple[Any, ...]]

    def sample(self) -> bytes:
        """Return the bytes of a PDO with the present values."""
        if self.readers:
            values = [read() for read in self.readers]
        else:
            values = [entry.value for entry in self.entries]
        for position in self.odd:
            values[position] = pack(self.entries[position].data_type, values[position])
        return self.pack(*values)

    def read(self, data: bytes) -> tuple[Any, ...]:
        """Return the values in the bytes of a PDO, without changing entries."""
        values = self.unpack(data)
        if self.odd:
            whole = list(values)
            for position in self.odd:
                whole[position] = unpack(self.entries[position].data_type, whole[position])
            values = tuple(whole)
        return values

    def broken(self, data: bytes) -> Entry | None:
        """Return the entry whose limits a value in a PDO exceeds, None if all are within them."""
        values = self.read(data)
        for position, entry, low, high in self.bounded:
            if not low <= values[position] <= high:
                return entry
        return None

    def write(self, data: bytes) -> None:
        """Set the entries to the values in a PDO, which must be within the limits."""
        for entry, value in zip(self.entries, self.read(data), strict=True):
            entry.value = value


def mapped_entry(od: ObjectDictionary, value: int, direction: Direction) -> Entry | None:
    """Return the entry that a mapping parameter names; None for a dummy.

    Raises
    ------
    Abort
        NO_OBJECT, NO_SUBINDEX, or NOT_MAPPABLE for the wrong direction, for a length other than
        that of the entry, and for entries that are not whole bytes (granularity 8).
    """
    index, subindex, bits = value >> 16, value >> 8 & 0xFF, value & 0xFF
    if index in od.dummies and not subindex:
        if direction is Direction.TRANSMIT or bits != 8 * SIZES[index]:
            raise Abort(AbortCode.NOT_MAPPABLE)
        return None
    entry = od.entry(index, subindex)
    mappable = entry.tpdo_mappable if direction is Direction.TRANSMIT else entry.rpdo_mappable
    if not mappable or bits != 8 * entry.size or entry.data_type == DataType.BOOLEAN:
        raise Abort(AbortCode.NOT_MAPPABLE)
    return entry


def fixed_count(od: ObjectDictionary, index: int) -> bool:
    """Return whether the number of objects of a mapping record cannot be set to 0."""
    return not settable(od.get(index), 0)


def compile_mapping(
    od: ObjectDictionary,
    index: int,
    direction: Direction,
    count: int | None = None,
    written: tuple[int, int] = (0, 0),
) -> Mapping:
    """Read the mapping record at an index.

    Parameters
    ----------
    count
        Number of mapped objects; None for the number in sub-index 0. If that is fixed, objects
        that are 0 are left out.
    written
        Sub-index with another value than it has; (0, 0) for none.

    Raises
    ------
    Abort
        As for `mapped_entry`; PDO_LENGTH for more than 64 bits or more objects than sub-indices.
    """
    count = od.number(index) if count is None else count
    parameters = [od.get(index, subindex) for subindex in range(1, min(count, cia.MOST_MAPPED) + 1)]
    if count > cia.MOST_MAPPED or any(parameter is None for parameter in parameters):
        raise Abort(AbortCode.PDO_LENGTH)
    values = [
        written[1] if parameter.subindex == written[0] else parameter.value
        for parameter in parameters
        if parameter is not None
    ]
    if fixed_count(od, index):
        values = [value for value in values if value]
    if sum(value & 0xFF for value in values) > PDO_BITS:
        raise Abort(AbortCode.PDO_LENGTH)
    code = "<"
    entries: list[Entry] = []
    bounded: list[Bounded] = []
    odd: list[int] = []
    for value in values:
        entry = mapped_entry(od, value, direction)
        if entry is None:
            code += f"{(value & 0xFF) // 8}x"
            continue
        position = len(entries)
        entries.append(entry)
        # NaN is outside the limits of a real type, however wide they are.
        if entry.data_type in REAL or (
            entry.data_type not in TIME and (entry.low, entry.high) != bounds(entry.data_type)
        ):
            bounded.append(Bounded(position, entry, entry.low, entry.high))
        letter = STRUCT_CODES.get(entry.data_type, "")
        if not letter:
            letter = f"{entry.size}s"
            if entry.data_type not in TIME:
                odd.append(position)
        code += letter
    layout = struct.Struct(code)
    computed = any(entry.source is not None for entry in entries)
    return Mapping(
        layout.size,
        tuple(entries),
        tuple(bounded),
        tuple(odd),
        tuple([entry.reader for entry in entries]) if computed else (),
        layout.pack,
        layout.unpack,
    )


def check_mapping(
    od: ObjectDictionary, entry: Entry, value: int, direction: Direction, *, in_use: bool
) -> None:
    """Enforce the procedure for writing a mapping record.

    Disable the PDO, set the number of objects to 0, write the objects, set their number, enable the
    PDO. For masters that write back what they have read, an unchanged number of objects is
    accepted, and so is an unchanged object while the number is 0.

    If the EDS fixes the number, an object is written without these two steps.

    Parameters
    ----------
    in_use
        Whether the PDO is valid, and can be made invalid.

    Raises
    ------
    Abort
        ACCESS for an object while the number is not 0, even if unchanged; STATE while the PDO is
        in use; else as for `compile_mapping`.
    """
    fixed = fixed_count(od, entry.index)
    if entry.subindex and od.number(entry.index) and not fixed:
        raise Abort(AbortCode.ACCESS)
    if value == entry.value:
        return
    if in_use:
        raise Abort(AbortCode.STATE)
    if entry.subindex and fixed:
        compile_mapping(od, entry.index, direction, written=(entry.subindex, value))
    elif entry.subindex == 0:
        compile_mapping(od, entry.index, direction, value)
    elif value:
        mapped_entry(od, value, direction)

"""An entry of the object dictionary: type, access, limits, unit and value."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final, NamedTuple

from smarttac_can.canopen.od.cia import Abort, AbortCode, DataType
from smarttac_can.canopen.od.data_types import (
    REAL,
    SIGNED,
    SIZES,
    TEXT,
    UNSIGNED,
    bounds,
    pack,
    unpack,
)
from smarttac_can.canopen.od.units import ONE, Quantity

ACCESS: Final = ("ro", "wo", "rw", "rwr", "rww", "const")
MAX_BYTES: Final = 1 << 20
"""Longest string or domain of an entry, in bytes."""

_INTEGER: Final = frozenset({*SIGNED, *UNSIGNED, DataType.BOOLEAN})


class Entry:
    """One sub-index of the object dictionary.

    Parameters
    ----------
    low, high
        Limits of the EDS, or else the bounds of the data type; 0 for types without an order.
    default
        Value after a reset.
    pdo
        Whether the EDS has PDOMapping=1.

    Attributes
    ----------
    value
        Raw value as on the wire: int, float, bytes or str by data type. Code that writes it
        directly must keep it within the limits, for example by `quantise`. An entry with a source
        has none.
    source
        Function that computes the raw value when it is read; None if `value` holds it.
    size
        Size on the wire in bytes, 0 for a type of variable length.
    per_node
        Those of `default`, `low` and `high` that contain the node-ID (``$NODEID``).
    unit, si
        Quantity of one count, with the displayed unit, and in SI base units.
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
    __deletable__ = ("value",)  # required by mypyc

    def __init__(
        self,
        index: int,
        subindex: int,
        name: str,
        data_type: DataType,
        access: str,
        *,
        low: int | float | None = None,
        high: int | float | None = None,
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
        # Not float: a compiler would make floats of integers.
        self.low: int | float = least if low is None else low
        self.high: int | float = most if high is None else high
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
        """Whether a TPDO may map the entry (rww is for RPDOs only, CiA 306)."""
        return self.pdo and self.access in ("ro", "rw", "rwr")

    @property
    def rpdo_mappable(self) -> bool:
        """Whether an RPDO may map the entry."""
        return self.pdo and self.access in ("wo", "rw", "rww")

    @property
    def si_value(self) -> float:
        """Value in SI base units."""
        return float(self.read() * self.si)

    def read(self) -> Any:
        """Return the present raw value, stored or computed."""
        return self.value if self.source is None else self.source()

    @property
    def reader(self) -> Callable[[], Any]:
        """Function equivalent to `read`, without the check for a source at each call."""
        return self.read if self.source is None else self.source

    def compute(self, source: Callable[[], Any]) -> None:
        """Compute the raw value whenever it is read.

        `value` is deleted, so that code which does not use `read` fails instead of using an old
        value.
        """
        if self.source is None:
            del self.value
        self.source = source

    def counts(self, text: str) -> int:
        """Return the raw value nearest to a quantity such as ``80 V``, ties to even, unclipped.

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

    def require_kept(self, raw: int, given: Quantity, name: str) -> None:
        """Refuse a quantity that is not 0 but would be rounded to 0.

        Parameters
        ----------
        raw
            Rounded raw value.
        given
            Quantity, such as 80 V.
        name
            What the giver calls the object.

        Raises
        ------
        ValueError
            If the quantity is not 0, and `raw` is. The message names it and the step of the
            object, or the lowest value, in the unit of the quantity, if it is below that.
        """
        if raw == 0 and given.number:
            symbol = given.symbol
            text = f"{name} {f'{float(given.number):.12g} {symbol}'.rstrip()}"
            if given.over(self.unit) < self.low:
                lowest = f"{self.unit.times(self.low, symbol):.12g} {symbol}".rstrip()
                raise ValueError(f"{text} is below {lowest}, its lowest value")
            step = f"{self.unit.number:f} {self.unit.symbol}".rstrip()
            raise ValueError(f"{text} would become 0: it goes in steps of {step}")

    def shown(self, raw: float) -> str:
        """Return a raw value in the displayed unit, such as ``3000 nm``."""
        return f"{raw * float(self.unit.number):.12g} {self.unit.symbol}".rstrip()

    def quantise(self, si: float) -> int:
        """Return the raw value nearest to a quantity in SI base units, within the limits.

        Ties go to the even value; a quantity outside the limits is clipped to them.

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
        """Add to a counter, which wraps around at the largest value of its type."""
        self.value = (self.value + more) % (1 << 8 * self.size)

    def check(self, value: Any) -> None:
        """Refuse a value of the wrong type or outside the limits.

        Raises
        ------
        Abort
            LENGTH for a wrong type, TOO_LOW, TOO_HIGH, VALUE (not a number), TOO_LONG.
        """
        if self.data_type in _INTEGER or self.data_type in REAL:
            # Any, or a compiler takes the value for an int.
            number: Any = int if self.data_type in _INTEGER else int | float
            if not isinstance(value, number):
                raise Abort(AbortCode.LENGTH)
            if value < self.low:
                raise Abort(AbortCode.TOO_LOW, f"{self.name} {value} is below {self.low}")
            if value > self.high:
                raise Abort(AbortCode.TOO_HIGH, f"{self.name} {value} is above {self.high}")
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
        """Return the value in bytes from the wire, without changing the entry.

        Raises
        ------
        Abort
            As for `check`; also if the bytes are no value of the type.
        """
        value = unpack(self.data_type, data)
        self.check(value)
        return value


class BitField(NamedTuple):
    """Bits of an object that have a meaning of their own."""

    name: str
    """Name in addition to that of the object; empty for the whole object."""
    start: int
    """Lowest bit, counted from 0."""
    length: int
    """Number of bits."""
    values: Mapping[int, str]
    """Names of the values; empty for a number or a flag."""

"""What a link to a stimulator carries: PDOs, raw values by name, readings and recordings."""

from __future__ import annotations

import struct
import threading
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from math import isnan, nan
from pathlib import Path
from typing import Final, NamedTuple, NoReturn, Protocol, Self

import numpy as np
import numpy.typing as npt

from smarttac_can.bench.errors import BusyError, NotRunningError
from smarttac_can.bench.traces import COLUMNS
from smarttac_can.master.errors import BenchError
from smarttac_can.od.cia import (
    CAN_ID_MASK,
    COB_INVALID,
    FRAME_BYTES,
    PDO_COB_ID,
    RPDO_COMMUNICATION,
    RPDO_MAPPING,
    TPDO_COMMUNICATION,
    TPDO_MAPPING,
    DataType,
)
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.od.entry import Entry
from smarttac_can.vocabulary.states import Mode, State, Status, state_in

RECORDED = tuple(column.object for column in COLUMNS)
"""Objects of the stimulator that a run records, a column each, in the order of a trace."""

HELD = ("Statusword",)
"""Those of them that are published when they change, at once, and stay as they are until then."""

PUBLISHED = (
    "Statusword",
    "Mode display",
    "Contact.Tangential force",
    "Contact.Normal force",
    "Contact.COF",
    "Contact.Position",
    "Vibration.Amplitude",
    "Vibration.Voltage",
    "Vibration.Frequency",
    "Plate temperature",
)
"""Objects of the stimulator that a reading needs."""

Row = tuple[int, ...]
"""Raw values of `RECORDED` in one cycle."""
Hear = Callable[[int, bytes], None]
"""Called with the identifier and the data of a frame."""
PUBLIC: Final = range(1, 5)
"""Numbers of the PDOs between a stimulator and its masters; the others are those of the loop."""
_FORMATS: Final = {
    DataType.BOOLEAN: "B",
    DataType.INTEGER8: "b",
    DataType.INTEGER16: "h",
    DataType.INTEGER32: "i",
    DataType.UNSIGNED8: "B",
    DataType.UNSIGNED16: "H",
    DataType.UNSIGNED32: "I",
}
_STATUS: Final = sum(Status)


def unwrapped(rows: list[Row]) -> npt.NDArray[np.int64]:
    """Return one or more rows, with 16-bit ticks that were extended so that they keep rising."""
    counts = np.array(rows, dtype=np.int64)
    ticks = counts[:, 0]
    ticks[1:] = ticks[0] + np.cumsum(np.diff(ticks) & 0xFFFF)
    return counts


class Snapshot(NamedTuple):
    """Raw values of the stimulator's objects by name, and how old they are."""

    values: dict[str, int]
    age: float
    """Age in s of the oldest of them."""


class OneRun:
    """Allows one thread at a time to run the loop of a link, which has one recording."""

    def __init__(self) -> None:
        self._lock = threading.Lock()

    def __enter__(self) -> None:
        """Begin.

        Raises
        ------
        BusyError
            While another thread runs it.
        """
        if not self._lock.acquire(blocking=False):
            raise BusyError(
                "the loop of this stimulator runs already, in another thread that is in run(), "
                "tare() or identify(): wait for its end, or use record(), which may go beside it"
            )

    def __exit__(self, *_: object) -> None:
        """End."""
        self._lock.release()


def never() -> bool:
    """Return that nobody interrupts."""
    return False


class FrameSource(NamedTuple):
    """What the frames that `Link.frames` passes on mean."""

    published: list[PublishedPdo]
    """Public TPDOs of the stimulator."""
    every_cycle: list[int]
    """Numbers of those that come in every cycle; the others come when what they carry changes."""
    commanded: list[PublishedPdo]
    """RPDOs by which a master commands it."""
    plate: ObjectDictionary | None
    """EDS of the plate node; None if the plate is inside the stimulator."""
    clocked: bool
    """Whether ticks follow the clock, and not this bench."""


class Link(Protocol):
    """A stimulator, with its plate, as the bench reaches it.

    Every method raises a `BenchError` if the other side is gone or refuses.
    """

    @property
    def where(self) -> str:
        """Name of what it goes over, for messages."""

    @property
    def only_read(self) -> bool:
        """Whether the stimulator may be driven by somebody else, and is not by this bench."""

    def drive(self) -> None:
        """Become the one bench that drives the stimulator.

        Raises
        ------
        BenchError
            While another bench drives it.
        """

    def read(self, name: str) -> int:
        """Read the raw value of an object of the stimulator, or of the simulation."""

    def text(self, name: str) -> str:
        """Read an object of the stimulator that is a string."""

    def write(self, name: str, raw: int) -> None:
        """Write a raw value to an object of the stimulator, or of the simulation."""

    def read_table(self, name: str) -> bytes:
        """Read an object of the stimulator that is a DOMAIN."""

    def write_table(self, name: str, data: bytes) -> None:
        """Write an object of the stimulator that is a DOMAIN; it may take a while."""

    def snapshot(self) -> Snapshot:
        """Return the newest values the stimulator has published."""

    def start_run(self) -> None:
        """Put a simulated plate to rest at tick 0 and reset the controllers."""

    def run(self, cycles: int, rows: list[Row], interrupted: Callable[[], bool] = never) -> None:
        """Let the loop run and record it, a row a cycle; rows of lost cycles are missing.

        Parameters
        ----------
        cycles
            How many.
        rows
            Each row is appended as it comes, so that they are there if the run fails.
        interrupted
            Asked after each cycle whether to end at once.
        """

    def source(self) -> FrameSource:
        """Return what the frames that `frames` passes on mean."""

    def frames(self, hear: Hear, *, every_cycle: bool = True) -> AbstractContextManager[None]:
        """Pass on the frames of the nodes, and those of masters, while a block lasts.

        Parameters
        ----------
        hear
            Called as they come, by whichever thread has them.
        every_cycle
            Whether the TPDOs are set to every cycle.
        """

    def raw(self, path: Path) -> AbstractContextManager[str]:
        """Log all frames of the bus, in a format of python-can, while a block lasts.

        It yields one line: what in the log differs from the bus; empty if nothing does.
        """

    def silent(self) -> list[int]:
        """Return the node-IDs whose heartbeats came and have stopped."""

    def wrong_time(self) -> str:
        """Return what is wrong if the stimulator keeps another time than the link; else nothing."""

    def close(self) -> None:
        """Leave the bus; may be called twice."""


class ClosedLink:
    """What is left of a link that was closed: whatever is asked of it is refused.

    Parameters
    ----------
    where
        Name of what it went over.
    """

    def __init__(self, where: str) -> None:
        self.where = where

    def __getattr__(self, _name: str) -> NoReturn:
        raise BenchError(f"the stimulator over {self.where} is closed: connect anew")


class PublishedPdo:
    """A valid PDO of a node: its CAN-ID, what it maps, and the data that came last.

    Parameters
    ----------
    number
        Number of the PDO from 1.
    can_id
        CAN-ID it is sent with.
    entries
        The mapped entries in order, integers of 8, 16 or 32 bits.

    Attributes
    ----------
    layout
        Of its data.
    received
        Time in s at which data came last; None before.
    """

    def __init__(self, number: int, can_id: int, entries: list[Entry]) -> None:
        self.number = number
        self.can_id = can_id
        self.names = [entry.name for entry in entries]
        self.layout = struct.Struct("<" + "".join(_FORMATS[entry.data_type] for entry in entries))
        self._size, self._unpack = self.layout.size, self.layout.unpack
        self.values: tuple[int, ...] = ()
        self.received: float | None = None

    def take(self, data: bytes | bytearray, now: float) -> bool:
        """Take received data; of a length that is not the mapping's, return False."""
        if len(data) != self._size:
            return False
        self.values = self._unpack(data)
        self.received = now
        return True


def published_pdos(od: ObjectDictionary, read: Callable[[Entry], int]) -> list[PublishedPdo]:
    """Ask a node what its public TPDOs carry.

    Parameters
    ----------
    od
        The EDS of the node.
    read
        Reads an entry from the node over SDO.

    Returns
    -------
    list of PublishedPdo
        The valid ones that map only integers the EDS knows, by number.
    """
    return _pdos(od, read, TPDO_COMMUNICATION, TPDO_MAPPING)


def commanded_pdos(od: ObjectDictionary, read: Callable[[Entry], int]) -> list[PublishedPdo]:
    """Ask a node what the RPDOs of its master carry, as `published_pdos` does of its TPDOs."""
    return _pdos(od, read, RPDO_COMMUNICATION, RPDO_MAPPING)


def _pdos(
    od: ObjectDictionary, read: Callable[[Entry], int], communication: int, mapping: int
) -> list[PublishedPdo]:
    pdos = []
    for number in PUBLIC:
        cob_id = read(od.entry(communication + number - 1, PDO_COB_ID))
        if cob_id & COB_INVALID:
            continue
        record = mapping + number - 1
        count = read(od.entry(record, 0))
        if count > FRAME_BYTES:
            # More than a frame has bytes, or a multiplexed PDO.
            continue
        mapped = [read(od.entry(record, position)) for position in range(1, count + 1)]
        entries = [od.get(value >> 16, value >> 8 & 0xFF) for value in mapped]
        known = [entry for entry in entries if entry is not None and entry.data_type in _FORMATS]
        # A device may answer anything: a PDO that fits no frame is none.
        if known and len(known) == count and sum(entry.size for entry in known) <= FRAME_BYTES:
            pdos.append(PublishedPdo(number, cob_id & CAN_ID_MASK, known))
    return pdos


@dataclass(frozen=True, slots=True, repr=False)
class Reading:
    """What the stimulator published last."""

    age: float
    """Age in s of the oldest value in it."""
    mode: Mode
    """Mode in force."""
    state: State
    """State of the device."""
    status: Status
    """Other bits of the statusword."""
    tangential_force: float
    """Tangential force in N."""
    normal_force: float
    """Normal force in N."""
    cof: float
    """Coefficient of friction; NaN while no finger touches."""
    amplitude: float
    """Vibration amplitude in um peak-to-peak."""
    voltage: float
    """Voltage in V."""
    frequency: float
    """Excitation frequency in Hz."""
    temperature: float
    """Plate temperature in degC."""
    position: float
    """Position of the finger in mm from the middle of the plate; NaN while it does not touch."""

    def __repr__(self) -> str:
        contact = "no contact"
        if not isnan(self.cof):
            contact = f"COF {self.cof:.4f} at {self.position:.2f} mm"
        return (
            f"<Reading of {self.age:.3f} s ago: {self.state}, mode {self.mode}, "
            f"status {self.status.name or 0}; {contact}, "
            f"Ft {self.tangential_force:.3f} N, Fn {self.normal_force:.3f} N, "
            f"{self.amplitude:.4f} um, {self.voltage:.2f} V, {self.frequency:.2f} Hz, "
            f"{self.temperature:.2f} degC>"
        )

    @classmethod
    def from_snapshot(cls, snapshot: Snapshot, od: ObjectDictionary) -> Self:
        """Convert raw values by the EDS of the stimulator.

        Raises
        ------
        NotRunningError
            If a value has not been published yet.
        """
        raw, age = snapshot
        for name in PUBLISHED:
            if name not in raw:
                raise NotRunningError(
                    f"{name!r} has not been published yet: run() first, or have its TPDO's event "
                    "timer, 0.1 s by default, send it"
                )

        def value(name: str, unit: str) -> float:
            return float(od[name].unit.times(raw[name], unit))

        return cls(
            age=age,
            mode=Mode(raw["Mode display"]),
            state=state_in(raw["Statusword"]),
            status=Status(raw["Statusword"] & _STATUS),
            tangential_force=value("Contact.Tangential force", "N"),
            normal_force=value("Contact.Normal force", "N"),
            cof=value("Contact.COF", "") or nan,
            amplitude=value("Vibration.Amplitude", "um"),
            voltage=value("Vibration.Voltage", "V"),
            frequency=value("Vibration.Frequency", "Hz"),
            temperature=value("Plate temperature", "degC"),
            position=value("Contact.Position", "mm") if raw["Contact.COF"] else nan,
        )

"""The interface of a link to a stimulator: PDOs, raw values by name, readings, recordings."""

from __future__ import annotations

import struct
import threading
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from math import isnan, nan
from pathlib import Path
from typing import Any, Final, NamedTuple, NoReturn, Protocol, Self

import numpy as np
import numpy.typing as npt

from smarttac_can.bench.errors import BusyError, NotRunningError
from smarttac_can.bench.traces import COLUMNS
from smarttac_can.canopen.master.errors import BenchError
from smarttac_can.canopen.od import cia
from smarttac_can.canopen.od.data_types import REAL, STRUCT_CODES
from smarttac_can.canopen.od.dictionary import ObjectDictionary
from smarttac_can.canopen.od.entry import Entry
from smarttac_can.vocabulary.states import Mode, State, Status, state_in

RECORDED = tuple(column.object for column in COLUMNS)
"""Objects of the stimulator that a run records, one per column, in the order of a trace."""

ON_CHANGE = ("Statusword",)
"""Recorded objects that are published only on a change, and at once."""

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
"""Function that receives the identifier and the data of a frame."""
PUBLIC: Final = range(1, 5)
"""Numbers of the PDOs between a stimulator and its masters; the other ones serve the loop."""
_STATUS: Final = sum(Status)


def unwrapped(rows: list[Row]) -> npt.NDArray[np.int64]:
    """Return the rows as an array, with 16-bit ticks extended so that they keep increasing."""
    counts = np.array(rows, dtype=np.int64)
    ticks = counts[:, 0]
    ticks[1:] = ticks[0] + np.cumsum(np.diff(ticks) & 0xFFFF)
    return counts


class Snapshot(NamedTuple):
    """Raw values of the stimulator's objects by name, and their age."""

    values: dict[str, int]
    age: float
    """Age in s of the oldest value."""


class Turns:
    """Lets threads in one by one, in the order in which they ask; one that is in may enter again.

    A cycle of a simulation, an SDO transfer and a call of several writes are each done by a thread
    that is in, so that none is half done for another. A plain lock would not do: a loop that leaves
    it and takes it again at once would let nobody in.
    """

    def __init__(self) -> None:
        self._next, self._in = threading.Lock(), threading.Lock()
        self._owner: int | None = None
        self._depth = 0

    def __enter__(self) -> None:
        """Wait for the turn of this thread."""
        me = threading.get_ident()
        if self._owner != me:
            with self._next:  # who waits here is next, also before the one that has just left
                self._in.acquire()
            self._owner = me
        self._depth += 1

    def __exit__(self, *_: object) -> None:
        """Leave to the next one."""
        self._depth -= 1
        if not self._depth:
            self._owner = None
            self._in.release()


class OneRun:
    """Lets one thread at a time run the loop of a link, because a link has one recording.

    Parameters
    ----------
    where
        Name of the link, for messages.
    """

    def __init__(self, where: str) -> None:
        self._lock = threading.Lock()
        self._where = where
        self._owner: int | None = None
        self._closed = False

    def __enter__(self) -> None:
        """Begin a run.

        Raises
        ------
        BusyError
            If another thread is running the loop.
        """
        if not self._lock.acquire(blocking=False):
            raise BusyError(
                "the loop of this stimulator runs already, in another thread that is in run(), "
                "tare() or identify(): wait for its end, or use record(), which may run beside it"
            )
        self._owner = threading.get_ident()

    def __exit__(self, *_: object) -> None:
        """End the run."""
        self._owner = None
        self._lock.release()

    def require_open(self) -> None:
        """Raise BenchError if the link was closed meanwhile; to be called in each cycle."""
        if self._closed:
            raise BenchError(f"the stimulator over {self._where} was closed during this call")

    def close(self) -> None:
        """Have the run of another thread end, and wait until it has."""
        self._closed = True
        if self._owner != threading.get_ident():
            with self._lock:
                pass


def never() -> bool:
    """Return False: the run is not interrupted."""
    return False


class FrameSource(NamedTuple):
    """Description of the frames that `Link.frames` passes on."""

    published: list[PublishedPdo]
    """Public TPDOs of the stimulator."""
    every_cycle: list[int]
    """Numbers of the TPDOs that are sent in every cycle; the other ones are sent on a change."""
    commanded: list[PublishedPdo]
    """RPDOs with which a master commands the stimulator."""
    plate: ObjectDictionary | None
    """EDS of the plate node; None if the plate is inside the stimulator."""
    clocked: bool
    """Whether ticks follow the clock, not the SYNC of this bench."""


class Link(Protocol):
    """Access of the bench to a stimulator and its plate.

    Every method raises a `BenchError` if the other side is gone or refuses.

    Attributes
    ----------
    turn
        Held during a call of several steps that no other thread may come between.
    """

    turn: Turns

    @property
    def where(self) -> str:
        """Name of the link, for messages."""

    @property
    def only_read(self) -> bool:
        """Whether another bench may be the commander, and this one is not."""

    def drive(self) -> None:
        """Become the commander of the stimulator.

        Raises
        ------
        BenchError
            If another bench is the commander.
        """

    def read(self, name: str) -> Any:
        """Read an object of the stimulator or the simulation: raw value, text, or bytes."""

    def write(self, name: str, raw: int | bytes) -> None:
        """Write an object of the stimulator or the simulation; a DOMAIN may take a while."""

    def snapshot(self) -> Snapshot:
        """Return the newest values that the stimulator has published."""

    def start_run(self) -> None:
        """Restart the simulation: the plate at rest at tick 0, the controllers reset."""

    def run(self, cycles: int, rows: list[Row], interrupted: Callable[[], bool] = never) -> None:
        """Run the loop and record a row per cycle; rows of lost cycles are missing.

        Parameters
        ----------
        cycles
            Number of cycles.
        rows
            List to which each row is appended at once, so that the rows remain if the run fails.
        interrupted
            Function called after each cycle; True ends the run at once.
        """

    def source(self) -> FrameSource:
        """Return a description of the frames that `frames` passes on."""

    def frames(self, hear: Hear, *, every_cycle: bool = True) -> AbstractContextManager[None]:
        """Pass on the frames of the nodes, and those of masters, during a block.

        Parameters
        ----------
        hear
            Function called for each frame, from any thread.
        every_cycle
            Whether the TPDOs are set to every cycle.
        """

    def raw(self, path: Path) -> AbstractContextManager[str]:
        """Log all frames of the bus, in a format of python-can, during a block.

        Yields one line on how the log differs from the bus; empty if it does not.
        """

    def silent(self) -> list[int]:
        """Return the node-IDs whose heartbeats were received and then lost."""

    def require_idle(self) -> None:
        """Raise BusyError if another thread is running the loop."""

    def wrong_time(self) -> str:
        """Return an error text if stimulator and link differ in lockstep or real time, else ""."""

    def close(self) -> None:
        """Leave the bus; may be called twice."""


class ClosedLink:
    """A link that this process has no more, which refuses every access.

    Parameters
    ----------
    where
        Name of the link.
    why
        Why it is gone, and what to do.
    """

    def __init__(self, where: str, why: str) -> None:
        self.where = where
        self._why = why

    def __getattr__(self, _name: str) -> NoReturn:
        raise BenchError(f"the stimulator over {self.where} {self._why}")


class PublishedPdo:
    """A valid PDO of a node: its CAN-ID, its mapping, and the last data.

    Parameters
    ----------
    number
        Number of the PDO from 1.
    can_id
        CAN-ID of its frames.
    entries
        Mapped entries in order, integers of 8, 16, 32 or 64 bits.

    Attributes
    ----------
    layout
        Layout of the data.
    received
        Time in s of the last data; None before the first.
    """

    def __init__(self, number: int, can_id: int, entries: list[Entry]) -> None:
        self.number = number
        self.can_id = can_id
        self.names = [entry.name for entry in entries]
        codes = (STRUCT_CODES[entry.data_type] for entry in entries)
        self.layout = struct.Struct(f"<{''.join(codes)}")
        self._size, self._unpack = self.layout.size, self.layout.unpack
        self.values: tuple[int, ...] = ()
        self.received: float | None = None

    def take(self, data: bytes | bytearray, now: float) -> bool:
        """Store received data; return False if the length differs from the mapping."""
        if len(data) != self._size:
            return False
        self.values = self._unpack(data)
        self.received = now
        return True


def published_pdos(od: ObjectDictionary, read: Callable[[Entry], int]) -> list[PublishedPdo]:
    """Read from a node what its public TPDOs carry.

    Parameters
    ----------
    od
        Object dictionary of the node.
    read
        Function that reads an entry from the node over SDO.

    Returns
    -------
    list of PublishedPdo
        Valid TPDOs that map only integers known to the EDS, by number.
    """
    return _pdos(od, read, cia.TPDO_COMMUNICATION, cia.TPDO_MAPPING)


def commanded_pdos(od: ObjectDictionary, read: Callable[[Entry], int]) -> list[PublishedPdo]:
    """Read from a node what the RPDOs of its master carry, as `published_pdos` for TPDOs."""
    return _pdos(od, read, cia.RPDO_COMMUNICATION, cia.RPDO_MAPPING)


def _pdos(
    od: ObjectDictionary, read: Callable[[Entry], int], communication: int, mapping: int
) -> list[PublishedPdo]:
    pdos = []
    for number in PUBLIC:
        cob_id = read(od.entry(communication + number - 1, cia.PDO_COB_ID))
        if cob_id & cia.COB_INVALID:
            continue
        record = mapping + number - 1
        count = read(od.entry(record, 0))
        if count > cia.FRAME_BYTES:
            # More than the bytes of a frame, or a multiplexed PDO.
            continue
        mapped = [read(od.entry(record, position)) for position in range(1, count + 1)]
        entries = [od.get(value >> 16, value >> 8 & 0xFF) for value in mapped]
        known = [e for e in entries if e is not None and e.data_type in STRUCT_CODES.keys() - REAL]
        # A device may answer anything: ignore a PDO that does not fit into a frame.
        if known and len(known) == count and sum(entry.size for entry in known) <= cia.FRAME_BYTES:
            pdos.append(PublishedPdo(number, cob_id & cia.CAN_ID_MASK, known))
    return pdos


@dataclass(frozen=True, slots=True, repr=False)
class Reading:
    """The values that the stimulator published last."""

    age: float
    """Age in s of the oldest value."""
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
    """Coefficient of friction; NaN while the finger does not touch."""
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
        """Convert raw values with the EDS of the stimulator.

        Raises
        ------
        NotRunningError
            If a value has not been published yet.
        """
        raw, age = snapshot
        for name in PUBLISHED:
            if name not in raw:
                raise NotRunningError(
                    f"{name!r} has not been published yet: run() first, or set the event timer of "
                    "its TPDO (0.1 s by default)"
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

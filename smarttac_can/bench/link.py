"""What a link between the bench and a stimulator carries: raw values by name, and recordings."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import NamedTuple, NoReturn, Protocol

import numpy as np
import numpy.typing as npt

from smarttac_can.bench.errors import BusyError
from smarttac_can.bench.published import PublishedPdo
from smarttac_can.bench.traces import COLUMNS
from smarttac_can.master.errors import BenchError
from smarttac_can.od.dictionary import ObjectDictionary

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
    """Lets one thread at a time run the loop of a link: it has one recording."""

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


Hear = Callable[[int, bytes], None]
"""Called with the identifier and the data of a frame."""


def never() -> bool:
    """Return that nobody interrupts."""
    return False


class FrameSource(NamedTuple):
    """What the frames of a link mean that `Link.frames` tells."""

    published: list[PublishedPdo]
    """Public TPDOs of the stimulator."""
    every_cycle: list[int]
    """Numbers of those that come in every cycle; the others come when what they carry changes."""
    commanded: list[PublishedPdo]
    """RPDOs by which a master commands it."""
    plate: ObjectDictionary | None
    """EDS of the plate node; None with the plate inside."""
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
        """Tell what the frames mean that `frames` tells."""

    def frames(self, hear: Hear) -> AbstractContextManager[None]:
        """Have the frames of all cycles told, and those of masters, while a block lasts.

        They are told as they come, by whichever thread has them.
        """

    def raw(self, path: Path) -> AbstractContextManager[str]:
        """Log all frames of the bus, in a format of python-can, while a block lasts.

        It gives the block what of the log is not as on the bus, in one line; empty if all is.
        """

    def wrong_time(self) -> str:
        """Say that the stimulator keeps another time than the link believes; empty if not."""

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

"""What a link between the bench and a stimulator carries: raw values by name, and recordings."""

from __future__ import annotations

from typing import NamedTuple, NoReturn, Protocol

from smarttac_can.master.errors import BenchError

RECORDED = (
    "Contact.Tick",
    "Contact.COF",
    "Contact.COF reference",
    "Vibration.Amplitude",
    "Vibration.Voltage",
    "Vibration.Frequency",
    "Contact.Tangential force",
    "Contact.Normal force",
)
"""Objects of the stimulator that a recording holds, a column each, in the order of a trace."""

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


class Snapshot(NamedTuple):
    """Raw values of the stimulator's objects by name, and how old they are."""

    values: dict[str, int]
    age: float
    """Age in s of the oldest of them."""


class Link(Protocol):
    """A stimulator, with its plate, as the bench reaches it.

    Every method raises a `BenchError` if the other side is gone or refuses.
    """

    @property
    def where(self) -> str:
        """Name of what it goes over, for messages."""
        ...

    @property
    def only_read(self) -> bool:
        """Whether the stimulator may be driven by somebody else, and is not by this bench."""
        ...

    def drive(self) -> None:
        """Become the one bench that drives the stimulator.

        Raises
        ------
        BenchError
            While another bench drives it.
        """
        ...

    def read(self, name: str) -> int:
        """Read the raw value of an object of the stimulator, or of the simulation."""
        ...

    def text(self, name: str) -> str:
        """Read an object of the stimulator that is a string."""
        ...

    def write(self, name: str, raw: int) -> None:
        """Write a raw value to an object of the stimulator, or of the simulation."""
        ...

    def snapshot(self) -> Snapshot:
        """Return the newest values the stimulator has published."""
        ...

    def start_run(self) -> None:
        """Put a simulated plate to rest at tick 0 and reset the controllers."""
        ...

    def run(self, cycles: int) -> list[Row]:
        """Let the loop run and record it, a row a cycle; rows of lost cycles are missing."""
        ...

    def wrong_time(self) -> str:
        """Say that the stimulator keeps another time than the link believes; empty if not."""
        ...

    def close(self) -> None:
        """Leave the bus; may be called twice."""
        ...


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

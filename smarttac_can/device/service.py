"""What the services of CiA 301 have in common: they own objects and live in some NMT states."""

from __future__ import annotations

from typing import Any, ClassVar

from smarttac_can.device.nmt import NMTState
from smarttac_can.device.port import Port
from smarttac_can.od.cia import CAN_ID_MASK, COB_EXTENDED, COB_INVALID, Abort, AbortCode, restricted
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.od.entry import Entry


class Service:
    """One communication service.

    Attributes
    ----------
    states
        NMT states it lives in; a service that is not alive neither listens nor sends.
    objects
        Indices whose values are its parameters.
    begins_anew
        Whether it acts on a write of the value that an object has already, as on any other.
    """

    states: ClassVar[frozenset[NMTState]] = frozenset()
    begins_anew: ClassVar[bool] = False

    def __init__(self, port: Port, od: ObjectDictionary, objects: tuple[int, ...]) -> None:
        self.port = port
        self.od = od
        self.objects = objects
        self.alive = False

    def check_read(self, entry: Entry) -> None:
        """Raise `Abort` if one of its objects has nothing to read."""

    def check(self, entry: Entry, value: Any) -> None:
        """Raise `Abort` if one of its objects must not take the value now."""

    def apply(self, entry: Entry) -> None:
        """Act on the value one of its objects has just taken."""
        alive = self.alive
        self.enter(None)
        self.configure()
        if alive:
            self.alive = True
            self.begin()

    def configure(self) -> None:
        """Read the parameters from the object dictionary; the service is not alive."""

    def enter(self, state: NMTState | None) -> None:
        """Begin or cease as the NMT state asks; None, no state, makes the service cease."""
        alive = state in self.states
        if alive != self.alive:
            self.alive = alive
            if alive:
                self.begin()
            else:
                self.cease()

    def begin(self) -> None:
        """Start what the service does while it is alive."""

    def cease(self) -> None:
        """Stop timers and drop what is pending."""

    def listen(self) -> None:
        """Register with the port for the CAN-IDs it listens to while it is alive."""

    @property
    def sends(self) -> tuple[int, ...]:
        """Identifiers that it sends with in one state or another, and no other device may."""
        return ()


def check_cob_id(old: int, new: int) -> None:
    """Refuse a COB-ID that an object with a valid bit (PDO, EMCY, SDO server) must not take.

    Raises
    ------
    Abort
        STATE if the CAN-ID would change while the object is valid, VALUE for 29-bit and
        restricted CAN-IDs.
    """
    if new & COB_INVALID:
        return
    if not old & COB_INVALID and (old ^ new) & (COB_EXTENDED | (COB_EXTENDED - 1)):
        raise Abort(AbortCode.STATE)
    if new & (COB_EXTENDED | ((COB_EXTENDED - 1) & ~CAN_ID_MASK)) or restricted(new & CAN_ID_MASK):
        raise Abort(AbortCode.VALUE)

"""Transmit PDOs with all transmission types (CiA 301, 7.2.2 and 7.5.2.37)."""

from __future__ import annotations

from typing import ClassVar

from smarttac_can.device.frame import Frame
from smarttac_can.device.mapping import Direction
from smarttac_can.device.pdo import PDO
from smarttac_can.device.port import Port
from smarttac_can.od.cia import (
    ACYCLIC,
    COB_NO_RTR,
    CYCLIC_LAST,
    EVENT_MANUFACTURER,
    EVENT_PROFILE,
    PDO_INHIBIT,
    PDO_SYNC_START,
    RTR_SYNC,
    TPDO_COMMUNICATION,
    TPDO_MAPPING,
)
from smarttac_can.od.dictionary import ObjectDictionary


class TPDO(PDO):
    """One transmit PDO.

    Type 254 goes out at every trigger, type 255 at a trigger that finds changed data; both also
    when the event timer elapses. Type 0 waits after a trigger for the next SYNC.
    """

    direction: ClassVar = Direction.TRANSMIT
    first_event_type: ClassVar = RTR_SYNC
    records: ClassVar = (TPDO_COMMUNICATION, TPDO_MAPPING)

    def __init__(self, port: Port, od: ObjectDictionary, number: int) -> None:
        super().__init__(port, od, number)
        self._event = port.clock.timer(self._on_event_timer)
        self._inhibit = port.clock.timer(self._on_inhibit_end)
        self._inhibit_time = 0
        self._start_value = 0
        self._sends = False
        self._pending = False
        self._awaits_start = False
        self._count = 0
        self._last: bytes | None = None
        self._sampled: bytes | None = None

    @property
    def synchronous(self) -> bool:
        """Whether it has something to do at a SYNC."""
        return self._sends and (self.transmission <= CYCLIC_LAST or self.transmission == RTR_SYNC)

    @property
    def sends(self) -> tuple[int, ...]:
        """Its own, while it is valid."""
        return (self.can_id,) if self.valid else ()

    def unasked(self) -> Frame | None:
        """Return what the event timer would send now; None if there is none."""
        timed = self._sends and self.event_time and self.transmission >= EVENT_MANUFACTURER
        return Frame(self.can_id, self._sample()) if timed else None

    def configure(self) -> None:
        """Read inhibit time, SYNC start value, and what every PDO has."""
        super().configure()
        communication, _ = self.objects
        self._inhibit_time = 100 * self.od.number(communication, PDO_INHIBIT)
        self._start_value = self.od.number(communication, PDO_SYNC_START)

    def begin(self) -> None:
        """Start counting SYNCs and time; nothing goes out by itself yet."""
        self._sends = self.valid and self.mapping is not None and self.mapping.size > 0
        self._awaits_start = self._start_value != 0
        self._count = 0
        if self._sends and self.event_time and self.transmission >= EVENT_MANUFACTURER:
            self._event.start(self.event_time, periodic=True)

    def cease(self) -> None:
        """Send nothing any more, and forget events that wait."""
        self._sends = self._pending = False
        self._last = self._sampled = None
        self._event.stop()
        self._inhibit.stop()

    def listen(self) -> None:
        """Listen to remote frames, where the COB-ID allows them."""
        if self._sends and not self.cob_id & COB_NO_RTR:
            self.port.listen(self.can_id, self._on_remote)

    def trigger(self) -> None:
        """Take an event of the application: at once, at the next SYNC, or never, by the type.

        Types 254 and 255 send at once, or after the inhibit time; type 255 only if the data are
        new. Type 0 sends at the next SYNC. Types 1..240, 252 and 253 have no events.
        """
        if not self._sends or self.mapping is None:
            return
        transmission = self.transmission
        if transmission < EVENT_MANUFACTURER:
            self._pending = transmission == ACYCLIC
            return
        data = self.mapping.sample()
        if transmission == EVENT_PROFILE and data == self._last:
            return
        if self._inhibit_time and self._inhibit.running:
            self._pending = True
            return
        self._send(data)
        if self.event_time:
            self._event.restart()

    def on_sync(self, counter: int) -> None:
        """Sample and send if it is this PDO's turn.

        Parameters
        ----------
        counter
            Of the SYNC, 0 where SYNC carries none; then the start value is not looked at.
        """
        transmission = self.transmission
        if transmission == ACYCLIC:
            if self._pending:
                self._pending = False
                self._send(self._sample())
            return
        if transmission == RTR_SYNC:
            self._sampled = self._sample()
            return
        if self._awaits_start and counter:
            if counter != self._start_value:
                return
            self._awaits_start = False
        self._count += 1
        if self._count >= transmission:
            self._count = 0
            self._send(self._sample())

    def _sample(self) -> bytes:
        return b"" if self.mapping is None else self.mapping.sample()

    def _send(self, data: bytes) -> None:
        self._last = data
        self.port.out.append(tuple.__new__(Frame, (self.can_id, data, False)))
        if self._inhibit_time:
            self._inhibit.start(self._inhibit_time)

    def _on_event_timer(self) -> None:
        if self._inhibit.running:
            self._pending = True
        else:
            self._send(self._sample())

    def _on_inhibit_end(self) -> None:
        if self._pending and self.transmission >= EVENT_MANUFACTURER:
            self._pending = False
            self._send(self._sample())

    def _on_remote(self, frame: Frame) -> None:
        if not frame.rtr:
            return
        if self.transmission == RTR_SYNC and self._sampled is not None:
            self._send(self._sampled)
        else:
            self._send(self._sample())

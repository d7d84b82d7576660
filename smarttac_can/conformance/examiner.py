"""The tester's side of the bus: frames, SDO, NMT, and what must or must not come."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable
from contextlib import suppress
from time import monotonic, sleep
from typing import Final, NamedTuple, Protocol

from smarttac_can.conformance.case import Failure
from smarttac_can.conformance.description import DeviceDescription
from smarttac_can.device.frame import Frame
from smarttac_can.host.bus import QueueFullError
from smarttac_can.master.requests import ABORT
from smarttac_can.od.cia import (
    BOOT_UP,
    FRAME_BYTES,
    HEARTBEAT_ID,
    NMT_ID,
    SDO_RX_ID,
    SDO_TX_ID,
    SYNC_COUNTER,
    Abort,
    AbortCode,
    NMTCommand,
)

_TRACE_LENGTH: Final = 24
_BOOT_TIME_OUTS: Final = 10
_FULL_S: Final = 1e-3
"""Time for a full queue to drain."""


class ProbeBus(Protocol):
    """What the examiner needs of a bus: any `Bus` has it, and a `DeviceTimeBus`."""

    def send(self, frame: Frame) -> None:
        """Send a frame."""

    def receive(self, timeout: float) -> Frame | None:
        """Return the next frame, None if none comes within a time in s; 0 takes what is there."""


class Arrival(NamedTuple):
    """A frame of the device and when it came, in s."""

    time: float
    frame: Frame


class Examiner:
    """Asks one device.

    Parameters
    ----------
    bus
        The bus; only the device under test should be on it.
    sheet
        The device's data sheet.
    timeout
        Longest time in s the device may take for an answer, above 0; all other times of the suite
        are multiples of it.
    clock
        Time in s, by which the bus waits.
    """

    def __init__(
        self,
        bus: ProbeBus,
        sheet: DeviceDescription,
        *,
        timeout: float = 0.3,
        clock: Callable[[], float] = monotonic,
    ) -> None:
        if timeout <= 0:
            raise ValueError(f"timeout {timeout} is not above 0")
        self.sheet = sheet
        self.node_id = sheet.node_id
        self.timeout = timeout
        self.trace: deque[str] = deque(maxlen=_TRACE_LENGTH)
        self._bus = bus
        self._clock = clock

    def send(self, can_id: int, data: bytes = b"", *, rtr: bool = False) -> None:
        """Send a frame; on a bus with a full queue, as soon as it takes it.

        Raises
        ------
        QueueFullError
            If it has taken none for the time-out.
        """
        frame = Frame(can_id, data, rtr)
        end = self._clock() + self.timeout
        while True:
            try:
                self._bus.send(frame)
            except QueueFullError:
                if self._clock() >= end:
                    raise
                sleep(_FULL_S)
            else:
                self.trace.append(f"> {_text(frame)}")
                return

    def arrivals(self, duration: float) -> Iterable[Arrival]:
        """Yield frames as they come, until the duration in s has passed.

        Those that wait by then are among them, however late a loaded system lets the examiner look.
        """
        end = self._clock() + duration
        last: float | None = None
        while True:
            now = self._clock()
            if last is None and now > end:
                # A bus on which frames never end has no longer than this from the first late look.
                last = now + self.timeout
            if last is not None and now > last:
                return
            frame = self._bus.receive(max(0.0, end - now))
            if frame is None:
                if self._clock() >= end:
                    return
                continue
            self.trace.append(f"< {_text(frame)}")
            yield Arrival(self._clock(), frame)

    def collect(self, can_id: int, duration: float | None = None) -> list[Arrival]:
        """Return all frames with a CAN-ID that come in a duration in s, by default the time-out."""
        wait = self.timeout if duration is None else duration
        return [arrival for arrival in self.arrivals(wait) if arrival.frame.can_id == can_id]

    def drain(self) -> None:
        """Drop the frames that have come already."""
        while (frame := self._bus.receive(0.0)) is not None:
            self.trace.append(f"< {_text(frame)}")

    def settle(self) -> None:
        """Drop the frames that come within a third of the time-out."""
        for _ in self.arrivals(self.timeout / 3):
            pass

    def wait(self, can_id: int, timeout: float | None = None) -> Arrival | None:
        """Return the next frame with a CAN-ID, others passed over; None after the time-out in s."""
        for arrival in self.arrivals(self.timeout if timeout is None else timeout):
            if arrival.frame.can_id == can_id and not arrival.frame.rtr:
                return arrival
        return None

    def expect(self, can_id: int, what: str, timeout: float | None = None) -> Frame:
        """Return the next frame with a CAN-ID.

        Raises
        ------
        Failure
            If none comes within the time-out in s.
        """
        arrival = self.wait(can_id, timeout)
        if arrival is None:
            limit = self.timeout if timeout is None else timeout
            raise Failure(f"no {what} ({can_id:03X}h) within {limit:g} s")
        return arrival.frame

    def silence(self, can_id: int, what: str, duration: float | None = None) -> None:
        """Raise `Failure` if a frame with this CAN-ID comes within a duration in s."""
        arrival = self.wait(can_id, duration)
        if arrival is not None:
            raise Failure(f"unexpected {what}: {_text(arrival.frame)}")

    def sync(self, counter: int | None = None) -> None:
        """Send SYNC; without a counter given, with one if the data sheet's defaults ask for it."""
        if counter is None and self.sheet.od.number(SYNC_COUNTER):
            counter = 1
        self.send(self.sync_id, b"" if counter is None else bytes((counter,)))

    def nmt(self, command: int, node_id: int | None = None) -> None:
        """Send an NMT command to the device or to another."""
        self.send(NMT_ID, bytes((command, self.node_id if node_id is None else node_id)))

    def enter(self, command: int) -> None:
        """Send the device an NMT command, and drop the frames that it causes."""
        self.nmt(command)
        self.settle()

    def reset(self, command: int = NMTCommand.RESET_NODE) -> None:
        """Reset the device and wait for its boot-up message."""
        self.drain()
        self.nmt(command)
        boot_up = self.expect(self.heartbeat_id, "boot-up", _BOOT_TIME_OUTS * self.timeout)
        if boot_up.data != BOOT_UP:
            raise Failure(f"after a reset came {_text(boot_up)} instead of a boot-up")
        self.settle()

    def require_device(self) -> None:
        """Raise `Failure` unless the device answers to a reset or to SDO."""
        with suppress(Failure):
            self.reset()
            return
        with suppress(Abort):
            self.request(b"\x40\0\x10\0")

    @property
    def sync_id(self) -> int:
        """Identifier of SYNC by the data sheet."""
        return self.sheet.od.sync_id

    @property
    def heartbeat_id(self) -> int:
        """Identifier of the device's error control frames."""
        return HEARTBEAT_ID + self.node_id

    def request(self, data: bytes) -> bytes:
        """Send an SDO request of up to 8 bytes, filled with zeros; return the response."""
        self.drain()
        self.sdo_send(data)
        return self.sdo_response()

    def sdo_send(self, data: bytes) -> None:
        """Send an SDO request of up to 8 bytes, filled with zeros; wait for no answer."""
        self.send(SDO_RX_ID + self.node_id, data.ljust(FRAME_BYTES, b"\0"))

    def sdo_response(self, timeout: float | None = None) -> bytes:
        """Wait for the next SDO response and return its 8 bytes.

        Raises
        ------
        Abort
            If it is an abort.
        Failure
            If none comes within the time-out in s.
        """
        data = self.expect(SDO_TX_ID + self.node_id, "SDO response", timeout).data
        if len(data) != FRAME_BYTES:
            raise Failure(f"SDO response of {len(data)} bytes")
        if data[0] == ABORT:
            raise Abort(int.from_bytes(data[4:], "little"))
        return data

    def refuse(self, ask: Callable[[], object], what: str, *codes: AbortCode) -> None:
        """Raise `Failure` unless the device answers with one of the abort codes, or any if none."""
        try:
            ask()
        except Abort as abort:
            if codes and abort.code not in codes:
                wanted = " or ".join(f"{code:08X}h" for code in codes)
                raise Failure(f"{what}: {abort}, not {wanted}") from None
            return
        raise Failure(f"{what}: accepted")


def _text(frame: Frame) -> str:
    return f"{frame.can_id:03X} {'rtr' if frame.rtr else frame.data.hex(' ').upper()}".rstrip()

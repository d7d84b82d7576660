"""The tester's side of the bus: frames, SDO, NMT, and checks of the device's answers."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from itertools import pairwise
from time import monotonic, sleep
from typing import Final, NamedTuple, Protocol

from smarttac_can.canopen.bus.bus import QueueFullError
from smarttac_can.canopen.conformance.case import DeviceDescription, Failure, NotApplicable
from smarttac_can.canopen.conformance.refusals import Refusal
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.master.requests import ABORT
from smarttac_can.canopen.od import cia
from smarttac_can.canopen.od.cia import Abort, AbortCode, NMTCommand

_TRACE_LENGTH: Final = 24
TIMEOUT_S: Final = 2.0
"""Longest time in s for an answer, unless the caller gives another; CiA 301 has none."""
# The other times of the suite follow from the time-out, but not below what any device needs. A
# device may need longer to start than to answer: CiA's own tool waits 5 s after a reset.
_BOOT: Final = 2.5
_WATCH, _WATCH_S = 0.15, 0.3
_PAUSE, _PAUSE_S = 0.05, 0.1
_SUBCOMMAND_BITS: Final = {1: 0, 2: 0, 5: 3, 6: 1}
"""Bits of an SDO request that are 0 in one that initiates a transfer, by its specifier."""
_FULL_S: Final = 1e-3
"""Time in s for a full queue to drain."""


class ProbeBus(Protocol):
    """Bus interface that the examiner needs; `Bus` and `DeviceTimeBus` have it."""

    def send(self, frame: Frame) -> None:
        """Send a frame."""

    def receive(self, timeout: float) -> Frame | None:
        """Return the next frame, None if none comes within a time in s; 0 does not wait."""


class Arrival(NamedTuple):
    """A received frame, and its time in s."""

    time: float
    frame: Frame


class Examiner:
    """Examine one device.

    Parameters
    ----------
    bus
        Bus, on which only the device under test should be.
    sheet
        EDS of the device.
    timeout
        Longest time in s for an answer of the device, above 0. A device that answers is judged
        without waiting for it.
    clock
        Function that returns the time in s that the bus uses.

    Attributes
    ----------
    watch
        Time in s for which a case watches that a frame does not come.
    pause
        Time in s that a device gets for what it does not confirm, such as an NMT command.
    remarks
        What is unusual and no fault, of the case that runs.
    """

    def __init__(
        self,
        bus: ProbeBus,
        sheet: DeviceDescription,
        *,
        timeout: float = TIMEOUT_S,
        clock: Callable[[], float] = monotonic,
    ) -> None:
        if timeout <= 0:
            raise ValueError(f"timeout {timeout} is not above 0")
        self.sheet = sheet
        self.node_id = sheet.node_id
        self.timeout = timeout
        self.watch = max(_WATCH_S, _WATCH * timeout)
        self.pause = max(_PAUSE_S, _PAUSE * timeout)
        self.trace: deque[str] = deque(maxlen=_TRACE_LENGTH)
        self.remarks: list[str] = []
        self._multiplexer = bytes(3)
        self._bus = bus
        self._clock = clock

    def send(self, can_id: int, data: bytes = b"", *, rtr: bool = False) -> None:
        """Send a frame; if the queue of the bus is full, wait until it accepts the frame.

        Raises
        ------
        QueueFullError
            The queue has accepted no frame for the time-out.
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
        """Yield frames as they are received, until the duration in s has elapsed.

        Frames that are waiting at that time are included, however late a loaded system continues.
        """
        end = self._clock() + duration
        last: float | None = None
        while True:
            now = self._clock()
            if last is None and now > end:
                # If frames never end, stop this long after the first late check.
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
        """Return all frames with a CAN-ID within a duration in s, by default `watch`."""
        wait = self.watch if duration is None else duration
        return [arrival for arrival in self.arrivals(wait) if arrival.frame.can_id == can_id]

    def drain(self) -> None:
        """Drop the frames that were received before."""
        while (frame := self._bus.receive(0.0)) is not None:
            self.trace.append(f"< {_text(frame)}")

    def settle(self) -> None:
        """Drop the frames that are received during a pause."""
        for _ in self.arrivals(self.pause):
            pass

    def wait(self, can_id: int, timeout: float | None = None) -> Arrival | None:
        """Return the next data frame with a CAN-ID; None after the time-out in s."""
        for arrival in self.arrivals(self.timeout if timeout is None else timeout):
            if arrival.frame.can_id == can_id and not arrival.frame.rtr:
                return arrival
        return None

    def expect(self, can_id: int, what: str, timeout: float | None = None) -> Frame:
        """Return the next frame with a CAN-ID.

        Raises
        ------
        Failure
            None is received within the time-out in s.
        """
        arrival = self.wait(can_id, timeout)
        if arrival is None:
            limit = self._limit(self.timeout if timeout is None else timeout)
            raise Failure(f"no {what} ({can_id:03X}h) within {limit}")
        return arrival.frame

    def _limit(self, timeout: float) -> str:
        """Return a time-out as text, with what it follows from."""
        return f"{timeout:g} s (--timeout {self.timeout:g})"

    def silence(self, can_id: int, what: str, duration: float | None = None) -> None:
        """Raise `Failure` if a frame with this CAN-ID comes within a duration in s, or `watch`."""
        arrival = self.wait(can_id, self.watch if duration is None else duration)
        if arrival is not None:
            raise Failure(f"unexpected {what}: {_text(arrival.frame)}")

    def sync(self, counter: int | None = None) -> None:
        """Send SYNC; the default counter is 1 if the EDS has a counter, else none."""
        if counter is None and self.sheet.od.number(cia.SYNC_COUNTER):
            counter = 1
        self.send(self.sync_id, b"" if counter is None else bytes((counter,)))

    def nmt(self, command: int, node_id: int | None = None) -> None:
        """Send an NMT command to the device or to another node."""
        self.send(cia.NMT_ID, bytes((command, self.node_id if node_id is None else node_id)))

    def enter(self, command: int) -> None:
        """Send an NMT command to the device, and drop the frames that it causes."""
        self.nmt(command)
        self.settle()

    def reset(self, command: int = NMTCommand.RESET_NODE) -> None:
        """Reset the device and wait until it has started.

        Raises
        ------
        Failure
            No boot-up message comes.
        """
        self.await_boot_up(command)
        self.settle()

    def await_boot_up(self, command: int) -> None:
        """Reset the device and wait for its boot-up message.

        An NMT command is not confirmed, so error control frames may still be under way when it is
        sent. They are passed over.
        """
        self.drain()
        self.nmt(command)
        instead = ""
        timeout = _BOOT * self.timeout
        for arrival in self.arrivals(timeout):
            if arrival.frame.can_id != self.heartbeat_id or arrival.frame.rtr:
                continue
            if arrival.frame.data == cia.BOOT_UP:
                return
            instead = f", but {_text(arrival.frame)}"
        limit = self._limit(timeout)
        raise Failure(f"no boot-up ({self.heartbeat_id:03X}h) within {limit}{instead}")

    def require_device(self) -> None:
        """Raise `Failure` unless the device responds to a reset or to SDO."""
        with suppress(Failure):
            self.reset()
            return
        with suppress(Abort):
            self.request(b"\x40\0\x10\0")

    @property
    def sync_id(self) -> int:
        """CAN-ID of SYNC in the EDS."""
        return self.sheet.od.sync_id

    @property
    def heartbeat_id(self) -> int:
        """CAN-ID of the device's error control frames."""
        return cia.HEARTBEAT_ID + self.node_id

    def request(self, data: bytes) -> bytes:
        """Send an SDO request of up to 8 bytes, padded with zeros; return the response."""
        self.drain()
        self.sdo_send(data)
        return self.sdo_response()

    def sdo_send(self, data: bytes) -> None:
        """Send an SDO request of up to 8 bytes, padded with zeros, without waiting."""
        subcommand = data[0] & _SUBCOMMAND_BITS.get(data[0] >> 5, 0xFF)
        if not subcommand:
            self._multiplexer = data[1:4]
        self.send(cia.SDO_RX_ID + self.node_id, data.ljust(cia.FRAME_BYTES, b"\0"))

    def abort_transfer(self) -> None:
        """Abort the last transfer, which may still be open, by 08000000h."""
        self.sdo_end(b"\x80" + self._multiplexer + AbortCode.GENERAL.to_bytes(4, "little"))

    def sdo_end(self, data: bytes) -> None:
        """Send an SDO frame that ends a transfer and has no answer; pause, so that it can act."""
        self.sdo_send(data)
        self.settle()

    def sdo_response(self, timeout: float | None = None) -> bytes:
        """Wait for the next SDO response and return its 8 bytes.

        Raises
        ------
        Abort
            The response is an abort.
        Failure
            No response is received within the time-out in s.
        """
        data = self.expect(cia.SDO_TX_ID + self.node_id, "SDO response", timeout).data
        if len(data) != cia.FRAME_BYTES:
            raise Failure(f"SDO response of {len(data)} bytes")
        if data[0] == ABORT:
            raise Abort(int.from_bytes(data[4:], "little"))
        return data

    @contextmanager
    def refused(self, what: str, refusal: Refusal | None = None) -> Iterator[None]:
        """Raise `Failure` unless an abort ends the block; remark on a code not in the refusal."""
        try:
            yield
        except Abort as abort:
            if refusal is not None and abort.code not in refusal.codes:
                wanted = " or ".join(f"{code:08X}h" for code in refusal.codes)
                self.remarks.append(f"{what}: {abort}, not {wanted}")
            return
        raise Failure(f"{what}: accepted")


def _text(frame: Frame) -> str:
    return f"{frame.can_id:03X} {'rtr' if frame.rtr else frame.data.hex(' ').upper()}".rstrip()


# SDO transfers of a client, with a check of each step.


_UPLOAD_RESPONSE = 2
_SEGMENT = 7
_LONGEST = 1 << 24


def address(index: int, subindex: int) -> bytes:
    """Return the multiplexer of an SDO request: the three bytes that address an entry."""
    return index.to_bytes(2, "little") + bytes((subindex,))


def upload(examiner: Examiner, index: int, subindex: int = 0) -> bytes:
    """Read the bytes of an entry by expedited or segmented upload.

    Raises
    ------
    Abort
        The device refuses.
    Failure
        The device does not answer, or violates the protocol.
    """
    where = address(index, subindex)
    response = examiner.request(b"\x40" + where)
    command = response[0]
    if command >> 5 != _UPLOAD_RESPONSE or response[1:4] != where:
        raise Failure(f"upload of {index:04X}h:{subindex:02X} answered by {response.hex(' ')}")
    if command & 2:
        return response[4 : 8 - (command >> 2 & 3)] if command & 1 else response[4:]
    size = int.from_bytes(response[4:], "little") if command & 1 else None
    data = bytearray()
    toggle = 0
    while len(data) < _LONGEST:
        segment = examiner.request(bytes((0x60 | toggle,)))
        if segment[0] >> 5 or segment[0] & 0x10 != toggle:
            raise Failure(f"upload segment with command byte {segment[0]:02X}h, toggle {toggle:X}h")
        data += segment[1 : 8 - (segment[0] >> 1 & 7)]
        toggle ^= 0x10
        if segment[0] & 1:
            break
    if size is not None and len(data) != size:
        raise Failure(f"{index:04X}h:{subindex:02X} says {size} bytes and sends {len(data)}")
    return bytes(data)


def download(examiner: Examiner, index: int, subindex: int, data: bytes) -> None:
    """Write an entry, by expedited download up to 4 bytes, else segmented.

    Raises
    ------
    Abort
        The device refuses.
    Failure
        The device does not answer, or violates the protocol.
    """
    if not 1 <= len(data) <= cia.EXPEDITED_BYTES:
        download_segments(examiner, index, subindex, data)
        return
    where = address(index, subindex)
    command = 0x23 | (4 - len(data)) << 2
    confirm(examiner.request(bytes((command,)) + where + data), where)


def download_segments(
    examiner: Examiner, index: int, subindex: int, data: bytes, *, with_size: bool = True
) -> None:
    """Write an entry by segmented download, whatever its length."""
    where = address(index, subindex)
    size = len(data).to_bytes(4, "little") if with_size else bytes(4)
    confirm(examiner.request(bytes((0x20 | with_size,)) + where + size), where)
    toggle = 0
    parts = [data[i : i + _SEGMENT] for i in range(0, len(data), _SEGMENT)] or [b""]
    for number, part in enumerate(parts, 1):
        last = number == len(parts)
        command = toggle | (_SEGMENT - len(part)) << 1 | last
        response = examiner.request(bytes((command,)) + part)
        if response[0] != 0x20 | toggle:
            raise Failure(f"download segment answered by {response.hex(' ')}")
        toggle ^= 0x10


def confirm(response: bytes, where: bytes) -> None:
    """Raise `Failure` unless the response confirms a download to the entry."""
    if response != b"\x60" + where + bytes(4):
        raise Failure(f"download answered by {response.hex(' ')}")


def number(examiner: Examiner, index: int, subindex: int = 0) -> int:
    """Read an unsigned number of any length."""
    return int.from_bytes(upload(examiner, index, subindex), "little")


def write_number(examiner: Examiner, index: int, subindex: int, value: int) -> None:
    """Write an unsigned number with the length of the entry in the EDS.

    Raises
    ------
    NotApplicable
        The value is beyond the limits of the EDS, so that the device may refuse it.
    """
    reason = examiner.sheet.limits(index, subindex, value)
    if reason is not None:
        raise NotApplicable(reason)
    try_number(examiner, index, subindex, value)


def try_number(examiner: Examiner, index: int, subindex: int, value: int) -> None:
    """Write an unsigned number as `write_number` does, also one beyond the limits of the EDS."""
    size = examiner.sheet.od.entry(index, subindex).size
    download(examiner, index, subindex, value.to_bytes(size, "little"))


# Periodic frames: how long a case receives them, and the tolerance of their period.


SPREAD = 0.4
"""Tolerance of a period as a fraction, which includes a bus in use and the computer's clock."""
PERIODS = 8
"""Number of periods for which a case receives periodic frames."""
LEAST = 3
"""Least number of frames in that time from which the period is computed."""


def mean_gap_ms(arrivals: list[Arrival]) -> float:
    """Return the mean time between two frames in ms."""
    gaps = [1000 * (later.time - earlier.time) for earlier, later in pairwise(arrivals)]
    return sum(gaps) / len(gaps)


def periodic(
    examiner: Examiner, can_id: int, name: str, parameter: str, period_ms: int
) -> list[Arrival]:
    """Receive the frames with a CAN-ID for 8 periods, and return them.

    Raises
    ------
    Failure
        Fewer than 3 are received, or their period is wrong; it gives the names of frame and
        parameter.
    """
    examiner.drain()
    arrivals = examiner.collect(can_id, 1e-3 * PERIODS * period_ms)
    if len(arrivals) < LEAST:
        raise Failure(f"{len(arrivals)} {name}s in {PERIODS} periods of {period_ms} ms")
    mean = mean_gap_ms(arrivals)
    if abs(mean - period_ms) > SPREAD * period_ms:
        raise Failure(f"{name} every {mean:.0f} ms, {parameter} {period_ms} ms")
    return arrivals

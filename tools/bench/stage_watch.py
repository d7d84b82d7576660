"""The voltage of the plate's stage, read by SDO as fast as possible beside a running loop."""

from __future__ import annotations

from contextlib import suppress
from time import monotonic
from types import TracebackType
from typing import Any, Final, NamedTuple, Self

from smarttac_can.bench.simulation import PLATE_ID, STIMULATOR_ID, plate_od, stimulator_od
from smarttac_can.canopen.bus.bus import QueueFullError
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.master import requests
from smarttac_can.canopen.master.errors import BenchError
from smarttac_can.canopen.od import cia
from smarttac_can.canopen.od.cia import Abort
from smarttac_can.canopen.od.entry import Entry
from smarttac_can.host.python_can import PythonCanBus
from smarttac_can.vocabulary.signals import MEASUREMENT_RPDOS

MASTER_ID: Final = 100
"""Node-ID of the heartbeat of `StageWatch`."""
_BEAT_S: Final = 0.1
_ANSWER_S: Final = 0.02
_PATIENCE_S: Final = 30.0
_NODES: Final = (PLATE_ID, STIMULATOR_ID)


class Moment(NamedTuple):
    """Bounds of the time of an event, in s of the monotonic clock."""

    begun: float
    over: float


class Reading(NamedTuple):
    """A value with bounds of the time of its reading, in s of the monotonic clock."""

    asked: float
    answered: float
    raw: int


class StageWatch:
    """Expedited SDO, emergency messages, and a heartbeat, on a bus with a plate and a stimulator.

    It has no thread: everything happens in its calls.

    Parameters
    ----------
    bus
        Options of `PythonCanBus`.

    Attributes
    ----------
    emergencies
        Node-ID and code of each emergency message received while a call waited.
    tick
        Tick of the last measurement of the plate received while a call waited.
    beats
        Whether a heartbeat is sent every 0.1 s, by calls that wait.
    beats_as
        Node-ID of that heartbeat, `MASTER_ID` at first.
    beaten
        Time of the last heartbeat.
    """

    def __init__(self, **bus: Any) -> None:
        self._bus = PythonCanBus(**bus)
        # Otherwise frames of the loop, or requests of others, fill the socket, and answers are
        # lost.
        others = {
            base + node for base in (*cia.TPDO_IDS, *cia.RPDO_IDS, cia.SDO_RX_ID) for node in _NODES
        }
        self._bus.block(frozenset(others - {cia.TPDO_IDS[0] + PLATE_ID}))
        self._ods = {PLATE_ID: plate_od(), STIMULATOR_ID: stimulator_od()}
        self._stage = self._ods[PLATE_ID]["Stage.Voltage"]
        self.emergencies: list[tuple[int, int]] = []
        self.tick = 0
        self.beats = False
        self.beats_as = MASTER_ID
        self.beaten = Moment(0.0, 0.0)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._bus.close()

    def send(self, can_id: int, data: bytes) -> None:
        """Send a frame, unless the queue is full."""
        self._send(Frame(can_id, data))

    def ask(self) -> None:
        """Request the voltage without waiting for the answer."""
        self._send(requests.upload(PLATE_ID, self._stage))

    def listen(self, seconds: float) -> None:
        """Receive frames for a time in s; frames are lost once the socket is full."""
        end = monotonic() + seconds
        while (left := end - monotonic()) > 0:
            self._hear(left)

    def read_stage(self) -> Reading:
        """Return the voltage of the stage in 10 mV; raises as `read`."""
        return self._transfer(requests.upload(PLATE_ID, self._stage), PLATE_ID, self._stage)

    def read(self, node_id: int, entry: Entry) -> int:
        """Return the raw value of an object of up to 4 bytes.

        Raises
        ------
        BenchError
            If the node refuses, or does not answer for 30 s.
        """
        return self._transfer(requests.upload(node_id, entry), node_id, entry).raw

    def write(self, node_id: int, entry: Entry, raw: int) -> None:
        """Write a raw value to an object of 1 to 4 bytes; raises as `read`."""
        self._transfer(requests.download(node_id, entry, raw), node_id, entry)

    def errors(self, node_id: int) -> list[int]:
        """Return the error history of a node, newest first; raises as `read`.

        Each entry is an emergency error code in the lower 16 bits, and the first two bytes of the
        manufacturer's part of the message above.
        """
        history = self._ods[node_id].objects[cia.ERROR_FIELD].entries
        number = self.read(node_id, history[0])
        return [self.read(node_id, history[place]) for place in range(1, number + 1)]

    def forget_errors(self, node_id: int) -> None:
        """Clear the error history of a node; raises as `read`."""
        self.write(node_id, self._ods[node_id].entry(cia.ERROR_FIELD, 0), 0)

    def deadline_ms(self) -> int:
        """Return the deadline of the plate in ms; raises as `read`."""
        return self.read(PLATE_ID, self._deadline(PLATE_ID, 1))

    def set_deadlines(self, deadline_ms: int) -> None:
        """Set the deadlines of the loop at both nodes, 1..100 ms; raises as `read`."""
        self.write(PLATE_ID, self._deadline(PLATE_ID, 1), deadline_ms)
        for rpdo in MEASUREMENT_RPDOS:
            self.write(STIMULATOR_ID, self._deadline(STIMULATOR_ID, rpdo), deadline_ms)

    def _deadline(self, node_id: int, rpdo: int) -> Entry:
        return self._ods[node_id].entry(cia.RPDO_COMMUNICATION + rpdo - 1, cia.PDO_EVENT)

    def _transfer(self, request: Frame, node_id: int, entry: Entry) -> Reading:
        """Repeat a request until an answer comes, which may belong to any of the requests."""
        asked = monotonic()
        while monotonic() < asked + _PATIENCE_S:
            self._send(request)
            again = monotonic() + _ANSWER_S
            while (left := again - monotonic()) > 0:
                frame = self._hear(left)
                if frame is None or not requests.answers(frame, request):
                    continue
                try:
                    raw = requests.value(frame, entry)
                except Abort as abort:
                    raise BenchError(f"node {node_id} refuses it: {abort.code:08X}h") from abort
                return Reading(asked, monotonic(), raw)
        raise BenchError(f"node {node_id} does not answer")

    def _send(self, frame: Frame) -> None:
        with suppress(QueueFullError):
            self._bus.send(frame)

    def _hear(self, timeout: float) -> Frame | None:
        if self.beats and monotonic() > self.beaten.begun + _BEAT_S:
            begun = monotonic()
            self._send(requests.heartbeat(self.beats_as))
            self.beaten = Moment(begun, monotonic())
        frame = self._bus.receive(timeout)
        if frame is None:
            return None
        if frame.can_id == cia.TPDO_IDS[0] + PLATE_ID:
            self.tick = frame.data[4]
        elif frame.can_id - cia.EMCY_ID in _NODES:
            code = int.from_bytes(frame.data[:2], "little")
            self.emergencies.append((frame.can_id - cia.EMCY_ID, code))
        return frame

"""A CANopen device from the view of a client: SDO, its heartbeat, and the bench's heartbeat."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from itertools import cycle
from threading import Event
from time import monotonic
from typing import Any, Final

import can
import canopen
from canopen.sdo.exceptions import SdoAbortedError, SdoCommunicationError

from smarttac_can.bench.errors import NotRunningError, refused_write, write_action
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.device.nmt import NMTState, state_text
from smarttac_can.canopen.master.errors import (
    BenchError,
    BusLostError,
    HeartbeatLostError,
    NodeNotFoundError,
    RefusedError,
    WrongDeviceError,
)
from smarttac_can.canopen.master.requests import answers, upload
from smarttac_can.canopen.master.sdo_client import OtherClientError, SharedSdoClient
from smarttac_can.canopen.od import cia
from smarttac_can.canopen.od.cia import Abort, AbortCode, NMTCommand
from smarttac_can.canopen.od.data_types import pack, unpack
from smarttac_can.canopen.od.dictionary import ObjectDictionary
from smarttac_can.canopen.od.entry import Entry
from smarttac_can.vocabulary.states import Control, Mode

_HEARTBEATS_MISSED: Final = 6
_ASK_AGAIN_S: Final = 1.0
_PRODUCT_CODE: Final = 2
_IDS: Final = 16
_PERIOD_S: Final = 0.1
_LISTEN_MS: Final = 250
"""Two heartbeats of another bench, and some delay, in ms."""
_LOST_MS: Final = 1000
_OPERATIONAL: Final = bytes((NMTState.OPERATIONAL,))


class RemoteDevice:
    """A CANopen device on the bus, checked against its EDS.

    Parameters
    ----------
    network
        Connected network of python-canopen.
    od
        Object dictionary from the EDS, loaded for the device's node-ID.
    where
        Name of the bus for error messages.
    timeout
        Longest wait for an SDO answer in s.
    turn
        Entered during each transfer, as the clients of python-canopen are for one thread.

    Attributes
    ----------
    heartbeat_at
        Time of its last heartbeat, by `time.monotonic`; None before the first.
    heartbeat_s
        Period of its heartbeat in s; 0 if it sends none.
    state
        Last known NMT state.

    Raises
    ------
    NodeNotFoundError
        If no node answers.
    WrongDeviceError
        If the product code differs from the EDS.
    """

    def __init__(
        self,
        network: canopen.Network,
        od: ObjectDictionary,
        where: str,
        timeout: float,
        turn: AbstractContextManager[None] = nullcontext(),  # noqa: B008 - has no state
    ) -> None:
        self.od = od
        self._turn = turn
        self._network = network
        self._name = od.info.get("productname", "device")
        self._sdo = SharedSdoClient(network, od.node_id, timeout)
        self._asked = cycle(od.objects[cia.IDENTITY].entries.values())
        self.heartbeat_at: float | None = None
        self.state = 0
        network.subscribe(cia.HEARTBEAT_ID + od.node_id, self._on_heartbeat)
        expected = od.entry(cia.IDENTITY, _PRODUCT_CODE)
        try:
            found = self.read(expected)
        except HeartbeatLostError as error:
            raise NodeNotFoundError(
                f"no node {od.node_id} answers on {where}: is it running there, with that node-ID?"
            ) from error
        if found != expected.default:
            raise WrongDeviceError(
                f"node {od.node_id} on {where} has product code {found:08X}, "
                f"a {self._name} has {expected.default:08X}: give the node-ID of the right one"
            )
        period = od.entry(cia.HEARTBEAT_PRODUCER)
        self.heartbeat_s = self.read(period) * period.si

    def read(self, entry: Entry) -> Any:
        """Read an entry over SDO."""
        with self._turn, self._explained(f"read {entry.name}"):
            return unpack(entry.data_type, self._sdo.upload(entry.index, entry.subindex))

    def write(self, entry: Entry, raw: int | bytes) -> None:
        """Write an entry over SDO, bytes by block transfer."""
        if isinstance(raw, bytes):
            with self._turn:
                self._write_block(entry, raw)
            return
        try:
            data = pack(entry.data_type, raw)
        except OverflowError as error:
            # A value that does not fit the type is refused here, with the words of the device.
            code = AbortCode.TOO_LOW if raw < 0 else AbortCode.TOO_HIGH
            raise refused_write(entry, raw, Abort(code)) from error
        with self._turn, self._explained(write_action(entry, raw)):
            try:
                self._sdo.download(entry.index, entry.subindex, data)
            except SdoAbortedError as error:
                raise refused_write(entry, raw, Abort(error.code)) from error

    def _write_block(self, entry: Entry, data: bytes) -> None:
        """Write a DOMAIN by SDO block transfer; empty data by a segmented transfer."""
        client = canopen.sdo.SdoClient(
            self._sdo.rx_cobid, self._sdo.tx_cobid, canopen.ObjectDictionary()
        )
        client.network = self._network
        client.RESPONSE_TIMEOUT = self._sdo.RESPONSE_TIMEOUT
        # The client of `read` does not handle block answers, so this one listens, too.
        self._network.subscribe(client.tx_cobid, client.on_response)
        try:
            with (
                self._explained(write_action(entry, data)),
                client.open(
                    entry.index, entry.subindex, "wb", size=len(data), block_transfer=bool(data)
                ) as stream,
            ):
                stream.write(data)
        finally:
            self._network.unsubscribe(client.tx_cobid, client.on_response)

    def start(self) -> None:
        """Command the device into the NMT state OPERATIONAL."""
        self._network.send_message(cia.NMT_ID, [NMTCommand.START, self.od.node_id])
        self.state = int(NMTState.OPERATIONAL)

    @property
    def operational(self) -> bool:
        """Whether its last heartbeat or PDO shows it OPERATIONAL."""
        return self.state == NMTState.OPERATIONAL

    def check_operational(self) -> None:
        """Raise NotRunningError if its last known NMT state is not OPERATIONAL."""
        if not self.operational:
            raise NotRunningError(
                f"node {self.od.node_id} is {state_text(self.state)}: a master, or the "
                "loss of a node that it supervises, has stopped it; connect again, which starts it"
            )

    @property
    def silence(self) -> float:
        """Time in s since the last heartbeat, if heartbeats were received and then lost; else 0."""
        if self.heartbeat_at is None or not self.heartbeat_s:
            return 0.0
        silence = monotonic() - self.heartbeat_at
        return silence if silence > _HEARTBEATS_MISSED * self.heartbeat_s else 0.0

    def check_heartbeat(self) -> None:
        """Raise HeartbeatLostError if heartbeats were received and then lost."""
        if silence := self.silence:
            raise HeartbeatLostError(
                f"node {self.od.node_id} has sent no heartbeat for {silence:.1f} s: "
                "it has stopped or left the bus; connect again when it is back"
            )

    def await_answer(self, patience: float, interrupted: Callable[[], bool]) -> None:
        """Wait until the device answers a request: it has then handled all earlier frames.

        Parameters
        ----------
        patience
            Longest silence of the device in s.
        interrupted
            Function that ends the wait by returning True.

        Raises
        ------
        HeartbeatLostError
            If the device is silent for longer.
        BusLostError
            If the bus has failed.
        """
        node_id = self.od.node_id
        # Each request reads another object, so that a late answer to the one before is not taken.
        request = upload(node_id, next(self._asked))
        answered = Event()

        def hear(can_id: int, data: bytearray, _timestamp: float) -> None:
            if answers(Frame(can_id, bytes(data)), request):
                answered.set()

        self._network.subscribe(cia.SDO_TX_ID + node_id, hear)
        try:
            end = monotonic() + patience
            while not interrupted():
                self._network.send_message(request.can_id, request.data)
                if answered.wait(_ASK_AGAIN_S):
                    return
                if monotonic() > end:
                    raise HeartbeatLostError(
                        f"node {node_id} has answered nothing for {patience:g} s: it has stopped "
                        "or left the bus; connect again when it is back"
                    )
        except can.CanError as error:
            raise BusLostError(f"cannot ask node {node_id}: the bus has failed: {error}") from error
        finally:
            self._network.unsubscribe(cia.SDO_TX_ID + node_id, hear)

    def _on_heartbeat(self, _can_id: int, data: bytearray, _timestamp: float) -> None:
        self.heartbeat_at = monotonic()
        self.state = data[0] & 0x7F if data else 0

    @contextmanager
    def _explained(self, action: str) -> Iterator[None]:
        try:
            yield
        except SdoAbortedError as error:
            raise RefusedError(f"cannot {action}: {Abort(error.code)}", error.code) from error
        except SdoCommunicationError as error:
            raise HeartbeatLostError(
                f"cannot {action}: node {self.od.node_id} does not answer"
            ) from error
        except OtherClientError as error:
            raise BenchError(
                f"cannot {action}: another SDO client keeps node {self.od.node_id} busy; end that"
            ) from error
        except can.CanError as error:
            raise BusLostError(f"cannot {action}: the bus has failed: {error}") from error


def bench_id(stimulator_id: int) -> int:
    """Return the node-ID, 112..127, that a bench uses for its heartbeat to a stimulator.

    Stimulators on one bus may have different benches, so each watches a different node-ID.
    """
    return cia.LAST_NODE_ID - stimulator_id % _IDS


def drives(name: str, raw: int) -> bool:
    """Return whether a write may lead to a voltage; a quick stop, from any bench, does not."""
    if name == "Controlword":
        return bool(raw & (Control.ARM | Control.FAULT_RESET))
    return name == "Mode" and raw != Mode.OFF


class BenchHeartbeat:
    """Heartbeat of a commanding bench in real time, from `begin` to `end`.

    A bench that only reads sends none. It need not be supervised, and its heartbeat would hide that
    the one of a killed commander is missing.

    Parameters
    ----------
    network
        Connected network of python-canopen.
    stimulator
        Stimulator that consumes the heartbeat, in the first free entry of 1016h. If all entries are
        in use, the bus has a master of its own, and the heartbeat is not consumed.
    """

    def __init__(self, network: canopen.Network, stimulator: RemoteDevice) -> None:
        self._network = network
        self._stimulator = stimulator
        self._id = bench_id(stimulator.od.node_id)
        self._watch = self._id << 16 | _LOST_MS
        self._over = threading.Event()
        # A periodic task of python-can cannot be joined when it ends.
        self._thread = threading.Thread(target=self._beat, name="bench heartbeat", daemon=True)

    @property
    def begun(self) -> bool:
        """Whether this bench has begun to command."""
        return self._thread.ident is not None

    def begin(self) -> None:
        """Start the heartbeat, and let the stimulator consume it, also again after a reset.

        Raises
        ------
        BenchError
            If another bench commands this stimulator, or the bus has failed.
        """
        watches = self._watches()
        own = [entry for entry, value in watches.items() if value >> 16 & 0x7F == self._id]
        if not self.begun and self._another_beats([watches[entry] & 0xFFFF for entry in own]):
            raise BenchError(
                f"another bench script drives node {self._stimulator.od.node_id}: "
                f"node {self._id}, its heartbeat, is on the bus; end that script first"
            )
        free = [entry for entry, value in watches.items() if value == 0]
        anew = not self.begun
        for entry in (own + free)[:1]:
            if watches[entry] != self._watch:
                self._stimulator.write(entry, self._watch)
                anew = True
        if anew:
            # Send the first heartbeat before the bench goes on: it starts the supervision, and
            # clears the fault that a killed bench has left.
            try:
                self._send()
            except can.CanError as error:
                raise BusLostError(
                    f"cannot send a heartbeat: the bus has failed: {error}"
                ) from error
        if not self.begun:
            self._thread.start()

    def end(self) -> None:
        """Remove the consumer entry, then end the heartbeat.

        Raises
        ------
        BenchError
            If the entry remains, which a stimulator refuses to remove while it is armed. It goes to
            0 V when it misses the heartbeat.
        """
        try:
            for entry, value in self._watches().items():
                if value == self._watch:
                    self._stimulator.write(entry, 0)
        finally:
            self._over.set()
            self._thread.join()

    def _beat(self) -> None:
        try:
            while not self._over.wait(_PERIOD_S):
                self._send()
        except can.CanError:
            # A failed bus stops the plate, and the next transfer of the bench reports it.
            return

    def _send(self) -> None:
        self._network.send_message(cia.HEARTBEAT_ID + self._id, _OPERATIONAL)

    def _watches(self) -> dict[Entry, int]:
        device = self._stimulator
        entries = device.od.objects[cia.HEARTBEAT_CONSUMER].entries
        return {
            entries[subindex]: device.read(entries[subindex]) for subindex in entries if subindex
        }

    def _another_beats(self, watched_ms: list[int]) -> bool:
        """Return whether another heartbeat comes while the stimulator would wait for one."""
        heard = threading.Event()

        def hear(_can_id: int, _data: bytearray, _timestamp: float) -> None:
            heard.set()

        self._network.subscribe(cia.HEARTBEAT_ID + self._id, hear)
        try:
            return heard.wait(max([_LISTEN_MS, *watched_ms]) * 1e-3)
        finally:
            self._network.unsubscribe(cia.HEARTBEAT_ID + self._id, hear)

"""Command ``log``: show the frames of a log or of a bus in plain text, by the EDS of each node."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from contextlib import closing
from datetime import datetime, timedelta
from pathlib import Path
from time import monotonic_ns
from typing import Final

import can
import click

from smarttac_can.bench.simulation import PLATE_ID, STIMULATOR_ID
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.device.lss import LSS_NAMES
from smarttac_can.canopen.device.mapping import Direction, Mapping, compile_mapping
from smarttac_can.canopen.device.nmt import STATES, NMTState
from smarttac_can.canopen.od import cia
from smarttac_can.canopen.od.cia import Abort, DataType, NMTCommand
from smarttac_can.canopen.od.data_types import SIZES
from smarttac_can.canopen.od.dictionary import ObjectDictionary
from smarttac_can.canopen.od.eds import load_eds
from smarttac_can.cli.shared import (
    EDS_FILE,
    OLD_FILE,
    BusChoice,
    bus_options,
    is_ours,
    load_file,
    one_line,
    plain_errors,
)
from smarttac_can.host.can_socket import to_frame
from smarttac_can.host.files import read_eds
from smarttac_can.host.log_file import read_messages
from smarttac_can.host.process_signals import stop_on_signals
from smarttac_can.vocabulary.meanings import (
    FIELDS,
    Names,
    emergency_text,
    meaning,
    meaning_of_bytes,
)

_PACKAGED: Final = {STIMULATOR_ID: "stimulator.eds", PLATE_ID: "plate.eds"}
_DIRECTIONS: Final = (
    ("RPDO", cia.RPDO_COMMUNICATION, cia.RPDO_MAPPING, Direction.RECEIVE),
    ("TPDO", cia.TPDO_COMMUNICATION, cia.TPDO_MAPPING, Direction.TRANSMIT),
)
_NODE_IDS: Final = range(1, 128)
_WAIT_S: Final = 0.1
_ABORT: Final = 0x80
_EXPEDITED, _SIZED = 0b10, 0b01
_DOWNLOAD, _UPLOAD = 1, 2
"""Command specifiers that start a transfer: that of a download request, and that of an upload
request and of its response."""


class FrameText:
    """Describe frames as text. Identifiers and mappings are those of the EDS files.

    Parameters
    ----------
    nodes
        Name and object dictionary of each node.
    """

    def __init__(self, nodes: Iterable[tuple[str, ObjectDictionary]]) -> None:
        self._names: dict[int, str] = {}
        self._ods: dict[int, ObjectDictionary] = {}
        self._fields: dict[int, Names] = {}
        self._pdos: dict[int, list[tuple[str, ObjectDictionary, Mapping | None]]] = {}
        self._emcy: dict[int, int] = {}
        for name, od in nodes:
            self._names[od.node_id] = f"{name} {od.node_id}"
            self._ods[od.node_id] = od
            self._fields[od.node_id] = FIELDS if is_ours(od) else {}
            self._add_pdos(self._names[od.node_id], od)
            cob_id = od.number(cia.EMCY_COB_ID, absent=cia.COB_INVALID)
            if not cob_id & cia.COB_INVALID:
                self._emcy[cob_id & cia.CAN_ID_MASK] = od.node_id

    def of_message(self, message: can.Message) -> str:
        """Return the meaning of a message of a log in one line, also of one that is no CANopen."""
        frame = to_frame(message)
        if frame is not None:
            return self.of(frame)
        data = bytes(message.data).hex(" ")
        if message.is_error_frame:
            return f"error frame {data}".rstrip()
        kind = "CAN FD frame" if message.is_fd else "frame with a 29-bit identifier"
        return f"no CANopen: {kind} {'(remote)' if message.is_remote_frame else data}".rstrip()

    def of(self, frame: Frame) -> str:
        """Return the meaning of a frame in one line."""
        can_id, data = frame.can_id, frame.data
        if can_id == cia.NMT_ID:
            return _nmt(data, self._names)
        if pdos := self._pdos.get(can_id):
            return "; ".join(f"{name}: {self._pdo(od, m, frame)}" for name, od, m in pdos)
        if can_id in self._emcy:
            return f"{self._names[self._emcy[can_id]]} {self._emergency(self._emcy[can_id], frame)}"
        if can_id in _OF_ALL:
            return _OF_ALL[can_id](data)
        for base, text_of in (
            (cia.EMCY_ID, self._emergency),
            (cia.SDO_TX_ID, self._answer),
            (cia.SDO_RX_ID, self._request),
            (cia.HEARTBEAT_ID, _heartbeat),
        ):
            if can_id - base in _NODE_IDS:
                node = can_id - base
                return f"{self._names.get(node, f'node {node}')} {text_of(node, frame)}"
        return f"unknown {'(remote)' if frame.rtr else data.hex(' ')}".rstrip()

    def _add_pdos(self, name: str, od: ObjectDictionary) -> None:
        for kind, communication, mapping, direction in _DIRECTIONS:
            for number in range(cia.PDO_COUNT):
                cob_id = od.get(communication + number, cia.PDO_COB_ID)
                if cob_id is None or cob_id.default & cia.COB_INVALID:
                    continue
                try:
                    compiled = compile_mapping(od, mapping + number, direction)
                except Abort:  # a multiplexed PDO, or a mapping of what the EDS does not have
                    compiled = None
                same = self._pdos.setdefault(cob_id.default & cia.CAN_ID_MASK, [])
                same.append((f"{name} {kind} {number + 1}", od, compiled))

    def _pdo(self, od: ObjectDictionary, mapping: Mapping | None, frame: Frame) -> str:
        data = frame.data
        if frame.rtr:
            return "is asked for"
        if mapping is None or not mapping.size:
            return f"{data.hex(' ')}, of a mapping that the EDS does not have"
        if len(data) < mapping.size:
            return f"{data.hex(' ')}, {mapping.size} bytes are mapped"
        fields = self._fields[od.node_id]
        values = zip(mapping.entries, mapping.read(data[: mapping.size]), strict=True)
        return ", ".join(f"{entry.name} {meaning(entry, raw, fields)}" for entry, raw in values)

    def _emergency(self, node: int, frame: Frame) -> str:
        data = frame.data
        code = int.from_bytes(data[:2], "little")
        if self._fields.get(node):
            return f"EMCY {code:04X}h: {emergency_text(code)}"
        if len(data) != cia.FRAME_BYTES:
            return f"EMCY {data.hex(' ')}, no 8 bytes"
        more = f", manufacturer {data[3:].hex(' ')}" if any(data[3:]) else ""
        return f"EMCY {code:04X}h: {cia.emergency_text(code)}; error register {data[2]:02X}h{more}"

    def _request(self, node: int, frame: Frame) -> str:
        return f"is asked by SDO: {self._sdo(node, frame, ('write', 'read'))}"

    def _answer(self, node: int, frame: Frame) -> str:
        return f"answers by SDO: {self._sdo(node, frame, ('has read', 'written'))}"

    def _sdo(self, node: int, frame: Frame, verbs: tuple[str, str]) -> str:
        data = frame.data
        if len(data) != cia.FRAME_BYTES:
            return f"{data.hex(' ')}, no SDO"
        index, subindex, command = data[1] | data[2] << 8, data[3], data[0]
        entry = self._ods[node].get(index, subindex) if node in self._ods else None
        what = f"{index:04X}h:{subindex} {entry.name if entry else ''}".rstrip()
        if command == _ABORT:
            return f"abort, {what}: {Abort(int.from_bytes(data[4:], 'little'))}"
        answer = cia.SDO_TX_ID <= frame.can_id < cia.SDO_RX_ID
        carries = _UPLOAD if answer else _DOWNLOAD
        specifier = command >> 5
        if specifier == carries and command & _EXPEDITED:
            size = 4 - (command >> 2 & 0b11) if command & _SIZED else 4
            value = meaning_of_bytes(entry, data[4 : 4 + size], self._fields.get(node, {}))
            return f"{verbs[0]} {what} = {value}"
        if specifier == carries:
            return f"{verbs[0]} {what}, in segments"
        if specifier == (3 if answer else _UPLOAD):
            return f"{verbs[1]} {what}"
        return f"segment {data.hex(' ')}"


def _nmt(data: bytes, names: dict[int, str]) -> str:
    known = [command for command in NMTCommand if data[:1] == bytes((command,))]
    if not known or len(data) == 1:
        return f"NMT {data.hex(' ')}, no command"
    who = names.get(data[1], f"node {data[1]}") if data[1] else "all nodes"
    return f"NMT {known[0].name.lower().replace('_', ' ')}: {who}"


def _sync(data: bytes) -> str:
    return f"SYNC {data[0]}" if data else "SYNC"


def _time(data: bytes) -> str:
    if len(data) != SIZES[DataType.TIME_OF_DAY]:
        return f"TIME {data.hex(' ')}, no 6 bytes"
    milliseconds = int.from_bytes(data[:4], "little") & _MILLISECONDS
    days = int.from_bytes(data[4:], "little")
    moment = datetime(1984, 1, 1) + timedelta(days=days, milliseconds=milliseconds)
    return f"TIME {moment.isoformat(' ', 'milliseconds')}"


def _lss(data: bytes) -> str:
    if len(data) != cia.FRAME_BYTES:
        return f"LSS {data.hex(' ')}, no 8 bytes"
    name = LSS_NAMES.get(data[0], f"command {data[0]:02X}h")
    return f"LSS {name}: {data[1:].hex(' ')}"


_MILLISECONDS: Final = (1 << 28) - 1
_OF_ALL: Final = {
    cia.SYNC_ID: _sync,
    cia.TIME_ID: _time,
    cia.LSS_MASTER_ID: _lss,
    cia.LSS_SLAVE_ID: _lss,
}
"""Services without a node, by their CAN-ID."""


def _heartbeat(_node: int, frame: Frame) -> str:
    if frame.rtr:
        return "is asked for its state"
    if not frame.data:
        return "heartbeat without a state"
    state = frame.data[0] & 0x7F
    if state == NMTState.INITIALISING:
        return "boot-up"
    return f"heartbeat, {STATES.get(state, state)}"


def _node_eds(
    _ctx: click.Context, _param: click.Parameter, given: tuple[str, ...]
) -> dict[int, Path]:
    found = {}
    for text in given:
        number, separator, file = text.partition("=")
        if not (separator and number.isdecimal() and int(number) in _NODE_IDS):
            raise click.BadParameter(f"{text!r} is not NODE=EDS with a node-ID of 1..127")
        found[int(number)] = Path(EDS_FILE(file))
    return found


@click.command(
    epilog="\b\nExamples:\n  smarttac log run.log\n"
    "  smarttac log --interface socketcan --channel can0\n"
    "  smarttac log run.blf --eds 12=drive.eds"
)
@click.argument("file", type=OLD_FILE, required=False)
@click.option(
    "--eds",
    "eds_files",
    multiple=True,
    metavar="NODE=EDS",
    callback=_node_eds,
    help="EDS of a node.  [default: the stimulator for 32, the plate for 33]",
)
@bus_options
def log(file: Path | None, eds_files: dict[int, Path], bus: BusChoice) -> None:
    """Show the frames of a log FILE in plain text, or the frames on a bus until Ctrl-C.

    FILE is the output of candump, or an ASC, BLF, CSV or TRC file. Identifiers and mappings are
    those of the EDS files; changes by a master are not taken into account. Times are in s, from
    the first frame on. From a file, frames that are not CANopen are shown, too.
    """
    with plain_errors(ValueError):
        text = FrameText(_nodes(eds_files))
        first: int | None = None
        if file is None:
            shown = ((time, f"{frame.can_id:03X}", text.of(frame)) for time, frame in _live(bus))
        else:
            messages = read_messages(file, _on_cut)
            shown = ((time, _identifier(m), text.of_message(m)) for time, m in messages)
        for time, identifier, meant in shown:
            first = time if first is None else first
            click.echo(f"{(time - first) * 1e-6:12.6f}  {identifier}  {one_line(meant)}")
    if file is not None and first is None:
        click.echo(f"{file} has no frames", err=True)


def _identifier(message: can.Message) -> str:
    return f"{message.arbitration_id:0{8 if message.is_extended_id else 3}X}"


def _on_cut(line: str) -> None:
    click.echo(one_line(line), err=True)


def _nodes(eds_files: dict[int, Path]) -> Iterator[tuple[str, ObjectDictionary]]:
    for node_id, name in _PACKAGED.items():
        if node_id not in eds_files:
            yield Path(name).stem, load_eds(read_eds(name), node_id)
    for node_id, path in eds_files.items():
        yield path.stem, load_file(path, node_id)


def _live(bus: BusChoice) -> Iterator[tuple[int, Frame]]:
    """Yield the frames of a bus with the time of reception, until a signal comes."""
    frames: deque[Frame] = deque()
    with stop_on_signals() as stop, closing(bus.open()) as connection:
        while not stop():
            connection.wait(_WAIT_S)
            connection.read(frames)
            time = monotonic_ns() // 1000
            while frames:
                yield time, frames.popleft()

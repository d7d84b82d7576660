"""Scripted devices with one deviation each, and the cases of the suite that each must fail.

Each is the device of this package with its frames altered on their way, or judged by an EDS that
is not its own. None stands for a stack. Tests examine a device by the cases that are named here;
`tools/pages/make conformance` examines it by all, and lists the others that it fails, and why.
"""

from collections.abc import Callable, Iterator
from typing import Final, NamedTuple

from altered_device import (
    EMCY,
    HEARTBEAT,
    NODE_ID,
    SDO,
    TPDO,
    Change,
    alter,
    drop,
    is_frame,
    judge,
    twice,
)
from rich_eds import RICH, changed, without

from smarttac_can.canopen.conformance.case import Result
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.od.cia import AbortCode, NMTCommand

REQUEST, RPDO, SYNC = 0x620, 0x220, 0x80


class Fault(NamedTuple):
    """One deviation."""

    fails: str
    """Cases that it must fail: those whose rule it breaks."""
    outwards: Change | None = None
    inwards: Change | None = None
    text: str = RICH
    """EDS of which the device is."""
    sheet: str = RICH
    """EDS by which it is judged."""

    def judge(self, only: str) -> list[Result]:
        """Return the results of some cases."""
        return judge(
            outwards=self.outwards,
            inwards=self.inwards,
            text=self.text,
            sheet=self.sheet,
            only=only,
        )


# Frames of SDO.


def place(index: int, subindex: int = 0) -> bytes:
    """Multiplexer of an entry."""
    return index.to_bytes(2, "little") + bytes((subindex,))


def writes(*places: bytes) -> Callable[[Frame], bool]:
    """Whether a frame writes one of some entries by an expedited download."""
    return lambda f: f.can_id == REQUEST and f.data[:1] >= b"\x22" and f.data[:1] < b"\x30" and (
        f.data[1:4] in places
    )  # fmt: skip


def reads(where: bytes) -> Callable[[Frame], bool]:
    """Whether a frame answers a read of an entry with its value."""
    return lambda f: f.can_id == SDO and f.data[0] >> 5 == 2 and f.data[1:4] == where


def keeps(value: int, *places: bytes, instead_of: int | None = None) -> Change:
    """Have entries written with one value, whatever the request says or if it says another."""
    old = None if instead_of is None else instead_of.to_bytes(4, "little")
    wanted = writes(*places)
    return alter(
        lambda f: wanted(f) and old in (None, f.data[4:]),
        lambda data: data[:4] + value.to_bytes(4, "little"),
    )


def says(value: int, where: bytes) -> Change:
    """Read one value of an entry, whatever it is."""
    return alter(reads(where), lambda data: data[:4] + value.to_bytes(4, "little"))


def is_command(*commands: int) -> Callable[[Frame], bool]:
    """Whether a frame is an NMT command."""
    return lambda f: f.can_id == 0 and f.data[:1] in [bytes((command,)) for command in commands]


def write(where: bytes, value: int, size: int) -> Frame:
    """Request that writes an entry; its answer is one that no case waits for."""
    command = bytes((0x23 | (4 - size) << 2,))
    return Frame(REQUEST, command + where + value.to_bytes(4, "little"))


def before(wanted: Callable[[Frame], bool], *first: Frame) -> Change:
    """Receive frames before each one that is wanted."""

    def change(frame: Frame) -> Iterator[Frame]:
        if wanted(frame):
            yield from first
        yield frame

    return change


def after(wanted: Callable[[Frame], bool], *then: Frame) -> Change:
    """Receive frames after each one that is wanted."""

    def change(frame: Frame) -> Iterator[Frame]:
        yield frame
        if wanted(frame):
            yield from then

    return change


def confirms(*codes: AbortCode) -> Change:
    """Confirm what these abort codes refuse."""
    refused = [code.to_bytes(4, "little") for code in codes]
    return alter(
        lambda f: f.can_id == SDO and f.data[0] == 0x80 and f.data[4:] in refused,
        lambda data: b"\x60" + data[1:4] + bytes(4),
    )


def under_another_id(wanted: Callable[[Frame], bool], can_id: int) -> Change:
    """Send frames under another CAN-ID."""

    def change(frame: Frame) -> Iterator[Frame]:
        yield frame._replace(can_id=can_id) if wanted(frame) else frame

    return change


GUARD_TIME, LIFE_TIME_FACTOR = place(0x100C), place(0x100D)
PRODUCER_TIME = place(0x1017)
REMOTE_TYPE = place(0x1804, 2)
"""Transmission type of the first TPDO that allows remote frames."""
REMOTE = Frame(HEARTBEAT, b"", rtr=True)
_RESETS = is_command(NMTCommand.RESET_NODE, NMTCommand.RESET_COMMUNICATION)


class Written:
    """The last frame that wrote an entry; None after a reset."""

    def __init__(self, where: bytes) -> None:
        self._writes = writes(where)
        self.frame: Frame | None = None

    def note(self, frame: Frame) -> None:
        if self._writes(frame):
            self.frame = frame
        elif _RESETS(frame):
            self.frame = None

    def __bool__(self) -> bool:
        return self.frame is not None and any(self.frame.data[4:])


def answers_under_heartbeat() -> Change:
    """Stop the heartbeat to answer a remote frame twice, as the first answer has toggle bit 0."""
    written = Written(PRODUCER_TIME)

    def change(frame: Frame) -> Iterator[Frame]:
        written.note(frame)
        if frame == REMOTE and written and written.frame is not None:
            yield from (write(PRODUCER_TIME, 0, 2), frame, frame, written.frame)
        else:
            yield frame

    return change


def no_answer_by_types(*types: int) -> Change:
    """Drop remote frames to a TPDO of some transmission types."""
    written = Written(REMOTE_TYPE)

    def change(frame: Frame) -> Iterator[Frame]:
        written.note(frame)
        of_type = written.frame is not None and written.frame.data[4] in types
        if not (frame.rtr and frame.can_id != HEARTBEAT and of_type):
            yield frame

    return change


def no_heartbeat_under_life_guarding() -> Change:
    """Keep the producer time at 0 while there is a guard time."""
    written = Written(GUARD_TIME)

    def change(frame: Frame) -> Iterator[Frame]:
        written.note(frame)
        off = written and writes(PRODUCER_TIME)(frame)
        yield write(PRODUCER_TIME, 0, 2) if off else frame

    return change


def guard_time_survives_reset_communication() -> Change:
    """Write the guard time again after a reset of communication."""
    written = Written(GUARD_TIME)

    def change(frame: Frame) -> Iterator[Frame]:
        kept = written.frame
        written.note(frame)
        yield frame
        if kept is not None and is_command(NMTCommand.RESET_COMMUNICATION)(frame):
            yield kept

    return change


def blocked_by_open_transfer() -> tuple[Change, Change]:
    """Drop requests that do not continue or abort the segmented upload that is open."""
    opened = False

    def outwards(frame: Frame) -> Iterator[Frame]:
        nonlocal opened
        if frame.can_id == SDO:
            if opened and frame.data[4:] == AbortCode.TIME_OUT.to_bytes(4, "little"):
                return
            last = frame.data[0] >> 5 == 0 and frame.data[0] & 1
            opened = frame.data[0] == 0x41 or (opened and not last and frame.data[0] != 0x80)
        yield frame

    def inwards(frame: Frame) -> Iterator[Frame]:
        nonlocal opened
        if frame.can_id == REQUEST and frame.data[:1] == b"\x80":
            opened = False
        if not opened or frame.can_id != REQUEST or frame.data[0] >> 5 == 3:
            yield frame

    return outwards, inwards


def cuts_fifth_byte(frame: Frame) -> Iterator[Frame]:
    """Take four bytes of a segmented download of five."""
    if frame.can_id == REQUEST and frame.data[:1] == b"\x21" and frame.data[4] == 5:
        frame = frame._replace(data=frame.data[:4] + b"\x04" + frame.data[5:])
    elif frame.can_id == REQUEST and frame.data[:1] == b"\x05":
        frame = frame._replace(data=b"\x07" + frame.data[1:5] + bytes(3))
    yield frame


def event_timer_0_is_a_time(frame: Frame) -> Iterator[Frame]:
    """Send a TPDO every 100 ms by event timer 0, whatever its transmission type."""
    if writes(place(0x1800, 5))(frame) and not any(frame.data[4:]):
        yield write(place(0x1800, 5), 100, 2)
        yield write(place(0x1800, 2), 255, 1)
    else:
        yield frame


def _swap_states(data: bytes) -> bytes:
    return bytes(({5: 0x7F, 0x7F: 5}.get(data[0], data[0]),))


def _as_command(command: int, instead: int) -> Change:
    return alter(is_command(command), lambda data: bytes((instead,)) + data[1:])


NODE = bytes((NODE_ID,))
START = is_command(NMTCommand.START)

FAULTS: Final[dict[str, Fault]] = {
    # EDS and object dictionary.
    "EDS without a mandatory object": Fault("EDS-01", sheet=without("1001")),
    "object missing": Fault("OD-01", text=without("2115")),
    "another data type": Fault("OD-02", text=changed("2115", "DataType=0x0007")),
    "another default": Fault("OD-03", text=changed("1029sub1", "DefaultValue=1")),
    "read-only entry takes values": Fault("OD-04", text=changed("2111", "AccessType=rw")),
    "write-only entry is readable": Fault("OD-05", text=changed("2112", "AccessType=rw")),
    "value out of range confirmed": Fault(
        "OD-06 EMCY-04 SYNC-03 SYNC-08 OTHER-09 PDO-15 PDO-29",
        confirms(AbortCode.VALUE, AbortCode.TOO_HIGH, AbortCode.TOO_LOW),
    ),
    "own value refused": Fault(
        "OD-07",
        alter(
            lambda f: f.data[:4] == b"\x60" + place(0x2110),
            lambda data: b"\x80" + data[1:4] + AbortCode.VALUE.to_bytes(4, "little"),
        ),
    ),
    "sub-index 0 too high": Fault("OD-08", says(5, place(0x1018))),
    "sub-index FFh says VAR of every object": Fault(
        "OD-09",
        alter(
            lambda f: f.can_id == SDO and f.data[0] == 0x43 and f.data[3] == 0xFF,
            lambda data: data[:4] + b"\x07" + data[5:],
        ),
    ),
    # SDO.
    "expedited answer without its size": Fault(
        "SDO-01", alter(is_frame(SDO, first=0x43), lambda data: b"\x42" + data[1:])
    ),
    "SDO data wrong": Fault(
        "SDO-02 OD-03 OTHER-01",
        alter(is_frame(SDO, first=0x43), lambda data: data[:4] + bytes((data[4] ^ 1,)) + data[5:]),
    ),
    "write without a size taken as one byte": Fault(
        "SDO-03", inwards=alter(is_frame(REQUEST, first=0x22), lambda data: b"\x2f" + data[1:])
    ),
    "toggle of upload segments stays 0": Fault(
        "SDO-04",
        alter(
            lambda f: f.can_id == SDO and f.data[0] >> 5 == 0,
            lambda data: bytes((data[0] & 0xEF,)) + data[1:],
        ),
    ),
    "toggle of download segments starts with 1": Fault(
        "SDO-05 SDO-06",
        alter(
            lambda f: f.can_id == SDO and f.data[0] >> 5 == 1,
            lambda data: bytes((data[0] ^ 0x10,)) + data[1:],
        ),
    ),
    "no segmented write without a size": Fault(
        "SDO-06", inwards=alter(is_frame(REQUEST, first=0x20), lambda data: b"\xe0" + data[1:])
    ),
    "toggle of the client's segments not looked at": Fault(
        "SDO-07",
        inwards=alter(is_frame(REQUEST, first=0x70), lambda data: b"\x60" + data[1:]),
    ),
    "wrong toggle confirmed": Fault("SDO-07 SDO-08", confirms(AbortCode.TOGGLE)),
    "unknown command confirmed": Fault("SDO-09 SDO-10", confirms(AbortCode.COMMAND)),
    "the client's abort ignored": Fault("SDO-11", inwards=drop(is_frame(REQUEST, first=0x80))),
    "transfer left behind blocks the server": Fault("SDO-12", *blocked_by_open_transfer()),
    "time-out of a transfer confirmed": Fault("SDO-13", confirms(AbortCode.TIME_OUT)),
    "object that does not exist confirmed": Fault("SDO-14", confirms(AbortCode.NO_OBJECT)),
    "sub-index that does not exist confirmed": Fault("SDO-15", confirms(AbortCode.NO_SUBINDEX)),
    "write to read-only entries confirmed": Fault("SDO-16 OD-04", confirms(AbortCode.READ_ONLY)),
    "read of write-only entries confirmed": Fault("SDO-17 OD-05", confirms(AbortCode.WRITE_ONLY)),
    "fifth byte cut off": Fault("SDO-18", inwards=cuts_fifth_byte),
    "too few bytes confirmed": Fault("SDO-19 SDO-20", confirms(AbortCode.TOO_SHORT)),
    "short SDO frames filled with zeros": Fault(
        "SDO-21",
        inwards=alter(
            lambda f: f.can_id == REQUEST and not f.rtr and len(f.data) < 8,
            lambda data: data.ljust(8, b"\0"),
        ),
    ),
    "abort without multiplexer": Fault(
        "SDO-22", alter(is_frame(SDO, first=0x80), lambda data: data[:1] + bytes(3) + data[4:])
    ),
    "wrong CRC": Fault(
        "SDO-23",
        alter(
            lambda f: f.can_id == SDO and f.data[0] & 0xE3 == 0xC1 and any(f.data[1:3]),
            lambda data: data[:1] + bytes((data[1] ^ 1,)) + data[2:],
        ),
    ),
    "CRC in a block upload of a client without CRC": Fault(
        "SDO-24", inwards=alter(is_frame(REQUEST, first=0xA0), lambda data: b"\xa4" + data[1:])
    ),
    "block acknowledged short": Fault(
        "SDO-25 SDO-26 SDO-27",
        alter(
            lambda f: f.can_id == SDO and f.data[0] & 0xE3 == 0xA2,
            lambda data: data[:1] + bytes((max(0, data[1] - 1),)) + data[2:],
        ),
    ),
    "lost segment acknowledged": Fault(
        "SDO-27", alter(is_frame(SDO, first=0xA2), lambda data: b"\xa2\x01" + data[2:])
    ),
    "block with a wrong CRC confirmed": Fault("SDO-28", confirms(AbortCode.CRC)),
    "block size 128 confirmed": Fault("SDO-29", confirms(AbortCode.BLOCK_SIZE)),
    "sequence number 128 confirmed": Fault("SDO-30", confirms(AbortCode.SEQUENCE)),
    # PDO.
    "TPDO too short": Fault("PDO-01", alter(is_frame(TPDO), lambda data: data[:-1])),
    "no TPDO": Fault(
        "PDO-01 PDO-02 PDO-03 PDO-09 PDO-13 PDO-19 SYNC-01 STATE-03", drop(is_frame(TPDO))
    ),
    "TPDO twice": Fault("PDO-03 PDO-09 PDO-11 SYNC-02", twice(TPDO)),
    "type 0 is type 1": Fault("PDO-04", inwards=keeps(1, place(0x1800, 2), instead_of=0)),
    "type 252 is type 1": Fault("PDO-05", inwards=keeps(1, REMOTE_TYPE, instead_of=252)),
    "type 253 not answered": Fault("PDO-06", inwards=no_answer_by_types(253)),
    "types 254 and 255 not answered": Fault("PDO-07", inwards=no_answer_by_types(254, 255)),
    "bit 30 of a TPDO's COB-ID not looked at": Fault(
        "PDO-08",
        inwards=alter(writes(place(0x1800, 1)), lambda data: data[:7] + bytes((data[7] & ~0x40,))),
    ),
    "event timer not looked at": Fault("PDO-09", inwards=keeps(0, place(0x1800, 5))),
    "event timer 0 is a time": Fault("PDO-10", inwards=event_timer_0_is_a_time),
    "inhibit time not looked at": Fault("PDO-11", inwards=keeps(0, place(0x1800, 3))),
    "SYNC start value not looked at": Fault("PDO-13", inwards=keeps(0, place(0x1800, 6))),
    "parameter of a valid object taken": Fault(
        "PDO-12 PDO-14 PDO-17 EMCY-05 SYNC-05", confirms(AbortCode.STATE)
    ),
    "start makes TPDOs valid": Fault(
        "PDO-16", inwards=before(START, write(place(0x1800, 1), TPDO, 4))
    ),
    "TPDO keeps its default CAN-ID": Fault(
        "PDO-18", under_another_id(lambda f: 0x180 <= f.can_id < 0x200, TPDO)
    ),
    "no RPDO": Fault("PDO-20 PDO-21 PDO-24 PDO-25", inwards=drop(is_frame(RPDO))),
    "synchronous RPDO taken at once": Fault(
        "PDO-21", inwards=keeps(255, place(0x1400, 2), instead_of=1)
    ),
    "PRE-OPERATIONAL is OPERATIONAL": Fault("PDO-22 STATE-02", inwards=_as_command(0x80, 0x01)),
    "start makes RPDOs valid": Fault(
        "PDO-23", inwards=before(START, write(place(0x1400, 1), RPDO, 4))
    ),
    "short RPDO filled with zeros": Fault(
        "PDO-24", inwards=alter(is_frame(RPDO), lambda data: data.ljust(8, b"\0"))
    ),
    "RPDO deadline not looked at": Fault("PDO-25", inwards=keeps(0, place(0x1400, 5))),
    "another default mapping": Fault("PDO-26", text=changed("1A00sub0", "DefaultValue=1")),
    "TPDO keeps its default length": Fault(
        "PDO-27", alter(is_frame(TPDO), lambda data: data.ljust(7, b"\0"))
    ),
    "mapping without the procedure confirmed": Fault("PDO-28", confirms(AbortCode.ACCESS)),
    "mapping that is too long confirmed": Fault("PDO-30", confirms(AbortCode.PDO_LENGTH)),
    "mapping of any entry confirmed": Fault(
        "PDO-31 PDO-32 PDO-33", confirms(AbortCode.NOT_MAPPABLE)
    ),
    # EMCY.
    "no EMCY": Fault("EMCY-01 EMCY-02 GUARD-04 HB-06 SYNC-10 PDO-24 PDO-25", drop(is_frame(EMCY))),
    "EMCY twice": Fault("EMCY-01", twice(EMCY)),
    "EMCY without register": Fault(
        "EMCY-01", alter(is_frame(EMCY), lambda data: data[:2] + b"\0" + data[3:])
    ),
    "EMCY without error reset": Fault(
        "EMCY-02", drop(lambda f: f.can_id == EMCY and f.data[:2] == b"\0\0")
    ),
    "history without error codes": Fault("EMCY-03", says(0x11, place(0x1003, 1))),
    "history does not count": Fault("EMCY-03", says(0, place(0x1003))),
    "another CAN-ID of EMCY": Fault("EMCY-05", text=changed("1014", "DefaultValue=$NODEID+0x90")),
    "inhibit time of EMCY not looked at": Fault("EMCY-06", inwards=keeps(0, place(0x1015))),
    # SYNC.
    "SYNC not received": Fault("PDO-02 PDO-21 SYNC-01", inwards=drop(is_frame(SYNC))),
    "SYNC not produced": Fault("SYNC-04 SYNC-06 SYNC-07", drop(is_frame(SYNC))),
    "SYNC counter stays 0": Fault(
        "SYNC-07", alter(lambda f: f.can_id == SYNC and len(f.data) == 1, lambda _: b"\0")
    ),
    "synchronous window not taken": Fault("SYNC-09", inwards=keeps(0, place(0x1007))),
    "SYNC of any length taken": Fault("SYNC-10", inwards=alter(is_frame(SYNC), lambda _: b"")),
    # Error control.
    "remote frames not answered": Fault("GUARD-01", inwards=drop(lambda f: f.rtr)),
    "toggle bit of guarding stays 0": Fault(
        "GUARD-02", alter(is_frame(HEARTBEAT), lambda data: bytes((data[0] & 0x7F,)))
    ),
    "wrong states": Fault(
        "GUARD-03 HB-04 STATE-02 TRANS-01", alter(is_frame(HEARTBEAT), _swap_states)
    ),
    "life guarding starts without a remote frame": Fault(
        "GUARD-05", inwards=after(writes(LIFE_TIME_FACTOR), REMOTE)
    ),
    "toggle bit survives reset communication": Fault(
        "GUARD-06", inwards=after(is_command(NMTCommand.RESET_COMMUNICATION), REMOTE)
    ),
    "no boot-up": Fault("HB-01 BOTH-05 TRANS-03 TRANS-04", drop(is_frame(HEARTBEAT, first=0))),
    "another heartbeat": Fault("HB-02", text=changed("1017", "DefaultValue=500")),
    "heartbeat twice": Fault("HB-03 HB-04 HB-05 BOTH-02 BOTH-03 BOTH-05 BOTH-07", twice(HEARTBEAT)),
    "two heartbeat consumers of one node": Fault("HB-07", confirms(AbortCode.PARAMETER)),
    "guarding answered during heartbeat": Fault("BOTH-01", inwards=answers_under_heartbeat()),
    "no heartbeat during life guarding": Fault(
        "BOTH-04", inwards=no_heartbeat_under_life_guarding()
    ),
    "boot-up twice": Fault("BOTH-05", twice(HEARTBEAT)),
    "guard time survives reset communication": Fault(
        "BOTH-06", inwards=guard_time_survives_reset_communication()
    ),
    # Identity, storage, error behaviour.
    "another vendor-ID": Fault("OTHER-01", text=changed("1018sub1", "DefaultValue=0x00000124")),
    "error register never 0": Fault("OTHER-02", says(0x11, place(0x1001))),
    "another name": Fault("OTHER-03", text=changed("1008", "DefaultValue=Something else")),
    "wrong signature confirmed": Fault("OTHER-04 OTHER-06", confirms(AbortCode.STORE)),
    "stored values lost in a reset": Fault(
        "OTHER-05",
        inwards=before(
            is_command(NMTCommand.RESET_NODE),
            write(place(0x1011, 1), int.from_bytes(b"load", "little"), 4),
        ),
    ),
    "defaults not restored": Fault(
        "OTHER-07",
        inwards=after(
            writes(place(0x1011, 1)),
            write(place(0x1010, 1), int.from_bytes(b"save", "little"), 4),
        ),
    ),
    "time of the configuration not kept": Fault("OTHER-08", inwards=keeps(0, place(0x1020, 2))),
    "error behaviour not looked at": Fault("OTHER-10", inwards=keeps(0, place(0x1029, 1))),
    # NMT.
    "starts by itself": Fault("STATE-01", inwards=after(_RESETS, Frame(0, b"\x01" + NODE))),
    "STOPPED is PRE-OPERATIONAL": Fault(
        "STATE-04 TRANS-01 BOTH-07", inwards=_as_command(0x02, 0x80)
    ),
    "commands for all not taken": Fault(
        "TRANS-02", inwards=drop(lambda f: f.can_id == 0 and f.data[1:] == b"\0")
    ),
    "commands for others taken": Fault(
        "TRANS-02",
        inwards=alter(lambda f: f.can_id == 0 and len(f.data) == 2, lambda data: data[:1] + b"\0"),
    ),
    "reset communication is reset node": Fault("TRANS-03", inwards=_as_command(0x82, 0x81)),
    "reset node is reset communication": Fault("TRANS-04", inwards=_as_command(0x81, 0x82)),
}

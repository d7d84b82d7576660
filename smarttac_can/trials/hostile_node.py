"""A third node that sends anything to anybody, at random."""

from __future__ import annotations

import random
from collections.abc import Callable
from typing import Final

from smarttac_can.bench.simulation import PLATE_ID, STIMULATOR_ID
from smarttac_can.device.frame import Frame
from smarttac_can.master import requests
from smarttac_can.od.cia import (
    EMCY_ID,
    EXPEDITED_BYTES,
    FRAME_BYTES,
    HEARTBEAT_ID,
    LAST_NODE_ID,
    NMT_ID,
    RPDO_IDS,
    SDO_RX_ID,
    SDO_TX_ID,
    SYNC_ID,
    TPDO_IDS,
    NMTCommand,
)
from smarttac_can.od.entry import Entry
from smarttac_can.trials.rig import Rig
from smarttac_can.vocabulary.modes import Mode
from smarttac_can.vocabulary.states import Control

CALM: Final = {
    "SDO read": 300,
    "SDO write": 80,
    "SDO, badly formed": 250,
    "set-point PDO": 30,
    "PDO of others": 120,
    "garbage": 120,
    "extended identifier": 60,
    "remote frame": 60,
    "heartbeat": 20,
    "EMCY": 15,
    "SYNC": 8,
    "NMT or controlword": 10,
}
"""What is sent outside of bursts: how often, beside the others."""
OWN: Final = "identifier of the pair"
"""What a burst sends: any frame with an identifier that only one of the two nodes sends with."""

_PAIR: Final = (STIMULATOR_ID, PLATE_ID)
_OWN_IDS: Final = (
    *(base + node for base in (EMCY_ID, *TPDO_IDS, SDO_TX_ID, HEARTBEAT_ID) for node in _PAIR),
    RPDO_IDS[0] + PLATE_ID,
)
_COMMAND_IDS: Final = (NMT_ID, RPDO_IDS[0] + STIMULATOR_ID)
_SDO_IDS: Final = tuple(SDO_RX_ID + node for node in _PAIR)
_SETPOINT_IDS: Final = tuple(base + STIMULATOR_ID for base in RPDO_IDS[1:])
_SPARED: Final = ("Simulation", "Fault", "Controlword")
"""Records that no SDO writes; the controlword has its place among the commands."""
_LAST_ID: Final = 0x7FF
_LAST_EXTENDED_ID: Final = 0x1FFF_FFFF
_NMT_COMMANDS: Final = tuple(c for c in NMTCommand if c is not NMTCommand.ENTER_PRE_OPERATIONAL)
_CONTROLWORDS: Final = tuple(range(Control.ARM | Control.RUN | Control.QUICK_STOP | 1))
"""None with the bit of the fault reset."""


class HostileNode:
    """Sends frames at random, of every kind that there is.

    Parameters
    ----------
    rig
        Its pair of nodes is attacked.
    draw
        Of all that is sent.

    Notes
    -----
    It sends no 80h, neither as an NMT command nor as a controlword: pre-operational is the master's
    to ask for, and so is the reset of a fault. It does not write to ``Simulation`` and ``Fault``,
    which no real plate has.
    """

    def __init__(self, rig: Rig, draw: random.Random) -> None:
        self._draw = draw
        self._port = rig.bus.connect(lambda _frame: None)
        self._entries = [
            (node, entry)
            for node, od in zip(_PAIR, (rig.od, rig.plate.od), strict=True)
            for entry in od
        ]
        self._writable = [
            (node, entry)
            for node, entry in self._entries
            if entry.writable and 0 < entry.size <= EXPEDITED_BYTES and not _spared(entry)
        ]
        spared = {entry.index for _, entry in self._entries if _spared(entry)}
        self._spared = {index.to_bytes(2, "little") for index in spared}
        self._makers: dict[str, Callable[[], Frame]] = {
            "SDO read": self._read,
            "SDO write": self._write,
            "SDO, badly formed": self._bad_sdo,
            "set-point PDO": lambda: Frame(self._draw.choice(_SETPOINT_IDS), self._bytes()),
            "PDO of others": self._pdo,
            "garbage": self._garbage,
            "extended identifier": self._extended,
            "remote frame": lambda: Frame(self._draw.randrange(_LAST_ID + 1), rtr=True),
            "heartbeat": lambda: Frame(self._of_others(HEARTBEAT_ID), self._bytes(1)),
            "EMCY": lambda: Frame(self._of_others(EMCY_ID), self._bytes(FRAME_BYTES)),
            "SYNC": lambda: Frame(SYNC_ID, self._bytes(self._draw.randrange(2))),
            "NMT or controlword": self._command,
            OWN: lambda: Frame(self._draw.choice(_OWN_IDS), self._bytes()),
        }
        self._calm = list(CALM), list(CALM.values())

    def act(self, *, own: bool) -> tuple[str, Frame]:
        """Send a frame; tell what it was.

        Parameters
        ----------
        own
            Whether with an identifier that one of the pair sends with.
        """
        kind = OWN if own else self._draw.choices(*self._calm)[0]
        frame = self._makers[kind]()
        self._port.send(frame)
        return kind, frame

    def _bytes(self, length: int | None = None) -> bytes:
        """Return random bytes, of a random length if none is given."""
        return self._draw.randbytes(
            self._draw.randint(0, FRAME_BYTES) if length is None else length
        )

    def _of_others(self, base: int) -> int:
        node = self._draw.choice([n for n in range(1, LAST_NODE_ID + 1) if n not in _PAIR])
        return base + node

    def _pdo(self) -> Frame:
        return Frame(self._of_others(self._draw.choice(TPDO_IDS + RPDO_IDS)), self._bytes())

    def _garbage(self) -> Frame:
        can_id = SYNC_ID
        while can_id in (*_OWN_IDS, *_COMMAND_IDS, *_SDO_IDS, SYNC_ID):
            can_id = self._draw.randrange(_LAST_ID + 1)
        return Frame(can_id, self._bytes())

    def _extended(self) -> Frame:
        can_id = self._draw.randint(_LAST_ID + 1, _LAST_EXTENDED_ID)
        return Frame(can_id, self._bytes(), self._draw.choice((False, True)))

    def _command(self) -> Frame:
        draw = self._draw
        if draw.choice((False, True)):
            node = draw.choice((0, *_PAIR, draw.randrange(256)))
            return requests.nmt(draw.choice(_NMT_COMMANDS), node)
        word = draw.choice(_CONTROLWORDS)
        return Frame(_COMMAND_IDS[1], bytes((word, 0, draw.choice(tuple(Mode)))))

    def _read(self) -> Frame:
        return requests.upload(*self._draw.choice(self._entries))

    def _write(self) -> Frame:
        node, entry = self._draw.choice(self._writable)
        return requests.download(node, entry, self._value(entry))

    def _value(self, entry: Entry) -> int | float:
        """Draw a value that the entry takes, its limits and what it holds among them."""
        draw = self._draw
        if not isinstance(entry.default, int):
            return draw.uniform(-1.0, 1.0)
        low, high = int(entry.low), int(entry.high)
        return draw.choice((low, high, int(entry.read()), draw.randint(low, high)))

    def _bad_sdo(self) -> Frame:
        """Make a request that is none, or not the next one of a transfer."""
        draw = self._draw
        can_id = draw.choice(_SDO_IDS)
        length = draw.choice((FRAME_BYTES, FRAME_BYTES, FRAME_BYTES, draw.randrange(FRAME_BYTES)))
        data = self._bytes(length)
        if length == FRAME_BYTES and draw.choice((False, True, True)):
            # Any command with an object that is there: sizes, segments and blocks that do not fit.
            _, entry = draw.choice(self._entries)
            address = entry.index.to_bytes(2, "little") + bytes((entry.subindex,))
            data = data[:1] + address + data[4:]
        if data[1:3] in self._spared:
            data = data[:1]
        return Frame(can_id, data)


def _spared(entry: Entry) -> bool:
    return entry.name.partition(".")[0] in _SPARED

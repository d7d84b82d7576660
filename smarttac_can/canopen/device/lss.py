"""Layer setting services, slave side (CiA 305): set node-ID and bit timing of an unknown device."""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar, Final

from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.device.nmt import NMTState
from smarttac_can.canopen.device.port import Port
from smarttac_can.canopen.device.service import Service
from smarttac_can.canopen.device.storage import UNCHANGED, ParameterStorage
from smarttac_can.canopen.od import cia
from smarttac_can.canopen.od.cia import Abort
from smarttac_can.canopen.od.dictionary import ObjectDictionary

BIT_RATES: Final = {0: 1000, 1: 800, 2: 500, 3: 250, 4: 125, 6: 50, 7: 20, 8: 10}
"""Bit rate in kbit/s by index into the table of CiA 305."""

# Command specifiers.
SWITCH_GLOBAL: Final = 0x04
CONFIGURE_NODE_ID: Final = 0x11
CONFIGURE_BIT_TIMING: Final = 0x13
ACTIVATE_BIT_TIMING: Final = 0x15
STORE: Final = 0x17
SWITCH_SELECTIVE: Final = range(0x40, 0x44)
SWITCHED: Final = 0x44
IDENTIFY: Final = range(0x46, 0x4C)
IDENTIFY_UNCONFIGURED: Final = 0x4C
IDENTIFIED: Final = 0x4F
UNCONFIGURED_IDENTIFIED: Final = 0x50
FASTSCAN: Final = 0x51
INQUIRE_IDENTITY: Final = range(0x5A, 0x5E)
INQUIRE_NODE_ID: Final = 0x5E

_PARTS: Final = ("vendor-ID", "product code", "revision number", "serial number")
LSS_NAMES: Final = {
    SWITCH_GLOBAL: "switch state global",
    CONFIGURE_NODE_ID: "configure node-ID",
    CONFIGURE_BIT_TIMING: "configure bit timing",
    ACTIVATE_BIT_TIMING: "activate bit timing",
    STORE: "store configuration",
    **{
        command: f"switch state selective, {part}"
        for command, part in zip(SWITCH_SELECTIVE, _PARTS, strict=True)
    },
    SWITCHED: "selected",
    **dict.fromkeys(IDENTIFY, "identify remote slave"),
    IDENTIFY_UNCONFIGURED: "identify non-configured remote slave",
    IDENTIFIED: "slave identified",
    UNCONFIGURED_IDENTIFIED: "non-configured slave identified",
    FASTSCAN: "fastscan",
    **{command: f"inquire {part}" for command, part in zip(INQUIRE_IDENTITY, _PARTS, strict=True)},
    INQUIRE_NODE_ID: "inquire node-ID",
}
"""Names of the commands of LSS, requests and answers, by their first byte."""

_OUT_OF_RANGE: Final = 1
_STORAGE_FAILED: Final = 2
_FASTSCAN_START: Final = 0x80
# The identity has four numbers of 32 bits.
_LAST_BIT: Final = 31
_LAST_PART: Final = 3
# Index into the identity and comparison, for the parts of switch selective and of identify remote
# slave: vendor, product, revision and serial number, of the last two the lowest and the highest.
_SELECTION: Final = ((0, 0), (1, 0), (2, 0), (3, 0))
_LIMITS: Final = ((0, 0), (1, 0), (2, 1), (2, -1), (3, 1), (3, -1))


class LSS(Service):
    """LSS slave. The master selects it by its identity, or finds it by fastscan.

    A new node-ID takes effect at the next NMT reset. A device without node-ID starts as soon as the
    master switches all slaves back to the waiting state.

    Parameters
    ----------
    storage
        Storage of the node-ID and the bit timing.
    on_configured
        Function that is called when a device without node-ID has received one.

    Attributes
    ----------
    node_id
        Active node-ID; 255 while the device has none.
    pending
        Node-ID after the next reset.
    bit_rate
        Bit rate in kbit/s that the master has activated; None before. The host has to switch it.
    """

    states: ClassVar = frozenset(
        {NMTState.INITIALISING, NMTState.PRE_OPERATIONAL, NMTState.STOPPED}
    )

    def __init__(
        self,
        port: Port,
        od: ObjectDictionary,
        storage: ParameterStorage,
        on_configured: Callable[[], None],
    ) -> None:
        super().__init__(port, od, ())
        self._storage = storage
        self._on_configured = on_configured
        self.bit_rate: int | None = None
        self.supported = od.info.get("lss_supported", "0") not in ("0", "")
        self.node_id = self.pending = od.node_id
        self._bit_timing = UNCHANGED
        self._identity = tuple(od.number(cia.IDENTITY, subindex) for subindex in range(1, 5))
        self._rates = {
            index
            for index, rate in BIT_RATES.items()
            if od.info.get(f"baudrate_{rate}", "0") not in ("0", "")
        }
        self._configuring = False
        self._selected = 0
        self._identified = 0
        self._scanned = 0

    def load(self, node_id: int) -> None:
        """Set the node-ID after the next reset, 255 for none, and load the stored bit timing."""
        self.pending = node_id
        self._bit_timing = self._storage.image.bit_timing

    def cease(self) -> None:
        """Return to the waiting state: the device is not selected for configuration."""
        self._configuring = False
        self._selected = self._identified = self._scanned = 0

    def listen(self) -> None:
        """Listen to the LSS master, if the EDS states that the device supports LSS."""
        if self.supported:
            self.port.listen(cia.LSS_MASTER_ID, self.receive)

    def receive(self, frame: Frame) -> None:
        """Take a command; an unknown command is not answered."""
        data = frame.data
        if len(data) != cia.FRAME_BYTES or frame.rtr:
            return
        command = data[0]
        number = int.from_bytes(data[1:5], "little")
        if command == SWITCH_GLOBAL:
            self._switch(data[1])
        elif command in SWITCH_SELECTIVE:
            self._select(command - SWITCH_SELECTIVE.start, number)
        elif command in IDENTIFY:
            self._identify(command - IDENTIFY.start, number)
        elif command == IDENTIFY_UNCONFIGURED:
            if self.node_id == self.pending == cia.UNCONFIGURED:
                self._answer(UNCONFIGURED_IDENTIFIED)
        elif command == FASTSCAN:
            self._fastscan(number, *data[5:8])
        elif self._configuring:
            self._configure(command, data)

    def _configure(self, command: int, data: bytes) -> None:
        if command == CONFIGURE_NODE_ID:
            valid = 1 <= data[1] <= cia.LAST_NODE_ID or data[1] == cia.UNCONFIGURED
            if valid:
                self.pending = data[1]
            self._answer(command, 0 if valid else _OUT_OF_RANGE)
        elif command == CONFIGURE_BIT_TIMING:
            valid = data[1] == 0 and data[2] in self._rates
            if valid:
                self._bit_timing = data[2]
            self._answer(command, 0 if valid else _OUT_OF_RANGE)
        elif command == ACTIVATE_BIT_TIMING:
            if self._bit_timing in BIT_RATES:
                self.bit_rate = BIT_RATES[self._bit_timing]
        elif command == STORE:
            try:
                self._storage.store_lss(self.pending, self._bit_timing)
            except (OSError, Abort):
                self._answer(command, _STORAGE_FAILED)
            else:
                self._answer(command, 0)
        elif command in INQUIRE_IDENTITY:
            value = self._identity[command - INQUIRE_IDENTITY.start]
            self._answer(command, *value.to_bytes(4, "little"))
        elif command == INQUIRE_NODE_ID:
            self._answer(command, self.node_id)

    def _switch(self, mode: int) -> None:
        if mode > 1:
            return
        self._configuring = bool(mode)
        self._selected = 0
        if not mode and self.node_id == cia.UNCONFIGURED != self.pending:
            self._on_configured()

    def _select(self, part: int, number: int) -> None:
        """Take one number of a selection; all four in order select the device."""
        self._selected = self._matched(_SELECTION, self._selected, part, number)
        if self._selected == len(_SELECTION):
            self._selected = 0
            self._configuring = True
            self._answer(SWITCHED)

    def _identify(self, part: int, number: int) -> None:
        """Take one number of an identification; answer after the last one if all match."""
        self._identified = self._matched(_LIMITS, self._identified, part, number)
        if self._identified == len(_LIMITS):
            self._identified = 0
            self._answer(IDENTIFIED)

    def _matched(
        self, parts: tuple[tuple[int, int], ...], before: int, part: int, number: int
    ) -> int:
        """Return how many parts have matched in order with this one; 0 if it does not match."""
        which, sign = parts[part]
        difference = self._identity[which] - number
        fits = difference * sign >= 0 if sign else not difference
        return part + 1 if fits and part in (0, before) else 0

    def _fastscan(self, number: int, bit: int, part: int, following: int) -> None:
        """Answer if this part of the identity equals ``number`` from ``bit`` upwards."""
        if self._configuring or not self.node_id == self.pending == cia.UNCONFIGURED:
            return
        if bit == _FASTSCAN_START:
            self._scanned = 0
            self._answer(IDENTIFIED)
            return
        if bit > _LAST_BIT or max(part, following) > _LAST_PART or part != self._scanned:
            return
        if (number ^ self._identity[part]) >> bit:
            return
        if bit == 0:
            self._scanned = following
            self._configuring = following < part
        self._answer(IDENTIFIED)

    def _answer(self, *data: int) -> None:
        self.port.out.append(Frame(cia.LSS_SLAVE_ID, bytes(data).ljust(8, b"\0")))

"""What a stimulator tells the bus unasked: drives, public TPDOs, and emergency messages."""

from __future__ import annotations

from typing import Final

from smarttac_can.device.device import Device
from smarttac_can.nodes.loop_frames import DRIVE_TPDO, LATCHED, sent_drive
from smarttac_can.nodes.supervisor import Supervisor
from smarttac_can.od.cia import EVENT_MANUFACTURER, PDO_TRANSMISSION, TPDO_COMMUNICATION
from smarttac_can.vocabulary.states import State
from smarttac_can.vocabulary.watchdogs import WATCHDOGS, watchdogs_in

_STATUS_TPDO: Final = 1
_MEASURED_TPDOS: Final = (2, 3, 4)


class Publishing:
    """The drive, the public TPDOs, and what was latched as emergency messages.

    TPDO 1 goes out when status or mode change, TPDO 2 to 4 in every cycle if their transmission
    type is 254; else they go out as their type says.

    Parameters
    ----------
    device
        That of the stimulator.
    supervisor
        Latches what is told.
    """

    def __init__(self, device: Device, supervisor: Supervisor) -> None:
        self._device = device
        self._supervisor = supervisor
        self._reported = 0
        self._drive = sent_drive(device.od)
        self._types = [
            (number, device.od.entry(TPDO_COMMUNICATION + number - 1, PDO_TRANSMISSION))
            for number in _MEASURED_TPDOS
        ]

    def cycle(self) -> None:
        """Publish what a cycle has changed."""
        trigger = self._device.trigger
        trigger(_STATUS_TPDO)
        for number, transmission in self._types:
            if transmission.value == EVENT_MANUFACTURER:
                trigger(number)

    def status(self) -> None:
        """Publish another state at once."""
        self._device.trigger(_STATUS_TPDO)

    def drive(self, session: int) -> None:
        """Send the drive; who sends it, and whether in FAULT, is in its check alone."""
        latched = LATCHED if self._supervisor.state is State.FAULT else 0
        self._drive.write_check(bytes((session, self._device.od.node_id | latched)))
        self._device.trigger(DRIVE_TPDO)

    def all(self) -> None:
        """Publish everything, for the last time."""
        for number in (_STATUS_TPDO, *_MEASURED_TPDOS):
            self._device.trigger(number)

    def report(self) -> None:
        """Make emergency messages of what was latched, or reset, since the last time."""
        before, self._reported = self._reported, self._supervisor.latched
        if before == self._reported:
            return
        for watchdog in watchdogs_in(before & ~self._reported):
            self._device.clear_emergency(WATCHDOGS[watchdog].code)
        for watchdog in watchdogs_in(self._reported & ~before):
            row = WATCHDOGS[watchdog]
            self._device.emergency(row.code, row.register, bytes((watchdog,)))
            self._device.trigger(_STATUS_TPDO)

    def hold(self) -> None:
        """Tell nothing of what is latched now: there is no device to tell it, in a reset."""
        self._reported = self._supervisor.latched

    def report_all(self) -> None:
        """Tell all that is latched, also what was so in a reset or before it."""
        self._reported = 0
        self.report()

"""A device of any EDS with nothing behind its objects: a stand-in for the real one."""

from __future__ import annotations

from smarttac_can.device.device import Device
from smarttac_can.device.frame import Frame
from smarttac_can.device.port import Identifiers


class PlainNode:
    """Runs a device whose values are held in memory only.

    Parameters
    ----------
    device
        The device, without an application.
    """

    def __init__(self, device: Device) -> None:
        self.device = device
        self.clock = device.clock
        self.start = device.start
        self.receive = self.overtaken = device.receive
        self.advance = device.advance
        self.segments = device.segments
        self.bus_off = device.bus_off
        self.bus_recovered = device.bus_recovered

    @property
    def ids(self) -> Identifiers:
        """CAN-IDs that the device listens to, and those of its urgent frames, now."""
        return self.device.ids

    def overdue(self) -> list[Frame]:
        """Return no frames: nothing is driven, so no deadline can pass."""
        return []

    def transmit_failed(self) -> list[Frame]:
        """Return no frames: nothing depends on a frame that could not be sent."""
        return []

    def shutdown(self) -> list[Frame]:
        """Return no frames: nothing is driven that would have to stop."""
        return []

"""A CANopen device as whoever runs it on a bus sees it: frames and time in, frames out."""

from __future__ import annotations

from smarttac_can.device.device import Device
from smarttac_can.device.frame import Frame
from smarttac_can.device.port import Identifiers
from smarttac_can.device.service import Application


class DeviceNode(Application):
    """Run a device; alone, its values are only held in memory, and nothing is driven.

    Parameters
    ----------
    device
        The device, whose application is the node itself where a subclass has one.
    """

    def __init__(self, device: Device) -> None:
        self.device = device
        self.clock = device.clock
        self.start = device.start
        self.receive = device.receive
        self.advance = device.advance
        self.segments = device.segments

    @property
    def ids(self) -> Identifiers:
        """CAN-IDs that the device listens to, and those of its urgent frames, now."""
        return self.device.ids

    def overtaken(self, frame: Frame) -> list[Frame]:
        """Take a frame that waited while a newer one of its kind came; return the answers."""
        return self.device.receive(frame)

    def overdue(self) -> list[Frame]:
        """Act on deadlines that have passed; without an application there are none."""
        return []

    def transmit_failed(self) -> list[Frame]:
        """Act on an urgent frame that could not be sent; without an application there is none."""
        return []

    def bus_off(self) -> list[Frame]:
        """Record that the CAN controller went bus-off."""
        return self.device.bus_off()

    def bus_recovered(self) -> list[Frame]:
        """Record that the CAN controller is on the bus again."""
        return self.device.bus_recovered()

    def shutdown(self) -> list[Frame]:
        """Leave nothing driven; return the frames that say so."""
        return []

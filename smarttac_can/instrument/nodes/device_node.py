"""A CANopen device as its runner sees it: frames and time in, frames out."""

from __future__ import annotations

from smarttac_can.canopen.device.device import Device
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.device.port import Identifiers
from smarttac_can.canopen.device.service import Application


class DeviceNode(Application):
    """Run a CANopen device. Without a subclass it only stores values in memory and drives nothing.

    Parameters
    ----------
    device
        Device to run. Its application is this node if a subclass overrides the callbacks.
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
        """CAN-IDs that the device receives, and those of its urgent frames."""
        return self.device.ids

    def overtaken(self, frame: Frame) -> list[Frame]:
        """Take a frame that was superseded by a newer frame of its kind; return the answers."""
        return self.device.receive(frame)

    def overdue(self) -> list[Frame]:
        """Act on elapsed deadlines; a device without an application has none."""
        return []

    def transmit_failed(self) -> list[Frame]:
        """Act on an urgent frame that was not sent; a device without an application has none."""
        return []

    def bus_off(self) -> list[Frame]:
        """Record that the CAN controller went bus-off."""
        return self.device.bus_off()

    def bus_recovered(self) -> list[Frame]:
        """Record that the CAN controller is on the bus again."""
        return self.device.bus_recovered()

    def shutdown(self) -> list[Frame]:
        """Switch off the drive; return the frames that report it."""
        return []

"""Emergency consumer (CiA 301, 7.2.7): the messages of one other node, for the application."""

from __future__ import annotations

from typing import ClassVar

from smarttac_can.device.application import Application
from smarttac_can.device.frame import Frame
from smarttac_can.device.nmt import CONFIGURABLE
from smarttac_can.device.port import Port
from smarttac_can.device.service import Service
from smarttac_can.od.cia import EMCY_ID, FRAME_BYTES
from smarttac_can.od.dictionary import ObjectDictionary


class EmergencyConsumer(Service):
    """Hears the default EMCY identifier of a node.

    Parameters
    ----------
    node_id
        1..127, 0 for none.
    """

    states: ClassVar = CONFIGURABLE

    def __init__(
        self, port: Port, od: ObjectDictionary, application: Application, node_id: int
    ) -> None:
        super().__init__(port, od, ())
        self._application = application
        self._node_id = node_id

    def listen(self) -> None:
        """Listen to the EMCY identifier of the node, if there is one."""
        if self._node_id:
            self.port.listen(EMCY_ID + self._node_id, self._receive)

    def _receive(self, frame: Frame) -> None:
        if len(frame.data) == FRAME_BYTES and not frame.rtr:
            self._application.on_emergency(int.from_bytes(frame.data[:2], "little"))

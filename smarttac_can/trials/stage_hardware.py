"""Simulated hardware at the output of the power stage, which the plate listens to."""

from __future__ import annotations

from struct import pack
from typing import TYPE_CHECKING

from smarttac_can.bench.simulation import PLATE_ID
from smarttac_can.device.frame import Frame
from smarttac_can.nodes.loop_frames import HARDWARE_RPDO
from smarttac_can.od.cia import PDO_COB_ID, PDO_EVENT, RPDO_COMMUNICATION, RPDO_IDS, SYNC_ID
from smarttac_can.vocabulary.signals import SHORT_DEADLINE_MS

if TYPE_CHECKING:
    from smarttac_can.trials.rig import Rig

_CAN_ID = RPDO_IDS[HARDWARE_RPDO - 1] + PLATE_ID


class StageHardware:
    """Reads the stage back at each SYNC, and tells the plate.

    Parameters
    ----------
    rig
        Its plate is told to listen.

    Attributes
    ----------
    enable
        Whether it lets the stage drive, 0 or 1.
    excess
        What it reads more than there is, in 10 mV.
    speaks
        Whether it says anything.
    """

    def __init__(self, rig: Rig) -> None:
        self.enable = 1
        self.excess = 0
        self.speaks = True
        self._stage = rig.stage
        parameters = rig.plate.od.objects[RPDO_COMMUNICATION + HARDWARE_RPDO - 1].entries
        rig.master.write(PLATE_ID, parameters[PDO_EVENT], SHORT_DEADLINE_MS)
        rig.master.write(PLATE_ID, parameters[PDO_COB_ID], _CAN_ID)
        self._port = rig.bus.connect(self._hear)

    def _hear(self, frame: Frame) -> None:
        if frame.can_id == SYNC_ID and self.speaks:
            reading = int(self._stage.read()) + self.excess
            self._port.send(Frame(_CAN_ID, pack("<BH", self.enable, reading)))

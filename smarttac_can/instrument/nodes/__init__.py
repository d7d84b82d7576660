"""The CANopen nodes: a device with the function block of the plate, or of the stimulator."""

from smarttac_can.instrument.nodes.loop_frames import crc8
from smarttac_can.instrument.nodes.plate_block import PlateBlock
from smarttac_can.instrument.nodes.plate_node import PlateNode
from smarttac_can.instrument.nodes.stimulator_block import StimulatorBlock
from smarttac_can.instrument.nodes.stimulator_node import StimulatorNode

__all__ = ["PlateBlock", "PlateNode", "StimulatorBlock", "StimulatorNode", "crc8"]

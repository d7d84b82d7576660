"""The CANopen nodes: a device with the function block of the plate, or of the stimulator."""

from __future__ import annotations

from typing import TYPE_CHECKING

from smarttac_can._faces import lazily

if TYPE_CHECKING:
    from smarttac_can.nodes.plate_block import PlateBlock
    from smarttac_can.nodes.plate_node import PlateNode
    from smarttac_can.nodes.stimulator_block import StimulatorBlock
    from smarttac_can.nodes.stimulator_node import StimulatorNode

__all__ = ["PlateBlock", "PlateNode", "StimulatorBlock", "StimulatorNode"]

__getattr__ = lazily(
    __name__,
    {
        "PlateBlock": "plate_block",
        "PlateNode": "plate_node",
        "StimulatorBlock": "stimulator_block",
        "StimulatorNode": "stimulator_node",
    },
)

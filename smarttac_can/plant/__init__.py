"""The simulated plate: resonator, thermal node, finger, friction and sensors."""

from __future__ import annotations

from typing import TYPE_CHECKING

from smarttac_can._faces import lazily

if TYPE_CHECKING:
    from smarttac_can.plant.finger import Lifted, Stroke
    from smarttac_can.plant.parameters import PlateParameters
    from smarttac_can.plant.plate import Plate
    from smarttac_can.plant.subjects import SUBJECTS, Subject

__all__ = ["SUBJECTS", "Lifted", "Plate", "PlateParameters", "Stroke", "Subject"]

__getattr__ = lazily(
    __name__,
    {
        "Lifted": "finger",
        "Stroke": "finger",
        "PlateParameters": "parameters",
        "Plate": "plate",
        "SUBJECTS": "subjects",
        "Subject": "subjects",
    },
)

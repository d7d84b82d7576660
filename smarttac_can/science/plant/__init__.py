"""The simulated plate: resonator, thermal node, finger, friction and sensors."""

from smarttac_can.science.plant.finger import Lifted, Stroke
from smarttac_can.science.plant.parameters import PlateParameters
from smarttac_can.science.plant.plate import Plate
from smarttac_can.science.plant.subjects import SUBJECTS, Subject

__all__ = ["SUBJECTS", "Lifted", "Plate", "PlateParameters", "Stroke", "Subject"]

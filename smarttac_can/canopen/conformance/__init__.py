"""A conformance suite for CANopen devices: 127 cases, which judge only the frames on the bus."""

from smarttac_can.canopen.conformance.examiner import Examiner
from smarttac_can.canopen.conformance.run import markdown, run_cases, summary

__all__ = ["Examiner", "markdown", "run_cases", "summary"]

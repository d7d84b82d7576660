"""Fault matrix, soak and attack: each fault in each mode, hours of faults, a hostile node."""

from smarttac_can.trials.fault_cases import cases
from smarttac_can.trials.hostile import Hostile
from smarttac_can.trials.rig import Rig
from smarttac_can.trials.soak import Soak

__all__ = ["Hostile", "Rig", "Soak", "cases"]

"""Fault matrix, soak and attack: each fault in each mode, hours of faults, a hostile node."""

from smarttac_can.assurance.trials.fault_cases import cases
from smarttac_can.assurance.trials.hostile import Hostile
from smarttac_can.assurance.trials.rig import Rig
from smarttac_can.assurance.trials.soak import Soak

__all__ = ["Hostile", "Rig", "Soak", "cases"]

"""Fault matrix, soak and attack: every fault in every mode, hours of faults, a hostile node."""

from __future__ import annotations

from typing import TYPE_CHECKING

from smarttac_can._faces import lazily

if TYPE_CHECKING:
    from smarttac_can.trials.fault_cases import cases
    from smarttac_can.trials.hostile import Hostile
    from smarttac_can.trials.rig import Rig
    from smarttac_can.trials.soak import Soak

__all__ = ["Hostile", "Rig", "Soak", "cases"]

__getattr__ = lazily(
    __name__,
    {
        "cases": "fault_cases",
        "Hostile": "hostile",
        "Rig": "rig",
        "Soak": "soak",
    },
)

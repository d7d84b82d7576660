"""Fault matrix and soak: every fault in every mode, and hours with faults at random."""

from __future__ import annotations

from typing import TYPE_CHECKING

from smarttac_can._faces import lazily

if TYPE_CHECKING:
    from smarttac_can.trials.fault_matrix import cases
    from smarttac_can.trials.rig import Rig
    from smarttac_can.trials.soak import Soak

__all__ = ["Rig", "Soak", "cases"]

__getattr__ = lazily(
    __name__,
    {
        "cases": "fault_matrix",
        "Rig": "rig",
        "Soak": "soak",
    },
)

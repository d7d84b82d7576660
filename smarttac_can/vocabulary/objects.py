"""Names of objects, and values with a meaning, that a client uses as the nodes do."""

from __future__ import annotations

from typing import Final

START_RUN: Final = "Simulation.Start run"
FAULT_KIND: Final = "Fault.Kind"
LIFTED, STROKE, RECORDED = range(3)
"""Values of ``Finger.Motion``."""
SIMULATION: Final = ("Simulation", "Finger", "Fault", "Weight")
"""Records that belong to the simulated plate."""
ZERO: Final = int.from_bytes(b"zero", "little")
"""Signature to write to the auto-zero object."""
TARE: Final = "AI auto-zero"
"""Record of the objects that take it."""
AUTO_ZERO: Final = tuple(
    f"{TARE}.AI auto-zero {channel}" for channel in ("force x", "force y", "normal force")
)
"""Its objects, one for each channel that can be tared."""
NOT_TARED: Final = "not tared: "
"""How the Message begins of a tare that is refused for a null outside its window."""
UNWATCHED: Final = "not armed, as nobody would be missed: "
"""How the Message begins of an arming that is refused for want of a watch; what to do follows."""

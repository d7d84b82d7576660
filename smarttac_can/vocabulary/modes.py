"""Modes and laws, by the numbers that the object dictionary gives them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from smarttac_can.vocabulary.named_number import NamedNumber


class Mode(NamedNumber):
    """What the cascade controls."""

    OFF = 0
    """0 V at the frequency of the set-point."""
    OPEN_LOOP = 1
    """Voltage and frequency of the set-point."""
    AMPLITUDE = 2
    """Amplitude by voltage, at the frequency of the set-point."""
    AMPLITUDE_RESONANCE = 3
    """Amplitude by voltage, and the resonance tracked by frequency."""
    FRICTION = 4
    """COF by amplitude, over both loops of the mode before."""
    IDENTIFY = 5
    """Identification of the unloaded plate; ends by itself in OFF."""
    TEXTURE = 6
    """COF by amplitude as in FRICTION; its reference is played from a table."""


class Law(NamedNumber):
    """How the amplitude follows the COF; to what the step dW is added the paper leaves open."""

    MEASURED = 0
    """``W_ref = |W| + dW``: integral action through the inner loop."""
    ACCUMULATE = 1
    """``W_ref += dW``: integral action before the inner loop; less margin than the above."""
    NOMINAL = 2
    """``W_ref = W_nominal + dW``: proportional action; it leaves a static error."""
    PREDICTIVE = 3
    """``W_ref`` by the friction map of the finger, which is learned on the way; without dW."""


class VibrationLaw(NamedNumber):
    """How amplitude and resonance are regulated."""

    PI = 0
    """Two PIs designed for the bare plate, as in the paper; in mode TEXTURE that of the
    amplitude as `SCHEDULED`."""
    SCHEDULED = 1
    """The same two, designed for the plate under the finger that presses now."""
    PREDICTIVE = 2
    """One step of a plate that is learned from tick to tick, through its dead time."""


LAWS: Final[Mapping[str, type[Law] | type[VibrationLaw]]] = {
    "Friction law": Law,
    "Controller.Vibration law": VibrationLaw,
}
"""Objects that choose a law, and what there is."""

"""The load of a finger on the plate: damping that grows with the contact area."""

from __future__ import annotations

from typing import Final

from smarttac_can.vocabulary.model import PlateModel

LOAD_FORCE: Final = 0.5
"""Normal force in N at which the load of a model is stated."""
_GROWTH: Final = 2.0 / 3.0
"""A Hertz contact grows so with the force, and its damping with it."""


def contact_load(Fn: float) -> float:
    """Return the contact at a normal force in N over that at 0.5 N; 0 without a force."""
    return float((Fn / LOAD_FORCE) ** _GROWTH) if Fn > 0.0 else 0.0


def decay_rate(model: PlateModel, contact: float) -> float:
    """Return 1/tau in 1/s under a contact of `contact_load`: ``1/tau(Fn) = 1/tau0 + c Fn^(2/3)``.

    The gain goes with tau: ``kappa = K/tau``, the force of a volt over the mass, stays.
    """
    return (1.0 + model.load * contact) / model.tau


def load_of_press(model: PlateModel, V: float, W: complex, Fn: float) -> float:
    """Return `PlateModel.load` from one press in steady state.

    Parameters
    ----------
    model
        The unloaded plate.
    V
        Voltage in V.
    W
        Vibration under the finger in m, of any detuning.
    Fn
        Normal force in N, above 0.

    Notes
    -----
    The real part of ``kappa V/W = 1/tau + j (w - w0)``.
    """
    square = W.real * W.real + W.imag * W.imag
    return (model.gain * V * W.real / square - 1.0) / contact_load(Fn)

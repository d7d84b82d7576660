"""C_mu: which COF is asked for where the finger is, and which amplitude it takes."""

from __future__ import annotations

from smarttac_can.control.friction import Boundary, FrictionLaw
from smarttac_can.control.parameters import CascadeParameters
from smarttac_can.control.predictive_friction import PredictiveFriction
from smarttac_can.control.texture import TexturePlayer
from smarttac_can.control.texture_friction import TextureFriction
from smarttac_can.control.tribometer import Tribometer
from smarttac_can.vocabulary.modes import Law
from smarttac_can.vocabulary.signals import Contact, Setpoint


class FrictionControl:
    """The outer loop of the modes FRICTION and TEXTURE, stepped once a tick.

    What it learned of a finger outlives a touch, and a change of the mode.

    Parameters
    ----------
    parameters
        Law, step and limits, preview and dead time.
    """

    __slots__ = ("_ahead", "_boundary", "_by_map", "_kind", "_law", "_textured")

    def __init__(self, parameters: CascadeParameters) -> None:
        self._boundary = Boundary(parameters.hysteresis)
        self._kind = Law.MEASURED
        self._by_map: PredictiveFriction | None = None
        self._textured = TextureFriction()
        self.configure(parameters)

    def configure(self, parameters: CascadeParameters) -> None:
        """Replace the parameters, without a bump."""
        p = parameters
        right = self._boundary.right
        self._boundary = Boundary(p.hysteresis)
        self._boundary.right = right
        self._law = FrictionLaw(p.law, p.slope, p.step_max)
        self._ahead = p.dead_time + p.preview
        if p.law is not self._kind:
            self._kind = p.law
            self._by_map = PredictiveFriction() if p.law is Law.PREDICTIVE else None

    def place(self, position: float, boundary: float) -> None:
        """Decide anew which side of the boundary the finger is on."""
        self._boundary.place(position, boundary)

    def at(self, position: float, setpoint: Setpoint) -> float:
        """Return the COF asked for on the side of the boundary where the finger is."""
        right = self._boundary.update(position, setpoint.boundary)
        return setpoint.mu_right if right else setpoint.mu_left

    def ahead(self, texture: TexturePlayer, contact: Contact, tribometer: Tribometer) -> float:
        """Return the COF that a texture has where the finger will be when a drive takes effect."""
        if not contact.touching:
            return texture.reference(contact.position, 0.0, self._ahead)
        line = self._textured.locate(*tribometer.centre())
        return texture.reference(line.position, line.speed, self._ahead)

    def release(self) -> None:
        """Take note that no finger touches, or that a mode begins."""
        self._textured.release()
        if self._by_map is not None:
            self._by_map.release()

    def for_texture(self, contact: Contact, W: float, mu_ref: float, W_max: float) -> float:
        """Return the amplitude reference in m of mode TEXTURE, for a finger that touches."""
        return self._textured.reference(contact, W, mu_ref, W_max)

    def for_level(
        self, contact: Contact, E: float, W: float, mu_ref: float, W_ref: float, W_nominal: float
    ) -> float:
        """Return the amplitude reference in m of mode FRICTION, for a finger that touches.

        Parameters
        ----------
        contact
            The finger.
        E
            Friction error in %.
        W
            Measured amplitude in m.
        mu_ref
            Reference of the COF, above 0.
        W_ref
            Amplitude reference in m of the tick before.
        W_nominal
            The user's amplitude in m.
        """
        if self._by_map is not None:
            return self._by_map.reference(contact, W, mu_ref)
        return self._law.reference(E, W, W_ref, W_nominal)

"""The skin between bone and plate: mass, spring, damper, and friction of the Dahl type."""

from __future__ import annotations

from typing import Generic

from smarttac_can.plant.friction import reduction, stribeck
from smarttac_can.plant.mathematics import Float, Mathematics
from smarttac_can.plant.subjects import Subject


class Skin(Generic[Float]):
    """State of the skin: sliding velocity v, stretch, and friction state z in -1..1.

    ``skin_mass v' = k stretch + b (v_bone - v) - F z``, ``stretch' = v_bone - v``,
    ``z' = (v - |v| z)/relaxation_length``. A step is implicit (backward Euler) in all three; the
    equation for the new v is monotone and quadratic on each side of 0, so it is solved in closed
    form and the step is stable at any length. Only the dependence of F on v is taken from the
    last step.

    Parameters
    ----------
    m
        Mathematics of the subject: SCALAR or ARRAY.
    subject
        The fingertip.
    f0
        Frequency of the vibration in Hz.
    """

    __slots__ = ("_f0", "_m", "friction", "stretch", "subject", "v", "z")

    def __init__(self, m: Mathematics[Float], subject: Subject[Float], f0: float) -> None:
        self._m: Mathematics[Float] = m
        self._f0 = f0
        self.subject: Subject[Float] = subject
        self.v: Float = 0.0 * subject.mu0
        self.stretch: Float = 0.0 * subject.mu0
        self.z: Float = 0.0 * subject.mu0
        self.friction: Float = 0.0 * subject.mu0

    def step(self, duration: float, W: Float, v_bone: Float, bare: Float) -> Float:
        """Advance and return the friction force on the plate in N.

        Parameters
        ----------
        duration
            Length of the step in s.
        W
            Vibration under the finger in m peak-to-peak, 0 or more.
        v_bone
            Velocity of the finger's bone in m/s.
        bare
            Friction without vibration in N, 0 or more; 0 is a lifted finger.
        """
        m, s, v, z = self._m, self.subject, self.v, self.z
        speed = m.select(v, v, -v)
        F = bare * reduction(m, s, W, speed, self._f0) * stribeck(s, speed)
        k, b, L = s.skin_stiffness, s.skin_damping, s.relaxation_length
        # (skin_mass + h b + h^2 k) v + h F z(v) = impulse, with u = |v| h/L the unknown.
        impulse = s.skin_mass * v + duration * (k * self.stretch + (b + duration * k) * v_bone)
        push = impulse - duration * F * z
        sign = m.select(push, 0.0 * push + 1.0, 0.0 * push - 1.0)
        inertia = (s.skin_mass + duration * (b + duration * k)) * L / duration
        hold = duration * F
        c = sign * push
        q = inertia + hold - sign * impulse
        root = m.sqrt(q * q + 4.0 * inertia * c)
        # Of the two forms of the root, the one without cancellation.
        total = m.select(q, q, -q) + root
        u = m.select(q, 2.0 * c / total, total / (2.0 * inertia))
        self.v = v = sign * u * L / duration
        self.stretch = self.stretch + duration * (v_bone - v)
        self.z = z = (z + sign * u) / (1.0 + u) * m.select(bare, 0.0 * z + 1.0, 0.0 * z)
        self.friction = F * z
        return self.friction

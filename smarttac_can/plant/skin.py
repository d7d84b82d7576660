"""The skin between bone and plate: mass, spring, damper, and friction of the Dahl type."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Generic

from smarttac_can.plant.friction import sliding_friction
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

    __slots__ = ("_friction", "_m", "stretch", "subject", "v", "z")

    def __init__(self, m: Mathematics[Float], subject: Subject[Float], f0: float) -> None:
        self._m: Mathematics[Float] = m
        self._friction: Callable[[Float, Float, Float], Float] = sliding_friction(m, subject, f0)
        self.subject: Subject[Float] = subject
        self.v: Float = 0.0 * subject.mu0
        self.stretch: Float = 0.0 * subject.mu0
        self.z: Float = 0.0 * subject.mu0

    def slide(
        self, duration: float, vibrations: Iterable[Float], v_bone: Float, bare: Float
    ) -> list[Float]:
        """Advance by steps of equal length; return the friction force on the plate in N of each.

        Parameters
        ----------
        duration
            Length of a step in s.
        vibrations
            Vibration under the finger in each step, in m peak-to-peak, 0 or more.
        v_bone
            Velocity of the finger's bone in m/s.
        bare
            Friction without vibration in N, 0 or more; 0 is a lifted finger.
        """
        m, s, friction = self._m, self.subject, self._friction
        sqrt, select = m.sqrt, m.select
        v, stretch, z = self.v, self.stretch, self.z
        k, L, mass = s.skin_stiffness, s.relaxation_length, s.skin_mass
        give = s.skin_damping + duration * k
        pull = give * v_bone
        inertia = (mass + duration * give) * L / duration
        inertia2, inertia4 = 2.0 * inertia, 4.0 * inertia
        touches = 1.0 * (bare > 0.0)
        forces: list[Float] = []
        for W in vibrations:
            speed = abs(v)
            F = friction(bare, W, speed)
            # (mass + h b + h^2 k) v + h F z(v) = impulse, with u = |v| h/L the unknown.
            impulse = mass * v + duration * (k * stretch + pull)
            hold = duration * F
            push = impulse - hold * z
            sign = 2.0 * (push > 0.0) - 1.0
            ahead = sign * push
            q = inertia + hold - sign * impulse
            root = sqrt(q * q + inertia4 * ahead)
            # Of the two forms of the root, the one without cancellation.
            total = abs(q) + root
            u = select(q, 2.0 * ahead / total, total / inertia2)
            advance = sign * u
            v = advance * L / duration
            stretch = stretch + duration * (v_bone - v)
            z = (z + advance) / (1.0 + u) * touches
            forces.append(F * z)
        self.v, self.stretch, self.z = v, stretch, z
        return forces

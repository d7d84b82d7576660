"""The vibration mode of eq. (1), solved exactly in the frame of the drive voltage.

``m W" + (d + 2jmw) W' + (c - m w^2 + jwd) W = jN V_q`` has constant coefficients while the drive
and the load are constant, so a step is a product with a matrix exponential. Both second-order terms
of eq. (4), (5) are kept; the step is exact for any detuning and any step size.
"""

from __future__ import annotations

from cmath import exp as exp_j
from math import sqrt

Response = tuple[complex, complex, complex, complex, complex]
"""Exact step of the mode for constant drive and load: a 2 x 2 matrix, and the equilibrium in m."""


def response(
    mass: float, duration: float, omega: float, force: float, damping: float, stiffness: float
) -> Response:
    """Return the exact step of the mode.

    Parameters
    ----------
    mass
        Modal mass m in kg, above 0.
    duration
        Length of the step in s.
    omega
        Angular frequency w of the drive in rad/s.
    force
        Force N V_q in N peak-to-peak.
    damping
        Damping d of plate and finger in N s/m; below 2 sqrt(c m).
    stiffness
        Stiffness c of plate and finger in N/m.
    """
    decay = 0.5 * damping / mass
    natural = sqrt(stiffness / mass - decay * decay)
    slow = complex(-decay, natural - omega)
    fast = complex(-decay, -natural - omega)
    e_slow = exp_j(slow * duration)
    e_fast = exp_j(fast * duration)
    scale = -0.5j / natural
    rise = (e_slow - e_fast) * scale
    return (
        (slow * e_fast - fast * e_slow) * scale,
        rise,
        -slow * fast * rise,
        (slow * e_slow - fast * e_fast) * scale,
        1j * force / complex(stiffness - mass * omega * omega, omega * damping),
    )


def integral(
    moved: tuple[complex, complex, complex, complex],
    duration: float,
    mass: float,
    omega: float,
    force: float,
    loaded: tuple[float, float],
) -> complex:
    """Return the integral of the envelope over a step in m s, from the differential equation.

    Parameters
    ----------
    moved
        Envelope in m and its rate in m/s before the step, and both after it.
    duration, mass, omega, force
        As for `response`.
    loaded
        Damping and stiffness of plate and finger, as for `response`.
    """
    damping, stiffness = loaded
    W, rate, W_next, rate_next = moved
    gained = mass * (rate_next - rate) + complex(damping, 2.0 * mass * omega) * (W_next - W)
    spring = complex(stiffness - mass * omega * omega, omega * damping)
    return (1j * force * duration - gained) / spring


def rate_in_frame(W: complex, rate: complex, faster: float) -> complex:
    """Return W' in a frame that rotates faster by ``faster`` rad/s; W itself is unchanged."""
    return rate + 1j * -faster * W


def vibrate(step: Response, W: complex, rate: complex) -> tuple[complex, complex]:
    """Return envelope W in m peak-to-peak and its rate in m/s after a step."""
    p11, p12, p21, p22, equilibrium = step
    deviation = W - equilibrium
    return equilibrium + p11 * deviation + p12 * rate, p21 * deviation + p22 * rate

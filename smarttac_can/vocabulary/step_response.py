"""Response of the plate to a switched voltage: its time constant, and its delay."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

from smarttac_can.vocabulary.signals import TICK

STEP_TICKS: Final = 24
"""Ticks between two switches, in which the response settles."""
_A_MIN: Final = 1e-5
_A_MAX: Final = math.exp(-TICK / 1e-2)
"""Bounds of abs(A): lags of 0.09 ms, far too short for the tick, and of 10 ms."""
_DELAY_MAX: Final = 100e-6
"""Largest difference in s between the delay and the dead time, in addition to the noise."""
_NOISE: Final = 5.0
"""Number of standard uncertainties of the delay that count as noise."""


class StepResponse(NamedTuple):
    """Response of the vibration to a switch of the voltage."""

    A: complex
    """Fraction of a deviation that is left after a tick, rotated by the detuning."""
    W: complex
    """Vibration in m in steady state at the voltage."""
    tau: float
    """Time constant in s without the bias of noise."""
    delay: float
    """Time in s from a measurement until its drive shows in the vibration. Half of the pick-up's
    window counts as delay."""
    unsure: float
    """Standard uncertainty of the delay in s."""

    @property
    def tolerance(self) -> float:
        """Largest difference in s of a correct dead time from the delay."""
        return _DELAY_MAX + _NOISE * self.unsure


def step_response(
    holds: Sequence[Sequence[complex]], offset: complex, noise: float
) -> StepResponse:
    """Return the response to a voltage that is switched off and on.

    Two ticks after a switch the fraction ``e^(-(2 Ts - delay)/tau)`` of the change is left.

    Parameters
    ----------
    holds
        Vibration in m in each tick from the first after a switch, off and on in turn. Before the
        first hold the voltage is arbitrary.
    offset
        Reading of the vibration in m at rest.
    noise
        Standard deviation in m of each axis of the pick-up.

    Raises
    ------
    ValueError
        The vibration does not decay.
    """
    product, square, next_square = 0j, 0.0, 0.0
    driven: list[tuple[complex, complex]] = []
    for i, samples in enumerate(holds):
        now, then = samples[:-1], samples[1:]
        now_mean, then_mean = _mean(now), _mean(then)
        for x, y in zip(now, then, strict=True):
            dx, dy = x - now_mean, y - then_mean
            product += dy * dx.conjugate()
            square += dx.real * dx.real + dx.imag * dx.imag
            next_square += dy.real * dy.real + dy.imag * dy.imag
        if i % 2:
            driven.append((now_mean, then_mean))
    A = product / square if square > 0.0 else 0j
    if not _A_MIN < abs(A) < _A_MAX:
        raise ValueError(
            f"the response to a step is no decay: {abs(A):.3g} is outside "
            f"{_A_MIN:.3g}..{_A_MAX:.3g}"
        )
    W = _mean([(then - A * now) / (1.0 - A) for now, then in driven]) - offset
    tau = -TICK / math.log(_unbiased(product, square, next_square))
    switched = len(holds) - 1
    left = [x[1] - offset - (W if i % 2 else 0.0) for i, x in enumerate(holds)][1:]
    share = abs(sum(-x if i % 2 == 0 else x for i, x in enumerate(left))) / (switched * abs(W))
    if share == 0.0:
        return StepResponse(A, W, tau, 2.0 * TICK, math.inf)
    delay = 2.0 * TICK + tau * math.log(share)
    return StepResponse(A, W, tau, delay, tau * noise / (math.sqrt(switched) * abs(W) * share))


def _unbiased(product: complex, square: float, next_square: float) -> float:
    """Return abs(A) by total least squares: noise in both samples biases the ordinary to 0."""
    size = abs(product)
    half = 0.5 * (next_square - square)
    return min(max((half + math.hypot(half, size)) / size, _A_MIN), _A_MAX)


def _mean(values: Sequence[complex]) -> complex:
    return sum(values) / len(values)

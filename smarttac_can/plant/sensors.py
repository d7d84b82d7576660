"""Strain gauges, vibration pick-up and thermometer: from true values to what is reported."""

from __future__ import annotations

from math import floor

import numpy as np

from smarttac_can.plant.parameters import SensorParameters, require
from smarttac_can.vocabulary.signals import Measurement

_BLOCK = 256
_NOISE_STREAM = 0x4E
_SERIAL_STREAM = 0x53
PICKUP_SATURATED = 1 << 6


class Sensors:
    """The sensors of one plate in one run.

    Null, drift and curvature of the gauges belong to the hardware: they come from the serial
    number and are the same in every run. The white noise comes from the seed of the run; that
    of a tick is a function of the seed and the tick alone.

    Parameters
    ----------
    parameters
        The sensors' data.
    seed
        Seed of the noise, 0 or more.
    """

    __slots__ = ("_block", "_gauges", "_noise", "_parameters", "_scale", "_seed", "nulls")

    def __init__(self, parameters: SensorParameters, seed: int) -> None:
        require("seed", seed, 0, 2**63 - 1)
        p = parameters
        draws = np.random.default_rng([p.serial, _SERIAL_STREAM]).uniform(-1.0, 1.0, (3, 6))
        nulls, drifts, bows = draws.tolist()
        curvature = 4.0 * p.linearity / (p.span * p.span) if p.span else 0.0
        self._parameters = p
        self.nulls: tuple[float, ...] = tuple(p.null * null for null in nulls)
        self._gauges = [
            (at, self.nulls[at], p.drift * drifts[at], curvature * bows[at])
            for at in range(len(nulls))
        ]
        self._scale = np.array([p.gauge_noise] * 6 + [p.pickup_noise] * 2 + [p.temperature_noise])
        self._seed = seed
        self._block = -1
        self._noise: list[list[float]] = []

    def measure(
        self, tick: int, W: complex, temperature: float, Fx: float, Fn: float, moment: float
    ) -> Measurement:
        """Return what is reported at a tick.

        Parameters
        ----------
        tick
            Number of the tick from the start of the run, 0 or more.
        W
            Vibration in m peak-to-peak.
        temperature
            Plate temperature in degC.
        Fx, Fn
            Forces behind the force path in N.
        moment
            Fn times the finger's position along x, behind the force path, in N m.
        """
        block, row = divmod(tick, _BLOCK)
        if block != self._block:
            rng = np.random.default_rng([self._seed, _NOISE_STREAM, block])
            self._noise = (rng.standard_normal((_BLOCK, 9)) * self._scale).tolist()
            self._block = block
        noise = self._noise[row]
        p = self._parameters
        (xx, _), (yx, _) = p.crosstalk
        lean = moment / p.node_x
        left = 0.25 * (Fn - lean)
        right = 0.25 * (Fn + lean)
        warmth = temperature - p.drift_temperature
        limit = p.full_scale
        step = p.gauge_resolution
        saturated = 0
        loads = (xx * Fx, yx * Fx, left, right, left, right)
        counts = [
            floor(
                (loads[at] + bow * loads[at] * loads[at] + null + drift * warmth + noise[at]) / step
                + 0.5
            )
            for at, null, drift, bow in self._gauges
        ]
        if not -limit < min(counts) <= max(counts) < limit:
            saturated = sum(1 << n for n, count in enumerate(counts) if abs(count) >= limit)
            counts = [max(-limit, min(limit, count)) for count in counts]
        gauges = tuple([count * step for count in counts])
        step = p.pickup_resolution
        d = floor((W.real + noise[6]) / step + 0.5)
        q = floor((W.imag + noise[7]) / step + 0.5)
        if not (-limit < d < limit and -limit < q < limit):
            saturated |= PICKUP_SATURATED
            d = max(-limit, min(limit, d))
            q = max(-limit, min(limit, q))
        grain = p.temperature_resolution
        temperature = floor((temperature + noise[8]) / grain + 0.5) * grain
        return tuple.__new__(
            Measurement, (complex(d * step, q * step), gauges, temperature, saturated)
        )

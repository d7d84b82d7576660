"""Strain gauges, vibration pick-up and thermometer: their readings from the true values."""

from __future__ import annotations

from collections.abc import Sequence
from math import floor, pi, sqrt
from typing import NamedTuple

import numpy as np
from numpy.random import default_rng  # imported here, as an import during a run may lose a Ctrl-C
from numpy.typing import NDArray

from smarttac_can.science.plant.parameters import SensorParameters, require
from smarttac_can.vocabulary.signals import PICKUP_SATURATED, MeasurementFields

NOISE_BLOCK = 256
"""Number of ticks whose noise comes from one generator."""
CHANNELS = 15
"""Noisy channels: S1..S6, the two axes of the pick-up, the thermometer, repeatability of S1..S6."""
REPEAT_BLOCKS = 4
"""Blocks of noise from one independent error of repeatability to the next, about 1 s [A]."""
_DRAW = 64
"""Number of ticks drawn at once. Once a millisecond a draw finds cold caches and takes some 80 us,
of 16 ticks as well as of 64; a whole block with the start of its generator makes a cycle late."""
_NOISE_STREAM = 0x4E
_REPEAT_STREAM = 0x52
_SERIAL_STREAM = 0x53
_WHITE = 9
"""Channels whose noise is white."""


class Gauge(NamedTuple):
    """Individual data of one strain gauge."""

    null: float
    """Output without load in N."""
    drift: float
    """Shift of the null in N/K."""
    bow: float
    """Curvature in 1/N."""
    sensitivity: float
    """Slope at no load and at the temperature of the null; 1 for a trimmed gauge."""
    shift: float
    """Shift of the slope in 1/K."""
    repeat: float
    """Standard deviation of the slope from one load to the next."""
    weight: float
    """Static load in N."""


class Weight(NamedTuple):
    """A static load on the plate, in addition to that of a finger."""

    Fx: float = 0.0
    """Lateral force along the plate in N."""
    Fy: float = 0.0
    """Lateral force across the plate in N."""
    Fn: float = 0.0
    """Normal force in N."""
    x: float = 0.0
    """Position along the plate in m from its middle."""


class Sensing(NamedTuple):
    """Coefficients of the readings of one set of sensors."""

    x_to_S1: float
    x_to_S2: float
    node_x: float
    drift_temperature: float
    limit: int
    step: float
    """Step of the gauge converter in N."""
    pickup_step: float
    grain: float
    """Step of the thermometer in K."""
    gauges: tuple[Gauge, Gauge, Gauge, Gauge, Gauge, Gauge]
    gain_d: float
    """Gain of the direct axis of the pick-up, before its converter; 1 for a sound one."""
    gain_q: float
    """Gain of the quadrature axis of the pick-up, before its converter."""


def sensing(parameters: SensorParameters) -> Sensing:
    """Return the sensors with these parameters; the serial number seeds the data of the gauges."""
    p = parameters
    draws = default_rng([p.serial, _SERIAL_STREAM]).uniform(-1.0, 1.0, (5, 6))
    curvature = 4.0 * p.linearity / (p.span * p.span) if p.span else 0.0
    s1, s2, s3, s4, s5, s6 = (
        Gauge(
            p.null * null,
            p.drift * drift,
            curvature * bow,
            1.0 + p.sensitivity * error,
            p.sensitivity_shift * shift,
            p.repeatability / sqrt(3.0),
            0.0,
        )
        for null, drift, bow, error, shift in draws.T.tolist()
    )
    (xx, _), (yx, _) = p.crosstalk
    return Sensing(
        xx,
        yx,
        p.node_x,
        p.drift_temperature,
        p.full_scale,
        p.gauge_resolution,
        p.pickup_resolution,
        p.temperature_resolution,
        (s1, s2, s3, s4, s5, s6),
        1.0,
        1.0,
    )


def loaded(parameters: SensorParameters, weight: Weight) -> Sensing:
    """Return the sensors under a weight, which loads each gauge in addition to a finger."""
    Fx, Fy, Fn, x = weight
    (xx, xy), (yx, yy) = parameters.crosstalk
    lean = Fn * x / parameters.node_x
    left, right = 0.25 * (Fn - lean), 0.25 * (Fn + lean)
    loads = (xx * Fx + xy * Fy, yx * Fx + yy * Fy, left, right, left, right)
    bare = sensing(parameters)
    s1, s2, s3, s4, s5, s6 = (
        gauge._replace(weight=load) for gauge, load in zip(bare.gauges, loads, strict=True)
    )
    return bare._replace(gauges=(s1, s2, s3, s4, s5, s6))


def noise_block(parameters: SensorParameters, seed: int, block: int) -> NDArray[np.float64]:
    """Return the noise of ticks ``256 block`` to ``256 block + 255``, a row of 15 a tick, SI."""
    return _Block(parameters, seed, block).draw(NOISE_BLOCK)


class _Block:
    """Noise of a block of ticks; it does not depend on how many ticks are drawn at once."""

    __slots__ = ("_first", "_knots", "_rng", "_scale")

    def __init__(self, parameters: SensorParameters, seed: int, block: int) -> None:
        p = parameters
        self._scale = np.array([p.gauge_noise] * 6 + [p.pickup_noise] * 2 + [p.temperature_noise])
        self._rng = default_rng([seed, _NOISE_STREAM, block])
        self._first = block % REPEAT_BLOCKS * NOISE_BLOCK
        knot = block // REPEAT_BLOCKS
        self._knots = (
            np.array([_at_knot(seed, knot), _at_knot(seed, knot + 1)]) if p.repeatability else None
        )

    def draw(self, ticks: int) -> NDArray[np.float64]:
        """Return the next rows, a row of 15 per tick, in SI."""
        noise = np.zeros((ticks, CHANNELS))
        noise[:, :_WHITE] = self._rng.standard_normal((ticks, _WHITE)) * self._scale
        if self._knots is not None:
            ticks_on = np.arange(self._first, self._first + ticks)
            angle = ticks_on * (0.5 * pi / (REPEAT_BLOCKS * NOISE_BLOCK))
            noise[:, _WHITE:] = np.column_stack((np.cos(angle), np.sin(angle))) @ self._knots
        self._first += ticks
        return noise


def _at_knot(seed: int, knot: int) -> NDArray[np.float64]:
    """Return the errors of repeatability at a knot, six normal numbers.

    Between two knots they are mixed by sine and cosine, so that the variance is 1 at any tick.
    """
    return default_rng([seed, _REPEAT_STREAM, knot]).standard_normal(6)


def readings(
    sensing: Sensing,
    noise: Sequence[float],
    W: complex,
    temperature: float,
    forces: tuple[float, float, float],
) -> MeasurementFields:
    """Return the measurement of a tick.

    Parameters
    ----------
    sensing
        Coefficients of the sensors.
    noise
        Noise of S1..S6 in N, of the axes of the pick-up in m and of the thermometer in K, and the
        errors of repeatability of S1..S6 in standard deviations.
    W
        Vibration in m peak-to-peak.
    temperature
        Plate temperature in degC.
    forces
        Outputs of the force path: Fx and Fn in N, and the moment in N m, which is Fn times the
        position of the finger along x.
    """
    Fx, Fn, moment = forces
    (
        xx, yx, node_x, drift_temperature, limit, step, pickup_step, grain, gauges, gain_d, gain_q,
    ) = sensing  # fmt: skip
    g1, g2, g3, g4, g5, g6 = gauges
    lean = moment / node_x
    left = 0.25 * (Fn - lean)
    right = 0.25 * (Fn + lean)
    warmth = temperature - drift_temperature
    c1 = _count(g1, xx * Fx, warmth, noise[0], noise[9], step)
    c2 = _count(g2, yx * Fx, warmth, noise[1], noise[10], step)
    c3 = _count(g3, left, warmth, noise[2], noise[11], step)
    c4 = _count(g4, right, warmth, noise[3], noise[12], step)
    c5 = _count(g5, left, warmth, noise[4], noise[13], step)
    c6 = _count(g6, right, warmth, noise[5], noise[14], step)
    saturated = 0
    if not -limit < min(c1, c2, c3, c4, c5, c6) <= max(c1, c2, c3, c4, c5, c6) < limit:
        saturated = (
            _bit(c1, limit, 1)
            | _bit(c2, limit, 2)
            | _bit(c3, limit, 4)
            | _bit(c4, limit, 8)
            | _bit(c5, limit, 16)
            | _bit(c6, limit, 32)
        )
        c1, c2, c3 = _ended(c1, limit), _ended(c2, limit), _ended(c3, limit)
        c4, c5, c6 = _ended(c4, limit), _ended(c5, limit), _ended(c6, limit)
    d = floor((gain_d * W.real + noise[6]) / pickup_step + 0.5)
    q = floor((gain_q * W.imag + noise[7]) / pickup_step + 0.5)
    if not (-limit < d < limit and -limit < q < limit):
        saturated |= PICKUP_SATURATED
        d, q = _ended(d, limit), _ended(q, limit)
    return (
        complex(d * pickup_step, q * pickup_step),
        (c1 * step, c2 * step, c3 * step, c4 * step, c5 * step, c6 * step),
        floor((temperature + noise[8]) / grain + 0.5) * grain,
        saturated,
    )


def _count(
    gauge: Gauge, load: float, warmth: float, noise: float, repeat: float, step: float
) -> int:
    null, drift, bow, sensitivity, shift, scatter, weight = gauge
    load = (load + weight) * (sensitivity + shift * warmth + scatter * repeat)
    return floor((load + bow * load * load + null + drift * warmth + noise) / step + 0.5)


def _bit(count: int, limit: int, bit: int) -> int:
    return bit if abs(count) >= limit else 0


def _ended(count: int, limit: int) -> int:
    return max(-limit, min(limit, count))


class Noise:
    """The noise of one run; that of a tick is a function of seed and tick only.

    Parameters
    ----------
    parameters
        Parameters of the sensors.
    seed
        Seed of the noise, 0 or more.
    """

    __slots__ = ("_block", "_drawn", "_parameters", "_rows", "_seed", "_source")

    def __init__(self, parameters: SensorParameters, seed: int) -> None:
        require("seed", seed, 0, 2**63 - 1)
        self._parameters = parameters
        self._seed = seed
        self._block = 0
        self._source = _Block(parameters, seed, 0)
        self._rows: list[list[float]] = []
        self._drawn = 0

    def at(self, tick: int) -> Sequence[float]:
        """Return the noise of a tick, 0 or more, in the order for `readings`."""
        block, row = divmod(tick, NOISE_BLOCK)
        if block != self._block or row < self._drawn - _DRAW:
            self._source = _Block(self._parameters, self._seed, block)
            self._block = block
            self._drawn = 0
        while row >= self._drawn:
            self._rows = self._source.draw(_DRAW).tolist()
            self._drawn += _DRAW
        return self._rows[row % _DRAW]

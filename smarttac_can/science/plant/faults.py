"""Faults of the plate: the readings of a faulty sensor, the output of a faulty power stage."""

from __future__ import annotations

from dataclasses import replace
from math import floor
from typing import Final, NamedTuple, Protocol

from numpy.random import default_rng

from smarttac_can.science.plant.finger import Finger, FingerState
from smarttac_can.science.plant.parameters import PlateParameters, SensorParameters, require
from smarttac_can.vocabulary.faults import (
    GAUGES,
    PICKUP,
    PICKUP_D,
    PICKUP_Q,
    THERMOMETER,
    FaultKind,
    last_sensor,
    value_range,
)
from smarttac_can.vocabulary.signals import PICKUP_SATURATED, Measurement

_FAULT_STREAM: Final = 0x46
_PICKUPS: Final = (PICKUP_D, PICKUP_Q, PICKUP)
SOUND: Final = (1.0, 1.0)
"""Gains of a sound pick-up."""


class Fault(NamedTuple):
    """A fault of the plate."""

    kind: FaultKind
    sensor: int
    """Number of the sensor, 1..10; ignored for kinds that do not concern a sensor."""
    value: int
    """Size; its unit follows from kind and sensor."""

    def require_sense(self) -> None:
        """Raise ValueError if the sensor does not exist, or the value is invalid for the kind."""
        require("sensor", self.sensor, 1, last_sensor(self.kind))
        require(self.kind.name.lower(), self.value, *value_range(self.kind))


class Failing(Protocol):
    """Sensors with a failure."""

    def gains(self, tick: int) -> tuple[float, float]:
        """Return the gains of the axes of the pick-up, before their converters, at a tick."""

    def measure(self, tick: int, sound: Measurement) -> Measurement:
        """Return the measurement at a tick for the measurement of sound sensors."""


class PowerStage:
    """A simulated power stage, initially sound."""

    __slots__ = ("_stuck",)

    def __init__(self) -> None:
        self._stuck = 0.0

    def put_out(self, commanded: float) -> float:
        """Return the voltage at its output in V, as hardware would read it back.

        At 0 V the output is disconnected, so even a stuck stage is at 0 V.

        Parameters
        ----------
        commanded
            Commanded voltage in V, 0 or more.
        """
        return self._stuck if commanded and self._stuck else commanded

    def stick(self, voltage: float) -> None:
        """Put out a voltage in V for every command above 0 V; 0 removes the fault."""
        self._stuck = voltage


class SensorFault:
    """One faulty sensor; the others are unchanged.

    Its reading at a tick is a function of seed and tick, and for a stuck sensor of the reading at
    which it got stuck.

    Parameters
    ----------
    fault
        Fault of one of the sensors.
    parameters
        Range and resolution of the sensors.
    seed
        Seed of the noise, 0 or more.
    tick
        First tick with the fault.
    """

    __slots__ = ("_fault", "_full_scale", "_gains", "_held", "_seed", "_step", "_tick")

    def __init__(self, fault: Fault, parameters: SensorParameters, seed: int, tick: int) -> None:
        self._fault = fault
        self._gains = _gains(fault)
        self._seed = seed
        self._tick = tick
        self._held: float | None = None
        p = parameters
        self._full_scale = p.full_scale
        if fault.sensor <= GAUGES:
            self._step = p.gauge_resolution
        elif fault.sensor < THERMOMETER:
            self._step = p.pickup_resolution
        else:
            self._step = p.temperature_resolution

    def gains(self, _tick: int) -> tuple[float, float]:
        """Return the gains of the axes of the pick-up, before their converters."""
        return self._gains

    def measure(self, tick: int, sound: Measurement) -> Measurement:
        """Return the measurement at a tick for the measurement of sound sensors."""
        if _is_gain_of_pickup(self._fault):
            return sound
        W, gauges, temperature, saturated = sound
        sensor = self._fault.sensor
        if sensor <= GAUGES:
            value, limited = self._reading(tick, gauges[sensor - 1])
            bit = 1 << (sensor - 1)
            forces = list(gauges)
            forces[sensor - 1] = value
            s1, s2, s3, s4, s5, s6 = forces
            saturated = saturated & ~bit | (bit if limited else 0)
            return Measurement(W, (s1, s2, s3, s4, s5, s6), temperature, saturated)
        if sensor == THERMOMETER:
            return Measurement(W, gauges, self._reading(tick, temperature)[0], saturated)
        if sensor == PICKUP_D:
            value, limited = self._reading(tick, W.real)
            W = complex(value, W.imag)
        else:
            value, limited = self._reading(tick, W.imag)
            W = complex(W.real, value)
        if limited:
            saturated |= PICKUP_SATURATED
        return Measurement(W, gauges, temperature, saturated)

    def _reading(self, tick: int, sound: float) -> tuple[float, bool]:
        """Return the faulty reading in SI units, and whether it is at the end of the range."""
        step, limit = self._step, self._full_scale
        count = floor(self._disturbed(tick, sound) / step + 0.5)
        return max(-limit, min(limit, count)) * step, abs(count) >= limit

    def _disturbed(self, tick: int, sound: float) -> float:
        kind, sensor, value = self._fault
        if self._held is None:
            self._held = sound
        if kind is FaultKind.STUCK:
            return self._held
        if kind is FaultKind.SATURATED:
            end = self._full_scale * self._step
            return -end if value < 0 else end
        if kind is FaultKind.DEAD:
            return 0.0
        if kind is FaultKind.GAIN:
            return sound * value * 1e-3
        size = value * (1e-3 if sensor <= GAUGES else 1e-9 if sensor < THERMOMETER else 1e-2)
        if kind is FaultKind.NOISE:
            rng = default_rng([self._seed, _FAULT_STREAM, tick])
            return sound + size * float(rng.standard_normal())
        return sound + (size if kind is FaultKind.OFFSET or tick == self._tick else 0.0)


def _is_gain_of_pickup(fault: Fault) -> bool:
    return fault.kind is FaultKind.GAIN and fault.sensor in _PICKUPS


def _gains(fault: Fault) -> tuple[float, float]:
    if not _is_gain_of_pickup(fault):
        return SOUND
    gain = fault.value * 1e-3
    return (1.0 if fault.sensor == PICKUP_Q else gain, 1.0 if fault.sensor == PICKUP_D else gain)


class Slam:
    """A finger that presses harder than its motion prescribes.

    Parameters
    ----------
    finger
        Motion of the finger.
    force
        Additional normal force in N, 0 or more.
    """

    __slots__ = ("_finger", "_force")

    def __init__(self, finger: Finger, force: float) -> None:
        self._finger = finger
        self._force = force

    def at(self, time: float) -> FingerState:
        """Return the state at a time in s, 0 or more, from the start of the run."""
        x, Fn = self._finger.at(time)
        return FingerState(x, Fn + self._force)


def broken(parameters: PlateParameters, fault: Fault) -> PlateParameters:
    """Return the parameters of a plate with a shifted resonance or a reduced quality factor."""
    mode = parameters.resonator
    f0, tau = mode.f0, mode.tau
    if fault.kind is FaultKind.RESONANCE_SHIFT:
        f0 += fault.value
    elif fault.kind is FaultKind.QUALITY:
        tau *= fault.value * 1e-3
    # The electromechanical conversion is unchanged.
    gain = mode.gain * tau / mode.tau * mode.f0 / f0
    return replace(parameters, resonator=replace(mode, f0=f0, tau=tau, gain=gain))

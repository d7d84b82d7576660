"""The simulated plate with a finger on it: drive in, measurement out, one tick at a time."""

from __future__ import annotations

import math

from smarttac_can.plant.faults import Fault, SensorFault, Slam, broken, pickup_gains
from smarttac_can.plant.felt import Felt
from smarttac_can.plant.finger import Finger, FingerState
from smarttac_can.plant.force_path import ForcePath, Propagator, propagator
from smarttac_can.plant.friction import bare_friction
from smarttac_can.plant.mathematics import SCALAR
from smarttac_can.plant.parameters import TWO_PI, PlateParameters, require
from smarttac_can.plant.resonator import Resonator
from smarttac_can.plant.sensors import Sensors
from smarttac_can.plant.skin import Skin
from smarttac_can.plant.subjects import FORCE_REFERENCE, Subject
from smarttac_can.vocabulary.faults import SENSOR_KINDS, FaultKind
from smarttac_can.vocabulary.signals import TICK, Drive, Measurement

SUBSTEPS = 4
"""Sub-steps of a tick, by the convergence test."""
VOLTAGE_MAX = 1e3
"""Largest voltage in V that the power stage takes [A]."""
FREQUENCY_MAX = 1e6
"""Largest frequency in Hz that the power stage takes [A]."""
CONTACT_GROWTH = 2.0 / 3.0
"""Exponent of the contact area, and with it the finger's load on the mode, over force [L]."""


class Plate:
    """One run of the plate, from rest at ambient temperature at tick 0.

    Each tick is ``sample`` (once or more), then ``step``. The attributes hold the true values
    behind the sensors at the present tick, for tests and reports.

    Parameters
    ----------
    parameters
        The plate.
    subject
        The fingertip.
    finger
        Its motion.
    seed
        Seed of the sensor noise, 0 or more.
    ambient
        Ambient temperature in degC, -20..60.
    dead_time
        Time in s from the start of a tick to the instant at which the new drive comes into
        force, 0..0.001.

    Attributes
    ----------
    tick
        Ticks since the start of the run.
    temperature
        Temperature of the plate in degC.
    Ft
        Friction force on the plate in N.
    occlusion
        Degree of occlusion under the finger, 0..1.
    finger_state
        Position and normal force.

    Raises
    ------
    ValueError
        If an argument is outside its range.
    """

    __slots__ = (
        "Ft",
        "_ambient",
        "_felt",
        "_finger",
        "_moment",
        "_normal",
        "_normal_phi",
        "_parameters",
        "_pickup",
        "_resonator",
        "_seed",
        "_segments",
        "_sensor_fault",
        "_sensors",
        "_skin",
        "_sound",
        "_subject",
        "_tangential",
        "_warming",
        "_wetting",
        "finger_state",
        "occlusion",
        "temperature",
        "tick",
    )

    def __init__(
        self,
        parameters: PlateParameters,
        subject: Subject[float],
        finger: Finger,
        seed: int = 1,
        ambient: float = 20.0,
        dead_time: float = 0.0,
    ) -> None:
        require("ambient", ambient, -20.0, 60.0)
        require("dead_time", dead_time, 0.0, TICK)
        self._parameters = parameters
        self._subject = subject
        self._finger = finger
        self._ambient = ambient
        self._seed = seed
        self._sound = (parameters, finger, ambient)
        self._sensor_fault: SensorFault | None = None
        self._pickup: tuple[float, float] | None = None
        self._resonator = Resonator(parameters.resonator.mass)
        contact = parameters.contact
        self._felt = Felt(contact) if contact.film_lag or contact.ripple else None
        self._skin = Skin(SCALAR, subject, parameters.resonator.f0)
        self._sensors = Sensors(parameters.sensors, seed)
        self._tangential = ForcePath()
        self._normal = ForcePath()
        self._moment = ForcePath()
        self._segments = (self._segment(dead_time), self._segment(TICK - dead_time))
        self._normal_phi = self._path(TICK)
        self._warming = -math.expm1(-TICK / parameters.thermal.time_constant)
        self._wetting = -math.expm1(-TICK / subject.occlusion_time)
        self.tick = 0
        self.temperature = ambient
        self.Ft = 0.0
        self.occlusion = 0.0
        self.finger_state: FingerState = finger.at(0.0)

    def _path(self, duration: float) -> Propagator:
        sensors = self._parameters.sensors
        return propagator(duration, sensors.path_frequency, sensors.path_damping)

    def _segment(self, duration: float) -> tuple[int, float, Propagator]:
        """Divide a part of a tick: number and length of sub-steps, and the force path's step."""
        count = math.ceil(SUBSTEPS * duration / TICK - 1e-9)
        length = duration / count if count else 0.0
        return count, length, self._path(length)

    @property
    def W(self) -> complex:
        """Vibration W_d + jW_q in m peak-to-peak."""
        return self._resonator.W

    @property
    def mu_true(self) -> float:
        """COF under the finger; 0 while it is lifted."""
        Fn = self.finger_state.Fn
        return abs(self.Ft) / Fn if Fn > 0.0 else 0.0

    @property
    def position(self) -> float:
        """Position of the finger along x in m."""
        return self.finger_state.x

    @property
    def Fn(self) -> float:
        """Normal force in N."""
        return self.finger_state.Fn

    @property
    def resonance(self) -> float:
        """Resonance frequency in Hz at the present temperature, without the finger's load."""
        return self._parameters.resonator.resonance(self.temperature)

    def sample(self) -> Measurement:
        """Return what the sensors report at the present tick, always the same for one tick."""
        W = self._resonator.W
        if self._pickup is not None:
            d, q = self._pickup
            W = complex(d * W.real, q * W.imag)
        measurement = self._sensors.measure(
            self.tick,
            W,
            self.temperature,
            self._tangential.y,
            self._normal.y,
            self._moment.y,
        )
        if self._sensor_fault is None:
            return measurement
        return self._sensor_fault.measure(self.tick, measurement)

    def inject(self, fault: Fault) -> None:
        """Break something from the coming step on, instead of what was broken before.

        `FaultKind.NONE` mends it: another temperature is back at once, the plate goes on moving.

        Raises
        ------
        ValueError
            If there is no such fault; nothing has changed then.
        """
        fault.require_sense()
        if self._ambient != self._sound[2]:
            self.temperature = self._sound[2]
        self._parameters, self._finger, self._ambient = self._sound
        self._sensor_fault = None
        self._pickup = pickup_gains(fault)
        kind = fault.kind
        if kind in SENSOR_KINDS and self._pickup is None:
            self._sensor_fault = SensorFault(
                fault, self._parameters.sensors, self._seed, self.tick + 1
            )
        elif kind is FaultKind.SLAM:
            self._finger = Slam(self._finger, fault.value * 1e-3)
        elif kind is FaultKind.TEMPERATURE:
            self.temperature = self._ambient = fault.value * 1e-2
        elif kind in (FaultKind.RESONANCE_SHIFT, FaultKind.QUALITY):
            self._parameters = broken(self._parameters, fault)

    def step(self, old: Drive, new: Drive) -> None:
        """Advance by one tick, with the old drive for the dead time and then with the new one.

        Raises
        ------
        ValueError
            If a voltage is outside 0..1000 V or a frequency outside 0..1 MHz; the plate is then
            unchanged.
        """
        for voltage, frequency in (old, new):
            if not (0.0 <= voltage <= VOLTAGE_MAX and 0.0 <= frequency <= FREQUENCY_MAX):
                raise ValueError(
                    f"drive {voltage} V, {frequency} Hz is outside "
                    f"0..{VOLTAGE_MAX:g} V, 0..{FREQUENCY_MAX:g} Hz"
                )
        tick = self.tick + 1
        x0, Fn0 = self.finger_state
        finger_state = self._finger.at(tick * TICK)
        x1, Fn1 = finger_state
        v_bone = (x1 - x0) / TICK
        Fn = 0.5 * (Fn0 + Fn1)
        self._heat()
        if self._felt is not None:
            self._felt.place(0.5 * (x0 + x1))
        self.occlusion += ((1.0 if Fn > 0.0 else 0.0) - self.occlusion) * self._wetting
        before, after = self._segments
        if before[0]:
            self._advance(old, before, v_bone, Fn)
        if after[0]:
            self._advance(new, after, v_bone, Fn)
        self._normal.follow(self._normal_phi, (Fn,))
        self._moment.follow(self._normal_phi, (0.5 * (Fn0 * x0 + Fn1 * x1),))
        self.finger_state = finger_state
        self.tick = tick

    def _heat(self) -> None:
        p = self._parameters
        velocity = 0.5 * TWO_PI * p.resonator.f0 * abs(self._resonator.W)
        loss = 0.5 * p.resonator.damping * velocity * velocity
        target = self._ambient + p.thermal.resistance * loss
        self.temperature += (target - self.temperature) * self._warming

    def _advance(
        self, drive: Drive, segment: tuple[int, float, Propagator], v_bone: float, Fn: float
    ) -> None:
        count, length, phi = segment
        subject = self._subject
        mode = self._parameters.resonator
        load = (Fn / FORCE_REFERENCE) ** CONTACT_GROWTH
        if self._felt is not None:
            load *= self._felt.shape * self._felt.shape
        resonator = self._resonator
        resonator.drive(
            length,
            TWO_PI * drive.frequency,
            mode.conversion * drive.voltage,
            mode.damping + subject.load_damping * load,
            mode.stiffness(self.temperature) + subject.load_stiffness * load,
        )
        bare = bare_friction(SCALAR, subject, Fn, self.occlusion)
        before = abs(resonator.W)
        vibrations = []
        for W in resonator.steps(count):
            after = abs(W)
            vibrations.append(0.5 * (before + after))
            before = after
        if self._felt is not None:
            vibrations = self._felt.follow(length, vibrations)
        forces = self._skin.slide(length, vibrations, v_bone, bare)
        self._tangential.follow(phi, forces)
        self.Ft = forces[-1]

"""The simulated plate with a finger on it: drive in, measurement out, one tick at a time."""

from __future__ import annotations

from smarttac_can.science.plant.faults import SOUND, Failing, Fault, SensorFault, Slam, broken
from smarttac_can.science.plant.finger import Finger, FingerState
from smarttac_can.science.plant.motion import (
    PlatePlan,
    at_rest,
    coefficients,
    measured,
    plate_step,
    seen_W,
)
from smarttac_can.science.plant.parameters import PlateParameters, require
from smarttac_can.science.plant.sensors import Noise, Sensing, Weight, loaded, sensing
from smarttac_can.science.plant.subjects import Subject
from smarttac_can.vocabulary.faults import SENSOR_KINDS, FaultKind
from smarttac_can.vocabulary.signals import TICK, Drive, Measurement, MeasurementFields

VOLTAGE_MAX = 1e3
"""Largest voltage in V that the power stage takes [A]."""
FREQUENCY_MAX = 1e6
"""Largest frequency in Hz that the power stage takes [A]."""


class Plate:
    """One run of the plate, from rest at ambient temperature at tick 0.

    In each tick call ``sample`` (once or more), then ``step``. The attributes are the true values
    at the present tick, not the readings of the sensors, for tests and reports.

    Parameters
    ----------
    parameters
        Parameters of the plate.
    subject
        Fingertip.
    finger
        Motion of the finger.
    seed
        Seed of the sensor noise, 0 or more.
    ambient
        Ambient temperature in degC, -20..60.
    dead_time
        Time in s from the start of a tick until the new drive comes into force, 0..0.001.
    failing
        Sensors with a failure; None for sound ones.

    Attributes
    ----------
    tick
        Ticks since the start of the run.
    finger_state
        Position and normal force of the finger.

    Raises
    ------
    ValueError
        An argument is outside its range.
    """

    __slots__ = (
        "_ambient",
        "_dead_time",
        "_failing",
        "_finger",
        "_last",
        "_measurement",
        "_noise",
        "_parameters",
        "_plan",
        "_seed",
        "_sound",
        "_state",
        "_subject",
        "finger_state",
        "tick",
    )

    def __init__(
        self,
        parameters: PlateParameters,
        subject: Subject,
        finger: Finger,
        seed: int = 1,
        ambient: float = 20.0,
        dead_time: float = 0.0,
        *,
        failing: Failing | None = None,
    ) -> None:
        require("ambient", ambient, -20.0, 60.0)
        require("dead_time", dead_time, 0.0, TICK)
        self._parameters = parameters
        self._subject = subject
        self._finger = finger
        self._ambient = ambient
        self._dead_time = dead_time
        self._seed = seed
        self._sound = (parameters, finger, ambient)
        self._failing = failing
        self._noise = Noise(parameters.sensors, seed)
        self._plan = self._planned(sensing(parameters.sensors))
        self._state = at_rest(ambient)
        self._measurement: MeasurementFields | None = None
        self._last: Drive | None = None
        self.tick = 0
        self.finger_state: FingerState = finger.at(0.0)

    def _planned(self, sensors: Sensing) -> PlatePlan:
        made = coefficients(
            self._parameters,
            self._subject,
            ambient=self._ambient,
            dead_time=self._dead_time,
            sound_f0=self._sound[0].resonator.f0,
        )
        return PlatePlan(made, sensors)

    @property
    def W(self) -> complex:
        """Vibration W_d + jW_q in m peak-to-peak."""
        return self._state.motion.W

    @property
    def seen_W(self) -> complex:
        """Vibration that the pick-up sees, before its noise and faults, in m peak-to-peak."""
        return seen_W(self._plan.coefficients, self._state.motion)

    @property
    def temperature(self) -> float:
        """Temperature of the plate in degC."""
        return self._state.temperature

    @property
    def Ft(self) -> float:
        """Friction force on the plate in N."""
        return self._state.motion.Ft

    @property
    def occlusion(self) -> float:
        """Degree of occlusion under the finger, 0..1."""
        return self._state.occlusion

    @property
    def mu_true(self) -> float:
        """COF under the finger; 0 for a lifted finger."""
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

    @property
    def nulls(self) -> tuple[float, ...]:
        """Outputs of S1..S6 without a load at 20 degC, in N."""
        return tuple(gauge.null for gauge in sensing(self._parameters.sensors).gauges)

    def put(self, weight: Weight) -> None:
        """Replace the weight on the plate, with immediate effect."""
        self._plan = self._plan._replace(sensing=loaded(self._parameters.sensors, weight))
        self._measurement = None

    def sample(self) -> Measurement:
        """Return the measurement at the present tick, which is always the same for one tick."""
        if self._measurement is None:
            self._measurement = measured(
                self._plan_at(self.tick), self._state, self._noise.at(self.tick)
            )
        # This takes half the time of a named tuple's own constructor.
        measurement: Measurement = tuple.__new__(Measurement, self._measurement)
        if self._failing is None:
            return measurement
        return self._failing.measure(self.tick, measurement)

    def _plan_at(self, tick: int) -> PlatePlan:
        gains = SOUND if self._failing is None else self._failing.gains(tick)
        if gains == SOUND:
            return self._plan
        gain_d, gain_q = gains
        sensors = self._plan.sensing._replace(gain_d=gain_d, gain_q=gain_q)
        return self._plan._replace(sensing=sensors)

    def inject(self, fault: Fault) -> None:
        """Inject a fault from the coming step on, which replaces the present fault.

        `FaultKind.NONE` removes the fault. A changed temperature is reset at once; the motion of
        the plate continues.

        Raises
        ------
        ValueError
            The fault is invalid; nothing is then changed.
        """
        fault.require_sense()
        if self._ambient != self._sound[2]:
            self._state = self._state._replace(temperature=self._sound[2])
        self._parameters, self._finger, self._ambient = self._sound
        self._failing = None
        kind = fault.kind
        if kind in SENSOR_KINDS:
            self._failing = SensorFault(fault, self._parameters.sensors, self._seed, self.tick + 1)
        elif kind is FaultKind.SLAM:
            self._finger = Slam(self._finger, fault.value * 1e-3)
        elif kind is FaultKind.TEMPERATURE:
            self._ambient = fault.value * 1e-2
            self._state = self._state._replace(temperature=self._ambient)
        elif kind in (FaultKind.RESONANCE_SHIFT, FaultKind.QUALITY):
            self._parameters = broken(self._parameters, fault)
        self._plan = self._planned(self._plan.sensing)
        self._measurement = None

    def step(self, old: Drive, new: Drive) -> None:
        """Advance by one tick, with the old drive for the dead time and then with the new one.

        Raises
        ------
        ValueError
            A voltage is outside 0..1000 V or a frequency outside 0..1 MHz; the plate is then
            unchanged.
        """
        _require_possible(new)
        if old is not self._last:
            _require_possible(old)
        tick = self.tick + 1
        finger_state = self._finger.at(tick * TICK)
        self._state, self._measurement = plate_step(
            self._plan_at(tick),
            self._state,
            (old, new),
            (self.finger_state, finger_state),
            self._noise.at(tick),
        )
        self.finger_state = finger_state
        self.tick = tick
        self._last = new


def _require_possible(drive: Drive) -> None:
    voltage, frequency = drive
    if not (0.0 <= voltage <= VOLTAGE_MAX and 0.0 <= frequency <= FREQUENCY_MAX):
        raise ValueError(
            f"drive {voltage} V, {frequency} Hz is outside "
            f"0..{VOLTAGE_MAX:g} V, 0..{FREQUENCY_MAX:g} Hz"
        )

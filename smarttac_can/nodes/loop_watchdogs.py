"""The watchdogs that look at every measurement and drive of the loop."""

from __future__ import annotations

from collections.abc import Sequence
from math import exp, hypot, isfinite
from operator import eq
from typing import Final

from smarttac_can.control.cascade import Cascade, Mode
from smarttac_can.control.parameters import CascadeParameters
from smarttac_can.control.tribometer import DETERMINANT_MIN
from smarttac_can.control.vibration import AMPLITUDE_MIN
from smarttac_can.nodes.cycle_input import SENSORS, Measured
from smarttac_can.nodes.loop_period import SHORT_DEADLINE_MS
from smarttac_can.nodes.settings import lateral_calibration
from smarttac_can.nodes.watchdogs import (
    AMPLITUDE_CYCLES,
    EXCESS_CYCLES,
    GAUGE_CYCLES,
    RESONANCE_CYCLES,
    SATURATED_CYCLES,
    SILENT_CYCLES,
    STUCK_GAUGE_CYCLES,
    STUCK_THERMOMETER_CYCLES,
    Watchdog,
)
from smarttac_can.od.dictionary import Entry, ObjectDictionary
from smarttac_can.signals import TICK, Drive

_PLATE_END: Final = 0.038
"""End of the plate in m from its middle: a finger presses no farther out."""
_FRICTION_MAX: Final = 2.0
"""Largest Ft/Fn a finger can have; that of a wet one is near 1.5."""
_EXCESS: Final = 1.5
"""Largest ratio of the vibration to that of the model: fingers and detuning only lower it."""
_EXCESS_UNIDENTIFIED: Final = 5.0
"""Largest such ratio while the model is still to be identified."""
_EXCESS_OFFSET: Final = 100e-9
"""Vibration in m that needs no voltage: noise, and the tail of one that dies down."""
_WEIGHT: Final = 2
"""How much a faulty cycle adds to a count, from which a sound one takes 1 away: two sound cycles
undo a faulty one."""
_MOST: Final = 2 * _WEIGHT * AMPLITUDE_CYCLES
"""Highest count: a fault that is gone is forgotten soon, however long it lasted."""
_SILENCE: Final = 0.05
"""Lowest ratio of the vibration to that of the model; 0.2 at the ends of the frequency range."""
_SILENCE_FROM: Final = 200e-9
"""Vibration of the model in m from which a plate that does not vibrate is noticed."""
_NO_PLATE: Final = 0
_THERMOMETER: Final = SENSORS.index("Temperature")
_TRACKED: Final = (Mode.AMPLITUDE_RESONANCE, Mode.FRICTION)
_BITS: Final = {watchdog: 1 << watchdog for watchdog in Watchdog}
_VOLTAGE = _BITS[Watchdog.VOLTAGE]
_CONTROLLER = _BITS[Watchdog.CONTROLLER]
_AMPLITUDE = _BITS[Watchdog.AMPLITUDE]
_TEMPERATURE = _BITS[Watchdog.TEMPERATURE]
_NORMAL = _BITS[Watchdog.NORMAL_FORCE]
_LATERAL = _BITS[Watchdog.LATERAL_FORCE]
_SATURATED = _BITS[Watchdog.SATURATED]
_STUCK = _BITS[Watchdog.STUCK]
_GAUGES = _BITS[Watchdog.GAUGES]
_PICKUP = _BITS[Watchdog.PICKUP]
_RESONANCE = _BITS[Watchdog.RESONANCE]
_CALIBRATION = _BITS[Watchdog.CALIBRATION]


class LoopWatchdogs:
    """Counters and limits of one loop; `configure` takes over objects that have changed.

    Parameters
    ----------
    od
        Object dictionary of ``stimulator.eds``.
    deadlines
        Event timers in ms of the measurements that come over a bus; empty with the plate inside.
        By as much as they are above 3 ms a drive may be late, and what the vibration should follow
        from is not in force.
    """

    __slots__ = (
        "_E",
        "_Fn_max",
        "_Ft_max",
        "_V",
        "_W_trip",
        "_above",
        "_deadlines",
        "_decay",
        "_detuned",
        "_excess",
        "_gain",
        "_last",
        "_mismatch",
        "_od",
        "_odd",
        "_repeats",
        "_saturated",
        "_serial",
        "_silent",
        "_temperature_max",
    )

    def __init__(self, od: ObjectDictionary, deadlines: Sequence[Entry] = ()) -> None:
        self._od = od
        self._deadlines = deadlines
        self.configure()
        self.reset()

    def configure(self) -> None:
        """Read limits, model and calibration."""
        od = self._od
        self._W_trip = od["Limit.Amplitude trip"].si_value
        self._temperature_max = od["Limit.Temperature"].si_value
        self._Fn_max = od["Limit.Normal force"].si_value
        self._Ft_max = od["Limit.Lateral force"].si_value
        self._mismatch = od["Limit.Gauge mismatch"].si_value
        self._gain = od["Model.Gain per volt"].si_value
        self._decay = exp(-TICK / od["Model.Tau"].si_value)
        (xx, xy), (yx, yy) = lateral_calibration(od)
        told_apart = abs(xx * yy - xy * yx) >= DETERMINANT_MIN
        # By another one a lateral force may read as none.
        self._serial = od["Calibration.Plate serial number"].value if told_apart else _NO_PLATE

    def reset(self) -> None:
        """Forget what was seen: the plate is at rest."""
        self._E = self._V = 0.0
        self._last: tuple[int, ...] = ()
        self._repeats = [0] * 9
        self._above = self._saturated = self._odd = self._excess = self._silent = self._detuned = 0

    def judge(self, drive: Drive, parameters: CascadeParameters) -> int:
        """Look at a drive before it goes out; return bits, 0 for a sound one."""
        voltage, frequency = drive
        p = parameters
        if not (isfinite(voltage) and voltage >= 0.0 and p.f_min <= frequency <= p.f_max):
            return _CONTROLLER
        return _VOLTAGE if voltage > p.V_max else 0

    def look(self, measured: Measured, mode: int, cascade: Cascade) -> int:
        """Look at a cycle.

        Parameters
        ----------
        measured
            What the plate has measured.
        mode
            Mode in which the controllers were asked in this cycle.
        cascade
            The controllers after the cycle.

        Returns
        -------
        int
            Faults that are present, as bits.
        """
        W, gauges, temperature, saturation = measured.si
        serial = measured.serial
        faults = 0
        if serial != self._serial or serial == _NO_PLATE:
            faults |= _CALIBRATION
        if temperature > self._temperature_max:
            faults |= _TEMPERATURE
        self._saturated = _counted(self._saturated, bool(saturation))
        if self._saturated >= _WEIGHT * SATURATED_CYCLES:
            faults |= _SATURATED
        if self._stuck(measured.counts):
            faults |= _STUCK
        if cascade.tribometer.tared:
            faults |= self._forces(gauges, cascade)
        return faults | self._vibration(W, abs(W), mode)

    def note_voltage(self, voltage: float) -> None:
        """Remember the voltage in V that is in force until the next measurement."""
        self._V = voltage

    def _stuck(self, sensors: tuple[int, ...]) -> bool:
        """Count samples that are the same as before, although noise makes them differ."""
        repeats = self._repeats
        stuck = False
        for at, same in enumerate(map(eq, sensors, self._last)):
            if same:
                repeats[at] += 1
                if repeats[at] >= STUCK_GAUGE_CYCLES - 1:
                    stuck |= at != _THERMOMETER or repeats[at] >= STUCK_THERMOMETER_CYCLES - 1
            else:
                repeats[at] = 0
        self._last = sensors
        return stuck

    def _forces(
        self, gauges: tuple[float, float, float, float, float, float], cascade: Cascade
    ) -> int:
        faults = 0
        contact = cascade.contact
        Fn = contact.Fn
        Ft = hypot(contact.Fx, contact.Fy)
        if Fn > self._Fn_max:
            faults = _NORMAL
        if Ft > self._Ft_max:
            faults |= _LATERAL
        _, _, o3, o4, o5, o6 = cascade.tribometer.offsets
        _, _, s3, s4, s5, s6 = gauges
        s3 -= o3
        s4 -= o4
        s5 -= o5
        s6 -= o6
        x3, x4, x5, x6 = cascade.parameters.gauge_positions
        mismatch = self._mismatch
        load = Fn if Fn > 0.0 else 0.0
        # A rigid plate rests on its diagonals alike, wherever the finger is.
        if (
            abs(s3 - s4 - s5 + s6) > mismatch
            or abs(x3 * s3 + x4 * s4 + x5 * s5 + x6 * s6) > _PLATE_END * (load + mismatch)
            or Fn < -mismatch
            or Ft > _FRICTION_MAX * load + mismatch
        ):
            self._odd += 1
            if self._odd >= GAUGE_CYCLES:
                faults |= _GAUGES
        else:
            self._odd = 0
        return faults

    def _vibration(self, W: complex, amplitude: float, mode: int) -> int:
        faults = 0
        driven = self._gain * self._V
        # No detuning and no finger makes the plate vibrate more than at its bare resonance.
        self._E = E = driven + (self._E - driven) * self._decay
        self._above = _counted(self._above, amplitude > self._W_trip)
        if self._above >= _WEIGHT * AMPLITUDE_CYCLES:
            faults = _AMPLITUDE
        most = _EXCESS_UNIDENTIFIED if mode == Mode.IDENTIFY else _EXCESS
        excess = amplitude > most * E + _EXCESS_OFFSET
        silent = E > _SILENCE_FROM and amplitude < _SILENCE * E
        self._silent = self._silent + 1 if silent else 0
        if excess or silent or self._excess:
            late = self._late_cycles()
            needed = _WEIGHT * (EXCESS_CYCLES + late)
            self._excess = _counted(self._excess, excess, _MOST + _WEIGHT * late)
            if self._excess >= needed or self._silent >= SILENT_CYCLES + late:
                faults |= _PICKUP
        if mode not in _TRACKED:
            self._detuned = 0
        elif amplitude > AMPLITUDE_MIN:
            # Without a vibration nobody knows: a friction loop that pauses hides nothing.
            self._detuned = self._detuned + 1 if abs(W.imag) > W.real else 0
        if self._detuned >= RESONANCE_CYCLES:
            faults |= _RESONANCE
        return faults

    def _late_cycles(self) -> int:
        if not self._deadlines:
            return 0
        shortest = int(min(entry.value for entry in self._deadlines))
        return max(0, shortest - SHORT_DEADLINE_MS)


def _counted(count: int, faulty: bool, most: int = _MOST) -> int:
    """Return the count after a cycle; one sound cycle does not make up for a faulty one.

    A controller that answers a wrong reading may make every other cycle look right.
    """
    if faulty:
        return min(count + _WEIGHT, most)
    return count - 1 if count else 0

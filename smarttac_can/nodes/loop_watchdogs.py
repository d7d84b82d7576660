"""The watchdogs that look at every measurement and drive of the loop."""

from __future__ import annotations

from collections.abc import Sequence
from math import hypot, isfinite
from typing import Final

from smarttac_can.control.cascade import Cascade
from smarttac_can.control.parameters import CascadeParameters
from smarttac_can.control.tribometer import DETERMINANT_MIN
from smarttac_can.nodes.cycle_input import SENSORS, Measured
from smarttac_can.nodes.lapses import Lapses
from smarttac_can.nodes.plate_block import TICK_MASK
from smarttac_can.nodes.settings import lateral_calibration
from smarttac_can.nodes.vibration_watch import VibrationWatch
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.od.entry import Entry
from smarttac_can.vocabulary.levels import level
from smarttac_can.vocabulary.signals import Drive
from smarttac_can.vocabulary.watchdogs import (
    GAUGE_CYCLES,
    SATURATED_CYCLES,
    STUCK_GAUGE_CYCLES,
    STUCK_THERMOMETER_CYCLES,
    STUCK_WITHIN,
    Watchdog,
)

_PLATE_END: Final = 0.038
"""End of the plate in m from its middle: a finger presses no farther out."""
_FRICTION_MAX: Final = 2.0
"""Largest Ft/Fn a finger can have; that of a wet one is near 1.5."""
_GAP_MAX: Final = TICK_MASK // 2
"""Most ticks between two measurements: more are a step back, as where a plate starts anew."""
WATCHED: Final = ("Limit", "Model", "Calibration")
"""Records that `LoopWatchdogs.configure` reads."""
_NO_PLATE: Final = 0
_STUCK_RULES: Final = tuple(
    (at, 0, STUCK_THERMOMETER_CYCLES)
    if name == "Temperature"
    else (at, STUCK_WITHIN, STUCK_GAUGE_CYCLES)
    for at, name in enumerate(SENSORS)
)
"""Place of each sensor, and how many samples within how many counts of the first are a fault."""
_BITS: Final = {watchdog: 1 << watchdog for watchdog in Watchdog}
_VOLTAGE = _BITS[Watchdog.VOLTAGE]
_CONTROLLER = _BITS[Watchdog.CONTROLLER]
_TEMPERATURE = _BITS[Watchdog.TEMPERATURE]
_NORMAL = _BITS[Watchdog.NORMAL_FORCE]
_LATERAL = _BITS[Watchdog.LATERAL_FORCE]
_SATURATED = _BITS[Watchdog.SATURATED]
_STUCK = _BITS[Watchdog.STUCK]
_GAUGES = _BITS[Watchdog.GAUGES]
_CALIBRATION = _BITS[Watchdog.CALIBRATION]


class LoopWatchdogs:
    """Counters and limits of one loop; `configure` takes over objects that have changed.

    Parameters
    ----------
    od
        Object dictionary of ``stimulator.eds``.
    deadlines
        As for `VibrationWatch`.

    Attributes
    ----------
    vibration
        Those of the vibration.
    """

    __slots__ = (
        "_Fn_max",
        "_Ft_max",
        "_mismatch",
        "_od",
        "_odd",
        "_rests",
        "_rests_at",
        "_saturated",
        "_serial",
        "_temperature",
        "_temperature_max",
        "_tick",
        "_zero",
        "vibration",
    )

    def __init__(self, od: ObjectDictionary, deadlines: Sequence[Entry] = ()) -> None:
        self._od = od
        self._temperature = od["Plate input.Temperature"]
        self.vibration = VibrationWatch(od, deadlines)
        self.configure()
        self.reset()

    def configure(self) -> None:
        """Read limits, model and calibration."""
        od = self._od
        self.vibration.configure()
        self._temperature_max = od["Limit.Temperature"].si_value
        self._Fn_max = od["Limit.Normal force"].si_value
        self._Ft_max = od["Limit.Lateral force"].si_value
        self._mismatch = od["Limit.Gauge mismatch"].si_value
        (xx, xy), (yx, yy) = lateral_calibration(od)
        told_apart = abs(xx * yy - xy * yx) >= DETERMINANT_MIN
        # By another one a lateral force may read as none.
        self._serial = od["Calibration.Plate serial number"].value if told_apart else _NO_PLATE

    def reset(self) -> None:
        """Forget what was seen: the plate is at rest."""
        self.vibration.reset()
        self._tick = TICK_MASK
        self._rests_at = [0] * len(SENSORS)
        self._rests = [0] * len(SENSORS)
        self._saturated = Lapses()
        self._odd = Lapses()
        self._zero: tuple[float, ...] = ()

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
        if self._saturated.count(bool(saturation), SATURATED_CYCLES):
            faults |= _SATURATED
        if self._stuck(measured.counts):
            faults |= _STUCK
        if cascade.tared:
            faults |= self._forces(gauges, cascade)
        # A measurement that is lost or passed over is time for the vibration all the same.
        ticks = measured.tick - self._tick & TICK_MASK
        self._tick = measured.tick
        if ticks > _GAP_MAX:
            ticks = 1
        return faults | self.vibration.look(W, cascade.contact, temperature, mode, ticks)

    def levels(self, cascade: Cascade) -> tuple[float, float, float, float, float, float, float]:
        """How near to a fault the loop is after a cycle, of 1.0.

        Parameters
        ----------
        cascade
            The controllers after the cycle.

        Returns
        -------
        tuple
            Voltage, temperature (in degC), normal force, lateral force, saturated sensors, a stuck
            one, and gauges that contradict each other.
        """
        contact = cascade.contact
        temperature = self._temperature
        return (
            level(self.vibration.voltage, cascade.parameters.V_max),
            level(temperature.value * temperature.si, self._temperature_max),
            contact.Fn / self._Fn_max,
            hypot(contact.Fx, contact.Fy) / self._Ft_max,
            self._saturated.share(SATURATED_CYCLES),
            max(self._rests[at] / most for at, _, most in _STUCK_RULES),
            self._odd.share(GAUGE_CYCLES),
        )

    def _stuck(self, sensors: tuple[int, ...]) -> bool:
        """Count samples that rest where they were, although noise moves those of a sound sensor.

        In a row: noise repeats single samples of a sound sensor, which would add up.
        """
        rests_at, rests = self._rests_at, self._rests
        stuck = False
        for at, within, most in _STUCK_RULES:
            value = sensors[at]
            if -within <= value - rests_at[at] <= within:
                rests[at] += 1
                if rests[at] >= most:
                    stuck = True
            else:
                rests_at[at] = value
                rests[at] = 1
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
        offsets = cascade.zero
        if offsets != self._zero:
            # What contradicted each other was the old zero.
            self._zero = offsets
            self._odd.clear()
        _, _, o3, o4, o5, o6 = offsets
        _, _, s3, s4, s5, s6 = gauges
        s3 -= o3
        s4 -= o4
        s5 -= o5
        s6 -= o6
        x3, x4, x5, x6 = cascade.parameters.gauge_positions
        mismatch = self._mismatch
        load = Fn if Fn > 0.0 else 0.0
        # A rigid plate rests on its diagonals alike, wherever the finger is.
        odd = (
            abs(s3 - s4 - s5 + s6) > mismatch
            or abs(x3 * s3 + x4 * s4 + x5 * s5 + x6 * s6) > _PLATE_END * (load + mismatch)
            or Fn < -mismatch
            or Ft > _FRICTION_MAX * load + mismatch
        )
        if self._odd.count(odd, GAUGE_CYCLES):
            faults |= _GAUGES
        return faults

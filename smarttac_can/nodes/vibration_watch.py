"""The watchdogs of the vibration: what the pick-up reads, and what the drive says it must be.

In the frame of the drive voltage a plate with gain K, time constant tau, resonance w0 and a finger
that multiplies its damping by D follows ``W' = lambda W + (K/tau) V`` with ``lambda = -D/tau +
j (w0 - w)``, so that it settles at ``K V/sqrt(D^2 + (tau (w0 - w))^2)``. Two bounds follow from it:

* **From above**, which takes nothing from the pick-up: the least D that any finger has at the
  measured normal force, and of all resonances that model, thermometer and finger leave possible the
  one nearest to the drive. What this bound may reach limits the voltage before it goes out.
* **From below**, what the pick-up has to read at least: the largest D, and the resonance that is
  farthest away.

Neither waits until the vibration has settled: a friction loop may drive in pulses that are shorter.
Before an identification nobody knows where the resonance is. The bound from above then takes it to
be where the drive is, and the one from below takes the phase that the pick-up reads.
"""

from __future__ import annotations

from cmath import exp as exp_j
from collections.abc import Sequence
from math import exp, nan, pi, sqrt
from typing import Final

from smarttac_can.control.vibration import AMPLITUDE_MIN
from smarttac_can.nodes.hard_caps import AMPLITUDE_TRIP_MAX
from smarttac_can.nodes.lapses import Lapses
from smarttac_can.nodes.loop_period import shortest_ms
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.od.entry import Entry
from smarttac_can.vocabulary.model import F0_SLOPE, contact_load
from smarttac_can.vocabulary.modes import Mode
from smarttac_can.vocabulary.signals import SHORT_DEADLINE_MS, TICK, Contact, Drive
from smarttac_can.vocabulary.states import IdentificationState
from smarttac_can.vocabulary.watchdogs import (
    AMPLITUDE_CYCLES,
    EXCESS_CYCLES,
    LACK_CYCLES,
    RESONANCE_CYCLES,
    SILENT_CYCLES,
    UNSEEN_CYCLES,
    Watchdog,
)

LEAST_LOAD: Final = 0.40
MOST_LOAD: Final = 1.60
"""Damping that a finger adds at 0.5 N, over that of the bare plate, at least and at most; an
assumption wider than all fingertips of the simulation, 0.47 to 1.32."""
MOST_STIFFENING: Final = 12.0
"""By how many Hz a finger of 0.5 N raises the resonance at most; an assumption wider than the
8.8 Hz of the simulation."""
THERMOMETER_UNCERTAINTY: Final = 1.0
"""Uncertainty of the thermometer in K. At 140 Hz off the resonance a kelvin is 4 % of the
vibration."""
_F0_UNCERTAINTY: Final = 2.0
"""Uncertainty in Hz of a resonance that was identified."""
_RESONANCE_UNCERTAINTY: Final = _F0_UNCERTAINTY - F0_SLOPE * THERMOMETER_UNCERTAINTY
"""Uncertainty in Hz of the resonance of an identified plate without a finger."""
_FORCE_UNCERTAINTY: Final = 0.05
"""Uncertainty of the normal force in N: noise, and drift since the tare."""
_FORCE_TOLERANCE: Final = 0.1
"""The same as a fraction: slope and bow of the gauges."""
_EXCESS: Final = 1.5
"""Largest ratio of the vibration to that of the model: fingers and detuning only lower it."""
_EXCESS_UNIDENTIFIED: Final = 3.0
"""Largest such ratio while the model is still to be identified."""
_EXCESS_OFFSET: Final = 100e-9
"""Vibration in m that needs no voltage: noise, and the tail of one that dies down."""
_LACK: Final = 0.8
"""Lowest ratio of the vibration to the least that model, phase and finger allow."""
_SILENCE: Final = 0.05
"""Lowest ratio of the vibration to that of the model; 0.2 at the ends of the frequency range."""
_LOOKED_FOR: Final = 200e-9
"""Vibration of the model in m from which its absence is looked for."""
_PHASE_FROM: Final = 20e-9
"""Vibration in m from which its phase tells the detuning: noise is 1 nm."""
_PHASE_MIN: Final = 0.05
"""Cosine of the phase, at least; at the ends of the frequency range it is 0.13."""
_HOP: Final = 10.0
"""Change in Hz from one drive to the next after which the vibration turns to a new phase, perhaps
through 0."""
_TURNING_CYCLES: Final = 8
"""How long that takes, in cycles: the phase tells nothing until then."""
_TWO_PI: Final = 2.0 * pi
_ROUNDING: Final = 1.0 + 1e-9
"""A bound that a voltage was cut to may miss its limit by the last bits."""
_IDENTIFIED: Final = IdentificationState.DONE
_IDENTIFY: Final = Mode.IDENTIFY
_OPEN_LOOP: Final = Mode.OPEN_LOOP
"""The mode in which the frequency may hop; a loop that hunts in frequency is no excuse."""
_UNJUDGED: Final = (Mode.OFF, Mode.IDENTIFY)
"""Modes in which nothing is missed: there is no voltage, or no model yet."""
_TRACKED: Final = (Mode.AMPLITUDE_RESONANCE, Mode.FRICTION, Mode.TEXTURE)
_AMPLITUDE: Final = 1 << Watchdog.AMPLITUDE
_PICKUP: Final = 1 << Watchdog.PICKUP
_RESONANCE: Final = 1 << Watchdog.RESONANCE
_UNSEEN: Final = 1 << Watchdog.UNSEEN


class DriveBound:
    """Vibration that the drive may make of the plate at most, and the voltage that limits it.

    A drive is taken to hold from its measurement to the next one, whatever the dead time is.

    Parameters
    ----------
    od
        Object dictionary of ``stimulator.eds``.
    """

    __slots__ = (
        "_D",
        "_W",
        "_asked",
        "_bare_limit",
        "_f0",
        "_found_at",
        "_gain",
        "_held",
        "_high",
        "_limit",
        "_low",
        "_model_state",
        "_od",
        "_response",
        "_response_asked",
        "_tau",
        "_touching",
        "_voltage",
    )

    def __init__(self, od: ObjectDictionary) -> None:
        self._od = od
        self._model_state = od["Model.State"]
        self.configure()
        self.reset()

    @property
    def size(self) -> float:
        """The bound at the last measurement, in m peak-to-peak."""
        return abs(self._W)

    @property
    def exceeded(self) -> bool:
        """Whether the bound is above what it may reach under a finger.

        `allowed` sees to it that drives which come in time never do that; late ones may.
        """
        return abs(self._W) > self._limit * _ROUNDING

    @property
    def identified(self) -> bool:
        """Whether the model is that of an identification, so that its resonance is known."""
        return bool(self._model_state.value == _IDENTIFIED)

    def configure(self) -> None:
        """Read limits, model and data sheet."""
        od = self._od
        self._limit = od["Limit.Amplitude by drive"].si_value
        self._bare_limit = min(AMPLITUDE_TRIP_MAX, self._limit)
        # A written model may be that of a plate whose pick-up reads too little.
        tolerance = od["Model.Data sheet tolerance"].si_value
        gain, tau = od["Model.Data sheet gain per volt"], od["Model.Data sheet tau"]
        self._gain = max(od["Model.Gain per volt"].si_value, (1.0 - tolerance) * gain.si_value)
        least, most = (1.0 - tolerance) * tau.si_value, (1.0 + tolerance) * tau.si_value
        self._tau = min(max(od["Model.Tau"].si_value, least), most)
        self._f0 = od["Model.Resonance"].si_value
        self._found_at = od["Model.Temperature"].si_value
        self._asked = nan

    def reset(self) -> None:
        """Forget what was driven: the plate is at rest, without a finger."""
        self._W = 0j
        self._voltage = 0.0
        self._response = self._held = self._response_asked = (0j, 0j)
        self._D = 1.0
        self._touching = False
        self._low = self._high = self._f0
        self._asked = nan

    def follow(self, contact: Contact, temperature: float, ticks: int) -> None:
        """Bring the bound up to date with the drive in force, and take finger and warmth.

        Parameters
        ----------
        contact
            The finger in this cycle.
        temperature
            Of the plate in degC.
        ticks
            For which the drive was in force, 1 or more.
        """
        left, per_volt = self._response
        W, V = self._W, self._voltage
        for _ in range(ticks):
            W = left * W + per_volt * V
        self._W = W
        self._touching = touching = contact.touching
        Fn = contact.Fn if contact.Fn > 0.0 else 0.0
        self._D = 1.0 + LEAST_LOAD * contact_load(least_force(Fn) if touching else 0.0)
        f0 = self._f0 + F0_SLOPE * (temperature - self._found_at)
        self._low = f0 - _RESONANCE_UNCERTAINTY
        self._high = f0 + _RESONANCE_UNCERTAINTY + MOST_STIFFENING * contact_load(most_force(Fn))
        self._asked = nan

    def allowed(self, drive: Drive) -> Drive:
        """Return a drive with its voltage cut to what keeps the bound within its limit.

        That is 3.27 um, the end of the pick-up's range, without contact, and
        ``Limit.Amplitude by drive`` under a finger, which may damp more than the least.
        """
        V, f = drive
        left, per_volt = self._response_to(f)
        limit = self._limit if self._touching else self._bare_limit
        free = left * self._W
        W = free + per_volt * V
        if W.real * W.real + W.imag * W.imag <= limit * limit:
            return drive
        over = free.real * free.real + free.imag * free.imag - limit * limit
        if over >= 0.0:
            return Drive(0.0, f)
        # |free + per_volt V|^2 = limit^2
        square = per_volt.real * per_volt.real + per_volt.imag * per_volt.imag
        half = free.real * per_volt.real + free.imag * per_volt.imag
        return Drive((sqrt(half * half - square * over) - half) / square, f)

    def note(self, drive: Drive, most: float, *, doubtful: bool, late: bool) -> None:
        """Take the drive that is in force until the next measurement.

        Parameters
        ----------
        drive
            As it went out.
        most
            The largest voltage in V that may be in force.
        doubtful
            Whether a drive before may be in force as well.
        late
            Whether one may be when the next drive has come.
        """
        response = asked = self._response_to(drive.frequency)
        if doubtful and abs(self._held[1]) > abs(response[1]):
            response = self._held
        self._response, self._voltage = response, most
        self._held = response if late else asked

    def least_share(self, frequency: float, damping: float) -> float:
        """Return which share of its vibration at resonance the plate has at least, 0..1.

        Parameters
        ----------
        frequency
            Of the drive in Hz.
        damping
            Of plate and finger over that of the plate.
        """
        off = max(abs(frequency - self._low), abs(frequency - self._high))
        x = _TWO_PI * off * self._tau / damping
        return 1.0 / sqrt(1.0 + x * x)

    def _response_to(self, frequency: float) -> tuple[complex, complex]:
        """Return what is left of a vibration after a tick at a frequency, and what a volt adds."""
        if frequency == self._asked:
            return self._response_asked
        off = 0.0
        if self.identified:
            if frequency < self._low:
                off = self._low - frequency
            elif frequency > self._high:
                off = self._high - frequency
        turn = complex(-self._D / self._tau, _TWO_PI * off)
        left = exp_j(turn * TICK)
        self._asked = frequency
        self._response_asked = left, self._gain / self._tau * (left - 1.0) / turn
        return self._response_asked


def least_force(Fn: float) -> float:
    """Return the least normal force in N that a reading of 0 N or more may stand for."""
    return (1.0 - _FORCE_TOLERANCE) * Fn - _FORCE_UNCERTAINTY


def most_force(Fn: float) -> float:
    """Return the largest normal force in N that a reading of 0 N or more may stand for."""
    return (1.0 + _FORCE_TOLERANCE) * Fn + _FORCE_UNCERTAINTY


class VibrationWatch:
    """Compares the pick-up with its limit and with the model, and the bound by the drive with its.

    The comparisons with the model take the larger or the lesser of two voltages in turn, so that a
    drive may take effect anywhere in its cycle. Where drives were late, the bounds take the largest
    and the least of those that may be in force.

    Parameters
    ----------
    od
        Object dictionary of ``stimulator.eds``.
    deadlines
        Event timers in ms of the measurements that come over a bus; empty with the plate inside.
        By as much as they are above 3 ms a drive may be late, and what the vibration should follow
        from is not in force.

    Attributes
    ----------
    by_drive
        The bound from above.
    """

    __slots__ = (
        "_E",
        "_E_least",
        "_V",
        "_V_least",
        "_V_least_before",
        "_V_most",
        "_V_most_before",
        "_W_trip",
        "_above",
        "_deadlines",
        "_decay",
        "_detuned",
        "_excess",
        "_frequency",
        "_gain",
        "_held_least",
        "_held_most",
        "_lack",
        "_late",
        "_least",
        "_od",
        "_silent",
        "_tau",
        "_turning",
        "_unseen",
        "by_drive",
    )

    def __init__(self, od: ObjectDictionary, deadlines: Sequence[Entry]) -> None:
        self._od = od
        self._deadlines = deadlines
        self.by_drive = DriveBound(od)
        self.configure()
        self.reset()

    @property
    def voltage(self) -> float:
        """Voltage in V that is in force until the next measurement."""
        return self._V

    def configure(self) -> None:
        """Read limits and model."""
        od = self._od
        self.by_drive.configure()
        self._W_trip = od["Limit.Amplitude trip"].si_value
        self._gain = od["Model.Gain per volt"].si_value
        self._tau = od["Model.Tau"].si_value
        self._decay = exp(-TICK / self._tau)

    def reset(self) -> None:
        """Forget what was seen: the plate is at rest."""
        self.by_drive.reset()
        self._E = self._E_least = self._least = 0.0
        self._V = self._V_most = self._V_least = 0.0
        self._V_most_before = self._V_least_before = 0.0
        self._held_most = self._held_least = 0.0
        self._frequency = nan
        self._turning = 0
        self._late = False
        self._above = Lapses()
        self._excess = Lapses()
        self._lack = Lapses()
        self._unseen = Lapses()
        self._detuned = Lapses()
        self._silent = 0

    def note_drive(self, drive: Drive, *, late: bool = False) -> None:
        """Remember the drive that is in force until the next measurement.

        A late one is so some time in the cycle after that, if at all: what was in force before it
        may be until one in time has come, and in the cycle in which that comes.
        """
        self._V = most = least = drive.voltage
        self._turning = max(0, self._turning - 1)
        if abs(drive.frequency - self._frequency) > _HOP:
            self._turning = _TURNING_CYCLES
        self._frequency = drive.frequency
        doubtful = late or self._late
        if doubtful:
            most, least = max(most, self._held_most), min(least, self._held_least)
        self._V_most_before, self._V_most = self._V_most, most
        self._V_least_before, self._V_least = self._V_least, least
        self._held_most, self._held_least = (most, least) if late else (self._V, self._V)
        self._late = late
        self.by_drive.note(drive, most, doubtful=doubtful, late=late)

    def look(
        self, W: complex, contact: Contact, temperature: float, mode: int, ticks: int = 1
    ) -> int:
        """Look at a cycle; return the faults that are present, as bits.

        Parameters
        ----------
        W
            What the pick-up reads, in m peak-to-peak.
        contact
            The finger in this cycle.
        temperature
            Of the plate in degC.
        mode
            Mode in which the controllers were asked.
        ticks
            Since the cycle before.
        """
        amplitude = abs(W)
        # No detuning and no finger makes the plate vibrate more than at its bare resonance.
        decay = self._decay**ticks
        driven = self._gain * max(self._V_most, self._V_most_before)
        self._E = driven + (self._E - driven) * decay
        driven = self._gain * self._V_least
        self._E_least = driven + (self._E_least - driven) * decay
        self._expect(W, amplitude, contact, ticks * TICK)
        bound = self.by_drive
        bound.follow(contact, temperature, ticks)
        late = self._late_cycles()
        faults = 0
        if self._above.count(amplitude > self._W_trip, AMPLITUDE_CYCLES):
            faults = _AMPLITUDE
        if self._implausible(amplitude, mode, late):
            faults |= _PICKUP
        if self._unseen.count(bound.exceeded, UNSEEN_CYCLES + late):
            faults |= _UNSEEN
        if mode not in _TRACKED:
            # A loop that is closed again may begin anew at the end of its range.
            self._detuned.clear()
        elif amplitude > AMPLITUDE_MIN:
            # Without a vibration nobody knows: a friction loop that pauses hides nothing.
            self._detuned.count(abs(W.imag) > W.real, RESONANCE_CYCLES)
        if self._detuned.share(RESONANCE_CYCLES) >= 1.0:
            faults |= _RESONANCE
        return faults

    def levels(self) -> tuple[float, float, float, float]:
        """How near to a fault amplitude, pick-up, resonance and bound by the drive are, of 1.0."""
        late = self._late_cycles()
        return (
            self._above.share(AMPLITUDE_CYCLES),
            max(
                self._excess.share(EXCESS_CYCLES + late),
                self._silent / (SILENT_CYCLES + late),
                self._lack.share(LACK_CYCLES + late),
            ),
            self._detuned.share(RESONANCE_CYCLES),
            self._unseen.share(UNSEEN_CYCLES + late),
        )

    def _implausible(self, amplitude: float, mode: int, late: int) -> bool:
        """Compare the reading with the model."""
        E, E_least = self._E, self._E_least
        most = _EXCESS_UNIDENTIFIED if mode == _IDENTIFY else _EXCESS
        excess = self._excess.count(amplitude > most * E + _EXCESS_OFFSET, EXCESS_CYCLES + late)
        silent = E_least > _LOOKED_FOR and amplitude < _SILENCE * E_least
        # In a row: a pulse that ends dies away sooner than E under a finger, each time it comes.
        self._silent = self._silent + 1 if silent else 0
        lack = self._lacks(amplitude, mode, LACK_CYCLES + late)
        return excess or lack or self._silent >= SILENT_CYCLES + late

    def _lacks(self, amplitude: float, mode: int, most: int) -> bool:
        """Compare the reading with its bound from below, where that tells anything."""
        lack, least = self._lack, self._least
        if mode in _UNJUDGED:
            lack.clear()
        elif least > _LOOKED_FOR and not (self._turning and mode == _OPEN_LOOP):
            # A loop that is led astray hunts: what is lacking comes and goes with the phase.
            lack.count(amplitude < _LACK * least, most)
        return lack.share(most) >= 1.0

    def _expect(self, W: complex, amplitude: float, contact: Contact, time: float) -> None:
        """Bring the bound from below up to date, over a time in s."""
        Fn = contact.Fn if contact.Fn > 0.0 else 0.0
        damping = 1.0 + MOST_LOAD * contact_load(most_force(Fn))
        voltage = min(self._V_least, self._V_least_before)
        driven = 0.0
        # Without a voltage there may have been no drive yet, and so no frequency.
        if voltage > 0.0:
            share = self._least_share(W, amplitude, damping)
            driven = self._gain * voltage * share / damping
        self._least = driven + (self._least - driven) * exp(-time * damping / self._tau)

    def _least_share(self, W: complex, amplitude: float, damping: float) -> float:
        """Return which share of its vibration at resonance the plate has at least, 0..1."""
        if self.by_drive.identified:
            return self.by_drive.least_share(self._frequency, damping)
        if amplitude > _PHASE_FROM and W.real > _PHASE_MIN * amplitude:
            return W.real / amplitude
        return 1.0

    def _late_cycles(self) -> int:
        if not self._deadlines:
            return 0
        return max(0, shortest_ms(self._deadlines) - SHORT_DEADLINE_MS)

"""The watchdogs of the vibration: what the pick-up reads, and what the drive says it must be."""

from __future__ import annotations

from collections.abc import Sequence
from math import exp
from typing import Final

from smarttac_can.control.vibration import AMPLITUDE_MIN
from smarttac_can.nodes.lapses import Lapses
from smarttac_can.nodes.loop_period import shortest_ms
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.od.entry import Entry
from smarttac_can.vocabulary.model import contact_load
from smarttac_can.vocabulary.modes import Mode
from smarttac_can.vocabulary.signals import SHORT_DEADLINE_MS, TICK, Contact
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
_FORCE_UNCERTAINTY: Final = 0.05
"""Uncertainty of the normal force in N: noise, and drift since the tare."""
_FORCE_TOLERANCE: Final = 0.1
"""The same as a fraction: slope and bow of the gauges."""
_EXCESS: Final = 1.5
"""Largest ratio of the vibration to that of the model: fingers and detuning only lower it."""
_EXCESS_UNIDENTIFIED: Final = 5.0
"""Largest such ratio while the model is still to be identified."""
_EXCESS_OFFSET: Final = 100e-9
"""Vibration in m that needs no voltage: noise, and the tail of one that dies down."""
_GAIN_LEAST: Final = 0.8
"""Lowest gain over that of the EDS that the bound from above believes in: a model may be that of a
plate whose pick-up reads too little."""
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
_IDENTIFY: Final = Mode.IDENTIFY
_UNJUDGED: Final = (Mode.OFF, Mode.IDENTIFY)
"""Modes in which nothing is missed: there is no voltage, or no model yet."""
_TRACKED: Final = (Mode.AMPLITUDE_RESONANCE, Mode.FRICTION, Mode.TEXTURE)
_AMPLITUDE: Final = 1 << Watchdog.AMPLITUDE
_PICKUP: Final = 1 << Watchdog.PICKUP
_RESONANCE: Final = 1 << Watchdog.RESONANCE
_UNSEEN: Final = 1 << Watchdog.UNSEEN


class VibrationWatch:
    """Compares the pick-up with its limit, and with the model of the plate under its voltage.

    Parameters
    ----------
    od
        Object dictionary of ``stimulator.eds``.
    deadlines
        Event timers in ms of the measurements that come over a bus; empty with the plate inside.
        By as much as they are above 3 ms a drive may be late, and what the vibration should follow
        from is not in force.

    Notes
    -----
    With the time constant ``tau`` and the gain K of the bare plate, a voltage V in force, a phase
    phi of the vibration and a finger that presses with Fn, the vibration settles at
    ``K V cos(phi)/(1 + c Fn^(2/3))``, where c is the finger's. The least c gives a bound from
    above, whatever the pick-up reads, the largest one from below. Neither waits until the vibration
    has settled: a friction loop may drive in pulses that are shorter. The one from below takes the
    lesser of two voltages in turn, so that a drive may take effect within its cycle. Where drives
    were late, the bounds take the largest and the least of those that may be in force.
    """

    __slots__ = (
        "_E",
        "_E_least",
        "_V",
        "_V_least",
        "_V_least_before",
        "_V_most",
        "_W_trip",
        "_above",
        "_bound",
        "_bound_trip",
        "_deadlines",
        "_decay",
        "_detuned",
        "_excess",
        "_gain",
        "_gain_bound",
        "_held_least",
        "_held_most",
        "_lack",
        "_late",
        "_least",
        "_od",
        "_silent",
        "_tau",
        "_unseen",
    )

    def __init__(self, od: ObjectDictionary, deadlines: Sequence[Entry]) -> None:
        self._od = od
        self._deadlines = deadlines
        self.configure()
        self.reset()

    @property
    def bound(self) -> float:
        """Vibration in m peak-to-peak that the drive may have made of the plate, at most."""
        return self._bound

    def configure(self) -> None:
        """Read limits and model."""
        od = self._od
        self._W_trip = od["Limit.Amplitude trip"].si_value
        self._bound_trip = od["Limit.Amplitude by drive"].si_value
        gain = od["Model.Gain per volt"]
        self._gain = gain.si_value
        self._gain_bound = max(self._gain, _GAIN_LEAST * gain.default * gain.si)
        self._tau = od["Model.Tau"].si_value
        self._decay = exp(-TICK / self._tau)

    def reset(self) -> None:
        """Forget what was seen: the plate is at rest."""
        self._E = self._E_least = self._bound = self._least = 0.0
        self._V = self._V_most = self._V_least = self._V_least_before = 0.0
        self._held_most = self._held_least = 0.0
        self._late = False
        self._above = Lapses()
        self._excess = Lapses()
        self._unseen = Lapses()
        self._lack = Lapses()
        self._detuned = Lapses()
        self._silent = 0

    def note_voltage(self, voltage: float, *, late: bool = False) -> None:
        """Remember the voltage in V that is in force until the next measurement.

        A late one is so some time in the cycle after that, if at all: what was in force before it
        may be until one in time has come, and in the cycle in which that comes.
        """
        self._V = most = least = voltage
        if late or self._late:
            most, least = max(voltage, self._held_most), min(voltage, self._held_least)
        self._V_most, self._V_least = most, least
        self._held_most, self._held_least = (most, least) if late else (voltage, voltage)
        self._late = late

    def look(self, W: complex, contact: Contact, mode: int, ticks: int = 1) -> int:
        """Look at a cycle; return the faults that are present, as bits.

        Parameters
        ----------
        W
            What the pick-up reads, in m peak-to-peak.
        contact
            The finger in this cycle.
        mode
            Mode in which the controllers were asked.
        ticks
            Since the cycle before.
        """
        amplitude = abs(W)
        # No detuning and no finger makes the plate vibrate more than at its bare resonance.
        decay = self._decay**ticks
        driven = self._gain * self._V_most
        self._E = driven + (self._E - driven) * decay
        driven = self._gain * self._V_least
        self._E_least = driven + (self._E_least - driven) * decay
        self._follow(W, amplitude, contact, ticks * TICK)
        late = self._late_cycles()
        faults = 0
        if self._above.count(amplitude > self._W_trip, AMPLITUDE_CYCLES):
            faults = _AMPLITUDE
        if self._implausible(amplitude, mode, late):
            faults |= _PICKUP
        if self._unseen.count(self._bound > self._bound_trip, UNSEEN_CYCLES + late):
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
        excess = self._excess.share(EXCESS_CYCLES + late)
        none = self._silent / (SILENT_CYCLES + late)
        lack = self._lack.share(LACK_CYCLES + late)
        return (
            self._above.share(AMPLITUDE_CYCLES),
            max(excess, none, lack),
            self._detuned.share(RESONANCE_CYCLES),
            self._unseen.share(UNSEEN_CYCLES + late),
        )

    @property
    def voltage(self) -> float:
        """Voltage in V that is in force until the next measurement."""
        return self._V

    def _implausible(self, amplitude: float, mode: int, late: int) -> bool:
        """Compare the reading with the model."""
        E, E_least = self._E, self._E_least
        most = _EXCESS_UNIDENTIFIED if mode == _IDENTIFY else _EXCESS
        excess = self._excess.count(amplitude > most * E + _EXCESS_OFFSET, EXCESS_CYCLES + late)
        silent = E_least > _LOOKED_FOR and amplitude < _SILENCE * E_least
        # A pulse that ends dies away sooner than E under a finger: such cycles must not add up.
        self._silent = self._silent + 1 if silent else 0
        lack = self._lacks(amplitude, mode, LACK_CYCLES + late)
        return excess or lack or self._silent >= SILENT_CYCLES + late

    def _lacks(self, amplitude: float, mode: int, most: int) -> bool:
        """Compare the reading with its bound from below, where that tells anything."""
        lack, least = self._lack, self._least
        if mode in _UNJUDGED:
            lack.clear()
        elif least > _LOOKED_FOR:
            # A loop that is led astray hunts: what is lacking comes and goes with the phase.
            lack.count(amplitude < _LACK * least, most)
        return lack.share(most) >= 1.0

    def _follow(self, W: complex, amplitude: float, contact: Contact, time: float) -> None:
        """Bring the bounds from above and from below up to date, over a time in s."""
        cosine = 1.0
        if amplitude > _PHASE_FROM and W.real > _PHASE_MIN * amplitude:
            cosine = W.real / amplitude
        Fn = contact.Fn if contact.Fn > 0.0 else 0.0
        pressing = (1.0 - _FORCE_TOLERANCE) * Fn - _FORCE_UNCERTAINTY if contact.touching else 0.0
        tau = self._tau
        damping = 1.0 + LEAST_LOAD * contact_load(pressing)
        driven = self._gain_bound * self._V_most * cosine / damping
        self._bound = driven + (self._bound - driven) * exp(-time * damping / tau)
        damping = 1.0 + MOST_LOAD * contact_load((1.0 + _FORCE_TOLERANCE) * Fn + _FORCE_UNCERTAINTY)
        driven = self._gain * min(self._V_least, self._V_least_before) * cosine / damping
        self._least = driven + (self._least - driven) * exp(-time * damping / tau)
        self._V_least_before = self._V_least

    def _late_cycles(self) -> int:
        if not self._deadlines:
            return 0
        return max(0, shortest_ms(self._deadlines) - SHORT_DEADLINE_MS)

"""The nested controllers: C_mu over C_W and C_omega, fed by the tribometer, 1 kHz."""

from __future__ import annotations

from dataclasses import replace
from math import isfinite, sqrt
from typing import Final

from smarttac_can.control.friction import relative_error
from smarttac_can.control.friction_control import FrictionControl
from smarttac_can.control.identification import Identification
from smarttac_can.control.inner_loops import InnerLoops, designed_for
from smarttac_can.control.limit import (
    AMPLITUDE,
    FREQUENCY,
    VOLTAGE,
    allowed_amplitude,
    in_limits,
)
from smarttac_can.control.parameters import CascadeParameters
from smarttac_can.control.texture import TexturePlayer
from smarttac_can.control.tribometer import Tribometer
from smarttac_can.vocabulary.model import PlateModel
from smarttac_can.vocabulary.modes import Mode
from smarttac_can.vocabulary.signals import Contact, Drive, Measurement, Setpoint

# To look a member up costs ten times as much as a name, and every cycle asks for these.
_FIXED: Final = Mode.AMPLITUDE
_FRICTION: Final = Mode.FRICTION
_TEXTURE: Final = Mode.TEXTURE

_ABSURD = 1e6
"""Bound of the squares of a measurement: 1 km, 1 kN. NaN and infinity do not pass either."""

FREQUENCY_STEP: Final = 5.0
"""Largest change in Hz of the frequency in a tick of mode AMPLITUDE, 3 % of half the width of the
resonance: a hop would meet the resonance with the voltage that the plate needed beside it."""

NO_CONTACT = Contact(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, False)


class Cascade:
    """All controllers of one stimulator, stepped once a tick.

    A mode change keeps the drive: the new loops start from the voltage and the frequency in force,
    and move them by their gain times their error. Two things are immediate by intent: OFF is 0 V at
    once, and in open loop voltage and frequency are put out as the set-point has them. In mode
    AMPLITUDE the frequency of a driven plate moves to the set-point by `FREQUENCY_STEP` a tick.
    From OFF the resonance loop starts at the set-point's frequency; the law ``predictive`` starts
    where model and thermometer put the resonance.

    Out of contact the modes FRICTION and TEXTURE hold the amplitude at the set-point's nominal
    one. The COF is unknown then, and the last reference before lift-off was made of a COF whose
    uncertainty grows as 1/Fn; a known amplitude keeps the resonance locked and meets the next
    finger at a chosen friction.

    Parameters
    ----------
    parameters
        Limits, design and calibration.
    model
        Plate to design the loops for until one is identified.

    Attributes
    ----------
    mode : Mode
        Mode in force.
    reason : str
        Why the cascade turned itself OFF; empty otherwise.
    contact : Contact
        The finger at the last tick.
    amplitude, W_ref : float
        Measured ``|W|`` and its reference in m; without an amplitude loop W_ref follows ``|W|``.
    mu_ref, E : float
        Reference of the COF and friction error in %, 0 outside FRICTION and TEXTURE; E is 0 out of
        contact.
    drive : Drive
        The drive put out last.
    limited : int
        Bits of :class:`~smarttac_can.control.limit.Limit`.
    identification : Identification or None
        The last one started.
    tribometer : Tribometer
        For its tare and offsets.
    texture : TexturePlayer or None
        What mode TEXTURE plays; may be replaced at any time.
    """

    __slots__ = (
        "E",
        "W_ref",
        "_fresh",
        "_from_off",
        "_inner",
        "_model",
        "_outer",
        "_parameters",
        "_predictive",
        "amplitude",
        "contact",
        "drive",
        "identification",
        "limited",
        "mode",
        "mu_ref",
        "reason",
        "texture",
        "tribometer",
    )

    def __init__(
        self, parameters: CascadeParameters | None = None, model: PlateModel | None = None
    ) -> None:
        p = CascadeParameters() if parameters is None else parameters
        self._model = PlateModel() if model is None else model
        self.mode = Mode.OFF
        self.reason = ""
        self.contact = NO_CONTACT
        self.amplitude = self.W_ref = self.mu_ref = self.E = 0.0
        self.drive = Drive(0.0, min(max(self._model.f0, p.f_min), p.f_max))
        self.limited = 0
        self.identification: Identification | None = None
        self.tribometer = Tribometer(p.lateral, p.gauge_positions, p.gauge_noise, p.contact_force)
        self.texture: TexturePlayer | None = None
        self._fresh = False
        self._from_off = True
        self._parameters = p
        self._outer = FrictionControl(p)
        self._design()

    @property
    def parameters(self) -> CascadeParameters:
        """Parameters in force."""
        return self._parameters

    @property
    def model(self) -> PlateModel:
        """Plate the loops are designed for."""
        return self._model

    def adopt(self, model: PlateModel) -> None:
        """Design the loops for another plate, such as a stored one, without a bump."""
        self._model = model
        self._design()

    def configure(self, parameters: CascadeParameters) -> None:
        """Replace the parameters, also while running, without a bump; ends an identification.

        The two loops go on as they are unless they have to be designed anew. The same parameters
        change nothing.
        """
        before, p = self._parameters, parameters
        if p == before:
            return
        if self.mode is Mode.IDENTIFY:
            self._turn_off("identification: parameters were changed")
        self.tribometer.calibrate(p.lateral, p.gauge_positions, p.gauge_noise, p.contact_force)
        self._outer.configure(p)
        self._parameters = p
        if designed_for(p) != designed_for(before):
            self._design()
        else:
            self._inner.limit(p)

    def set_mode(self, mode: int) -> None:
        """Change the mode; the mode in force again changes nothing.

        Raises
        ------
        ValueError
            If there is no such mode.
        """
        chosen = Mode(mode)
        if chosen is self.mode:
            return
        self.reason = ""
        if chosen is Mode.OFF:
            self._turn_off("")
            return
        if self.mode is Mode.IDENTIFY and self.identification is not None:
            self.identification.fail("another mode was chosen")
        self._from_off = self.mode is Mode.OFF or (self._fresh and self._from_off)
        self._fresh = True
        self.mode = chosen

    def update(self, measurement: Measurement, setpoint: Setpoint) -> Drive:
        """Return the drive of this tick, in force until the next.

        A measurement or set-point that is not finite turns the cascade OFF, with 0 V and a
        :attr:`reason`. So does a COF reference of 0 or less in mode FRICTION, and no texture in
        mode TEXTURE. Set-points beyond a limit are cut to it.
        """
        W, gauges, temperature, _ = measurement
        s1, s2, s3, s4, s5, s6 = gauges
        square = W.real * W.real + W.imag * W.imag
        forces = s1 * s1 + s2 * s2 + s3 * s3 + s4 * s4 + s5 * s5 + s6 * s6
        mode = self.mode
        fault = ""
        if not square + forces < _ABSURD:
            fault = "measurement is not finite"
        elif not isfinite(sum(setpoint)):
            fault = "set-point is not finite"
        elif mode is _FRICTION and (setpoint.mu_left <= 0.0 or setpoint.mu_right <= 0.0):
            fault = "COF reference is not above 0"
        elif mode is _TEXTURE and self.texture is None:
            fault = "there is no texture"
        if fault:
            if self._predictive is not None:
                self._predictive.interrupt()
            return self._turn_off(fault)
        self.amplitude = sqrt(square)
        self.contact = self.tribometer.update(gauges)
        if self._predictive is not None:
            self._predictive.observe(W, self.drive, self.contact, temperature)
        if self._fresh:
            self._enter(setpoint)
        if mode is _FRICTION or mode is _TEXTURE:
            return self._closed_loop(W, self._friction(setpoint), setpoint)
        if mode is Mode.AMPLITUDE_RESONANCE or mode is Mode.AMPLITUDE:
            return self._closed_loop(W, setpoint.amplitude, setpoint)
        if mode is Mode.IDENTIFY:
            return self._identify(W, temperature)
        return self._open_loop(setpoint)

    def realised(self, drive: Drive) -> None:
        """Go on from the drive that went out; a lower voltage than asked for is a limit."""
        asked = self.drive
        if drive.voltage < asked.voltage:
            self.limited |= AMPLITUDE
            self._inner.realise(drive.voltage - asked.voltage)
            if self.mode is Mode.IDENTIFY and self.identification is not None:
                self.identification.fail(
                    f"{asked.voltage:.0f} V were cut to {drive.voltage:.0f} V: more may make more "
                    "vibration than its limit; correct the data sheet of the model"
                )
        self.drive = drive

    def _closed_loop(self, W: complex, W_ref: float, setpoint: Setpoint) -> Drive:
        """Return the drive of the inner loops for an amplitude reference in m."""
        p = self._parameters
        tracked = self.mode is not _FIXED
        allowed = allowed_amplitude(W_ref, p.W_max, W, self.amplitude, tracked)
        limited = 0 if allowed == W_ref else AMPLITUDE
        self.W_ref = W_ref = allowed
        inner = self._inner
        fixed = self._followable(setpoint.frequency) if self.mode is _FIXED else None
        drive = inner.step(W, self.amplitude, W_ref, self.contact, fixed)
        V, f = drive
        # Whatever a law makes of what it knows, nothing but a drive within limits leaves here.
        if not in_limits(V, f, p.V_max, p.f_min, p.f_max):
            return self._turn_off("drive is not finite")
        if fixed is not None and fixed != setpoint.frequency:
            limited |= FREQUENCY
        self.limited = limited | inner.limited
        self.drive = drive
        return drive

    def _followable(self, frequency: float) -> float:
        """Move the frequency in force towards a set-point in Hz, no faster than V can follow."""
        voltage, before = self.drive
        if voltage == 0.0:
            return frequency
        return min(max(frequency, before - FREQUENCY_STEP), before + FREQUENCY_STEP)

    def _open_loop(self, setpoint: Setpoint) -> Drive:
        """Return the set-point's drive, or the same with 0 V in mode OFF."""
        p = self._parameters
        V, f = 0.0, p.clip_frequency(setpoint.frequency)
        self.limited = 0
        if self.mode is Mode.OPEN_LOOP:
            V = min(max(setpoint.voltage, 0.0), p.V_max)
            if setpoint.voltage != V:
                self.limited |= VOLTAGE
            # Nothing regulates here: the bare plate at its resonance is the worst case.
            if self._model.gain * V > p.W_max:
                V = p.W_max / self._model.gain
                self.limited |= AMPLITUDE
            self.W_ref = self.amplitude
            if setpoint.frequency != f:
                self.limited |= FREQUENCY
        self.drive = Drive(V, f)
        return self.drive

    def _friction(self, setpoint: Setpoint) -> float:
        """Return the amplitude reference in m that C_mu asks for."""
        contact, outer = self.contact, self._outer
        texture = self.texture if self.mode is _TEXTURE else None
        if texture is None:
            mu_ref = outer.at(contact.position, setpoint)
        else:
            mu_ref = outer.ahead(texture, contact, self.tribometer)
        self.mu_ref = mu_ref
        if not contact.touching:
            self.E = 0.0
            outer.release()
            return setpoint.amplitude
        self.E = E = relative_error(contact.mu, mu_ref)
        W = self.amplitude
        if texture is not None:
            return outer.for_texture(contact, W, mu_ref, self._parameters.W_max)
        return outer.for_level(contact, E, W, mu_ref, self.W_ref, setpoint.amplitude)

    def _identify(self, W: complex, temperature: float) -> Drive:
        identification = self.identification
        assert identification is not None
        if self.contact.touching and self.tribometer.tared:
            identification.fail(f"the plate is loaded with {self.contact.Fn:.2f} N")
        drive = identification.update(W)
        if drive is not None:
            self.limited = 0
            self.drive = drive
            return drive
        if identification.model is None:
            return self._turn_off(f"identification: {identification.failure}")
        self._turn_off("")
        # A load is not identified, and where f0 stands follows the temperature.
        self.adopt(replace(identification.model, load=self._model.load, temperature=temperature))
        return self.drive

    def _enter(self, setpoint: Setpoint) -> None:
        """Start a mode from the drive in force; from OFF, at the frequency of the set-point."""
        p = self._parameters
        f_set = p.clip_frequency(setpoint.frequency)
        self._fresh = False
        voltage, frequency = self.drive
        self._inner.preset(Drive(voltage, f_set if self._from_off else frequency))
        self._outer.release()
        self._inner.follow_load(self.mode is _TEXTURE)
        if self.mode is Mode.FRICTION:
            self._outer.place(self.contact.position, setpoint.boundary)
        elif self.mode is _TEXTURE and self.texture is not None:
            self.texture.start()
        else:
            self.mu_ref = self.E = 0.0
        if self.mode is Mode.IDENTIFY:
            self.W_ref = 0.0
            self.identification = Identification(self._model, f_set, p)

    def _turn_off(self, reason: str) -> Drive:
        if self.mode is Mode.IDENTIFY and self.identification is not None:
            self.identification.fail(reason or "turned off")
        self.mode = Mode.OFF
        self.reason = reason
        self._fresh = False
        self.W_ref = self.mu_ref = self.E = 0.0
        self.limited = 0
        self.drive = Drive(0.0, self.drive.frequency)
        return self.drive

    def _design(self) -> None:
        """Build the loops from parameters and model, and start them from the drive in force."""
        self._inner = InnerLoops(self._model, self._parameters, self.drive)
        self._inner.follow_load(self.mode is _TEXTURE)
        self._predictive = self._inner.predictive

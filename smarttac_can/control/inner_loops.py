"""The inner loops, C_W and C_omega, by the law of the vibration that was chosen."""

from __future__ import annotations

from smarttac_can.control.design import amplitude_pi, resonance_pi
from smarttac_can.control.limit import FREQUENCY, VOLTAGE, cut_voltage
from smarttac_can.control.parameters import CascadeParameters
from smarttac_can.control.predictive import PredictiveLoop
from smarttac_can.control.schedule import Schedule
from smarttac_can.control.vibration import AmplitudeLoop, ResonanceLoop
from smarttac_can.vocabulary.model import PlateModel
from smarttac_can.vocabulary.modes import VibrationLaw
from smarttac_can.vocabulary.signals import Contact, Drive


class InnerLoops:
    """From a reference of ``|W|`` to a drive, designed once for a model and parameters.

    Parameters
    ----------
    model
        Plate they are designed for.
    parameters
        Law, poles, dead time and limits.
    drive
        The drive in force, from which they start.

    Attributes
    ----------
    amplitude, resonance
        C_W and C_omega of the laws ``pi`` and ``scheduled``.
    predictive
        What stands for both with the law ``predictive``; None with the others.
    limited
        Bits of :class:`Limit` that cut the last drive.
    """

    __slots__ = (
        "_designed",
        "_follows_load",
        "_parameters",
        "_schedule",
        "_scheduled",
        "amplitude",
        "limited",
        "predictive",
        "resonance",
    )

    def __init__(self, model: PlateModel, parameters: CascadeParameters, drive: Drive) -> None:
        p = parameters
        law = p.vibration_law
        self._parameters = p
        self._schedule = Schedule(model, p.amplitude_pole, p.resonance_pole, p.dead_time)
        self._scheduled = law is VibrationLaw.SCHEDULED
        self._follows_load = False
        self.predictive = (
            PredictiveLoop(model, p.dead_time) if law is VibrationLaw.PREDICTIVE else None
        )
        self.amplitude = AmplitudeLoop(amplitude_pi(model, p.amplitude_pole, p.dead_time), p.V_max)
        self.resonance = ResonanceLoop(
            resonance_pi(model, p.resonance_pole, p.dead_time), p.f_min, p.f_max
        )
        self._designed = (self.amplitude.pi.Kp, self.amplitude.pi.a)
        self.limited = 0
        self.preset(drive)

    def follow_load(self, on: bool) -> None:
        """Have the amplitude's gains of the law ``pi`` follow the finger, or stand as designed.

        What the PI stands at does not change. The resonance keeps its gains: a pick-up that has
        lost some of its direct axis would lead faster ones astray.
        """
        if self._parameters.vibration_law is VibrationLaw.PI:
            self._follows_load = on
            self.amplitude.pi.Kp, self.amplitude.pi.a = self._designed

    def preset(self, drive: Drive) -> None:
        """Have both PIs start from a drive."""
        self.amplitude.pi.state = drive.voltage
        self.resonance.preset(drive.frequency)

    def realise(self, change: float) -> None:
        """Let the PI of the amplitude go on from a voltage that was changed by so many V."""
        self.amplitude.pi.state += change

    def limit(self, parameters: CascadeParameters) -> None:
        """Take parameters that ask for the same design, with other limits."""
        p = self._parameters = parameters
        self.amplitude.V_max = p.V_max
        self.resonance.limit(p.f_min, p.f_max)

    def step(
        self, W: complex, amplitude: float, W_ref: float, contact: Contact, fixed: float | None
    ) -> Drive:
        """Return the drive of this tick.

        Parameters
        ----------
        W, amplitude
            Vibration and its modulus in m.
        W_ref
            Reference of the modulus in m.
        contact
            The finger.
        fixed
            Frequency in Hz that is asked for; None to follow the resonance.
        """
        if self.predictive is not None:
            return self._predicted(self.predictive, W_ref, fixed)
        limited = 0
        amplitude_loop = self.amplitude
        Fn = contact.Fn if contact.touching else 0.0
        if self._scheduled:
            self._schedule.tune(Fn, amplitude_loop.pi, self.resonance.pi)
        elif self._follows_load:
            self._schedule.tune_amplitude(Fn, amplitude_loop.pi)
        V = amplitude_loop.step(W_ref, amplitude)
        if amplitude_loop.limited:
            limited = VOLTAGE
        if fixed is None:
            f = self.resonance.step(W, amplitude)
            if self.resonance.limited:
                limited |= FREQUENCY
        else:
            f = self._parameters.clip_frequency(fixed)
            if f != fixed:
                limited |= FREQUENCY
        self.limited = limited
        return Drive(V, f)

    def _predicted(self, loop: PredictiveLoop, W_ref: float, fixed: float | None) -> Drive:
        """Return the drive that the predictive law asks for, cut to the limits."""
        p = self._parameters
        asked = loop.resonance if fixed is None else fixed
        f = p.clip_frequency(asked)
        limited = FREQUENCY if f != asked else 0
        asked_V = loop.voltage(W_ref, f)
        V = cut_voltage(asked_V, p.V_max)
        if asked_V != V:
            limited |= VOLTAGE
        self.limited = limited
        return Drive(V, f)


def designed_for(parameters: CascadeParameters) -> tuple[VibrationLaw, float, float, float]:
    """Return what the design of the loops follows from, apart from the model."""
    p = parameters
    return p.vibration_law, p.amplitude_pole, p.resonance_pole, p.dead_time

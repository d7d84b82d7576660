"""The controllers of one stimulator: plan and state of `step`, identification and tare."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from smarttac_can.science.control.identification import Identification
from smarttac_can.science.control.mode_shape import ModeShape
from smarttac_can.science.control.parameters import CascadeParameters
from smarttac_can.science.control.step import (
    FAULTS,
    NO_CONTACT,
    ControlPlan,
    ControlState,
    adopted,
    at_rest,
    control_plan,
    control_step,
    realised,
    redesigned,
    turned_off,
)
from smarttac_can.science.control.texture import Texture
from smarttac_can.science.control.tribometer import Forces, Nulls
from smarttac_can.science.control.vibration import AMPLITUDE
from smarttac_can.vocabulary.model import PlateModel, require
from smarttac_can.vocabulary.signals import Contact, Drive, Measurement, Setpoint
from smarttac_can.vocabulary.states import Mode

_IDENTIFY: Final = Mode.IDENTIFY
"""Module constant, as looking up an enumeration member takes ten times as long in every cycle."""
WEIGHT_MIN: Final = 20e-3
"""Normal force in N since the tare above which an identification adds a remark. Its noise is 1.5
mN; the gauges of a sound plate may drift by this much in 2 K."""


class Cascade:
    """The controllers of one stimulator, with their state between two ticks.

    Parameters
    ----------
    parameters
        Limits, design and calibration.
    model
        Plate for which the loops are designed until one is identified.

    Attributes
    ----------
    mode : Mode
        Commanded mode, or `Mode.OFF` after the controllers have turned themselves off.
    reason : str
        Reason for which they did; empty otherwise.
    contact : Contact
        Finger at the last tick.
    amplitude : float
        Measured ``|W|`` in m.
    mu_ref, E : float
        Reference of the COF and friction error in %, 0 outside FRICTION and TEXTURE; E is 0 out of
        contact.
    limited : int
        Bits of :class:`~smarttac_can.science.control.vibration.Limit`.
    identification : Identification or None
        Last identification that was started.
    tared : bool
        Whether the zeros of the gauges were measured or set.
    parameters : CascadeParameters
        Parameters in force.
    model : PlateModel
        Plate for which the loops are designed.
    """

    __slots__ = (
        "E",
        "_nulls",
        "_plan",
        "_state",
        "amplitude",
        "contact",
        "identification",
        "limited",
        "mode",
        "model",
        "mu_ref",
        "parameters",
        "reason",
        "tared",
    )

    def __init__(
        self, parameters: CascadeParameters | None = None, model: PlateModel | None = None
    ) -> None:
        self.parameters = CascadeParameters() if parameters is None else parameters
        self.model = PlateModel() if model is None else model
        self._plan = control_plan(self.parameters, self.model)
        self._state = at_rest(self._plan)
        self._nulls = Nulls()
        self.mode = Mode.OFF
        self.reason = ""
        self.contact = NO_CONTACT
        self.amplitude = self.mu_ref = self.E = 0.0
        self.limited = 0
        self.identification: Identification | None = None
        self.tared = False

    @property
    def plan(self) -> ControlPlan:
        """Plan in force."""
        return self._plan

    @property
    def state(self) -> ControlState:
        """State of the controllers after the last tick."""
        return self._state

    @property
    def mode_shape(self) -> ModeShape:
        """Known mode shape."""
        return self._state.sliding.known.mode_shape

    @property
    def drive(self) -> Drive:
        """The drive in force."""
        return self._state.drive

    @property
    def W_ref(self) -> float:
        """Amplitude reference in m; without an amplitude loop it equals ``|W|``."""
        return self._state.W_ref

    @property
    def zero(self) -> Forces:
        """Zero of S1..S6 in N, -20..20; a new zero ends a touch."""
        return self._plan.zero

    @zero.setter
    def zero(self, zero: Forces) -> None:
        for gauge, offset in enumerate(zero, 1):
            require(f"zero of S{gauge}", offset, -20.0, 20.0)
        self.tared = True
        self._swap(self._plan._replace(zero=zero))

    def null(self) -> Forces:
        """Return the mean of the last 64 raw samples of S1..S6 in N.

        Raises
        ------
        RuntimeError
            There were fewer than 64 samples.
        """
        return self._nulls.mean()

    def play(self, texture: Texture) -> None:
        """Set the texture of mode TEXTURE; a table over time starts from its beginning."""
        self._swap(self._plan._replace(texture=texture))
        self._state = self._state._replace(playing=self._state.playing._replace(ticks=0))

    def adopt(self, model: PlateModel) -> None:
        """Design the loops for another plate, such as a stored one, bumplessly."""
        self.model = model
        self._plan = self._planned()
        self._state = redesigned(self._plan, self._state)

    def configure(self, parameters: CascadeParameters) -> None:
        """Set the parameters, also while running, bumplessly; this ends an identification.

        Equal parameters have no effect.
        """
        self.swap(
            parameters,
            self.model,
            control_plan(parameters, self.model, self._plan.zero, self._plan.texture),
        )

    def swap(self, parameters: CascadeParameters, model: PlateModel, plan: ControlPlan) -> None:
        """Set parameters, model and the plan that was built from them, bumplessly.

        Other parameters end an identification.
        """
        if parameters != self.parameters and self.mode is _IDENTIFY:
            self._turn_off("identification: parameters were changed")
        self.parameters, self.model = parameters, model
        self._swap(plan)

    def _planned(self) -> ControlPlan:
        return control_plan(self.parameters, self.model, self._plan.zero, self._plan.texture)

    def _swap(self, plan: ControlPlan) -> None:
        before, self._plan = self._plan, plan
        self._state = adopted(before, plan, self._state)

    def set_mode(self, mode: int) -> None:
        """Set the mode; the present mode has no effect.

        Raises
        ------
        ValueError
            There is no such mode.
        """
        chosen = Mode(mode)
        if chosen is self.mode:
            return
        if chosen is Mode.OFF:
            self._turn_off("")
            return
        self.reason = ""
        if self.mode is _IDENTIFY and self.identification is not None:
            self.identification.fail("another mode was chosen")
        self.mode = chosen

    def update(self, measurement: Measurement, setpoint: Setpoint) -> Drive:
        """Return the drive of this tick, in force until the next, as `control_step` computes it.

        In mode IDENTIFY it is the drive of the identification.
        """
        begins = self._state.mode != self.mode
        self._state, controlled = control_step(
            self._plan, self._state, self.mode, measurement, setpoint
        )
        contact, amplitude, self.mu_ref, self.E, self.limited, fault = controlled
        if fault:
            self._turn_off(FAULTS[fault])
            return self._state.drive
        # This takes half the time of a named tuple's own constructor.
        self.contact = tuple.__new__(Contact, contact)
        self.amplitude = amplitude
        self._nulls.add(measurement.gauges)
        if self.mode is _IDENTIFY:
            return self._identify(measurement, setpoint, begins)
        return self._state.drive

    def realised(self, drive: Drive) -> None:
        """Continue from the drive that was sent; a voltage below that asked for is limited."""
        asked = self._state.drive
        if drive.voltage < asked.voltage:
            self.limited |= AMPLITUDE
            if self.mode is _IDENTIFY and self.identification is not None:
                self.identification.fail(
                    f"{asked.voltage:.0f} V were cut to {drive.voltage:.0f} V: more may make more "
                    "vibration than its limit; correct the data sheet of the model"
                )
        if drive != asked:
            self._state = realised(self._state, drive)

    def _identify(self, measurement: Measurement, setpoint: Setpoint, begins: bool) -> Drive:
        if begins:
            start = self.parameters.clip_frequency(setpoint.frequency)
            self.identification = Identification(self.model, start, self.parameters)
        identification = self.identification
        assert identification is not None
        if self.contact.touching and self.tared:
            identification.fail(f"the plate is loaded with {self.contact.Fn:.2f} N")
        drive = identification.update(measurement.W)
        if drive is not None:
            self._state = self._state._replace(drive=drive)
            return drive
        if identification.model is None:
            self._turn_off(f"identification: {identification.failure}")
            return self._state.drive
        self._turn_off("; ".join(filter(None, (identification.remark, self._remark_on_weight()))))
        # The load is not identified, and f0 depends on the temperature.
        self.adopt(
            replace(identification.model, load=self.model.load, temperature=measurement.temperature)
        )
        return self._state.drive

    def _remark_on_weight(self) -> str:
        """Return a remark on a weight since the tare, too light for a contact; empty for none."""
        weight = sum(self.null()[2:]) - sum(self._plan.zero[2:])
        if not self.tared or weight < WEIGHT_MIN:
            return ""
        return (
            f"the gauges read {weight * 1e3:.0f} mN more than at the tare: if something touched "
            "the plate, lift it and repeat; otherwise tare"
        )

    def _turn_off(self, reason: str) -> None:
        if self.mode is _IDENTIFY and self.identification is not None:
            self.identification.fail(reason or "turned off")
        self.mode = Mode.OFF
        self.reason = reason
        self.mu_ref = self.E = 0.0
        self.limited = 0
        self._state = turned_off(self._state, self._state.learned)

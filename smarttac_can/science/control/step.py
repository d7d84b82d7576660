"""One tick, at 1 kHz, of the nested controllers: C_mu over C_W and C_omega, fed by the tribometer.

`control_step` computes a tick from a plan, the state after the tick before, a measurement and a
set-point, in this order::

    gauges -> forces, COF, position                               tribometer
    W, drive in force -> estimated plate                          vibration law predictive
    COF, reference -> W_ref                                       C_mu:    eq. (8), (9), or a map
    W_ref -> W_ref within its limits
    W_ref - |W| -> V,   -W_q/W_d -> f                             C_W, C_omega: eq. (6), (7)

A change of the mode is bumpless: the loops start from the voltage and the frequency in force, and
change them by their gain times their error. Two changes are immediate by intent: OFF sets 0 V, and
open loop sets voltage and frequency of the set-point. In mode AMPLITUDE the frequency of a driven
plate moves to the set-point by `FREQUENCY_STEP` per tick. From OFF the resonance loop starts at the
set-point's frequency; the law ``predictive`` starts at the resonance of model and thermometer.

Out of contact the modes FRICTION and TEXTURE hold the nominal amplitude of the set-point. The COF
is then unknown, and the last reference before lift-off came from a COF with an uncertainty that
grows as 1/Fn. A known amplitude keeps the resonance locked, and gives the next finger a defined
friction.

All functions are pure, with floats and named tuples; numba and mypyc compile them unchanged.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite, sqrt
from typing import Final, NamedTuple

from smarttac_can.science.control.budget import Calibrated
from smarttac_can.science.control.design import (
    Gains,
    Inverse,
    amplitude_inverse,
    designed,
    row_of,
)
from smarttac_can.science.control.friction import (
    asked_amplitude,
    is_right,
    limited_step,
    relative_error,
)
from smarttac_can.science.control.mode_shape import ModeShape, restored, shape_of, share_at
from smarttac_can.science.control.parameters import CascadeParameters
from smarttac_can.science.control.predictive import (
    LEAST_POLE,
    Learned,
    PlantPrior,
    asked_voltage,
    interrupted,
    observed,
    prior_of,
    resonance_of,
    unlearned,
)
from smarttac_can.science.control.predictive_friction import (
    PATH_LAG,
    FrictionSample,
    MapState,
    amplitude_asked,
    begin_map,
    follow_map,
    unknown_finger,
    with_mode_shape,
)
from smarttac_can.science.control.texture import (
    NO_TEXTURE,
    NO_TEXTURE_STATE,
    Line,
    Texture,
    TextureState,
    begin_texture,
    cof_ahead,
    follow_texture,
    line_from,
    prolonged,
)
from smarttac_can.science.control.tribometer import (
    UNTOUCHED,
    Forces,
    Gauging,
    PositionTrack,
    centre_uncertainty,
    contact_of,
    gauging_of,
)
from smarttac_can.science.control.vibration import (
    AMPLITUDE,
    FREQUENCY,
    VOLTAGE,
    allowed_amplitude,
    cut_voltage,
    in_limits,
    lost,
    regulated,
    resonance_error,
)
from smarttac_can.vocabulary.model import PlateModel
from smarttac_can.vocabulary.signals import (
    TICK,
    Contact,
    ContactFields,
    Drive,
    MeasurementFields,
    Setpoint,
)
from smarttac_can.vocabulary.states import Law, Mode, VibrationLaw

# Plain integers, as looking up an enumeration member takes ten times as long, and numba has no
# enums.
_OFF: Final = int(Mode.OFF)
_OPEN_LOOP: Final = int(Mode.OPEN_LOOP)
_AMPLITUDE: Final = int(Mode.AMPLITUDE)
_RESONANCE: Final = int(Mode.AMPLITUDE_RESONANCE)
_FRICTION: Final = int(Mode.FRICTION)
_IDENTIFY: Final = int(Mode.IDENTIFY)
_TEXTURE: Final = int(Mode.TEXTURE)
_MAPPED: Final = int(Law.PREDICTIVE)
_SCHEDULED: Final = int(VibrationLaw.SCHEDULED)
_PREDICTIVE: Final = int(VibrationLaw.PREDICTIVE)

_ABSURD: Final = 1e6
"""Bound of the squares of a measurement, 1 km or 1 kN, and of a COF reference; refuses NaN, too."""
_COF_MIN: Final = 1e-6
"""Least COF reference, so that the error relative to it is finite."""
FREQUENCY_STEP: Final = 5.0
"""Largest change of the frequency in Hz per tick of mode AMPLITUDE, 3 % of half the width of the
resonance. A hop would reach the resonance with the higher voltage needed beside it."""

SAVED: Final = 0.33e-3
"""Time in s by which the inverse of the amplitude loop, and the lead for the stretch of the skin,
make mode TEXTURE earlier than the loop alone, whose delay is the default preview."""

FAULTS: Final = (
    "",
    "measurement is not finite",
    "set-point is not finite",
    "COF reference is not above 0",
    "there is no texture",
    "drive is not finite",
)
"""Reasons for which the controllers turned themselves off, by `Controlled.fault`."""
_NO_MEASUREMENT: Final = 1
_NO_SETPOINT: Final = 2
_NO_REFERENCE: Final = 3
_NO_TABLE: Final = 4
_NO_DRIVE: Final = 5

NO_CONTACT: Final = Contact(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, False)
"""Contact before the first tick."""


class ControlPlan(NamedTuple):
    """Parameters of the controllers, in SI units."""

    law: int
    """Number of `Law`."""
    slope: float
    """Step of the amplitude in m per % of friction error."""
    step_max: float
    """Largest step of the amplitude in m."""
    half: float
    """Half of the boundary's hysteresis in m."""
    ahead: float
    """Time in s by which the reference of a texture is ahead."""
    inverse: Inverse
    """Inverse of the amplitude loop, for mode TEXTURE."""
    vibration_law: int
    """Number of `VibrationLaw`."""
    bare: Gains
    """Gains for the bare plate."""
    rows: Sequence[Sequence[float]]
    """Gains for the plate under a finger; `row_of` gives the row for a force."""
    prior: PlantPrior
    gain: float
    """Gain of the bare plate at its resonance in m/V."""
    V_max: float
    """Limit of the voltage in V."""
    W_max: float
    """Limit of the amplitude reference in m."""
    f_min: float
    """Lowest frequency in Hz."""
    f_max: float
    """Highest frequency in Hz."""
    mode_shape: ModeShape
    """Mode shape before learning."""
    gauging: Gauging
    zero: Forces
    """Zeros of S1..S6 in N."""
    texture: Texture


class Loops(NamedTuple):
    """State of the two PIs after a tick."""

    voltage: float
    """State of C_W in V."""
    frequency: float
    """State of C_omega in Hz."""
    held: float
    """Last output of C_omega in Hz, held while there is no vibration."""
    cut: bool
    """Whether this output was cut to a limit."""


class Playing(NamedTuple):
    """State of C_mu of mode TEXTURE after a tick."""

    ticks: int
    """Ticks since the texture started."""
    touches: bool
    """Whether `line` and `touch` belong to a touch in progress."""
    line: Line
    touch: TextureState


class ControlState(NamedTuple):
    """State of the controllers after a tick."""

    mode: int
    """Number of `Mode`."""
    drive: Drive
    """Drive in force until the next tick."""
    W_ref: float
    """Amplitude reference in m; without an amplitude loop it equals ``|W|``."""
    loops: Loops
    learned: Learned
    """State of the vibration law ``predictive``, which learns in every mode."""
    touch: PositionTrack
    right: bool
    """Whether the finger is right of the boundary."""
    slides: bool
    """Whether `sliding` belongs to a touch in progress."""
    sliding: MapState
    """State of the friction law ``predictive`` in this touch or the last one, of which the learned
    knowledge is kept."""
    playing: Playing


class Controlled(NamedTuple):
    """Results of a tick, in addition to the state."""

    contact: ContactFields
    """Fields of a `Contact`."""
    amplitude: float
    """``|W|`` in m."""
    mu_ref: float
    """Reference of the COF, 0 outside FRICTION and TEXTURE."""
    E: float
    """Friction error in %, 0 without contact and outside these modes."""
    limited: int
    """Bits of `Limit` for the limits that were active."""
    fault: int
    """Index into `FAULTS`; above 0 if the controllers have turned themselves off."""


def control_plan(
    parameters: CascadeParameters,
    model: PlateModel,
    zero: Forces = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    texture: Texture = NO_TEXTURE,
) -> ControlPlan:
    """Return the parameters of the controllers.

    Parameters
    ----------
    parameters
        Limits, design and calibration.
    model
        Plate for which the loops are designed.
    zero
        Zeros of S1..S6 in N.
    texture
        Texture of mode TEXTURE.
    """
    p = parameters
    bare, rows = designed(model, p.amplitude_pole, p.resonance_pole, p.dead_time)
    inverse = _inverse(p, model)
    return ControlPlan(
        law=int(p.law),
        slope=p.slope,
        step_max=p.step_max,
        half=0.5 * p.hysteresis,
        ahead=p.preview + inverse.late - SAVED,
        inverse=inverse,
        vibration_law=int(p.vibration_law),
        bare=bare,
        rows=rows,
        prior=prior_of(model, p.dead_time),
        gain=model.gain,
        V_max=p.V_max,
        W_max=p.W_max,
        f_min=p.f_min,
        f_max=p.f_max,
        mode_shape=shape_of(p.node_distance, p.shape_cosine, p.shape_sine),
        gauging=gauging_of(
            p.lateral,
            p.gauge_positions,
            p.gauge_noise,
            p.contact_force,
            Calibrated(
                p.cof_uncertainty, p.cof_uncertainty_shift, p.null_drift, p.calibration_temperature
            ),
        ),
        zero=zero,
        texture=texture,
    )


def _inverse(p: CascadeParameters, model: PlateModel) -> Inverse:
    """Return the inverse of the amplitude loop of the vibration law."""
    inverse = amplitude_inverse(model, p.amplitude_pole, p.dead_time)
    if p.vibration_law is VibrationLaw.PREDICTIVE:
        whole = 1.0 - LEAST_POLE
        return Inverse(1.0 / whole, -LEAST_POLE / whole, 0.0, inverse.late)
    return inverse


def at_rest(plan: ControlPlan) -> ControlState:
    """Return the state before the first tick: mode OFF at 0 V."""
    f = _clipped(plan, plan.prior.f0)
    return ControlState(
        mode=_OFF,
        drive=Drive(0.0, f),
        W_ref=0.0,
        loops=Loops(0.0, f, f, False),
        learned=unlearned(plan.prior),
        touch=UNTOUCHED,
        right=False,
        slides=False,
        sliding=unknown_finger(plan.mode_shape),
        playing=Playing(0, False, line_from(0.0), NO_TEXTURE_STATE),
    )


def adopted(before: ControlPlan, plan: ControlPlan, state: ControlState) -> ControlState:
    """Return the state under another plan, bumplessly.

    Another zero ends the touch. Another friction law starts without knowledge of the finger, and
    another mode shape replaces what was learned of it.
    Another design of the inner loops starts them from the drive in force. A held frequency is cut
    to the limits. Everything else is kept.
    """
    if plan.zero != before.zero:
        # Contact and position are those of the old zero, so reset both.
        state = state._replace(touch=UNTOUCHED)
    if plan.law != before.law:
        state = state._replace(slides=False, sliding=unknown_finger(plan.mode_shape))
    elif plan.mode_shape != before.mode_shape:
        known = restored(state.sliding.known.mode_shape, plan.mode_shape)
        state = state._replace(sliding=with_mode_shape(state.sliding, known))
    if _design_of(plan) != _design_of(before):
        return redesigned(plan, state)
    held = state.loops.held
    if not plan.f_min <= held <= plan.f_max:
        state = state._replace(loops=_preset(plan, state.loops.voltage, held))
    return state


def _design_of(plan: ControlPlan) -> tuple[int, Gains, Sequence[Sequence[float]], PlantPrior]:
    return plan.vibration_law, plan.bare, plan.rows, plan.prior


def redesigned(plan: ControlPlan, state: ControlState) -> ControlState:
    """Return the state with inner loops that restart from the drive in force."""
    loops = _preset(plan, state.drive.voltage, state.drive.frequency)
    return state._replace(loops=loops, learned=unlearned(plan.prior))


def turned_off(state: ControlState, learned: Learned) -> ControlState:
    """Return the state in mode OFF, at 0 V, with what the predictive law has learned."""
    _, drive, _, loops, _, touch, right, slides, sliding, playing = state
    off = Drive(0.0, drive.frequency)
    return ControlState(_OFF, off, 0.0, loops, learned, touch, right, slides, sliding, playing)


def realised(state: ControlState, drive: Drive) -> ControlState:
    """Return the state after another drive than asked for was put in force.

    C_W continues from its voltage, so that it does not wind up.
    """
    loops = state.loops
    if drive.voltage < state.drive.voltage:
        change = drive.voltage - state.drive.voltage
        loops = loops._replace(voltage=loops.voltage + change)
    return state._replace(drive=drive, loops=loops)


def control_step(
    plan: ControlPlan,
    state: ControlState,
    mode: int,
    measurement: MeasurementFields,
    setpoint: Setpoint,
) -> tuple[ControlState, Controlled]:
    """Return the state after a tick, whose `ControlState.drive` is the drive asked for.

    A measurement or set-point that is not finite turns the controllers off. So does a COF reference
    of 0 or less in mode FRICTION, and a missing texture in mode TEXTURE. Set-points beyond a limit
    are cut to it. In mode IDENTIFY the drive is unchanged, as the identification sets it.

    Parameters
    ----------
    plan, state
        Parameters, and state after the tick before.
    mode
        Number of `Mode`; if it differs from that of the state, the new mode starts with this tick.
    measurement, setpoint
        Measurement and set-point of this tick.
    """
    W, gauges, temperature, _ = measurement
    fault = _fault(plan, mode, W, gauges, setpoint)
    if fault:
        nobody = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, False)
        off = turned_off(state, interrupted(state.learned))
        return off, Controlled(nobody, 0.0, 0.0, 0.0, 0, fault)
    amplitude = sqrt(W.real * W.real + W.imag * W.imag)
    touch, contact, centre = contact_of(plan.gauging, plan.zero, state.touch, gauges, temperature)
    Fn = contact[2] if contact[7] else 0.0
    learned = state.learned
    if plan.vibration_law == _PREDICTIVE:
        learned = observed(plan.prior, learned, W, state.drive, Fn, temperature)
    if mode not in (state.mode, _OFF):
        state = _entered(plan, state, mode, setpoint, contact[5])
    _, drive, W_ref, loops, _, _, right, slides, sliding, playing = state
    mu_ref = E = 0.0
    limited = fault = 0
    if mode in (_OFF, _OPEN_LOOP):
        drive, limited = _open_loop(plan, mode, setpoint)
        W_ref = amplitude if mode == _OPEN_LOOP else 0.0
    elif mode != _IDENTIFY:
        if mode == _FRICTION:
            right = is_right(right, contact[5], setpoint.boundary, plan.half)
            mu_ref = setpoint.mu_right if right else setpoint.mu_left
            Fx, Fy, _, mu, u_mu, position, speed, _ = contact
            sample = FrictionSample(mu, u_mu, Fx, Fy, amplitude, mu_ref, position, speed)
            slides, sliding, E, W_ref = _for_level(plan, state, contact[7], sample, setpoint)
        elif mode == _TEXTURE:
            playing, mu_ref, E, W_ref = _for_texture(
                plan, state, contact, centre, amplitude, setpoint.amplitude
            )
        else:
            W_ref = setpoint.amplitude
        drive, W_ref, loops, limited = _inner_loops(
            plan, state, learned, (W, amplitude, Fn), W_ref, setpoint.frequency
        )
        # No law can put out anything but a drive within limits.
        if not in_limits(drive.voltage, drive.frequency, plan.V_max, plan.f_min, plan.f_max):
            mode, fault = _OFF, _NO_DRIVE
            drive, W_ref, mu_ref, E, limited = Drive(0.0, state.drive.frequency), 0.0, 0.0, 0.0, 0
    return (
        ControlState(mode, drive, W_ref, loops, learned, touch, right, slides, sliding, playing),
        Controlled(contact, amplitude, mu_ref, E, limited, fault),
    )


def _fault(plan: ControlPlan, mode: int, W: complex, gauges: Forces, setpoint: Setpoint) -> int:
    """Return the index into `FAULTS` of the first invalid input, 0 if all are valid."""
    s1, s2, s3, s4, s5, s6 = gauges
    forces = s1 * s1 + s2 * s2 + s3 * s3 + s4 * s4 + s5 * s5 + s6 * s6
    if not W.real * W.real + W.imag * W.imag + forces < _ABSURD:
        return _NO_MEASUREMENT
    voltage, frequency, amplitude, mu_left, mu_right, boundary = setpoint
    if not isfinite(voltage + frequency + amplitude + mu_left + mu_right + boundary):
        return _NO_SETPOINT
    references = _COF_MIN < mu_left < _ABSURD and _COF_MIN < mu_right < _ABSURD
    if mode == _FRICTION and not references:
        return _NO_REFERENCE
    if mode == _TEXTURE and len(plan.texture.values) == 0:
        return _NO_TABLE
    return 0


def _entered(
    plan: ControlPlan, state: ControlState, mode: int, setpoint: Setpoint, position: float
) -> ControlState:
    """Return the state at the start of a mode, from the drive in force.

    From OFF it starts at the frequency of the set-point.
    """
    before, drive, W_ref, loops, learned, touch, right, _, sliding, playing = state
    f = _clipped(plan, setpoint.frequency) if before == _OFF else drive.frequency
    loops = _preset(plan, drive.voltage, f)
    ticks = playing.ticks
    if mode == _FRICTION:
        right = position > setpoint.boundary
    elif mode == _TEXTURE:
        ticks = 0
    elif mode == _IDENTIFY:
        W_ref = 0.0
    playing = Playing(ticks, False, playing.line, playing.touch)
    return ControlState(mode, drive, W_ref, loops, learned, touch, right, False, sliding, playing)


def _preset(plan: ControlPlan, voltage: float, frequency: float) -> Loops:
    """Return both PIs for a start from a drive in V and Hz."""
    f = _clipped(plan, frequency)
    return Loops(voltage, f, f, f != frequency)


def _clipped(plan: ControlPlan, frequency: float) -> float:
    return min(max(frequency, plan.f_min), plan.f_max)


def _open_loop(plan: ControlPlan, mode: int, setpoint: Setpoint) -> tuple[Drive, int]:
    """Return the set-point's drive, with 0 V in mode OFF, and the bits of active limits."""
    f = _clipped(plan, setpoint.frequency)
    if mode == _OFF:
        return Drive(0.0, f), 0
    V = cut_voltage(setpoint.voltage, plan.V_max)
    limited = 0 if setpoint.voltage == V else VOLTAGE
    # There is no feedback here, so assume the worst case: the bare plate at its resonance.
    if plan.gain * V > plan.W_max:
        V = plan.W_max / plan.gain
        limited |= AMPLITUDE
    if f != setpoint.frequency:
        limited |= FREQUENCY
    return Drive(V, f), limited


def _for_level(
    plan: ControlPlan,
    state: ControlState,
    touching: bool,
    sample: FrictionSample,
    setpoint: Setpoint,
) -> tuple[bool, MapState, float, float]:
    """Step C_mu of mode FRICTION; return its touch, E in % and W_ref in m, before its limits."""
    sliding = state.sliding
    if not touching:
        return False, sliding, 0.0, setpoint.amplitude
    E = relative_error(sample.mu, sample.mu_ref)
    if plan.law != _MAPPED:
        dW = limited_step(plan.slope, plan.step_max, E)
        W_ref = asked_amplitude(plan.law, dW, sample.W, state.W_ref, setpoint.amplitude)
        return state.slides, sliding, E, W_ref
    if not state.slides:
        return True, begin_map(sample, sliding.known), E, sample.W
    sliding = follow_map(sliding, sample)
    return True, sliding, E, amplitude_asked(sliding)


def _for_texture(
    plan: ControlPlan,
    state: ControlState,
    contact: ContactFields,
    centre: float,
    amplitude: float,
    W_nominal: float,
) -> tuple[Playing, float, float, float]:
    """Step C_mu of mode TEXTURE; return it, mu_ref, E in % and W_ref in m, before its limits."""
    ticks, touches, line, touch = state.playing
    Fx, Fy, Fn, mu, u_mu, position, _, touching = contact
    if not touching:
        mu_ref = cof_ahead(plan.texture, ticks, position, 0.0, plan.ahead)
        return Playing(ticks + 1, False, line, touch), mu_ref, 0.0, W_nominal
    if touches:
        line = prolonged(line, centre, centre_uncertainty(plan.gauging, Fn))
    else:
        line = line_from(centre)
    mu_ref = cof_ahead(plan.texture, ticks, line.position, line.speed, plan.ahead)
    # C_mu has the vibration that acts on the finger, by the mode shape known from mode FRICTION.
    mode_shape = state.sliding.known.mode_shape
    x, speed = line.position, line.speed
    acting = amplitude * share_at(mode_shape, x + PATH_LAG * speed)
    share = share_at(mode_shape, x + (PATH_LAG + TICK) * speed)
    sample = FrictionSample(mu, u_mu, Fx, Fy, acting, mu_ref, x, speed)
    if touches:
        touch = follow_texture(touch, sample, speed, share * plan.W_max, plan.inverse)
    else:
        touch = begin_texture(sample, touch.known)
    playing = Playing(ticks + 1, True, line, touch)
    return playing, mu_ref, relative_error(mu, mu_ref), touch.W_ref / share


def _inner_loops(
    plan: ControlPlan,
    state: ControlState,
    learned: Learned,
    seen: tuple[complex, float, float],
    W_ref: float,
    f_set: float,
) -> tuple[Drive, float, Loops, int]:
    """Step C_W and C_omega by the vibration law.

    Parameters
    ----------
    plan, state
        Parameters, and state after the tick before, or at the start of the mode.
    learned
        State of the predictive law after this tick.
    seen
        Vibration and its modulus in m, and the normal force in N, 0 without contact.
    W_ref
        Reference of the modulus in m, before its limits.
    f_set
        Frequency in Hz of mode AMPLITUDE; the other modes track the resonance.

    Returns
    -------
    drive, W_ref, loops, limited
        Drive asked for, reference within its limits, the PIs, and bits of `Limit`.
    """
    W, amplitude, _ = seen
    tracked = state.mode != _AMPLITUDE
    allowed = allowed_amplitude(W_ref, plan.W_max, W, amplitude, tracked)
    limited = 0 if allowed == W_ref else AMPLITUDE
    f = f_set
    if not tracked and state.drive.voltage > 0.0:
        # Not faster than the voltage can follow.
        before = state.drive.frequency
        f = min(max(f_set, before - FREQUENCY_STEP), before + FREQUENCY_STEP)
        if f != f_set:
            limited |= FREQUENCY
    if plan.vibration_law == _PREDICTIVE:
        drive, cut = _predicted(plan, learned, allowed, resonance_of(learned) if tracked else f)
        return drive, allowed, state.loops, limited | cut
    drive, loops, cut = _regulated(plan, state, seen, allowed, f)
    return drive, allowed, loops, limited | cut


def _predicted(plan: ControlPlan, learned: Learned, W_ref: float, f: float) -> tuple[Drive, int]:
    """Return the drive of the law ``predictive`` at a frequency in Hz, and active limits."""
    f_cut = _clipped(plan, f)
    limited = 0 if f_cut == f else FREQUENCY
    V = asked_voltage(plan.prior, learned, W_ref, f_cut)
    V_cut = cut_voltage(V, plan.V_max)
    if V_cut != V:
        limited |= VOLTAGE
    return Drive(V_cut, f_cut), limited


def _regulated(
    plan: ControlPlan,
    state: ControlState,
    seen: tuple[complex, float, float],
    W_ref: float,
    f_fixed: float,
) -> tuple[Drive, Loops, int]:
    """Return the drive of the two PIs, the PIs after it, and bits of active limits."""
    W, amplitude, Fn = seen
    V_state, f_state, f, f_cut = state.loops
    Kp_W, Kp_omega, a = plan.bare
    a_W = a
    if plan.vibration_law == _SCHEDULED:
        row = plan.rows[row_of(Fn, len(plan.rows))]
        Kp_W, Kp_omega, a, a_W = row[0], row[1], row[2], row[2]
    elif state.mode == _TEXTURE:
        # The resonance loop keeps its gains: a pick-up with a loss of gain on its direct axis would
        # mislead a faster loop.
        row = plan.rows[row_of(Fn, len(plan.rows))]
        Kp_W, a_W = row[0], row[2]
    V, V_state, V_cut = regulated(V_state, Kp_W, a_W, W_ref - amplitude, 0.0, plan.V_max)
    limited = VOLTAGE if V_cut else 0
    if state.mode == _AMPLITUDE:
        f_drive = _clipped(plan, f_fixed)
        if f_drive != f_fixed:
            limited |= FREQUENCY
        return Drive(V, f_drive), Loops(V_state, f_state, f, f_cut), limited
    if lost(W, amplitude):
        f_state = f
    else:
        error = resonance_error(W)
        f, f_state, f_cut = regulated(f_state, Kp_omega, a, error, plan.f_min, plan.f_max)
    if f_cut:
        limited |= FREQUENCY
    return Drive(V, f), Loops(V_state, f_state, f, f_cut), limited

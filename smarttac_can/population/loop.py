"""The closed loop of one finger, in plain functions: what a campaign runs, compiled or not.

It is `smarttac_can.plant.Plate` and `smarttac_can.control.Cascade` in mode FRICTION, of the same
formulas, without what a bench may change in between.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import sqrt
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from smarttac_can.control.friction import (
    asked_amplitude,
    is_right,
    limited_step,
    relative_error,
)
from smarttac_can.control.limit import allowed_amplitude, cut_voltage, in_limits
from smarttac_can.control.pi import regulated
from smarttac_can.control.predictive import (
    Learned,
    Prior,
    asked_voltage,
    observed,
    resonance_of,
    unlearned,
)
from smarttac_can.control.predictive_friction import ANYBODY, Felt, amplitude_asked, begin, follow
from smarttac_can.control.predictive_friction import Touch as Sliding
from smarttac_can.control.schedule import row_of
from smarttac_can.control.tribometer import UNTOUCHED, Forces, Gauging, Touch, contact_of
from smarttac_can.control.vibration import lost, resonance_error
from smarttac_can.plant.finger import Pass, Path, smooth, stroke_at
from smarttac_can.plant.motion import Making, at_rest, moved
from smarttac_can.plant.sensors import Sensing, readings
from smarttac_can.vocabulary.modes import Law, VibrationLaw
from smarttac_can.vocabulary.signals import TARE_SAMPLES, TICK, Drive

Floats = NDArray[np.float64]
Table = Floats | Sequence[Sequence[float]]
"""Rows of numbers: an array where it is compiled, lists where not, of which Python reads faster."""
_MAPPED: Final = int(Law.PREDICTIVE)
_PREDICTIVE: Final = int(VibrationLaw.PREDICTIVE)
_NOBODY: Final = begin(Felt(0.0, 0.0, 0.0, 0.0, 0.0, 1.0), ANYBODY)
"""Before the first touch, which takes nothing of it but `ANYBODY`."""
LIFT_PERIOD, LIFT_LENGTH, LIFT_RAMP = 1.0, 0.1, 0.01
"""A finger that lifts does so each second, for 100 ms with a ramp of 10 ms at both ends."""


class Laws(NamedTuple):
    """What the stimulator regulates by, in SI units."""

    law: int
    """Of `smarttac_can.vocabulary.modes.Law`."""
    slope: float
    step_max: float
    vibration_law: int
    """Of `smarttac_can.vocabulary.modes.VibrationLaw`."""
    prior: Prior
    gauging: Gauging
    half: float
    """Half of the boundary's hysteresis in m."""
    V_max: float
    W_max: float
    f_min: float
    f_max: float
    amplitude: float
    """Nominal amplitude in m, held out of contact."""
    mu_left: float
    mu_right: float


class Setup(NamedTuple):
    """What a run begins with."""

    making: Making
    sensing: Sensing
    laws: Laws
    path: Path
    lifts: bool
    """Whether the finger lifts each second."""


class Controls(NamedTuple):
    """The stimulator after a tick."""

    on: bool
    touch: Touch
    sliding: Sliding
    """The law ``predictive`` in this touch, or in the last one: what it learned there it keeps."""
    right: bool
    W_ref: float
    voltage_state: float
    frequency_state: float
    learned: Learned
    drive: Drive


def lift(time: float) -> float:
    """Return the share of its force that a finger which lifts each second has at a time in s."""
    since = time % LIFT_PERIOD
    return max(1.0 - smooth(since / LIFT_RAMP), smooth((since - LIFT_LENGTH) / LIFT_RAMP))


def finger_at(
    path: Path, passes: Table, number: int, time: float, lifts: bool
) -> tuple[float, float]:
    """Return position in m and normal force in N at a time in s, in a pass of this number."""
    row = passes[number]
    now = Pass(row[0], row[1], row[2], row[3])
    Fn_before = passes[number - 1][3] if number else now.Fn
    x, force = stroke_at(path, number % 2 == 1, now, Fn_before, time)
    return x, force * lift(time) if lifts else force


def controlled(
    laws: Laws,
    gains: Table,
    controls: Controls,
    zero: Forces,
    reading: tuple[complex, Forces, float, int],
) -> tuple[Controls, float]:
    """Return the stimulator after a tick, and the COF that it measured; 0 without contact.

    Parameters
    ----------
    laws, gains
        What it regulates by; the gains by rows of `smarttac_can.control.schedule`, or one row.
    controls
        After the tick before.
    zero
        Offsets of the gauges in N.
    reading
        Of `smarttac_can.plant.sensors.readings`.
    """
    on, touch, sliding, right, W_ref, V_state, f_state, learned, drive = controls
    W, gauges, temperature, _ = reading
    amplitude = sqrt(W.real * W.real + W.imag * W.imag)
    touched = touch[0]
    touch, contact = contact_of(laws.gauging, zero, touch, gauges)
    Fx, Fy, Fn, mu, u_mu, position, _, touching = contact
    if not touching:
        Fn = 0.0
    predictive = laws.vibration_law == _PREDICTIVE
    if predictive:
        learned = observed(laws.prior, learned, W, drive, Fn, temperature)
    if not on:
        drive = Drive(0.0, laws.prior.f0)
        return Controls(on, touch, sliding, right, 0.0, V_state, f_state, learned, drive), mu
    right = is_right(right, position, 0.0, laws.half)
    mu_ref = laws.mu_right if right else laws.mu_left
    if not touching:
        W_ref = laws.amplitude
    elif laws.law != _MAPPED:
        dW = limited_step(laws.slope, laws.step_max, relative_error(mu, mu_ref))
        W_ref = asked_amplitude(laws.law, dW, amplitude, W_ref, laws.amplitude)
    else:
        felt = Felt(mu, u_mu, Fx, Fy, amplitude, mu_ref)
        sliding, W_ref = _by_map(sliding, touched, felt)
    W_ref = allowed_amplitude(W_ref, laws.W_max, W, amplitude, True)
    if predictive:
        f = min(max(resonance_of(learned), laws.f_min), laws.f_max)
        V = cut_voltage(asked_voltage(laws.prior, learned, W_ref, f), laws.V_max)
    else:
        row = gains[row_of(Fn, len(gains))]
        V, V_state, _ = regulated(V_state, row[0], row[2], W_ref - amplitude, 0.0, laws.V_max)
        f = drive.frequency
        if lost(W, amplitude):
            f_state = f
        else:
            error = resonance_error(W)
            f, f_state, _ = regulated(f_state, row[1], row[2], error, laws.f_min, laws.f_max)
    if in_limits(V, f, laws.V_max, laws.f_min, laws.f_max):
        drive = Drive(V, f)
    else:
        on, W_ref, drive = False, 0.0, Drive(0.0, drive.frequency)
    return Controls(on, touch, sliding, right, W_ref, V_state, f_state, learned, drive), mu


def _by_map(sliding: Sliding, touched: bool, felt: Felt) -> tuple[Sliding, float]:
    """Return the law ``predictive`` after a tick of a touch, and the amplitude in m it asks for."""
    if touched:
        sliding = follow(sliding, felt)
        return sliding, amplitude_asked(sliding)
    return begin(felt, sliding.known), felt.W


def run(setup: Setup, gains: Table, passes: Table, noise: Table, traces: Floats) -> None:
    """Let a finger stroke while its friction is regulated, after a tare of 64 ticks.

    Parameters
    ----------
    setup
        Plate, stimulator and finger.
    gains
        Rows of `smarttac_can.control.schedule`, or one.
    passes
        A row for each pass, to the end of the run.
    noise
        A row of 9 for each tick.
    traces
        Filled, a row for each tick: true COF, measured COF, 1.0 right of the boundary.
    """
    making, sensing, laws, path, lifts = setup
    state = at_rest(making.ambient)
    off = Drive(0.0, laws.prior.f0)
    learned = unlearned(laws.prior)
    f = off.frequency
    controls = Controls(False, UNTOUCHED, _NOBODY, False, 0.0, 0.0, f, learned, off)
    zero = sums = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    number = 0
    finger = finger_at(path, passes, 0, 0.0, lifts)
    for tick in range(len(noise)):
        moving, Fn, _, moment, _, temperature, _ = state
        reading = readings(sensing, noise[tick], moving.W, temperature, (moving.Fx, Fn, moment))
        before = controls.drive
        controls, mu = controlled(laws, gains, controls, zero, reading)
        traces[tick, 0] = abs(moving.Ft) / finger[1] if finger[1] > 0.0 else 0.0
        traces[tick, 1] = mu
        traces[tick, 2] = 1.0 if controls.right else 0.0
        time = (tick + 1) * TICK
        while number + 1 < len(passes) and time >= passes[number + 1][0]:
            number += 1
        finger_next = finger_at(path, passes, number, time, lifts)
        state = moved(making, state, before, controls.drive, finger, finger_next)
        finger = finger_next
        if tick < TARE_SAMPLES:
            sums = _added(sums, reading[1])
            if tick == TARE_SAMPLES - 1:
                zero = _mean(sums)
                controls = _turned_on(controls)


def _added(sums: Forces, forces: Forces) -> Forces:
    a1, a2, a3, a4, a5, a6 = sums
    b1, b2, b3, b4, b5, b6 = forces
    return a1 + b1, a2 + b2, a3 + b3, a4 + b4, a5 + b5, a6 + b6


def _mean(sums: Forces) -> Forces:
    s1, s2, s3, s4, s5, s6 = sums
    n = TARE_SAMPLES
    return s1 / n, s2 / n, s3 / n, s4 / n, s5 / n, s6 / n


def _turned_on(controls: Controls) -> Controls:
    """Return the stimulator after its tare, in mode FRICTION from 0 V, left of the boundary."""
    drive, learned = controls.drive, controls.learned
    return Controls(True, UNTOUCHED, _NOBODY, False, 0.0, 0.0, drive.frequency, learned, drive)

"""Predictive vibration control: one step with a complex plate model that is learned meanwhile.

With ``lambda = -1/tau + j (w0 - w)`` and ``kappa = K/tau`` the plate of eq. (6) and (7) is, in the
frame of the drive voltage, ``W' = lambda W + kappa V``. A constant drive over a time h gives
exactly ::

    e^(lambda h) W + kappa phi(lambda, h) V,        phi(lambda, h) = (e^(lambda h) - 1)/lambda

The drive of tick k takes effect after the dead time d, at the W that the drive before has produced.
The law puts out the voltage that brings ``|W|`` to its reference one tick later.

The plate is estimated from two measurements by an iterated extended Kalman filter with four states.
These are differences from the model: the logarithms of kappa and of 1/tau, so that neither can
change sign, the angular resonance at rest, and its fall with the amplitude (softening). Within a
part of a tick the resonance is that of a mean amplitude.

All functions are pure, with floats and named tuples.
"""

from __future__ import annotations

from cmath import exp as exp_j
from math import exp, isnan, nan, pi, sqrt
from typing import Final, NamedTuple

from smarttac_can.vocabulary.model import F0_SLOPE, PlateModel, contact_load, decay_rate
from smarttac_can.vocabulary.signals import TICK, Drive

TWO_PI: Final = 2.0 * pi
KAPPA_SPREAD: Final = 0.12
"""Standard uncertainty of the model's kappa as a fraction: uniform, with 20 % of gain at most."""
RATE_SPREAD: Final = 0.10
"""Standard uncertainty of the model's 1/tau as a fraction."""
W0_SPREAD: Final = TWO_PI * 60.0
"""Standard uncertainty of the model's resonance in rad/s. An error of 200 Hz is learned in one
tick, as the phase of W shows it."""
SOFTENING_SPREAD: Final = TWO_PI * 60e6
"""Standard uncertainty of the model's softening in rad/(s m)."""
_KEEP_KAPPA: Final = 0.9999
"""Factor a tick on what is known of kappa: 10 s. A finger does not change kappa."""
_KEEP_RATE: Final = 0.95
"""Factor a tick on what is known of 1/tau: 20 ms. Pressing and sliding change it."""
_KEEP_W0: Final = 0.9999
_KEEP_SOFTENING: Final = 0.99999
"""Factor a tick on what is known of the softening: 100 s. It predicts the resonance after the next
step."""
_SHIFT: Final = 200.0
"""Uncertainty of the resonance in rad/s for a change of 1/tau by e, as a finger adds stiffness."""
_NOISE: Final = 1e-9
"""Standard uncertainty in m of each axis of the pick-up."""
_UNMODELLED: Final = 1e-3
"""Relative standard uncertainty of a prediction of W, for changes of the finger within a tick."""
_JITTER: Final = 60e-6
"""Standard uncertainty in s of the instant at which a drive takes effect. It prevents that a wrong
dead time is learned as a different plate."""
_FARTHEST: Final = 1.0
"""Bound of both logarithms: a factor of 2.7."""
_FARTHEST_W0: Final = TWO_PI * 2000.0
_FARTHEST_SOFTENING: Final = TWO_PI * 1e9
_ABSURD: Final = 1e3
"""Bound of the logarithms above which the estimate is discarded instead of clipped."""
_PASSES: Final = 3
_MOVED: Final = 0.02
"""Change of the logarithms above which the filter linearises again."""
_MISSED_FROM: Final = 100e-9
"""Error of a prediction in m above which a lost drive is considered; a smaller one does no harm."""
_MISSED_SHARE: Final = 0.1
"""Largest fraction of the error, along it, that may remain under the assumption of a lost drive."""
_MISSED_TURNED: Final = 0.3
"""Largest such fraction across the error; a softening that is still unknown causes it."""
_KAPPA_VARIANCE: Final = KAPPA_SPREAD * KAPPA_SPREAD
_RATE_VARIANCE: Final = RATE_SPREAD * RATE_SPREAD
_W0_VARIANCE: Final = W0_SPREAD * W0_SPREAD
_SOFTENING_VARIANCE: Final = SOFTENING_SPREAD * SOFTENING_SPREAD
_KK: Final = _KEEP_KAPPA * _KEEP_KAPPA
_RR: Final = _KEEP_RATE * _KEEP_RATE
_WW: Final = _KEEP_W0 * _KEEP_W0
_SS: Final = _KEEP_SOFTENING * _KEEP_SOFTENING


class PlateNow(NamedTuple):
    """Parameters of the plate in one tick."""

    kappa: float
    """K/tau in m/(V s)."""
    rate: float
    """1/tau in 1/s."""
    w0: float
    """Angular resonance at rest in rad/s."""
    softening: float
    """Fall of the resonance with the amplitude in rad/(s m)."""


class Belief(NamedTuple):
    """Differences between the plate and its model, and their covariance."""

    kappa: float
    """ln of kappa divided by the model's."""
    rate: float
    """ln of 1/tau divided by the model's."""
    w0: float
    """Angular resonance minus the model's in rad/s."""
    softening: float
    """Softening minus the model's in rad/(s m)."""
    kk: float
    kr: float
    kw: float
    ks: float
    rr: float
    rw: float
    rs: float
    ww: float
    ws: float
    ss: float


class Span(NamedTuple):
    """The drives between two measurements; the first one acts during the dead time."""

    V_before: float
    w_before: float
    V: float
    w: float


PRIOR: Final = Belief(
    0.0, 0.0, 0.0, 0.0,
    _KAPPA_VARIANCE, 0.0, 0.0, 0.0, _RATE_VARIANCE, 0.0, 0.0, _W0_VARIANCE, 0.0,
    _SOFTENING_VARIANCE,
)  # fmt: skip
"""State before learning: the plate is the model."""


def believed(model: PlateNow, belief: Belief) -> PlateNow:
    """Return the estimated plate."""
    return PlateNow(
        model.kappa * exp(belief.kappa),
        model.rate * exp(belief.rate),
        model.w0 + belief.w0,
        model.softening + belief.softening,
    )


class Part(NamedTuple):
    """Response of the plate to a part of a tick with one drive: ``left W + kappa per_force V``."""

    left: complex
    per_force: complex
    """phi, in s."""
    by_turn: complex
    """Derivative of phi with respect to lambda, in s2."""
    free: float
    """Mean amplitude in m for the free vibration, which gives its resonance."""
    forced: float
    """Mean amplitude in m for the forced vibration, with more weight on its end."""


def part_of(plate: PlateNow, w: float, before: float, after: float, h: float) -> Part:
    """Return the response to a part of a tick of h in s, at a drive of w in rad/s.

    The amplitude is assumed to change exponentially from ``before`` to ``after``, in m, as at
    resonance.
    """
    decay = plate.rate * h
    free = before + (0.5 + decay / 12.0) * (after - before)
    forced = before + (2.0 / 3.0 + decay / 10.0) * (after - before)
    left = exp_j(complex(-decay, (plate.w0 - plate.softening * free - w) * h))
    turn = complex(-plate.rate, plate.w0 - plate.softening * forced - w)
    e = exp_j(turn * h)
    phi = (e - 1.0) / turn
    return Part(left, phi, (h * e - phi) / turn, free, forced)


def part_before(plate: PlateNow, w: float, W: complex, forced: float, h: float) -> Part:
    """Return the response during the dead time, for a drive with a force kappa V in m/s."""
    size = abs(W)
    first = part_of(plate, w, size, size, h)
    return part_of(plate, w, size, abs(first.left * W + first.per_force * forced), h)


def fade(belief: Belief, load_change: float) -> Belief:
    """Return the belief a tick later: the estimates stay, the covariance approaches the prior's.

    Parameters
    ----------
    belief
        Belief after the last measurement.
    load_change
        Change of ln 1/tau by the load of the finger since then. It is as uncertain as it is large.
    """
    kappa, rate, w0, softening, kk, kr, kw, ks, rr, rw, rs, ww, ws, ss = belief
    shift = _SHIFT * load_change
    return Belief(
        kappa,
        rate,
        w0,
        softening,
        _KK * kk + (1.0 - _KK) * _KAPPA_VARIANCE,
        _KEEP_KAPPA * _KEEP_RATE * kr,
        _KEEP_KAPPA * _KEEP_W0 * kw,
        _KEEP_KAPPA * _KEEP_SOFTENING * ks,
        _RR * rr + (1.0 - _RR) * _RATE_VARIANCE + load_change * load_change,
        _KEEP_RATE * _KEEP_W0 * rw,
        _KEEP_RATE * _KEEP_SOFTENING * rs,
        _WW * ww + (1.0 - _WW) * _W0_VARIANCE + shift * shift,
        _KEEP_W0 * _KEEP_SOFTENING * ws,
        _SS * ss + (1.0 - _SS) * _SOFTENING_VARIANCE,
    )


def drive_lost(
    belief: Belief, model: PlateNow, dead_time: float, W: complex, span: Span, W_next: complex
) -> bool:
    """Return whether the second drive of a span was lost, judged by the measured W.

    W is then what the first drive makes of it. A pick-up that reads almost nothing gives the same
    result; nothing could be learned from it, and the watchdogs detect it. An error within the
    standard deviation of the prediction itself, as that of a plate with an unknown softening, says
    nothing of the drive.
    """
    size = abs(W_next)
    predicted, late, by_kappa, by_rate, by_w0, by_softening, variance = _predict(
        belief, model, dead_time, W, span, size
    )
    error = W_next - predicted
    if abs(error) < _MISSED_FROM:
        return False
    explained = (
        _square(by_kappa) * belief.kk
        + _square(by_rate) * belief.rr
        + _square(by_w0) * belief.ww
        + _square(by_softening) * belief.ss
        + _square(late)
        + variance
    )
    if _square(error) < explained:
        return False
    left = W_next - _predict(belief, model, dead_time, W, with_first_only(span), size)[0]
    left /= error
    return abs(left.real) < _MISSED_SHARE and abs(left.imag) < _MISSED_TURNED


def _square(x: complex) -> float:
    return x.real * x.real + x.imag * x.imag


def with_first_only(span: Span) -> Span:
    """Return a span in which the first drive acts all the time, as the second was lost."""
    return Span(span.V_before, span.w_before, span.V_before, span.w_before)


def learn(
    belief: Belief, model: PlateNow, dead_time: float, W: complex, span: Span, W_next: complex
) -> Belief:
    """Return the belief after W has become W_next in a tick.

    It is the prior if the result is not a number, or farther off than is possible for a plate.
    """
    learned = belief
    at = belief
    for _ in range(_PASSES):
        predicted, late, by_kappa, by_rate, by_w0, by_softening, variance = _predict(
            at, model, dead_time, W, span, abs(W_next)
        )
        # Rotate to the axis along a wrong instant, and the one across, which shows the phase.
        size = abs(late)
        if size > 0.0:
            along = late.conjugate() / size
            by_kappa *= along
            by_rate *= along
            by_w0 *= along
            by_softening *= along
            innovation = (W_next - predicted) * along
        else:
            innovation = W_next - predicted
        innovation -= (
            by_kappa * (belief.kappa - at.kappa)
            + by_rate * (belief.rate - at.rate)
            + by_w0 * (belief.w0 - at.w0)
            + by_softening * (belief.softening - at.softening)
        )
        slopes = (by_kappa.real, by_rate.real, by_w0.real, by_softening.real)
        learned = _update(belief, slopes, innovation.real, variance + size * size)
        # The second axis gets what the first one has not explained.
        left = (
            innovation.imag
            - by_kappa.imag * (learned.kappa - belief.kappa)
            - by_rate.imag * (learned.rate - belief.rate)
            - by_w0.imag * (learned.w0 - belief.w0)
            - by_softening.imag * (learned.softening - belief.softening)
        )
        slopes = (by_kappa.imag, by_rate.imag, by_w0.imag, by_softening.imag)
        learned = _update(learned, slopes, left, variance)
        if not _sound(learned):
            return PRIOR
        moved = abs(learned.kappa - at.kappa) + abs(learned.rate - at.rate)
        at = _bounded(learned)
        if moved < _MOVED:
            break
    return at


def _predict(
    at: Belief, model: PlateNow, d: float, W: complex, span: Span, size: float
) -> tuple[complex, complex, complex, complex, complex, complex, float]:
    """Return W after a tick, its shift by the jitter, its four derivatives, and the variance.

    ``size`` is the measured amplitude after the tick, from which the mean amplitude follows.
    """
    plate = believed(model, at)
    kappa, rate, w0, _ = plate
    V_before, w_before, V, w = span
    h = TICK - d
    forced_before = by_before = by_softening = 0j
    if d > 0.0:
        part = part_before(plate, w_before, W, kappa * V_before, d)
        forced_before = kappa * V_before * part.per_force
        by_free, by_forced = d * part.left * W, kappa * V_before * part.by_turn
        by_before = by_free + by_forced
        by_softening = -part.free * by_free - part.forced * by_forced
        W = part.left * W + forced_before
    part = part_of(plate, w, abs(W), size, h)
    e = part.left
    forced = kappa * part.per_force * V
    predicted = e * W + forced
    by_free, by_forced = h * e * W, kappa * V * part.by_turn
    by_softening = e * by_softening - part.free * by_free - part.forced * by_forced
    by_turn = by_free + by_forced + e * by_before
    forced += e * forced_before
    square = predicted.real * predicted.real + predicted.imag * predicted.imag
    jump = kappa * (V - V_before)
    late = _JITTER * jump * e
    # Noise of both measurements, of which the older one decays during the tick; and, not modelled,
    # the second oscillation of eq. (1), at -w0 - w, which a jump of the voltage starts.
    other = 0.5 * jump / w0
    variance = (
        _NOISE * _NOISE * (1.0 + exp(-2.0 * rate * TICK))
        + _UNMODELLED * _UNMODELLED * square
        + other * other
    )
    return predicted, late, forced, -rate * by_turn, 1j * by_turn, 1j * by_softening, variance


def _update(
    belief: Belief,
    slopes: tuple[float, float, float, float],
    innovation: float,
    variance: float,
) -> Belief:
    """Return the belief after one axis, from its derivatives, innovation and variance."""
    kappa, rate, w0, softening, kk, kr, kw, ks, rr, rw, rs, ww, ws, ss = belief
    k, r, w, s = slopes
    to_kappa = kk * k + kr * r + kw * w + ks * s
    to_rate = kr * k + rr * r + rw * w + rs * s
    to_w0 = kw * k + rw * r + ww * w + ws * s
    to_softening = ks * k + rs * r + ws * w + ss * s
    precision = 1.0 / (k * to_kappa + r * to_rate + w * to_w0 + s * to_softening + variance)
    innovation *= precision
    return Belief(
        kappa + to_kappa * innovation,
        rate + to_rate * innovation,
        w0 + to_w0 * innovation,
        softening + to_softening * innovation,
        kk - to_kappa * to_kappa * precision,
        kr - to_kappa * to_rate * precision,
        kw - to_kappa * to_w0 * precision,
        ks - to_kappa * to_softening * precision,
        rr - to_rate * to_rate * precision,
        rw - to_rate * to_w0 * precision,
        rs - to_rate * to_softening * precision,
        ww - to_w0 * to_w0 * precision,
        ws - to_w0 * to_softening * precision,
        ss - to_softening * to_softening * precision,
    )


def _sound(belief: Belief) -> bool:
    """Return whether all are numbers, with variances above 0; NaN fails every comparison."""
    kappa, rate, w0, softening, kk, _, _, _, rr, _, _, ww, _, ss = belief
    sane = abs(kappa) + abs(rate) < _ABSURD and abs(w0) < _FARTHEST_W0
    sane = sane and abs(softening) < _FARTHEST_SOFTENING
    return sane and kk > 0.0 and rr > 0.0 and ww > 0.0 and ss > 0.0


def _bounded(belief: Belief) -> Belief:
    kappa, rate = belief.kappa, belief.rate
    if -_FARTHEST <= kappa <= _FARTHEST and -_FARTHEST <= rate <= _FARTHEST:
        return belief
    _, _, w0, softening, kk, kr, kw, ks, rr, rw, rs, ww, ws, ss = belief
    kappa = min(max(kappa, -_FARTHEST), _FARTHEST)
    rate = min(max(rate, -_FARTHEST), _FARTHEST)
    return Belief(kappa, rate, w0, softening, kk, kr, kw, ks, rr, rw, rs, ww, ws, ss)


# The law, which drives the plate that is believed.

LEAST_POLE: Final = 0.1
"""Fraction of an error that is left intentionally, as a margin for a wrong dead time."""
CAUTION: Final = 1.0
"""Factor by which the uncertainty of the response to a volt reduces a step."""
LEARN_MIN: Final = 20e-9
"""Vibration in m above which the law learns. Below it an offset of the pick-up, 5 nm, would look
like a plate whose vibration does not decay."""
_FORCE_SHARE: Final = 0.3
"""Filter factor of the normal force per tick, as its noise would become noise of the voltage."""
_TEMPERATURE_SHARE: Final = 0.01
"""Filter factor of the thermometer per tick. A plate needs seconds, so a jump is a fault."""
_WARMEST: Final = 150.0


def voltage_for(
    plate: PlateNow, belief: Belief, dead_time: float, W: complex, span: Span, W_ref: float
) -> float:
    """Return the voltage in V that brings ``|W|`` to its reference, before its limits.

    Parameters
    ----------
    plate, belief
        Estimated plate, and its uncertainty.
    dead_time
        Time in s until the new drive is in force.
    W
        Vibration in m in this tick.
    span
        Drive until then, and the angular frequency of the new one.
    W_ref
        Reference of ``|W|`` in m.
    """
    kappa = plate.kappa
    if dead_time > 0.0:
        forced = kappa * span.V_before
        part = part_before(plate, span.w_before, W, forced, dead_time)
        W = part.left * W + part.per_force * forced
    part = part_of(plate, span.w, abs(W), W_ref, TICK)
    by_turn = part.by_turn / part.per_force
    pole = _held_back(belief, -plate.rate * by_turn.real, -by_turn.imag)
    goal = pole * abs(W) + (1.0 - pole) * W_ref
    free, per_volt = part.left * W, kappa * part.per_force
    # |free + per_volt V|^2 = goal^2; without a root, the nearest value.
    square = per_volt.real * per_volt.real + per_volt.imag * per_volt.imag
    half = free.real * per_volt.real + free.imag * per_volt.imag
    root = half * half - square * (free.real * free.real + free.imag * free.imag - goal * goal)
    return (sqrt(root) - half) / square if root > 0.0 else -half / square


def _held_back(belief: Belief, by_rate: float, by_w0: float) -> float:
    """Return the fraction of an error to leave, from the uncertainty of the response to a volt.

    Parameters
    ----------
    belief
        Belief with its covariance.
    by_rate, by_w0
        Derivatives of the logarithm of the response to a volt; that with respect to kappa is 1.
    """
    variance = (
        belief.kk
        + by_rate * (2.0 * belief.kr + by_rate * belief.rr + 2.0 * by_w0 * belief.rw)
        + by_w0 * (2.0 * belief.kw + by_w0 * belief.ww)
    )
    unsure = CAUTION * sqrt(variance) if variance > 0.0 else 0.0
    pole = unsure / (1.0 + unsure)
    return pole if pole > LEAST_POLE else LEAST_POLE


class PlantPrior(NamedTuple):
    """Knowledge before the first measurement: the model, and the dead time."""

    kappa: float
    """K/tau in m/(V s)."""
    tau: float
    """Time constant of the bare plate in s."""
    load: float
    """Damping of the finger that the model expects, as `PlateModel.load`."""
    f0: float
    """Resonance in Hz."""
    temperature: float
    """Temperature in degC at which f0 applies."""
    softening: float
    """Fall of the resonance with the amplitude in rad/(s m)."""
    dead_time: float
    """Time from the tick until the new drive is in force in s, 0 or more, below 1 ms."""


class Learned(NamedTuple):
    """State of the law after a tick."""

    belief: Belief
    """Differences from the model."""
    plate: PlateNow
    """Estimated plate."""
    W: complex
    """Vibration of the tick in m."""
    drive: Drive
    """Drive that was in force then; valid if `follows`."""
    follows: bool
    """Whether the next measurement follows from this one and the drives."""
    held: bool
    """Whether there was only one measurement; two are needed to know the effect of a drive."""
    rate: float
    """1/tau in 1/s of the model under the finger."""
    contact: float
    """Contact as in `contact_load`, filtered."""
    temperature: float
    """Plate temperature in degC, filtered; NaN before the first plausible one."""


def unlearned(prior: PlantPrior) -> Learned:
    """Return the state before the first measurement."""
    rate = decay_rate(prior.load, prior.tau, 0.0)
    plate = PlateNow(prior.kappa, rate, TWO_PI * prior.f0, prior.softening)
    return Learned(PRIOR, plate, 0j, Drive(0.0, prior.f0), False, True, rate, 0.0, nan)


def observed(
    prior: PlantPrior, learned: Learned, W: complex, drive: Drive, Fn: float, temperature: float
) -> Learned:
    """Return the state after the measurement of a tick.

    Parameters
    ----------
    prior, learned
        Model, and state after the tick before.
    W
        Vibration in m.
    drive
        Drive that answered the tick before. It is in force unless W shows that it was lost.
    Fn
        Normal force of the finger in N, 0 without contact.
    temperature
        Plate temperature in degC; an impossible value is ignored.
    """
    belief, _, W_before, before, follows, _, rate_before, contact, warmth = learned
    if -_WARMEST < temperature < _WARMEST:
        if isnan(warmth):
            warmth = temperature
        warmth += _TEMPERATURE_SHARE * (temperature - warmth)
    warmer = 0.0 if isnan(warmth) else warmth - prior.temperature
    contact += _FORCE_SHARE * (contact_load(Fn) - contact)
    rate = decay_rate(prior.load, prior.tau, contact)
    w0 = TWO_PI * (prior.f0 + F0_SLOPE * warmer)
    model = PlateNow(prior.kappa, rate, w0, prior.softening)
    if follows and abs(W) > LEARN_MIN:
        span = Span(
            before.voltage, TWO_PI * before.frequency, drive.voltage, TWO_PI * drive.frequency
        )
        faded = fade(belief, (rate - rate_before) / rate_before)
        if drive_lost(faded, model, prior.dead_time, W_before, span, W):
            drive, span = before, with_first_only(span)
        belief = learn(faded, model, prior.dead_time, W_before, span, W)
    plate = believed(model, belief)
    return Learned(belief, plate, W, drive, True, not follows, rate, contact, warmth)


def interrupted(learned: Learned) -> Learned:
    """Return the state after a missing tick: the next measurement does not follow from this one."""
    belief, plate, W, drive, _, held, rate, contact, temperature = learned
    return Learned(belief, plate, W, drive, False, held, rate, contact, temperature)


def resonance_of(learned: Learned) -> float:
    """Return the estimated resonance in Hz; after a single measurement the frequency in force."""
    if learned.held and learned.follows:
        return learned.drive.frequency
    plate = learned.plate
    return (plate.w0 - plate.softening * abs(learned.W)) / TWO_PI


def asked_voltage(prior: PlantPrior, learned: Learned, W_ref: float, frequency: float) -> float:
    """Return the voltage in V, before its limits.

    After a single measurement it is the voltage in force, as two are needed to know its effect.

    Parameters
    ----------
    prior, learned
        Model, and state after this tick.
    W_ref
        Reference of ``|W|`` in m.
    frequency
        Excitation frequency in Hz of the same drive.
    """
    if not learned.follows:
        return 0.0
    drive = learned.drive
    if learned.held:
        return drive.voltage
    span = Span(drive.voltage, TWO_PI * drive.frequency, 0.0, TWO_PI * frequency)
    return voltage_for(learned.plate, learned.belief, prior.dead_time, learned.W, span, W_ref)


def prior_of(model: PlateModel, dead_time: float) -> PlantPrior:
    """Return the knowledge about a plate from its model."""
    m = model
    softening = TWO_PI * m.softening
    return PlantPrior(m.gain / m.tau, m.tau, m.load, m.f0, m.temperature, softening, dead_time)

"""What two measurements tell of the plate: an iterated extended Kalman filter of three numbers.

They are the logarithms of kappa and 1/tau and the angular resonance, each against the model's, so
that neither can change sign. The functions are plain ones of floats and named tuples.
"""

from __future__ import annotations

from cmath import exp as exp_j
from math import exp, pi
from typing import Final, NamedTuple

from smarttac_can.vocabulary.signals import TICK

TWO_PI: Final = 2.0 * pi
KAPPA_SPREAD: Final = 0.12
"""Standard uncertainty of the model's kappa, as a fraction: 20 % of gain at most, uniform."""
RATE_SPREAD: Final = 0.10
"""The same of 1/tau."""
W0_SPREAD: Final = TWO_PI * 60.0
"""Standard uncertainty of the model's resonance in rad/s; that it may be 200 Hz off is learned
in a tick, because the phase of W tells it."""
_KEEP_KAPPA: Final = 0.9999
"""What is left after a tick of what was learned of kappa: 10 s. A finger does not change it."""
_KEEP_RATE: Final = 0.95
"""The same of 1/tau: 20 ms. A finger changes it as it presses and slides."""
_KEEP_W0: Final = 0.9999
_SHIFT: Final = 200.0
"""Uncertainty of the resonance in rad/s when 1/tau has changed e-fold: a finger is stiff, too."""
_NOISE: Final = 1e-9
"""Standard uncertainty in m of an axis of the pick-up."""
_UNMODELLED: Final = 1e-3
"""That of a prediction of W, as a fraction: what a finger does within a tick."""
_JITTER: Final = 60e-6
"""That of the instant in s at which a drive takes force. It keeps a wrong dead time
from being taken for another plate."""
_FARTHEST: Final = 1.0
"""Bound of the two logarithms: a factor of 2.7."""
_FARTHEST_W0: Final = TWO_PI * 2000.0
_ABSURD: Final = 1e3
"""Bound of the logarithms before they are cut to what a plate can be."""
_PASSES: Final = 3
_MOVED: Final = 0.02
"""Change of the logarithms above which it is linearised anew."""
_MISSED_FROM: Final = 100e-9
"""Error in m of a prediction from which a drive may have been lost: less does no harm."""
_MISSED_SHARE: Final = 0.1
"""Largest share of it that is left once the drive before is taken to have lasted."""
_KAPPA_VARIANCE: Final = KAPPA_SPREAD * KAPPA_SPREAD
_RATE_VARIANCE: Final = RATE_SPREAD * RATE_SPREAD
_W0_VARIANCE: Final = W0_SPREAD * W0_SPREAD
_KK: Final = _KEEP_KAPPA * _KEEP_KAPPA
_RR: Final = _KEEP_RATE * _KEEP_RATE
_WW: Final = _KEEP_W0 * _KEEP_W0


class PlateNow(NamedTuple):
    """The plate in one tick."""

    kappa: float
    """K/tau in m/(V s)."""
    rate: float
    """1/tau in 1/s."""
    w0: float
    """Angular resonance in rad/s."""


class Belief(NamedTuple):
    """How far the plate is from its model, and the covariance of that."""

    kappa: float
    """ln of kappa over the model's."""
    rate: float
    """ln of 1/tau over the model's."""
    w0: float
    """Angular resonance less the model's in rad/s."""
    kk: float
    kr: float
    kw: float
    rr: float
    rw: float
    ww: float


class Span(NamedTuple):
    """The drives between two measurements: the first until the dead time is over."""

    V_before: float
    w_before: float
    V: float
    w: float


PRIOR: Final = Belief(0.0, 0.0, 0.0, _KAPPA_VARIANCE, 0.0, 0.0, _RATE_VARIANCE, 0.0, _W0_VARIANCE)
"""The model, and nothing learned."""


def believed(model: PlateNow, belief: Belief) -> PlateNow:
    """Return the plate that is believed in."""
    return PlateNow(
        model.kappa * exp(belief.kappa), model.rate * exp(belief.rate), model.w0 + belief.w0
    )


def fade(belief: Belief, load_change: float) -> Belief:
    """Let a tick pass: what was learned grows old, and the covariance returns to the prior's.

    Parameters
    ----------
    belief
        After the last measurement.
    load_change
        Change of ln 1/tau by the load of the finger since; it is as uncertain as it is large.
    """
    kappa, rate, w0, kk, kr, kw, rr, rw, ww = belief
    shift = _SHIFT * load_change
    return Belief(
        kappa,
        rate,
        w0,
        _KK * kk + (1.0 - _KK) * _KAPPA_VARIANCE,
        _KEEP_KAPPA * _KEEP_RATE * kr,
        _KEEP_KAPPA * _KEEP_W0 * kw,
        _RR * rr + (1.0 - _RR) * _RATE_VARIANCE + load_change * load_change,
        _KEEP_RATE * _KEEP_W0 * rw,
        _WW * ww + (1.0 - _WW) * _W0_VARIANCE + shift * shift,
    )


def missed(
    belief: Belief, model: PlateNow, dead_time: float, W: complex, span: Span, W_next: complex
) -> bool:
    """Whether W has become what the first drive of a span makes of it, and not the second.

    It is taken for a drive that was lost. So would be a pick-up that reads next to nothing, from
    which nothing could be learned either; the watchdogs answer for that.
    """
    error = abs(W_next - _predict(belief, model, dead_time, W, span)[0])
    if error < _MISSED_FROM:
        return False
    left = abs(W_next - _predict(belief, model, dead_time, W, first_lasting(span))[0])
    return left < _MISSED_SHARE * error


def first_lasting(span: Span) -> Span:
    """Return a span in which the second drive was lost."""
    return Span(span.V_before, span.w_before, span.V_before, span.w_before)


def learn(
    belief: Belief, model: PlateNow, dead_time: float, W: complex, span: Span, W_next: complex
) -> Belief:
    """Return what is believed once W has become W_next in a tick.

    The belief is the prior if what came out is no number, or is farther off than a plate can be.
    """
    learned = belief
    at = belief
    for _ in range(_PASSES):
        predicted, late, by_kappa, by_rate, by_w0, variance = _predict(
            at, model, dead_time, W, span
        )
        # Seen along the axis of a wrong instant, and across, where phase is.
        size = abs(late)
        if size > 0.0:
            along = late.conjugate() / size
            by_kappa *= along
            by_rate *= along
            by_w0 *= along
            innovation = (W_next - predicted) * along
        else:
            innovation = W_next - predicted
        back = (belief.kappa - at.kappa, belief.rate - at.rate, belief.w0 - at.w0)
        innovation -= by_kappa * back[0] + by_rate * back[1] + by_w0 * back[2]
        jittered = variance + size * size
        learned = _update(
            belief, by_kappa.real, by_rate.real, by_w0.real, innovation.real, jittered
        )
        # The second axis is left with what the first one has not explained.
        left = (
            innovation.imag
            - by_kappa.imag * (learned.kappa - belief.kappa)
            - by_rate.imag * (learned.rate - belief.rate)
            - by_w0.imag * (learned.w0 - belief.w0)
        )
        learned = _update(learned, by_kappa.imag, by_rate.imag, by_w0.imag, left, variance)
        if not _sound(learned):
            return PRIOR
        moved = abs(learned.kappa - at.kappa) + abs(learned.rate - at.rate)
        at = _bounded(learned)
        if moved < _MOVED:
            break
    return at


def _predict(
    at: Belief, model: PlateNow, d: float, W: complex, span: Span
) -> tuple[complex, complex, complex, complex, complex, float]:
    """Return W after a tick, by what the jitter shifts it, its derivatives, and the variance."""
    kappa, rate, w0 = believed(model, at)
    V_before, w_before, V, w = span
    h = TICK - d
    turn = complex(-rate, w0 - w)
    e = exp_j(turn * h)
    phi = (e - 1.0) / turn
    forced = kappa * phi * V
    by_turn = kappa * V * (h * e - phi) / turn
    if d > 0.0:
        turn_before = complex(-rate, w0 - w_before)
        e_before = exp_j(turn_before * d)
        phi_before = (e_before - 1.0) / turn_before
        forced_before = kappa * phi_before * V_before
        by_before = d * e_before * W + kappa * V_before * (d * e_before - phi_before) / turn_before
        W = e_before * W + forced_before
        forced += e * forced_before
        by_turn += e * by_before
        predicted = e * W + kappa * phi * V
    else:
        predicted = e * W + forced
    by_turn += h * e * W
    square = predicted.real * predicted.real + predicted.imag * predicted.imag
    jump = kappa * (V - V_before)
    late = _JITTER * jump * e
    # The noise of both measurements, of which the older one decays by the tick; and the other of
    # the two oscillations of eq. (1), at -w0 - w, which a jump of the voltage starts, unmodelled.
    other = 0.5 * jump / w0
    variance = (
        _NOISE * _NOISE * (1.0 + exp(-2.0 * rate * TICK))
        + _UNMODELLED * _UNMODELLED * square
        + other * other
    )
    return predicted, late, forced, -rate * by_turn, 1j * by_turn, variance


def _update(
    belief: Belief, k: float, r: float, w: float, innovation: float, variance: float
) -> Belief:
    """Return the belief after one axis: derivatives of its prediction, innovation and variance."""
    kappa, rate, w0, kk, kr, kw, rr, rw, ww = belief
    to_kappa = kk * k + kr * r + kw * w
    to_rate = kr * k + rr * r + rw * w
    to_w0 = kw * k + rw * r + ww * w
    precision = 1.0 / (k * to_kappa + r * to_rate + w * to_w0 + variance)
    innovation *= precision
    return Belief(
        kappa + to_kappa * innovation,
        rate + to_rate * innovation,
        w0 + to_w0 * innovation,
        kk - to_kappa * to_kappa * precision,
        kr - to_kappa * to_rate * precision,
        kw - to_kappa * to_w0 * precision,
        rr - to_rate * to_rate * precision,
        rw - to_rate * to_w0 * precision,
        ww - to_w0 * to_w0 * precision,
    )


def _sound(belief: Belief) -> bool:
    """Whether it is numbers, with variances above 0; NaN fails every comparison."""
    kappa, rate, w0, kk, _, _, rr, _, ww = belief
    sane = abs(kappa) + abs(rate) < _ABSURD and abs(w0) < _FARTHEST_W0
    return sane and kk > 0.0 and rr > 0.0 and ww > 0.0


def _bounded(belief: Belief) -> Belief:
    if -_FARTHEST <= belief.kappa <= _FARTHEST and -_FARTHEST <= belief.rate <= _FARTHEST:
        return belief
    _, _, w0, kk, kr, kw, rr, rw, ww = belief
    kappa = min(max(belief.kappa, -_FARTHEST), _FARTHEST)
    rate = min(max(belief.rate, -_FARTHEST), _FARTHEST)
    return Belief(kappa, rate, w0, kk, kr, kw, rr, rw, ww)

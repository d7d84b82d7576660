"""Predictive friction control: amplitude from a friction map that is learned meanwhile.

``W_ref = h^-1(ln mu_ref - m0)``. A new reference changes the amplitude at once, by the learned map;
m0 then removes the remaining error. The measured COF is delayed by the force path, flexure and
filter. The expected COF passes a model of that path, so that the delay is no error, and m0 does not
react to it. W is the vibration that acts on the finger, by the `mode_shape` that is learned, too.

All functions are pure, with floats and named tuples.
"""

from __future__ import annotations

from math import cos, exp, log, pi, sin, sqrt
from typing import Final, NamedTuple

from smarttac_can.science.control.friction_map import (
    PRIOR,
    Nodes,
    Plateau,
    Weights,
    amplitude_for,
    learned,
    shape,
    slope,
    value,
)
from smarttac_can.science.control.mode_shape import (
    FLAT,
    ModeShape,
    Regressors,
    follow,
    regressors,
    share_at,
    unsureness,
)
from smarttac_can.science.control.mode_shape import learned as shape_learned
from smarttac_can.vocabulary.signals import TICK

PATH_FREQUENCY: Final = 100.0
"""Assumed natural frequency of the force path in Hz, as in the plate."""
PATH_DAMPING: Final = 0.7
"""Assumed damping ratio of the force path."""
PATH_LAG: Final = 2.0 * PATH_DAMPING / (2.0 * pi * PATH_FREQUENCY)
"""Delay of forces and of the position in s behind the finger: ``2 zeta/w0`` of the force path."""
POLE: Final = 0.07
"""Fraction of a step of the reference left for the next tick. More friction stretches the skin. If
that is faster than the finger slides, the skin sticks, and releases with an overshoot."""
POLE_UNKNOWN: Final = 0.85
"""Such a fraction before the first pair of plateaus, when the map is that of any finger."""
LEAD: Final = 0.1
"""Share of a step of the reference that is asked for in addition at first, because part of the
friction follows the vibration late, through the skin [chosen over fingers of seeds 5 and 71]."""
LEAD_FOLLOWED: Final = 0.2
"""Share of the lead that is taken back in a tick."""
GAIN_UNKNOWN: Final = 1.0
"""Fraction of an error that m0 takes over in the first tick of known sliding."""
GAIN_FIRST: Final = 0.3
"""Fraction of an error that m0 takes over in the next ticks, and after a turn."""
GAIN_LAST: Final = 0.1
"""Fraction of an error that m0 takes over in the long run."""
GAIN_KEPT: Final = 0.9
"""Fraction of the difference between the two gains that is left after a tick."""
QUIET: Final = 0.25
"""Factor of the gain for `QUIET_TICKS` after a step of the reference, as the map has no skin."""
QUIET_TICKS: Final = 10
FROZEN_TICKS: Final = 20
"""Ticks after a turn of the finger without learning, as it sticks and starts to slide again."""
ERROR_MAX: Final = 0.1
"""Bound of the error of ln mu in a tick."""
SETTLED_TICKS: Final = 22
"""Ticks after a step of the reference until a plateau is settled."""
STEP_MIN: Final = 0.02
"""Change of ln mu_ref in a tick that counts as a step."""
SPEED_VARIANCE: Final = 2.5e-5
"""Variance of the difference of two plateaus without noise: force and speed change in a pass."""
MU_MIN: Final = 0.02
"""COF below which a finger does not count as sliding."""


PLATEAU_TICKS: Final = 20
"""Number of ticks of a plateau."""
PLATEAU_SPREAD: Final = 0.1e-6
"""Difference in m between an amplitude and the mean so far with which a plateau restarts."""
PLATEAU_DRIFT: Final = 0.03
"""The same for m0: a finger that stops makes no plateau, although the amplitude stays at 0."""
PAIR_MIN: Final = 0.05
"""Least difference of ln mu_ref of a pair of plateaus. A smaller one is noise that the loop has
followed; learning from it would be learning from itself."""
PAIR_MIN_W: Final = 0.05e-6
"""Least difference of the amplitudes of a pair in m."""
SHAPE_SPEED: Final = 15e-3
"""Speed in m/s from which the mode shape is learned; below it friction changes with the speed."""


class PathStep(NamedTuple):
    """Exact step of the force path for an input that is constant during it."""

    yy: float
    yr: float
    ry: float
    rr: float


def path_step(frequency: float, damping: float) -> PathStep:
    """Return the step of a tick for a natural frequency in Hz and a damping ratio below 1."""
    w = 2.0 * pi * frequency
    decay = damping * w
    ring = w * sqrt(1.0 - damping * damping)
    e = exp(-decay * TICK)
    c, s = e * cos(ring * TICK), e * sin(ring * TICK) / ring
    return PathStep(c + decay * s, s, -w * w * s, c - decay * s)


PATH: Final = path_step(PATH_FREQUENCY, PATH_DAMPING)


class FrictionSample(NamedTuple):
    """Data of the finger in one tick."""

    mu: float
    """Coefficient of friction."""
    u_mu: float
    """Standard uncertainty of mu."""
    Fx: float
    """Lateral forces in N."""
    Fy: float
    W: float
    """Amplitude of the plate in m."""
    mu_ref: float
    """Reference of the COF, above 0."""
    x: float
    """Position in m, late by the force path."""
    v: float
    """Speed in m/s."""


class Path(NamedTuple):
    """State of the model of the force path; its input is exp h, or h in mode TEXTURE."""

    y: float
    rate: float
    """In 1/s."""


class Known(NamedTuple):
    """Learned knowledge of a finger, and of the plate under it."""

    weights: Weights
    nodes: Nodes
    """h at the nodes, `shape` of the weights."""
    pairs: int
    """Number of pairs of plateaus from which it was learned."""
    mode_shape: ModeShape


class Gathered(NamedTuple):
    """Plateaus of a pass."""

    ticks: int
    """Ticks of the plateau in progress, to which the sums belong."""
    sum_ln: float
    sum_W: float
    sum_m0: float
    made: int
    """Number of complete plateaus."""
    last: Plateau


class MapState(NamedTuple):
    """State of the law while a finger touches."""

    m0: float
    """Present ln mu without vibration."""
    gain: float
    """Fraction of an error that m0 takes over."""
    ln_aim: float
    """Target of ln mu in this tick."""
    ln_slow: float
    """Target behind a low-pass filter; the lead is in proportion to the difference."""
    since_step: int
    """Ticks since the last step of the reference."""
    since_turn: int
    """Ticks since the last turn of the finger."""
    path: Path
    gathered: Gathered
    known: Known
    sample: FrictionSample
    """Data of the last tick."""
    acting: float
    """Amplitude in m that acted on the finger in it."""
    followed: Regressors
    """What m0 has followed of the regressors of the mode shape."""


NOTHING: Final = Gathered(0, 0.0, 0.0, 0.0, 0, Plateau(0.0, 0.0, 0.0))
ANYBODY: Final = Known(PRIOR, shape(PRIOR), 0, FLAT)
"""Knowledge before learning, for any finger and plate."""
NO_SAMPLE: Final = FrictionSample(0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0)
"""Sample before the first touch."""


def cut_short(so_far: Gathered, turned: bool) -> Gathered:
    """Return the plateaus after a step or a turn has ended the one in progress."""
    return Gathered(0, 0.0, 0.0, 0.0, 0 if turned else so_far.made, so_far.last)


def gathered(so_far: Gathered, ln_mu: float, W: float, ln_ref: float, m0: float) -> Gathered:
    """Return the plateaus after one more tick.

    Parameters
    ----------
    so_far
        Plateaus after the tick before.
    ln_mu, W
        Measured ln mu, and amplitude in m.
    ln_ref
        ln of the reference of the COF.
    m0
        Estimated ln mu without vibration.
    """
    ticks, sum_ln, sum_W, sum_m0, made, last = so_far
    moved = abs(ticks * W - sum_W) > ticks * PLATEAU_SPREAD
    if moved or abs(ticks * m0 - sum_m0) > ticks * PLATEAU_DRIFT:
        ticks, sum_ln, sum_W, sum_m0 = 0, 0.0, 0.0, 0.0
    ticks, sum_ln, sum_W, sum_m0 = ticks + 1, sum_ln + ln_mu, sum_W + W, sum_m0 + m0
    if ticks < PLATEAU_TICKS:
        return Gathered(ticks, sum_ln, sum_W, sum_m0, made, last)
    return Gathered(0, 0.0, 0.0, 0.0, made + 1, Plateau(sum_ln / ticks, sum_W / ticks, ln_ref))


def tells(before: Plateau, after: Plateau) -> bool:
    """Return whether two plateaus differ because their references do."""
    asked = abs(after.ln_ref - before.ln_ref) > PAIR_MIN
    return asked and abs(after.W - before.W) > PAIR_MIN_W


def begin_map(sample: FrictionSample, known: Known) -> MapState:
    """Return the state at the start of a touch or of the mode; it keeps the present amplitude.

    Parameters
    ----------
    sample
        Data of the first tick.
    known
        Knowledge learned before.
    """
    acting = sample.W * share_at(known.mode_shape, sample.x + PATH_LAG * sample.v)
    h = value(known.nodes, acting)
    ln_mu = log(sample.mu if sample.mu > MU_MIN else sample.mu_ref)
    path = Path(exp(h), 0.0)
    # It is not known yet whether the finger slides.
    return MapState(
        ln_mu - h,
        GAIN_UNKNOWN,
        ln_mu,
        ln_mu,
        SETTLED_TICKS,
        0,
        path,
        NOTHING,
        known,
        sample,
        acting,
        (0.0, 0.0),
    )


def follow_map(touch: MapState, sample: FrictionSample) -> MapState:
    """Return the state one tick later; `amplitude_asked` returns its amplitude."""
    before, known, m0, followed = touch.sample, touch.known, touch.m0, touch.followed
    ln_aim, ln_slow = touch.ln_aim, touch.ln_slow
    ln_ref = log(sample.mu_ref)
    pole = POLE if known.pairs else POLE_UNKNOWN
    stepped = abs(ln_ref - log(before.mu_ref)) > STEP_MIN
    turned = sample.Fx * before.Fx + sample.Fy * before.Fy < 0.0
    since_step = 0 if stepped else touch.since_step + 1
    since_turn = 0 if turned else touch.since_turn + 1
    gain = GAIN_FIRST if turned and touch.gain < GAIN_UNKNOWN else touch.gain
    acting = sample.W * share_at(known.mode_shape, sample.x + PATH_LAG * sample.v)
    h_before, h = value(known.nodes, touch.acting), value(known.nodes, acting)
    path = through_path(touch.path, 0.5 * (exp(h_before) + exp(h)))
    plateaus = touch.gathered
    if turned and plateaus.made:
        # Since then m0 has followed a stopping finger, whose friction is lower.
        m0 = plateaus.last.ln_mu - value(known.nodes, plateaus.last.W)
    if stepped or turned:
        plateaus = cut_short(plateaus, turned)
    if since_turn >= FROZEN_TICKS and sample.mu >= MU_MIN and path.y >= MU_MIN:
        error = log(sample.mu) - m0 - log(path.y)
        by = regressors(known.mode_shape, sample.x, slope(known.nodes, acting) * sample.W)
        settled = since_step >= SETTLED_TICKS
        if gain < GAIN_UNKNOWN:
            share = QUIET * gain if known.pairs and since_step < QUIET_TICKS else gain
            error = _bounded(error)
            if settled and known.pairs and abs(sample.v) > SHAPE_SPEED:
                known, change = _taught_shape(known, by, followed, error, sample)
                m0 += change
            m0 += share * error
            gain = GAIN_LAST + GAIN_KEPT * (gain - GAIN_LAST)
        else:
            # The target starts from the present COF, so that the amplitude does not jump.
            share = GAIN_UNKNOWN
            m0 += error
            ln_aim += error
            ln_slow = ln_aim
            gain = GAIN_FIRST
        followed = follow(followed, by, share)
        if settled:
            so_far = plateaus
            plateaus = gathered(so_far, log(sample.mu), acting, ln_ref, m0)
            if plateaus.made > so_far.made > 0 and tells(so_far.last, plateaus.last):
                known = _taught(known, so_far.last, plateaus.last, by, sample)
                # Keep the expected COF at this amplitude.
                rise = value(known.nodes, acting) - h
                m0 -= rise
                path = Path(path.y * exp(rise), path.rate * exp(rise))
    if gain < GAIN_UNKNOWN:
        ln_slow += LEAD_FOLLOWED * (ln_aim - ln_slow)
        ln_aim = ln_ref + pole * (ln_aim - ln_ref)
    return MapState(
        m0,
        gain,
        ln_aim,
        ln_slow,
        since_step,
        since_turn,
        path,
        plateaus,
        known,
        sample,
        acting,
        followed,
    )


def amplitude_asked(touch: MapState) -> float:
    """Return the amplitude in m; below 0 for a COF that no amplitude reaches."""
    known, sample = touch.known, touch.sample
    x = sample.x + (PATH_LAG + TICK) * sample.v
    ln_mu = touch.ln_aim + LEAD * (touch.ln_aim - touch.ln_slow)
    return amplitude_for(known.nodes, ln_mu - touch.m0) / share_at(known.mode_shape, x)


def through_path(path: Path, middle: float) -> Path:
    """Return the model of the force path a tick later, for its input at the middle of the tick."""
    deviation = path.y - middle
    return Path(
        middle + PATH.yy * deviation + PATH.yr * path.rate,
        PATH.ry * deviation + PATH.rr * path.rate,
    )


def _bounded(error: float) -> float:
    return ERROR_MAX if error > ERROR_MAX else -ERROR_MAX if error < -ERROR_MAX else error


def _with(known: Known, mode_shape: ModeShape) -> Known:
    return Known(known.weights, known.nodes, known.pairs, mode_shape)


def _taught_shape(
    known: Known, by: Regressors, followed: Regressors, error: float, sample: FrictionSample
) -> tuple[Known, float]:
    """Return the knowledge after a tick of steady sliding, and the change of m0 with it."""
    relative = sample.u_mu / sample.mu
    mode_shape, change = shape_learned(known.mode_shape, by, followed, error, relative)
    return _with(known, mode_shape), change


def _taught(
    known: Known, before: Plateau, after: Plateau, by: Regressors, sample: FrictionSample
) -> Known:
    """Return the knowledge after two plateaus of one pass, with an unknown mode shape at both."""
    relative = sample.u_mu / sample.mu
    variance = SPEED_VARIANCE + 2.0 * relative * relative / PLATEAU_TICKS
    variance += 2.0 * unsureness(known.mode_shape, by)
    weights = learned(known.weights, before, after, variance)
    return Known(weights, shape(weights), known.pairs + 1, known.mode_shape)


def unknown_finger(mode_shape: ModeShape) -> MapState:
    """Return the state before the first touch, on a plate of a mode shape."""
    return begin_map(NO_SAMPLE, _with(ANYBODY, mode_shape))


def with_mode_shape(touch: MapState, mode_shape: ModeShape) -> MapState:
    """Return the state with another mode shape."""
    return touch._replace(known=_with(touch.known, mode_shape))

"""C_mu of mode TEXTURE: the amplitude by a friction map that is learned while the texture plays.

``ln mu = m0 + s h(W)``, with h of `smarttac_can.control.friction_map` as it is in the mean over
fingers. The step that an edge asks for is made at once, ``W_ref = h^-1((ln mu_ref - m0)/s)``; a law
that waits for an error comes too late for the next edge. A texture moves W all the time, and what
is felt is h of that W after the force path: a Kalman filter learns m0 and s from each tick, by an
h that has gone through a model of that path.

The functions are plain ones of floats and named tuples.
"""

from __future__ import annotations

from math import log, sqrt
from typing import Final, NamedTuple

from smarttac_can.control.friction import limited_step, relative_error
from smarttac_can.control.friction_map import MEAN, amplitude_for, value
from smarttac_can.control.predictive_friction import (
    FROZEN_TICKS,
    MU_MIN,
    NO_SAMPLE,
    PATH,
    FrictionSample,
    Path,
)

STEEPNESS_VARIANCE: Final = 0.25
"""Variance of s over fingers."""
FLATTEST: Final = 0.25
"""Least s: nothing that is learned makes the map turn round."""
STEEPEST: Final = 4.0
LEVEL_VARIANCE: Final = 0.04
"""Variance of m0 when a finger begins to slide."""
LEVEL_DRIFT: Final = 1e-6
"""Variance that m0 gains in a tick: sweat, force and place move it by 3 % in a second."""
FORGOTTEN: Final = 1e-5
"""Share of what was learned of s that is forgotten in a tick."""
MODEL_VARIANCE: Final = 4e-4
"""Variance of ln mu in a tick by what is not noise: the skin follows, and h is another one."""
GATE: Final = 4.0
"""Standard deviations beyond which an error of a tick counts no more."""
LASTING_SHARE: Final = 0.05
"""Share of the error of a tick in the lasting one."""
LASTING_MAX: Final = 0.1
"""Lasting error of ln mu from which m0 is not known any more: another place, or another finger."""
LOST_VARIANCE: Final = 0.01
"""Variance of m0 then."""
BUMP_KEPT: Final = 0.85
"""Share of the first step of the amplitude, made once a finger is known to slide, that is left for
the next tick."""

LAG_KEPT: Final = 0.6
"""Share of a rise of the amplitude by which |W| may still lag in the next tick."""
BEHIND: Final = 0.15e-6
"""Distance in m by which |W| lags farther, from which the plate does not follow."""
BEHIND_TICKS: Final = 100
"""Ticks of that in which nothing is learned: by then a lack of the pick-up is a fault."""
SLOPE: Final = 0.04e-6
"""Step of the amplitude in m per % of friction error while it does not, of the paper's eq. (9)."""
STEP_MAX: Final = 1e-6
"""Largest such step in m."""


class Known(NamedTuple):
    """What is known of a finger, and its covariance."""

    m0: float
    """ln mu without vibration, here and now."""
    s: float
    """Steepness of its map, 1 in the mean over fingers."""
    mm: float
    ms: float
    ss: float


class TextureState(NamedTuple):
    """State of the law while a finger touches."""

    known: Known
    slides: bool
    """Whether m0 was measured; the amplitude is held until it is."""
    since_turn: int
    """Ticks since the touch began, or the finger turned."""
    path: Path
    """h after the force path."""
    lasting: float
    """Filtered error of ln mu."""
    bump: float
    """What is left of the first step of the amplitude, in m."""
    risen: float
    """What is left of its rises, in m."""
    lag_ticks: int
    """Ticks in a row in which the plate has not followed."""
    W_map: float
    """Amplitude in m by the map, within its limits."""
    W_ref: float
    """Amplitude in m that is asked for: the same, or, where the plate does not follow by a lack of
    voltage or a pick-up that reads too little, as by the law ``measured``."""
    sample: FrictionSample
    """The last tick."""


ANYBODY: Final = Known(0.0, 1.0, LEVEL_VARIANCE, 0.0, STEEPNESS_VARIANCE)
"""Any finger."""


def begin_texture(sample: FrictionSample, known: Known) -> TextureState:
    """Return the state when a touch or the mode begins: it asks for the amplitude there is.

    Parameters
    ----------
    sample
        The first tick.
    known
        What was learned before.
    """
    W = sample.W
    return TextureState(known, False, 0, Path(value(MEAN, W), 0.0), 0.0, 0.0, 0.0, 0, W, W, sample)


def follow_texture(touch: TextureState, sample: FrictionSample, W_max: float) -> TextureState:
    """Return the state a tick later; W_max is the limit of the amplitude in m."""
    known, slides, since_turn, path, lasting, bump, risen, lag_ticks, W_before, W_ref, last = touch
    W_map = W_before
    path = _through_path(path, 0.5 * (value(MEAN, last.W) + value(MEAN, sample.W)))
    since_turn += 1
    if sample.Fx * last.Fx + sample.Fy * last.Fy < 0.0:
        since_turn, lasting = 0, 0.0
    starts = False
    if since_turn >= FROZEN_TICKS and sample.mu >= MU_MIN:
        if slides and 0 < lag_ticks <= BEHIND_TICKS:
            lasting = 0.0
        elif slides:
            error = log(sample.mu) - known.m0 - known.s * path.y
            lasting += LASTING_SHARE * (error - lasting)
            lost = abs(lasting) > LASTING_MAX
            known = learned(known, path.y, error, sample.u_mu / sample.mu, lost)
        else:
            slides = starts = True
            m0 = log(sample.mu) - known.s * path.y
            known = Known(m0, known.s, LEVEL_VARIANCE, 0.0, known.ss)
    if slides:
        asked = amplitude_for(MEAN, (log(sample.mu_ref) - known.m0) / known.s)
        bump = W_before - asked if starts else BUMP_KEPT * bump
        W_map = asked + bump
        W_map = 0.0 if W_map < 0.0 else W_max if W_map > W_max else W_map
        risen = LAG_KEPT * risen + W_map - W_before
        risen = risen if risen > 0.0 else 0.0
        W_ref = W_map
        lag_ticks = lag_ticks + 1 if W_map - sample.W - risen > BEHIND else 0
        if lag_ticks:
            W_ref = sample.W + limited_step(
                SLOPE, STEP_MAX, relative_error(sample.mu, sample.mu_ref)
            )
    return TextureState(
        known, slides, since_turn, path, lasting, bump, risen, lag_ticks, W_map, W_ref, sample
    )


def learned(known: Known, h: float, error: float, relative: float, lost: bool) -> Known:
    """Return what is known after a tick of sliding.

    Parameters
    ----------
    known
        Before it.
    h
        After the force path.
    error
        By how much ln mu is above what was expected.
    relative
        Standard uncertainty of the COF over the COF.
    lost
        Whether the errors last.
    """
    m0, s, mm, ms, ss = known
    mm += LEVEL_DRIFT
    if lost and mm < LOST_VARIANCE:
        mm = LOST_VARIANCE
    ms *= 1.0 - FORGOTTEN
    ss += FORGOTTEN * (STEEPNESS_VARIANCE - ss)
    by_m, by_s = mm + ms * h, ms + ss * h
    spread = by_m + by_s * h + relative * relative + MODEL_VARIANCE
    most = GATE * sqrt(spread)
    share = (most if error > most else -most if error < -most else error) / spread
    s += by_s * share
    return Known(
        m0 + by_m * share,
        FLATTEST if s < FLATTEST else STEEPEST if s > STEEPEST else s,
        mm - by_m * by_m / spread,
        ms - by_m * by_s / spread,
        ss - by_s * by_s / spread,
    )


def _through_path(path: Path, middle: float) -> Path:
    """Step the force path with h as it is in the middle of the tick."""
    away = path.y - middle
    return Path(
        middle + PATH.yy * away + PATH.yr * path.rate,
        PATH.ry * away + PATH.rr * path.rate,
    )


NO_TEXTURE_STATE: Final = begin_texture(NO_SAMPLE, ANYBODY)
"""Before the first touch, which takes nothing of it but `ANYBODY`."""

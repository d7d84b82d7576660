"""Mode TEXTURE: the COF reference at the place where the finger will be, and its C_mu.

The COF follows its reference after some ticks, the preview. The finger is then at
``x + (lag + preview) v``, so the value at this position is the present reference. A table over time
is read ahead in time.

A straight line through the latest positions gives position and speed of the finger. The centre of
pressure of one tick has an error of 0.24 mm under 1 N. A short memory averages little of it, and a
long one is late at a turn. So the memory grows with the samples, and becomes short again when they
deviate from the line.

C_mu takes the amplitude from a friction map that is learned while the texture plays:
``ln mu = m0 + s h(W)``, with the mean h of `smarttac_can.science.control.friction_map` over all
fingers. At an edge the amplitude changes at once, ``W_ref = h^-1((ln mu_ref - m0)/s)``; a law that
waits for an error would be too late for the next edge. A texture changes W all the time, and the
measured COF shows h of that W after the skin and the force path. A Kalman filter therefore learns
m0 and s from each tick, with an h that has passed a model of both: the skin follows with the
cut-off ``v/(2 pi SKIN_WAY)``.

Its error is not white. Two things are correlated in time, and would make s wrong and sure of it:

* m0 moves, with the speed of a turning finger by tens of percent in 0.1 s. C_mu answers by W, so
  that the COF stays, whatever h does, and the map seems flat. So the uncertainty of m0 is at least
  `LEVEL_DOUBT` times the error that lasts: m0 takes it, and s does not.
* The model of the path is some tenths of a ms off, which makes an error in proportion to the rate
  of h, the same in each period. It counts as noise, by its correlation time. So s is learned from
  what is slow beside the path, and hardly from what is fast.

The amplitude loop is slow beside a fast texture, with a dead time above all. ``W_ref`` is the
amplitude of the map behind the inverse of this loop (`smarttac_can.science.control.design`).

All functions are pure, with floats and named tuples.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import exp, log, sqrt
from typing import Final, NamedTuple

from smarttac_can.science.control.design import Inverse
from smarttac_can.science.control.friction import limited_step, relative_error
from smarttac_can.science.control.friction_map import MEAN, amplitude_for, value
from smarttac_can.science.control.predictive_friction import (
    FROZEN_TICKS,
    MU_MIN,
    NO_SAMPLE,
    PATH_LAG,
    FrictionSample,
    Path,
    through_path,
)
from smarttac_can.vocabulary.signals import TICK
from smarttac_can.vocabulary.textures import Axis, TextureTable, cof_at

POSITION_LAG: Final = PATH_LAG
"""Delay of the measured position in s. Its filter adds no delay at a steady speed."""
SHORT: Final = 40.0
"""Memory in samples while the finger turns."""
LONG: Final = 400.0
"""Longest memory in samples."""
BEND_SHARE: Final = 0.05
"""Filter factor of the bend per sample; its noise is a sixth of that of a sample."""
BENT: Final = 4.0 * sqrt(BEND_SHARE / (2.0 - BEND_SHARE))
"""Bend above which the finger has left the line, in uncertainties of a sample: 4 of its own."""
_NM_PER_M: Final = 1e9
_US_PER_S: Final = 1e6


class Texture(NamedTuple):
    """A table as used by the controllers."""

    by_position: bool
    repeats: bool
    start: int
    step: int
    values: Sequence[float]
    """COF in 1e-4; empty for no texture."""


NO_TEXTURE: Final = Texture(True, False, 0, 1, ())


def texture_of(table: TextureTable) -> Texture:
    """Return a table in the form used by the controllers."""
    return Texture(
        table.axis is Axis.POSITION, table.repeats, table.start, table.step, table.values
    )


def cof_ahead(texture: Texture, ticks: int, position: float, speed: float, preview: float) -> float:
    """Return the reference of the COF in a tick.

    Parameters
    ----------
    texture
        Texture to play.
    ticks
        Ticks since its start, for a table over time.
    position, speed
        Position and speed of the finger in m and m/s, for a table over the position.
    preview
        Delay of the COF behind its reference in s.
    """
    by_position, repeats, start, step, values = texture
    if by_position:
        place = (position + (POSITION_LAG + preview) * speed) * _NM_PER_M
    else:
        place = (ticks * TICK + preview) * _US_PER_S
    return cof_at(values, repeats, start, step, place)


class Line(NamedTuple):
    """The straight line through the latest positions of a touch."""

    position: float
    """Position in this tick in m."""
    speed: float
    """Speed in m/s."""
    samples: float
    """Memory in samples."""
    bend: float
    """Filtered distance in m between the samples and the line's prediction."""


def line_from(position: float) -> Line:
    """Return the line at the start of a touch, at a measured position in m."""
    return Line(position, 0.0, 1.0, 0.0)


def prolonged(line: Line, position: float, unsure: float) -> Line:
    """Return the line a tick later, with the gains of the least-squares line through its samples.

    Parameters
    ----------
    line
        Line of the tick before.
    position
        Measured position in m of this tick.
    unsure
        Standard uncertainty of the position in m; 0 keeps the memory short.
    """
    before, speed, n, bend = line
    expected = before + TICK * speed
    residual = position - expected
    bend += BEND_SHARE * (residual - bend)
    if n > SHORT and abs(bend) >= BENT * unsure:
        n = SHORT
    elif n < LONG:
        n += 1.0
    square = n * (n + 1.0)
    alpha = (4.0 * n - 2.0) / square
    return Line(expected + alpha * residual, speed + 6.0 / (square * TICK) * residual, n, bend)


# C_mu of the mode: what it learns of a finger, and the amplitude that it asks for.

STEEPNESS_VARIANCE: Final = 0.25
"""Variance of s over fingers."""
FLATTEST: Final = 0.25
"""Least s, so that the learned map cannot rise."""
STEEPEST: Final = 4.0
LEVEL_VARIANCE: Final = 0.04
"""Variance of m0 when a finger begins to slide."""
LEVEL_DRIFT: Final = 1e-6
"""Variance that m0 gains per tick: sweat, force and position change it by 3 % in a second."""
FORGOTTEN: Final = 1e-5
"""Fraction of the learned s that fades per tick."""
MODEL_VARIANCE: Final = 4e-4
"""Variance of ln mu in a tick without noise: by another h."""
GATE: Final = 4.0
"""Standard deviations to which the error of a tick is limited."""
LASTING_SHARE: Final = 0.05
"""Filter factor of the lasting error per tick."""
LEVEL_DOUBT: Final = 2.0
"""Least standard uncertainty of m0, in lasting errors."""
SKIN_WAY: Final = 11.5e-6
"""Way in m over which friction follows the map, as measured: arXiv:2505.11162."""
STRETCH_LEAD: Final = 0.15
"""Fraction of a fast change of h that more amplitude makes up for. To pull more the skin stretches;
meanwhile its speed falls behind, and friction with it: in the mean over random fingers the COF has
0.90 of a slow swing at 100 Hz and 0.85 at 172 Hz, between 0.7 and 1.05 for 8 of 10."""
STRETCH_KEPT: Final = 0.5
"""Fraction of the distance to a slow change that is left after a tick: 110 Hz, by stiffness and
damping of the skin."""
UNEVEN: Final = TICK / 6.0
"""Part of the curvature of h, in s, that a path lacks whose input is the mean of two ticks for a
tick: with ``x = 2 pi f TICK`` it has ``cos(x/2) sin(x/2)/(x/2) = 1 - x^2/6`` of a swing."""
SLOWEST: Final = 5e-3
"""Least speed in m/s for the lag of the skin."""
PATH_TIME: Final = 0.2e-3
"""Standard uncertainty of the delay of the force path in s, an assumption."""
SKIN_SHARE: Final = 0.5
"""That of the lag of the skin, as a fraction of it."""
SAME_SIGN: Final = 100.0
"""Ticks in which such an error is the same, so that they tell no more than one."""
BUMP_KEPT: Final = 0.85
"""Fraction of the first step of the amplitude that is left for the next tick. That step follows
when the finger is first known to slide."""

LAG_KEPT: Final = 0.6
"""Fraction of a rise of the amplitude by which |W| may still lag in the next tick."""
BEHIND: Final = 0.15e-6
"""Additional lag of |W| in m above which the plate does not follow."""
BEHIND_TICKS: Final = 100
"""Ticks of such a lag without learning; after them a lack of vibration is a fault."""
SLOPE: Final = 0.04e-6
"""Step of the amplitude in m per % of friction error during such a lag; paper, eq. (9)."""
STEP_MAX: Final = 1e-6
"""Largest such step in m."""


class Known(NamedTuple):
    """Knowledge of a finger, and its covariance."""

    m0: float
    """Present ln mu without vibration."""
    s: float
    """Steepness of the map; 1 is the mean over fingers."""
    mm: float
    ms: float
    ss: float


class TextureState(NamedTuple):
    """State of the law while a finger touches."""

    known: Known
    slides: bool
    """Whether m0 was measured; until then the amplitude is held."""
    since_turn: int
    """Ticks since the start of the touch, or since the last turn of the finger."""
    skin: float
    """h after the lag of the skin."""
    path: Path
    """The same after the force path."""
    slow: float
    """Slow part of h after skin, force path and stretch."""
    slow_asked: float
    """Slow part of the h that is asked for."""
    lasting: float
    """Filtered error of ln mu."""
    bump: float
    """Rest of the first step of the amplitude in m."""
    risen: float
    """Rest of rises of the amplitude in m."""
    lag_ticks: int
    """Number of ticks in a row in which the plate has not followed."""
    W_map: float
    """Amplitude in m from the map, within its limits."""
    W_last: float
    """That of the tick before."""
    W_ref: float
    """Amplitude reference in m: `W_map` before the inverse of the amplitude loop. If the plate does
    not follow, due to a lack of voltage or a pick-up that reads too little, it is that of the law
    ``measured``."""
    sample: FrictionSample
    """Data of the last tick."""


ANYBODY: Final = Known(0.0, 1.0, LEVEL_VARIANCE, 0.0, STEEPNESS_VARIANCE)
"""Knowledge before learning, for any finger."""


def begin_texture(sample: FrictionSample, known: Known) -> TextureState:
    """Return the state at the start of a touch or of the mode; it keeps the present amplitude.

    Parameters
    ----------
    sample
        Data of the first tick.
    known
        Knowledge learned before.
    """
    W = sample.W
    h = value(MEAN, W)
    return TextureState(known, False, 0, h, Path(h, 0.0), h, h, 0.0, 0.0, 0.0, 0, W, W, W, sample)


def follow_texture(
    touch: TextureState, sample: FrictionSample, speed: float, W_max: float, inverse: Inverse
) -> TextureState:
    """Return the state a tick later.

    Parameters
    ----------
    touch, sample
        State before, and data of this tick.
    speed
        Speed of the finger in m/s.
    W_max
        Limit of the amplitude in m.
    inverse
        Inverse of the amplitude loop.
    """
    (
        known, slides, since_turn, skin_before, path, slow, slow_asked,
        lasting, bump, risen, lag_ticks, W_before, W_older, W_ref, last,
    ) = touch  # fmt: skip
    W_map = W_before
    lag = SKIN_WAY / max(abs(speed), SLOWEST)
    skin = through_skin(skin_before, value(MEAN, last.W), value(MEAN, sample.W), lag)
    rate = path.rate
    path = through_path(path, 0.5 * (skin_before + skin))
    felt = path.y - UNEVEN * (path.rate - rate)
    h = (felt + STRETCH_LEAD * slow) / (1.0 + STRETCH_LEAD)
    slow = h + STRETCH_KEPT * (slow - h)
    since_turn += 1
    if sample.Fx * last.Fx + sample.Fy * last.Fy < 0.0:
        since_turn, lasting = 0, 0.0
    starts = False
    if since_turn >= FROZEN_TICKS and sample.mu >= MU_MIN:
        if slides and 0 < lag_ticks <= BEHIND_TICKS:
            lasting = 0.0
        elif slides:
            error = log(sample.mu) - known.m0 - known.s * h
            lasting += LASTING_SHARE * (error - lasting)
            noise = sample.u_mu / sample.mu
            late = (PATH_TIME + SKIN_SHARE * lag) * known.s * path.rate
            variance = noise * noise + MODEL_VARIANCE + SAME_SIGN * late * late
            known = learned(known, h, error, variance, LEVEL_DOUBT * lasting)
        else:
            slides = starts = True
            m0 = log(sample.mu) - known.s * h
            known = Known(m0, known.s, LEVEL_VARIANCE, 0.0, known.ss)
    if slides:
        h = (log(sample.mu_ref) - known.m0) / known.s
        asked = amplitude_for(MEAN, h + STRETCH_LEAD * (h - slow_asked))
        slow_asked = h + STRETCH_KEPT * (slow_asked - h)
        bump = W_before - asked if starts else BUMP_KEPT * bump
        W_map = asked + bump
        W_map = 0.0 if W_map < 0.0 else W_max if W_map > W_max else W_map
        risen = LAG_KEPT * risen + W_map - W_before
        risen = risen if risen > 0.0 else 0.0
        W_ref = inverse.new * W_map + inverse.last * W_before + inverse.older * W_older
        lag_ticks = lag_ticks + 1 if W_map - sample.W - risen > BEHIND else 0
        if lag_ticks:
            W_ref = sample.W + limited_step(
                SLOPE, STEP_MAX, relative_error(sample.mu, sample.mu_ref)
            )
    return TextureState(
        known, slides, since_turn, skin, path, slow, slow_asked,
        lasting, bump, risen, lag_ticks, W_map, W_before, W_ref, sample,
    )  # fmt: skip


def through_skin(skin: float, before: float, after: float, lag: float) -> float:
    """Return h after a first-order lag in s, a tick later, in which its input is a ramp."""
    late = (after - before) * (lag / TICK)
    return after - late + (skin - before + late) * exp(-TICK / lag)


def learned(known: Known, h: float, error: float, variance: float, doubt: float) -> Known:
    """Return the knowledge after a tick of sliding.

    Parameters
    ----------
    known
        Knowledge before it.
    h
        Value of h after skin and force path.
    error
        Measured ln mu minus the expected one.
    variance
        Variance of this error, without that of what is known.
    doubt
        Least standard uncertainty of m0, of either sign.
    """
    m0, s, mm, ms, ss = known
    mm += LEVEL_DRIFT
    mm = max(mm, doubt * doubt)
    ms *= 1.0 - FORGOTTEN
    ss += FORGOTTEN * (STEEPNESS_VARIANCE - ss)
    by_m, by_s = mm + ms * h, ms + ss * h
    spread = by_m + by_s * h + variance
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


NO_TEXTURE_STATE: Final = begin_texture(NO_SAMPLE, ANYBODY)
"""State before the first touch, of which only `ANYBODY` is used."""

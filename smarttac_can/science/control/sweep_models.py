"""Models of two sweeps at different voltages, and the tests that choose between them.

In steady state one resonance has ``y = V/W = (1 + j T (f - f0))/gain`` with ``T = 2 pi tau``: a
straight line over f, across a straight line of the complex plane. A plate may differ from it:

* Its resonance falls with the amplitude, or with its square (Duffing): y gains ``j c |W|**p``.
* Its losses grow with the amplitude or its square: y gains ``c |W|**p``.
* The pick-up sees a second mode: ``W/V`` is the sum of two resonances, and y is bent.

Within one sweep these look alike, as |W| depends on f. **Two sweeps part them**: a linear plate has
the same y at the same f, whatever its modes are. So c follows from the differences between both
sweeps alone, at frequencies that both have, and needs no model of the plate. The line and the
second mode are then fitted to what is left of y.

**Bent or not.** A quadratic is fitted to y; that of one resonance has no curvature. But near its
resonance a carrier has an envelope of first order only to within ``u = (f - f0)/f0``: a pick-up of
displacement reads ``y (1 + u)``, one of speed y, one of acceleration ``y (1 - u)``, each with
``x (1 - u/2)`` for x. That tilts and bends y by up to ``1.5 half/f0``, 0.6 % at the ends of the
sweep. The mean of a few ticks at rest leaves an error of the pick-up's offset, which bends y as
well. What is more than these and 4.5 standard deviations is no single resonance.

**Two modes.** ``W/V`` is a quotient of two polynomials, ``(b0 + b1 x)/(1 + a1 x + a2 x**2)``, with
complex numbers. The first fit multiplies by the denominator and is linear (Levy); the next divides
by the denominator so far (Sanathanan and Koerner); then Gauss-Newton steps make the fit unbiased.
Each is one least squares of four complex numbers. The poles are the resonances, their residues the
gains, and the covariance says how sure these are. There is no search, and nothing is assumed of the
second mode: not its tau, and not the phase with which it is seen.

**What cannot be told.** Expand a second mode of share b and the same tau, d half bandwidths off::

    b/(1 + j (x - d)) = b/(1 + j x) + j b d/(1 + j x)**2 - b d**2/(1 + j x)**3 ...

The first term is a gain, the second a shift of f0 by ``b d`` half bandwidths: a single plate does
both. Only the third is seen, where gain, tau, offset and carrier do not make up for it. With the
default pick-up, 1 nm a tick and so 0.3 nm for a point at 0.8 um, half of the plates are remarked at
``b d**2 = 0.006``. By the bound of Cramer and Rao 4.5 standard deviations are 0.0026 for one who
knows the offset, and that both modes have one tau. So for the default plate, of 169 Hz for half a
bandwidth, by simulation (`tests/science/control/test_identification.py` has some of these):

=========  ===================  =======================================================
distance   always remarked      a weaker one is silent, and adds at most
=========  ===================  =======================================================
30 Hz      none up to 10 %      its share to the gain: +9.8 %, tau -0.5 %, f0 2.8 Hz
45 Hz      from 14 % on         its share to the gain: +9.5 %, tau -0.9 %, f0 4 Hz
60 Hz      from 7 % on          +4.6 %, tau -0.8 %, f0 2.7 Hz
90 Hz      from 5 % on          +3.2 %, tau -1.3 %, f0 3 Hz
138 Hz     from 4 % on          +1.8 %, tau -1.7 %, f0 2.8 Hz
300 Hz     from 1 % on
=========  ===================  =======================================================

With ten times the noise it takes ten times the share. The control loses little by a silent one: the
pick-up reads the sum of both, and the model reads what it reads to 0.4 %. What the finger feels may
differ by the share. A second mode of twice or half the tau is seen from 2 % on at 30 Hz already.

Levy, IRE Trans. Automatic Control AC-4 (1959) 37, and Sanathanan and Koerner, IEEE Trans. Automatic
Control 8 (1963) 56: known from what others write of them, not read.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Sequence
from typing import Final, NamedTuple

FIT_STEPS: Final = 6
"""Steps of a fit of two modes."""
_STEPS_OF_LINES: Final = 2
"""The first steps of such a fit, which need no start."""
_FLOOR: Final = 1e-4
"""Relative error of a point besides its noise: resolution, and what has not settled."""
_CARRIER: Final = 1.5
"""How much the carrier tilts and bends y, relative to half of the width of the sweep over f0."""
_SIGNIFICANT: Final = 4.5
"""Standard deviations that are not noise."""
_CHANCE: Final = 7.0
"""Standard deviations of a sum of squares that are not noise."""
_SQUARE_INSTEAD: Final = 9.0
"""Sum of squares by which a growth with the square of the amplitude has to be nearer."""
_PART: Final = 0.15
"""Largest difference of the sweeps beyond a growth, relative to it, that is not remarked."""
_KNOWN_GAIN: Final = 0.015
"""Largest relative uncertainty of the gain of a mode that is told apart from a second one."""
_KNOWN_SHARE: Final = 0.35
"""Largest relative uncertainty of the gain of a second mode that is told."""
_SINGULAR: Final = 1e-13
"""Pivot, relative to its diagonal, below which equations have no single solution."""


class Point(NamedTuple):
    """Mean vibration at one frequency of a sweep."""

    f: float
    V: float
    W: complex
    deviation: float
    """Standard deviation of the mean in m, of each axis."""


class Inverse(NamedTuple):
    """``y = V/W`` at one frequency."""

    f: float
    y: complex
    size: float
    """Amplitude |W| in m."""
    unsure: float
    """Standard uncertainty of each axis of y."""


class Growth(NamedTuple):
    """What one axis of y gains with the amplitude."""

    value: float
    """In V/m at an amplitude of 1 m; 0 if there is no growth beyond the noise."""
    power: int
    """1 or 2: with the amplitude or with its square."""
    squares: float
    """Sum of the squared differences that remain, in standard deviations."""
    most: float
    """Largest of these differences."""

    def of(self, size: float) -> float:
        """Return the growth at an amplitude in m."""
        return self.value * size**self.power


class Modes(NamedTuple):
    """Two resonances that fit a sweep."""

    gain: float
    tau: float
    f0: float
    share: float
    """Gain of the second mode relative to that of the first."""
    offset: float
    """Resonance of the second mode minus that of the first in Hz."""


class Quotient(NamedTuple):
    """Two modes as a quotient of polynomials in ``x = (f - middle)/half``."""

    numbers: tuple[complex, ...]
    """a1, a2, b0, b1 of ``W/V = gain (b0 + b1 x)/(1 + a1 x + a2 x**2)``."""
    normal: list[list[complex]]
    """Inverse covariance of these numbers."""


def noise_of(*sweeps: Sequence[Point]) -> float:
    """Return the standard deviation in m, of each axis, that all points show together."""
    deviations = [point.deviation for points in sweeps for point in points]
    return math.sqrt(math.fsum(s * s for s in deviations) / len(deviations))


def inverses(points: Sequence[Point], noise: float) -> list[Inverse]:
    """Return y of a sweep whose points have a noise in m; a point without vibration has none."""
    return [
        Inverse(f, V / W, size, math.hypot(noise / size, _FLOOR) * V / size)
        for f, V, W, _ in points
        if (size := abs(W))
    ]


def growths(
    first: Sequence[Inverse], check: Sequence[Inverse], offset: float
) -> tuple[Growth, Growth]:
    """Return the growths of both axes by the differences of two sweeps: losses, and fall of f0.

    Parameters
    ----------
    first, check
        The sweeps. The frequencies of the second one are among those of the first.
    offset
        Standard uncertainty of each axis of the pick-up's offset in m.
    """
    at = {point.f: point for point in first}
    pairs = [(at[point.f], point) for point in check if point.f in at]
    losses, falls = (
        [_growth(pairs, axis, power, offset) for power in (1, 2)] for axis in (1.0, -1j)
    )
    return _nearer(*losses), _nearer(*falls)


def _nearer(linear: Growth, square: Growth) -> Growth:
    return square if square.squares + _SQUARE_INSTEAD < linear.squares else linear


def _growth(
    pairs: Sequence[tuple[Inverse, Inverse]], axis: complex, power: int, offset: float
) -> Growth:
    """Fit the growth with one power; y times the axis has it as its real part."""
    differences = [
        (
            one.size**power - other.size**power,
            (axis * (one.y - other.y)).real,
            math.hypot(one.unsure, other.unsure),
            # What an offset of the pick-up adds to the difference.
            offset * (abs(other.y) / other.size - abs(one.y) / one.size),
        )
        for one, other in pairs
    ]
    information = math.fsum((a / s) ** 2 for a, _, s, _ in differences) or math.inf
    value = math.fsum(a * d / (s * s) for a, d, s, _ in differences) / information
    shifted = math.fsum(a * o / (s * s) for a, _, s, o in differences) / information
    if abs(value) < _SIGNIFICANT * math.hypot(1.0 / math.sqrt(information), shifted):
        value = 0.0
    left = [(d - value * a, math.hypot(s, o)) for a, d, s, o in differences]
    squares = math.fsum((d / s) ** 2 for d, s in left)
    return Growth(value, power, squares, max((abs(d) for d, _ in left), default=0.0))


def without(
    points: Sequence[Inverse], losses: Growth | None, falls: Growth, slope: float
) -> list[Inverse]:
    """Return what a sweep would be at no amplitude.

    The fall of f0 shifts the frequencies. For a straight line this is the same as a shift of y by
    the slope in V/m/Hz; for a bent one it is right as well. Losses that are None stay as they are.
    """
    return [
        point._replace(
            f=point.f + falls.of(point.size) / slope,
            y=point.y - (losses.of(point.size) if losses else 0.0),
        )
        for point in points
    ]


def unexplained_by(losses: Growth, falls: Growth, size: float, pairs: int) -> float:
    """Return the difference of the sweeps in V/m that no growth explains; 0 for none.

    It counts beyond the noise and beyond a part of the growths at an amplitude in m: a second mode
    bends the line, and so changes what a growth does.
    """
    most = math.hypot(losses.most, falls.most)
    part = _PART * (abs(losses.of(size)) + abs(falls.of(size)))
    if most <= part or _by_chance(losses.squares + falls.squares, 2 * pairs - 2):
        return 0.0
    return most


def _by_chance(squares: float, freedom: int) -> bool:
    """Return whether noise explains a sum of squared standard deviations."""
    return squares <= freedom + _CHANCE * math.sqrt(2.0 * freedom)


def is_bent(points: Sequence[Inverse], offset: float) -> bool:
    """Return whether y differs from the line of one resonance by more than noise and carrier.

    Parameters
    ----------
    points
        The sweep, at no amplitude. Fewer than three of them are no line.
    offset
        Standard uncertainty of each axis of the pick-up's offset in m.
    """
    middle, half = _scale(points)
    rows = [
        [term / unsure for term in (1.0, x, x * x, y)]
        for f, y, _, unsure in points
        for x in ((f - middle) / (half or 1.0),)
    ]
    normal, side = _normal(rows)
    try:
        level, tilt, bend = _solved(normal, side)
    except ArithmeticError:
        return True
    left = math.fsum(abs(y - level * a - tilt * b - bend * c) ** 2 for a, b, c, y in rows)
    carrier = _CARRIER * half / middle * abs(level)
    # An offset adds (1 + j x)**2 times this to y.
    shift = offset * abs(level) / max(size for _, _, size, _ in points)
    noise_of_tilt = _SIGNIFICANT * math.hypot(_uncertainty(normal, (0.0, 1.0, 0.0)), 2.0 * shift)
    noise_of_bend = _SIGNIFICANT * math.hypot(_uncertainty(normal, (0.0, 0.0, 1.0)), shift)
    return (
        abs(tilt.real) > noise_of_tilt + carrier
        or abs(bend.real) > noise_of_bend
        or abs(bend.imag) > noise_of_bend + carrier
        or not _by_chance(left, 2 * len(points) - 6)
    )


def next_fit(points: Sequence[Inverse], gain: float, fit: Quotient | None, step: int) -> Quotient:
    """Do one of the `FIT_STEPS` of a fit of two modes.

    Parameters
    ----------
    points
        The sweep, at no amplitude.
    gain
        Gain of the sweep in m/V, which makes the numbers about 1.
    fit
        Result of the step before; None for step 0.
    step
        Number of the step.

    Raises
    ------
    ArithmeticError
        The fit has no single solution.
    """
    rows: list[list[complex]] = []
    for x, seen, unsure in _seen(points, gain):
        below, model = (1.0 + 0j, seen) if fit is None else _quotient(fit.numbers, x)
        off = seen - model
        if step < _STEPS_OF_LINES:
            off, model = 0j, seen
        terms = (-model * x, -model * x * x, 1.0, x, model + below * off)
        rows.append([term / (below * unsure) for term in terms])
    normal, side = _normal(rows)
    return Quotient(_solved(normal, side), normal)


def modes_of(points: Sequence[Inverse], gain: float, fit: Quotient) -> Modes | None:
    """Return the modes of a fit, the stronger one first; None if it does not tell them apart."""
    middle, half = _scale(points)
    left = math.fsum(
        abs((seen - _quotient(fit.numbers, x)[1]) / unsure) ** 2
        for x, seen, unsure in _seen(points, gain)
    )
    a1, a2, _, _ = fit.numbers
    root = cmath.sqrt(a1 * a1 - 4.0 * a2)
    modes = [_mode(fit, -2.0 / (a1 + sign * root)) for sign in (1.0, -1.0)]
    one, two = sorted(modes, key=lambda mode: -mode.strength)
    known = one.unsure <= _KNOWN_GAIN and two.residue_unsure <= _KNOWN_SHARE
    if not known or one.pole.imag <= 0.0 or not _by_chance(left, 2 * len(points) - 8):
        return None
    return Modes(
        gain * one.strength,
        1.0 / (2.0 * math.pi * half * one.pole.imag),
        middle + half * one.pole.real,
        two.strength / one.strength,
        half * (two.pole.real - one.pole.real),
    )


class _Mode(NamedTuple):
    """One mode of a quotient: ``W/V = residue/(x - pole)``."""

    pole: complex
    """Its resonance, with its half bandwidth as the imaginary part."""
    strength: float
    """Size of W/V at its resonance."""
    unsure: float
    """Relative standard uncertainty of the strength."""
    residue_unsure: float
    """That of the residue."""


def _mode(fit: Quotient, pole: complex) -> _Mode:
    """Return the mode at a root of the denominator, as sure as the numbers of the fit are."""
    a1, a2, b0, b1 = fit.numbers
    slope = a1 + 2.0 * a2 * pole
    residue = (b0 + b1 * pole) / slope
    # How pole and residue change with each of the numbers.
    poles = [-pole / slope, -pole * pole / slope, 0j, 0j]
    slopes = [1.0 + 2.0 * a2 * poles[0], 2.0 * (pole + a2 * poles[1]), 0j, 0j]
    tops = [b1 * poles[0], b1 * poles[1], 1.0 + 0j, pole]
    residues = [
        top / (residue * slope) - turned / slope for top, turned in zip(tops, slopes, strict=True)
    ]
    strengths = [by + 1j * moved / pole.imag for by, moved in zip(residues, poles, strict=True)]
    return _Mode(
        pole,
        abs(residue / pole.imag),
        _uncertainty(fit.normal, strengths),
        _uncertainty(fit.normal, residues),
    )


def _seen(points: Sequence[Inverse], gain: float) -> list[tuple[float, complex, float]]:
    """Return x, W/V relative to the gain, and its uncertainty."""
    middle, half = _scale(points)
    return [
        ((f - middle) / half, seen, unsure * gain * abs(seen) ** 2)
        for f, y, _, unsure in points
        for seen in (1.0 / (y * gain),)
    ]


def _scale(points: Sequence[Inverse]) -> tuple[float, float]:
    """Return the middle of the sweep and half of its width in Hz."""
    return 0.5 * (points[-1].f + points[0].f), 0.5 * (points[-1].f - points[0].f)


def _quotient(numbers: Sequence[complex], x: float) -> tuple[complex, complex]:
    """Return the denominator and the quotient at one x."""
    a1, a2, b0, b1 = numbers
    below = 1.0 + x * (a1 + x * a2)
    return below, (b0 + x * b1) / below


def _normal(rows: Sequence[Sequence[complex]]) -> tuple[list[list[complex]], list[complex]]:
    """Return the normal equations of rows of regressors, each with its value behind."""
    columns = list(zip(*rows, strict=True))
    *regressors, values = columns
    conjugates = [[z.conjugate() for z in column] for column in regressors]
    matrix = [[_dot(one, other) for other in regressors] for one in conjugates]
    return matrix, [_dot(one, values) for one in conjugates]


def _dot(one: Sequence[complex], other: Sequence[complex]) -> complex:
    return sum((a * b for a, b in zip(one, other, strict=True)), 0j)


def _solved(matrix: Sequence[Sequence[complex]], side: Sequence[complex]) -> tuple[complex, ...]:
    """Solve normal equations; `ArithmeticError` if they have no single solution."""
    rows = [[*row, value] for row, value in zip(matrix, side, strict=True)]
    count = len(rows)
    for i, row in enumerate(rows):
        pivot = row[i].real
        if not _SINGULAR * matrix[i][i].real < pivot < math.inf:
            raise ArithmeticError("the equations have no single solution")
        for below in rows[i + 1 :]:
            factor = below[i] / pivot
            for k in range(i, count + 1):
                below[k] -= factor * row[k]
    solution = [0j] * count
    for i in reversed(range(count)):
        rest = sum(rows[i][j] * solution[j] for j in range(i + 1, count))
        solution[i] = (rows[i][count] - rest) / rows[i][i]
    return tuple(solution)


def _uncertainty(matrix: Sequence[Sequence[complex]], weights: Sequence[complex]) -> float:
    """Return the standard uncertainty of a weighted sum of the solution, on each axis."""
    conjugates = [weight.conjugate() for weight in weights]
    return math.sqrt(max(_dot(weights, _solved(matrix, conjugates)).real, 0.0))

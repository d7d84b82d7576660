"""A fingertip fitted to a recording of forces, motion and vibration.

The skin of the plant slides along the recorded motion, under the recorded normal force and
vibration, and its friction goes through the force path of the gauges. What is left of the recorded
lateral force is least squares in all numbers of `FREE` at once.

Before any data a number is where fingers are: normally distributed, or its logarithm, with 95 % in
the range that `FREE` gives. So the fit has an answer when a recording tells nothing of a number,
and the answer then is that range. A number is told if the recording narrows its range to a third or
less. The others get wide limits, and the numbers that are correlated with them, too.

The limits are those of the linear model at the optimum, with four additions:

* Residuals that are correlated in time tell less than as many independent ones. A residual counts
  by ``1/(1 + 2 sum of its autocorrelation)``.
* Position, normal force and vibration have noise, too. A contact at rest slips under a jitter of
  the position that it never felt, so this does not average out. They are smoothed first. Then noise
  of the size that they had is added `DRAWS` times, and the shift of the optimum, to first order, is
  taken off (as in SIMEX: Cook, Stefanski 1994, doi:10.1080/01621459.1994.10476871), and its mean
  square is added to the variance.
* Two numbers of the recording are fitted besides: zero of the lateral force, and how the vibration
  gets from one tick to the next. The residual of the acceleration, if it was recorded, has a scale
  of its own.
* Several optima may be as good.

They hold for the noise of a recording. A wrong gain of the gauges is a wrong mu0.

Mass, stiffness, damping and creep of the skin share a long valley, which a finger that sticks and
slips makes rough, as the phase of a slip may fit by chance. Where 30 simulated fingers were fitted,
the stiffness was inside its own limits 9 times. So these five numbers are never told: their values
fit the recording together, but not one by one. A fit begins from both ends of the valley, from its
middle and from both of its sides, with means of the residual over the ticks of `STAGES`. Without
the sides 1 of 30 fingers was refused, and 2 had limits that were far too narrow. The result is the
mean of the optima that are as good as the best, and their mean square about it is added to the
variance.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields
from math import exp, expm1, log, pi, sqrt
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from smarttac_can.science.plant.force_path import Propagator, propagator
from smarttac_can.science.plant.friction import FrictionMap, bare_friction
from smarttac_can.science.plant.motion import SUBSTEPS
from smarttac_can.science.plant.parameters import TWO_PI, SensorParameters, require
from smarttac_can.science.plant.skin import Skin, skin_step, slide
from smarttac_can.science.plant.subjects import BOUNDS, FORCE_REFERENCE, SUBJECTS, Subject
from smarttac_can.science.population.compiled import can_compile, compiled
from smarttac_can.science.population.fingers import F0
from smarttac_can.vocabulary.signals import TICK

Floats = npt.NDArray[np.float64]
_SENSORS: Final = SensorParameters()


class Free(NamedTuple):
    """A number that is fitted."""

    low: float
    high: float
    """Range of 95 % of the fingers before any data [A], in SI units."""
    logarithmic: bool
    """Whether its logarithm is normally distributed."""
    told_by: str = ""
    """What a recording needs to tell it."""


_SPEEDS = "sliding at speeds on both sides of it"
_VIBRATION = "sliding with and without vibration, at several amplitudes"
FREE: Final = {
    "mu0": Free(0.15, 1.5, True, "sliding without vibration"),
    "exponent": Free(
        2.0 / 3.0, 1.0, False, "sliding at normal forces that differ by a factor of 2"
    ),
    "occlusion": Free(0.0, 0.3, False, "a contact of some 10 s or more"),
    "occlusion_time": Free(5.0, 80.0, True, "a contact of a minute or more"),
    "rho": Free(0.0, 0.6, False, "sliding with a vibration far above W0"),
    "W0": Free(0.5e-6, 5e-6, True, _VIBRATION),
    "p": Free(0.8, 2.5, True, _VIBRATION),
    "stribeck": Free(0.9, 1.5, False, "sliding from some mm/s to 100 mm/s"),
    "stribeck_speed": Free(5e-3, 0.2, True, _SPEEDS),
    "relaxation_length": Free(
        2e-6, 80e-6, True, "fast changes of the vibration under a slow finger"
    ),
    "skin_mass": Free(0.02e-3, 0.5e-3, True),
    "skin_stiffness": Free(250.0, 4000.0, True),
    "skin_damping": Free(0.2, 5.0, True),
    "creep_ratio": Free(0.1, 2.5, True),
    "creep_time": Free(1.5e-3, 35e-3, True),
    "release_time": Free(4e-3, 0.1, True, "vibration that begins while the finger rests"),
    "_decay": Free(0.2 * TICK, 4.0 * TICK, True),
    "_zero": Free(-20e-3, 20e-3, False),
}
"""What is fitted. The last two, in s and in N, are of the recording, not of the finger."""
_NOT_IN_FORCES: Final = ("load_damping", "load_stiffness")
_NOT_PARTED: Final = ("skin_mass", "skin_stiffness", "skin_damping", "creep_ratio", "creep_time")
"""Numbers whose valley has optima as good as the best outside the limits of any one of them."""
TOLD: Final = 1.0 / 3.0
"""Most of the width of its range before any data that a number that is told may have."""
STAGES: Final = ((40, 0.1), (8, 0.03), (1, 0.01))
"""Ticks over which residuals are averaged, and steps of the numerical derivatives."""
DRAWS: Final = 24
"""Draws of the noise of position, normal force and vibration."""
LEAST_ROWS: Final = 1000
"""Least number of ticks that are compared."""
MOST_SECONDS: Final = 600.0
"""Longest recording in s."""
AS_GOOD: Final = 1.02
"""Sum of squares, over the least one, up to which an optimum is as good."""
MOST_LEFT: Final = 1.5
"""Most residual, over the noise of the lateral force, of a fit that has limits [A]."""
LEAST_NOISE: Final = 1e-3
"""Least noise in N of the lateral force to which a residual is compared [A]."""
_STARTS: Final = ((0.0, 0.0), (-1.2, -1.2), (1.2, 1.2), (-0.6, 0.6), (0.6, -0.6))
"""Stiffness and creep ratio from which a fit begins, as coordinates."""
_ENOUGH: Final = 0.05
"""Gain of a step that ends a descent, in squares of a standard deviation."""
_NORMAL_95: Final = 1.959964
_SEED: Final = 0x46
_MOST_PERIOD: Final = 5e-3
_GAP: Final = 5.0
"""Distance of two rows, in their median, from which on the finger was lifted between them."""
_FORGOTTEN_S, _FORGOTTEN_M = 0.05, 1e-3
"""Time in s and way in m after a gap until the skin has forgotten how it was before."""
_TOUCHING: Final = 0.02
"""Normal force in N above which a finger touches."""
_FORCE_SMOOTHING: Final = 20
_MOST_SMOOTHING: Final = 25
_JITTER: Final = 0.03e-3
"""Standard deviation in m/s of the speed to which the position is smoothed."""
_MOST_LAG: Final = 400
_MOST_STEPS: Final = 25
_MOST_TRIES: Final = 10


class FingerRecording(NamedTuple):
    """What was recorded of a finger: arrays of equal length, in SI units."""

    time: Floats
    """Times in s, rising; 200 rows/s or more. Without rows the finger is lifted."""
    lateral: Floats
    """Friction force in N; its sign is turned to that of the motion."""
    normal: Floats
    """Normal force in N."""
    position: Floats
    """Position in m along the motion."""
    amplitude: Floats | None = None
    """Vibration in m peak-to-peak; None for a plate that does not vibrate."""
    acceleration: Floats | None = None
    """Acceleration of the skin in m/s2 along the motion."""
    path_frequency: float = _SENSORS.path_frequency
    """Natural frequency of the force path in Hz, with the damping ratio of the plate's."""
    frequency: float = F0
    """Frequency of the vibration in Hz."""
    position_by_gauges: bool = False
    """Whether the position is that of the gauges, and has the lag of the normal force."""


class Estimate(NamedTuple):
    """A number of a finger, in SI units, with its 95 % limits."""

    value: float
    low: float
    high: float
    told: bool
    """Whether the recording determines it; if not, its limits are wide, or as for most fingers."""
    reason: str
    """Reason why the recording does not determine it; empty if it does."""


class FingerFit(NamedTuple):
    """A finger fitted to a recording."""

    subject: Subject
    """The finger with all values. Values that are not determined only fit together."""
    numbers: dict[str, Estimate]
    """By the names of the fields of `Subject`."""
    residual: float
    """Standard deviation of the residual of the lateral force, in N."""
    rows: int
    """Number of ticks that were compared."""
    independent: float
    """Number of independent residuals with the same information."""


def _slid(
    friction: FrictionMap,
    skin: Skin,
    constants: tuple[float, Propagator],
    nearing: tuple[float, float],
    rows: Sequence[Sequence[float]],
    out: Floats,
) -> None:
    """Fill the lateral force behind the path, and the acceleration of the skin, tick by tick.

    Parameters
    ----------
    friction, skin
        The finger.
    constants
        Rise of the occlusion in a tick, and a sub-step of the force path.
    nearing
        Share of its distance from where it goes that the vibration keeps in a sub-step, and that
        distance as a multiple of its change in the tick.
    rows
        Position in m, normal force in N and vibration in m of each tick.
    out
        Two numbers for each tick.
    """
    wetting, path = constants
    kept, beyond = nearing
    length = TICK / SUBSTEPS
    v = stretch = creep = Ft = force = rate = occlusion = 0.0
    x, Fn, W = rows[0][0], rows[0][1], rows[0][2]
    for tick in range(1, len(rows)):
        row = rows[tick]
        mean_Fn = 0.5 * (Fn + row[1])
        occlusion += ((1.0 if mean_Fn > _TOUCHING else 0.0) - occlusion) * wetting
        contact = (bare_friction(friction, mean_Fn, occlusion), 1.0, 0.0, 0.0)
        step = skin_step(skin, length, (row[0] - x) / TICK)
        vibration = (complex(kept), 0j, 0j, 0j, complex(W + beyond * (row[2] - W)))
        moving = (complex(W), 0j, W, v, stretch, creep, Ft, force, rate)
        v0 = v
        _, _, _, v, stretch, creep, Ft, force, rate = slide(
            SUBSTEPS, (vibration, step, path), contact, friction, moving
        )
        out[tick, 0] = force
        out[tick, 1] = (v - v0) / TICK
        x, Fn, W = row[0], row[1], row[2]


_NAMES: Final = tuple(FREE)
_LOW: Final = np.array([log(free.low) if free.logarithmic else free.low for free in FREE.values()])
_HIGH: Final = np.array(
    [log(free.high) if free.logarithmic else free.high for free in FREE.values()]
)
_MEAN: Final = 0.5 * (_LOW + _HIGH)
_SIGMA: Final = 0.5 * (_HIGH - _LOW) / _NORMAL_95
# A coordinate u of the fit is a number, or its logarithm, as (number - _MEAN)/_SIGMA.


def _number(name: str, u: float) -> float:
    """Return a number by its coordinate."""
    at = _NAMES.index(name)
    value = float(_MEAN[at] + _SIGMA[at] * u)
    return exp(value) if FREE[name].logarithmic else value


class _Rows(NamedTuple):
    """A recording on the ticks of the plant."""

    given: Floats
    """Position, normal force, vibration, smoothed."""
    seen: Floats
    """Lateral force and, if it was recorded, acceleration, a row each."""
    judged: npt.NDArray[np.bool_]
    """Whether a tick is compared."""
    noise: tuple[float, float, float]
    """Standard deviation of `given` before it was smoothed."""
    smoothing: int
    """Ticks on each side over which the position is smoothed."""
    lateral_noise: float
    """Standard deviation of the noise of the lateral force in N."""


class _Model:
    """The plant on the rows of a recording."""

    def __init__(self, recording: FingerRecording, rows: _Rows) -> None:
        damping = _SENSORS.path_damping
        self._path = propagator(TICK / SUBSTEPS, recording.path_frequency, damping)
        self._frequency = recording.frequency
        self._rows = rows
        self._compiled = can_compile()
        self._run = compiled(_slid) if self._compiled else _slid

    def residuals(self, u: Floats, given: Floats | None = None) -> Floats:
        """Return the residuals of each channel, 0 where they are not judged."""
        s = {name: _number(name, at) for name, at in zip(_NAMES, u.tolist(), strict=True)}
        # Not by `friction_map` and `skin_of` of a Subject: a descent passes a Subject's bounds.
        friction = FrictionMap(
            s["mu0"] * FORCE_REFERENCE,
            s["exponent"],
            s["occlusion"],
            s["mu0"] * pi * self._frequency,
            s["W0"],
            s["p"],
            s["rho"],
            s["stribeck"] - 1.0,
            s["stribeck_speed"],
        )
        skin = Skin(
            s["skin_mass"],
            s["skin_stiffness"],
            s["skin_damping"],
            s["relaxation_length"],
            s["creep_ratio"],
            s["creep_time"],
            s["release_time"],
        )
        constants = (-expm1(-TICK / s["occlusion_time"]), self._path)
        nearing = (exp(-TICK / SUBSTEPS / s["_decay"]), -1.0 / expm1(-TICK / s["_decay"]))
        table = self._rows.given if given is None else given
        out = np.zeros((len(table), 2))
        if self._compiled:
            self._run(friction, skin, constants, nearing, table, out)  # type: ignore[arg-type]
        else:
            self._run(friction, skin, constants, nearing, table.tolist(), out)
        out[:, 0] += s["_zero"]
        seen = self._rows.seen
        return np.where(self._rows.judged, out.T[: len(seen)] - seen, 0.0)


def fit_finger(
    recording: FingerRecording,
    *,
    name: str = "fitted",
    progress: Callable[[float], None] | None = None,
) -> FingerFit:
    """Fit a fingertip to a recording, with the uncertainty of its numbers.

    Parameters
    ----------
    recording
        Forces, motion and vibration of a finger that slides.
    name
        Name of the subject.
    progress
        Function that is called with the share that is done, 0..1.

    Raises
    ------
    ValueError
        If the recording is too short, too coarse in time or no finger slides in it, or the fit
        leaves more than `MOST_LEFT` of the noise; the message names value and bound.
    """
    told = progress or (lambda _share: None)
    rows = _on_ticks(recording)
    model = _Model(recording, rows)
    parts = len(STAGES) * len(_STARTS) + 1
    optima: list[_Optimum] = []
    for number, (stiffness, creep) in enumerate(_STARTS):
        u = np.zeros(len(_NAMES))
        u[[_NAMES.index("skin_stiffness"), _NAMES.index("creep_ratio")]] = stiffness, creep
        for stage, (width, step) in enumerate(STAGES):
            optimum = _optimum(model, u, width, step, rows)
            u = optimum.u
            told((len(STAGES) * number + stage + 1) / parts)
        optima.append(optimum)
    best = min(optima, key=lambda optimum: optimum.squares)
    count = int(np.count_nonzero(rows.judged))
    residual = sqrt(best.squares / count)
    _require_fit(residual, rows.lateral_noise)
    near = [one.u for one in optima if one.squares < AS_GOOD * best.squares]
    middle = np.mean(near, axis=0)
    bias, spread = _shift(model, best, rows)
    apart = np.mean((np.array(near) - middle) ** 2, axis=0)
    variance = np.diag(best.covariance) + spread + apart
    told(1.0)
    numbers = _numbers(middle - bias, np.sqrt(variance), rows)
    return FingerFit(
        Subject(name=name, **{key: estimate.value for key, estimate in numbers.items()}),
        numbers,
        residual,
        count,
        count / best.correlation,
    )


def _require_fit(residual: float, noise: float) -> None:
    """Refuse a fit that leaves clearly more than the noise, as its limits would not hold."""
    bound = MOST_LEFT * max(noise, LEAST_NOISE)
    if residual > bound:
        raise ValueError(
            f"the fit leaves {1e3 * residual:.3g} mN of the lateral force, more than the "
            f"{1e3 * bound:.3g} mN that its noise of {1e3 * noise:.3g} mN allows, so its limits "
            "would not hold: fit another part, without stick and slip, and check --path"
        )


class _Optimum(NamedTuple):
    """The end of a descent."""

    u: Floats
    squares: float
    """Sum of the squares of the residuals of the lateral force, in N^2."""
    covariance: Floats
    pull: Floats
    """Change of the coordinates with each residual, a channel after the other."""
    correlation: float
    """Ticks of the lateral force's residual for an independent one."""


def _optimum(model: _Model, u: Floats, width: int, step: float, rows: _Rows) -> _Optimum:
    """Descend by Levenberg and Marquardt on means of the residuals over some ticks."""
    count = int(np.count_nonzero(rows.judged))

    def residuals(u: Floats) -> Floats:
        return _means(model.residuals(u), width)

    def slopes(u: Floats, r: Floats) -> Floats:
        made = np.empty((len(u), *r.shape))
        for number in range(len(u)):
            moved = u.copy()
            moved[number] += step
            made[number] = (residuals(moved) - r) / step
        return made

    r, caution = residuals(u), 1e-2
    for _ in range(_MOST_STEPS):
        taus = np.array([correlation_of(one) for one in r])
        weights = np.sqrt(count / (taus * np.maximum(np.sum(r * r, axis=1), 1e-30)))[:, None]
        J = (slopes(u, r) * weights).reshape(len(u), -1)
        normal = np.eye(len(u)) + J @ J.T
        uphill = u + J @ (r * weights).ravel()
        squares = float(np.sum((r * weights) ** 2) + u @ u)
        for _ in range(_MOST_TRIES):
            way = -np.linalg.solve(normal + caution * np.diag(np.diag(normal)), uphill)
            tried = np.clip(u + way / max(1.0, float(np.abs(way).max()) / 0.7), -4.0, 4.0)
            after = residuals(tried)
            less = squares - float(np.sum((after * weights) ** 2) + tried @ tried)
            if less > 0.0:
                break
            caution *= 4.0
        if not less > 0.0:
            break
        u, r, caution = tried, after, max(0.2 * caution, 1e-7)
        if less < _ENOUGH:
            break
    covariance = np.linalg.inv(normal)
    raw = float(np.sum(r[0] * r[0]))
    pull = -covariance @ J * np.broadcast_to(weights, r.shape).ravel()
    return _Optimum(u, raw, covariance, pull, correlation_of(r[0]))


def _means(r: Floats, width: int) -> Floats:
    """Return running means over a number of ticks, of each row."""
    if width == 1:
        return r
    sums = np.concatenate([np.zeros((len(r), 1)), np.cumsum(r, axis=1)], axis=1)
    ticks = np.arange(r.shape[1])
    first = np.maximum(ticks - width // 2, 0)
    last = np.minimum(ticks + (width + 1) // 2, r.shape[1])
    means: Floats = (sums[:, last] - sums[:, first]) / width
    return means


def correlation_of(r: Floats) -> float:
    """Return how many residuals tell as much as an independent one, 1 or more.

    The autocorrelation is summed in pairs, as long as they are positive (Geyer 1992).
    """
    spectrum = np.fft.rfft(r, 2 * len(r))
    shared = np.fft.irfft((spectrum * spectrum.conj()).real)[: _MOST_LAG + 1]
    if not shared[0] > 0.0:
        return 1.0
    pairs = (shared[1:-1:2] + shared[2::2]) / shared[0]
    ended = np.flatnonzero(pairs <= 0.0)
    return max(1.0, 1.0 + 2.0 * float(pairs[: ended[0] if len(ended) else None].sum()))


def _shift(model: _Model, optimum: _Optimum, rows: _Rows) -> tuple[Floats, Floats]:
    """Return mean and mean square of how noise of motion, force and vibration moves the optimum."""
    rng = np.random.default_rng(_SEED)
    base = model.residuals(optimum.u)
    x, Fn, W = rows.given.T
    shifts = []
    for _ in range(DRAWS):
        dx, dFn, dW = (size * rng.standard_normal(len(x)) for size in rows.noise)
        noisy = np.column_stack(
            (
                x + _smoothed(dx, rows.smoothing),
                np.where(Fn > 0.0, np.maximum(Fn + _smoothed(dFn, _FORCE_SMOOTHING), 0.0), 0.0),
                np.abs(W + dW),
            )
        )
        shifts.append(optimum.pull @ (model.residuals(optimum.u, noisy) - base).ravel())
    moved = np.array(shifts)
    bias: Floats = moved.mean(axis=0)
    return bias, np.mean(moved * moved, axis=0)


def _numbers(u: Floats, sigma: Floats, rows: _Rows) -> dict[str, Estimate]:
    """Return the numbers of the subject by the coordinates of the fit and their deviations."""
    vibrated = bool(np.any(rows.given[:, 2] > 0.0))
    numbers = {}
    for field in fields(Subject):
        if field.name in FREE:
            at = _NAMES.index(field.name)
            numbers[field.name] = _estimate(field.name, float(u[at]), float(sigma[at]), vibrated)
        elif field.name in _NOT_IN_FORCES:
            value = getattr(SUBJECTS[1], field.name)
            numbers[field.name] = Estimate(
                value, *BOUNDS[field.name], False, "forces do not show the load on the vibration"
            )
    return numbers


def _estimate(name: str, u: float, sigma: float, vibrated: bool) -> Estimate:
    least, most = BOUNDS[name]
    value, low, high = (
        min(max(_number(name, u + sigma * k), least), most) for k in (0.0, -_NORMAL_95, _NORMAL_95)
    )
    reason = ""
    if name in ("rho", "W0", "p") and not vibrated:
        reason = "the plate did not vibrate"
    elif name in _NOT_PARTED:
        low, high = FREE[name].low, FREE[name].high
        reason = "forces do not part mass, stiffness, damping and creep of the skin"
    elif low == high:
        reason = f"it would be beyond its bound {value:g}"
    elif sigma > TOLD:
        reason = f"told by {FREE[name].told_by}"
    return Estimate(value, low, high, not reason, reason)


# -- The recording -----------------------------------------------------------------------------


def _on_ticks(recording: FingerRecording) -> _Rows:
    time = np.asarray(recording.time, dtype=np.float64)
    period = _require_usable(recording, time)
    damping = _SENSORS.path_damping
    lag = 2.0 * damping / (TWO_PI * recording.path_frequency)
    ticks = np.arange(round((time[-1] - time[0]) / TICK) + 1) * TICK

    def taken(values: Floats, late: float = 0.0) -> Floats:
        return _at_ticks(time - time[0] - late, np.asarray(values, np.float64), period, ticks)

    x = taken(recording.position, lag if recording.position_by_gauges else 0.0)
    Fn = taken(recording.normal, lag)
    Ft = taken(recording.lateral)
    W = np.zeros(len(x)) if recording.amplitude is None else np.abs(taken(recording.amplitude))
    shrunk = sqrt(min(1.0, period / TICK))  # by the means of a fast recording
    noise = (
        shrunk * _scatter(recording.position),
        shrunk * _scatter(recording.normal),
        0.0 if recording.amplitude is None else shrunk * _scatter(recording.amplitude),
    )
    smoothing = 2
    while smoothing < _MOST_SMOOTHING and _jitter(noise[0], smoothing) > _JITTER:
        smoothing += 1
    x = _smoothed(x, smoothing)
    Fn = np.maximum(_smoothed(Fn, _FORCE_SMOOTHING), 0.0)
    away = _in_gaps(time - time[0], period, ticks)
    Fn[away] = 0.0
    judged = _judged(away, x)
    count = int(np.count_nonzero(judged))
    if count < LEAST_ROWS:
        raise ValueError(
            f"{count} ms of a sliding finger are fewer than {LEAST_ROWS}: record longer"
        )
    speed = np.gradient(x) / TICK
    if float(np.sum((Ft * speed)[judged])) < 0.0:
        Ft = -Ft
    seen = [Ft]
    if recording.acceleration is not None:
        a = taken(recording.acceleration)
        # The model's is the mean over a tick.
        seen.append(np.concatenate([a[:1], 0.5 * (a[1:] + a[:-1])]))
    lateral_noise = shrunk * _scatter(recording.lateral)
    given = np.column_stack((x, Fn, W))
    return _Rows(given, np.array(seen), judged, noise, smoothing, lateral_noise)


def _require_usable(recording: FingerRecording, time: Floats) -> float:
    """Return the median distance of two rows in s; refuse a recording that cannot be fitted."""
    require("path_frequency", recording.path_frequency, 1.0, 1e5)
    require("frequency", recording.frequency, 5e3, 1e6)
    for name, values in recording._asdict().items():
        if isinstance(values, float | bool) or values is None:
            continue
        if np.shape(values) != (len(time),):
            raise ValueError(f"{name} has {np.size(values)} values, and time has {len(time)}")
        if not np.all(np.isfinite(values)):
            raise ValueError(f"{name} has values that are not finite: leave these rows out")
    if len(time) < LEAST_ROWS // 2:
        raise ValueError(f"{len(time)} rows are fewer than the {LEAST_ROWS // 2} of a fit")
    steps = np.diff(time)
    if not np.all(steps > 0.0):
        raise ValueError(f"time does not rise at row {int(np.argmin(steps)) + 2}")
    if time[-1] - time[0] > MOST_SECONDS:
        raise ValueError(
            f"{time[-1] - time[0]:g} s are more than {MOST_SECONDS:g} s: fit a part of them"
        )
    period = float(np.median(steps))
    if period > _MOST_PERIOD:
        raise ValueError(
            f"a row each {period * 1e3:.3g} ms is less than one each {_MOST_PERIOD * 1e3:g} ms: "
            "the skin is faster"
        )
    return period


def _at_ticks(time: Floats, values: Floats, period: float, ticks: Floats) -> Floats:
    """Return values at ticks: means of a fast recording, lines between the rows of a slow one."""
    if period < 0.7 * TICK:
        near = np.maximum(np.round(time / TICK).astype(np.int64), 0)
        counts = np.bincount(near)
        filled = counts > 0
        time = np.bincount(near, time)[filled] / counts[filled]
        values = np.bincount(near, values)[filled] / counts[filled]
    taken: Floats = np.interp(ticks, time, values)
    return taken


def _in_gaps(time: Floats, period: float, ticks: Floats) -> npt.NDArray[np.bool_]:
    """Return which ticks lie between rows so far apart that the finger was lifted."""
    after = np.clip(np.searchsorted(time, ticks), 1, len(time) - 1)
    far = time[after] - time[after - 1] > max(_GAP * period, _GAP * TICK)
    return far & (ticks > time[after - 1] + 0.5 * TICK) & (ticks < time[after] - 0.5 * TICK)


def _judged(away: npt.NDArray[np.bool_], x: Floats) -> npt.NDArray[np.bool_]:
    """Return which ticks are compared: those after which the skin has forgotten a gap."""
    way = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(x)))])
    ticks = np.arange(len(x))
    last = np.maximum.accumulate(np.where(away, ticks, 0))
    judged: npt.NDArray[np.bool_] = ((ticks - last) * TICK > _FORGOTTEN_S) & (
        way - way[last] > _FORGOTTEN_M
    )
    return judged


def _scatter(values: Floats) -> float:
    """Return the standard deviation of the noise of values, by their fourth differences."""
    return float(np.median(np.abs(np.diff(values, 4)))) / (0.6745 * sqrt(70.0))


def _jitter(noise: float, half: int) -> float:
    """Return the standard deviation of a slope, in m/s, over `half` ticks on each side."""
    return noise * sqrt(3.0 / (half * (half + 1) * (2 * half + 1))) / TICK


def _smoothed(values: Floats, half: int) -> Floats:
    """Return the parabolas through `half` ticks on each side, at their middle (Savitzky, Golay)."""
    ticks = np.arange(-half, half + 1.0)
    weights = np.linalg.pinv(np.vander(ticks, 3, increasing=True))[0]
    padded = np.pad(values, half, mode="reflect", reflect_type="odd")
    smooth: Floats = np.convolve(padded, weights, mode="valid")
    return smooth

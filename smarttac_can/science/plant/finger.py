"""Prescribed motion of the bone of the finger, as a pure function of time."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np
from numpy.random import default_rng

from smarttac_can.science.plant.parameters import TWO_PI, require

_STROKE_STREAM = 0x57
_LEAST_SAMPLES = 2
_RAMP_SHARE = 0.2
"""Length of a turning ramp, as a fraction of the travel at full speed."""
_LAG_S = 0.02
"""Time constant of a guided finger."""
_LIFTED_N = 1e-3
"""Normal force in N below which a guided finger does not touch."""
SAMPLE_RANGES = (("time", 0.0, 1e9), ("x", -38e-3, 38e-3), ("Fn", 0.0, 10.0))
"""Bounds of the columns of a recording, in s, m and N."""
GIVEN_RANGES = (*SAMPLE_RANGES[:2], ("Fn", -0.01, SAMPLE_RANGES[2][2]))
"""Bounds of a recording as it is given: below 0 a force is noise of a finger in the air, and is
taken as 0."""


class FingerState(NamedTuple):
    """Position of the finger, and its normal force."""

    x: float
    """Position along the plate in m from its middle."""
    Fn: float
    """Normal force in N; 0 for a lifted finger."""


class Finger(Protocol):
    """Motion of a finger."""

    def at(self, time: float) -> FingerState:
        """Return the state at a time in s, 0 or more, from the start of the run."""
        ...


class Lifted:
    """No finger on the plate."""

    __slots__ = ()

    def at(self, time: float) -> FingerState:
        """Return the lifted state, the same at all times."""
        return FingerState(0.0, 0.0)


class Pass(NamedTuple):
    """One pass of a stroke."""

    start: float
    """Start time in s."""
    duration: float
    """Duration in s, including a ramp at both ends."""
    speed: float
    """Speed between the ramps in m/s."""
    Fn: float
    """Normal force in N."""


class Path(NamedTuple):
    """Common data of all passes of a stroke."""

    travel: float
    """Distance between the turning points in m."""
    rest: float
    """Time in s before the finger presses."""
    press: float
    """Rise time of the normal force in s."""


def pass_at(start: float, travel: float, speed: float, Fn: float) -> Pass:
    """Return a pass that starts at a time in s."""
    return Pass(start, (1.0 + _RAMP_SHARE) * travel / speed, speed, Fn)


def ramp_of(path: Path, now: Pass) -> float:
    """Return the duration of a ramp of a pass in s."""
    return _RAMP_SHARE * path.travel / now.speed


def stroke_at(
    path: Path, back: bool, now: Pass, Fn_before: float, time: float
) -> tuple[float, float]:
    """Return position in m and normal force in N of a stroke.

    Parameters
    ----------
    path
        Common data of the stroke.
    back
        Whether the pass goes from right to left.
    now
        Pass at this time; for times before the first pass, the first one.
    Fn_before
        Normal force of the pass before in N.
    time
        Time in s.
    """
    travel, rest, press = path
    start, duration, speed, Fn = now
    if time < start:
        return -0.5 * travel, Fn_before * smooth((time - rest) / press)
    elapsed = time - start
    ramp = _RAMP_SHARE * travel / speed
    x = -0.5 * travel + _ramped(elapsed, duration, ramp) * speed
    return (-x if back else x), Fn_before + (Fn - Fn_before) * smooth(elapsed / ramp)


class Stroke:
    """A finger that slides to and fro over the middle of the plate.

    It rests above the left side of the plate, presses, and then slides without lifting. Every pass
    is one touch of the middle, at constant speed there, with raised-cosine ramps at the turns.
    Force and speed are drawn anew for each pass.

    Parameters
    ----------
    force
        Mean normal force in N, 0.01..3.
    speed
        Mean sliding speed in m/s, 0.001..1.
    travel
        Distance between the turning points in m, 0.001..0.05.
    force_variation, speed_variation
        Half-width of the uniform distribution about the mean, as a fraction, 0..0.9.
    seed
        Seed of the distribution, 0 or more.
    rest
        Time in s before the finger presses, for taring, 0..100.
    press
        Rise time of the normal force in s, 0.001..10.
    """

    __slots__ = ("_force", "_passes", "_path", "_rng", "_speed", "_variation")

    def __init__(
        self,
        force: float = 0.5,
        speed: float = 0.06,
        travel: float = 0.03,
        *,
        force_variation: float = 0.2,
        speed_variation: float = 0.2,
        seed: int = 1,
        rest: float = 0.2,
        press: float = 0.1,
    ) -> None:
        require("force", force, 0.01, 3.0)
        require("speed", speed, 1e-3, 1.0)
        require("travel", travel, 1e-3, 50e-3)
        require("force_variation", force_variation, 0.0, 0.9)
        require("speed_variation", speed_variation, 0.0, 0.9)
        require("seed", seed, 0, 2**63 - 1)
        require("rest", rest, 0.0, 100.0)
        require("press", press, 1e-3, 10.0)
        self._force = force
        self._speed = speed
        self._path = Path(travel, rest, press)
        self._variation = (force_variation, speed_variation)
        self._rng = default_rng([seed, _STROKE_STREAM])
        self._passes = [self._draw(rest + press)]

    def _draw(self, start: float) -> Pass:
        force_draw, speed_draw = self._rng.random(2).tolist()
        force_variation, speed_variation = self._variation
        speed = self._speed * (1.0 + speed_variation * (2.0 * speed_draw - 1.0))
        Fn = self._force * (1.0 + force_variation * (2.0 * force_draw - 1.0))
        return pass_at(start, self._path.travel, speed, Fn)

    def at(self, time: float) -> FingerState:
        """Return the state at a time in s, 0 or more, from the start of the run."""
        passes = self._passes
        last = passes[-1]
        while time >= last.start + last.duration:
            last = self._draw(last.start + last.duration)
            passes.append(last)
        number = len(passes) - 1
        if time < last.start:
            number = max(0, bisect_right(passes, time, key=_start) - 1)
        now = passes[number]
        before = passes[number - 1].Fn if number else now.Fn
        # This takes half the time of a named tuple's own constructor.
        return tuple.__new__(FingerState, stroke_at(self._path, number % 2 == 1, now, before, time))

    @property
    def path(self) -> Path:
        """Common data of all passes."""
        return self._path

    def passes(self, count: int) -> list[Pass]:
        """Return the first ``count`` passes, 1 or more."""
        passes = self._passes
        while len(passes) < count:
            passes.append(self._draw(passes[-1].start + passes[-1].duration))
        return passes[:count]


def _start(item: Pass) -> float:
    return item.start


def smooth(share: float) -> float:
    """Return a raised cosine from 0 at share <= 0 to 1 at share >= 1."""
    if share <= 0.0:
        return 0.0
    if share >= 1.0:
        return 1.0
    return 0.5 - 0.5 * math.cos(math.pi * share)


def _ramped(elapsed: float, duration: float, ramp: float) -> float:
    """Return the distance at unit speed with raised-cosine ramps of the speed at both ends."""
    if elapsed < ramp:
        return 0.5 * elapsed - ramp / TWO_PI * math.sin(math.pi * elapsed / ramp)
    left = duration - elapsed
    if left < ramp:
        return duration - ramp - 0.5 * left + ramp / TWO_PI * math.sin(math.pi * left / ramp)
    return elapsed - 0.5 * ramp


class Trajectory:
    """A recorded finger: interpolated between samples, lifted before the first and after the last.

    Parameters
    ----------
    samples
        (time in s, x in m, Fn in N) with rising times, 2 or more; x within +-0.038, Fn 0..10.

    Raises
    ------
    ValueError
        There are too few samples, or they are out of order or out of range.
    """

    __slots__ = ("_samples", "_times")

    def __init__(self, samples: Sequence[tuple[float, float, float]]) -> None:
        if len(samples) < _LEAST_SAMPLES:
            raise ValueError(f"{len(samples)} samples of a trajectory are fewer than 2")
        table = np.asarray(samples, dtype=np.float64)
        for column, (name, low, high) in zip(table.T, SAMPLE_RANGES, strict=True):
            sound = (column >= low) & (column <= high)
            if not sound.all():
                number = int(sound.argmin())
                require(f"sample {number} {name}", column[number], low, high)
        late = np.flatnonzero(np.diff(table[:, 0]) <= 0.0) + 1
        if late.size:
            number = int(late[0])
            time = samples[number][0]
            raise ValueError(f"sample {number} time {time} is not after the one before")
        self._samples = tuple(samples)
        self._times = [sample[0] for sample in samples]

    def at(self, time: float) -> FingerState:
        """Return the state at a time in s, 0 or more, from the start of the run."""
        number = bisect_right(self._times, time)
        if number == 0:
            return FingerState(self._samples[0][1], 0.0)
        t0, x0, Fn0 = self._samples[number - 1]
        if number == len(self._times):
            return FingerState(x0, Fn0 if time == t0 else 0.0)
        t1, x1, Fn1 = self._samples[number]
        share = (time - t0) / (t1 - t0)
        return FingerState(x0 + (x1 - x0) * share, Fn0 + (Fn1 - Fn0) * share)


class GuidedFinger:
    """A finger guided by hand, which follows a goal that can be set at any time.

    Position and normal force approach the goal like a critically damped second-order system, so
    that steps of the goal, as from a mouse, are smoothed.
    """

    __slots__ = ("_goal", "_now", "_rates", "_time")

    def __init__(self) -> None:
        self._goal = FingerState(0.0, 0.0)
        self._start(0.0)

    def guide(self, x: float, Fn: float) -> None:
        """Set the goal: position in m from the middle, and normal force in N.

        Raises
        ------
        ValueError
            x is outside +-0.038, or Fn outside 0..10; the goal is then unchanged.
        """
        for (name, low, high), value in zip(SAMPLE_RANGES[1:], (x, Fn), strict=True):
            require(name, value, low, high)
        self._goal = FingerState(x, Fn)

    def _start(self, time: float) -> None:
        self._time = time
        self._now = FingerState(self._goal.x, 0.0)
        self._rates = (0.0, 0.0)

    def at(self, time: float) -> FingerState:
        """Return the state at a time in s; a time before the last one starts a new run."""
        if time < self._time:
            self._start(time)
        goal, now, rates = self._goal, self._now, self._rates
        if now.Fn < _LIFTED_N:
            # A lifted finger moves to where it will touch.
            now, rates = FingerState(goal.x, now.Fn), (0.0, rates[1])
        x, x_rate = _approached(now.x, rates[0], goal.x, time - self._time)
        Fn, Fn_rate = _approached(now.Fn, rates[1], goal.Fn, time - self._time)
        self._time = time
        self._now = FingerState(x, 0.0 if Fn < _LIFTED_N and not goal.Fn else Fn)
        self._rates = (x_rate, Fn_rate)
        return self._now


def _approached(value: float, rate: float, goal: float, elapsed: float) -> tuple[float, float]:
    away = value - goal
    pull = rate + away / _LAG_S
    decay = math.exp(-elapsed / _LAG_S)
    rest = (away + pull * elapsed) * decay
    return goal + rest, pull * decay - rest / _LAG_S

"""A curve of the COF around a switch of its reference, and its metrics.

*Levels* of a step are the means of the curve itself before the switch and from 40 ms after it.
Rise time (10 to 90 %) and overshoot are taken in % of the step between these levels, as the state
levels of IEEE 181; the distance of the levels to the references is the static error. So the three
numbers are independent of each other. A metric that does not exist for a curve raises
`UndefinedError`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
BEFORE_MS, AFTER_MS = 20, 80
"""Window around a switch of the reference."""
TIME_MS: Final = np.arange(-BEFORE_MS, AFTER_MS + 1, dtype=np.float64)
"""Ticks of the window, in ms after the switch."""
SETTLED_MS = 40
"""Time in ms after the switch from which a curve counts as static."""
_RISING, _RISEN = 0.1, 0.9
"""Fractions of a step between which its rise time is measured."""
_LEAST_SHARE = 0.5
"""Least fraction of the reference step that a curve must reach to have metrics."""


class UndefinedError(ValueError):
    """A metric that does not exist for the data; the message says why."""


class Step(NamedTuple):
    """A curve of mu around a switch of its reference."""

    time_ms: Floats
    """Time in ms after the switch; mu at time 0 does not depend on the switch yet."""
    mu: Floats
    before: float
    """Reference before the switch."""
    after: float
    """Reference from the switch on."""

    def levels(self) -> tuple[float, float]:
        """Return the means of the curve before the switch and from 40 ms after it."""
        low = float(np.mean(self.mu[self.time_ms <= 0]))
        return low, float(np.mean(self.mu[self.time_ms >= SETTLED_MS]))

    def normalised(self) -> Floats:
        """Scale the curve to the step between its own levels: from 0 to 1.

        Raises
        ------
        UndefinedError
            If the levels differ by less than half of the reference step.
        """
        start, end = self.levels()
        share = (end - start) / (self.after - self.before)
        if not share >= _LEAST_SHARE:
            raise UndefinedError(f"mu moves by {100 * share:.0f} % of the step asked for")
        return (self.mu - start) / (end - start)


def rise_time(step: Step) -> float:
    """Return the time in ms from 10 % to 90 % of the step, up or down, interpolated linearly.

    The rise begins at the last passage of 10 % before the first passage of 90 % after the switch.

    Raises
    ------
    UndefinedError
        If the curve does not pass both, or as `Step.normalised` does.
    """
    share = step.normalised()
    passes = (share[:-1] < _RISEN) & (share[1:] >= _RISEN) & (step.time_ms[1:] > 0)
    if not passes.any():
        raise UndefinedError("mu does not pass 90 % of the step")
    upper = int(np.flatnonzero(passes)[0])
    below = np.flatnonzero(share[: upper + 1] < _RISING)
    if not len(below):
        raise UndefinedError("mu is nowhere below 10 % of the step ahead of 90 %")
    lower = int(below[-1])
    start = np.interp(_RISING, share[lower : lower + 2], step.time_ms[lower : lower + 2])
    end = np.interp(_RISEN, share[upper : upper + 2], step.time_ms[upper : upper + 2])
    return float(end - start)


def overshoot_percent(step: Step) -> float:
    """Return the overshoot of mu beyond its level after the switch, in % of the step."""
    return 100 * (float(np.max(step.normalised()[step.time_ms > 0])) - 1)


def static_error_percent(step: Step) -> float:
    """Return the larger distance of a level to its reference, in % of the reference."""
    pairs = zip(step.levels(), (step.before, step.after), strict=True)
    return 100 * max(abs(level - reference) / reference for level, reference in pairs)


def single_steps(curves: Floats, asked: float, without: float) -> Floats:
    """Return rise time in ms and overshoot in % of many steps, a row each, as for a `Step`.

    Six curves at once take a fifth of the time of `rise_time` and `overshoot_percent` for each.

    Parameters
    ----------
    curves
        Curves of mu at `TIME_MS` around each up-step, a row each.
    asked
        Step of the reference.
    without
        Overshoot in % for a curve without a step; its rise time is infinite.
    """
    start = curves[:, : BEFORE_MS + 1].mean(axis=1)
    step = curves[:, BEFORE_MS + SETTLED_MS :].mean(axis=1) - start
    stepped = step >= _LEAST_SHARE * asked
    share = (curves - start[:, None]) / np.where(stepped, step, asked)[:, None]
    passes = (share[:, BEFORE_MS:-1] < _RISEN) & (share[:, BEFORE_MS + 1 :] >= _RISEN)
    upper = BEFORE_MS + passes.argmax(axis=1)
    below = (share < _RISING) & (np.arange(len(TIME_MS)) <= upper[:, None])
    lower = len(TIME_MS) - 1 - below[:, ::-1].argmax(axis=1)
    stepped &= passes.any(axis=1) & below.any(axis=1)
    rise = _passage(share, upper, _RISEN) - _passage(share, lower, _RISING)
    overshoot = 100.0 * (share[:, BEFORE_MS + 1 :].max(axis=1) - 1.0)
    return np.where(stepped, (rise, overshoot), [[np.inf], [without]]).T


def _passage(share: Floats, after: NDArray[np.intp], level: float) -> Floats:
    """Return the time in ms at which each row passes a level, from sample `after` to the next."""
    rows = np.arange(len(share))
    begin, end = share[rows, after], share[rows, np.minimum(after + 1, len(TIME_MS) - 1)]
    return TIME_MS[after] + (level - begin) / np.where(end > begin, end - begin, 1.0)


STEP_METRICS: Final[dict[str, Callable[[Step], float]]] = {
    "rise_time_ms": rise_time,
    "overshoot_percent": overshoot_percent,
    "static_error_percent": static_error_percent,
}
"""Metrics of each step in Table I and in the tables beside it."""

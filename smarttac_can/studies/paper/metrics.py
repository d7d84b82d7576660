"""The numbers of the paper's experiments, computed only from recorded traces.

Definitions
-----------
* *Switch-on* is the first tick with a voltage; time counts from there (Fig. 5, 6).
* *Response time* is the last entry into the band around the reference.
* A *touch* is one crossing of the boundary: the curve of mu cut around the tick at which the
  reference switches. Touches with a lost tick, a lost contact or a second switch in the window
  are dropped and counted.
* Levels, rise time and overshoot of a step are those of `smarttac_can.science.population.steps`.
* Table I is the up-step of the mean curve, since noise of mu biases the values of single touches;
  these, and down-steps, are reported beside it.

A metric that does not exist for a trace raises `UndefinedError`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from smarttac_can.bench.traces import Floats, Trace
from smarttac_can.science.population.steps import AFTER_MS, BEFORE_MS, Step, UndefinedError
from smarttac_can.studies.paper.references import RESPONSE_BAND

FINAL_MS = 20
"""Time in ms at the end of a run that counts as its steady state."""
LOOPS = ("amplitude_only", "amplitude_and_frequency")
"""Names of the two runs of Fig. 5 and 6."""


class NotRunError(UndefinedError):
    """A metric of an experiment that was not run."""


def response_time(W: Floats, reference: float, band: float = RESPONSE_BAND) -> float:
    """Return the time in ms after which W stays within reference * (1 +- band).

    Parameters
    ----------
    W
        Samples 1 ms apart, the first at the instant of the step.
    reference
        Final value, in the unit of W, above 0.
    band
        Half width of the band as a fraction of the reference.

    Returns
    -------
    float
        Last entry into the band, interpolated linearly between two samples; 0 if W is never
        outside.

    Raises
    ------
    UndefinedError
        If the last sample is outside, or a sample at the entry is missing (NaN).
    """
    outside = ~(np.abs(W - reference) <= band * reference)
    if not len(W) or outside[-1]:
        raise UndefinedError(f"does not stay within {100 * band:g} % of {reference:g}")
    if not outside.any():
        return 0.0
    last = int(np.flatnonzero(outside)[-1])
    edge = reference * (1 + band if W[last] > reference else 1 - band)
    entry = last + float((edge - W[last]) / (W[last + 1] - W[last]))
    if np.isnan(entry):
        raise UndefinedError("a sample is missing at the entry into the band")
    return entry


def overshoot_above(W: Floats, reference: float, step: float) -> float:
    """Return the overshoot of W beyond its reference, in % of the step; 0 if there is none.

    Raises
    ------
    UndefinedError
        If a sample is missing (NaN).
    """
    highest = float(np.max(W))
    if np.isnan(highest):
        raise UndefinedError("a sample is missing")
    return max(0.0, 100.0 * (highest - reference) / step)


def from_switch_on(trace: Trace, column: Floats) -> Floats:
    """Return a column of the trace from the switch-on, the first tick with a voltage.

    Raises
    ------
    UndefinedError
        If there is no voltage, or a tick after the switch-on was lost.
    """
    driven = np.flatnonzero(trace.voltage_v)
    if not len(driven):
        raise UndefinedError(f"{trace.experiment} has no voltage")
    start = int(driven[0])
    if trace.tick[-1] - trace.tick[start] != len(trace) - 1 - start:
        raise UndefinedError(f"{trace.experiment} has lost ticks after switch-on")
    return column[start:]


def final_mean(trace: Trace, column: Floats) -> float:
    """Return the mean of a column of the trace over its last 20 ms.

    Raises
    ------
    UndefinedError
        If the trace does not end with 20 ticks in a row.
    """
    if len(trace) < FINAL_MS or trace.tick[-1] - trace.tick[-FINAL_MS] != FINAL_MS - 1:
        raise UndefinedError(f"{trace.experiment} has no {FINAL_MS} ticks in a row at its end")
    return float(np.mean(column[-FINAL_MS:]))


def voltage_difference_percent(amplitude_only: Trace, both_loops: Trace) -> float:
    """Return the additional voltage that the amplitude loop alone needs, in % (Fig. 6).

    100 % is the voltage with both loops.

    The paper's "about 30 %" is interpreted in this direction: 30 % more off resonance.

    Raises
    ------
    UndefinedError
        If a trace ends without a voltage, or with lost ticks.
    """
    base = final_mean(both_loops, both_loops.voltage_v)
    if base <= 0:
        raise UndefinedError(f"{both_loops.experiment} ends without a voltage")
    return 100 * (final_mean(amplitude_only, amplitude_only.voltage_v) / base - 1)


class Touches(NamedTuple):
    """The touches of one subject in one direction, aligned at the switch."""

    steps: tuple[Step, ...]
    dropped: int
    """Crossings without a whole touch: end of trace, lost tick, lost contact, second switch."""

    def mean_curve(self) -> Step:
        """Return the mean over all touches at each tick (the continuous curve of Fig. 7).

        Raises
        ------
        UndefinedError
            If there is no touch, or touches of different references.
        """
        if not self.steps:
            raise UndefinedError(f"no whole touch ({self.dropped} dropped)")
        if len({(step.before, step.after) for step in self.steps}) > 1:
            raise UndefinedError("the touches have different references")
        return self.steps[0]._replace(mu=np.mean([step.mu for step in self.steps], axis=0))

    def of_mean_curve(self, metric: Callable[[Step], float]) -> float:
        """Return a metric of `STEP_METRICS` for the mean curve."""
        return metric(self.mean_curve())

    def of_each(self, metric: Callable[[Step], float]) -> list[float]:
        """Return a metric of `STEP_METRICS` for every touch that has it."""
        values = []
        for step in self.steps:
            with suppress(UndefinedError):
                values.append(metric(step))
        return values


def align_at_switch(traces: Iterable[Trace], *, up: bool) -> Touches:
    """Return the touches in traces: -20 to +80 ms around each up-step, or down-step, of mu_ref."""
    time_ms = np.arange(-BEFORE_MS, AFTER_MS + 1, dtype=np.float64)
    steps, dropped = [], 0
    for trace in traces:
        reference = trace.cof_reference
        change = np.diff(reference)
        # Without a reference it is NaN, so the beginning and end of control are not steps.
        wanted = change > 0 if up else change < 0
        for switch in (np.flatnonzero(wanted) + 1).tolist():
            begin, end = switch - BEFORE_MS, switch + AFTER_MS + 1
            whole = (
                begin >= 0
                and end <= len(trace)
                and trace.tick[end - 1] - trace.tick[begin] == BEFORE_MS + AFTER_MS
                and np.count_nonzero(change[begin : end - 1]) == 1
                and not np.isnan(trace.cof[begin:end]).any()
            )
            if not whole:
                dropped += 1
                continue
            before, after = trace.cof_reference[[switch - 1, switch]].tolist()
            steps.append(Step(time_ms, trace.cof[begin:end], before, after))
    return Touches(tuple(steps), dropped)


def friction_amplitudes(traces: Iterable[Trace]) -> list[float]:
    """Return the amplitudes in um of Fig. 2, from the labels ``fig2.<amplitude>``."""
    labels = (re.fullmatch(r"fig2\.(\d+\.\d+)", trace.experiment) for trace in traces)
    return sorted({float(label[1]) for label in labels if label})


def friction_ratio_percent(traces: Iterable[Trace], subject: int, amplitude_um: float) -> float:
    """Return the ratio mu_1/mu_0 of the friction with and without an amplitude, in % (Fig. 2).

    mu_1 and mu_0 are medians over the ticks in contact, which the reversals of the stroke, where
    the finger does not slide, do not change.

    Raises
    ------
    UndefinedError
        If a run is missing, has no contact, or was not at its amplitude within 5 % and 0.02 um.
    """
    traces = list(traces)
    medians = []
    for amplitude in (amplitude_um, 0.0):
        trace = find(traces, f"fig2.{amplitude:.1f}", subject)
        touching = ~np.isnan(trace.cof)
        if not touching.any():
            raise UndefinedError(f"{trace.experiment} of subject {subject} has no contact")
        actual = float(np.median(trace.amplitude_um[touching]))
        if abs(actual - amplitude) > 0.05 * amplitude + 0.02:
            raise UndefinedError(f"{trace.experiment} ran at {actual:.3f} um")
        medians.append(float(np.median(trace.cof[touching])))
    return 100 * medians[0] / medians[1]


def find(traces: Iterable[Trace], experiment: str, subject: int | None = None) -> Trace:
    """Return the trace of an experiment, of one subject or any.

    Raises
    ------
    NotRunError
        If it was not run.
    """
    for trace in traces:
        if trace.experiment == experiment and subject in (None, trace.subject):
            return trace
    by = "" if subject is None else f" by subject {subject}"
    raise NotRunError(f"{experiment} was not run{by}")


def subjects_of(traces: Iterable[Trace], experiment: str) -> list[int]:
    """Return the subjects of an experiment or of its parts (``fig2`` for ``fig2.0.5``)."""
    return sorted({t.subject for t in traces if f"{t.experiment}.".startswith(f"{experiment}.")})

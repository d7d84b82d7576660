"""Self-test of a stimulator with an empty plate: measurements, limits and verdicts."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from math import inf, isfinite, pi
from typing import Any, Final, NamedTuple, Self

import numpy as np
import numpy.typing as npt

from smarttac_can.bench.calibration import GAUGES, SAMPLES, gauge_names
from smarttac_can.bench.errors import RunInterruptedError
from smarttac_can.bench.stimulator import Stimulator
from smarttac_can.bench.traces import Trace
from smarttac_can.canopen.master.errors import BenchError, BusLostError, HeartbeatLostError
from smarttac_can.vocabulary.model import F0_SLOPE
from smarttac_can.vocabulary.signals import null_window
from smarttac_can.vocabulary.step_response import STEP_TICKS, step_response

_TIMING_S: Final = 1.0
_SETTLE_CYCLES: Final = 20
_END_S: Final = 0.02
_MEAN_OF: Final = 8
_SWEEP_UM: Final = 0.5
_SWEEP_HZ: Final = 250.0
_SWEEP_POINTS: Final = 13
_MOST_V: Final = 40.0
_SWITCHES: Final = 16
_HOLD_CYCLES: Final = 32
_COUNTS: Final = ("Foreign ticks", "Corrupt measurements", "Surplus measurements")

LOST_PERCENT: Final = 5.0
DRIFT_MN: Final = 41.0
"""Drift of a gauge's null over 15 K in mN, from its data sheet (FSS1500)."""
NOISE_MN: Final = (0.1, 13.0)
"""Standard deviation in mN; at most 3 times the value used for the uncertainty of the COF."""
PICKUP_NOISE_NM: Final = (0.05, 5.0)
PICKUP_REST_NM: Final = 5.0
END_NM: Final = 10.0
RESIDUAL_PERCENT: Final = 3.0
RESONANCE_HZ: Final = 60.0
SHARE: Final = 0.2
"""Largest relative deviation of gain and quality from the model in force."""

_Part = Callable[[Stimulator], Iterator["Check"]]
_LEAST_POINTS = 3


class Check(NamedTuple):
    """Result of one check."""

    name: str
    value: float | None
    """Measured value; None if it could not be measured."""
    unit: str
    low: float
    high: float
    """Limits: low..high passes; infinite if there is no limit."""
    text: str = ""
    """Reason why it could not be measured."""

    @property
    def passed(self) -> bool:
        """Whether the value was measured and is within its limits."""
        return self.value is not None and self.low <= self.value <= self.high

    def as_json(self) -> dict[str, Any]:
        """Return the check for a JSON file; an infinite limit is null."""
        return {
            "name": self.name,
            "passed": self.passed,
            "value": self.value,
            "unit": self.unit,
            "low": self.low if isfinite(self.low) else None,
            "high": self.high if isfinite(self.high) else None,
            "text": self.text,
        }


def selftest(stimulator: Stimulator, tell: Callable[[Check], None] = lambda _: None) -> list[Check]:
    """Check timing, gauges, pick-up, resonance and delay of a stimulator with an empty plate.

    It drives up to 0.5 um in open loop. In any case the stimulator is disarmed at the end, at 0 V,
    and its set-points are restored. If the stimulator refuses a part, or a fault ends it, that part
    is a failed check with the reason, and the next part follows.

    Parameters
    ----------
    stimulator
        Connected stimulator that is not armed.
    tell
        Function called with each check as soon as it is done.

    Raises
    ------
    BenchError
        If the stimulator has another commander; nothing was changed then.
    BusLostError, HeartbeatLostError
        If the stimulator has left the bus.
    RunInterruptedError
        On Ctrl-C in one of its runs; the stimulator has been disarmed.
    """
    checks: list[Check] = []

    def judge(parts: Mapping[str, _Part]) -> None:
        for name, part in parts.items():
            for check in _judged(name, part, stimulator):
                checks.append(check)
                tell(check)

    stimulator.claim()
    before = stimulator.voltage, stimulator.frequency
    try:
        judge({"timing": _timing, "rest": _at_rest, "sweep": _sweep})
    finally:
        _leave(stimulator, before)
    judge({"end": _end})
    return checks


def _leave(stimulator: Stimulator, before: tuple[float, float]) -> None:
    stimulator.disarm()
    with suppress(BenchError):
        stimulator.voltage, stimulator.frequency = before


def _judged(name: str, part: _Part, stimulator: Stimulator) -> Iterator[Check]:
    try:
        yield from part(stimulator)
    except (BusLostError, HeartbeatLostError, RunInterruptedError):
        raise
    except (BenchError, ValueError) as error:
        yield Check(name, None, "", -inf, inf, str(error))


def _timing(stimulator: Stimulator) -> Iterator[Check]:
    names = ("Missed deadlines", *_COUNTS)
    before = {name: stimulator.get(f"Cycle.{name}") for name in names}
    trace = stimulator.run(_TIMING_S, "selftest.timing")
    more = {name: stimulator.get(f"Cycle.{name}") - before[name] for name in names}
    ticks = int(trace.tick[-1] - trace.tick[0]) + 1
    yield Check("timing.lost rows", 100.0 * trace.lost / ticks, "%", 0.0, LOST_PERCENT)
    allowed = stimulator.get("Limit.Missed ticks")
    missed = 100.0 * more["Missed deadlines"] / (ticks + more["Missed deadlines"])
    yield Check("timing.missed ticks", missed, "%", 0.0, allowed)
    for name in _COUNTS:
        yield Check(f"timing.{name.lower()}", more[name], "", 0.0, 0.0)


def _at_rest(stimulator: Stimulator) -> Iterator[Check]:
    names = [*gauge_names(), "Plate input.W_d", "Plate input.W_q"]
    samples = stimulator.sample(names, SAMPLES)
    yield from _gauges(stimulator, samples[:, : len(GAUGES)])
    for axis, values in zip(("d", "q"), samples.T[len(GAUGES) :], strict=True):
        yield Check(f"noise.W_{axis}", float(values.std(ddof=1)), "nm", *PICKUP_NOISE_NM)
        yield Check(f"null.W_{axis}", float(values.mean()), "nm", -PICKUP_REST_NM, PICKUP_REST_NM)


def _gauges(stimulator: Stimulator, samples: npt.NDArray[np.float64]) -> Iterator[Check]:
    nulls = [stimulator.get(f"Gauge null.Null of S{gauge}", "mN") for gauge in GAUGES]
    window = null_window(stimulator.get("Gauge null.Window", "mN"), nulls)
    for gauge, null, values in zip(GAUGES, nulls, samples.T, strict=True):
        mean = float(values.mean())
        yield Check(f"null.S{gauge}", mean, "mN", null - window, null + window)
        zero = stimulator.get(f"Gauge zero.Zero of S{gauge}", "mN")
        yield Check(f"drift.S{gauge}", mean - zero, "mN", -DRIFT_MN, DRIFT_MN)
        yield Check(f"noise.S{gauge}", float(values.std(ddof=1)), "mN", *NOISE_MN)


def _sweep(stimulator: Stimulator) -> Iterator[Check]:
    gain = stimulator.get("Model.Gain per volt", "m")
    temperature = stimulator.get("Plate temperature", "degC")
    warmer = temperature - stimulator.get("Model.Temperature", "degC")
    expected = stimulator.get("Model.Resonance", "Hz") + F0_SLOPE * warmer
    voltage = min(_SWEEP_UM * 1e-6 / gain, _MOST_V, stimulator.get("Limit.Voltage", "V"))
    frequency = np.linspace(expected - _SWEEP_HZ, expected + _SWEEP_HZ, _SWEEP_POINTS)
    stimulator.voltage = voltage
    stimulator.frequency = float(frequency[0])
    stimulator.mode = "open_loop"
    W = [_answer(stimulator, float(f)) for f in frequency]
    fit = ResonanceFit.from_sweep(frequency, W, voltage)
    stimulator.frequency = min(max(fit.f0, frequency[0]), frequency[-1])
    trace = _switched(stimulator, voltage)
    stimulator.disarm()
    quality = stimulator.get("Model.Quality")
    yield Check("sweep.residual", 100.0 * fit.residual, "%", 0.0, RESIDUAL_PERCENT)
    yield Check("sweep.resonance", fit.f0, "Hz", expected - RESONANCE_HZ, expected + RESONANCE_HZ)
    yield Check("sweep.gain", abs(fit.gain) * 1e9, "nm/V", *_about(gain * 1e9))
    yield Check("sweep.quality", abs(fit.quality), "", *_about(quality))
    yield Check("polarity.drive", float(np.sign(fit.gain)), "", 1.0, 1.0)
    yield Check("polarity.phase", float(np.sign(fit.tau)), "", 1.0, 1.0)
    yield _delay(trace, stimulator.get("Controller.Dead time", "us"))


def _switched(stimulator: Stimulator, voltage: float) -> Trace:
    """Switch the voltage to its half and back, and return the trace; it begins with all of it."""
    switches = 0

    def switch(cycles: int) -> None:
        nonlocal switches
        if cycles >= (switches + 1) * _HOLD_CYCLES and switches < _SWITCHES:
            switches += 1
            stimulator.voltage = voltage / (1 + switches % 2)

    stimulator.voltage = voltage
    seconds = 1e-3 * (_SWITCHES + 2) * _HOLD_CYCLES
    return stimulator.run(seconds, "selftest.delay", meanwhile=switch)


def _delay(trace: Trace, dead_time: float) -> Check:
    """Judge the time from a measurement until its drive is seen, against the dead time in us.

    Half of the voltage stands for none: an offset of the pick-up cancels, and so does most of what
    a plate softens.
    """
    name = "sweep.delay"
    volts, W = trace.voltage_v, 1e-6 * trace.amplitude_um
    at = np.flatnonzero(np.diff(volts)) + 1
    whole = [
        len(W) > k + STEP_TICKS
        and trace.tick[k + STEP_TICKS] - trace.tick[k - 1] == STEP_TICKS + 1
        and not np.any(np.diff(volts[k : k + STEP_TICKS]))
        for k in at
    ]
    pairs = [k for k in range(0, len(at) - 1, 2) if whole[k] and whole[k + 1]]
    holds = [W[k + 1 : k + 1 + STEP_TICKS].tolist() for pair in pairs for k in at[pair : pair + 2]]
    if len(pairs) < _LEAST_POINTS:
        return Check(name, None, "us", -inf, inf, "too many cycles were lost between the steps")
    rest = np.array(holds)[:, STEP_TICKS // 2 :]
    low = float(rest[::2].mean())
    noise = float(np.sqrt(rest.var(axis=1).mean()))
    try:
        found = step_response(holds, low, noise)
    except ValueError as error:
        return Check(name, None, "us", -inf, inf, str(error))
    allowed = found.tolerance * 1e6
    return Check(name, found.delay * 1e6, "us", dead_time - allowed, dead_time + allowed)


def _answer(stimulator: Stimulator, frequency: float) -> complex:
    """Return the settled W in m at a frequency in Hz, the mean of some samples."""
    stimulator.frequency = frequency
    samples = stimulator.sample(("Vibration.W_d", "Vibration.W_q"), _SETTLE_CYCLES + _MEAN_OF)
    d, q = samples[_SETTLE_CYCLES:].mean(axis=0)
    return 1e-9 * complex(d, q)


def _about(value: float) -> tuple[float, float]:
    return value * (1.0 - SHARE), value * (1.0 + SHARE)


def _end(stimulator: Stimulator) -> Iterator[Check]:
    trace = stimulator.run(_END_S, "selftest.end")
    yield Check("end.voltage", float(trace.voltage_v[-1]), "V", 0.0, 0.0)
    yield Check("end.amplitude", float(trace.amplitude_um[-1]) * 1e3, "nm", 0.0, END_NM)


class ResonanceFit(NamedTuple):
    """Least-squares fit of ``V/W = (1 + j tau (w - w0)) / gain`` to a sweep of a plate.

    The signs of gain and tau are part of the fit. Wrong polarity of pick-up or drive gives a gain
    below 0; a phase that runs backwards gives a tau below 0.
    """

    gain: float
    """Vibration at resonance in m peak-to-peak per V."""
    tau: float
    """Time constant in s."""
    f0: float
    """Resonance in Hz."""
    residual: float
    """Root mean square of the residual of V/W, as a fraction of 1/gain."""

    @property
    def quality(self) -> float:
        """Quality factor ``pi f0 tau``."""
        return pi * self.f0 * self.tau

    @classmethod
    def from_sweep(
        cls,
        frequency: npt.ArrayLike,
        W: npt.ArrayLike,
        voltage: float,
    ) -> Self:
        """Fit a sweep.

        Parameters
        ----------
        frequency
            Frequencies in Hz, shape (n,), three or more different ones.
        W
            Complex vibration in m peak-to-peak at each, shape (n,), in the frame of the drive.
        voltage
            Voltage of the drive in V, above 0.

        Raises
        ------
        ValueError
            If there are too few points, or the plate does not respond: W is 0 or constant.
        """
        f = np.asarray(frequency, dtype=np.float64)
        answers = np.asarray(W, dtype=np.complex128)
        if len(f) < _LEAST_POINTS or len(np.unique(f)) < _LEAST_POINTS:
            raise ValueError(f"{len(f)} points of a sweep are fewer than {_LEAST_POINTS}")
        if not np.all(np.abs(answers) > 0.0):
            raise ValueError("the plate does not vibrate")
        inverse = voltage / answers
        centre = f.mean()
        slope, middle = np.polyfit(f - centre, inverse.imag, 1)
        real = float(inverse.real.mean())
        if not slope or not real:
            raise ValueError("the vibration does not change with the frequency")
        fitted = real + 1j * (middle + slope * (f - centre))
        residual = float(np.sqrt(np.mean(np.abs(inverse - fitted) ** 2)))
        return cls(
            gain=1.0 / real,
            tau=float(slope) / (2.0 * pi * real),
            f0=float(centre - middle / slope),
            residual=residual / abs(real),
        )

"""The self-test of a stimulator with nothing on its plate: what it measures, limits, verdicts."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from math import inf, isfinite
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from smarttac_can.bench.errors import RunInterruptedError
from smarttac_can.bench.gauge_samples import GAUGES, SAMPLES, gauge_names
from smarttac_can.bench.resonance_fit import ResonanceFit
from smarttac_can.bench.stimulator import Stimulator
from smarttac_can.master.errors import BenchError, BusLostError, HeartbeatLostError

_TIMING_S: Final = 1.0
_SETTLE_CYCLES: Final = 20
_END_S: Final = 0.02
_MEAN_OF: Final = 8
_SWEEP_UM: Final = 0.5
_SWEEP_HZ: Final = 250.0
_SWEEP_POINTS: Final = 13
_MOST_V: Final = 40.0
_HZ_PER_K: Final = -14.0
"""Change of the resonance with temperature, by the paper."""
_COUNTS: Final = ("Foreign ticks", "Corrupt measurements", "Surplus measurements")

LOST_PERCENT: Final = 5.0
DRIFT_MN: Final = 41.0
"""Of a gauge's null over 15 K, by its data sheet (FSS1500)."""
NOISE_MN: Final = (0.1, 13.0)
"""Up to three times the standard deviation with which the uncertainty of the COF is worked out."""
PICKUP_NOISE_NM: Final = (0.05, 5.0)
PICKUP_REST_NM: Final = 5.0
END_NM: Final = 10.0
RESIDUAL_PERCENT: Final = 3.0
RESONANCE_HZ: Final = 60.0
SHARE: Final = 0.2
"""How far gain and quality may be from those of the model in force."""

_Part = Callable[[Stimulator], Iterator["Check"]]


class Check(NamedTuple):
    """One verdict."""

    name: str
    value: float | None
    """None if it could not be measured."""
    unit: str
    low: float
    high: float
    """What passes is within low..high; infinite for no bound."""
    text: str = ""
    """Why it could not be measured."""

    @property
    def passed(self) -> bool:
        """Whether it was measured, and is within its limits."""
        return self.value is not None and self.low <= self.value <= self.high

    def as_json(self) -> dict[str, Any]:
        """Return what a JSON file holds of it; a bound that there is not is null."""
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
    """Judge timing, gauges, pick-up and resonance; nothing may rest on the plate.

    It drives up to 0.5 um, in open loop. On every way out the stimulator is disarmed, at 0 V, and
    its set-points are what they were. A part that the stimulator refuses, or that ends in a fault,
    is a failed check with the reason; the next part goes on.

    Parameters
    ----------
    stimulator
        Connected; not armed, by nobody.
    tell
        Called with each check as soon as it is made.

    Raises
    ------
    BenchError
        If somebody drives the stimulator; nothing was changed then.
    BusLostError, HeartbeatLostError
        If the stimulator is no longer there.
    RunInterruptedError
        At Ctrl-C in one of its runs; it has been disarmed.
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
    """Go to 0 V, whatever else fails; then put the set-points back."""
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
    window = stimulator.get("Gauge null.Window", "mN")
    for gauge, values in zip(GAUGES, samples.T, strict=True):
        null = stimulator.get(f"Gauge null.Null of S{gauge}", "mN")
        mean = float(values.mean())
        yield Check(f"null.S{gauge}", mean, "mN", null - window, null + window)
        zero = stimulator.get(f"Gauge zero.Zero of S{gauge}", "mN")
        yield Check(f"drift.S{gauge}", mean - zero, "mN", -DRIFT_MN, DRIFT_MN)
        yield Check(f"noise.S{gauge}", float(values.std(ddof=1)), "mN", *NOISE_MN)


def _sweep(stimulator: Stimulator) -> Iterator[Check]:
    gain = stimulator.get("Model.Gain per volt", "m")
    temperature = stimulator.get("Plate temperature", "degC")
    warmer = temperature - stimulator.get("Model.Temperature", "degC")
    expected = stimulator.get("Model.Resonance", "Hz") + _HZ_PER_K * warmer
    voltage = min(_SWEEP_UM * 1e-6 / gain, _MOST_V, stimulator.get("Limit.Voltage", "V"))
    frequency = np.linspace(expected - _SWEEP_HZ, expected + _SWEEP_HZ, _SWEEP_POINTS)
    stimulator.voltage = voltage
    stimulator.frequency = float(frequency[0])
    stimulator.mode = "open_loop"
    W = [_answer(stimulator, float(f)) for f in frequency]
    stimulator.disarm()
    fit = ResonanceFit.from_sweep(frequency, W, voltage)
    quality = stimulator.get("Model.Quality")
    yield Check("sweep.residual", 100.0 * fit.residual, "%", 0.0, RESIDUAL_PERCENT)
    yield Check("sweep.resonance", fit.f0, "Hz", expected - RESONANCE_HZ, expected + RESONANCE_HZ)
    yield Check("sweep.gain", abs(fit.gain) * 1e9, "nm/V", *_about(gain * 1e9))
    yield Check("sweep.quality", abs(fit.quality), "", *_about(quality))
    yield Check("polarity.drive", float(np.sign(fit.gain)), "", 1.0, 1.0)
    yield Check("polarity.phase", float(np.sign(fit.tau)), "", 1.0, 1.0)


def _answer(stimulator: Stimulator, frequency: float) -> complex:
    """Return W in m at a frequency in Hz, the mean of some samples after it has settled."""
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

"""Identification of the plate from voltage steps and a frequency sweep.

In the frame of the drive the plate is one complex first-order lag (eq. 6 and 7). Both fits below
follow from it, are linear, and know nothing of the phase or size of W beforehand:

* After a voltage step, at constant drive, ``W[k+1] = A W[k] + c`` with
  ``A = exp(-(1/tau + j dw) Ts)``: modulus and argument of A give tau and the detuning, which is
  unambiguous within +-500 Hz. Neither an offset of the pick-up nor a dead time disturbs A.
* In steady state ``V/W = (1 + j tau (w - w0))/gain``: a straight line over w, whose real part is
  1/gain, whose slope tau/gain and whose zero w0.

The step finds where and how to sweep; the sweep gives the model.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Generator

from smarttac_can.vocabulary.model import PlateModel
from smarttac_can.vocabulary.signals import TICK, Drive
from smarttac_can.vocabulary.states import IdentificationState

W_CEILING = 1.5e-6
"""Amplitude in m at which identification gives up; it aims well below."""
W_PROBE = 0.15e-6
"""Amplitude in m that is enough for the steps."""
W_SWEEP = 0.8e-6
"""Amplitude in m aimed at in the middle of the sweep."""
REST_TICKS = 80
OFFSET_TICKS = 16
PROBE_TICKS = 12
PROBE_LEVELS = 10
STEP_TICKS = 24
STEP_PAIRS = 4
A_MIN = 1e-5
A_MAX = math.exp(-TICK / 1e-2)
"""Bounds of abs(A): lags of 0.09 ms, far too short for the tick, and of 10 ms."""
SWEEP_POINTS = 17
SWEEP_SETTLING = 7.0
"""Ticks between two frequencies, in time constants."""
SWEEP_TICKS = 12
RESIDUAL_MAX = 0.05
"""Largest relative deviation of the sweep from the model that is taken for a resonance."""

Procedure = Generator[Drive, complex, PlateModel]
Samples = Generator[Drive, complex, list[complex]]


class IdentificationError(Exception):
    """The plate could not be identified; the message says why in one line."""


class Identification:
    """Identification of the unloaded plate, one tick at a time; 0.7 s at tau = 1 ms.

    Parameters
    ----------
    frequency
        Where to start in Hz; the resonance may be up to 300 Hz away.
    V_max
        Largest voltage in V; the voltages used follow from the response.
    f_min, f_max
        Limits of the frequency in Hz.
    """

    __slots__ = ("_procedure", "_started", "failure", "model", "progress", "state")

    def __init__(self, frequency: float, V_max: float, f_min: float, f_max: float) -> None:
        self.state = IdentificationState.RUNNING
        self.model: PlateModel | None = None
        """The plate, once the state is DONE."""
        self.failure = ""
        """Why it failed, once the state is FAILED."""
        self.progress = 0.0
        """Fraction of the procedure that is over, 0..1; 1 when it ended, however."""
        self._started = False
        start = min(max(frequency, f_min), f_max)
        self._procedure = self._identify(start, V_max, f_min, f_max)

    def update(self, W: complex) -> Drive | None:
        """Take the vibration of this tick and return its drive; None once it is over."""
        if self.state is not IdentificationState.RUNNING:
            return None
        try:
            # The first measurement belongs to a drive that is not ours.
            drive = self._procedure.send(W) if self._started else next(self._procedure)
        except StopIteration as end:
            self.model = end.value
            self.state = IdentificationState.DONE
            self.progress = 1.0
            return None
        except IdentificationError as error:
            self.fail(str(error))
            return None
        self._started = True
        return drive

    def fail(self, reason: str) -> None:
        """End without a model; nothing happens once it is over."""
        if self.state is not IdentificationState.RUNNING:
            return
        self.failure = reason
        self.state = IdentificationState.FAILED
        self.progress = 1.0
        self._procedure.close()

    def _identify(self, start: float, V_max: float, f_min: float, f_max: float) -> Procedure:
        for _ in range(REST_TICKS):
            yield Drive(0.0, start)
        offset = _mean((yield from _hold(0.0, start, OFFSET_TICKS)))
        self.progress = 0.1
        V = yield from _probe(V_max, start, offset)
        self.progress = 0.2
        tau, f0, gain = yield from _steps(V, start, offset)
        if not f_min <= f0 <= f_max:
            raise IdentificationError(f"resonance {f0:.0f} Hz is outside {f_min:.0f}..{f_max:.0f}")
        half = 0.5 / (math.pi * tau)
        low, high = max(f0 - half, f_min), min(f0 + half, f_max)
        V = min(W_SWEEP / gain, V_max)
        settling = math.ceil(SWEEP_SETTLING * tau / TICK)
        points: list[tuple[float, complex]] = []
        for i in range(SWEEP_POINTS):
            self.progress = 0.4 + 0.6 * i / SWEEP_POINTS
            f = low + (high - low) * i / (SWEEP_POINTS - 1)
            yield from _hold(V, f, settling)
            points.append((f, _mean((yield from _hold(V, f, SWEEP_TICKS))) - offset))
        return _fit_sweep(V, points)


def _hold(V: float, f: float, ticks: int) -> Samples:
    """Keep a drive for some ticks and return the vibration after each."""
    drive = Drive(V, f)
    samples = []
    for _ in range(ticks):
        W = yield drive
        if abs(W) > W_CEILING:
            raise IdentificationError(
                f"vibration {abs(W) * 1e6:.2f} um is above {W_CEILING * 1e6:g} um"
            )
        samples.append(W)
    return samples


def _probe(V_max: float, f: float, offset: complex) -> Generator[Drive, complex, float]:
    """Double the voltage until the plate vibrates enough, and return it."""
    for level in range(PROBE_LEVELS + 1):
        V = V_max * 2.0 ** (level - PROBE_LEVELS)
        samples = yield from _hold(V, f, PROBE_TICKS)
        if abs(_mean(samples[-4:]) - offset) > W_PROBE:
            return V
    raise IdentificationError(f"no vibration of {W_PROBE * 1e6:g} um at {V_max:g} V")


def _steps(
    V: float, f: float, offset: complex
) -> Generator[Drive, complex, tuple[float, float, float]]:
    """Switch the voltage off and on, and return a first tau, f0 and gain."""
    product, square = 0j, 0.0
    driven: list[tuple[complex, complex]] = []
    for _ in range(STEP_PAIRS):
        for voltage in (0.0, V):
            samples = yield from _hold(voltage, f, STEP_TICKS)
            now, then = samples[:-1], samples[1:]
            now_mean, then_mean = _mean(now), _mean(then)
            for x, y in zip(now, then, strict=True):
                dx = x - now_mean
                product += (y - then_mean) * dx.conjugate()
                square += dx.real * dx.real + dx.imag * dx.imag
            if voltage > 0.0:
                driven.append((now_mean, then_mean))
    A = product / square if square > 0.0 else 0j
    if not A_MIN < abs(A) < A_MAX:
        raise IdentificationError(
            f"the response to a step is no decay: {abs(A):.3g} is outside {A_MIN:.3g}..{A_MAX:.3g}"
        )
    tau = -TICK / math.log(abs(A))
    dw = -cmath.phase(A) / TICK
    W = _mean([(then - A * now) / (1.0 - A) for now, then in driven]) - offset
    return tau, f - dw / (2.0 * math.pi), abs(W * complex(1.0, tau * dw)) / V


def _fit_sweep(V: float, points: list[tuple[float, complex]]) -> PlateModel:
    """Fit the straight line V/W over the frequency, weighted by its variance."""
    weights = [abs(W) ** 4 for _, W in points]
    total = math.fsum(weights)
    if total == 0.0:
        raise IdentificationError("no vibration in the sweep")
    inverse = [V / W if W else 0j for _, W in points]
    f_mean = math.fsum(w * f for w, (f, _) in zip(weights, points, strict=True)) / total
    real = math.fsum(w * z.real for w, z in zip(weights, inverse, strict=True)) / total
    imag = math.fsum(w * z.imag for w, z in zip(weights, inverse, strict=True)) / total
    slope = math.fsum(
        w * (f - f_mean) * z.imag for w, (f, _), z in zip(weights, points, inverse, strict=True)
    ) / math.fsum(w * (f - f_mean) ** 2 for w, (f, _) in zip(weights, points, strict=True))
    if real <= 0.0 or slope <= 0.0:
        raise IdentificationError("the sweep shows no resonance")
    f0 = f_mean - imag / slope
    if not points[0][0] <= f0 <= points[-1][0]:
        raise IdentificationError(f"resonance {f0:.0f} Hz is outside the sweep")
    gain, tau = 1.0 / real, slope / (2.0 * math.pi * real)
    residual = max(
        abs(W * complex(1.0, 2.0 * math.pi * tau * (f - f0)) / (gain * V) - 1.0) for f, W in points
    )
    if residual > RESIDUAL_MAX:
        raise IdentificationError(f"the sweep is {100 * residual:.0f} % off a resonance")
    try:
        return PlateModel(gain, tau, f0)
    except ValueError as error:
        raise IdentificationError(str(error)) from error


def _mean(values: list[complex]) -> complex:
    return sum(values) / len(values)

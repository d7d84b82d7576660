"""Identification of the plate from voltage steps and a frequency sweep.

In the frame of the drive the plate is one complex first-order lag (eq. 6 and 7). Both fits below
follow from it, are linear, and need no initial phase or size of W:

* After a voltage step, at constant drive, ``W[k+1] = A W[k] + c`` with
  ``A = exp(-(1/tau + j dw) Ts)``. Modulus and argument of A give tau and the detuning, the latter
  up to multiples of 1 kHz. Neither an offset of the pick-up nor a dead time affects A. The steady
  state gives the multiple: ``dw_c = -(W_q/W_d)/tau``.
* In steady state ``V/W = (1 + j tau (w - w0))/gain``: a straight line over w, with the real part
  1/gain, the slope tau/gain and the zero w0. In a plate that softens, w0 falls with the amplitude.

The steps find where and how to sweep, from any start; the sweep gives the model. A finger changes
gain and tau by the same factor, so ``kappa = gain/tau`` of a plate is constant. A model with the
known kappa and a smaller tau is therefore a loaded plate, even if a tare hides the finger from the
gauges.

The model is accepted if it agrees with the data sheet of the plate. A second, shorter sweep at half
the voltage tells what grows with the amplitude from what does not. Softening becomes part of the
model. Losses that grow, a resonance that falls with the square of the amplitude, and a second mode
are remarked (`sweep_models`); gain, tau and f0 are then those of the first mode at small vibration.
A pick-up that has lost gain, or whose gain depends on the amplitude, gives no model.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Generator, Sequence
from typing import NamedTuple

from smarttac_can.science.control.parameters import CascadeParameters
from smarttac_can.science.control.sweep_models import (
    FIT_STEPS,
    Growth,
    Inverse,
    Point,
    growths,
    inverses,
    is_bent,
    modes_of,
    next_fit,
    noise_of,
    unexplained_by,
    without,
)
from smarttac_can.vocabulary.model import PlateModel
from smarttac_can.vocabulary.signals import TICK, Drive
from smarttac_can.vocabulary.states import IdentificationState
from smarttac_can.vocabulary.step_response import STEP_TICKS, StepResponse, step_response

W_CEILING = 1.5e-6
"""Amplitude in m at which the identification gives up; it aims well below."""
NOISE = 10e-9
"""Noise of each axis of the pick-up in m, above which measuring takes proportionally longer."""
NOISE_MAX = 50e-9
"""Noise in m above which the identification gives up."""
W_PROBE = 0.15e-6
"""Amplitude in m that suffices for the steps."""
OUT_OF_NOISE = 15.0
"""Amplitude that suffices for the steps, in standard deviations of the pick-up's noise."""
LEAST_OUT_OF_NOISE = 5.0
"""Such an amplitude if V_max does not allow more."""
W_SWEEP = 0.8e-6
"""Amplitude in m at the middle of the sweep."""
REST_TICKS = 80
OFFSET_TICKS = 16
PROBE_TICKS = 12
PROBE_LEVELS = 10
STEP_PAIRS = 4
PHASE_MAX = 1.55
"""Bound of the phase of W in rad, beyond which W_d is only noise."""
NEAR = 300.0
"""Largest distance in Hz from the frequency of the steps to the resonance that they find. If it is
larger, the steps are repeated at that resonance."""
APPROACHES = 6
TURN = 2.0 * math.pi / TICK
"""Interval in rad/s: a step gives the detuning up to multiples of it."""
SWEEP_POINTS = 17
SWEEP_SETTLING = 7.0
"""Ticks after a change of frequency, in time constants."""
SWEEP_TICKS = 12
SWEEPS = 4
CHECK_POINTS = (0, 3, 5, 8, 11, 13, 16)
"""Frequencies of the first sweep that the second one repeats."""
CHECK_SHARE = 0.5
"""Ratio of the voltage of the second sweep to that of the first."""
LINEAR = 0.05
"""Largest relative difference of kappa between both sweeps, in addition to the noise."""
SAME = 1.25
"""Largest ratio of the tau that a sweep finds to the tau for which it was designed."""
SQUARE = 2
"""Power of a growth with the square of the amplitude."""
GROWTH_MIN = 0.01
"""Relative growth of the losses at 1 um that is remarked."""
FALL_TOLD = 0.15
"""Largest fall of f0 in half bandwidths besides which two modes are told apart. It is known to some
2 % if there is a second mode."""
BENT_PART = 0.1
"""Share of a fall of f0 that may look like losses if there is a second mode."""
RESIDUAL_MAX = 0.05
"""Largest relative deviation of the sweep from a resonance, in addition to the noise."""
RESIDUAL_NOISE = 5.0
"""Standard deviations of a point of the sweep that count as noise."""
LOAD_KAPPA = 0.1
"""Largest relative difference of kappa for the same plate."""
LOAD_TAU = 0.9
"""Fraction of the known tau below which the same plate counts as loaded."""

Procedure = Generator[Drive, complex, PlateModel]
Samples = Generator[Drive, complex, list[complex]]


class _Sweep(NamedTuple):
    """Parameters of a sweep over a range of frequencies."""

    low: float
    high: float
    settling: int
    """Ticks for which a point settles before it is measured."""
    ticks: int
    """Ticks for which a point is measured."""
    offset: complex
    """Reading of the pick-up at rest in m."""


class IdentificationError(Exception):
    """The plate could not be identified; the message gives the reason in one line."""


class Identification:
    """Identification of the unloaded plate, one tick at a time; it takes 0.9 s at tau = 1 ms.

    A start more than 300 Hz off takes about 0.4 s more.

    Parameters
    ----------
    known
        Model of the plate so far. A result with the same kappa and a smaller tau is a loaded plate.
    frequency
        Start frequency in Hz; the resonance may be anywhere within the limits.
    parameters
        Largest voltage, limits of the frequency, and data sheet of the plate. The voltages follow
        from the response.
    """

    __slots__ = ("_procedure", "_started", "failure", "model", "progress", "remark", "state")

    def __init__(self, known: PlateModel, frequency: float, parameters: CascadeParameters) -> None:
        self.state = IdentificationState.RUNNING
        self.model: PlateModel | None = None
        """Identified plate, if the state is DONE."""
        self.failure = ""
        """Reason of the failure, if the state is FAILED."""
        self.remark = ""
        """Parameter to correct, although the plate was identified; empty for none."""
        self.progress = 0.0
        """Progress, 0..1; 1 after any end."""
        self._started = False
        start = parameters.clip_frequency(frequency)
        self._procedure = self._identify(known, start, parameters)

    def update(self, W: complex) -> Drive | None:
        """Take the vibration of this tick and return its drive; None after the end."""
        if self.state is not IdentificationState.RUNNING:
            return None
        try:
            # The first measurement belongs to a drive from before the identification.
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
        """End without a model; no effect after the end."""
        if self.state is not IdentificationState.RUNNING:
            return
        self.failure = reason
        self.state = IdentificationState.FAILED
        self.progress = 1.0
        self._procedure.close()

    def _identify(self, known: PlateModel, start: float, p: CascadeParameters) -> Procedure:
        V_max, f_min, f_max = p.V_max, p.f_min, p.f_max
        for _ in range(REST_TICKS):
            yield Drive(0.0, start)
        rest = yield from _hold(0.0, start, OFFSET_TICKS)
        offset, noise = _mean(rest), _deviation(rest)
        if noise > NOISE_MAX:
            raise IdentificationError(
                f"noise of {noise * 1e9:.0f} nm at rest is above {NOISE_MAX * 1e9:g} nm"
            )
        patience = math.ceil(max(noise / NOISE, 1.0))
        self.progress = 0.1
        f = start
        for _ in range(APPROACHES):
            V = yield from _probe(V_max, f, offset, noise)
            self.progress = 0.2
            tau, f0, gain, steps = yield from _steps(V, f, offset, noise, patience * STEP_PAIRS)
            nearest = min(max(f0, f_min), f_max)
            if abs(nearest - f) <= NEAR:
                break
            f = nearest
            yield from _hold(0.0, f, REST_TICKS)
        ticks = patience * SWEEP_TICKS
        for _ in range(SWEEPS):
            half = 0.5 / (math.pi * tau)
            middle = min(max(f0, f_min), f_max)
            low, high = max(middle - half, f_min), min(middle + half, f_max)
            if low == high:
                raise IdentificationError(f"limits {low:.0f}..{high:.0f} Hz leave nothing to sweep")
            V = min(W_SWEEP / gain, V_max)
            settling = math.ceil(SWEEP_SETTLING * tau / TICK)
            sweep = _Sweep(low, high, settling, ticks, offset)
            points = yield from self._sweep(V, sweep, range(SWEEP_POINTS))
            model = _fit_sweep(inverses(points, 0.0))
            fits = low <= model.f0 <= high and 1.0 / SAME <= model.tau / tau <= SAME
            tau, f0, gain = model.tau, model.f0, model.gain
            if fits:
                check = yield from self._sweep(CHECK_SHARE * V, sweep, CHECK_POINTS)
                model, seen = yield from _judge(points, check, ticks, p.W_max)
                f0 = model.f0
                if not f_min <= f0 <= f_max:
                    break
                _require_unloaded(model, known)
                _require_data_sheet(model, p)
                delay = _remark_on_delay(steps, p.dead_time)
                self.remark = "; ".join(filter(None, (*seen, delay)))
                return model
        if f_min <= f0 <= f_max:
            raise IdentificationError(f"no sweep fits the resonance it finds, last {f0:.0f} Hz")
        raise IdentificationError(f"resonance {f0:.0f} Hz is outside {f_min:.0f}..{f_max:.0f}")

    def _sweep(
        self, V: float, sweep: _Sweep, which: Sequence[int]
    ) -> Generator[Drive, complex, list[Point]]:
        """Return the mean vibration after settling at some of the frequencies of a sweep."""
        low, high, settling, ticks, offset = sweep
        points: list[Point] = []
        begin, end = (0.4, 0.8) if len(which) == SWEEP_POINTS else (0.8, 1.0)
        for i in which:
            self.progress = max(self.progress, begin + (end - begin) * len(points) / len(which))
            f = low + (high - low) * i / (SWEEP_POINTS - 1)
            yield from _hold(V, f, settling)
            samples = yield from _hold(V, f, ticks)
            deviation = _deviation(samples) / math.sqrt(ticks)
            points.append(Point(f, V, _mean(samples) - offset, deviation))
        return points


def _judge(
    first: list[Point], check: list[Point], ticks: int, W_max: float
) -> Generator[Drive, complex, tuple[PlateModel, list[str]]]:
    """Return the model of two sweeps, and remarks on what is no single, linear resonance.

    Each point is the mean of some ticks. The work is spread over some more ticks at 0 V, of which
    it takes a third each. A fall with the square becomes a softening that is right at W_max in m.
    """
    noise = noise_of(first, check)
    offset = noise * math.sqrt(ticks / OFFSET_TICKS)
    full, half = inverses(first, noise), inverses(check, noise)
    losses, falls = growths(full, half, offset)
    size = max((point.size for point in full), default=0.0)
    remarks = []
    if unexplained := unexplained_by(losses, falls, size, len(half)):
        losses = losses._replace(value=0.0)
    rest = Drive(0.0, first[-1].f)
    yield rest
    slope = _slope(
        _fit_sweep([point._replace(y=point.y - 1j * falls.of(point.size)) for point in full])
    )
    _require_linear(
        _fit_sweep(without(full, None, falls, slope)),
        _fit_sweep(without(half, None, falls, slope)),
        max(point.unsure / abs(point.y) for point in half),
    )
    points = without(full, losses, falls, slope)
    model = _fit_sweep(points)
    if unexplained:
        remarks.append(
            f"the sweeps differ by {100.0 * unexplained * model.gain:.1f} % more than softening "
            "and losses explain: check the pick-up"
        )
    yield rest
    if bent := is_bent(points, offset):
        told = not unexplained and abs(falls.of(size)) * model.gain <= FALL_TOLD
        model, remark = yield from _two_modes(points, model, rest, told=told)
        if not unexplained:
            remarks.append(remark)
    remarks += _remarks_on_growth(losses, falls, model, W_max, bent=bent)
    # The bound of the vibration has to know how low the resonance may fall.
    softening = falls.value / slope * W_max ** (falls.power - 1)
    return _model(model.gain, model.tau, model.f0, softening), remarks


def _remarks_on_growth(
    losses: Growth, falls: Growth, model: PlateModel, W_max: float, *, bent: bool
) -> list[str]:
    remarks = []
    if falls.value and falls.power == SQUARE:
        remarks.append(
            "the resonance falls with the square of the amplitude, by "
            f"{falls.of(1e-6) / _slope(model):.0f} Hz at 1 um: "
            f"Model.Softening is right at {W_max * 1e6:g} um"
        )
    # On a bent line a fall of f0 looks like losses, by a part of it.
    like_losses = BENT_PART * abs(falls.of(1e-6)) * model.gain if bent else 0.0
    growth = losses.of(1e-6) * model.gain
    if abs(growth) > GROWTH_MIN + like_losses:
        square = "square of the " if losses.power == SQUARE else ""
        remarks.append(
            f"the losses grow with the {square}amplitude, by {100.0 * growth:.0f} % at 1 um: "
            "gain and tau are those of a small vibration"
        )
    return remarks


def _two_modes(
    points: list[Inverse], line: PlateModel, rest: Drive, *, told: bool
) -> Generator[Drive, complex, tuple[PlateModel, str]]:
    """Return the model of a sweep that is no single resonance, and the remark on it.

    Each step of the fit has a tick of its own.
    """
    modes, fit = None, None
    try:
        for step in range(FIT_STEPS if told else 0):
            fit = next_fit(points, line.gain, fit, step)
            yield rest
        modes = modes_of(points, line.gain, fit) if fit else None
    except ArithmeticError:
        pass
    second = ""
    if modes:
        second = (
            f"a second mode of some {100.0 * modes.share:.0f} % of the gain some "
            f"{abs(modes.offset):.0f} Hz {'above' if modes.offset > 0.0 else 'below'}"
        )
    off = _off(points, line)
    if off > RESIDUAL_MAX:
        as_with = f", as with {second}" if second else ""
        raise IdentificationError(
            f"no single resonance: the sweep is {100.0 * off:.0f} % off one{as_with}"
        )
    if not modes:
        return line, (
            "no single resonance, as with a second mode that is not told apart: "
            "gain and tau are those of both"
        )
    return (
        _model(modes.gain, modes.tau, modes.f0),
        f"the pick-up sees {second}: the model is that of the first",
    )


def _off(points: list[Inverse], line: PlateModel) -> float:
    """Return the largest relative deviation from a resonance, beyond the noise."""
    turn = 2.0 * math.pi * line.tau
    return max(
        abs(complex(1.0, turn * (f - line.f0)) / (line.gain * y) - 1.0)
        - RESIDUAL_NOISE * unsure / abs(y)
        for f, y, _, unsure in points
    )


def _model(gain: float, tau: float, f0: float, softening: float = 0.0) -> PlateModel:
    """Return a model; `IdentificationError` if no controller takes it."""
    try:
        return PlateModel(gain, tau, f0, softening=softening)
    except ValueError as error:
        raise IdentificationError(str(error)) from error


def _remark_on_delay(steps: StepResponse, dead_time: float) -> str:
    if abs(steps.delay - dead_time) <= steps.tolerance:
        return ""
    return (
        f"a drive is seen some {steps.delay * 1e6:.0f} us after its measurement, the dead time "
        f"is {dead_time * 1e6:.0f} us: write Controller.Dead time"
    )


def _hold(V: float, f: float, ticks: int) -> Samples:
    """Keep a drive for some ticks, and return the vibration after each."""
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


def _probe(
    V_max: float, f: float, offset: complex, noise: float
) -> Generator[Drive, complex, float]:
    """Double the voltage until the plate vibrates enough; return one well above the noise."""
    enough = OUT_OF_NOISE * noise
    W = 0.0
    for level in range(PROBE_LEVELS + 1):
        V = V_max * 2.0 ** (level - PROBE_LEVELS)
        samples = yield from _hold(V, f, PROBE_TICKS)
        W = abs(_mean(samples[-4:]) - offset)
        if W > W_PROBE:
            return min(V * max(1.0, enough / W), V_max)
    if noise < W / LEAST_OUT_OF_NOISE:
        return V_max
    raise IdentificationError(f"no vibration of {W_PROBE * 1e6:g} um at {V_max:g} V")


def _steps(
    V: float, f: float, offset: complex, noise: float, pairs: int
) -> Generator[Drive, complex, tuple[float, float, float, StepResponse]]:
    """Switch the voltage off and on; return a first tau, f0 and gain, and the response."""
    holds: list[list[complex]] = []
    for _ in range(pairs):
        for voltage in (0.0, V):
            holds.append((yield from _hold(voltage, f, STEP_TICKS)))
    try:
        response = step_response(holds, offset, noise)
    except ValueError as error:
        raise IdentificationError(str(error)) from error
    A, W, unbiased, _, _ = response
    phase = max(-PHASE_MAX, min(PHASE_MAX, -cmath.phase(W)))
    dw = -cmath.phase(A) / TICK
    dw_c = math.tan(phase) / unbiased
    dw += TURN * round((dw_c - dw) / TURN)
    tau = -TICK / math.log(abs(A))
    amplitude = max(abs(W * complex(1.0, tau * dw)), abs(W) / math.cos(phase) / SAME)
    return tau, f - dw / (2.0 * math.pi), amplitude / V, response


def _fit_sweep(points: list[Inverse]) -> PlateModel:
    """Fit the straight line y = V/W over the frequency, weighted by its variance."""
    weights = [point.size**4 for point in points]
    total = math.fsum(weights)
    if total == 0.0:
        raise IdentificationError("no vibration in the sweep")
    f_mean, real, imag = (
        math.fsum(w * x for w, x in zip(weights, of, strict=True)) / total
        for of in (
            [point.f for point in points],
            [point.y.real for point in points],
            [point.y.imag for point in points],
        )
    )
    ff = fy = 0.0
    for w, (f, y, _, _) in zip(weights, points, strict=True):
        df = f - f_mean
        ff, fy = ff + w * df * df, fy + w * df * (y.imag - imag)
    slope = fy / ff if ff else 0.0
    if real <= 0.0 or slope <= 0.0:
        raise IdentificationError("the sweep shows no resonance")
    return _model(1.0 / real, slope / (2.0 * math.pi * real), f_mean - imag / slope)


def _slope(model: PlateModel) -> float:
    """Return the slope of y over the frequency in V/m/Hz."""
    return 2.0 * math.pi * model.tau / model.gain


def _require_unloaded(model: PlateModel, known: PlateModel) -> None:
    """Refuse a model with gain and tau below the known ones by one factor: it has a finger."""
    tau, gain = model.tau / known.tau, model.gain / known.gain
    if abs(gain / tau - 1.0) <= LOAD_KAPPA and tau < LOAD_TAU:
        raise IdentificationError(
            f"the plate is loaded, gain and tau are {100.0 * (1.0 - tau):.0f} % below the model: "
            "lift the finger, tare and repeat; write the model if there is none"
        )


def _require_data_sheet(model: PlateModel, p: CascadeParameters) -> None:
    """Refuse a model outside the tolerance of the data sheet."""
    for name, found, sheet, unit, per in (
        ("gain", model.gain, p.sheet_gain, "nm/V", 1e9),
        ("tau", model.tau, p.sheet_tau, "ms", 1e3),
    ):
        off = found / sheet - 1.0
        if abs(off) > p.sheet_tolerance:
            raise IdentificationError(
                f"{name} {found * per:.3g} {unit} is {100.0 * off:+.0f} % off the data sheet's "
                f"{sheet * per:.3g} {unit}, {100.0 * p.sheet_tolerance:.0f} % are allowed: "
                "check the pick-up, or write the data sheet of this plate to Model"
            )


def _require_linear(model: PlateModel, check: PlateModel, noise: float) -> None:
    """Refuse a plate whose gain or tau alone depends on the amplitude: its pick-up is not linear.

    Losses that grow change both by one factor.

    Parameters
    ----------
    model, check
        Models of both sweeps.
    noise
        Relative standard deviation of a point of the second sweep.
    """
    most = LINEAR + RESIDUAL_NOISE * noise
    gain, tau = check.gain / model.gain, check.tau / model.tau
    if abs(gain / tau - 1.0) > most:
        name, off = ("gain", gain - 1.0) if abs(gain - 1.0) > abs(tau - 1.0) else ("tau", tau - 1.0)
        raise IdentificationError(
            f"{name} changes by {100.0 * off:+.0f} % at half the voltage, "
            f"{100.0 * most:.0f} % are allowed: check the pick-up"
        )


def _mean(values: list[complex]) -> complex:
    return sum(values) / len(values)


def _deviation(values: list[complex]) -> float:
    """Return the standard deviation of one axis."""
    mean = _mean(values)
    squares = math.fsum(abs(value - mean) ** 2 for value in values)
    return math.sqrt(0.5 * squares / (len(values) - 1))

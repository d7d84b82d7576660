"""One finger of a campaign: closed loop, set-up, run, and result.

The loop consists of plain functions, compiled or not. It steps plate and controllers as the nodes
do, without changes by a bench during the run.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, lru_cache
from math import ceil, inf, nan, sqrt
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from smarttac_can.science.control.parameters import CascadeParameters
from smarttac_can.science.control.step import (
    ControlPlan,
    ControlState,
    adopted,
    at_rest,
    control_plan,
    control_step,
)
from smarttac_can.science.control.tribometer import Forces, calibration
from smarttac_can.science.plant.finger import Pass, Path, ramp_of, stroke_at
from smarttac_can.science.plant.motion import (
    PlatePlan,
    PlateState,
    coefficients,
    measured,
    plate_step,
)
from smarttac_can.science.plant.motion import at_rest as plate_at_rest
from smarttac_can.science.plant.parameters import PlateParameters
from smarttac_can.science.plant.sensors import NOISE_BLOCK, noise_block, sensing
from smarttac_can.science.population.compiled import can_compile, compiled
from smarttac_can.science.population.fingers import (
    CASES,
    LIFT_LENGTH,
    LIFT_PERIOD,
    LIFT_RAMP,
    MODEL_PLATE,
    PLATES,
    Case,
    Finger,
    Plate,
    draw_finger,
    draw_plate,
    lift,
    stroke_of,
)
from smarttac_can.science.population.steps import (
    AFTER_MS,
    BEFORE_MS,
    SETTLED_MS,
    TIME_MS,
    Floats,
    Step,
    UndefinedError,
    overshoot_percent,
    rise_time,
    single_steps,
    static_error_percent,
)
from smarttac_can.vocabulary.model import PlateModel
from smarttac_can.vocabulary.signals import TARE_SAMPLES, TICK, MeasurementFields, Setpoint
from smarttac_can.vocabulary.states import Law, Mode, VibrationLaw

Table = Floats | Sequence[Sequence[float]]
"""Rows of numbers: an array for compiled code, or lists, which Python reads faster."""


class Setup(NamedTuple):
    """Plate and finger of a run."""

    plan: PlatePlan
    path: Path
    passes: Table
    """A row for each pass, until the end of the run."""
    lifts: bool
    """Whether the finger lifts every second."""


class Asked(NamedTuple):
    """Mode and set-points of the controllers."""

    mode: int
    setpoint: Setpoint


class Loop(NamedTuple):
    """State of the loop at a tick."""

    tick: int
    plate: PlateState
    measurement: MeasurementFields
    controls: ControlState


def finger_at(
    path: Path, passes: Table, number: int, time: float, lifts: bool
) -> tuple[float, float]:
    """Return position in m and normal force in N at a time in s, in the pass `number`."""
    row = passes[number]
    now = Pass(row[0], row[1], row[2], row[3])
    Fn_before = passes[number - 1][3] if number else now.Fn
    x, force = stroke_at(path, number % 2 == 1, now, Fn_before, time)
    return x, force * lift(time) if lifts else force


def run(
    setup: Setup,
    plan: ControlPlan,
    loop: Loop,
    asked: Asked,
    noise: Table,
    traces: Floats,
) -> tuple[Loop, Forces]:
    """Run the loop with a stroking finger and the controllers in one mode.

    Parameters
    ----------
    setup
        Plate and finger.
    plan
        Plan of the controllers.
    loop
        State in which the run begins.
    asked
        Mode and set-point.
    noise
        A row of 15 values for each tick, and for the one after the last.
    traces
        Array to fill, a row per tick: true COF, measured COF, 1.0 right of the boundary.

    Returns
    -------
    loop, sums
        State at the end, and the sums of the samples of S1..S6 in N.
    """
    plate_plan, path, passes, lifts = setup
    mode, setpoint = asked
    first, plate, measurement, controls = loop
    s1 = s2 = s3 = s4 = s5 = s6 = 0.0
    number = _pass_at(passes, 0, first * TICK)
    finger = finger_at(path, passes, number, first * TICK, lifts)
    last = len(noise) - 1
    for tick in range(first, last):
        before = controls.drive
        controls, controlled = control_step(plan, controls, mode, measurement, setpoint)
        traces[tick, 0] = abs(plate.motion.Ft) / finger[1] if finger[1] > 0.0 else 0.0
        traces[tick, 1] = controlled.contact[3]
        traces[tick, 2] = 1.0 if controls.right else 0.0
        time = (tick + 1) * TICK
        number = _pass_at(passes, number, time)
        finger_next = finger_at(path, passes, number, time, lifts)
        g1, g2, g3, g4, g5, g6 = measurement[1]
        s1, s2, s3, s4, s5, s6 = s1 + g1, s2 + g2, s3 + g3, s4 + g4, s5 + g5, s6 + g6
        plate, measurement = plate_step(
            plate_plan,
            plate,
            (before, controls.drive),
            (finger, finger_next),
            noise[tick + 1],
        )
        finger = finger_next
    return Loop(last, plate, measurement, controls), (s1, s2, s3, s4, s5, s6)


def _pass_at(passes: Table, number: int, time: float) -> int:
    """Return the number of the pass at a time in s, searching from `number` on."""
    while number + 1 < len(passes) and time >= passes[number + 1][0]:
        number += 1
    return number


Flags = NDArray[np.bool_]
LEARNING: Final = 4
"""Number of switches of the reference at first that are not judged, so that a law may learn."""
NO_STEP: Final = 100.0
"""Overshoot in % of a finger without a step."""
TOUCHES: Final = 6
"""Up-steps of a finger whose figures are stored singly: all of them, if it does not lift."""
TOUCH_FIGURES: Final = ("rise_time_ms", "overshoot_percent")
"""Figures stored for a single touch; infinite and `NO_STEP` without a step."""


class Figures(NamedTuple):
    """Metrics of one curve of the COF."""

    rise_time_ms: float
    """Infinite without a step."""
    overshoot_percent: float
    static_error_percent: float
    """NaN without a usable touch."""
    chatter: float
    """Standard deviation while the reference and the finger's pace are constant; NaN if never."""


class Traces(NamedTuple):
    """Traces of a run, one element per tick."""

    mu_true: Floats
    mu: Floats
    """Measured COF; 0 without contact."""
    right: Floats
    """1.0 where the reference is the one right of the boundary."""
    steady: Flags
    """Whether force and speed of the finger are constant."""


class Outcome(NamedTuple):
    """Result of a finger."""

    true: Figures
    measured: Figures
    touches: Floats
    """`TOUCH_FIGURES` of the true COF, a row for each of `TOUCHES`; NaN for a missing touch."""


def outcome(run: Traces, mu_left: float, mu_right: float) -> Outcome:
    """Return the metrics of a run between these references."""
    switches = np.flatnonzero(np.diff(run.right)) + 1
    touching = run.mu > 0.0
    judged = switches[LEARNING:]
    up = [n for n in judged.tolist() if run.right[n] and _whole(n, touching, run.right)]
    around = np.array(up, dtype=np.intp)[:, None] + np.arange(-BEFORE_MS, AFTER_MS + 1)
    settled = run.steady & touching
    settled[: judged[0] if len(judged) else None] = False
    for begin in (*judged.tolist(), *(np.flatnonzero(touching[1:] & ~touching[:-1]) + 1).tolist()):
        settled[begin : begin + SETTLED_MS] = False
    true, measured = (
        _figures(mu, around, settled, (mu_left, mu_right)) for mu in (run.mu_true, run.mu)
    )
    touches = np.full((TOUCHES, len(TOUCH_FIGURES)), nan)
    singly = run.mu_true[around[:TOUCHES]]
    touches[: len(singly)] = single_steps(singly, mu_right - mu_left, NO_STEP)
    return Outcome(true, measured, touches)


def _whole(switch: int, touching: Flags, right: Floats) -> bool:
    """Return whether the window of 20 ms before to 80 ms after has contact and only this switch."""
    window = slice(switch - BEFORE_MS, switch + AFTER_MS + 1)
    alone = np.count_nonzero(np.diff(right[window])) == 1
    return bool(alone and len(right) >= window.stop and touching[window].all())


def _figures(
    mu: Floats, around: NDArray[np.intp], settled: Flags, references: tuple[float, float]
) -> Figures:
    """Return the metrics of a curve, from the ticks around up-steps and from settled ticks."""
    chatter = _chatter(mu, settled)
    if not len(around):
        return Figures(inf, NO_STEP, nan, chatter)
    step = Step(TIME_MS, mu[around].mean(axis=0), *references)
    static = static_error_percent(step)
    try:
        return Figures(rise_time(step), overshoot_percent(step), static, chatter)
    except UndefinedError:
        return Figures(inf, NO_STEP, static, chatter)


def _chatter(mu: Floats, settled: Flags) -> float:
    """Return the standard deviation within sections of settled ticks, about the mean of each."""
    edges = np.flatnonzero(np.diff(settled, prepend=False, append=False))
    if not len(edges):
        return nan
    lengths = edges[1::2] - edges[::2]
    padded = np.append(mu, 0.0)
    means = np.add.reduceat(padded, edges)[::2] / lengths
    deviations = mu[settled] - np.repeat(means, lengths)
    return sqrt(float(np.mean(deviations * deviations)))


Runner = tuple[Callable[..., Any], Callable[[Any], Any]]
"""`run`, and the function that makes its tables."""
AMPLITUDE: Final = 1e-6
"""Nominal amplitude in m, which is held without contact."""
PASSES: Final = 16
"""Passes of a finger; six up-steps are after the fourth switch."""
_DEAD_TIME_MAX: Final = 999e-6
"""Longest dead time in s that the controllers can assume."""


@dataclass(frozen=True, slots=True)
class Campaign:
    """Parameters that all fingers of a campaign share.

    Raises
    ------
    ValueError
        If there is no such case or choice of plates, or the dead time is out of its range.
    """

    seed: int = 1
    """Seed of the fingers, their motion and the noise, 0..2^32 - 1."""
    law: Law = Law.MEASURED
    """Friction law."""
    vibration_law: VibrationLaw = VibrationLaw.PI
    """Law for amplitude and resonance."""
    dead_time: float = 0.0
    """Time in s from the tick until the new drive is in force, 0..999e-6."""
    case: str = "nominal"
    """Name in `CASES`."""
    plates: str = "model"
    """One of `PLATES`."""
    parameters: CascadeParameters = field(init=False)
    """Parameters of the controllers, which follow from the others."""

    def __post_init__(self) -> None:
        if self.case not in CASES:
            raise ValueError(f"there is no case {self.case!r}: {', '.join(CASES)}")
        if self.plates not in PLATES:
            raise ValueError(f"there are no plates {self.plates!r}: {', '.join(PLATES)}")
        p = CascadeParameters(
            law=self.law,
            vibration_law=self.vibration_law,
            dead_time=self.dead_time,
            lateral=calibration(PlateParameters().sensors.crosstalk),
        )
        slope = p.slope * CASES[self.case].slope
        object.__setattr__(self, "parameters", replace(p, slope=slope))


def parameters_of(campaign: Campaign, plate: Plate) -> CascadeParameters:
    """Return the parameters of the controllers for a plate, with their assumed dead time."""
    assumed = min(max(campaign.dead_time + plate.excess, 0.0), _DEAD_TIME_MAX)
    return replace(campaign.parameters, dead_time=assumed)


def plate_of(case: Case, plate: Plate = MODEL_PLATE) -> PlateParameters:
    """Return the parameters of a plate in a case."""
    p = PlateParameters(plate.resonator)
    sensors = replace(
        p.sensors,
        path_frequency=p.sensors.path_frequency * case.path_frequency,
        pickup_window=plate.window,
    )
    if case.path_damping is not None:
        sensors = replace(sensors, path_damping=case.path_damping)
    contact = replace(p.contact, film_lag=case.film_lag, ripple=case.ripple)
    return replace(p, sensors=sensors, contact=contact)


def traces_of(campaign: Campaign, finger: Finger, under: Plate = MODEL_PLATE) -> Traces:
    """Run a finger of a campaign.

    Parameters
    ----------
    campaign
        Parameters that all fingers share.
    finger
        Finger to run.
    under
        Plate under the finger.
    """
    case = CASES[campaign.case]
    plate = plate_of(case, under)
    stroke = stroke_of(finger, case)
    passes = stroke.passes(PASSES)
    ticks = int((passes[-1].start + passes[-1].duration) / TICK)
    noise = np.concatenate(
        [noise_block(plate.sensors, finger.noise_seed, n) for n in range(ticks // NOISE_BLOCK + 1)]
    )[: ticks + 1]
    traces = np.empty((ticks, 3))
    run_loop, table = fastest()
    made = coefficients(
        plate,
        finger.subject,
        ambient=under.ambient,
        dead_time=campaign.dead_time,
        sound_f0=plate.resonator.f0,
    )
    plate_plan = PlatePlan(made, sensing(plate.sensors))
    setup = Setup(plate_plan, stroke.path, table(passes), case.lifts)
    plan = _plan_of(parameters_of(campaign, under), under.model, table)
    f0 = plan.prior.f0
    setpoint = Setpoint(0.0, f0, AMPLITUDE, finger.mu_left, finger.mu_right, 0.0)
    rest = plate_at_rest(under.ambient)
    first = measured(plate_plan, rest, noise[0].tolist())
    loop = Loop(0, rest, first, at_rest(plan))
    off, on = Asked(int(Mode.OFF), setpoint), Asked(int(Mode.FRICTION), setpoint)
    loop, sums = run_loop(setup, plan, loop, off, table(noise[: TARE_SAMPLES + 1]), traces)
    tared = plan._replace(zero=tuple([total / TARE_SAMPLES for total in sums]))
    # Without the rows, which are the same: compiled code compares arrays by their elements.
    before, after = plan._replace(rows=()), tared._replace(rows=())
    loop = loop._replace(controls=adopted(before, after, loop.controls))
    run_loop(setup, tared, loop, on, table(noise), traces)
    mu_true, mu, right = np.ascontiguousarray(traces.T)
    return Traces(mu_true, mu, right, _steady(ticks, stroke.path, passes, case.lifts))


def _steady(ticks: int, path: Path, passes: list[Pass], lifts: bool) -> Flags:
    """Return the ticks at which the finger slides with the constant force and speed of a pass."""
    steady = np.zeros(ticks, dtype=np.bool_)
    for now in passes:
        ramp = ramp_of(path, now)
        begin, end = now.start + ramp, now.start + now.duration - ramp
        steady[ceil(begin / TICK) : int(end / TICK) + 1] = True
    if lifts:
        steady &= np.arange(ticks) * TICK % LIFT_PERIOD > LIFT_LENGTH + LIFT_RAMP
    return steady


def outcome_of(campaign: Campaign, number: int) -> tuple[Outcome, float]:
    """Return the result of a finger of a campaign by its number, and its simulated time in s."""
    finger = draw_finger(campaign.seed, number, CASES[campaign.case])
    run_ = traces_of(campaign, finger, draw_plate(campaign.seed, number, campaign.plates))
    return outcome(run_, finger.mu_left, finger.mu_right), len(run_.mu) * TICK


@cache
def fastest() -> Runner:
    """Return the loop, compiled if possible, and the function that makes its tables."""
    if can_compile():
        return compiled(run), lambda rows: np.asarray(rows, dtype=np.float64)
    return plain()


def plain() -> Runner:
    """Return the loop without compilation; Python reads lists faster than arrays."""
    return run, lambda rows: rows.tolist() if isinstance(rows, np.ndarray) else rows


@lru_cache(maxsize=16)
def _plan_of(
    parameters: CascadeParameters, model: PlateModel, table: Callable[[Any], Any]
) -> ControlPlan:
    """Return the plan of the controllers, with tables in the form that the loop reads fastest."""
    plan = control_plan(parameters, model)
    rows, none = table(plan.rows), table([])
    return plan._replace(rows=rows, texture=plan.texture._replace(values=none))

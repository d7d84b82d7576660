"""The watchdogs that check every cycle of the loop.

`watch_step` checks a measurement and the drive that is to answer it. It steps the counts in the
table `WATCHDOGS` and returns the faults that are present, one bit for each watchdog. There are two
kinds of counts:

* A **leaky bucket** (`Way.SLOWLY`): a faulty cycle adds `FORGOTTEN`, a sound cycle subtracts 1. A
  number of faulty cycles in a row (``most``) is a fault, and so are fewer that recur: among any n
  cycles without a fault, fewer than ``(most FORGOTTEN + n)/(FORGOTTEN + 1)`` were faulty.
* A count **in a row**: a sound cycle sets it to 0.

A cycle that cannot be judged is neither faulty nor sound, and leaves the count unchanged.
"""

from __future__ import annotations

from collections.abc import Callable
from math import hypot, inf
from typing import Final, NamedTuple

from smarttac_can.instrument.nodes.bounds import (
    ROUNDING,
    BoundPlan,
    InForce,
    Vibration,
    bound_plan,
    follow,
    still,
)
from smarttac_can.instrument.nodes.plate_block import TICK_MASK
from smarttac_can.instrument.nodes.process_image import SENSORS, Measured
from smarttac_can.science.control.parameters import CascadeParameters
from smarttac_can.science.control.tribometer import DETERMINANT_MIN, Forces
from smarttac_can.science.control.vibration import AMPLITUDE_MIN
from smarttac_can.vocabulary.signals import PICKUP_SATURATED, SHORT_DEADLINE_MS, Contact, Drive
from smarttac_can.vocabulary.states import Mode
from smarttac_can.vocabulary.watchdogs import (
    FORGOTTEN,
    STUCK_GAUGE_CYCLES,
    STUCK_THERMOMETER_CYCLES,
    STUCK_WITHIN,
    WATCHDOGS,
    Watchdog,
    Way,
    level,
)

_PLATE_END: Final = 0.038
"""Distance in m from the middle of the plate to its end; a finger cannot press farther out."""
_FRICTION_MAX: Final = 2.0
"""Largest Ft/Fn of a finger; a wet one reaches about 1.5."""
_EXCESS: Final = 1.5
"""Largest ratio of the vibration to that of the model. Fingers and detuning only lower it."""
_EXCESS_UNIDENTIFIED: Final = 3.0
"""Largest such ratio during an identification."""
_EXCESS_OFFSET: Final = 100e-9
"""Vibration in m that is accepted without a voltage: noise, and the decay of a vibration."""
_LACK: Final = 0.8
"""Lowest ratio of the vibration to the bound from below."""
_SILENCE: Final = 0.05
"""Lowest ratio of the vibration to that of the model; it is 0.2 at the ends of the range."""
_LOOKED_FOR: Final = 200e-9
"""Vibration of the model in m above which a missing vibration is detected."""
_GAP_MAX: Final = TICK_MASK // 2
"""Most ticks between two measurements; more are a step back, as by a restart of the plate."""
_NO_PLATE: Final = 0
_OPEN_LOOP: Final = int(Mode.OPEN_LOOP)
"""The mode in which frequency steps are excused. In other modes they may be a sign of the fault."""
_IDENTIFY: Final = int(Mode.IDENTIFY)

_COUNTS: Final = [(watchdog, count) for watchdog, row in WATCHDOGS.items() for count in row.counts]
_NO_COUNTS: Final = (0,) * len(_COUNTS)
_PLACES: Final = {count.what: place for place, (_, count) in enumerate(_COUNTS)}
_STEPS: Final = [
    (1 << place, 1 << watchdog, count.way is Way.SLOWLY)
    for place, (watchdog, count) in enumerate(_COUNTS)
]
"""For each count: its bit, the bit of its watchdog, and whether it is a leaky bucket."""
_ELSEWHERE: Final = [
    sum(1 << place for place, (_, count) in enumerate(_COUNTS) if mode not in count.modes)
    for mode in Mode
]
"""For each mode: the bits of the counts that do not apply in it."""
_AMPLITUDE: Final = 1 << _PLACES["amplitude"]
_SATURATED: Final = 1 << _PLACES["saturated"]
_AT_ITS_END: Final = 1 << _PLACES["pick-up at its end"]
_GAUGES: Final = 1 << _PLACES["gauges"]
_EXCESSIVE: Final = 1 << _PLACES["excess"]
_SILENT: Final = 1 << _PLACES["silent"]
_LACKING: Final = 1 << _PLACES["lack"]
_RESONANCE: Final = 1 << _PLACES["resonance"]
_UNSEEN: Final = 1 << _PLACES["unseen"]

_THERMOMETER: Final = SENSORS.index("Temperature")
_WITHIN: Final = [0 if name == "Temperature" else STUCK_WITHIN for name in SENSORS]
_VOLTAGE: Final = 1 << Watchdog.VOLTAGE
_CONTROLLER: Final = 1 << Watchdog.CONTROLLER
_HOT: Final = 1 << Watchdog.TEMPERATURE
_NORMAL: Final = 1 << Watchdog.NORMAL_FORCE
_LATERAL: Final = 1 << Watchdog.LATERAL_FORCE
_STUCK: Final = 1 << Watchdog.STUCK
_CONTRADICTED: Final = 1 << Watchdog.GAUGES
_CALIBRATION: Final = 1 << Watchdog.CALIBRATION


class WatchPlan(NamedTuple):
    """Parameters of the watchdogs, in SI units."""

    bound: BoundPlan
    V_max: float
    """Limit of the voltage in V."""
    f_min: float
    """Lowest frequency in Hz."""
    f_max: float
    """Highest frequency in Hz."""
    temperature_max: float
    """Limit of the temperature in degC."""
    Fn_max: float
    """Limit of the normal force in N."""
    Ft_max: float
    """Limit of the magnitude of the lateral force in N."""
    mismatch: float
    """Largest contradiction between gauges in N."""
    gauge_positions: tuple[float, float, float, float]
    """Positions of S3 to S6 along x in m."""
    serial: int
    """Serial number of the plate that the calibration is for; 0 for none."""
    full: tuple[int, ...]
    """Value of each count from which on it is a fault, in the order of the table."""


class Seen(NamedTuple):
    """Inputs of the watchdogs in a cycle."""

    measured: Measured
    mode: int
    """Mode of the controllers in this cycle."""
    left_in: int
    """Mode after the cycle; the controllers leave a mode by themselves in doubt."""
    asked: Drive
    """Drive of the controllers."""
    contact: Contact
    zero: Forces
    """Zero of the gauges in N."""
    tared: bool
    """Whether the gauges have a zero."""
    in_force: InForce
    """Drives since the measurement before."""


class WatchState(NamedTuple):
    """State of the watchdogs after a cycle."""

    tick: int
    """Tick of the plate, 0..255."""
    vibration: Vibration
    counts: tuple[int, ...]
    """Counts, in the order of the table."""
    rests_at: tuple[int, ...]
    """Sample of each sensor since which it has not changed, in counts of its converter."""
    rests: tuple[int, ...]
    """Number of samples for which each sensor has not changed."""
    zero: tuple[float, ...]
    """Zero of the gauges in N; empty before the first."""


def watch_plan(
    parameters: CascadeParameters,
    si: Callable[[str], float],
    *,
    identified: bool,
    deadline_ms: int = SHORT_DEADLINE_MS,
) -> WatchPlan:
    """Return the parameters of the watchdogs.

    Parameters
    ----------
    parameters
        Parameters of the controllers, whose limits and calibration also apply here.
    si
        Function that returns the value of an object of ``stimulator.eds`` in SI units.
    identified
        Whether the model comes from an identification.
    deadline_ms
        Shortest event timer of the measurements over a bus, in ms. A drive may be late by the time
        above 3 ms. The drive from which the vibration is expected is not in force until then.
    """
    (xx, xy), (yx, yy) = parameters.lateral
    separable = abs(xx * yy - xy * yx) >= DETERMINANT_MIN
    return WatchPlan(
        bound=bound_plan(si, identified=identified),
        V_max=parameters.V_max,
        f_min=parameters.f_min,
        f_max=parameters.f_max,
        temperature_max=si("Limit.Temperature"),
        Fn_max=si("Limit.Normal force"),
        Ft_max=si("Limit.Lateral force"),
        mismatch=si("Limit.Gauge mismatch"),
        gauge_positions=parameters.gauge_positions,
        # With a calibration that mixes up the axes, a lateral force may read as 0.
        serial=int(si("Calibration.Plate serial number")) if separable else _NO_PLATE,
        full=full_counts(deadline_ms),
    )


def full_counts(deadline_ms: int) -> tuple[int, ...]:
    """Return the value at which each count is a fault under a deadline of the loop in ms."""
    late = max(0, deadline_ms - SHORT_DEADLINE_MS)
    cycles = [count.cycles + late * count.waits for _, count in _COUNTS]
    return tuple(
        [full_bucket(n) if slow else n for n, (_, _, slow) in zip(cycles, _STEPS, strict=True)]
    )


def at_rest(plan: WatchPlan) -> WatchState:
    """Return the state of the watchdogs for a plate at rest; the next tick is 0."""
    nothing = (0,) * len(SENSORS)
    return WatchState(TICK_MASK, still(plan.bound), _NO_COUNTS, nothing, nothing, ())


def watch_step(plan: WatchPlan, before: WatchState, seen: Seen) -> tuple[WatchState, int]:
    """Check a cycle.

    Parameters
    ----------
    plan
        Parameters of the watchdogs.
    before
        State of the watchdogs after the cycle before.
    seen
        Inputs of this cycle.

    Returns
    -------
    tuple
        State of the watchdogs after this cycle, and the present faults as bits, 1 << `Watchdog`.
    """
    tick, vibration, counts, rests_at, rests, zero = before
    measured, mode, _, _, contact, offsets, tared, in_force = seen
    measurement = measured.si
    W, gauges, _, saturation = measurement
    # During a lost or skipped measurement the vibration changes all the same.
    ticks = measured.tick - tick & TICK_MASK
    if ticks > _GAP_MAX:
        ticks = 1
    vibration = follow(plan.bound, vibration, in_force, measurement, contact, ticks)
    amplitude = abs(W)
    rests_at, rests = _rested(measured.counts, rests_at, rests)
    faults = _at_once(plan, seen, rests)
    faulty = _of_vibration(plan, vibration, W, amplitude, mode)
    if saturation:
        if saturation & ~PICKUP_SATURATED or mode == _IDENTIFY:
            faulty |= _SATURATED
        if saturation & PICKUP_SATURATED:
            faulty |= _AT_ITS_END
    cleared = _ELSEWHERE[mode]
    held = cleared | _undecided(vibration, in_force, amplitude, mode)
    if tared:
        Fn, Ft = contact.Fn, hypot(contact.Fx, contact.Fy)
        faults |= (_NORMAL if Fn > plan.Fn_max else 0) | (_LATERAL if Ft > plan.Ft_max else 0)
        if _odd(plan, gauges, offsets, Fn, Ft):
            faulty |= _GAUGES
        if offsets != zero:
            # The contradiction came from the old zero.
            zero = offsets
            cleared |= _GAUGES
    else:
        held |= _GAUGES
    if faulty & ~held or counts != _NO_COUNTS:
        counts, tripped = _counted(plan.full, counts, faulty, held, cleared)
        faults |= tripped if tared else tripped & ~_CONTRADICTED
    state = (measured.tick, vibration, counts, rests_at, rests, zero)
    return tuple.__new__(WatchState, state), faults


def levels(
    plan: WatchPlan, state: WatchState, in_force: InForce, contact: Contact, temperature: float
) -> dict[Watchdog, float]:
    """Return the level of each of these watchdogs after a cycle; 1.0 is a fault."""
    found: dict[Watchdog, float] = {}
    for (watchdog, _), count, full in zip(_COUNTS, state.counts, plan.full, strict=True):
        found[watchdog] = max(found.get(watchdog, 0.0), count / full)
    stuck = max(
        rest / (STUCK_THERMOMETER_CYCLES if at == _THERMOMETER else STUCK_GAUGE_CYCLES)
        for at, rest in enumerate(state.rests)
    )
    return found | {
        Watchdog.VOLTAGE: level(in_force.drive.voltage, plan.V_max),
        Watchdog.TEMPERATURE: level(temperature, plan.temperature_max),
        Watchdog.NORMAL_FORCE: contact.Fn / plan.Fn_max,
        Watchdog.LATERAL_FORCE: hypot(contact.Fx, contact.Fy) / plan.Ft_max,
        Watchdog.STUCK: stuck,
    }


def full_bucket(most: int) -> int:
    """Return the level of a leaky bucket that is a fault: so many faulty cycles in a row."""
    return most * FORGOTTEN


def leaked(bucket: int, full: int, faulty: bool) -> int:
    """Return the level of a leaky bucket after a cycle; from `full` on it is a fault."""
    if faulty:
        # The upper end lets the bucket fall below `full` after `FORGOTTEN` + 1 sound cycles.
        return min(bucket + FORGOTTEN, full + FORGOTTEN)
    return bucket - 1 if bucket else 0


def _counted(
    full: tuple[int, ...], counts: tuple[int, ...], faulty: int, held: int, cleared: int
) -> tuple[tuple[int, ...], int]:
    """Step all counts; return them, and the bits of the watchdogs whose counts are full."""
    stepped = []
    tripped = 0
    for (bit, watchdog, slowly), most, before in zip(_STEPS, full, counts, strict=True):
        count = 0 if cleared & bit else before
        if not held & bit:
            if slowly:
                count = leaked(count, most, bool(faulty & bit))
            else:
                count = count + 1 if faulty & bit else 0
        stepped.append(count)
        if count >= most:
            tripped |= watchdog
    return tuple(stepped), tripped


def _rested(
    counts: tuple[int, ...], rests_at: tuple[int, ...], rests: tuple[int, ...]
) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Return the value at which each sensor rests, and for how many samples in a row.

    Only samples in a row count: noise repeats single samples of a sound sensor.
    """
    now_at, now = list(rests_at), list(rests)
    for sensor, within in enumerate(_WITHIN):
        if -within <= counts[sensor] - now_at[sensor] <= within:
            now[sensor] += 1
        else:
            now_at[sensor] = counts[sensor]
            now[sensor] = 1
    return tuple(now_at), tuple(now)


def _at_once(plan: WatchPlan, seen: Seen, rests: tuple[int, ...]) -> int:
    """Return the faults without a count, and the fault of a stuck sensor."""
    measured = seen.measured
    serial = measured.serial
    faults = 0
    if serial != plan.serial or serial == _NO_PLATE:
        faults = _CALIBRATION
    if measured.si.temperature > plan.temperature_max:
        faults |= _HOT
    if rests[_THERMOMETER] >= STUCK_THERMOMETER_CYCLES or (
        max(rests[:_THERMOMETER]) >= STUCK_GAUGE_CYCLES
    ):
        faults |= _STUCK
    voltage, frequency = seen.asked
    # NaN is in no range.
    if not (0.0 <= voltage < inf and plan.f_min <= frequency <= plan.f_max):
        faults |= _CONTROLLER
    elif voltage > plan.V_max:
        faults |= _VOLTAGE
    if seen.mode not in (seen.left_in, _IDENTIFY):
        # An identification ends by itself, without a fault.
        faults |= _CONTROLLER
    return faults


def _undecided(vibration: Vibration, in_force: InForce, amplitude: float, mode: int) -> int:
    """Return the bits of the counts for which this cycle cannot be judged."""
    # Without a vibration there is no phase; while it decays at 0 V it turns at its own frequency.
    phased = amplitude > AMPLITUDE_MIN and in_force.drive.voltage > 0.0
    held = 0 if phased else _RESONANCE
    # With a wrong phase the loop hunts in frequency, so only open-loop steps of it are excused.
    turns = in_force.turning and mode == _OPEN_LOOP
    return held if vibration.least > _LOOKED_FOR and not turns else held | _LACKING


def _of_vibration(
    plan: WatchPlan, vibration: Vibration, W: complex, amplitude: float, mode: int
) -> int:
    """Compare the vibration that the pick-up reads with its limit and with the model."""
    faulty = _UNSEEN if abs(vibration.most) > plan.bound.limit * ROUNDING else 0
    if amplitude > plan.bound.trip:
        faulty |= _AMPLITUDE
    most = _EXCESS_UNIDENTIFIED if mode == _IDENTIFY else _EXCESS
    if amplitude > most * vibration.E + _EXCESS_OFFSET:
        faulty |= _EXCESSIVE
    # In a row: under a finger the end of each pulse decays faster than E.
    if vibration.E_least > _LOOKED_FOR and amplitude < _SILENCE * vibration.E_least:
        faulty |= _SILENT
    if amplitude < _LACK * vibration.least:
        faulty |= _LACKING
    if abs(W.imag) > W.real:
        faulty |= _RESONANCE
    return faulty


def _odd(plan: WatchPlan, gauges: Forces, zero: Forces, Fn: float, Ft: float) -> bool:
    """Return whether the gauges contradict each other."""
    _, _, o3, o4, o5, o6 = zero
    _, _, s3, s4, s5, s6 = gauges
    s3 -= o3
    s4 -= o4
    s5 -= o5
    s6 -= o6
    x3, x4, x5, x6 = plan.gauge_positions
    mismatch = plan.mismatch
    load = Fn if Fn > 0.0 else 0.0
    # On a rigid plate the sums over both diagonals are equal, wherever the finger is.
    return (
        abs(s3 - s4 - s5 + s6) > mismatch
        or abs(x3 * s3 + x4 * s4 + x5 * s5 + x6 * s6) > _PLATE_END * (load + mismatch)
        or Fn < -mismatch
        or Ft > _FRICTION_MAX * load + mismatch
    )

"""The closed loop of one finger, in plain functions: what a campaign runs, compiled or not.

It steps plate and controllers as the nodes do, without what a bench may change in between.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from smarttac_can.control.step import ControlPlan, ControlState, control_step
from smarttac_can.control.tribometer import Forces
from smarttac_can.plant.finger import Pass, Path, smooth, stroke_at
from smarttac_can.plant.motion import PlatePlan, PlateState, plate_step
from smarttac_can.vocabulary.signals import TICK, MeasurementFields, Setpoint

Floats = NDArray[np.float64]
Table = Floats | Sequence[Sequence[float]]
"""Rows of numbers: an array where it is compiled, lists where not, of which Python reads faster."""
LIFT_PERIOD, LIFT_LENGTH, LIFT_RAMP = 1.0, 0.1, 0.01
"""A finger that lifts does so each second, for 100 ms with a ramp of 10 ms at both ends."""


class Setup(NamedTuple):
    """Plate and finger of a run."""

    plan: PlatePlan
    path: Path
    passes: Table
    """A row for each pass, to the end of the run."""
    lifts: bool
    """Whether the finger lifts each second."""


class Asked(NamedTuple):
    """What is asked of the controllers."""

    mode: int
    setpoint: Setpoint


class Loop(NamedTuple):
    """The loop at a tick."""

    tick: int
    plate: PlateState
    measurement: MeasurementFields
    controls: ControlState


def lift(time: float) -> float:
    """Return the share of its force that a finger which lifts each second has at a time in s."""
    since = time % LIFT_PERIOD
    return max(1.0 - smooth(since / LIFT_RAMP), smooth((since - LIFT_LENGTH) / LIFT_RAMP))


def finger_at(
    path: Path, passes: Table, number: int, time: float, lifts: bool
) -> tuple[float, float]:
    """Return position in m and normal force in N at a time in s, in a pass of this number."""
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
    """Let a finger stroke while the controllers are in a mode.

    Parameters
    ----------
    setup
        Plate and finger.
    plan
        What is regulated by.
    loop
        Where the run goes on.
    asked
        Mode and set-point.
    noise
        A row of 9 for each tick, and for the one after the last.
    traces
        Filled, a row for each tick: true COF, measured COF, 1.0 right of the boundary.

    Returns
    -------
    loop, sums
        Where it has come to, and the sums of the samples of S1..S6 in N.
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
    """Return the number of the pass at a time in s, which is that of one before or a later one."""
    while number + 1 < len(passes) and time >= passes[number + 1][0]:
        number += 1
    return number

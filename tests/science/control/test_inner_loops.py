"""The inner loops, closed on a plate: resonance and amplitude, and their limits under every law."""

from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import pytest
from first_order_plate import GRATING, FirstOrderPlate, gauges, run, setpoint

from smarttac_can.science.control.cascade import Cascade
from smarttac_can.science.control.design import Gains, row_of
from smarttac_can.science.control.parameters import CascadeParameters
from smarttac_can.science.control.step import (
    _regulated,
    adopted,
    at_rest,
    control_plan,
    control_step,
)
from smarttac_can.science.control.texture import texture_of
from smarttac_can.science.control.vibration import Limit
from smarttac_can.vocabulary.model import PlateModel
from smarttac_can.vocabulary.signals import Drive
from smarttac_can.vocabulary.states import Mode, VibrationLaw

LAWS = list(VibrationLaw)


class Tick(NamedTuple):
    """Vibration before the drive of a tick, that drive, and the limits that were active."""

    W: complex
    drive: Drive
    limited: int


def started(mode, target, dead_time=0.0):
    """Return the first ticks of a mode, from rest, with the loops of the paper."""
    plate = FirstOrderPlate(dead_time=dead_time)
    cascade = Cascade(CascadeParameters(dead_time=dead_time))
    cascade.set_mode(mode)
    ticks = []
    for _ in range(61):
        W = plate.W
        (drive,) = run(cascade, plate, target, 1)
        ticks.append(Tick(W, drive, cascade.limited))
    return ticks


def test_amplitude_is_right_when_detuned():
    last = started(Mode.AMPLITUDE, setpoint(frequency=43250.0))[-1]
    assert abs(last.W) == pytest.approx(1e-6, rel=1e-3)
    assert last.drive.frequency == 43250.0


@pytest.mark.parametrize("detuning", [-300.0, -140.0, 0.0, 140.0, 300.0])
@pytest.mark.parametrize("dead_time", [0.0, 0.5e-3])
def test_resonance_is_found_from_either_side(detuning, dead_time):
    target = setpoint(frequency=43390.0 + detuning)
    ticks = started(Mode.AMPLITUDE_RESONANCE, target, dead_time)
    assert ticks[-1].drive.frequency == pytest.approx(43390.0, abs=0.05)
    assert abs(ticks[-1].W) == pytest.approx(1e-6, rel=1e-3)
    assert max(abs(tick.W) for tick in ticks) < 1.25e-6


class Loops:
    """The inner loops of a stimulator in a mode, from a frequency in Hz."""

    def __init__(self, mode=Mode.AMPLITUDE_RESONANCE, frequency=43300.0, **parameters):
        limits = {"V_max": 30.0, "f_min": 43000.0, "f_max": 43800.0} | parameters
        self.plan = control_plan(CascadeParameters(**limits), PlateModel())
        self.state = at_rest(self.plan)
        self.mode, self.frequency, self.limited = mode, frequency, 0

    def step(self, W, W_ref=1e-6):
        measurement = (W, (0.0,) * 6, 20.0, 0)
        target = setpoint(amplitude=W_ref, frequency=self.frequency)
        self.state, controlled = control_step(self.plan, self.state, self.mode, measurement, target)
        self.limited = controlled.limited
        return self.state.drive

    def limit(self, **limits):
        before = self.plan
        self.plan = before._replace(**limits)
        self.state = adopted(before, self.plan, self.state)


@pytest.mark.parametrize("W", [0.06e-6 + 0.06e-6j, -1e-6 + 1e-6j, 1e-6j, 0j])
def test_frequency_is_held_without_a_usable_phase(W):
    loops = Loops()
    before = loops.step(1e-6 + 1e-8j).frequency
    for _ in range(3):
        assert loops.step(W).frequency == before
    # And it goes on from there.
    assert loops.step(1e-6 + 0j).frequency == before


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_runaway_tangent_is_bounded(side):
    steep = Loops(frequency=43400.0).step(complex(1e-9, side * 1e-6)).frequency
    bound = Loops(frequency=43400.0).step(complex(0.5e-6, side * 1e-6)).frequency
    assert steep == bound
    assert 0.0 < side * (steep - 43400.0) < 399.0


def test_frequency_limits():
    loops = Loops()
    for _ in range(10):
        drive = loops.step(1e-6 + 1e-6j)
    assert drive.frequency == 43800.0
    assert loops.limited & Limit.FREQUENCY
    assert loops.step(1e-6 - 1e-7j).frequency < 43800.0


@pytest.mark.parametrize(("asked", "given"), [(1e3, 43000.0), (1e5, 43800.0), (43210.0, 43210.0)])
def test_a_mode_begins_within_the_limits(asked, given):
    loops = Loops(frequency=asked)
    assert loops.step(0j).frequency == given


@pytest.mark.parametrize(
    ("limits", "held", "limited"),
    [
        ((43000.0, 43800.0), 43390.0, 0),
        ((43500.0, 43800.0), 43500.0, Limit.FREQUENCY),
        ((43000.0, 43200.0), 43200.0, Limit.FREQUENCY),
    ],
)
def test_a_held_frequency_is_cut_to_new_limits(limits, held, limited):
    loops = Loops(frequency=43390.0)
    loops.step(0j)
    loops.limit(f_min=limits[0], f_max=limits[1])
    assert loops.step(0j).frequency == held
    assert loops.limited & Limit.FREQUENCY == limited


@pytest.mark.parametrize("dead_time", [0.0, 0.1e-3])
@pytest.mark.parametrize("frequency", [42700.0, 42790.0, 42900.0, 43990.0, 44000.0])
def test_largest_step_off_resonance_overshoots_below_9_percent(frequency, dead_time):
    target = setpoint(frequency=frequency, amplitude=3e-6)
    ticks = started(Mode.AMPLITUDE_RESONANCE, target, dead_time)
    assert max(max(abs(tick.W.real), abs(tick.W.imag)) for tick in ticks) < 3.27e-6
    assert abs(ticks[-1].W) == pytest.approx(3e-6, rel=1e-3)
    lowered = [bool(tick.limited & Limit.AMPLITUDE) for tick in ticks]
    assert any(lowered[:10])
    assert not any(lowered[20:])


def driven(law, mode):
    """Return a cascade at 1 um with 20 V, its plate and its parameters."""
    parameters = CascadeParameters(
        vibration_law=law, V_max=40.0, W_max=2e-6, f_min=43_000.0, f_max=43_800.0
    )
    cascade, plate = Cascade(parameters), FirstOrderPlate()
    cascade.set_mode(mode)
    run(cascade, plate, setpoint(), 50)
    assert cascade.drive.voltage == pytest.approx(20.0, abs=0.1)
    assert cascade.limited == 0
    return cascade, plate, parameters


@pytest.mark.parametrize(("asked", "cut"), [(43_900.0, 43_800.0), (42_900.0, 43_000.0)])
@pytest.mark.parametrize("law", LAWS)
def test_a_frequency_beyond_the_limits_is_cut_and_told(law, asked, cut):
    cascade, plate, _ = driven(law, Mode.AMPLITUDE)
    run(cascade, plate, setpoint(frequency=asked), 100)  # 5 Hz a tick
    assert cascade.mode is Mode.AMPLITUDE
    assert cascade.drive.frequency == cut
    assert cascade.limited & Limit.FREQUENCY
    run(cascade, plate, setpoint(frequency=cut), 1)
    assert not cascade.limited & Limit.FREQUENCY


@pytest.mark.parametrize("law", LAWS)
def test_narrowing_limits_hold_at_once_without_windup(law):
    cascade, plate, parameters = driven(law, Mode.AMPLITUDE_RESONANCE)
    cascade.configure(replace(parameters, V_max=10.0, f_max=43_300.0))
    run(cascade, plate, setpoint(), 1)
    assert cascade.mode is Mode.AMPLITUDE_RESONANCE
    assert 0.0 < cascade.drive.voltage <= 10.0
    assert cascade.drive.frequency == 43_300.0
    run(cascade, plate, setpoint(), 20)
    assert cascade.drive == (10.0, 43_300.0)
    assert cascade.limited == Limit.VOLTAGE | Limit.FREQUENCY
    # And they are left at once.
    run(cascade, plate, setpoint(amplitude=0.2e-6), 1)
    assert cascade.drive.voltage < 10.0


@pytest.mark.parametrize("law", LAWS)
def test_a_voltage_that_would_be_negative_is_told(law):
    cascade, plate, _ = driven(law, Mode.AMPLITUDE)
    run(cascade, plate, setpoint(amplitude=0.1e-6), 1)
    assert cascade.drive.voltage == 0.0
    assert cascade.limited == Limit.VOLTAGE


@pytest.mark.parametrize("law", [VibrationLaw.PI, VibrationLaw.SCHEDULED])
def test_texture_mode_of_pi_schedules_amplitude_not_resonance(law):
    """A change of ``|W|`` in a tick moves the voltage by the gain of C_W, and W_q the frequency."""

    def moved(mode):
        cascade, plate = Cascade(CascadeParameters(vibration_law=law)), FirstOrderPlate()
        cascade.play(texture_of(GRATING))
        cascade.set_mode(mode)
        run(cascade, plate, setpoint(), 30, lambda W: gauges(0.3, 0.0, 1.0))
        plan, state = cascade.plan, cascade.state
        loops = [
            _regulated(plan, state, (W, abs(W), 1.0), 1e-6, 0.0)[0]
            for W in (1e-6 + 0j, 0.99e-6 + 1e-9j)
        ]
        return loops[1].voltage - loops[0].voltage, loops[1].frequency - loops[0].frequency

    friction, texture = moved(Mode.FRICTION), moved(Mode.TEXTURE)
    if law is VibrationLaw.PI:
        assert texture[0] > 1.5 * friction[0]
        assert texture[1] == pytest.approx(friction[1])
    else:
        assert texture == pytest.approx(friction)


@pytest.mark.parametrize("Fn", [0.0, 0.3, 1.0, 2.9])
def test_scheduled_loops_equal_a_bare_plate_of_that_force(Fn):
    cascade, _, _ = driven(VibrationLaw.SCHEDULED, Mode.AMPLITUDE_RESONANCE)
    plan, state = cascade.plan, cascade.state
    row = plan.rows[row_of(Fn, len(plan.rows))]
    other = plan._replace(vibration_law=int(VibrationLaw.PI), bare=Gains(*row))
    seen = (0.9e-6 + 0.1e-6j, abs(0.9e-6 + 0.1e-6j), Fn)
    assert _regulated(plan, state, seen, 1e-6, 0.0) == _regulated(other, state, seen, 1e-6, 0.0)


@pytest.mark.parametrize(("Fn", "damped"), [(0.5, 2.0), (1.0, 1.0 + 2.0 ** (2 / 3))])
def test_under_a_finger_the_error_shrinks_to_the_pole_each_tick(Fn, damped):
    loaded = PlateModel(gain=50e-9 / damped, tau=0.944e-3 / damped)
    cascade = Cascade(CascadeParameters(vibration_law=VibrationLaw.SCHEDULED), PlateModel(load=1.0))
    plate = FirstOrderPlate(loaded)
    cascade.set_mode(Mode.AMPLITUDE_RESONANCE)
    run(cascade, plate, setpoint(), 50, lambda W: gauges(Fn=Fn))
    errors = []
    for _ in range(3):
        errors.append(1.5e-6 - abs(plate.W))
        run(cascade, plate, setpoint(amplitude=1.5e-6), 1, lambda W: gauges(Fn=Fn))
    for before, after in pairwise(errors):
        assert after / before == pytest.approx(0.2, abs=0.01)

import cmath
import math

import numpy as np
import pytest
from first_order_plate import FirstOrderPlate
from hypothesis import example, given, settings
from hypothesis import strategies as st

from smarttac_can.science.control.design import (
    FORCE_STEP,
    amplitude_inverse,
    amplitude_pi,
    designed,
    dominant_pole,
    resonance_pi,
    row_of,
)
from smarttac_can.science.control.vibration import regulated
from smarttac_can.vocabulary.model import PlateModel, contact_load
from smarttac_can.vocabulary.signals import Drive

TICK = 1e-3


def impulse_response(model, dead_time):
    """a, b0, b1 of the sampled plant, from the simulated plate instead of the formula."""
    plate = FirstOrderPlate(model, dead_time)
    samples = []
    for voltage in (1.0, 0.0, 0.0):
        plate.step(Drive(voltage, model.f0))
        samples.append(plate.W.real)
    # h = b0, b1 + a b0, a (b1 + a b0)
    a = samples[2] / samples[1]
    return a, samples[0], samples[1] - a * samples[0]


@given(tau=st.floats(0.3e-3, 3e-3), dead_time=st.floats(0.0, 0.999e-3), pole=st.floats(0.02, 0.95))
@settings(max_examples=60)
@example(tau=1e-3, dead_time=0.0, pole=0.0)
@example(tau=1e-3, dead_time=0.0, pole=0.2)
@example(tau=1e-3, dead_time=1e-12, pole=0.2)
def test_closed_loop_pole_is_as_designed_or_the_fastest_possible(tau, dead_time, pole):
    model = PlateModel(gain=30e-9, tau=tau)
    a, b0, b1 = impulse_response(model, dead_time)
    pi = amplitude_pi(model, pole, dead_time)
    assert pi.a == pytest.approx(a, rel=1e-9)
    roots = np.roots([1.0, pi.Kp * b0 - 1.0, pi.Kp * b1])
    reached = dominant_pole(tau, pole, dead_time)
    # The tolerance is that of a double root.
    assert max(abs(roots)) == pytest.approx(reached, abs=1e-6)
    assert np.allclose(roots.imag, 0.0, atol=1e-6)
    assert reached >= pole
    assert reached == pole or dead_time > 0.0, "without dead time every pole is reached"


def test_dead_time_near_a_tick_allows_a_double_pole_of_0_5():
    assert dominant_pole(1e-3, 0.1, 0.9999e-3) == pytest.approx(0.5, abs=1e-3)


def test_resonance_controller_is_for_the_gain_of_minus_tau():
    model = PlateModel()
    pi = resonance_pi(model, 0.2)
    assert pi.Kp * (-2.0 * math.pi * model.tau) == pytest.approx(
        amplitude_pi(model, 0.2).Kp * model.gain
    )


@given(Fn=st.floats(-1.0, 3.0), load=st.floats(0.0, 2.0))
@settings(max_examples=60)
@example(Fn=3.0, load=0.87)
@example(Fn=0.0, load=0.87)
def test_the_row_of_a_force_is_the_design_of_the_plate_under_it(Fn, load):
    """To within half a step of the table: a finger adds damping, and kappa stays."""
    model = PlateModel(load=load)
    bare, rows = designed(model, 0.2, 0.3, 0.2e-3)
    row = rows[row_of(Fn, len(rows))]
    for make, Kp, pole in ((amplitude_pi, row.amplitude, 0.2), (resonance_pi, row.resonance, 0.3)):
        light, heavy = (
            make(under(model, max(Fn + side * FORCE_STEP, 0.0)), pole, 0.2e-3)
            for side in (-0.501, 0.501)
        )
        assert abs(light.Kp) * (1.0 - 1e-9) <= abs(Kp) <= abs(heavy.Kp) * (1.0 + 1e-9)
        assert heavy.a * (1.0 - 1e-9) <= row.a <= light.a * (1.0 + 1e-9)
    if Fn <= 0.0:
        assert row == pytest.approx(bare)


def under(model, Fn):
    """The bare plate that moves as this one does under a force."""
    tau = 1.0 / model.decay_rate(contact_load(Fn))
    return PlateModel(model.gain * tau / model.tau, tau, model.f0)


def test_a_heavy_finger_on_any_plate_has_a_design():
    _, rows = designed(PlateModel(gain=1e-9, tau=2e-4, load=5.0), 0.2, 0.3, 999e-6)
    assert math.isfinite(rows[row_of(3.0, len(rows))].amplitude)


def test_the_table_of_forces_ends_at_3_N():
    _, rows = designed(PlateModel(), 0.2, 0.3, 0.0)
    assert row_of(3.0, len(rows)) == row_of(1e9, len(rows)) == len(rows) - 1
    assert row_of(3.0 - FORCE_STEP, len(rows)) == len(rows) - 2


@pytest.mark.parametrize("dead_time", [0.0, 0.3e-3, 0.7e-3])
def test_step_does_not_overshoot(dead_time):
    model = PlateModel()
    plate = FirstOrderPlate(model, dead_time)
    pi, state = amplitude_pi(model, 0.1, dead_time), 0.0
    for _ in range(100):
        error = 1e-6 - abs(plate.W)
        assert error > -1e-14
        voltage, state, _ = regulated(state, pi.Kp, pi.a, error, -1e9, 1e9)
        plate.step(Drive(voltage, model.f0))
    assert abs(plate.W) == pytest.approx(1e-6)


@pytest.mark.parametrize("pole", [-0.01, 0.951, math.nan])
def test_pole_out_of_range(pole):
    with pytest.raises(ValueError, match=r"^pole .* is outside 0\.\.0\.95$"):
        amplitude_pi(PlateModel(), pole)


@pytest.mark.parametrize("dead_time", [-1e-6, 1e-3, math.nan])
def test_dead_time_out_of_range(dead_time):
    with pytest.raises(ValueError, match=r"^dead_time .* is outside 0\.\.0\.001, the end excl"):
        resonance_pi(PlateModel(), 0.3, dead_time)


@pytest.mark.parametrize("dead_time", [0.0, 250e-6, 540e-6, 900e-6])
def test_inverse_leaves_a_mean_of_two_ticks_of_the_loop(dead_time):
    model = PlateModel()
    inverse = amplitude_inverse(model, 0.2, dead_time)
    tau = 1.0 / model.decay_rate(contact_load(1.0))
    loaded = PlateModel(gain=model.gain * tau / model.tau, tau=tau)
    a, b0, b1 = impulse_response(loaded, dead_time)
    b0, b1 = b0 / loaded.gain, b1 / loaded.gain
    Kp = amplitude_pi(loaded, 0.2, dead_time).Kp * loaded.gain
    z = cmath.exp(2j * math.pi * 100.0 * TICK)
    open_loop = Kp * (z - a) / (z - 1.0) * (b0 * z + b1) / (z * (z - a))
    closed = open_loop / (1.0 + open_loop)
    undone = closed * (inverse.new + inverse.last / z + inverse.older / z**2)
    assert undone == pytest.approx((b0 + b1 / z) / (b0 + b1) / z, abs=1e-6)
    assert inverse.late == pytest.approx(TICK * b1 / (b0 + b1))
    if dead_time == 540e-6:
        assert (abs(closed), abs(undone)) == pytest.approx((0.747, 0.963), abs=2e-3)

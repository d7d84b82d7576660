"""The limits of the inner loops, under every law of the vibration."""

from dataclasses import replace

import pytest
from first_order_plate import FirstOrderPlate, gauges, run, setpoint

from smarttac_can.control.cascade import Cascade
from smarttac_can.control.design import Gains, row_of
from smarttac_can.control.parameters import CascadeParameters
from smarttac_can.control.step import _regulated
from smarttac_can.control.texture import texture_of
from smarttac_can.control.vibration import Limit
from smarttac_can.vocabulary.states import Mode, VibrationLaw
from smarttac_can.vocabulary.textures import Axis, TextureTable

LAWS = list(VibrationLaw)


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
def test_limits_that_close_in_hold_at_once_and_end_nothing(law):
    cascade, plate, parameters = driven(law, Mode.AMPLITUDE_RESONANCE)
    cascade.configure(replace(parameters, V_max=10.0, f_max=43_300.0))
    run(cascade, plate, setpoint(), 1)
    assert cascade.mode is Mode.AMPLITUDE_RESONANCE
    assert 0.0 < cascade.drive.voltage <= 10.0
    assert cascade.drive.frequency == 43_300.0
    run(cascade, plate, setpoint(), 20)
    assert cascade.drive == (10.0, 43_300.0)
    assert cascade.limited == Limit.VOLTAGE | Limit.FREQUENCY


@pytest.mark.parametrize("law", LAWS)
def test_a_voltage_that_would_be_negative_is_told(law):
    cascade, plate, _ = driven(law, Mode.AMPLITUDE)
    run(cascade, plate, setpoint(amplitude=0.1e-6), 1)
    assert cascade.drive.voltage == 0.0
    assert cascade.limited == Limit.VOLTAGE


@pytest.mark.parametrize("law", [VibrationLaw.PI, VibrationLaw.SCHEDULED])
def test_in_mode_texture_the_amplitude_of_pi_follows_the_finger_and_the_resonance_does_not(law):
    """A change of ``|W|`` in a tick moves the voltage by the gain of C_W, and W_q the frequency."""

    def moved(mode):
        cascade, plate = Cascade(CascadeParameters(vibration_law=law)), FirstOrderPlate()
        cascade.play(texture_of(TextureTable(Axis.POSITION, True, 0, 1_000_000, (3000, 4000))))
        cascade.set_mode(mode)
        for _ in range(30):
            plate.step(cascade.update(plate.measure(gauges(0.3, 0.0, 1.0)), setpoint()))
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
def test_scheduled_loops_are_those_of_a_bare_plate_with_the_design_of_the_force(Fn):
    cascade, _, _ = driven(VibrationLaw.SCHEDULED, Mode.AMPLITUDE_RESONANCE)
    plan, state = cascade.plan, cascade.state
    row = plan.rows[row_of(Fn, len(plan.rows))]
    other = plan._replace(vibration_law=int(VibrationLaw.PI), bare=Gains(*row))
    seen = (0.9e-6 + 0.1e-6j, abs(0.9e-6 + 0.1e-6j), Fn)
    assert _regulated(plan, state, seen, 1e-6, 0.0) == _regulated(other, state, seen, 1e-6, 0.0)

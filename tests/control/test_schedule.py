import math

import pytest
from first_order_plate import FirstOrderPlate, gauges, setpoint

from smarttac_can.control.cascade import Cascade
from smarttac_can.control.design import designed, row_of
from smarttac_can.control.parameters import CascadeParameters
from smarttac_can.vocabulary.model import PlateModel
from smarttac_can.vocabulary.states import Mode, VibrationLaw

MODEL = PlateModel(gain=50e-9, tau=0.944e-3, f0=43390.0, load=1.0)


def tuned(Fn, dead_time=0.0, model=MODEL):
    _, rows = designed(model, 0.2, 0.3, dead_time)
    return rows[row_of(Fn, len(rows))]


def test_neighbouring_forces_share_a_design_and_any_force_has_one():
    assert tuned(0.50) == tuned(0.52) != tuned(0.56)
    assert tuned(1e9) == tuned(3.0)
    heavy = PlateModel(gain=1e-9, tau=2e-4, f0=43390.0, load=5.0)
    assert math.isfinite(tuned(3.0, 999e-6, heavy).amplitude)


@pytest.mark.parametrize(("Fn", "damped"), [(0.5, 2.0), (1.0, 1.0 + 2.0 ** (2 / 3))])
def test_under_a_finger_the_error_shrinks_to_the_pole_each_tick(Fn, damped):
    loaded = PlateModel(gain=50e-9 / damped, tau=0.944e-3 / damped)
    cascade = Cascade(CascadeParameters(vibration_law=VibrationLaw.SCHEDULED), MODEL)
    plate = FirstOrderPlate(loaded)
    cascade.set_mode(Mode.AMPLITUDE_RESONANCE)
    errors = []
    for tick in range(60):
        W_ref = 1e-6 if tick < 50 else 1.5e-6
        drive = cascade.update(plate.measure(gauges(Fn=Fn)), setpoint(amplitude=W_ref))
        errors.append(W_ref - abs(plate.W))
        plate.step(drive)
    assert errors[51] / errors[50] == pytest.approx(0.2, abs=0.01)
    assert errors[52] / errors[51] == pytest.approx(0.2, abs=0.01)

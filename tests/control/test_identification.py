import random

import pytest
from first_order_plate import FirstOrderPlate, gauges, setpoint

from smarttac_can.control.cascade import Cascade
from smarttac_can.control.parameters import CascadeParameters
from smarttac_can.vocabulary.model import PlateModel
from smarttac_can.vocabulary.states import IdentificationState, Mode

NULLS = (0.7, -1.1, 0.3, -0.2, 1.2, -0.9)


def identify(plate, start, cascade=None, forces=(0.0,) * 6):
    """Run the mode to its end; return the cascade, the ticks and the largest amplitude in m.

    The data sheet is that of the plate.
    """
    sheet = CascadeParameters(sheet_gain=plate.model.gain, sheet_tau=plate.model.tau)
    cascade = Cascade(sheet) if cascade is None else cascade
    cascade.set_mode(Mode.IDENTIFY)
    target = setpoint(frequency=start)
    ticks, largest, progress = 0, 0.0, 0.0
    while True:
        drive = cascade.update(plate.measure(forces), target)
        if cascade.mode is not Mode.IDENTIFY:
            break
        assert cascade.identification.state is IdentificationState.RUNNING
        assert progress <= cascade.identification.progress < 1.0
        progress = cascade.identification.progress
        plate.step(drive)
        largest = max(largest, abs(plate.W))
        ticks += 1
    assert drive.voltage == 0.0
    assert cascade.mode is Mode.OFF
    assert cascade.identification.progress == 1.0
    return cascade, ticks, largest


def drawn_plate(seed):
    draw = random.Random(seed)
    model = PlateModel(
        gain=draw.uniform(10e-9, 200e-9),
        tau=draw.uniform(0.5e-3, 2e-3),
        f0=43390.0 + draw.uniform(-100.0, 100.0),
    )
    offset = complex(draw.gauss(0.0, 5e-9), draw.gauss(0.0, 5e-9))
    plate = FirstOrderPlate(model, noise=1e-9, offset=offset, seed=seed)
    return plate, model.f0 + draw.uniform(-300.0, 300.0)


@pytest.mark.parametrize("seed", range(12))
def test_accuracy_with_noise_quantisation_offset_and_a_wrong_start(seed):
    plate, start = drawn_plate(seed)
    cascade, ticks, largest = identify(plate, start)
    assert cascade.identification.state is IdentificationState.DONE, cascade.reason
    assert cascade.reason == ""
    true, found = plate.model, cascade.model
    assert found.f0 == pytest.approx(true.f0, abs=1.0)
    assert found.tau == pytest.approx(true.tau, rel=0.02)
    assert found.gain == pytest.approx(true.gain, rel=0.01)
    assert ticks < 1500
    assert largest < 1e-6


@pytest.mark.parametrize("start", [43090.0, 43690.0])
@pytest.mark.parametrize("dead_time", [0.0, 0.9e-3])
def test_dead_time_does_not_disturb(start, dead_time):
    plate = FirstOrderPlate(noise=1e-9, dead_time=dead_time)
    cascade, _, _ = identify(plate, start)
    assert cascade.model.f0 == pytest.approx(43390.0, abs=1.0)
    assert cascade.model.tau == pytest.approx(plate.model.tau, rel=0.02)
    assert cascade.model.gain == pytest.approx(plate.model.gain, rel=0.01)


def test_residual_vibration_of_the_mode_before_does_not_disturb():
    plate = FirstOrderPlate(PlateModel(tau=2e-3), noise=1e-9)
    plate.W = 4e-6j
    cascade, _, _ = identify(plate, 43390.0)
    assert cascade.model.tau == pytest.approx(2e-3, rel=0.02)


def failure(plate, start=43390.0, **kwargs):
    cascade, _, _ = identify(plate, start, **kwargs)
    assert cascade.identification.state is IdentificationState.FAILED
    assert cascade.model == PlateModel()
    assert cascade.reason == f"identification: {cascade.identification.failure}"
    return cascade.identification.failure


def test_dead_plate():
    class Dead(FirstOrderPlate):
        def step(self, drive):
            pass

    assert failure(Dead(noise=1e-9)) == "no vibration of 0.15 um at 150 V"


def test_plate_without_lag():
    class Stiff(FirstOrderPlate):
        def step(self, drive):
            self.W = complex(drive.voltage * 50e-9)

    assert failure(Stiff()).startswith("the response to a step is no decay: ")
    assert failure(Stiff(noise=1e-9))


def test_plate_that_changes_under_the_sweep():
    class Changing(FirstOrderPlate):
        ticks = 0

        def step(self, drive):
            self.ticks += 1
            if self.ticks == 450:
                self.model = PlateModel(gain=35e-9, tau=0.7e-3)
            super().step(drive)

    assert failure(Changing(noise=1e-9)).endswith("% off a resonance")


def test_finger_on_the_plate():
    cascade = Cascade()
    for _ in range(64):
        cascade.update(FirstOrderPlate().measure(NULLS), setpoint())
    cascade.zero = cascade.null()
    loaded = tuple(n + s for n, s in zip(NULLS, gauges(Fn=0.5), strict=True))
    reason = failure(FirstOrderPlate(), cascade=cascade, forces=loaded)
    assert reason == "the plate is loaded with 0.50 N"


@pytest.mark.parametrize(("Fn", "remark"), [(0.015, ""), (0.025, "25"), (0.08, "80")])
def test_a_finger_too_light_for_a_contact_is_remarked(Fn, remark):
    cascade = Cascade()
    for _ in range(64):
        cascade.update(FirstOrderPlate().measure(NULLS), setpoint())
    cascade.zero = cascade.null()
    loaded = tuple(n + s for n, s in zip(NULLS, gauges(Fn=Fn), strict=True))
    identify(FirstOrderPlate(), 43390.0, cascade=cascade, forces=loaded)
    assert cascade.identification.state is IdentificationState.DONE
    more = (
        f"the gauges read {remark} mN more than at the tare: if something touched the plate, "
        "lift it and repeat; otherwise tare"
    )
    assert cascade.reason == (more if remark else "")


def test_nulls_of_an_untared_tribometer_do_not_count_as_a_finger():
    cascade, _, _ = identify(FirstOrderPlate(), 43390.0, forces=NULLS)
    assert cascade.identification.state is IdentificationState.DONE
    assert cascade.reason == ""

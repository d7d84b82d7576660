import pytest
from first_order_plate import FirstOrderPlate, setpoint

from smarttac_can.control.cascade import Cascade
from smarttac_can.control.parameters import CascadeParameters
from smarttac_can.control.step import adopted, at_rest, control_plan, control_step
from smarttac_can.control.vibration import Limit
from smarttac_can.vocabulary.model import PlateModel
from smarttac_can.vocabulary.states import Mode


def response(mode, ticks=60, frequency=43250.0, dead_time=0.0):
    """The experiment of Fig. 5: amplitudes in m and drives, from rest to 1 um."""
    plate = FirstOrderPlate(dead_time=dead_time)
    cascade = Cascade(CascadeParameters(dead_time=dead_time))
    cascade.set_mode(mode)
    target = setpoint(frequency=frequency)
    amplitudes, drives = [], []
    for _ in range(ticks):
        amplitudes.append(abs(plate.W))
        drives.append(cascade.update(plate.measure(), target))
        plate.step(drives[-1])
    return amplitudes, drives


def settling_time(amplitudes, target=1e-6, band=0.05):
    """When the amplitude enters the band for good, in ms, interpolated between the samples."""
    k = max(i for i, W in enumerate(amplitudes) if abs(W - target) > band * target)
    outside, inside = amplitudes[k], amplitudes[k + 1]
    edge = target * (1.0 - band if outside < target else 1.0 + band)
    return k + (edge - outside) / (inside - outside)


def test_response_time_of_both_loops():
    assert settling_time(response(Mode.AMPLITUDE_RESONANCE)[0]) == pytest.approx(2.0, abs=0.6)


def test_response_time_of_the_amplitude_loop_alone():
    assert settling_time(response(Mode.AMPLITUDE)[0]) == pytest.approx(5.0, abs=1.0)


def test_thirty_percent_more_voltage_without_the_resonance_loop():
    _, alone = response(Mode.AMPLITUDE)
    _, both = response(Mode.AMPLITUDE_RESONANCE)
    assert alone[-1].frequency == 43250.0
    assert both[-1].frequency == pytest.approx(43390.0, abs=0.01)
    assert alone[-1].voltage / both[-1].voltage == pytest.approx(1.30, abs=0.005)


def test_amplitude_is_right_when_detuned():
    amplitudes, _ = response(Mode.AMPLITUDE)
    assert amplitudes[-1] == pytest.approx(1e-6, rel=1e-3)


@pytest.mark.parametrize("detuning", [-300.0, -140.0, 0.0, 140.0, 300.0])
@pytest.mark.parametrize("dead_time", [0.0, 0.5e-3])
def test_resonance_is_found_from_either_side(detuning, dead_time):
    amplitudes, drives = response(
        Mode.AMPLITUDE_RESONANCE, frequency=43390.0 + detuning, dead_time=dead_time
    )
    assert drives[-1].frequency == pytest.approx(43390.0, abs=0.05)
    assert amplitudes[-1] == pytest.approx(1e-6, rel=1e-3)
    assert max(amplitudes) < 1.25e-6


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


def test_voltage_limit_leaves_no_windup():
    plate, loops = FirstOrderPlate(), Loops(Mode.AMPLITUDE, 43390.0)
    for _ in range(500):
        drive = loops.step(plate.W, 3e-6)
        plate.step(drive)
    assert drive.voltage == 30.0
    assert loops.limited == Limit.VOLTAGE
    assert loops.step(plate.W, 1e-6).voltage < 30.0


@pytest.mark.parametrize("W", [0.06e-6 + 0.06e-6j, -1e-6 + 1e-6j, 1e-6j, 0j])
def test_frequency_is_held_without_a_usable_phase(W):
    loops = Loops()
    before = loops.step(1e-6 + 1e-8j).frequency
    for _ in range(3):
        assert loops.step(W).frequency == before
    # And it goes on from there.
    assert loops.step(1e-6 + 0j).frequency == before


def test_frequency_rises_while_the_vibration_leads():
    assert Loops().step(1e-6 + 0.1e-6j).frequency > 43300.0
    assert Loops().step(1e-6 - 0.1e-6j).frequency < 43300.0


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
def test_a_start_at_the_largest_amplitude_off_resonance_overshoots_by_less_than_9_percent(
    frequency: float, dead_time: float
) -> None:
    plate = FirstOrderPlate(dead_time=dead_time)
    cascade = Cascade(CascadeParameters(dead_time=dead_time))
    cascade.set_mode(Mode.AMPLITUDE_RESONANCE)
    target = setpoint(frequency=frequency, amplitude=3e-6)
    readings, limited = [], []
    for _ in range(60):
        readings.append(max(abs(plate.W.real), abs(plate.W.imag)))
        plate.step(cascade.update(plate.measure(), target))
        limited.append(bool(cascade.limited & Limit.AMPLITUDE))
    assert max(readings) < 3.27e-6
    assert abs(plate.W) == pytest.approx(3e-6, rel=1e-3)
    assert any(limited[:10])
    assert not any(limited[20:])

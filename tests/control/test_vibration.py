import pytest
from first_order_plate import FirstOrderPlate, setpoint

from smarttac_can.control.cascade import Cascade
from smarttac_can.control.design import amplitude_pi, resonance_pi
from smarttac_can.control.limit import Limit
from smarttac_can.control.parameters import CascadeParameters
from smarttac_can.control.pi import PI
from smarttac_can.control.vibration import AmplitudeLoop, ResonanceLoop
from smarttac_can.vocabulary.model import PlateModel
from smarttac_can.vocabulary.modes import Mode
from smarttac_can.vocabulary.signals import Drive


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


def amplitude_loop(V_max=30.0):
    return AmplitudeLoop(amplitude_pi(PlateModel(), 0.2), V_max)


def test_voltage_limit_leaves_no_windup():
    plate, loop = FirstOrderPlate(), amplitude_loop()
    for _ in range(500):
        voltage = loop.step(3e-6, abs(plate.W))
        plate.step(Drive(voltage, 43390.0))
    assert voltage == 30.0
    assert loop.limited
    assert loop.step(1e-6, abs(plate.W)) < 30.0


def test_voltage_is_never_negative():
    loop = amplitude_loop()
    assert loop.step(0.0, 1e-6) == 0.0
    assert loop.limited


def resonance_loop(frequency=43300.0):
    loop = ResonanceLoop(resonance_pi(PlateModel(), 0.3), 43000.0, 43800.0)
    loop.preset(frequency)
    return loop


@pytest.mark.parametrize("W", [0.06e-6 + 0.06e-6j, -1e-6 + 1e-6j, 1e-6j, 0j])
def test_frequency_is_held_without_a_usable_phase(W):
    loop = resonance_loop()
    loop.step(1e-6 + 1e-8j, 1e-6)
    before = loop.frequency
    for _ in range(3):
        assert loop.step(W, abs(W)) == before
    # And it goes on from there.
    assert loop.step(1e-6 + 0j, 1e-6) == before


def test_frequency_rises_while_the_vibration_leads():
    assert resonance_loop().step(1e-6 + 0.1e-6j, 1e-6) > 43300.0
    assert resonance_loop().step(1e-6 - 0.1e-6j, 1e-6) < 43300.0


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_runaway_tangent_is_bounded(side):
    steep = resonance_loop(43400.0).step(complex(1e-9, side * 1e-6), 1e-6)
    bound = resonance_loop(43400.0).step(complex(0.5e-6, side * 1e-6), 1.12e-6)
    assert steep == bound
    assert 0.0 < side * (steep - 43400.0) < 399.0


def test_frequency_limits():
    loop = ResonanceLoop(PI(-1e4, 0.5), 43000.0, 43800.0)
    loop.preset(43300.0)
    for _ in range(10):
        assert loop.step(1e-6 + 1e-6j, 1.4e-6) == 43800.0
        assert loop.limited
    assert loop.step(1e-6 - 1e-7j, 1e-6) < 43800.0


@pytest.mark.parametrize(("asked", "given"), [(1e3, 43000.0), (1e5, 43800.0), (43210.0, 43210.0)])
def test_preset_keeps_the_limits(asked, given):
    loop = resonance_loop(asked)
    assert loop.frequency == given
    assert loop.limited == (asked != given)


@pytest.mark.parametrize(
    ("limits", "held", "limited"),
    [
        ((43000.0, 43800.0), 43390.0, False),
        ((43500.0, 43800.0), 43500.0, True),
        ((43000.0, 43200.0), 43200.0, True),
    ],
)
def test_a_held_frequency_is_cut_to_new_limits(limits, held, limited):
    loop = resonance_loop(43390.0)
    loop.limit(*limits)
    assert loop.step(0j, 0.0) == held
    assert loop.limited is limited


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

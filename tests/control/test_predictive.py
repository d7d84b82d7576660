import cmath
import math

import numpy as np
import pytest
from first_order_plate import FirstOrderPlate, gauges, run, setpoint
from hypothesis import example, given, settings
from hypothesis import strategies as st

from smarttac_can.control.cascade import Cascade
from smarttac_can.control.parameters import CascadeParameters
from smarttac_can.control.predictive import (
    PRIOR,
    PlateNow,
    Span,
    asked_voltage,
    interrupted,
    observed,
    prior_of,
    resonance_of,
    unlearned,
    voltage_for,
)
from smarttac_can.control.vibration import Limit
from smarttac_can.vocabulary.model import F0_SLOPE, PlateModel
from smarttac_can.vocabulary.signals import Drive, Measurement
from smarttac_can.vocabulary.states import Mode, VibrationLaw

W0 = 2 * math.pi * 43390.0
PLATE = PlateNow(53e-6, 1060.0, W0, 0.0)
SURE = PRIOR._replace(kk=1e-12, rr=1e-12, ww=1e-6)
BUS = 540e-6
BOTH, ALONE = Mode.AMPLITUDE_RESONANCE, Mode.AMPLITUDE


def at_the_next_instant(plate, dead_time, W, span, V):
    """W when the new drive has acted for a tick."""
    for voltage, w, time in ((span.V_before, span.w_before, dead_time), (V, span.w, 1e-3)):
        turn = complex(-plate.rate, plate.w0 - w)
        steady = -plate.kappa * voltage / turn
        W = steady + (W - steady) * cmath.exp(turn * time)
    return W


@given(
    W=st.builds(cmath.rect, st.floats(0.0, 2e-6), st.floats(-1.5, 1.5)),
    V_before=st.floats(0.0, 100.0),
    off=st.floats(-1500.0, 1500.0),
    W_ref=st.floats(0.0, 3e-6),
    dead_time=st.sampled_from([0.0, 250e-6, 540e-6, 999e-6]),
)
@settings(max_examples=200)
def test_the_voltage_brings_the_amplitude_to_a_tenth_of_the_error(
    W, V_before, off, W_ref, dead_time
):
    span = Span(V_before, W0 - off, 0.0, W0 - off)
    V = voltage_for(PLATE, SURE, dead_time, W, span, W_ref)
    turn = complex(-1060.0, off)
    steady = -53e-6 * V_before / turn
    start = abs(steady + (W - steady) * cmath.exp(turn * dead_time))
    goal = 0.1 * start + 0.9 * W_ref
    reached = abs(at_the_next_instant(PLATE, dead_time, W, span, V))
    lowest = min(
        abs(at_the_next_instant(PLATE, dead_time, W, span, V + change)) for change in (-1e-3, 1e-3)
    )
    # Where no voltage meets the goal, none comes nearer.
    assert reached == pytest.approx(goal, abs=1e-15) or (goal < reached < lowest + 1e-15)


def test_a_step_is_held_back_by_as_much_as_is_unsure():
    span = Span(0.0, W0, 0.0, W0)
    known = voltage_for(PLATE, SURE, 0.0, 0j, span, 1e-6)
    unsure = voltage_for(PLATE, SURE._replace(kk=0.25), 0.0, 0j, span, 1e-6)
    assert known == pytest.approx(0.9e-6 / (53e-6 * (1 - math.exp(-1.06)) / 1060.0))
    # Half a volt more or less a volt: a third of the step stays.
    assert unsure / known == pytest.approx((2 / 3) / 0.9, rel=1e-6)


@given(
    spread=st.tuples(*[st.floats(0.0, 0.5)] * 2, st.floats(0.0, 1500.0)),
    hang=st.tuples(*[st.floats(-0.9, 0.9)] * 3),
    off=st.floats(-3000.0, 3000.0),
)
@settings(max_examples=50)
@example(spread=(0.0, 0.5, 0.0), hang=(0.0, 0.0, 0.0), off=0.0)
@example(spread=(0.0, 0.0, 1500.0), hang=(0.0, 0.0, 0.0), off=2000.0)
def test_what_a_volt_does_is_as_unsure_as_each_of_the_three_makes_it(spread, hang, off):
    """The standard uncertainty of its logarithm, by its derivatives: as a share of the step."""
    shape = np.array([[1, hang[0], hang[1]], [hang[0], 1, hang[2]], [hang[1], hang[2], 1]])
    P = np.outer(spread, spread) * shape

    def volt(rate=1.0, w0=0.0):
        turn = complex(-PLATE.rate * rate, off + w0)
        return abs((cmath.exp(turn * 1e-3) - 1.0) / turn)

    slopes = np.array(
        [
            1.0,
            (math.log(volt(rate=1.0 + 1e-5)) - math.log(volt(rate=1.0 - 1e-5))) / 2e-5,
            (math.log(volt(w0=0.1)) - math.log(volt(w0=-0.1))) / 0.2,
        ]
    )
    variance = float(slopes @ P @ slopes)
    belief = SURE._replace(kk=P[0, 0], kr=P[0, 1], kw=P[0, 2], rr=P[1, 1], rw=P[1, 2], ww=P[2, 2])
    span = Span(0.0, W0 - off, 0.0, W0 - off)
    V = voltage_for(PLATE, belief, 0.0, 0j, span, 1e-6)
    left = 1.0 - V * PLATE.kappa * volt() / 1e-6
    unsure = math.sqrt(max(variance, 0.0))
    assert left == pytest.approx(max(unsure / (1.0 + unsure), 0.1), abs=1e-4)


class Seen(FirstOrderPlate):
    """The plate, with the largest vibration at any instant at which the drive changes."""

    peak = 0.0

    def _advance(self, drive, duration):
        super()._advance(drive, duration)
        self.peak = max(self.peak, abs(self.W))


def amplitudes(cascade, plate, target, ticks):
    """The amplitudes in m that some ticks begin with."""
    found = []
    for _ in range(ticks):
        found.append(abs(plate.W))
        run(cascade, plate, target, 1)
    return np.array(found)


def settled(W, reference, band):
    """Time in ms of the last entry into the band, linear between samples."""
    outside = np.flatnonzero(np.abs(W - reference) > band)
    last = outside[-1]
    edge = reference + math.copysign(band, W[last] - reference)
    return last + (edge - W[last]) / (W[last + 1] - W[last])


def response(plate, mode, told, W_ref=1e-6, frequency=43250.0, ticks=60):
    """5 % response time in ms and overshoot in %, from rest."""
    law = CascadeParameters(vibration_law=VibrationLaw.PREDICTIVE, dead_time=told)
    cascade = Cascade(law)
    target = setpoint(amplitude=W_ref, frequency=frequency)
    run(cascade, plate, target, 5)
    cascade.set_mode(mode)
    old = amplitudes(cascade, plate, target, ticks)
    assert cascade.mode is mode
    return settled(old, W_ref, 0.05 * W_ref), 100 * (plate.peak / W_ref - 1)


@pytest.mark.parametrize("mode", [BOTH, ALONE])
@pytest.mark.parametrize(("dead_time", "most"), [(0.0, 1.8), (250e-6, 2.1), (BUS, 2.3)])
def test_response_of_the_plate_that_is_known(mode, dead_time, most):
    time, overshoot = response(Seen(dead_time=dead_time, noise=1e-9), mode, dead_time)
    assert time < most
    assert overshoot < 2.0


@pytest.mark.parametrize("mode", [BOTH, ALONE])
@pytest.mark.parametrize("dead_time", [0.0, BUS])
def test_response_of_a_plate_that_is_not(mode, dead_time):
    """Gain and tau off by up to 20 %, the resonance by up to 200 Hz."""
    draw = np.random.default_rng(11)
    found = []
    for seed in range(100):
        gain, tau = draw.uniform(0.8, 1.2, 2)
        model = PlateModel(50e-9 * gain, 0.944e-3 * tau, 43390.0 + draw.uniform(-200.0, 200.0))
        plate = Seen(model, dead_time=dead_time, noise=1e-9, seed=seed)
        found.append(response(plate, mode, dead_time))
    time, overshoot = np.percentile(found, 95, axis=0)
    assert time <= 4.0
    assert overshoot <= 15.0


@pytest.mark.parametrize("mode", [BOTH, ALONE])
@pytest.mark.parametrize(("share", "most"), [(0.7, 6.0), (1.3, 30.0)])
def test_a_dead_time_that_is_told_wrongly_by_30_percent(mode, share, most):
    time, overshoot = response(Seen(dead_time=share * BUS, noise=1e-9), mode, BUS)
    assert time < 5.0
    assert overshoot < most


@pytest.mark.parametrize(("W_ref", "most"), [(0.05e-6, 8.0), (0.1e-6, 4.0), (2.5e-6, 1.0)])
def test_small_and_large_amplitudes(W_ref, most):
    time, overshoot = response(Seen(dead_time=BUS, noise=1e-9), BOTH, BUS, W_ref)
    assert time < 3.0
    assert overshoot < most


def test_the_noise_of_the_pickup_moves_the_plate_by_less_than_itself():
    plate = FirstOrderPlate(dead_time=BUS, noise=1e-9)
    law = CascadeParameters(vibration_law=VibrationLaw.PREDICTIVE, dead_time=BUS)
    cascade = Cascade(law)
    cascade.set_mode(BOTH)
    W = amplitudes(cascade, plate, setpoint(), 1000)
    assert np.std(W[100:]) < 1.0e-9
    assert np.mean(W[100:]) == pytest.approx(1e-6, rel=1e-3)


def test_a_frequency_at_its_limit_costs_voltage_and_no_time():
    plate = Seen(dead_time=BUS, noise=1e-9)
    law = CascadeParameters(vibration_law=VibrationLaw.PREDICTIVE, dead_time=BUS, f_max=43_300.0)
    cascade = Cascade(law)
    cascade.set_mode(BOTH)
    W = amplitudes(cascade, plate, setpoint(), 40)
    assert settled(W, 1e-6, 5e-8) < 4.0
    assert cascade.drive.frequency == 43_300.0
    assert cascade.limited == Limit.FREQUENCY


def test_a_voltage_at_its_limit_winds_nothing_up():
    plate = Seen(dead_time=BUS, noise=1e-9)
    law = CascadeParameters(vibration_law=VibrationLaw.PREDICTIVE, dead_time=BUS, V_max=24.0)
    cascade = Cascade(law)
    cascade.set_mode(BOTH)
    run(cascade, plate, setpoint(amplitude=1.5e-6), 40)
    assert cascade.drive.voltage == 24.0
    assert cascade.limited == Limit.VOLTAGE
    W = amplitudes(cascade, plate, setpoint(amplitude=0.8e-6), 20)
    assert settled(W, 0.8e-6, 0.02e-6) < 2.5


def driven(ticks=60, **parameters):
    """A cascade that holds 1 um, and its plate."""
    law = CascadeParameters(vibration_law=VibrationLaw.PREDICTIVE, dead_time=BUS, **parameters)
    cascade, plate = Cascade(law), FirstOrderPlate(dead_time=BUS, noise=1e-9)
    cascade.set_mode(BOTH)
    run(cascade, plate, setpoint(), ticks)
    return cascade, plate


def test_the_thermometer_tells_where_the_resonance_starts():
    model = PlateModel(f0=43_250.0, temperature=30.0)
    law = CascadeParameters(vibration_law=VibrationLaw.PREDICTIVE)
    cascade = Cascade(law, model)
    for _ in range(3):
        cascade.update(Measurement(0j, (0.0,) * 6, 20.0, 0), setpoint())
    cascade.set_mode(BOTH)
    drive = cascade.update(Measurement(0j, (0.0,) * 6, 20.0, 0), setpoint(frequency=43_250.0))
    assert drive.frequency == pytest.approx(43_390.0, abs=0.1)


def observed_at(temperatures, learned=None):
    """What is known after so many ticks at rest."""
    prior = prior_of(PlateModel(), 0.0)
    learned = unlearned(prior) if learned is None else learned
    for temperature in temperatures:
        learned = observed(prior, learned, 0j, Drive(0.0, 43390.0), 0.0, temperature)
    return learned


def test_the_temperature_is_that_of_the_first_tick_and_then_followed_within_seconds():
    first = observed_at([31.0])
    assert first.temperature == 31.0
    assert (first.plate.w0 - W0) / (2 * math.pi) == pytest.approx(F0_SLOPE * 11.0)
    later = observed_at([41.0] * 300, first).temperature
    assert 40.0 < later < 41.0
    assert observed_at([math.nan]).plate.w0 == pytest.approx(W0, rel=1e-12)
    assert first.contact == 0.0
    # One that no plate has is not believed.
    for broken in (-150.0, 150.0, 1e9, math.nan):
        assert observed_at([broken], first).temperature == 31.0
        assert math.isnan(observed_at([broken]).temperature)
    assert observed_at([120.0]).temperature == 120.0


def test_nothing_is_asked_for_before_something_was_seen_nor_changed_before_two_were():
    prior = prior_of(PlateModel(), 0.0)
    nothing = unlearned(prior)
    assert nothing.plate.rate == pytest.approx(1.0 / PlateModel().tau)
    assert asked_voltage(prior, nothing, 1e-6, 43_300.0) == 0.0
    once = observed(prior, nothing, 0.5e-6 + 0j, Drive(17.0, 43_300.0), 0.0, 20.0)
    assert asked_voltage(prior, once, 1e-6, 43_300.0) == 17.0
    assert resonance_of(once) == 43_300.0
    assert resonance_of(interrupted(once)) == pytest.approx(43_390.0)
    twice = observed(prior, once, 0.5e-6 + 0j, Drive(17.0, 43_300.0), 0.0, 20.0)
    assert asked_voltage(prior, twice, 1e-6, 43_300.0) != 17.0
    assert resonance_of(twice) != 43_300.0
    # After a tick that is missing two are needed again.
    gap = interrupted(twice)
    assert asked_voltage(prior, gap, 1e-6, 43_300.0) == 0.0
    assert (
        observed(prior, gap, 0.5e-6 + 0j, Drive(17.0, 43_300.0), 0.0, 20.0).belief == twice.belief
    )


@pytest.mark.parametrize(("size", "learns"), [(15e-9, False), (30e-9, True)])
def test_an_offset_of_the_pickup_teaches_nothing(size, learns):
    prior = prior_of(PlateModel(), 0.0)
    learned = unlearned(prior)
    for _ in range(2):
        learned = observed(prior, learned, complex(size), Drive(0.0, 43_390.0), 0.0, 20.0)
    assert (learned.belief[:3] != (0.0, 0.0, 0.0)) == learns


def test_a_force_is_believed_within_a_few_ticks_and_its_noise_is_not():
    prior = prior_of(PlateModel(), 0.0)
    contacts, learned = [], unlearned(prior)
    for _ in range(10):
        learned = observed(prior, learned, 0j, Drive(0.0, 43_390.0), 0.5, 20.0)
        contacts.append(learned.contact)
    assert 0.15 < contacts[0] < 0.5
    assert contacts == sorted(contacts)
    assert contacts[-1] == pytest.approx(1.0, abs=0.1)
    assert learned.rate == pytest.approx(prior.load * contacts[-1] / prior.tau + 1.0 / prior.tau)


@pytest.mark.parametrize("temperature", [math.nan, math.inf, -1e9, 80.0, -30.0])
def test_a_thermometer_that_breaks_does_not_move_the_plate(temperature):
    cascade, plate = driven()
    for _ in range(200):
        measurement = plate.measure()._replace(temperature=temperature)
        drive = cascade.update(measurement, setpoint())
        plate.step(drive)
        assert abs(plate.W) == pytest.approx(1e-6, rel=0.02)
        assert drive.frequency == pytest.approx(43_390.0, abs=60.0)


def test_after_a_bad_measurement_it_starts_from_two_good_ones():
    cascade, plate = driven()
    bad = Measurement(complex(math.nan, 0.0), (0.0,) * 6, 20.0, 0)
    learned = cascade.state.learned.belief
    plate.step(cascade.update(bad, setpoint()))
    plate.step(cascade.update(plate.measure(), setpoint()))
    assert cascade.state.learned.belief == learned
    cascade.set_mode(BOTH)
    run(cascade, plate, setpoint(), 20)
    assert abs(plate.W) == pytest.approx(1e-6, rel=0.02)


@pytest.mark.parametrize("drive", [Drive(0.0, 43_390.0), Drive(15.0, 43_200.0)])
def test_it_counts_with_the_drive_that_went_out(drive):
    """Whatever was asked for: a supervisor may have put out another one."""
    cascade, plate = driven()
    for _ in range(5):
        cascade.update(plate.measure(), setpoint())
        cascade.realised(drive)
        plate.step(drive)
    # What it believes in is the plate, not one that ignores a voltage.
    assert cascade.state.learned.plate.kappa == pytest.approx(50e-9 / 0.944e-3, rel=0.05)


def test_a_finger_is_learned_and_forgotten():
    cascade, plate = driven()
    loaded = PlateModel(50e-9 / 2.2, 0.944e-3 / 2.2)
    for model, Fn in ((loaded, 0.5), (PlateModel(), 0.0)):
        plate.model = model
        for _ in range(30):
            plate.step(cascade.update(plate.measure(gauges(Fn=Fn)), setpoint()))
        assert abs(plate.W) == pytest.approx(1e-6, rel=0.01)
        assert cascade.state.learned.plate.rate == pytest.approx(1.0 / model.tau, rel=0.15)


@pytest.mark.parametrize("dead_time", [0.0, BUS])
@pytest.mark.parametrize(("lost", "most"), [(0, 2.57e-6), (1, 2.96e-6), (2, 2.57e-6)])
def test_a_drive_that_was_lost_is_not_taken_for_another_plate(lost, most, dead_time):
    """The second one would have ended the step up, so that the plate itself goes on rising."""
    law = CascadeParameters(vibration_law=VibrationLaw.PREDICTIVE, dead_time=dead_time)
    cascade, plate = Cascade(law), Seen(dead_time=dead_time, noise=1e-9)
    cascade.set_mode(BOTH)
    for _ in range(40):
        last = cascade.update(plate.measure(), setpoint(amplitude=0.3e-6))
        plate.step(last)
    plate.peak = 0.0
    for tick in range(40):
        drive = cascade.update(plate.measure(), setpoint(amplitude=2.5e-6))
        last = last if tick == lost else drive
        plate.step(last)
    assert plate.peak < most
    assert abs(plate.W) == pytest.approx(2.5e-6, rel=0.01)
    assert cascade.state.learned.plate.kappa == pytest.approx(50e-9 / 0.944e-3, rel=0.03)


@pytest.mark.parametrize("amplitude", [0.5e-6, 1.5e-6, 2.5e-6])
@pytest.mark.parametrize("change", [0.4, 0.5, 0.7, 1.4, 2.0])
def test_a_plate_that_changes_in_a_step_is_not_taken_for_lost_drives(change, amplitude):
    """One drive may seem lost by chance, where a volt does less just as more volts are asked."""
    cascade, plate = driven()
    plate.model = PlateModel(gain=50e-9 * change)
    run(cascade, plate, setpoint(amplitude=amplitude), 30)
    assert abs(plate.W) == pytest.approx(amplitude, rel=0.02)
    learned = cascade.state.learned.plate
    assert learned.kappa / learned.rate == pytest.approx(50e-9 * change, rel=0.02)

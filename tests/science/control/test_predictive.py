"""The predictive law: its estimate of a plate, its drive, and the closed loop."""

import cmath
import math
import random

import numpy as np
import pytest
from first_order_plate import FirstOrderPlate, gauges, run, setpoint
from hypothesis import example, given, settings
from hypothesis import strategies as st

from smarttac_can.science.control.cascade import Cascade
from smarttac_can.science.control.parameters import CascadeParameters
from smarttac_can.science.control.predictive import (
    _JITTER,
    _MISSED_FROM,
    _NOISE,
    _UNMODELLED,
    PRIOR,
    PlateNow,
    Span,
    _predict,
    _update,
    asked_voltage,
    believed,
    drive_lost,
    fade,
    interrupted,
    learn,
    observed,
    prior_of,
    resonance_of,
    unlearned,
    voltage_for,
    with_first_only,
)
from smarttac_can.science.control.vibration import Limit
from smarttac_can.science.plant.parameters import SensorParameters
from smarttac_can.studies.paper.metrics import response_time
from smarttac_can.vocabulary.model import F0_SLOPE, PlateModel
from smarttac_can.vocabulary.signals import Drive, Measurement
from smarttac_can.vocabulary.states import Mode, VibrationLaw

W0 = 2 * math.pi * 43390.0
MODEL = PlateNow(kappa=53e-6, rate=1060.0, w0=W0, softening=0.0)
SURE = PRIOR._replace(kk=1e-12, rr=1e-12, ww=1e-6)
BUS = 540e-6
BOTH, ALONE = Mode.AMPLITUDE_RESONANCE, Mode.AMPLITUDE


def moved(plate, dead_time, W, span, end=1e-3, parts=1):
    """The plate, written the other way round: as a decay towards its steady state.

    A resonance that falls as the plate moves is that of each of the parts.
    """
    for V, w, time in ((span[0], span[1], dead_time), (span[2], span[3], end - dead_time)):
        for _ in range(parts):
            turn = complex(-plate.rate, plate.w0 - plate.softening * abs(W) - w)
            steady = -plate.kappa * V / turn
            W = steady + (W - steady) * cmath.exp(turn * time / parts)
    return W


def watched(plate, voltages, dead_time=BUS, noise=0.0, parts=1):
    """Learn from a plate under these voltages; return the belief after each tick."""
    shake = random.Random(1)
    W, before, belief, beliefs = 0j, 0.0, PRIOR, []
    seen = W
    for V in voltages:
        span = Span(before, W0, V, W0)
        W = moved(plate, dead_time, W, span, parts=parts)
        now = W + complex(shake.gauss(0.0, noise), shake.gauss(0.0, noise))
        belief = learn(fade(belief, 0.0), MODEL, dead_time, seen, span, now)
        seen, before = now, V
        beliefs.append(belief)
    return beliefs


@pytest.mark.parametrize("dead_time", [0.0, BUS])
@pytest.mark.parametrize(("gain", "tau", "off"), [(1.2, 0.8, 150.0), (0.8, 1.2, -200.0)])
def test_a_plate_that_is_driven_to_and_fro_is_known(gain, tau, off, dead_time):
    plate = PlateNow(53e-6 * gain / tau, 1060.0 / tau, W0 + 2 * math.pi * off, 0.0)
    voltages = [30.0] * 8 + [20.0] * 8 + [30.0] * 8
    found = believed(MODEL, watched(plate, voltages, dead_time, noise=1e-9)[-1])
    assert found.kappa == pytest.approx(plate.kappa, rel=0.06)
    assert found.rate == pytest.approx(plate.rate, rel=0.06)
    assert (found.w0 - plate.w0) / (2 * math.pi) == pytest.approx(0.0, abs=10.0)


def test_a_plate_twice_as_damped_is_one_that_there_may_be():
    beliefs = watched(MODEL._replace(rate=2.2 * MODEL.rate), [30.0, 20.0] * 12)
    assert max(belief.rate for belief in beliefs) > math.log(1.9)


def test_the_phase_of_one_tick_tells_the_resonance():
    plate = PlateNow(53e-6, 1060.0, W0 + 2 * math.pi * 200.0, 0.0)
    belief = watched(plate, [30.0])[-1]
    # From rest, the share of the drive turns as at some three quarters of the amplitude reached.
    reached = abs(moved(plate, BUS, 0j, Span(0.0, W0, 30.0, W0)))
    there = belief.w0 - belief.softening * 0.75 * reached
    assert there / (2 * math.pi) == pytest.approx(200.0, abs=15.0)


@pytest.mark.parametrize("dead_time", [0.0, BUS])
@pytest.mark.parametrize("softening", [-60e6, 0.0, 60e6, 150e6])
def test_the_softening_is_known_after_two_amplitudes(softening, dead_time):
    plate = PlateNow(53e-6, 1060.0, W0 + 2 * math.pi * 50.0, 2 * math.pi * softening)
    voltages = [20.0] * 8 + [45.0] * 8 + [20.0] * 8
    found = believed(MODEL, watched(plate, voltages, dead_time, 1e-9, parts=200)[-1])
    assert found.softening / (2 * math.pi) == pytest.approx(softening, rel=0.1, abs=6e6)
    assert (found.w0 - plate.w0) / (2 * math.pi) == pytest.approx(0.0, abs=10.0)


def test_a_steady_vibration_is_explained_whichever_plate_it_is():
    plate = PlateNow(53e-6 * 1.2, 1060.0 * 1.3, W0 + 300.0, 0.0)
    belief = watched(plate, [20.0] * 200, noise=1e-9)[-1]
    found = believed(MODEL, belief)
    found = found._replace(w0=found.w0 - found.softening * 20.0 * plate.kappa / plate.rate)
    there, here = (-p.kappa * 20.0 / complex(-p.rate, p.w0 - W0) for p in (plate, found))
    assert abs(here - there) < 0.01 * abs(there)


def test_at_rest_nothing_is_learned():
    belief = watched(MODEL, [0.0] * 100)[-1]
    assert belief[:4] == (0.0, 0.0, 0.0, 0.0)
    assert belief[4:] == pytest.approx(PRIOR[4:])


def test_another_load_is_not_known():
    assert fade(PRIOR, 0.3).rr == pytest.approx(PRIOR.rr + 0.09)


@pytest.mark.parametrize("off", [0.0, 2000.0, 4000.0])
def test_a_drive_that_came_late_is_not_another_plate(off):
    """60 us later than told, W lacks 10 % after the first tick, and off resonance some phase."""
    span = Span(0.0, W0 - off, 30.0, W0 - off)
    belief = learn(PRIOR, MODEL, BUS, 0j, span, moved(MODEL, BUS + 60e-6, 0j, span))
    assert -0.07 < belief.kappa < 0.0
    assert -150.0 < belief.w0 <= 0.0


somewhere = st.tuples(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.floats(-2e3, 2e3))


@given(
    at=somewhere,
    dead_time=st.sampled_from([0.0, 250e-6, BUS]),
    W=st.builds(cmath.rect, st.floats(0.0, 2e-6), st.floats(-3.0, 3.0)),
    voltages=st.tuples(st.floats(0.0, 100.0), st.floats(0.0, 100.0)),
    off=st.floats(-2e3, 2e3),
)
@settings(max_examples=50)
def test_prediction_and_derivatives_equal_those_of_the_plate(at, dead_time, W, voltages, off):
    span = Span(voltages[0], W0 - off, voltages[1], W0 + 0.5 * off)

    def moves(kappa, rate, w0):
        return moved(
            believed(MODEL, PRIOR._replace(kappa=kappa, rate=rate, w0=w0)), dead_time, W, span
        )

    belief = PRIOR._replace(kappa=at[0], rate=at[1], w0=at[2])
    size = abs(moves(*at))
    predicted, _, *derivatives, by_softening, variance = _predict(
        belief, MODEL, dead_time, W, span, size
    )
    # A softening of 16 mHz/um: the mean amplitude of both parts turns W.
    turned = belief._replace(softening=1e5)
    soft = _predict(turned, MODEL, dead_time, W, span, size)[0] - predicted
    assert abs(by_softening * 1e5 - soft) < 1e-3 * abs(soft) + 1e-15
    size = abs(W) + 1e-6
    assert abs(predicted - moves(*at)) < 1e-9 * size
    for place, step in enumerate((1e-5, 1e-5, 1e-1)):
        more, less = ([*at[:place], at[place] + way * step, *at[place + 1 :]] for way in (1, -1))
        slope = (moves(*more) - moves(*less)) / (2.0 * step)
        assert abs(derivatives[place] - slope) * step < 1e-9 * size
    assert variance > 0.0


def test_wrong_drive_instant_shifts_by_the_jump_of_the_voltage():
    """By the voltage it differs by, over the jitter: the derivative by the dead time."""
    span = Span(10.0, W0, 40.0, W0)
    late = _predict(PRIOR, MODEL, BUS, 0j, span, 1e-6)[1]
    slope = (moved(MODEL, BUS + 1e-7, 0j, span) - moved(MODEL, BUS - 1e-7, 0j, span)) / 2e-7
    assert late == pytest.approx(-_JITTER * slope, rel=1e-2)
    assert _predict(PRIOR, MODEL, BUS, 0j, Span(40.0, W0, 40.0, W0), 1e-6)[1] == 0j


def test_prediction_variance_grows_with_size_and_jump():
    def variance(W, V_before, V):
        return _predict(PRIOR, MODEL, BUS, W, Span(V_before, W0, V, W0), 1e-6)[-1]

    still = variance(0j, 0.0, 0.0)
    # The older reading decays by the tick.
    assert still / _NOISE**2 == pytest.approx(1.0 + math.exp(-2.0 * MODEL.rate * 1e-3))
    steady = MODEL.kappa * 20.0 / MODEL.rate
    large = variance(complex(steady), 20.0, 20.0) - still
    assert large / steady**2 == pytest.approx(_UNMODELLED**2, rel=1e-9, abs=0.0)
    # The share of the other oscillation in a jump, at twice the frequency, is 1/(2 w0) of it.
    reached = abs(moved(MODEL, BUS, 0j, Span(0.0, W0, 20.0, W0)))
    jump = variance(0j, 0.0, 20.0) - still - (_UNMODELLED * reached) ** 2
    assert jump / (MODEL.kappa * 20.0 / (2.0 * W0)) ** 2 == pytest.approx(1.0)


def test_the_noise_is_that_of_the_pickup():
    assert SensorParameters().pickup_noise == _NOISE


@given(
    slopes=st.tuples(*[st.floats(-2e-6, 2e-6)] * 2, *[st.floats(-1e-9, 1e-9)] * 2),
    innovation=st.floats(-1e-6, 1e-6),
    variance=st.floats(1e-18, 1e-14),
)
@settings(max_examples=50)
def test_one_axis_teaches_as_a_kalman_filter(slopes, innovation, variance):
    hang = {"kr": 1e-3, "kw": 0.2, "ks": 0.3, "rw": -0.3, "rs": 0.1, "ws": -20.0}
    belief = fade(PRIOR, 0.2)._replace(ss=1e5, kappa=0.1, rate=-0.1, w0=50.0, softening=3.0, **hang)
    P = np.zeros((4, 4))
    P[np.triu_indices(4)] = belief[4:]
    P += np.triu(P, 1).T
    H = np.array(slopes)
    gain = P @ H / (H @ P @ H + variance)
    x, P = np.array(belief[:4]) + gain * innovation, P - np.outer(gain, H @ P)
    found = _update(belief, slopes, innovation, variance)
    assert found[:4] == pytest.approx(x, rel=1e-9, abs=1e-12)
    assert found[4:] == pytest.approx(P[np.triu_indices(4)], rel=1e-6, abs=1e-12)


def test_learned_variance_grows_in_10_s_of_damping_in_20_ms():
    """Of the variance that is left out by then e^-2; correlated ones keep to it."""
    sure = PRIOR._replace(kk=0.0, rr=0.0, ww=0.0, ss=0.0)
    for tick in range(10_001):
        if tick == 20:
            assert sure.rr / PRIOR.rr == pytest.approx(1.0 - math.exp(-2.0), rel=0.02)
        sure = fade(sure, 0.0)
    assert sure.kk / PRIOR.kk == pytest.approx(1.0 - math.exp(-2.0), rel=0.01)
    assert sure.ww / PRIOR.ww == pytest.approx(1.0 - math.exp(-2.0), rel=0.01)
    assert sure.ss / PRIOR.ss == pytest.approx(1.0 - math.exp(-0.2), rel=0.01)
    assert sure.rr == pytest.approx(PRIOR.rr)


def test_pressing_finger_raises_the_variance_of_the_resonance():
    """1/tau changes e-fold under it, and the resonance by some 200 rad/s."""
    for change in (0.3, -0.3):
        belief = fade(PRIOR, change)
        assert belief.ww - PRIOR.ww == pytest.approx((200.0 * change) ** 2)


def test_the_model_is_as_unsure_as_plates_differ():
    """By 20 % of the gain at most, uniform; 200 Hz off is three standard deviations or so."""
    assert math.sqrt(PRIOR.kk) == pytest.approx(0.2 / math.sqrt(3.0), rel=0.05)
    assert math.sqrt(PRIOR.rr) == pytest.approx(math.sqrt(PRIOR.kk), rel=0.2)
    assert 3.0 < 200.0 / (math.sqrt(PRIOR.ww) / (2.0 * math.pi)) < 4.0
    assert PRIOR.kr == PRIOR.kw == PRIOR.rw == 0.0


@pytest.mark.parametrize("dead_time", [0.0, BUS])
def test_drive_is_lost_if_the_one_before_explains_the_error(dead_time):
    span, W = Span(10.0, W0, 60.0, W0), 0.4e-6 + 0j
    kept = moved(MODEL, dead_time, W, with_first_only(span))
    came = moved(MODEL, dead_time, W, span)
    assert abs(came - kept) > 5.0 * _MISSED_FROM

    def is_lost(share):
        return drive_lost(PRIOR, MODEL, dead_time, W, span, kept + share * (came - kept))

    assert [is_lost(share) for share in (0.0, 0.08, 0.12, 0.5, 1.0)] == [
        True,
        True,
        False,
        False,
        False,
    ]
    # A tiny error is no lost drive, and neither is one that an unsure model explains.
    sure = PRIOR._replace(kk=1e-6, rr=1e-6, ww=1.0, ss=1.0)
    for belief, change, lost in ((sure, 0.9, False), (sure, 1.1, True), (PRIOR, 1.1, False)):
        small = Span(10.0, W0, 10.0 + 50.0 * change * _MISSED_FROM / abs(came - kept), W0)
        still = moved(MODEL, dead_time, W, with_first_only(small))
        assert drive_lost(belief, MODEL, dead_time, W, small, still) == lost


@pytest.mark.parametrize(
    ("left", "lost"),
    [(0.08, True), (0.12, False), (-0.12, False), (0.05 + 0.25j, True), (0.05 - 0.25j, True),
     (0.05 + 0.35j, False), (0.05 - 0.35j, False)],
)  # fmt: skip
def test_lost_drive_leaves_a_tenth_along_the_error_0_3_across(left, lost):
    span, W = Span(10.0, W0, 60.0, W0), 0.4e-6 + 0j
    kept = moved(MODEL, BUS, W, with_first_only(span))
    came = moved(MODEL, BUS, W, span)
    # From here ``left`` of the way from what was asked for is still to go to what was kept.
    assert drive_lost(PRIOR, MODEL, BUS, W, span, (kept - left * came) / (1.0 - left)) == lost


finite = st.floats(-1e4, 1e4)
vibration = st.builds(complex, st.floats(-1e3, 1e3), st.floats(-1e3, 1e3)) | st.builds(
    complex, st.floats(-5e-6, 5e-6), st.floats(-5e-6, 5e-6)
)
spans = st.builds(
    Span,
    st.floats(0.0, 500.0),
    st.floats(W0 - 1e4, W0 + 1e4),
    st.floats(0.0, 500.0),
    st.floats(W0 - 1e4, W0 + 1e4),
)


@given(st.lists(st.tuples(vibration, spans, st.floats(0.0, 1.0)), min_size=1, max_size=40))
@settings(max_examples=150)
@pytest.mark.parametrize("dead_time", [0.0, 1e-6, 999e-6])
def test_whatever_is_measured_the_belief_stays_one_of_a_plate(dead_time, ticks):
    belief, W = PRIOR, 0j
    for W_next, span, load_change in ticks:
        belief = learn(fade(belief, load_change), MODEL, dead_time, W, span, W_next)
        W = W_next
        assert all(math.isfinite(number) for number in belief)
        assert abs(belief.kappa) <= 1.0
        assert abs(belief.rate) <= 1.0
        assert abs(belief.w0) <= 2 * math.pi * 2000.0
        assert abs(belief.softening) <= 2 * math.pi * 1e9
        assert min(belief.kk, belief.rr, belief.ww, belief.ss) > 0.0


@pytest.mark.parametrize("bad", [complex(math.nan, 0.0), complex(0.0, math.inf)])
def test_no_number_gives_the_model_back(bad):
    learned = watched(PlateNow(60e-6, 1000.0, W0, 0.0), [30.0] * 5)[-1]
    assert learn(learned, MODEL, BUS, bad, Span(0.0, W0, 30.0, W0), 1e-6 + 0j) == PRIOR
    assert learn(learned, MODEL, BUS, 1e-6 + 0j, Span(0.0, W0, 30.0, W0), bad) == PRIOR


@given(
    W=st.builds(cmath.rect, st.floats(0.0, 2e-6), st.floats(-1.5, 1.5)),
    V_before=st.floats(0.0, 100.0),
    off=st.floats(-1500.0, 1500.0),
    W_ref=st.floats(0.0, 3e-6),
    dead_time=st.sampled_from([0.0, 250e-6, 540e-6, 999e-6]),
)
@settings(max_examples=200)
def test_voltage_brings_the_amplitude_to_a_tenth_of_the_error(W, V_before, off, W_ref, dead_time):
    span = Span(V_before, W0 - off, 0.0, W0 - off)
    V = voltage_for(MODEL, SURE, dead_time, W, span, W_ref)

    def at_the_end(V, time):
        return abs(moved(MODEL, dead_time, W, span._replace(V=V), dead_time + time))

    goal = 0.1 * at_the_end(V, 0.0) + 0.9 * W_ref
    reached = at_the_end(V, 1e-3)
    lowest = min(at_the_end(V + change, 1e-3) for change in (-1e-3, 1e-3))
    # Where no voltage meets the goal, none comes nearer.
    assert reached == pytest.approx(goal, abs=1e-15) or (goal < reached < lowest + 1e-15)


def test_a_step_is_held_back_by_as_much_as_is_unsure():
    span = Span(0.0, W0, 0.0, W0)
    known = voltage_for(MODEL, SURE, 0.0, 0j, span, 1e-6)
    unsure = voltage_for(MODEL, SURE._replace(kk=0.25), 0.0, 0j, span, 1e-6)
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
def test_variance_of_a_volt_sums_those_of_three_parameters(spread, hang, off):
    """The standard uncertainty of its logarithm, by its derivatives: as a share of the step."""
    shape = np.array([[1, hang[0], hang[1]], [hang[0], 1, hang[2]], [hang[1], hang[2], 1]])
    P = np.outer(spread, spread) * shape

    def volt(rate=1.0, w0=0.0):
        turn = complex(-MODEL.rate * rate, off + w0)
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
    V = voltage_for(MODEL, belief, 0.0, 0j, span, 1e-6)
    left = 1.0 - V * MODEL.kappa * volt() / 1e-6
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


def predicting(mode=BOTH, dead_time=BUS, **parameters):
    """A cascade that begins a mode with the predictive law."""
    cascade = Cascade(
        CascadeParameters(vibration_law=VibrationLaw.PREDICTIVE, dead_time=dead_time, **parameters)
    )
    cascade.set_mode(mode)
    return cascade


def response(plate, mode, told, W_ref=1e-6, frequency=43250.0, ticks=60):
    """5 % response time in ms and overshoot in %, from rest."""
    cascade = predicting(Mode.OFF, told)
    target = setpoint(amplitude=W_ref, frequency=frequency)
    run(cascade, plate, target, 5)
    cascade.set_mode(mode)
    found = amplitudes(cascade, plate, target, ticks)
    assert cascade.mode is mode
    return response_time(found, W_ref), 100 * (plate.peak / W_ref - 1)


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


def test_pickup_noise_moves_the_plate_by_less_than_itself():
    plate = FirstOrderPlate(dead_time=BUS, noise=1e-9)
    W = amplitudes(predicting(), plate, setpoint(), 1000)
    assert np.std(W[100:]) < 1.0e-9
    assert np.mean(W[100:]) == pytest.approx(1e-6, rel=1e-3)


def test_a_frequency_at_its_limit_costs_voltage_and_no_time():
    plate = Seen(dead_time=BUS, noise=1e-9)
    cascade = predicting(f_max=43_300.0)
    W = amplitudes(cascade, plate, setpoint(), 40)
    assert response_time(W, 1e-6) < 4.0
    assert cascade.drive.frequency == 43_300.0
    assert cascade.limited == Limit.FREQUENCY


def test_a_voltage_at_its_limit_winds_nothing_up():
    plate = Seen(dead_time=BUS, noise=1e-9)
    cascade = predicting(V_max=24.0)
    run(cascade, plate, setpoint(amplitude=1.5e-6), 40)
    assert cascade.drive.voltage == 24.0
    assert cascade.limited == Limit.VOLTAGE
    W = amplitudes(cascade, plate, setpoint(amplitude=0.8e-6), 20)
    assert response_time(W, 0.8e-6, 0.025) < 2.5


def driven():
    """A cascade that holds 1 um, and its plate."""
    cascade, plate = predicting(), FirstOrderPlate(dead_time=BUS, noise=1e-9)
    run(cascade, plate, setpoint(), 60)
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
    """The estimate after so many ticks at rest."""
    prior = prior_of(PlateModel(), 0.0)
    learned = unlearned(prior) if learned is None else learned
    for temperature in temperatures:
        learned = observed(prior, learned, 0j, Drive(0.0, 43390.0), 0.0, temperature)
    return learned


def test_temperature_starts_at_the_first_tick_then_follows():
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


def test_predictive_law_holds_until_two_readings():
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


def test_force_is_followed_in_a_few_ticks_without_its_noise():
    prior = prior_of(PlateModel(), 0.0)
    contacts, learned = [], unlearned(prior)
    for _ in range(10):
        learned = observed(prior, learned, 0j, Drive(0.0, 43_390.0), 0.5, 20.0)
        contacts.append(learned.contact)
    assert 0.15 < contacts[0] < 0.5
    assert contacts == sorted(contacts)
    assert contacts[-1] == pytest.approx(1.0, abs=0.1)
    assert learned.rate == pytest.approx(PlateModel().decay_rate(contacts[-1]))


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
    # It believes in the plate, not in one that ignores a voltage.
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
    cascade, plate = predicting(dead_time=dead_time), Seen(dead_time=dead_time, noise=1e-9)
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
def test_step_change_of_the_plate_is_not_taken_for_lost_drives(change, amplitude):
    """One drive may seem lost by chance, where a volt does less just as more volts are asked."""
    cascade, plate = driven()
    plate.model = PlateModel(gain=50e-9 * change)
    run(cascade, plate, setpoint(amplitude=amplitude), 30)
    assert abs(plate.W) == pytest.approx(amplitude, rel=0.02)
    learned = cascade.state.learned.plate
    assert learned.kappa / learned.rate == pytest.approx(50e-9 * change, rel=0.02)

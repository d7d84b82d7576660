import cmath
import math
import random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from smarttac_can.control.predictive import (
    _JITTER,
    _MISSED_FROM,
    _NOISE,
    _UNMODELLED,
    PRIOR,
    PlateNow,
    Span,
    _predict,
    _update,
    believed,
    fade,
    first_lasting,
    learn,
    missed,
)
from smarttac_can.plant.parameters import SensorParameters

W0 = 2 * math.pi * 43390.0
MODEL = PlateNow(kappa=53e-6, rate=1060.0, w0=W0, softening=0.0)
DEAD = 540e-6


def moved(plate, dead_time, W, span):
    """The plate, written the other way round: as a decay towards its steady state."""
    for V, w, time in ((span[0], span[1], dead_time), (span[2], span[3], 1e-3 - dead_time)):
        turn = complex(-plate.rate, plate.w0 - w)
        steady = -plate.kappa * V / turn
        W = steady + (W - steady) * cmath.exp(turn * time)
    return W


def softened(plate, dead_time, W, span):
    """The same of a plate whose resonance falls as it moves, in 200 parts."""
    for V, w, time in ((span[0], span[1], dead_time), (span[2], span[3], 1e-3 - dead_time)):
        for _ in range(200):
            now = plate._replace(w0=plate.w0 - plate.softening * abs(W))
            turn = complex(-now.rate, now.w0 - w)
            steady = -now.kappa * V / turn
            W = steady + (W - steady) * cmath.exp(turn * time / 200)
    return W


def watched(plate, voltages, dead_time=DEAD, noise=0.0, belief=PRIOR, w=W0, moved=moved):
    """Learn from a plate under these voltages; return the belief after each tick."""
    shake = random.Random(1)
    W, before, beliefs = 0j, 0.0, []
    seen = W
    for V in voltages:
        span = Span(before, w, V, w)
        W = moved(plate, dead_time, W, span)
        now = W + complex(shake.gauss(0.0, noise), shake.gauss(0.0, noise))
        belief = learn(fade(belief, 0.0), MODEL, dead_time, seen, span, now)
        seen, before = now, V
        beliefs.append(belief)
    return beliefs


@pytest.mark.parametrize("dead_time", [0.0, DEAD])
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
    # From rest, what the drive adds turns as at some three quarters of the amplitude reached.
    reached = abs(moved(plate, DEAD, 0j, Span(0.0, W0, 30.0, W0)))
    there = belief.w0 - belief.softening * 0.75 * reached
    assert there / (2 * math.pi) == pytest.approx(200.0, abs=15.0)


@pytest.mark.parametrize("dead_time", [0.0, DEAD])
@pytest.mark.parametrize("softening", [-60e6, 0.0, 60e6, 150e6])
def test_the_softening_is_known_after_two_amplitudes(softening, dead_time):
    plate = PlateNow(53e-6, 1060.0, W0 + 2 * math.pi * 50.0, 2 * math.pi * softening)
    voltages = [20.0] * 8 + [45.0] * 8 + [20.0] * 8
    found = believed(MODEL, watched(plate, voltages, dead_time, 1e-9, moved=softened)[-1])
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
    belief = learn(PRIOR, MODEL, DEAD, 0j, span, moved(MODEL, DEAD + 60e-6, 0j, span))
    assert -0.07 < belief.kappa < 0.0
    assert -150.0 < belief.w0 <= 0.0


somewhere = st.tuples(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.floats(-2e3, 2e3))


@given(
    at=somewhere,
    dead_time=st.sampled_from([0.0, 250e-6, DEAD]),
    W=st.builds(cmath.rect, st.floats(0.0, 2e-6), st.floats(-3.0, 3.0)),
    voltages=st.tuples(st.floats(0.0, 100.0), st.floats(0.0, 100.0)),
    off=st.floats(-2e3, 2e3),
)
@settings(max_examples=50)
def test_a_prediction_is_the_plates_and_its_derivatives_are_those_of_the_plate(
    at, dead_time, W, voltages, off
):
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


def test_a_jump_of_the_voltage_is_what_an_instant_told_wrongly_shifts():
    """By the voltage it differs by, over the jitter: the derivative by the dead time."""
    span = Span(10.0, W0, 40.0, W0)
    late = _predict(PRIOR, MODEL, DEAD, 0j, span, 1e-6)[1]
    slope = (moved(MODEL, DEAD + 1e-7, 0j, span) - moved(MODEL, DEAD - 1e-7, 0j, span)) / 2e-7
    assert late == pytest.approx(-_JITTER * slope, rel=1e-2)
    assert _predict(PRIOR, MODEL, DEAD, 0j, Span(40.0, W0, 40.0, W0), 1e-6)[1] == 0j


def test_a_prediction_is_as_unsure_as_two_readings_and_more_so_of_a_large_or_jumping_one():
    def variance(W, V_before, V):
        return _predict(PRIOR, MODEL, DEAD, W, Span(V_before, W0, V, W0), 1e-6)[-1]

    still = variance(0j, 0.0, 0.0)
    # The older reading decays by the tick.
    assert still / _NOISE**2 == pytest.approx(1.0 + math.exp(-2.0 * MODEL.rate * 1e-3))
    steady = MODEL.kappa * 20.0 / MODEL.rate
    large = variance(complex(steady), 20.0, 20.0) - still
    assert large / steady**2 == pytest.approx(_UNMODELLED**2, rel=1e-9, abs=0.0)
    # What a jump starts of the other oscillation, at twice the frequency, is 1/(2 w0) of it.
    reached = abs(moved(MODEL, DEAD, 0j, Span(0.0, W0, 20.0, W0)))
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


def test_what_was_learned_is_forgotten_in_10_s_and_of_the_damping_in_20_ms():
    """Of the variance that is left out by then e^-2; what hangs together keeps to it."""
    sure = PRIOR._replace(kk=0.0, rr=0.0, ww=0.0, ss=0.0)
    for tick in range(10_001):
        if tick == 20:
            assert sure.rr / PRIOR.rr == pytest.approx(1.0 - math.exp(-2.0), rel=0.02)
        sure = fade(sure, 0.0)
    assert sure.kk / PRIOR.kk == pytest.approx(1.0 - math.exp(-2.0), rel=0.01)
    assert sure.ww / PRIOR.ww == pytest.approx(1.0 - math.exp(-2.0), rel=0.01)
    assert sure.ss / PRIOR.ss == pytest.approx(1.0 - math.exp(-0.2), rel=0.01)
    assert sure.rr == pytest.approx(PRIOR.rr)


def test_a_finger_that_presses_makes_the_resonance_unsure_as_well():
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


@pytest.mark.parametrize("dead_time", [0.0, DEAD])
def test_a_drive_was_missed_if_the_one_before_explains_nearly_all_that_is_off(dead_time):
    span, W = Span(10.0, W0, 60.0, W0), 0.4e-6 + 0j
    kept = moved(MODEL, dead_time, W, first_lasting(span))
    came = moved(MODEL, dead_time, W, span)
    assert abs(came - kept) > 5.0 * _MISSED_FROM

    def is_missed(share):
        return missed(PRIOR, MODEL, dead_time, W, span, kept + share * (came - kept))

    assert [is_missed(share) for share in (0.0, 0.08, 0.12, 0.5, 1.0)] == [
        True,
        True,
        False,
        False,
        False,
    ]
    # What is off by next to nothing is no drive that was lost.
    for change, lost in ((0.9, False), (1.1, True)):
        small = Span(10.0, W0, 10.0 + 50.0 * change * _MISSED_FROM / abs(came - kept), W0)
        still = moved(MODEL, dead_time, W, first_lasting(small))
        assert missed(PRIOR, MODEL, dead_time, W, small, still) == lost


@pytest.mark.parametrize(
    ("left", "lost"),
    [(0.08, True), (0.12, False), (-0.12, False), (0.05 + 0.25j, True), (0.05 - 0.25j, True),
     (0.05 + 0.35j, False), (0.05 - 0.35j, False)],
)  # fmt: skip
def test_a_lost_drive_may_leave_a_tenth_along_the_error_and_three_tenths_across(left, lost):
    span, W = Span(10.0, W0, 60.0, W0), 0.4e-6 + 0j
    kept = moved(MODEL, DEAD, W, first_lasting(span))
    came = moved(MODEL, DEAD, W, span)
    # From here ``left`` of the way from what was asked for is still to go to what was kept.
    assert missed(PRIOR, MODEL, DEAD, W, span, (kept - left * came) / (1.0 - left)) == lost


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
    assert learn(learned, MODEL, DEAD, bad, Span(0.0, W0, 30.0, W0), 1e-6 + 0j) == PRIOR
    assert learn(learned, MODEL, DEAD, 1e-6 + 0j, Span(0.0, W0, 30.0, W0), bad) == PRIOR

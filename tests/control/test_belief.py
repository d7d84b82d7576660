import cmath
import math
import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from smarttac_can.control.belief import PRIOR, PlateNow, Span, believed, fade, learn

W0 = 2 * math.pi * 43390.0
MODEL = PlateNow(kappa=53e-6, rate=1060.0, w0=W0)
DEAD = 540e-6


def moved(plate, dead_time, W, span):
    """The plate, written the other way round: as a decay towards its steady state."""
    for V, w, time in ((span[0], span[1], dead_time), (span[2], span[3], 1e-3 - dead_time)):
        turn = complex(-plate.rate, plate.w0 - w)
        steady = -plate.kappa * V / turn
        W = steady + (W - steady) * cmath.exp(turn * time)
    return W


def watched(plate, voltages, dead_time=DEAD, noise=0.0, belief=PRIOR, w=W0):
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
    plate = PlateNow(53e-6 * gain / tau, 1060.0 / tau, W0 + 2 * math.pi * off)
    voltages = [30.0] * 8 + [20.0] * 8 + [30.0] * 8
    found = believed(MODEL, watched(plate, voltages, dead_time, noise=1e-9)[-1])
    assert found.kappa == pytest.approx(plate.kappa, rel=0.06)
    assert found.rate == pytest.approx(plate.rate, rel=0.06)
    assert (found.w0 - plate.w0) / (2 * math.pi) == pytest.approx(0.0, abs=10.0)


def test_the_phase_of_one_tick_tells_the_resonance():
    plate = PlateNow(53e-6, 1060.0, W0 + 2 * math.pi * 200.0)
    belief = watched(plate, [30.0])[-1]
    assert belief.w0 / (2 * math.pi) == pytest.approx(200.0, abs=15.0)


def test_a_steady_vibration_is_explained_whichever_plate_it_is():
    plate = PlateNow(53e-6 * 1.2, 1060.0 * 1.3, W0 + 300.0)
    belief = watched(plate, [20.0] * 200, noise=1e-9)[-1]
    found = believed(MODEL, belief)
    there, here = (-p.kappa * 20.0 / complex(-p.rate, p.w0 - W0) for p in (plate, found))
    assert abs(here - there) < 0.01 * abs(there)


def test_at_rest_nothing_is_learned():
    belief = watched(MODEL, [0.0] * 100)[-1]
    assert belief[:3] == (0.0, 0.0, 0.0)
    assert belief[3:] == pytest.approx(PRIOR[3:])


def test_what_was_learned_grows_as_old_as_its_memory():
    sure = PRIOR._replace(kk=0.0, rr=0.0, ww=0.0)
    for _ in range(20):
        sure = fade(sure, 0.0)
    # 20 ms: kappa is still known, 1/tau is not.
    assert sure.kk < 0.01 * PRIOR.kk
    assert sure.rr > 0.8 * PRIOR.rr


def test_another_load_is_not_known():
    assert fade(PRIOR, 0.3).rr == pytest.approx(PRIOR.rr + 0.09)


def test_a_drive_that_came_late_is_not_another_plate():
    """60 us later than told, W lacks 10 % after the first tick."""
    span = Span(0.0, W0, 30.0, W0)
    belief = learn(PRIOR, MODEL, DEAD, 0j, span, moved(MODEL, DEAD + 60e-6, 0j, span))
    assert -0.07 < belief.kappa < 0.0


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
        assert min(belief.kk, belief.rr, belief.ww) > 0.0


@pytest.mark.parametrize("bad", [complex(math.nan, 0.0), complex(0.0, math.inf)])
def test_no_number_gives_the_model_back(bad):
    learned = watched(PlateNow(60e-6, 1000.0, W0), [30.0] * 5)[-1]
    assert learn(learned, MODEL, DEAD, bad, Span(0.0, W0, 30.0, W0), 1e-6 + 0j) == PRIOR
    assert learn(learned, MODEL, DEAD, 1e-6 + 0j, Span(0.0, W0, 30.0, W0), bad) == PRIOR

"""The functions of the inner loops: the PI without windup, and the limits of its input."""

import math

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from smarttac_can.science.control.vibration import (
    AMPLITUDE_MIN,
    allowed_amplitude,
    cut_voltage,
    in_limits,
    lost,
    regulated,
)

number = st.floats(-1e3, 1e3)
FAR = 1e9


def run(errors, limit, state=0.0):
    outputs, cut = [], []
    for error in errors:
        output, state, limited = regulated(state, 2.0, 0.25, error, -limit, limit)
        outputs.append(output)
        cut.append(limited)
    return outputs, cut


def test_difference_equation():
    # u[k] = u[k-1] + 2 e[k] - 0.5 e[k-1]
    assert run([1.0, 1.0, 0.0, -1.0], FAR) == ([2.0, 3.5, 3.0, 1.0], [False] * 4)


def test_a_thousand_ticks_at_the_limit_leave_no_windup():
    outputs, cut = run([10.0] * 1000 + [2.0, -10.0], 5.0)
    assert outputs[:1000] == [5.0] * 1000
    # The limit is left in the very tick in which the error falls.
    assert outputs[1000] == pytest.approx(5.0 + 2.0 * 2.0 - 0.5 * 10.0)
    assert outputs[1001] == -5.0
    assert cut == [True] * 1000 + [False, True]


@pytest.mark.parametrize("output", [-5.0, 5.0])
def test_an_output_at_its_limit_is_not_cut(output):
    assert regulated(output, 2.0, 0.25, 0.0, -5.0, 5.0) == (output, output, False)


@given(Kp=number, a=st.floats(0.0, 1.0), output=number, error=number)
@settings(max_examples=50)
def test_an_output_as_state_is_bumpless(Kp, a, output, error):
    assert regulated(output, Kp, a, 0.0, -FAR, FAR)[0] == output
    first, _, _ = regulated(output, Kp, a, error, -FAR, FAR)
    assert abs(first - output) <= abs(Kp * error) * (1.0 + 1e-9) + 1e-9


references = st.floats(-1.0, 1.0) | st.just(math.nan)
vibrations = st.builds(complex, st.floats(-4e-6, 4e-6), st.floats(-4e-6, 4e-6))


@given(W_ref=references.map(lambda share: 6e-6 * share), W=vibrations, tracked=st.booleans())
@example(W_ref=3e-6, W=0.05e-6 + 0.05e-6j, tracked=True)
@example(W_ref=3e-6, W=1e-6 + 1e-6j, tracked=False)
def test_amplitude_reference_is_cut_and_lowered_during_search(W_ref, W, tracked):
    allowed = allowed_amplitude(W_ref, 3e-6, W, abs(W), tracked)
    within = 3e-6 if math.isnan(W_ref) else min(max(W_ref, 0.0), 3e-6)
    assert 0.0 <= allowed <= within
    if allowed < within:
        assert tracked
        assert abs(W) > AMPLITUDE_MIN


@pytest.mark.parametrize(("tangent", "lowered"), [(0.4, False), (0.6, True), (-0.6, True)])
def test_amplitude_reference_leaves_room_for_overshoot(tangent, lowered):
    """It overshoots by up to 29 %, and the range of the pick-up is 9 % more than the limit."""
    W = complex(1e-6, 1e-6 * tangent)
    allowed = allowed_amplitude(3e-6, 3e-6, W, abs(W), True)
    assert (allowed < 3e-6) == lowered
    if lowered:
        assert 0.85 * 3.27e-6 < 1.29 * allowed < 3.27e-6
        assert allowed_amplitude(0.9 * allowed, 3e-6, W, abs(W), True) == 0.9 * allowed


@given(V=st.floats(-1e3, 1e3), f=st.floats(40_000.0, 46_000.0))
@example(V=-0.0, f=43_000.0)
@example(V=100.0, f=44_000.0)
@example(V=0.0, f=42_000.0)
@example(V=math.nan, f=43_000.0)
@example(V=50.0, f=math.nan)
def test_a_drive_goes_out_within_limits_alone(V, f):
    within = 0.0 <= V <= 100.0 and 42_000.0 <= f <= 44_000.0
    assert in_limits(V, f, 100.0, 42_000.0, 44_000.0) == within
    cut = cut_voltage(V, 100.0)
    if math.isnan(V):
        assert math.isnan(cut)
    else:
        assert cut == min(max(V, 0.0), 100.0)
        assert math.copysign(1.0, cut) == 1.0
        assert cut_voltage(cut, 100.0) == cut


def test_the_phase_counts_from_a_tenth_of_a_um_on():
    for size, frozen in ((0.09e-6, True), (0.11e-6, False)):
        assert lost(complex(size), size) == frozen

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from smarttac_can.control.vibration import regulated

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


@given(Kp=number, a=st.floats(0.0, 1.0), output=number, error=number)
@settings(max_examples=50)
def test_an_output_as_state_is_bumpless(Kp, a, output, error):
    assert regulated(output, Kp, a, 0.0, -FAR, FAR)[0] == output
    first, _, _ = regulated(output, Kp, a, error, -FAR, FAR)
    assert abs(first - output) <= abs(Kp * error) * (1.0 + 1e-9) + 1e-9

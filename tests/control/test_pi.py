import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from smarttac_can.control.pi import PI

number = st.floats(-1e3, 1e3)


def test_difference_equation():
    pi = PI(2.0, 0.25)
    outputs = []
    for error in (1.0, 1.0, 0.0, -1.0):
        u = pi.compute(error)
        pi.update(error, u)
        outputs.append(u)
    # u[k] = u[k-1] + 2 e[k] - 0.5 e[k-1]
    assert outputs == [2.0, 3.5, 3.0, 1.0]


def test_compute_changes_nothing():
    pi = PI(2.0, 0.25)
    pi.preset(1.0)
    assert pi.compute(3.0) == pi.compute(3.0) == 7.0


def test_a_thousand_ticks_at_the_limit_leave_no_windup():
    pi = PI(2.0, 0.25)
    for _ in range(1000):
        assert pi.compute(10.0) > 5.0
        pi.update(10.0, 5.0)
    # The limit is left in the very tick in which the error falls.
    assert pi.compute(2.0) == pytest.approx(5.0 + 2.0 * 2.0 - 0.5 * 10.0)
    assert pi.compute(2.0) < 5.0


@given(Kp=number, a=st.floats(0.0, 1.0), output=number, error=number)
@settings(max_examples=50)
def test_preset_is_bumpless(Kp, a, output, error):
    pi = PI(Kp, a)
    pi.update(123.0, 456.0)
    pi.preset(output)
    assert pi.compute(0.0) == output
    assert abs(pi.compute(error) - output) <= abs(Kp * error) * (1.0 + 1e-9) + 1e-9

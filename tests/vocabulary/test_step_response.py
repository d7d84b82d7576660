"""The response to a switched voltage: exact without noise, and known to be unknown."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from smarttac_can.vocabulary.step_response import _unbiased, step_response

W, OFFSET, NOISE, TICK = 2e-6, 1e-8, 1e-9, 1e-3


@pytest.mark.parametrize("delay", [0.0, 0.3e-3, 1.2e-3])
@pytest.mark.parametrize("A", [0.3, 0.6])
def test_exact_decay_gives_its_delay_with_its_uncertainty(A: float, delay: float) -> None:
    tau = -TICK / math.log(A)
    holds, last = [], OFFSET
    for number in range(8):
        target = OFFSET + W * (number % 2)
        change = (last - target) * math.exp((delay - TICK) / tau)
        holds.append([target + change * A**k for k in range(24)])
        last = target
    response = step_response(holds, OFFSET, NOISE)
    assert pytest.approx(A, rel=1e-6) == response.A
    assert pytest.approx(W, rel=1e-6) == response.W
    assert response.delay == pytest.approx(delay, abs=1e-8)
    left = math.exp((delay - 2 * TICK) / tau)
    assert response.unsure == pytest.approx(tau * NOISE / (math.sqrt(7) * W * left), rel=1e-5)
    assert response.tolerance == pytest.approx(100e-6 + 5.0 * response.unsure)


def test_delay_is_unknown_for_a_response_gone_after_two_ticks() -> None:
    # All sums of these powers of two are exact.
    off = [2.0 ** (16 - k) for k in range(17)]
    on = [64.0 + w for w in off]
    response = step_response([off, on, off], 0.0, NOISE)
    assert (response.A, response.W) == (0.5, 64.0)
    assert (response.delay, response.unsure) == (2e-3, math.inf)


@given(a=st.floats(0.05, 0.85), square=st.floats(1e-14, 1e-9), noise=st.floats(0.0, 1.0))
@settings(max_examples=50)
def test_noise_in_both_samples_does_not_shorten_the_decay(
    a: float, square: float, noise: float
) -> None:
    both = noise * square
    assert _unbiased(a * square + 0j, square + both, a * a * square + both) == pytest.approx(a)

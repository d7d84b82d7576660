import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from smarttac_can.science.plant.force_path import follow, propagator


def test_agrees_with_the_differential_equation():
    w, damping = 2 * math.pi * 100.0, 0.7
    forces = [0.0, 1.0, 1.0, -0.5, 0.2, 0.2]
    phi = propagator(1e-3, 100.0, damping)
    path, rate = 0.0, 0.0
    y = np.zeros(2)
    for force in forces:
        path, rate = follow(phi, path, rate, force)
        y = solve_ivp(
            lambda _, y, f=force: [y[1], w * w * (f - y[0]) - 2 * damping * w * y[1]],
            (0.0, 1e-3), y, rtol=1e-11, atol=1e-14,
        ).y[:, -1]  # fmt: skip
        assert path == pytest.approx(y[0], abs=1e-9)
        assert rate == pytest.approx(y[1], abs=1e-6)


def test_two_half_steps_are_one():
    one, _ = follow(propagator(1e-3, 100.0, 0.7), 0.0, 0.0, 0.3)
    half = propagator(0.5e-3, 100.0, 0.7)
    two, _ = follow(half, *follow(half, 0.0, 0.0, 0.3), 0.3)
    assert two == pytest.approx(one, rel=1e-12)

"""Closed forms beside numeric integration."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from smarttac_can.timing.frozen_stage import FrozenStage, frozen_stage
from smarttac_can.vocabulary.model import PlateModel


def integrated(deadline_ms: float, tau_ms: float, start: float) -> tuple[float, float, float]:
    """Share reached, time until below 5 %, and dose in ms, by integration."""

    def part(duration: float, final: float, W: float, dose: float) -> tuple[np.ndarray, ...]:
        times = np.linspace(0.0, duration, 20_001)
        solution = solve_ivp(
            lambda _, y: [(final - y[0]) / tau_ms, y[0] ** 2],
            (0.0, duration),
            [W, dose],
            t_eval=times,
            rtol=1e-10,
            atol=1e-12,
        )
        return times, *solution.y

    _, rising, dose = part(deadline_ms, 1.0, start, 0.0)
    times, falling, doses = part(30.0 * tau_ms, 0.0, rising[-1], dose[-1])
    return rising[-1], deadline_ms + times[np.argmax(falling < 0.05)], doses[-1]


@pytest.mark.parametrize("deadline", [0.5, 3.0, 10.0, 20.0])
@pytest.mark.parametrize("tau", [0.944, 3.0])
def test_the_closed_forms(deadline: float, tau: float) -> None:
    stage = FrozenStage(deadline, tau, 150.0, 7.5)
    reached, quiet, dose = integrated(deadline, tau, 0.0)
    assert stage.reached == pytest.approx(reached, abs=1e-6)
    assert stage.quiet_ms == pytest.approx(quiet, abs=30.0 * tau / 20_000)
    assert stage.dose_from_rest == pytest.approx(dose, rel=1e-6)
    assert stage.dose_from_final == pytest.approx(integrated(deadline, tau, 1.0)[2], rel=1e-6)


def test_the_default_limits() -> None:
    shortest = frozen_stage(3).as_json()
    assert shortest == {
        "voltage_v": 150.0,
        "final_um": 7.5,
        "reached_share": 0.9583,
        "below_5_percent_ms": 5.79,
        "dose_ratio": 1.0,
        "dose_ratio_from_rest": 1.0,
    }
    assert frozen_stage(3).tau_ms == pytest.approx(PlateModel().tau * 1e3, rel=1e-3)
    ten, twenty = frozen_stage(10).as_json(), frozen_stage(20).as_json()
    assert ten["reached_share"] == pytest.approx(1.0, abs=1e-4)
    assert (ten["below_5_percent_ms"], twenty["below_5_percent_ms"]) == (12.83, 22.83)
    assert (ten["dose_ratio"], twenty["dose_ratio"]) == (3.02, 5.9)
    assert (ten["dose_ratio_from_rest"], twenty["dose_ratio_from_rest"]) == (4.32, 9.09)

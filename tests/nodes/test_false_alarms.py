"""How often noise alone looks like a stuck sensor, by the constants of the simulated plate."""

from math import erf, sqrt

import pytest

from smarttac_can.plant.parameters import SensorParameters
from smarttac_can.vocabulary.watchdogs import STUCK_GAUGE_CYCLES, STUCK_THERMOMETER_CYCLES

CYCLES_PER_HOUR = 3_600_000
P = SensorParameters()


def alarms_per_hour(noise: float, resolution: float, cycles: int, sensors: int) -> float:
    """Windows of equal samples, the true value in the middle of a count: there are most."""
    s = noise / resolution

    def below(count: float) -> float:
        return 0.5 * (1.0 + erf(count / (s * sqrt(2.0))))

    reach = int(8 * s) + 1
    shares = (below(k + 0.5) - below(k - 0.5) for k in range(-reach, reach + 1))
    return sensors * CYCLES_PER_HOUR * sum(share**cycles for share in shares)


@pytest.mark.parametrize(
    ("noise", "resolution", "cycles", "sensors", "expected"),
    [
        (P.gauge_noise, P.gauge_resolution, STUCK_GAUGE_CYCLES, 6, 3e-16),
        (P.pickup_noise, P.pickup_resolution, STUCK_GAUGE_CYCLES, 2, 9e-10),
        (P.temperature_noise, P.temperature_resolution, STUCK_THERMOMETER_CYCLES, 1, 1e-10),
    ],
    ids=["gauges", "pick-up", "thermometer"],
)
def test_false_alarms_an_hour(
    noise: float, resolution: float, cycles: int, sensors: int, expected: float
) -> None:
    assert alarms_per_hour(noise, resolution, cycles, sensors) == pytest.approx(expected, rel=0.1)

"""How often noise alone looks like a stuck sensor, by the constants of the simulated plate."""

from math import erf, sqrt

import pytest

from smarttac_can.plant.parameters import SensorParameters
from smarttac_can.vocabulary.watchdogs import (
    STUCK_GAUGE_CYCLES,
    STUCK_THERMOMETER_CYCLES,
    STUCK_WITHIN,
)

CYCLES_PER_HOUR = 3_600_000
P = SensorParameters()


def alarms_per_hour(
    noise: float, resolution: float, within: int, cycles: int, sensors: int
) -> float:
    """Windows of samples near the first; most with the true value in the middle of a count."""
    s = noise / resolution

    def below(count: float) -> float:
        return 0.5 * (1.0 + erf(count / (s * sqrt(2.0))))

    reach = int(8 * s) + 1
    return (
        sensors
        * CYCLES_PER_HOUR
        * sum(
            (below(k + 0.5) - below(k - 0.5))
            * (below(k + within + 0.5) - below(k - within - 0.5)) ** (cycles - 1)
            for k in range(-reach, reach + 1)
        )
    )


@pytest.mark.parametrize(
    ("noise", "resolution", "within", "cycles", "sensors", "expected"),
    [
        (P.gauge_noise, P.gauge_resolution, 2, 24, 6, 9.3e-25),
        (P.pickup_noise, P.pickup_resolution, 2, 24, 2, 9.2e-11),
        (P.temperature_noise, P.temperature_resolution, 0, 100, 1, 1e-10),
    ],
    ids=["gauges", "pick-up", "thermometer"],
)
def test_false_alarms_an_hour(
    noise: float, resolution: float, within: int, cycles: int, sensors: int, expected: float
) -> None:
    alarms = alarms_per_hour(noise, resolution, within, cycles, sensors)
    assert alarms == pytest.approx(expected, rel=0.1, abs=0.0)


def test_the_numbers_are_those_of_the_watch() -> None:
    assert (STUCK_WITHIN, STUCK_GAUGE_CYCLES, STUCK_THERMOMETER_CYCLES) == (2, 24, 100)

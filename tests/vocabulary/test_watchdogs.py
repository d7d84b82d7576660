"""The table of the watchdogs, and how often noise alone looks like a stuck sensor."""

from math import erf, sqrt

import pytest

from smarttac_can.science.plant.parameters import SensorParameters
from smarttac_can.vocabulary.watchdogs import (
    STUCK_GAUGE_CYCLES,
    STUCK_THERMOMETER_CYCLES,
    STUCK_WITHIN,
    WATCHDOGS,
    Watchdog,
    level,
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
        (P.gauge_noise, P.gauge_resolution, STUCK_WITHIN, STUCK_GAUGE_CYCLES, 6, 9.3e-25),
        (P.pickup_noise, P.pickup_resolution, STUCK_WITHIN, STUCK_GAUGE_CYCLES, 2, 9.2e-11),
        (P.temperature_noise, P.temperature_resolution, 0, STUCK_THERMOMETER_CYCLES, 1, 1e-10),
    ],
    ids=["gauges", "pick-up", "thermometer"],
)
def test_false_alarms_an_hour(
    noise: float, resolution: float, within: int, cycles: int, sensors: int, expected: float
) -> None:
    alarms = alarms_per_hour(noise, resolution, within, cycles, sensors)
    assert alarms == pytest.approx(expected, rel=0.1, abs=0.0)


def test_every_code_is_its_own() -> None:
    codes = [row.code for row in WATCHDOGS.values()]
    assert list(WATCHDOGS) == list(Watchdog)
    assert len(set(codes)) == len(codes)
    assert all(row.why and row.text for row in WATCHDOGS.values())


def test_level_of_a_limit_of_0() -> None:
    assert level(0.0, 0.0) == 0.0
    assert level(0.1, 0.0) == float("inf")
    assert level(1.0, 4.0) == 0.25

"""Make the tables of the COF's uncertainty in explanation/plant.md; some seconds.

Gauges are drawn by their data sheet, with their sensitivity trimmed to 1 %. Each set is calibrated
at 20 degC with the weights of how-to/tribometer.md, and tared there; then it reads random strokes.
The first table has the share of variance of each component in the mean calibration. The second has,
as GUM supplement 1 does, how many of the readings are within twice u(mu) of the true COF.

Example: tools/pages/make uncertainty --check
"""

from __future__ import annotations

from math import cos, sin, tau
from typing import Final, NamedTuple

import numpy as np
from pages import EXPLANATION, Pages, columns, made, renewed

from smarttac_can.bench.calibration import (
    BUDGET_COF,
    BUDGET_FORCES,
    BUDGET_TEMPERATURES,
    Calibration,
)
from smarttac_can.bench.plate_loads import STANDARD_GRAVITY, Placing, Weighing
from smarttac_can.science.control.budget import (
    COVERAGE,
    budget,
    combined,
    stated,
)
from smarttac_can.science.control.tribometer import (
    UNTOUCHED,
    contact_of,
    gauging_of,
)
from smarttac_can.science.plant.parameters import SensorParameters
from smarttac_can.science.plant.sensors import CHANNELS, Weight, loaded, readings

SEED: Final = 54
PLATES: Final = 1000
TRIMMED: Final = 0.01
CALIBRATED_AT: Final = 20.0
PLAN: Final = [Placing(200, 30, azimuth, 0) for azimuth in (0, 90, 180, 270)] + [
    Placing(300, 0, 0, x_mm) for x_mm in (-20, 20)
]
PAGE: Final = EXPLANATION / "plant.md"


class Reading(NamedTuple):
    """A reading of the COF beside the true one."""

    error: float
    uncertainty: float


def gauges_under(
    rng: np.random.Generator, sensors: SensorParameters, weight: Weight, at: float, mean_of: int
) -> tuple[float, ...]:
    """Return S1..S6 in N as the mean of so many samples within one error of repeatability."""
    noise = np.zeros(CHANNELS)
    noise[:6] = rng.normal(0.0, sensors.gauge_noise / np.sqrt(mean_of), 6)
    noise[9:] = rng.standard_normal(6)
    return readings(loaded(sensors, weight), noise.tolist(), 0j, at, (0.0, 0.0, 0.0))[1]


def calibrated(rng: np.random.Generator, sensors: SensorParameters) -> Calibration:
    """Return the calibration of a plate with these sensors by the weights of the page."""
    weighings = []
    for placing in PLAN:
        Fx, Fy, Fn = placing.load(STANDARD_GRAVITY)
        on = Weight(Fx, Fy, Fn, placing.x_mm * 1e-3 if placing.level else 0.0)
        empty, full = (
            np.array(gauges_under(rng, sensors, weight, CALIBRATED_AT, 64))
            for weight in (Weight(), on)
        )
        weighings.append(Weighing(placing, empty, full))
    return Calibration.fit(weighings, (-28.0, 28.0, -28.0, 28.0))


def reading(
    rng: np.random.Generator,
    sensors: SensorParameters,
    calibration: Calibration,
    Fn: float,
    temperature: float,
) -> Reading:
    """Return a reading of a random stroke with this normal force at this temperature."""
    lateral, positions, gauges = calibration.lateral, calibration.positions_mm, calibration.gauges
    assert lateral is not None and positions is not None and gauges is not None
    xx, xy, yx, yy = lateral
    x3, x4, x5, x6 = (1e-3 * mm for mm in positions)
    said = stated(gauges, CALIBRATED_AT)
    gauging = gauging_of(((xx, xy), (yx, yy)), (x3, x4, x5, x6), sensors.gauge_noise, 0.01, said)
    mu, angle, x = rng.uniform(0.2, 0.9), rng.uniform(0.0, tau), rng.uniform(-15e-3, 15e-3)
    stroke = Weight(mu * Fn * cos(angle), mu * Fn * sin(angle), Fn, x)
    zero = gauges_under(rng, sensors, Weight(), CALIBRATED_AT, 64)
    raw = gauges_under(rng, sensors, stroke, temperature, 1)
    _, contact, _ = contact_of(gauging, zero, UNTOUCHED, raw, temperature)  # type: ignore[arg-type]
    return Reading(contact[3] - mu, contact[4])


def readings_of(
    seed: int, plates: int, trimmed: float = TRIMMED
) -> tuple[list[Calibration], dict[tuple[float, float], list[Reading]], int]:
    """Return calibrations, readings by temperature and normal force, and the plates refused."""
    rng = np.random.default_rng(seed)
    calibrations, refused = [], 0
    found: dict[tuple[float, float], list[Reading]] = {
        (at, Fn): [] for at in BUDGET_TEMPERATURES for Fn in BUDGET_FORCES
    }
    for serial in range(plates):
        sensors = SensorParameters.data_sheet(serial, sensitivity=trimmed)
        calibration = calibrated(rng, sensors)
        if calibration.shortcomings():
            refused += 1
            continue
        calibrations.append(calibration)
        for (at, Fn), rows in found.items():
            rows.append(reading(rng, sensors, calibration, Fn, at))
    return calibrations, found, refused


def covered(rows: list[Reading]) -> float:
    """Return the fraction of readings that are within twice their uncertainty."""
    return float(np.mean([abs(row.error) <= COVERAGE * row.uncertainty for row in rows]))


def pages(_: bool, seed: int) -> Pages:
    """Return the page with its tables made anew."""
    calibrations, found, refused = readings_of(seed, PLATES)
    untrimmed = readings_of(seed, PLATES, 0.17)[2]
    shares, coverage = [], []
    for (at, Fn), rows in found.items():
        parts = [
            budget(gauges, BUDGET_COF, Fn, at - CALIBRATED_AT)
            for calibration in calibrations
            if (gauges := calibration.gauges)
        ]
        squares = {name: np.mean([part[name] ** 2 for part in parts]) for name in parts[0]}
        total = sum(squares.values())
        u = float(np.mean([combined(part) for part in parts]))
        place = (f"{at:g}", f"{Fn:g}")
        percents = (f"{100 * square / total:.0f}" for square in squares.values())
        shares.append((*place, f"{u:.4f}", *percents))
        spread = float(np.sqrt(np.mean([row.error**2 for row in rows])))
        stated = float(np.sqrt(np.mean([row.uncertainty**2 for row in rows])))
        coverage.append((*place, f"{stated:.4f}", f"{spread:.4f}", f"{100 * covered(rows):.1f}"))
    names = " | ".join(parts[0])
    return renewed(
        PAGE,
        {
            "shares": columns(f"degC | N | u(mu) | {names}", shares),
            "coverage": columns("degC | N | u(mu) | error rms | within 2 u, %", coverage),
            "refused": f"{100 * refused / PLATES:.1f} %",
            "untrimmed": f"{100 * untrimmed / PLATES:.0f} %",
        },
    )


def main() -> int:
    """Make the page, or compare it."""
    return made(__doc__, pages, SEED)

"""The budget of the COF agrees with its closed forms, and with simulated gauges."""

from __future__ import annotations

import math

import numpy as np
import pytest

from smarttac_can.science.control.budget import (
    Component,
    Gauges,
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
from smarttac_can.science.plant.sensors import Weight, loaded, noise_block, readings

NONE = Gauges(*[0.0] * len(Gauges._fields))
MU, FN, WARMER = 0.4, 0.5, 15.0
BY_HAND = {
    "noise": (NONE._replace(noise=4.3e-3), 4.3e-3 * math.sqrt(1.64) / FN),
    "repeatability": (NONE._replace(repeatability=0.02), MU * 0.02 * math.sqrt(1.25)),
    "sensitivity": (NONE._replace(sensitivity_t=0.03, sensitivity_n=0.04), MU * 0.05),
    "weights": (NONE._replace(weights=0.01), 0.0),
    "drift": (NONE._replace(drift=1e-3), 15e-3 * math.sqrt(1.64) / FN),
    "cross-talk": (NONE._replace(crosstalk=0.01), MU * 0.01),
    "temperature": (NONE._replace(shift=1e-3), MU * 0.015 * math.sqrt(1.25)),
    "linearity": (NONE._replace(bow=2e-3), MU * 2e-3 * FN * math.hypot(MU, 0.125)),
}


@pytest.mark.parametrize("name", BY_HAND)
def test_component_alone_has_its_closed_form(name: str) -> None:
    gauges, expected = BY_HAND[name]
    parts = budget(gauges, MU, FN, WARMER)
    assert parts[name] == pytest.approx(expected, abs=1e-12)
    assert combined(parts) == pytest.approx(expected, abs=1e-12)
    assert budget(gauges, MU, FN, -WARMER) == parts
    assert parts.keys() == BY_HAND.keys()


def test_opposite_errors_of_both_forces_add() -> None:
    assert Component(0.01, 0.02, -1.0).of_cof(0.5, 1.0) == pytest.approx(0.02)
    assert Component(0.01, 0.02).of_cof(0.5, 1.0) == pytest.approx(0.01 * math.sqrt(2.0))


def test_sample_uncertainty_is_that_of_the_budget() -> None:
    """Linearity is taken at 2 N, so it is left out here."""
    gauges = Gauges(sensitivity_t=0.01, sensitivity_n=0.006, crosstalk=0.002, bow=0.0)
    gauging = gauging_of(
        ((1.0, 0.0), (0.0, 1.0)),
        (-28e-3, 28e-3, -28e-3, 28e-3),
        gauges.noise,
        0.1,
        stated(gauges, 21.0),
    )
    for Fn in (0.2, 0.5, 1.0, 2.0):
        for temperature in (21.0, 35.0, 10.0):
            raw = (MU * Fn, 0.0, *[Fn / 4.0] * 4)
            _, contact, _ = contact_of(gauging, (0.0,) * 6, UNTOUCHED, raw, temperature)
            expected = combined(budget(gauges, MU, Fn, temperature - 21.0))
            assert contact[4] == pytest.approx(expected)


IDEAL = {"null": 0.0, "drift": 0.0, "linearity": 0.0, "gauge_noise": 0.0}
SHEET = Gauges()
ALONE = {
    "noise": {"gauge_noise": 4.3e-3},
    "repeatability": {"repeatability": SensorParameters.data_sheet().repeatability},
    "sensitivity": {"sensitivity": 0.17},
    "drift": {"drift": SensorParameters().drift},
    "temperature": {"sensitivity_shift": SensorParameters.data_sheet().sensitivity_shift},
    "linearity": {"linearity": 0.22},
}


def measured_cof(serial: int, mu: float, Fn: float, at: float, **figures: float) -> float:
    """Return the COF that gauges with these figures measure, tared at 20 degC."""
    sensors = SensorParameters(
        serial=serial, crosstalk=((1.0, 0.0), (0.0, 1.0)), **{**IDEAL, **figures}
    )
    noise = noise_block(sensors, serial, 0)[0].tolist()
    still = (0.0, 0.0, 0.0)
    on = loaded(sensors, Weight(Fx=mu * Fn, Fn=Fn))
    zero = readings(loaded(sensors, Weight()), [0.0] * len(noise), 0j, 20.0, still)[1]
    raw = readings(on, noise, 0j, at, still)[1]
    gauging = gauging_of(((1.0, 0.0), (0.0, 1.0)), (-28e-3, 28e-3, -28e-3, 28e-3), 0.0, 0.01)
    return contact_of(gauging, zero, UNTOUCHED, raw, at)[1][3]


@pytest.mark.parametrize("name", ALONE)
def test_simulated_gauges_spread_as_a_component_says(name: str) -> None:
    """Within 6 % over 1500 plates; 4 % are two standard deviations of a normal spread."""
    Fn = 1.5 if name == "linearity" else 0.8
    errors = [measured_cof(serial, MU, Fn, 30.0, **ALONE[name]) - MU for serial in range(1500)]
    expected = budget(SHEET, MU, Fn, 10.0)[name]
    assert math.sqrt(np.mean(np.square(errors))) == pytest.approx(expected, rel=0.06)

import dataclasses
import math

import pytest

from smarttac_can.plant.parameters import (
    PlateParameters,
    ResonatorParameters,
    SensorParameters,
    ThermalParameters,
    require,
)
from smarttac_can.plant.subjects import SUBJECTS, random_subjects


def test_time_constant_and_quality_follow_from_the_30_percent():
    plate = ResonatorParameters()
    assert plate.tau == pytest.approx(0.944e-3, abs=0.5e-6)
    assert math.pi * plate.f0 * plate.tau == pytest.approx(129, abs=0.5)
    assert 2 * plate.mass / plate.damping == pytest.approx(plate.tau)


def test_resonance_falls_with_temperature_as_in_the_paper():
    plate = ResonatorParameters()
    assert plate.resonance(20.0) == 43390.0
    assert plate.resonance(30.0) == 43250.0


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: ResonatorParameters(tau=0.0), r"^tau 0.0 is outside 1e-05..1$"),
        (lambda: ResonatorParameters(mass=math.nan), r"^mass nan is outside 0.0001..1$"),
        (lambda: ThermalParameters(time_constant=0.0), r"^time_constant 0.0 is outside"),
        (lambda: SensorParameters(crosstalk=((1.0, 1.0), (1.0, 1.0))), "^crosstalk determinant"),
        (lambda: SensorParameters(gauge_noise=-1e-3), r"^gauge_noise -0.001 is outside 0..1$"),
        (lambda: SensorParameters(path_damping=1.0), r"^path_damping 1.0 is outside"),
        (lambda: dataclasses.replace(SUBJECTS[0], exponent=0.5), r"^exponent 0.5 is outside"),
        (lambda: dataclasses.replace(SUBJECTS[0], rho=math.inf), r"^rho inf is outside 0..0.95$"),
        (lambda: random_subjects(0, 1), r"^count 0 is outside"),
    ],
)
def test_refuses_what_is_out_of_range(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_bounds_are_allowed():
    require("x", 0.0, 0.0, 1.0)
    require("x", 1.0, 0.0, 1.0)


def test_parameters_are_values():
    assert PlateParameters() == PlateParameters()
    with pytest.raises(dataclasses.FrozenInstanceError):
        PlateParameters().resonator.tau = 1.0


def test_random_subjects_depend_on_the_seed_alone():
    assert random_subjects(5, 1) == random_subjects(5, 1)
    assert random_subjects(5, 1) == random_subjects(9, 1)[:5]
    assert random_subjects(5, 1) != random_subjects(5, 2)

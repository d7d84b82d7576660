import dataclasses
import math

import pytest
from stated_bounds import made_at_bounds

from smarttac_can.science.plant.finger import Stroke
from smarttac_can.science.plant.parameters import (
    ContactParameters,
    PlateParameters,
    ResonatorParameters,
    SensorParameters,
    ThermalParameters,
)
from smarttac_can.science.plant.plate import Plate
from smarttac_can.science.plant.sensors import Noise
from smarttac_can.science.plant.subjects import SUBJECTS
from smarttac_can.vocabulary.signals import Drive


def test_time_constant_and_quality_follow_from_the_30_percent():
    plate = ResonatorParameters()
    assert plate.tau == pytest.approx(0.944e-3, abs=0.5e-6)
    assert math.pi * plate.f0 * plate.tau == pytest.approx(129, abs=0.5)
    assert 2 * plate.mass / plate.damping == pytest.approx(plate.tau)


def test_resonance_falls_with_temperature_as_in_the_paper():
    plate = ResonatorParameters()
    assert plate.resonance(20.0) == 43390.0
    assert plate.resonance(30.0) == 43250.0


def test_default_plate_is_linear_with_one_mode_and_no_lag():
    plate, sensors = ResonatorParameters(), SensorParameters()
    assert (plate.softening, plate.neighbour_share) == (0.0, 0.0)
    assert (sensors.pickup_window, sensors.pickup_lag) == (0.0, 0.0)


def test_refuses_gauges_whose_loads_cannot_be_told_apart():
    with pytest.raises(ValueError, match=r"^crosstalk determinant"):
        SensorParameters(crosstalk=((1.0, 1.0), (1.0, 1.0)))


def numbers_of(made):
    """The fields that a caller sets and that are a single number with a unit."""
    return [
        item.name
        for item in dataclasses.fields(made)
        if item.init and isinstance(getattr(made, item.name), float)
    ]


GROUPS = {
    "resonator": ResonatorParameters(),
    "thermal": ThermalParameters(),
    "sensors": SensorParameters(),
    "contact": ContactParameters(),
    "subject": SUBJECTS[1],
}
NUMBERS = [(group, name) for group, made in GROUPS.items() for name in numbers_of(made)]


@pytest.mark.parametrize(("group", "name"), NUMBERS)
def test_plate_moves_at_each_bound_and_refuses_values_beyond(group, name):
    made = GROUPS[group]
    for at_bound in made_at_bounds(name, lambda value: dataclasses.replace(made, **{name: value})):
        moves(**{group: at_bound})


def moves(subject=SUBJECTS[1], **groups):
    plate = Plate(PlateParameters(**groups), subject, Stroke(rest=0.0, press=0.002))
    for _ in range(20):
        plate.step(Drive(40.0, 43390.0), Drive(40.0, 43390.0))
        W, gauges, temperature, _ = plate.sample()
        assert all(map(math.isfinite, (W.real, W.imag, *gauges, temperature, plate.mu_true)))


@pytest.mark.parametrize(
    "make",
    [
        lambda seed: Noise(SensorParameters(), seed),
        lambda seed: Stroke(seed=seed),
    ],
    ids=["noise", "stroke"],
)
def test_a_seed_has_63_bits(make):
    for seed in (0, 2**63 - 1):
        make(seed)
    for seed in (-1, 2**64):
        with pytest.raises(ValueError, match=rf"^seed {seed} is outside"):
            make(seed)


def test_parameters_are_values():
    assert PlateParameters() == PlateParameters()
    with pytest.raises(dataclasses.FrozenInstanceError):
        PlateParameters().resonator.tau = 1.0


@pytest.mark.parametrize(
    ("wrong", "line"),
    [
        ({"pickup_window": 1e-12}, "pickup_window 1e-12 is outside 1e-06..0.001"),
        ({"pickup_window": "461e-6"}, "pickup_window '461e-6' is text, no number"),
    ],
)
def test_a_window_is_none_or_a_time(wrong, line):
    with pytest.raises(ValueError, match=line):
        SensorParameters(**wrong)


@pytest.mark.parametrize(
    "wrong",
    [
        {"f0": 6e3, "neighbour_offset": -5e3},
        {"f0": 5e3, "tau": 1e-5},
        {"f0": 5e3, "mass": 1e-3},
    ],
)
def test_overdamped_mode_is_refused(wrong):
    with pytest.raises(ValueError, match="Hz does not oscillate"):
        moves(resonator=ResonatorParameters(**wrong))


@pytest.mark.parametrize("offset", [0.0, 900.0, -900.0])
def test_mode_needs_to_oscillate_at_10_n_and_half_its_resonance(offset):
    mode = ResonatorParameters(tau=1e-4, mass=5e-3, neighbour_offset=offset)
    fingertip = dataclasses.replace(SUBJECTS[1], load_damping=55.0)
    damping = 2 * 5e-3 / 1e-4 + 55.0 * 20.0 ** (2 / 3) * 1.1**2
    least = damping / (2 * math.pi * 5e-3) - min(offset, 0.0)
    contact = ContactParameters(ripple=0.1)
    enough = dataclasses.replace(mode, f0=1.00001 * least)
    moves(subject=fingertip, contact=contact, resonator=enough)
    with pytest.raises(ValueError, match="does not oscillate"):
        lower = dataclasses.replace(mode, f0=0.99999 * least)
        moves(subject=fingertip, contact=contact, resonator=lower)


def test_extreme_softening_keeps_a_resonance():
    mode = ResonatorParameters(f0=5e3, tau=5e-3, gain=1e-6, softening=1e9)
    plate = Plate(PlateParameters(resonator=mode), SUBJECTS[1], Stroke(rest=0.0, press=0.002))
    for volts in (150.0, 3.0, 150.0, 0.0) * 10:
        plate.step(Drive(volts, mode.f0), Drive(volts, mode.f0))
        assert math.isfinite(abs(plate.W))

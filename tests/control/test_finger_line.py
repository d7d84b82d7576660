"""The line through a finger's places: no lag, less noise the longer it holds, short at a turn."""

import math
import random

import pytest

from smarttac_can.control.texture import (
    LONG,
    POSITION_LAG,
    SHORT,
    Line,
    cof_ahead,
    line_from,
    prolonged,
    texture_of,
)
from smarttac_can.plant.force_path import follow, propagator
from smarttac_can.plant.parameters import SensorParameters
from smarttac_can.vocabulary.signals import TICK
from smarttac_can.vocabulary.textures import Axis, TextureTable

NOISE = 0.24e-3
"""Of the centre of pressure of a tick in m, under 1 N."""
SPEED = 0.06


def root_mean_square(values):
    return math.sqrt(sum(value * value for value in values) / len(values))


def followed(places, seed=1, noise=NOISE, unsure=NOISE):
    """Return the lines through places in m, one a tick."""
    draw = random.Random(seed)
    lines = []
    for place in places:
        measured = place + draw.gauss(0.0, noise)
        line = prolonged(lines[-1], measured, unsure) if lines else line_from(measured)
        lines.append(line)
    return lines


def test_a_steady_speed_is_followed_without_lag_from_the_second_sample():
    places = [1e-3 + SPEED * TICK * tick for tick in range(500)]
    for line, place in zip(followed(places, noise=0.0)[1:], places[1:], strict=True):
        assert line.position == pytest.approx(place, abs=1e-12)
        assert line.speed == pytest.approx(SPEED)


def test_the_noise_falls_while_the_finger_keeps_its_speed():
    places = [SPEED * TICK * tick for tick in range(400)]
    runs = [followed(places, seed) for seed in range(40)]
    off = [
        root_mean_square([run[tick].position - places[tick] for run in runs]) for tick in (40, 399)
    ]
    # The filter of the tribometer keeps a quarter of the noise: 0.06 mm.
    assert 0.05e-3 < off[0] < 0.11e-3
    assert off[1] < 0.03e-3


def test_a_turn_makes_the_memory_short_and_is_followed():
    there = [SPEED * TICK * tick for tick in range(400)]
    back = [there[-1] - SPEED * TICK * tick for tick in range(1, 200)]
    runs = [followed(there + back, seed) for seed in range(20)]
    assert all(run[399].samples > 300 for run in runs)
    assert all(min(line.samples for line in run[400:440]) == SHORT for run in runs)
    late = [run[520].position - back[120] for run in runs]
    assert root_mean_square(late) < 0.08e-3


def test_the_memory_does_not_grow_for_ever_nor_where_noise_is_not_expected():
    places = [SPEED * TICK * tick for tick in range(600)]
    assert followed(places)[-1].samples == LONG
    assert followed(places, unsure=0.0)[-1].samples <= SHORT + 1.0


@pytest.mark.parametrize("samples", [1.0, 5.0, SHORT - 1.0])
def test_a_young_line_grows_by_a_sample_however_it_bends(samples):
    assert prolonged(Line(0.0, 0.0, samples, 1.0), 1.0, 1e-4).samples == samples + 1.0


def test_at_a_steady_speed_the_lag_of_the_force_path_is_made_up_for():
    sensors = SensorParameters()
    phi = propagator(TICK, sensors.path_frequency, sensors.path_damping)
    texture = texture_of(TextureTable(Axis.POSITION, False, 0, 10_000_000, (3000, 9000)))
    y = rate = 0.0
    for tick in range(100):
        y, rate = follow(phi, y, rate, SPEED * TICK * (tick + 0.5))
    place = 100 * TICK * SPEED
    found = cof_ahead(texture, 0, y, SPEED, 0.0)
    assert found - 0.3 == pytest.approx(0.6 * place / 10e-3, rel=1e-3)


@pytest.mark.parametrize("repeats", [True, False])
@pytest.mark.parametrize("axis", list(Axis))
def test_the_reference_is_that_of_the_table_where_the_finger_is_or_when(axis, repeats):
    table = TextureTable(axis, repeats, 0, 1_000_000, (3000, 4000, 3500, 4200))
    texture = texture_of(table)
    for share in (0.0, 0.3, 1.6, 2.9, 3.4):
        ticks, place = (round(share * 1e3), 0.0) if axis is Axis.TIME else (7, share * 1e-3)
        assert cof_ahead(texture, ticks, place, 0.0, 0.0) == pytest.approx(table.at(share * 1e6))
        # What is ahead by a time is where it will be then.
        ahead = cof_ahead(texture, ticks, place, SPEED, 0.01)
        way = 10_000.0 if axis is Axis.TIME else SPEED * (0.01 + POSITION_LAG) * 1e9
        assert ahead == pytest.approx(table.at(share * 1e6 + way))


def test_a_line_is_a_value():
    assert line_from(2e-3) == Line(2e-3, 0.0, 1.0, 0.0)

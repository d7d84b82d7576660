"""The line through a finger's places: no lag, less noise the longer it holds, short at a turn."""

import math
import random

import pytest

from smarttac_can.control.texture import LONG, SHORT, Line, line_from, prolonged
from smarttac_can.vocabulary.signals import TICK

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


def test_a_line_is_a_value():
    assert line_from(2e-3) == Line(2e-3, 0.0, 1.0, 0.0)

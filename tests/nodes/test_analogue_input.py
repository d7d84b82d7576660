"""The status of the analogue inputs: which channels a cycle leaves valid."""

import pytest

from smarttac_can.bench.simulation import stimulator_od
from smarttac_can.nodes.process_image import AnalogueInput
from smarttac_can.od.dictionary import ObjectDictionary

CHANNELS = ("force x", "force y", "normal force", "COF", "amplitude", "temperature")
NOT_VALID, OVERLOAD = 1, 3


def statuses(od: ObjectDictionary) -> list[int]:
    return [od[f"AI status.AI status {channel}"].value for channel in CHANNELS]


@pytest.mark.parametrize(
    ("sensors", "over"),
    [
        (range(2), ("force x", "force y", "COF")),
        (range(2, 6), ("normal force", "COF")),
        (range(6, 7), ("amplitude",)),
        (range(7, 8), ()),
    ],
)
def test_a_sensor_at_its_end_is_an_overload_of_the_channels_that_come_of_it(
    sensors: range, over: tuple[str, ...]
) -> None:
    od = stimulator_od()
    inputs = AnalogueInput(od)
    for sensor in sensors:
        inputs.update(True, 1 << sensor)
        assert statuses(od) == [OVERLOAD * (channel in over) for channel in CHANNELS]
        inputs.update(True, 0)
        assert statuses(od) == [0] * 6


def test_without_a_finger_the_cof_is_not_valid_beside_what_is_over() -> None:
    od = stimulator_od()
    inputs = AnalogueInput(od)
    inputs.update(False, 0)
    assert statuses(od) == [0, 0, 0, NOT_VALID, 0, 0]
    inputs.update(False, 1 << 2)
    assert statuses(od) == [0, 0, OVERLOAD, OVERLOAD, 0, 0]
    inputs.update(True, 0)
    assert statuses(od) == [0] * 6


def test_after_a_reset_a_cycle_like_the_last_one_is_shown_again() -> None:
    od = stimulator_od()
    inputs = AnalogueInput(od)
    inputs.update(False, 0)
    od.reset()
    inputs.reset()
    inputs.update(False, 0)
    assert statuses(od) == [0, 0, 0, NOT_VALID, 0, 0]

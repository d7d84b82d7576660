import pytest
from rich_eds import RICH

from smarttac_can.canopen.od.eds import load_eds
from smarttac_can.canopen.od.timing import (
    CyclicFrame,
    bus_load,
    cycle_seconds,
    cyclic_frames,
    frame_bits,
    frame_seconds,
)

LOOP = [
    CyclicFrame(0x080, 0, 1e-3),
    CyclicFrame(0x1A1, 8, 1e-3),
    CyclicFrame(0x1A2, 8, 1e-3),
    CyclicFrame(0x220, 7, 1e-3),
]


@pytest.mark.parametrize(("size", "bits"), [(0, 55), (1, 65), (4, 95), (7, 125), (8, 135)])
def test_frame_bits_are_those_of_davis(size: int, bits: int) -> None:
    assert frame_bits(size) == bits
    assert frame_seconds(size, 1_000_000) == bits / 1_000_000


@pytest.mark.parametrize("size", [-1, 9])
def test_frame_bits_refuses_lengths_beyond_8_bytes(size: int) -> None:
    with pytest.raises(ValueError, match=rf"data_bytes {size} is outside 0..8"):
        frame_bits(size)


def test_loop_takes_450_us_at_1_mbit() -> None:
    assert cycle_seconds(LOOP, 1_000_000) == pytest.approx(450e-6)
    assert bus_load(LOOP, 1_000_000) == pytest.approx(0.45)
    assert bus_load(LOOP, 500_000) == pytest.approx(0.90)


def test_cyclic_frames_follow_the_pdo_parameters() -> None:
    od = load_eds(RICH, 0x20)
    od.entry(0x1800, 3).value = 25
    od.entry(0x1802, 5).value = 20
    frames = cyclic_frames([od], 1e-3)
    assert frames == [
        CyclicFrame(0x080, 0, 1e-3),
        CyclicFrame(0x1A0, 7, 2.5e-3),
        CyclicFrame(0x2A0, 4, 3e-3),
        CyclicFrame(0x3A0, 4, 20e-3),
    ]
    od.entry(0x1019).value = 10
    assert cyclic_frames([od], 1e-3)[0].size == 1

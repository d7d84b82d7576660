from pathlib import Path

import pytest

from smarttac_can.od.eds import load_eds
from smarttac_can.od.timing import (
    CyclicFrame,
    bus_load,
    cycle_seconds,
    cyclic_frames,
    frame_bits,
    frame_seconds,
    worst_case_response_time,
)

RICH = (Path(__file__).parent.parent / "eds" / "rich.eds").read_text()
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
def test_frame_bits_refuse_what_is_no_frame(size: int) -> None:
    with pytest.raises(ValueError, match=rf"data_bytes {size} is outside 0..8"):
        frame_bits(size)


def test_loop_takes_450_us_at_1_mbit() -> None:
    assert cycle_seconds(LOOP, 1_000_000) == pytest.approx(450e-6)
    assert bus_load(LOOP, 1_000_000) == pytest.approx(0.45)
    assert bus_load(LOOP, 500_000) == pytest.approx(0.90)


def test_response_is_blocking_plus_all_of_higher_priority() -> None:
    assert worst_case_response_time(LOOP, 0x080, 1_000_000) == pytest.approx(190e-6)
    assert worst_case_response_time(LOOP, 0x220, 1_000_000) == pytest.approx((450 + 135) * 1e-6)


def test_response_counts_a_fast_frame_as_often_as_it_comes() -> None:
    frames = [CyclicFrame(0x100, 8, 300e-6), CyclicFrame(0x200, 8, 1e-3)]
    # 135 blocking + 135 own of high + own 135: at 270 us the high one has come once.
    assert worst_case_response_time(frames, 0x200, 1_000_000) == pytest.approx(405e-6)
    frames[0] = CyclicFrame(0x100, 8, 200e-6)
    # By 270 us it has come twice, by 405 us three times, by 540 us three times.
    assert worst_case_response_time(frames, 0x200, 1_000_000) == pytest.approx(
        (135 + 3 * 135 + 135) * 1e-6
    )


def test_response_refuses_an_overloaded_bus() -> None:
    with pytest.raises(ValueError, match=r"can_id 544 can miss its period of 0\.001 s"):
        worst_case_response_time(LOOP, 0x220, 500_000)
    with pytest.raises(ValueError, match="can_id 5 is none of the frames"):
        worst_case_response_time(LOOP, 5, 500_000)


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

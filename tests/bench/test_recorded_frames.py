"""Rows of frames: ticks that rise, runs told apart, gaps named, no row of two cycles."""

import random
from collections.abc import Iterable

import numpy as np
import pytest

from smarttac_can.bench.recorded_frames import Missing, RecordedPdo, RowReader
from smarttac_can.bench.simulation import stimulator_od
from smarttac_can.host.frame_log import FRAME, RECORD, Records

OD = stimulator_od()
HEADS = [
    (1, 0x1A0, ["Statusword", "Mode display"]),
    (2, 0x2A0, ["Contact.COF"]),
    (3, 0x3A0, ["Contact.Position", "Contact.Tick"]),
    (4, 0x4A0, ["Vibration.Voltage"]),
]
PDOS = [
    RecordedPdo(OD, {"number": number, "can_id": can_id, "names": names, "every_cycle": number > 1})
    for number, can_id, names in HEADS
]
MS = 1_000_000

Sent = tuple[int, int, bytes]
"""Time in ns, identifier, data."""


def reader(clocked: bool = True) -> RowReader:
    return RowReader(PDOS, {"Statusword": 256, "Mode display": 0}, clocked)


def cycle(tick: int, at: int | None = None) -> list[Sent]:
    """Frames of a cycle in which each value follows from the tick."""
    time_ns = (tick if at is None else at) * MS
    wire = (tick & 0xFFFF).to_bytes(2, "little")
    return [(time_ns, 0x2A0, wire), (time_ns, 0x3A0, wire + wire), (time_ns, 0x4A0, wire)]


def records(frames: Iterable[Sent]) -> Records:
    rows = [(t, i, FRAME, len(d), list(d.ljust(8, b"\0")), 0) for t, i, d in frames]
    return np.array(rows, RECORD)


NONE = np.array([], np.intp)


def take(reading: RowReader, frames: list[Sent], last: bool = True) -> list[int]:
    rows = reading.take(records(frames), NONE, last)
    for values in (rows.values["Contact.COF"], rows.values["Vibration.Voltage"]):
        assert (values == rows.tick & 0xFFFF).all()
    return rows.tick.tolist()


def test_ticks_rise_beyond_16_bits() -> None:
    ticks = range(65_000, 140_000)
    reading = reader()
    assert take(reading, [f for tick in ticks for f in cycle(tick)]) == list(ticks)
    assert reading.gaps == []


@pytest.mark.parametrize("clocked", [True, False])
def test_each_lost_frame_is_a_gap_of_its_cycle(clocked: bool) -> None:
    draw = random.Random(3)
    reading = reader(clocked)
    lost = {tick for tick in range(10, 1990) if draw.random() < 0.1}
    frames = []
    for tick in range(2000):
        sent = cycle(tick)
        if tick in lost:
            # One of the cycle's frames, or all.
            sent = draw.choice([[], sent[1:], sent[:1] + sent[2:], sent[:2], sent[2:], sent[:1]])
        frames.append(sent)
    got: list[int] = []
    for begin in range(0, 2000, 250):
        piece = [f for sent in frames[begin : begin + 250] for f in sent]
        got += take(reading, piece, last=begin == 1750)
    named = {t for gap in reading.gaps for t in range(gap.first_tick, gap.last_tick + 1)}
    # A row beside a loss may be of two cycles.
    assert lost <= named <= {tick + by for tick in lost for by in (-1, 0, 1)}
    assert got == [tick for tick in range(2000) if tick not in named]


def test_the_halves_of_two_cycles_are_no_row() -> None:
    first, second = cycle(7), cycle(8)
    reading = reader()
    frames = [*cycle(5), *cycle(6), *first[:2], *second[:1], *second[2:], *cycle(9), *cycle(10)]
    assert take(reading, frames) == [5, 10]
    assert reading.gaps == [Missing(0, 6, 9, 4, 10 * MS)]


@pytest.mark.parametrize("begin", [0, 1, 2, 3])
@pytest.mark.parametrize("end", [0, 1, 2, 3])
def test_a_loss_that_begins_and_ends_within_a_cycle_mixes_none(begin: int, end: int) -> None:
    reading = reader()
    whole = [f for tick in range(5, 8) for f in cycle(tick)]
    after = [f for tick in range(21, 24) for f in cycle(tick)]
    got = take(reading, whole + cycle(8)[:begin] + cycle(20)[end:] + after)
    assert got[:2] == [5, 6]
    assert got[-2:] == [22, 23]
    assert len(reading.gaps) == 1
    gap = reading.gaps[0]
    assert got == [*range(5, gap.first_tick), *range(gap.last_tick + 1, 24)]


def test_event_timer_repetition_is_no_recorded_row() -> None:
    frames = cycle(5) + cycle(5, 105) + cycle(5, 205) + cycle(6, 206)
    assert take(reader(), frames) == [5, 6]


def test_a_restart_begins_a_run() -> None:
    reading = reader()
    frames = [f for tick in (*range(500), *range(50)) for f in cycle(tick)]
    rows = reading.take(records(frames), np.array([1500], np.intp), last=True)
    assert rows.tick.tolist() == [*range(500), *range(50)]
    assert rows.run.tolist() == [0] * 500 + [1] * 50
    assert reading.gaps == []


def test_a_restart_between_two_pieces() -> None:
    reading = reader()
    frames = [f for tick in range(500) for f in cycle(tick)]
    reading.take(records(frames + cycle(3)[:1]), np.array([1500], np.intp), last=True)
    rows = reading.take(records(cycle(3)), NONE, last=True)
    assert (rows.run.tolist(), rows.tick.tolist()) == ([1], [3])


@pytest.mark.parametrize("seconds", [40, 70, 200])
def test_a_gap_longer_than_the_tick_counts_is_told_by_the_clock(seconds: int) -> None:
    reading = reader()
    take(reading, cycle(99) + cycle(100), last=False)
    later = 100 + seconds * 1000
    assert take(reading, cycle(later - 1, later) + cycle(later)) == [later]
    assert [(gap.first_tick, gap.last_tick) for gap in reading.gaps] == [(100, later - 1)]


def test_in_lockstep_the_clock_says_nothing_of_ticks() -> None:
    assert take(reader(clocked=False), cycle(100) + cycle(101, 500_000)) == [100, 101]


def test_frames_that_waited_in_a_queue_begin_no_run() -> None:
    reading = reader()
    frames = [*cycle(100), *cycle(101, 9000), *cycle(8990, 9000), *cycle(8991, 9000)]
    assert take(reading, frames) == [100, 8991]
    assert len(reading.gaps) == 1


def test_tpdo_sent_on_change_is_held_between_rows() -> None:
    reading = reader()
    status = [(0, 0x1A0, (775).to_bytes(2, "little") + b"\x04")]
    rows = reading.take(records(cycle(0) + status + cycle(1)), NONE, last=True)
    assert rows.values["Statusword"].tolist() == [256, 775]
    assert rows.values["Mode display"].tolist() == [0, 4]
    rows = reading.take(records(cycle(2)), NONE, last=True)
    assert rows.values["Statusword"].tolist() == [775]


def test_without_a_tick_nothing_can_be_said() -> None:
    with pytest.raises(
        ValueError, match=r"no TPDO that comes in every cycle carries Contact\.Tick"
    ):
        RowReader(PDOS[:2], {"Statusword": 0, "Mode display": 0}, True)

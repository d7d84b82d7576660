"""A log of frames: each record is read, and damage costs the damaged ones."""

import os
import random
import struct
from pathlib import Path
from typing import Any
from zlib import crc32

import pytest

from smarttac_can.host import frame_log
from smarttac_can.host.frame_log import MARK, MARK_END, RECORD, FrameLog, FrameLogReader

HEAD = {"version": "0", "nodes": [1, 2]}
FRAMES = [(0x1A0 + n % 4, bytes(range(n % 9))) for n in range(1000)]


@pytest.fixture
def log(tmp_path: Path) -> Path:
    path = tmp_path / "run.log"
    with FrameLog(path, HEAD) as writing:
        for frame in FRAMES:
            writing.frame(*frame)
    return path


def frames_in(reader: FrameLogReader) -> list[tuple[int, bytes]]:
    return [
        (int(row["can_id"]), bytes(row["data"][: row["length"]]))
        for records in reader.chunks()
        for row in records
    ]


def test_frame_log_reads_back_each_record(log: Path) -> None:
    reader = FrameLogReader(log)
    assert reader.head == HEAD
    assert frames_in(reader) == FRAMES
    assert reader.damaged == 0


def test_time_never_goes_back(log: Path) -> None:
    (records,) = FrameLogReader(log).chunks()
    times = records["time_ns"].tolist()
    assert times == sorted(times)
    assert abs(times[0] * 1e-9 - log.stat().st_mtime) < 60


def test_a_system_clock_set_back_does_not_reach_the_times(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    epoch, since_boot = 1_700_000_000_000_000_000, 5_000
    monkeypatch.setattr(frame_log, "time_ns", lambda: epoch)
    monkeypatch.setattr(frame_log, "monotonic_ns", lambda: since_boot)
    with FrameLog(tmp_path / "log", HEAD) as writing:
        for later in (0, 1_000, 3_000):
            epoch -= 3_600 * 10**9
            since_boot = 5_000 + later
            writing.frame(0x181, b"frame")
            writing.mark("mark")
    (records,) = FrameLogReader(tmp_path / "log").chunks()
    begun = 1_700_000_000_000_000_000
    wanted = [begun + later for later in (0, 1_000, 3_000) for _ in ("frame", "mark")]
    assert records["time_ns"].tolist() == wanted


@pytest.mark.parametrize("size", [9, 64, 255])
def test_a_record_longer_than_a_frame_is_damaged(tmp_path: Path, size: int) -> None:
    with FrameLog(tmp_path / "log", HEAD) as writing:
        for data in (b"before", bytes(size), b"after"):
            writing.frame(0x181, data)
    reader = FrameLogReader(tmp_path / "log")
    assert frames_in(reader) == [(0x181, b"before"), (0x181, b"after")]
    assert reader.damaged == 1


def test_a_marker_is_of_any_length(tmp_path: Path) -> None:
    with FrameLog(tmp_path / "log", {}) as writing:
        writing.mark("trial 3: Fläche rauh")
        writing.mark("")
    (records,) = FrameLogReader(tmp_path / "log").chunks()
    assert records["kind"].tolist() == [MARK, MARK, MARK_END, MARK_END]
    text = b"".join(bytes(row["data"][: row["length"]]) for row in records)
    assert text.decode() == "trial 3: Fläche rauh"


@pytest.mark.parametrize("cut", [1, 5, 23, 24, 25])
def test_truncated_frame_log_lacks_only_its_end(log: Path, cut: int) -> None:
    os.truncate(log, log.stat().st_size - cut)
    reader = FrameLogReader(log)
    assert frames_in(reader) == FRAMES[: 1000 - -(-cut // RECORD.itemsize)]
    assert reader.damaged == (cut % RECORD.itemsize > 0)


def test_a_flipped_bit_costs_one_record(log: Path) -> None:
    draw = random.Random(1)
    whole = log.read_bytes()
    start = len(whole) - 1000 * RECORD.itemsize
    for _ in range(50):
        at = draw.randrange(start, len(whole))
        damaged = bytearray(whole)
        damaged[at] ^= 1 << draw.randrange(8)
        log.write_bytes(damaged)
        reader = FrameLogReader(log)
        lost = (at - start) // RECORD.itemsize
        assert frames_in(reader) == FRAMES[:lost] + FRAMES[lost + 1 :]
        assert reader.damaged == 1


def test_a_log_is_never_written_over(log: Path) -> None:
    before = log.read_bytes()
    with pytest.raises(FileExistsError):
        FrameLog(log, HEAD)
    assert log.read_bytes() == before


@pytest.mark.parametrize("content", [b"", b"something else"])
def test_another_file_is_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "log").write_bytes(content)
    with pytest.raises(ValueError, match=r"/log is no log of a recording$"):
        FrameLogReader(tmp_path / "log")


def head(text: bytes) -> bytes:
    return struct.pack("<II", len(text), crc32(text)) + text


@pytest.mark.parametrize(
    "rest",
    [
        b"\xff\xff",
        head(b'{"a": 1}')[:-2] + b"2}",
        *map(head, (b"[" * 100_000, b"{", b'{"a": ' + b"9" * 5000 + b"}", b"[]")),
    ],
    ids=["cut", "a wrong sum", "too deep", "open", "too large", "no map"],
)
def test_a_damaged_head_is_named(tmp_path: Path, rest: bytes) -> None:
    (tmp_path / "log").write_bytes(b"SMARTTAC recording log 1\n" + rest)
    with pytest.raises(ValueError, match=r"the head of .* is damaged: nothing can be made of it"):
        FrameLogReader(tmp_path / "log")


def test_a_disk_that_is_full_is_told_and_stops_nothing(tmp_path: Path, monkeypatch: Any) -> None:
    with FrameLog(tmp_path / "log", HEAD) as writing:

        def full() -> None:
            raise OSError(28, "No space left on device")

        monkeypatch.setattr(writing, "_sync", full)
        writing.frame(1, b"")
        while writing.error is None:
            pass
        writing.frame(2, b"")
        assert not writing._queue
    assert writing.error.strerror == "No space left on device"

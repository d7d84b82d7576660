import io
from pathlib import Path

import can
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from smarttac_can.canopen.device.frame import Frame
from smarttac_can.host.log_file import CandumpWriter, read_candump, read_log, read_messages

STAMPS = st.integers(0, 2_000_000_000_000_000)
IDS = st.integers(0, 0x7FF)
FRAMES = st.builds(Frame, IDS, st.binary(max_size=8), st.just(False)) | st.builds(
    Frame, IDS, st.just(b""), st.just(True)
)


def test_line_is_that_of_candump() -> None:
    text = io.StringIO()
    writer = CandumpWriter(text, "vcan0")
    writer.write(1_000_055, Frame(0x0A1, b"\x01\x02"))
    writer.write(1_700_000_000_000_001, Frame(0x7FF, b"\xab"))
    writer.write(0, Frame(0x005, rtr=True))
    assert text.getvalue() == (
        "(0000000001.000055) vcan0 0A1#0102\n"
        "(1700000000.000001) vcan0 7FF#AB\n"
        "(0000000000.000000) vcan0 005#R\n"
    )


@settings(max_examples=60)
@given(records=st.lists(st.tuples(STAMPS, FRAMES), max_size=20))
def test_round_trip(
    records: list[tuple[int, Frame]], tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.getbasetemp() / "bus.log"
    with path.open("w") as file:
        writer = CandumpWriter(file)
        for record in records:
            writer.write(*record)
    assert list(read_candump(path)) == records


def test_log_of_python_can_and_foreign_frames(tmp_path: Path) -> None:
    path = tmp_path / "bus.log"
    with can.CanutilsLogWriter(path) as log:
        log(can.Message(1.5, 0x181, is_extended_id=False, data=b"\x01"))
        log(can.Message(1.6, 0x18100, is_extended_id=True, data=b"\x02"))
        log(can.Message(1.7, is_error_frame=True, is_extended_id=False))
        log(can.Message(1.8, 0x182, is_extended_id=False, is_remote_frame=True))
    assert list(read_candump(path)) == [
        (1_500_000, Frame(0x181, b"\x01")),
        (1_800_000, Frame(0x182, rtr=True)),
    ]


@pytest.mark.parametrize(
    ("line", "time"),
    [
        ("  can0  181   [2]  01 02", 0),
        (" (1700000000.250000)  can0  181   [2]  01 02", 1_700_000_000_250_000),
        (" (2023-11-14 22:13:20.250000)  can0  181   [2]  01 02", 1_700_000_000_250_000),
        (" (000.250000)  can0  181   [2]  01 02", 250_000),
        (" (000.250000)  can0  RX - -  181   [2]  01 02   '..'", 250_000),
        ("(1.5) can0 181#0102", 1_500_000),
        ("(1.5) can0 181#0102 R", 1_500_000),
        ("vcan1  181   [2]  01 02", 0),
    ],
)
def test_log_file_reads_the_output_of_candump(line: str, time: int, tmp_path: Path) -> None:
    path = tmp_path / "pasted.txt"
    path.write_text(f"\n{line}\n")
    assert list(read_log(path)) == [(time, Frame(0x181, b"\x01\x02"))]


@pytest.mark.parametrize(
    ("line", "told"),
    [
        ("  can0  181   [0]  remote request", Frame(0x181, rtr=True)),
        ("(1.5) can0 181#R8", Frame(0x181, rtr=True)),
        ("  can0  181   {F}  01 02 03 04 05 06 07 08", Frame(0x181, bytes(range(1, 9)))),
        ("(1.5) can0 181#0102030405060708_F", Frame(0x181, bytes(range(1, 9)))),
        ("  can0  181   [0]", Frame(0x181)),
    ],
)
def test_lengths_that_candump_shows(line: str, told: Frame, tmp_path: Path) -> None:
    path = tmp_path / "pasted.txt"
    path.write_text(f"{line}\n")
    assert [frame for _, frame in read_log(path)] == [told]


@pytest.mark.parametrize(
    ("line", "kind"),
    [
        ("  can0  00018100   [1]  01", "is_extended_id"),
        ("  can0  181  [03]  01 02 03", "is_fd"),
        (
            "  can0  20000080   [2]  00 00   ERRORFRAME\n\tbus-off",
            "is_error_frame",
        ),
    ],
)
def test_candump_shows_frames_that_are_no_canopen(line: str, kind: str, tmp_path: Path) -> None:
    path = tmp_path / "pasted.txt"
    path.write_text(f"{line}\n")
    ((_, message),) = read_messages(path)
    kinds = ("is_extended_id", "is_fd", "is_error_frame")
    assert [name for name in kinds if getattr(message, name)] == [kind]
    assert list(read_log(path)) == []


@pytest.mark.parametrize(
    "line", ["hello", "(1.0) can0 181", "(1.0) can0 xyz#00", "(1.0) can0 1#0g"]
)
def test_other_file_is_refused(line: str, tmp_path: Path) -> None:
    path = tmp_path / "bus.log"
    path.write_text(f"(1.0) can0 181#00\n{line}\n")
    with pytest.raises(
        ValueError, match=r"bus\.log, line 2: '.*' is no line of a candump log$"
    ) as told:
        list(read_candump(path))
    assert repr(line) in str(told.value)


def test_a_line_that_is_cut(tmp_path: Path) -> None:
    path = tmp_path / "bus.log"
    whole = "(1.0) can0 181#00\n(2.0) can0 182#00"
    path.write_text(whole)
    with pytest.raises(
        ValueError, match=r"line 2: '\(2\.0\) can0 182#00' is cut: no line of a cand"
    ):
        list(read_candump(path))
    told: list[str] = []
    assert list(read_log(path, told.append)) == [(1_000_000, Frame(0x181, b"\0"))]
    assert told == [f"{path}: the last line, 2, is cut and left out"]
    path.write_text(f"{whole}\n")
    assert len(list(read_log(path, told.append))) == 2
    assert len(told) == 1


def test_a_line_that_is_too_long_is_no_cut_one(tmp_path: Path) -> None:
    path = tmp_path / "bus.log"
    path.write_text("1" * 5000)
    with pytest.raises(ValueError, match=r"line 1: '1{60}' is too long: no line of a candump log$"):
        list(read_log(path, print))


@pytest.mark.parametrize("channel", ["", "can 0", "can0\n"])
def test_channel_that_would_break_the_line_is_refused(channel: str) -> None:
    with pytest.raises(ValueError, match="is empty or has spaces"):
        CandumpWriter(io.StringIO(), channel)

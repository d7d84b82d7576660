"""``smarttac log`` shows the meaning of frames in words."""

import signal
import subprocess
import sys
from pathlib import Path
from time import monotonic, sleep
from typing import Any

import can
import pytest
from commands import refusal, run, succeed
from nodes_on_a_bus import GUARD_S, NodeProcess, multicast_options
from rich_eds import RICH_EDS
from small_eds import entry, record, small_eds, written

from smarttac_can.bench import plate_od, stimulator_od
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.cli.log import FrameText


@pytest.mark.parametrize(
    ("frame", "text"),
    [
        ("080", "SYNC"),
        ("000#0120", "NMT start: stimulator 32"),
        ("000#8100", "NMT reset node: all nodes"),
        ("000#77", "NMT 77, no command"),
        ("720#00", "stimulator 32 boot-up"),
        ("705#7F", "node 5 heartbeat, pre-operational"),
        ("705#33", "node 5 heartbeat, 51"),
        ("720", "stimulator 32 heartbeat without a state"),
        ("0A0#3181010000000000", "stimulator 32 EMCY 8131h: the heartbeat of a supervised node "
                                 "is lost"),
        ("1A0#0F0304", "stimulator 32 TPDO 1: Statusword live+driving+touching+limited+running, "
                       "Mode display friction"),
        ("220#038004", "stimulator 32 RPDO 1: Controlword arm+run+8000h, Mode friction"),
        ("220#030004", "stimulator 32 RPDO 1: Controlword arm+run, Mode friction"),
        ("220#0000", "stimulator 32 RPDO 1: 00 00, 3 bytes are mapped"),
        ("2A0#7D00F401AC0D1027", "stimulator 32 TPDO 2: Contact.Tangential force 125 mN, "
                                 "Contact.Normal force 500 mN, Contact.COF 0.35, "
                                 "Vibration.Amplitude 1000 nm"),
        ("620#2B171000F4010000", "stimulator 32 is asked by SDO: write 1017h:0 "
                                 "Producer heartbeat time = 500 ms"),
        ("5A0#6017100000000000", "stimulator 32 answers by SDO: written 1017h:0 "
                                 "Producer heartbeat time"),
        ("620#4017100000000000", "stimulator 32 is asked by SDO: read 1017h:0 "
                                 "Producer heartbeat time"),
        ("5A0#4B171000F4010000", "stimulator 32 answers by SDO: has read 1017h:0 "
                                 "Producer heartbeat time = 500 ms"),
        ("5A0#8001200022000008", "stimulator 32 answers by SDO: abort, 2001h:0 Mode: "),
        ("610#40", "node 16 is asked by SDO: 40, no SDO"),
        ("7FF", "unknown"),
        ("7FF#0102", "unknown 01 02"),
        ("100#40420F00E63B", "TIME 2025-12-25 00:16:40.000"),
        ("100#4042", "TIME 40 42, no 6 bytes"),
        ("7E5#0401000000000000", "LSS switch state global: 01 00 00 00 00 00 00"),
        ("7E4#4F00000000000000", "LSS slave identified: 00 00 00 00 00 00 00"),
        ("7E5#77", "LSS 77, no 8 bytes"),
        ("085#3081110102030405", "node 5 EMCY 8130h: life guard or heartbeat error; "
                                 "error register 11h, manufacturer 01 02 03 04 05"),
        ("085#2133000000000000", "node 5 EMCY 3321h: output voltage; error register 00h"),
        ("085#0000000000000000", "node 5 EMCY 0000h: error reset or no error; error register 00h"),
    ],
)  # fmt: skip
def test_a_frame_is_told_in_words(frame: str, text: str) -> None:
    can_id, _, data = frame.partition("#")
    says = FrameText([("stimulator", stimulator_od()), ("plate", plate_od())])
    said = says.of(Frame(int(can_id, 16), bytes.fromhex(data)))
    assert said.startswith(text) if text.endswith(": ") else said == text


def test_a_log_is_shown_by_the_eds_of_its_nodes(tmp_path: Path) -> None:
    file = tmp_path / "run.log"
    file.write_text(
        "(1700000000.000000) can0 705#00\n(1700000000.250000) can0 1A0#010100\n",
        encoding="ascii",
    )
    assert succeed("log", file, "--eds", f"5={RICH_EDS}").splitlines() == [
        "    0.000000  705  rich 5 boot-up",
        "    0.250000  1A0  stimulator 32 TPDO 1: Statusword live+ready, Mode display off",
    ]


def pdo(index: str, cob_id: str, mapping: str, count: str, value: str) -> str:
    return record(
        index,
        entry(f"{index}sub0", 5, "const", "2"),
        entry(f"{index}sub1", 7, "rw", cob_id),
        entry(f"{index}sub2", 5, "rw", "255"),
    ) + record(
        mapping, entry(f"{mapping}sub0", 5, "rw", count), entry(f"{mapping}sub1", 7, "rw", value)
    )


DRIVE = (
    pdo("1400", "$NODEID+0x200", "1600", "1", "0x60400010")
    + pdo("1800", "$NODEID+0x180", "1A00", "1", "0x60410010")
    + pdo("1801", "$NODEID+0x280", "1A01", "0xFE", "0")
    + entry("1014", 7, "rw", "$NODEID+0x90")
    + entry("6040", 6, "rww", "0", "PDOMapping=1").replace("Entry 6040", "Controlword")
    + entry("6041", 6, "ro", "0", "PDOMapping=1").replace("Entry 6041", "Statusword")
)


@pytest.mark.parametrize(
    ("line", "text"),
    [
        ("18A#3702", "small 10 TPDO 1: Statusword 567"),
        ("20A#0F00", "small 10 RPDO 1: Controlword 15"),
        ("18A#R", "small 10 TPDO 1: is asked for"),
        ("28A#8A00600101000000", "small 10 TPDO 2: 8a 00 60 01 01 00 00 00"),
        ("09A#1023010000000000", "small 10 EMCY 2310h: current, device output side; "),
        ("58A#4B41600037020000", "small 10 answers by SDO: has read 6041h:0 Statusword = 567"),
    ],
)
def test_a_drive_has_no_names_of_the_stimulator(line: str, text: str, tmp_path: Path) -> None:
    """Its words are called the same, and its second TPDO is multiplexed."""
    file = written(tmp_path, small_eds(DRIVE, rx=1, tx=2))
    log = tmp_path / "drive.log"
    log.write_text(f"(1.000000) can0 {line}\n", encoding="ascii")
    assert succeed("log", log, "--eds", f"10={file}").startswith(
        f"    0.000000  {line[:3]}  {text}"
    )


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("(1.0) can0 00018100#0102", "00018100  no CANopen: frame with a 29-bit identifier 01 02"),
        ("(1.0) can0 181##0010203", "181  no CANopen: CAN FD frame 01 02 03"),
        ("(1.0) can0 20000080#0000000000000000", "080  error frame 00 00 00 00 00 00 00 00"),
    ],
)
def test_frames_that_are_no_canopen_are_shown(line: str, said: str, tmp_path: Path) -> None:
    log = tmp_path / "other.log"
    log.write_text(f"{line}\n", encoding="ascii")
    assert succeed("log", log) == f"    0.000000  {said}\n"


def test_a_log_without_frames_says_so(tmp_path: Path) -> None:
    log = tmp_path / "empty.log"
    log.write_text("", encoding="ascii")
    result = run("log", log)
    assert (result.exit_code, result.stdout) == (0, "")
    assert result.stderr == f"{log} has no frames\n"


def test_a_cut_last_line_is_named_and_left_out(tmp_path: Path) -> None:
    file = tmp_path / "run.log"
    file.write_text("(1700000000.000000) can0 705#00\n(1700000000.25", encoding="ascii")
    result = run("log", file)
    assert result.stdout.splitlines() == ["    0.000000  705  node 5 boot-up"]
    assert result.stderr == f"{file}: the last line, 2, is cut and left out\n"
    assert result.exit_code == 0


def test_a_reader_that_leaves_ends_it_without_a_word(tmp_path: Path) -> None:
    file = tmp_path / "run.log"
    file.write_text("(1700000000.000000) can0 705#00\n" * 20_000, encoding="ascii")
    with subprocess.Popen(
        [sys.executable, "-m", "smarttac_can", "log", file],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    ) as process:  # fmt: skip
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.readline()
        process.stdout.close()
        assert process.stderr.read() == b""


def test_a_bus_is_shown_until_ctrl_c(multicast: dict[str, Any]) -> None:
    process = NodeProcess("log", *multicast_options(multicast))
    guard = monotonic() + GUARD_S
    with can.Bus(**multicast) as bus:
        while process.lines.empty():
            assert monotonic() < guard
            bus.send(can.Message(arbitration_id=0x720, data=[5], is_extended_id=False))
            sleep(0.05)
    status, _, complaint = process.end(signal.SIGINT)
    assert process.lines.get() == "    0.000000  720  stimulator 32 heartbeat, operational"
    assert (status, complaint) == (0, "")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--eds", "200=plate"), "'200=plate' is not NODE=EDS with a node-ID of 1..127"),
        (("--eds", "5=missing.eds"), "'missing.eds' is neither a file nor"),
        ((str(RICH_EDS),), "is none of"),
    ],
)
def test_log_refuses_wrong_eds_options(arguments: tuple[str, ...], message: str) -> None:
    assert message in refusal("log", *arguments, code=None)

"""``smarttac log`` says in words what frames mean."""

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

from smarttac_can.bench import plate_od, stimulator_od
from smarttac_can.cli.log import FrameText
from smarttac_can.device.frame import Frame


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
def test_what_makes_no_sense_is_refused(arguments: tuple[str, ...], message: str) -> None:
    assert message in refusal("log", *arguments, code=None)

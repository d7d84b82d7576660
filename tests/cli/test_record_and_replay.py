"""``smarttac record --raw`` beside a script, and ``smarttac replay`` of its log."""

import json
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import can
import pytest
from click.testing import CliRunner
from nodes_on_a_bus import (
    GUARD_S,
    both,
    in_threads,
    multicast_options,
    processes,
    regulate_friction,
)

from smarttac_can.bench import Stimulator
from smarttac_can.cli import main
from smarttac_can.device.frame import Frame
from smarttac_can.host.files import packaged_eds
from smarttac_can.host.log_file import read_log

BOOT_UPS = {0x720, 0x721}
SDO_TO, DRIVE = 0x620, 0x221


def reset_all(bus: Mapping[str, Any]) -> None:
    """Reset both nodes, and wait until they have."""
    with can.Bus(**bus) as handle:
        handle.send(can.Message(arbitration_id=0, data=[129, 0], is_extended_id=False))
        seen: set[int] = set()
        guard = time.monotonic() + GUARD_S
        while not seen >= BOOT_UPS:
            assert time.monotonic() < guard, "they do not boot"
            message = handle.recv(0.1)
            if message is not None and message.data == b"\0":
                seen.add(message.arbitration_id)


def friction(bench: Stimulator) -> None:
    bench.start_run()
    regulate_friction(bench)


def at_rest(bench: Stimulator) -> None:
    """Ask much, and drive nothing: a system that is busy trips over no deadline then."""
    for voltage in (10, 20, 30):
        bench.voltage = voltage
        bench.run(0.1)
        assert bench.get("Setpoint.Voltage", "V") == voltage


TRIES = 4
CROSSED = r"SDO answer \(5A0h\)|lacks the TPDO [1-4] "
"""What a request that crossed another one leaves: its answer, or a TPDO whose type it has set."""
HELD_UP = r"makes the node send this EMCY|the log lacks "
"""What else is left in real time of a process that was held up: a deadline that it has missed, and
no log has, or frames that the log has lost."""


def replayed(log: Path, *options: str) -> dict[str, Any]:
    found = log.with_suffix(".json")
    result = CliRunner().invoke(main, ["replay", str(log), *options, "--json", str(found)])
    assert result.exit_code == 0, result.output
    return dict(json.loads(found.read_text()))


def frames(log: Path, can_id: int) -> list[Frame]:
    """Frames with an identifier behind the boot-up, where a replay begins."""
    heard = [frame for _, frame in read_log(log)]
    behind = heard[heard.index(Frame(0x720, b"\0")) :]
    return [frame for frame in behind if frame.can_id == can_id]


def patient_eds(path: Path) -> Path:
    """EDS of a stimulator that waits as long as it may before it misses a measurement."""
    text = packaged_eds("stimulator.eds").read_text()
    limits = "LowLimit=1\nHighLimit=100\nDefaultValue="
    assert text.count(f"{limits}20") == len(("RPDO 5", "RPDO 6", "RPDO 7"))
    path.write_text(text.replace(f"{limits}20", f"{limits}100"))
    return path


@pytest.mark.parametrize(("pace", "act"), [("--lockstep", friction), ("--produce-sync", at_rest)])
def test_what_a_process_records_is_replayed(
    multicast: dict[str, Any], tmp_path: Path, pace: str, act: Callable[[Stimulator], None]
) -> None:
    told = (pace, "--eds", str(patient_eds(tmp_path / "patient.eds")))
    # Requests of script and recorder may cross on multicast: their order in the log is then not
    # that in which the node heard them, which a bus with one order for all cannot do.
    for attempt in range(TRIES):
        raw = tmp_path / f"run{attempt}.log"
        record_process(multicast, raw, told, act)
        result = CliRunner().invoke(main, ["replay", str(raw), *told])
        excused = CROSSED if pace == "--lockstep" else f"{CROSSED}|{HELD_UP}"
        if result.exit_code == 0 or not re.search(excused, result.output):
            break
    found = replayed(raw, *told)
    assert found["same"] is True
    assert found["drives"] == len(frames(raw, DRIVE)) > 200
    # Of the script, and of the recorder, which sets the types of the TPDOs again.
    assert len(frames(raw, SDO_TO)) > 50


def record_process(
    multicast: dict[str, Any], raw: Path, told: tuple[str, ...], act: Callable[[Stimulator], None]
) -> None:
    """Have a process record what a script does with both nodes."""
    lockstep = told[0] == "--lockstep"
    plate = "plate --lockstep" if lockstep else "plate"
    rows = raw.with_suffix(".h5")
    command = [sys.executable, "-W", "error", "-m", "smarttac_can", "record", "--plate-node", "33"]
    command += ["--raw", str(raw), "--timeout", "5", *multicast_options(multicast)]
    with processes(multicast, plate, " ".join(("node --plate-node 33", *told))):
        with subprocess.Popen([*command, str(rows)], stderr=subprocess.PIPE, text=True) as recorder:
            try:
                assert recorder.stderr is not None
                assert recorder.stderr.readline() == f"recording {rows}\n"
                reset_all(multicast)
                options = {**multicast, "plate_node_id": 33, "lockstep": lockstep, "timeout": 5.0}
                with Stimulator.connect(**options) as bench:
                    act(bench)
                recorder.send_signal(signal.SIGINT)
                recorder.communicate(timeout=GUARD_S)
            finally:
                recorder.kill()
        assert recorder.returncode == 0


def test_what_a_script_records_in_lockstep_is_replayed(
    virtual: dict[str, Any], tmp_path: Path
) -> None:
    raw = tmp_path / "run.log"
    options = {**virtual, "plate_node_id": 33, "lockstep": True, "timeout": 5.0}
    with in_threads(virtual, *both()):
        with (
            Stimulator.connect(**options) as recorder,
            recorder.record(tmp_path / "run.h5", raw=raw) as recording,
        ):
            reset_all(virtual)
            with Stimulator.connect(**options) as bench:
                friction(bench)
            # The recorder's own requests come in between.
            assert recorder.get("Mode") == 0
            recorder.voltage = 5
        assert recording.raw_note == ""
    found = replayed(raw, "--lockstep")
    assert found["drives"] == len(frames(raw, DRIVE)) > 400

"""What a watchdog sees, and what it bars: wrong drives, limits, values at their ends."""

from __future__ import annotations

import struct

import pytest
from driven import STATE, driven, reset_fault, write, write_entry
from line import DRIVE

from smarttac_can.bench.simulation import PLATE_ID
from smarttac_can.control.cascade import Cascade
from smarttac_can.device.frame import Frame
from smarttac_can.nodes.bus_loop import LateAnswers
from smarttac_can.vocabulary.signals import Drive, Measurement, Setpoint
from smarttac_can.vocabulary.states import Mode, State
from smarttac_can.vocabulary.watchdogs import UNSEEN_CYCLES, WATCHDOGS, Watchdog

VALUE, TOO_HIGH, TOO_LOW = 0x06090030, 0x06090031, 0x06090032


@pytest.mark.parametrize(
    ("name", "low", "high", "watchdog", "mode"),
    [
        ("Temperature", 1500, 6000, Watchdog.TEMPERATURE, Mode.IDENTIFY),
        ("Normal force", 100, 4000, Watchdog.NORMAL_FORCE, Mode.AMPLITUDE),
        ("Lateral force", 100, 3000, Watchdog.LATERAL_FORCE, Mode.FRICTION),
    ],
)
def test_a_limit_that_is_lowered_is_in_force_in_the_next_cycle(
    name: str, low: int, high: int, watchdog: Watchdog, mode: Mode
) -> None:
    rig = driven(mode)
    rig.write(f"Limit.{name}", low)
    rig.cycle(2)
    assert rig.stage.read() == 0
    assert rig.od["Diagnosis.Code"].value == WATCHDOGS[watchdog].code
    assert reset_fault(rig) == STATE
    rig.write(f"Limit.{name}", high)
    rig.cycle(2)
    assert reset_fault(rig) == 0


def test_late_drives_that_may_make_more_vibration_than_a_lower_limit_end_a_run(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """In time the drive is cut to the limit; a late one leaves in force what was sent before."""
    rig = driven()
    rig.write("Limit.Amplitude by drive", 500)
    rig.cycle(20)
    assert rig.state is State.RUNNING
    monkeypatch.setattr(LateAnswers, "late", lambda *_: True)
    rig.write("Limit.Amplitude by drive", 100)
    rig.cycle(UNSEEN_CYCLES - 1)
    assert rig.state is State.RUNNING
    rig.cycle()
    assert rig.state is State.FAULT
    assert rig.od["Diagnosis.Code"].value == WATCHDOGS[Watchdog.UNSEEN].code
    assert rig.od["Diagnosis.Latched"].value == 1 << Watchdog.UNSEEN
    assert rig.stage.read() == 0


@pytest.mark.parametrize(
    ("voltage", "frequency", "watchdog"),
    [
        (999.0, 43_390.0, Watchdog.VOLTAGE),
        (150.1, 43_390.0, Watchdog.VOLTAGE),
        (float("nan"), 43_390.0, Watchdog.CONTROLLER),
        (float("inf"), 43_390.0, Watchdog.CONTROLLER),
        (-1.0, 43_390.0, Watchdog.CONTROLLER),
        (10.0, float("nan"), Watchdog.CONTROLLER),
        (10.0, 1e9, Watchdog.CONTROLLER),
    ],
)
def test_no_wrong_drive_goes_out(
    voltage: float, frequency: float, watchdog: Watchdog, monkeypatch: pytest.MonkeyPatch
) -> None:
    frames: list[Frame] = []
    rig = driven(Mode.AMPLITUDE, lambda _time, frame: frames.append(frame))
    update = Cascade.update

    def wrong(self: Cascade, measurement: Measurement, setpoint: Setpoint) -> Drive:
        update(self, measurement, setpoint)
        self._state = self.state._replace(drive=Drive(voltage, frequency))
        return self.drive

    frames.clear()
    monkeypatch.setattr(Cascade, "update", wrong)
    rig.cycle()
    monkeypatch.setattr(Cascade, "update", update)
    drives = [frame for frame in frames if frame.can_id == DRIVE]
    assert [struct.unpack_from("<HIB", frame.data)[0] for frame in drives] == [0]
    assert rig.stage.read() == 0
    assert rig.od["Diagnosis.Code"].value == WATCHDOGS[watchdog].code


def test_every_code_is_its_own() -> None:
    codes = [row.code for row in WATCHDOGS.values()]
    assert list(WATCHDOGS) == list(Watchdog)
    assert len(set(codes)) == len(codes)
    assert all(row.why and row.text for row in WATCHDOGS.values())


@pytest.mark.parametrize(
    ("name", "cap"),
    [
        ("Voltage", 20_000),
        ("Amplitude", 3000),
        ("Amplitude trip", 3270),
        ("Temperature", 8000),
        ("Normal force", 8000),
        ("Lateral force", 4000),
        ("Gauge mismatch", 1000),
    ],
)
def test_no_write_passes_a_hard_cap(name: str, cap: int) -> None:
    rig = driven()
    assert write(rig, "Controlword", 0) == 0
    assert write(rig, f"Limit.{name}", cap) == 0
    assert write(rig, f"Limit.{name}", cap + 1) == TOO_HIGH
    assert rig.read(f"Limit.{name}") == cap


@pytest.mark.parametrize("index", [0x1404, 0x1405, 0x1406])
def test_stimulator_keeps_its_deadlines(index: int) -> None:
    rig = driven()
    deadline = rig.od.entry(index, 5)
    assert write_entry(rig, deadline, 0) == TOO_LOW
    assert deadline.value == 3


@pytest.mark.parametrize("record", ["Model", "Controller", "Calibration", "Limit"])
def test_the_node_takes_any_value_that_its_eds_allows(record: str) -> None:
    rig = driven()
    assert write(rig, "Controlword", 0) == 0
    for entry in rig.od:
        if not entry.name.startswith(f"{record}.") or not entry.writable:
            continue
        for raw in (int(entry.low), int(entry.high), entry.default):
            # The two ends of the frequency range must not pass each other.
            meets = (entry.name, raw) in (
                ("Limit.Lowest frequency", int(entry.high)),
                ("Limit.Highest frequency", int(entry.low)),
            )
            code = write(rig, entry.name, raw)
            assert code == (VALUE if meets else 0), entry.name
            rig.cycle()


def test_counts_of_cycles_begin_anew() -> None:
    rig = driven()
    rig.od["Cycle.Cycles"].value = rig.plate.od["Cycle.Ticks"].value = 0xFFFF_FFFF
    rig.cycle()
    assert rig.read("Cycle.Cycles") == 0
    assert rig.master.read(PLATE_ID, rig.plate.od["Cycle.Ticks"]) == 0

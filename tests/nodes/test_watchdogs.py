"""Every watchdog in every mode that drives: 0 V in time, for good, and back after a reset."""

from __future__ import annotations

import random
import struct
from collections.abc import Callable
from typing import NamedTuple

import pytest
from line import DRIVE, MEASUREMENT, PREOP, START, Line, drive, ready_plate
from loop import (
    AMPLITUDE,
    AMPLITUDE_RESONANCE,
    DRIVING,
    FRICTION,
    MASTER_LOST_MS,
    OPEN_LOOP,
    SETPOINT_DEADLINE_MS,
    Loop,
)

from smarttac_can.control.cascade import Cascade
from smarttac_can.device.frame import Frame
from smarttac_can.nodes.fault_codes import FaultCode
from smarttac_can.nodes.plate_node import PlateNode
from smarttac_can.nodes.state_machine import State
from smarttac_can.nodes.watchdogs import STUCK_GAUGE_CYCLES, WATCHDOGS, Watchdog
from smarttac_can.od.cia import EmergencyCode
from smarttac_can.plant.faults import PICKUP_D, THERMOMETER, FaultKind
from smarttac_can.signals import Drive, Measurement, Setpoint
from smarttac_can.trials.fault_cases import PDO_DEADLINE_MS, RING_DOWN_CYCLES

TOUCHED = (OPEN_LOOP, AMPLITUDE, AMPLITUDE_RESONANCE, FRICTION)
STATE, VALUE = 0x08000022, 0x06090030

Act = Callable[[Loop], object]


class Case(NamedTuple):
    name: str
    watchdog: Watchdog
    inject: Act
    remove: Act
    modes: tuple[int, ...] = tuple(DRIVING)
    stays: bool = True
    """Whether the fault can still be seen at 0 V."""
    set_bound: int | None = None
    """Bound in cycles where an object or another node sets it."""
    to_show: int = 0
    """Cycles until the cause is seen in the measurements."""

    @property
    def bound(self) -> int:
        bound = WATCHDOGS[self.watchdog].bound if self.set_bound is None else self.set_bound
        assert isinstance(bound, int)
        return bound + self.to_show


def put(name: str, value: object) -> Act:
    return lambda loop: setattr(loop, name, value)


def lose(*can_ids: int) -> Act:
    return lambda loop: loop.lost.update(can_ids)


def limit(name: str, raw: int) -> Act:
    return lambda loop: loop.limit(name, raw)


def broken(kind: FaultKind, sensor: int = 1, value: int = 0) -> Act:
    return lambda loop: loop.break_plate(kind, sensor, value)


def serial(number: int) -> Act:
    return lambda loop: setattr(loop.plate.od["Plate serial number"], "value", number)


def skip(loop: Loop) -> None:
    loop.line.master.sync_counter += 7


def nothing(_loop: Loop) -> None: ...


def nmt(command: int) -> Act:
    return lambda loop: loop.line.nmt(command, 0x20)


mend = broken(FaultKind.NONE)
W = Watchdog
CASES = (
    Case("NMT", W.NMT, nmt(PREOP), nothing, set_bound=PDO_DEADLINE_MS),
    Case("heartbeat", W.HEARTBEAT, put("heartbeat", False), put("heartbeat", True),
         set_bound=MASTER_LOST_MS + PDO_DEADLINE_MS),
    Case("measurements", W.MEASUREMENT, lose(MEASUREMENT[1]), lambda loop: loop.lost.clear(),
         set_bound=PDO_DEADLINE_MS),
    Case("drives", W.PLATE, lose(DRIVE), lambda loop: loop.lost.clear(), set_bound=3),
    Case("set-points", W.SETPOINT, put("setpoints", False), put("setpoints", True),
         set_bound=SETPOINT_DEADLINE_MS),
    Case("no SYNC", W.SYNC_LOST, put("syncs", 0), put("syncs", 1), set_bound=3),
    Case("two SYNCs", W.SYNC_IRREGULAR, put("syncs", 2), put("syncs", 1), set_bound=16),
    Case("SYNC counter", W.SYNC_COUNTER, skip, nothing),
    Case("bus-off", W.BUS_OFF, lambda loop: loop.said(loop.node.bus_off()),
         lambda loop: loop.said(loop.node.bus_recovered())),
    Case("queue", W.TRANSMIT_QUEUE, lambda loop: loop.said(loop.node.transmit_failed()), nothing),
    Case("amplitude", W.AMPLITUDE, limit("Amplitude trip", 100), limit("Amplitude trip", 3200),
         TOUCHED, stays=False),
    Case("temperature", W.TEMPERATURE, limit("Temperature", 1500), limit("Temperature", 6000)),
    Case("normal force", W.NORMAL_FORCE, limit("Normal force", 100), limit("Normal force", 4000),
         TOUCHED),
    Case("lateral force", W.LATERAL_FORCE, limit("Lateral force", 100),
         limit("Lateral force", 3000), (OPEN_LOOP, FRICTION)),
    Case("saturated", W.SATURATED, broken(FaultKind.SATURATED, 1), mend),
    Case("stuck", W.STUCK, broken(FaultKind.STUCK, 1), mend, set_bound=STUCK_GAUGE_CYCLES),
    Case("stuck thermometer", W.STUCK, broken(FaultKind.STUCK, THERMOMETER), mend),
    Case("gauges", W.GAUGES, broken(FaultKind.OFFSET, 3, 600), mend),
    Case("too much", W.PICKUP, broken(FaultKind.GAIN, PICKUP_D, 4000), mend,
         (OPEN_LOOP, AMPLITUDE, AMPLITUDE_RESONANCE), False),
    Case("none", W.PICKUP, broken(FaultKind.RESONANCE_SHIFT, 1, -20_000), mend,
         (OPEN_LOOP, AMPLITUDE), False, to_show=RING_DOWN_CYCLES),
    Case("resonance", W.RESONANCE, broken(FaultKind.RESONANCE_SHIFT, 1, -1500), mend,
         (AMPLITUDE_RESONANCE,), False, to_show=RING_DOWN_CYCLES),
    Case("another plate", W.CALIBRATION, serial(2), serial(1)),
    Case("no serial number", W.CALIBRATION, serial(0), serial(1)),
)  # fmt: skip


def cycles_to_zero(loop: Loop, most: int) -> int:
    for count in range(most + 1):
        if loop.voltage == 0 and loop.state is State.FAULT:
            return count
        loop.cycle()
    raise AssertionError(f"{loop.voltage} after {most} cycles")


def random_traffic(loop: Loop, cycles: int) -> None:
    """A master that does what it can to have the plate driven, but reset the fault."""
    draw = random.Random(1)
    line, node = loop.line, loop.node
    for _ in range(cycles):
        name, raw = draw.choice(
            [
                *(("Mode", mode) for mode in DRIVING),
                *(("Controlword", word) for word in (0, 1, 2, 3, 4)),
                ("Setpoint.Voltage", draw.randrange(20_000)),
            ]
        )
        line.write(node, name, raw)
        line.send(Frame(0x220, bytes((draw.randrange(8), 0, draw.randrange(6)))))
        if draw.random() < 0.1:
            line.nmt(START)
        loop.cycle()
        assert loop.voltage == 0


@pytest.mark.parametrize(
    ("case", "mode"),
    [
        pytest.param(case, mode, id=f"{case.name}, mode {mode}")
        for case in CASES
        for mode in case.modes
    ],
)
def test_watchdog(case: Case, mode: int) -> None:
    loop = Loop(mode)
    row = WATCHDOGS[case.watchdog]
    case.inject(loop)
    assert cycles_to_zero(loop, case.bound + 1) <= case.bound + 1
    assert loop.node.od["Diagnosis.Code"].value == row.code
    assert loop.node.od["Diagnosis.Latched"].value >> case.watchdog & 1
    assert loop.node.od["Message"].value == row.text
    history = [loop.node.od.entry(0x1003, n).value & 0xFFFF for n in range(1, 9)]
    assert row.code in history
    sent = [frame.data for frame in loop.line.frames if frame.can_id == 0xA0]
    (emcy,) = [data for data in sent if int.from_bytes(data[:2], "little") == row.code]
    assert emcy[2] & row.register
    assert emcy[2] & 1
    assert emcy[3] == case.watchdog
    assert loop.node.od["Drive.Voltage"].value == 0
    random_traffic(loop, 60)
    if row.lasting and case.stays:
        loop.line.write(loop.node, "Controlword", 0)
        assert loop.line.write(loop.node, "Controlword", 0x80) == STATE, "it is still there"
    case.remove(loop)
    loop.line.nmt(START)
    loop.cycle(30)
    before = len(loop.line.frames)
    assert loop.line.write(loop.node, "Controlword", 0) == 0
    assert loop.line.write(loop.node, "Controlword", 0x80) == 0, bin(
        loop.node.od["Diagnosis.Present"].value
    )
    gone = [frame.data[:2] for frame in loop.line.frames[before:] if frame.can_id == 0xA0]
    assert bytes(2) in gone
    assert loop.state is not State.FAULT
    assert loop.node.od["Diagnosis.Code"].value == loop.node.od["Diagnosis.Latched"].value == 0
    assert loop.line.write(loop.node, "Controlword", 0) == 0
    loop.begin()


@pytest.mark.parametrize("mode", DRIVING)
@pytest.mark.parametrize(
    ("voltage", "frequency", "watchdog"),
    [
        (999.0, 43_390.0, W.VOLTAGE),
        (150.1, 43_390.0, W.VOLTAGE),
        (float("nan"), 43_390.0, W.CONTROLLER),
        (float("inf"), 43_390.0, W.CONTROLLER),
        (-1.0, 43_390.0, W.CONTROLLER),
        (10.0, float("nan"), W.CONTROLLER),
        (10.0, 1e9, W.CONTROLLER),
    ],
)
def test_no_wrong_drive_goes_out(
    mode: int,
    voltage: float,
    frequency: float,
    watchdog: Watchdog,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    loop = Loop(mode)
    update = Cascade.update

    def wrong(self: Cascade, measurement: Measurement, setpoint: Setpoint) -> Drive:
        update(self, measurement, setpoint)
        self.drive = Drive(voltage, frequency)
        return self.drive

    before = len(loop.line.frames)
    monkeypatch.setattr(Cascade, "update", wrong)
    loop.cycle()
    monkeypatch.setattr(Cascade, "update", update)
    drives = [frame for frame in loop.line.frames[before:] if frame.can_id == DRIVE]
    assert [struct.unpack_from("<HIB", frame.data)[0] for frame in drives] == [0]
    assert loop.voltage == 0
    assert loop.node.od["Diagnosis.Code"].value == WATCHDOGS[watchdog].code


def test_a_cascade_in_doubt_is_a_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    loop = Loop(AMPLITUDE)
    monkeypatch.setattr(Cascade, "update", lambda self, *_: self._turn_off("drive is not finite"))
    loop.cycle()
    assert loop.voltage == 0
    assert loop.node.od["Diagnosis.Code"].value == FaultCode.CONTROLLER


def test_what_is_present_before_arming_bars_it_and_is_no_fault() -> None:
    loop = Loop()
    assert loop.line.write(loop.node, "Controlword", 0) == 0
    loop.limit("Temperature", 1500)
    loop.cycle()
    assert loop.state is State.NOT_READY
    assert loop.node.od["Diagnosis.Present"].value == 1 << W.TEMPERATURE
    assert loop.line.write(loop.node, "Controlword", 1) == STATE
    loop.limit("Temperature", 6000)
    loop.cycle()
    assert loop.state is State.READY
    assert loop.node.od["Diagnosis.Present"].value == 0
    assert loop.node.od["Error register"].value == 0


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
    loop = Loop()
    assert loop.line.write(loop.node, f"Limit.{name}", cap) == 0
    assert loop.line.write(loop.node, f"Limit.{name}", cap + 1) == 0x06090031
    assert loop.line.read(loop.node, f"Limit.{name}") == cap


# The plate by itself, whatever its controller does.


def driven_plate() -> tuple[Line, PlateNode]:
    line, plate = ready_plate()
    line.send(drive(2000, 0))
    assert plate.od["Stage.Voltage"].value == 2000
    return line, plate


def tick_of(plate: PlateNode) -> int:
    return int(plate.od["Vibration.Tick"].value)


def emergencies(line: Line) -> list[int]:
    return [
        int.from_bytes(frame.data[:2], "little") for frame in line.frames if frame.can_id == 0xA1
    ]


def assert_barred_until_0_v(line: Line, plate: PlateNode) -> None:
    for _ in range(5):
        line.sync()
        line.send(drive(2000, tick_of(plate)))
        assert plate.od["Stage.Voltage"].value == 0
    line.send(drive(0, tick_of(plate)))
    line.sync()
    line.send(drive(2000, tick_of(plate)))
    assert plate.od["Stage.Voltage"].value == 2000
    assert emergencies(line)[-1] == 0


def test_plate_without_drives() -> None:
    line, plate = driven_plate()
    line.sync(3)
    assert plate.od["Stage.Voltage"].value == 0
    assert emergencies(line) == [EmergencyCode.RPDO_TIME_OUT, FaultCode.DRIVE_LOST]
    assert_barred_until_0_v(line, plate)


def test_plate_without_drives_and_without_sync() -> None:
    line, plate = driven_plate()
    line.advance(3)
    assert plate.od["Stage.Voltage"].value == 0


def test_plate_whose_measurements_are_not_answered_in_time() -> None:
    line, plate = driven_plate()
    for count in range(3):
        line.sync()
        assert (plate.od["Stage.Voltage"].value == 0) == (count == 2)
        line.send(drive(2000, tick_of(plate) - 1 & 0xFF))
    assert emergencies(line) == [FaultCode.DRIVE_LOST]
    assert_barred_until_0_v(line, plate)


def test_plate_asked_for_more_than_its_limit() -> None:
    line, plate = driven_plate()
    line.sync()
    line.send(drive(15_001, 1))
    assert plate.od["Stage.Voltage"].value == 0
    assert emergencies(line) == [FaultCode.VOLTAGE]
    assert plate.od["Error register"].value & 4
    assert_barred_until_0_v(line, plate)


def test_plate_too_hot() -> None:
    line, plate = driven_plate()
    assert line.write(plate, "Limit.Temperature", 1500) == 0
    line.sync()
    assert plate.od["Stage.Voltage"].value == 0
    for _ in range(5):
        line.send(drive(0, tick_of(plate)))
        line.sync()
        line.send(drive(2000, tick_of(plate)))
        assert plate.od["Stage.Voltage"].value == 0
    assert emergencies(line) == [FaultCode.TEMPERATURE], "once"
    assert line.write(plate, "Limit.Temperature", 7000) == 0
    line.sync()
    line.send(drive(0, tick_of(plate)))
    assert_barred_after_reset(line, plate)


def assert_barred_after_reset(line: Line, plate: PlateNode) -> None:
    line.sync()
    line.send(drive(2000, tick_of(plate)))
    assert plate.od["Stage.Voltage"].value == 2000
    assert emergencies(line)[-1] == 0


def test_plate_that_left_operational_waits_for_0_v() -> None:
    line, plate = driven_plate()
    line.nmt(PREOP)
    assert plate.od["Stage.Voltage"].value == 0
    line.nmt(START)
    line.sync()
    line.send(drive(2000, tick_of(plate)))
    assert plate.od["Stage.Voltage"].value == 0


@pytest.mark.parametrize(("name", "cap"), [("Voltage", 20_000), ("Temperature", 8000)])
def test_no_write_passes_a_hard_cap_of_the_plate(name: str, cap: int) -> None:
    line, plate = driven_plate()
    assert line.write(plate, f"Limit.{name}", cap + 1) == 0x06090031


def test_plate_keeps_its_deadline() -> None:
    line, plate = driven_plate()
    deadline = plate.od.entry(0x1400, 5)
    assert line.write_entry(plate, deadline, 101) == 0x06090031
    assert deadline.value == 3
    assert line.write_entry(plate, deadline, 0) == 0
    plate.advance(1000)
    assert plate.od["Stage.Voltage"].value == 0, "no deadline is no drive"


@pytest.mark.parametrize("index", [0x1404, 0x1405, 0x1406])
def test_stimulator_keeps_its_deadlines(index: int) -> None:
    loop = Loop()
    deadline = loop.node.od.entry(index, 5)
    assert loop.line.write_entry(loop.node, deadline, 0) == 0x06090032
    assert deadline.value == 3


def test_a_first_drive_above_the_limit_bars_as_well() -> None:
    line, plate = ready_plate()
    line.send(drive(15_001, tick_of(plate)))
    line.sync()
    line.send(drive(2000, tick_of(plate)))
    assert plate.od["Stage.Voltage"].value == 0
    assert_barred_until_0_v(line, plate)


def test_a_plate_that_cools_down_waits_for_0_v() -> None:
    line, plate = ready_plate()
    line.write(plate, "Limit.Temperature", 1500)
    line.sync()
    line.send(drive(2000, tick_of(plate)))
    line.write(plate, "Limit.Temperature", 7000)
    line.sync()
    line.send(drive(2000, tick_of(plate)))
    assert plate.od["Stage.Voltage"].value == 0


@pytest.mark.parametrize("kind", ["corrupt", "out of range", "of an old tick"])
def test_plate_without_sync_is_not_fed_by_drives_that_do_not_count(kind: str) -> None:
    line, plate = driven_plate()
    frame = {
        "corrupt": Frame(DRIVE, bytes(8)),
        "out of range": Frame(DRIVE, b"\xff" * 8),
        "of an old tick": drive(2000, tick_of(plate) - 1 & 0xFF),
    }[kind]
    for _ in range(3):
        plate.advance(1000)
        line.send(frame)
    assert plate.od["Stage.Voltage"].value == 0


@pytest.mark.parametrize("record", ["Model", "Controller", "Calibration", "Limit"])
def test_the_node_takes_any_value_that_its_eds_allows(record: str) -> None:
    loop = Loop()
    assert loop.line.write(loop.node, "Controlword", 0) == 0
    for entry in loop.node.od:
        if not entry.name.startswith(f"{record}.") or not entry.writable:
            continue
        for raw in (int(entry.low), int(entry.high), entry.default):
            # The two ends of the frequency range must not pass each other.
            meets = (entry.name, raw) in (
                ("Limit.Lowest frequency", int(entry.high)),
                ("Limit.Highest frequency", int(entry.low)),
            )
            code = loop.line.write(loop.node, entry.name, raw)
            assert code == (VALUE if meets else 0), entry.name
            loop.cycle()


def test_counts_of_cycles_begin_anew() -> None:
    loop = Loop()
    loop.node.od["Cycle.Cycles"].value = loop.plate.od["Cycle.Ticks"].value = 0xFFFF_FFFF
    loop.cycle()
    assert loop.line.read(loop.node, "Cycle.Cycles") == 0
    assert loop.line.read(loop.plate, "Cycle.Ticks") == 0

"""The stimulator node with a plate node: pairing, answers, states, refusals."""

import struct
from types import SimpleNamespace
from typing import Any

import pytest
from driven import driven as driven_rig
from driven import write_entry
from line import (
    DRIVE,
    EMCY_STIMULATOR,
    MEASUREMENT,
    PREOP,
    PUBLIC,
    RESET,
    RESET_COMMUNICATION,
    START,
    STOP,
    SYNC,
    Line,
    both_nodes,
    driven_both,
    ids,
    measurement,
    ready_both,
    stage,
    stimulator_alone,
)

from smarttac_can.bench.simulation import STIMULATOR_ID, plate_od, stimulator_od
from smarttac_can.canopen.bus.local_bus import LocalBus
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.od.cia import Abort, DataType, NMTCommand
from smarttac_can.canopen.od.entry import Entry
from smarttac_can.instrument.nodes.loop_frames import crc8
from smarttac_can.instrument.nodes.plate_block import PlateBlock
from smarttac_can.instrument.nodes.plate_node import PlateNode
from smarttac_can.instrument.nodes.stimulator_node import Publishing, StimulatorNode
from smarttac_can.vocabulary.signals import DRIVE_TPDO
from smarttac_can.vocabulary.states import State

STATE, VALUE, READ_ONLY = 0x08000022, 0x06090030, 0x06010002
NO_DATA = 0x08000024
TOO_HIGH, TOO_LOW = 0x06090031, 0x06090032
OFF, OPEN_LOOP, AMPLITUDE, AMPLITUDE_RESONANCE, FRICTION, IDENTIFY = range(6)


def waiting() -> tuple[Line, StimulatorNode]:
    line, node = stimulator_alone()
    line.nmt(START)
    return line, node


def driven(frames: list[Frame]) -> list[tuple[int, int, int]]:
    """Voltage, frequency and tick of the drives among frames."""
    return [struct.unpack_from("<HIB", frame.data) for frame in frames if frame.can_id == DRIVE]


def driving(mode: int = AMPLITUDE) -> tuple[Line, PlateNode, StimulatorNode]:
    """Both nodes, with 1 um of vibration."""
    line, plate, stimulator = ready_both()
    assert line.write(stimulator, "Setpoint.Amplitude", 1000) == 0
    assert line.write(stimulator, "Setpoint.Voltage", 2000) == 0
    line.run(stimulator, mode)
    line.sync(10)
    assert stage(plate) > 1000
    return line, plate, stimulator


def test_lost_and_foreign_measurements_count_without_an_answer() -> None:
    line, node = waiting()
    first, _, last = measurement(0)
    assert line.send(SYNC, first, last) == []
    assert driven(line.send(SYNC, *measurement(1))) == [(0, 4_339_000, 1)]
    assert node.od["Cycle.Lost cycles"].value == 1
    assert driven(line.send(SYNC, *measurement(2, gauge_tick=1))) == []
    assert driven(line.send(SYNC, *measurement(1))) == []
    assert node.od["Cycle.Foreign ticks"].value == 2
    assert node.od["Cycle.Cycles"].value == 1


def test_a_measurement_begun_before_a_stop_is_forgotten() -> None:
    line, _ = waiting()
    line.send(*measurement(0)[:2])
    line.nmt(STOP)
    line.nmt(START)
    assert line.send(measurement(0)[2]) == []
    assert driven(line.send(SYNC, *measurement(1))) == [(0, 4_339_000, 1)]


def corrupt(frame: Frame) -> Frame:
    return Frame(frame.can_id, bytes((frame.data[0] ^ 32, *frame.data[1:])))


def test_plate_input_shows_whole_measurements_alone() -> None:
    line, stimulator = waiting()
    shown = [entry for entry in stimulator.od if entry.name.startswith("Plate input.")]
    frames = measurement(0)
    line.send(SYNC, *frames)
    before = [entry.value for entry in shown]
    assert stimulator.od["Plate input.Tick"].value == 0
    assert stimulator.od["Plate input.Check"].value == frames[-1].data[7]
    first, second, last = measurement(1)
    line.send(SYNC, first, second)
    assert [entry.value for entry in shown] == before, "two parts"
    line.send(corrupt(last))
    assert [entry.value for entry in shown] == before, "a wrong check"
    line.send(SYNC, first, second, last)
    assert stimulator.od["Plate input.Tick"].value == 1
    assert stimulator.od["Plate input.Check"].value == last.data[7]


def test_write_to_plate_input_is_used_in_no_cycle() -> None:
    """The controllers answer what has come, whatever a master writes between two PDOs of it."""
    outcomes = []
    for raw in (0, 9_000):
        line, stimulator = waiting()
        line.send(SYNC, *measurement(0))
        first, second, last = measurement(1, W=500)
        line.send(SYNC, first, second)
        for name in ("S3", "W_d", "Temperature"):
            assert line.write(stimulator, f"Plate input.{name}", raw) == 0
            assert line.read(stimulator, f"Plate input.{name}") == raw
        assert DRIVE in ids(line.send(last))
        assert line.read(stimulator, "Plate input.S3") == 0
        cascade = stimulator.block.cascade
        outcomes.append((cascade.contact, cascade.amplitude, stimulator.levels()))
    assert outcomes[0] == outcomes[1]
    assert outcomes[0][1] > 0.0


def test_three_unusable_measurements_in_a_row_are_a_fault() -> None:
    line, plate, stimulator = driven_both()
    line.ports[0].close()
    tick = plate.od["Vibration.Tick"].value
    for count in range(1, 4):
        first, second, last = measurement(tick + count & 0xFF)
        line.send(first, second, corrupt(last))
        assert stimulator.block.state is State.RUNNING
    sent = line.send(first)
    assert stimulator.block.state is State.FAULT
    assert [frame.data[:2] for frame in sent if frame.can_id == DRIVE] == [bytes(2)], "0 V"
    assert stimulator.od["Diagnosis.Code"].value == 0x8251


def test_requested_drive_is_0_v_once_operational_is_left() -> None:
    line, plate, _ = driven_both()
    (asked,) = line.send(Frame(DRIVE, rtr=True))
    assert asked.data[:2] == b"\xd0\x07"
    line.nmt(PREOP, STIMULATOR_ID)
    line.nmt(START, STIMULATOR_ID)
    (asked,) = line.send(Frame(DRIVE, rtr=True))
    assert asked.data[:2] == bytes(2)
    line.sync(30)
    assert stage(plate) == 0


def test_wrong_cycle_period_is_reported_once_and_stops_the_drive() -> None:
    line, node = waiting()
    period = node.od.entry(0x1006)
    assert line.write_entry(node, period, 2000) == 0
    wrong = [Frame(EMCY_STIMULATOR, bytes.fromhex("00 63 01 00 00 00 00 00"))]
    assert line.send(SYNC, *measurement(0)) == wrong
    assert line.send(SYNC, *measurement(1)) == []
    assert line.write_entry(node, period, 1000) == 0
    assert ids(line.send(SYNC, *measurement(2)))[:2] == [EMCY_STIMULATOR, DRIVE]


@pytest.mark.parametrize("produce_sync", [False, True])
def test_a_master_that_downloads_the_defaults_stops_no_loop(produce_sync: bool) -> None:
    """All of the EDS but signatures and mappings in force, and read back at once."""
    plate = PlateNode(plate_od())
    node = StimulatorNode(stimulator_od(), plate_node_id=33, produce_sync=produce_sync)
    line = Line(plate, node, lockstep=not produce_sync)
    line.nmt(START)

    def cycles(count: int) -> list[Frame]:
        if produce_sync:
            return [frame for _ in range(count) for frame in line.advance(1)]
        return line.sync(count)

    cycles(70)
    line.nmt(PREOP, node.device.node_id)
    signatures = {0x1010, 0x1011, 0x6125}
    for entry in stimulator_od():
        mapping = 0x1600 <= entry.index < 0x1800 or 0x1A00 <= entry.index < 0x1C00
        if entry.writable and entry.size and not mapping and entry.index not in signatures:
            assert line.write_entry(node, entry, entry.default) == 0, entry.name
            assert node.od.entry(entry.index, entry.subindex).value == entry.default
    line.nmt(START, node.device.node_id)
    frames = cycles(100)
    assert EMCY_STIMULATOR not in ids(frames)
    assert ids(frames).count(DRIVE) == 100
    assert node.od.entry(0x1016, 4).value == 33 << 16 | 2000
    assert line.write(node, "Drive unwatched", 1) == 0
    assert line.write(node, "Setpoint.Voltage", 2000) == 0
    line.run(node, OPEN_LOOP)
    cycles(5)
    assert stage(plate) == 2000


def test_it_links_to_the_plate_it_is_given() -> None:
    node = StimulatorNode(stimulator_od(0x20), plate_node_id=5)
    plate = PlateNode(plate_od(5))
    line = Line(plate, node)
    line.nmt(START)
    assert ids(line.sync()) == [0x185, 0x285, 0x385, 0x205, PUBLIC[0]]
    assert line.read(node, "Plate node-ID") == 5
    assert not plate.block.inhibited, "it has had 0 V"
    line.sync(69)
    assert node.block.state is State.READY, "it expects the serial number of that plate"
    line.nmt(RESET_COMMUNICATION)
    line.nmt(START)
    assert 0x205 in ids(line.sync()), "linked again"


def test_it_has_the_plate_either_inside_or_outside() -> None:
    with pytest.raises(ValueError, match="either inside or at a node-ID"):
        StimulatorNode(stimulator_od())
    with pytest.raises(ValueError, match="either inside or at a node-ID"):
        StimulatorNode(stimulator_od(), PlateBlock(plate_od()), plate_node_id=33)


@pytest.mark.parametrize("produce", [True, False])
def test_sync_producer(produce: bool) -> None:
    frames: list[int] = []
    bus = LocalBus(log=lambda _time, frame: frames.append(frame.can_id))
    bus.attach(PlateNode(plate_od()), lockstep=False)
    bus.attach(
        StimulatorNode(stimulator_od(), plate_node_id=33, produce_sync=produce), lockstep=False
    )
    master = bus.connect(lambda frame: None)
    master.send(Frame(0, bytes((START, 0))))
    frames.clear()
    bus.advance(3000)
    cycle = [0x80, *MEASUREMENT, DRIVE]
    assert [can_id for can_id in frames if can_id not in PUBLIC] == cycle * 3 * produce


def test_shutdown_tells_the_plate_0_v() -> None:
    line, plate, _ = driving()
    line.bus.shutdown()
    ((voltage, _, _),) = driven(line.frames[-5:])
    assert voltage == stage(plate) == 0


@pytest.mark.parametrize("mode", range(1, 6))
def test_mode_is_refused_outside_operational(mode: int) -> None:
    line, _, stimulator = both_nodes()
    assert line.write(stimulator, "Mode", mode) == STATE
    assert line.read(stimulator, "Mode") == OFF
    assert line.write(stimulator, "Mode", OFF) == 0
    line.nmt(START)
    assert line.write(stimulator, "Mode", mode) == 0
    line.nmt(PREOP)
    assert line.write(stimulator, "Mode", mode) == STATE


def test_mode_by_pdo() -> None:
    line, plate, _ = driving(OPEN_LOOP)
    line.send(Frame(0x420, struct.pack("<HHH", 500, 3000, 3000)))
    line.send(Frame(0x220, struct.pack("<HB", 3, AMPLITUDE)))
    line.sync(30)
    assert abs(plate.od["Vibration.W_d"].value - 5000) < 100, "0.5 um in 0.1 nm"
    line.send(Frame(0x220, struct.pack("<HB", 3, OFF)))
    line.sync()
    assert stage(plate) == 0


@pytest.mark.parametrize(
    ("name", "raw"),
    [
        ("Simulation.Subject", 2),
        ("Simulation.Seed", 2),
        ("Simulation.Drive instant", 100),
        ("Finger.Motion", 1),
        ("Finger.Force", 600),
        ("Fault.Kind", 1),
    ],
)
def test_simulation_is_refused_without_the_plate_inside(name: str, raw: int) -> None:
    line, _, stimulator = both_nodes()
    before = line.read(stimulator, name)
    assert line.write(stimulator, name, raw) == STATE
    assert line.write(stimulator, name, before) == 0, "what was read may be written back"
    assert line.read(stimulator, name) == before


AUTO_ZERO = "AI auto-zero.AI auto-zero force x"


@pytest.mark.parametrize(
    ("command", "name", "raw", "code", "reason"),
    [
        (PREOP, "Mode", 1, STATE,
         "Mode 1 needs NMT OPERATIONAL: start the node, then write Mode again"),
        (PREOP, "Controlword", 1, STATE,
         "not armed: the node is not in NMT OPERATIONAL, start it, and the gauges are not tared"
         ", lift the finger and tare"),
        (PREOP, "Simulation.Seed", 77, STATE,
         "Simulation.Seed is not simulated in this node: write it to the plate node"),
        (START, "Mode", 7, TOO_HIGH, "Mode 7 is above 6"),
        (START, "Controlword", 0x40, VALUE, "Controlword 0040h has unknown bits: 0087h are known"),
        (START, "Limit.Lowest frequency", 4_400_001, VALUE,
         "f_max 44000 is outside 44000..1e+06"),
        (START, "Limit.Highest frequency", 4_269_999, VALUE,
         "f_max 42700 is outside 42700..1e+06"),
        (START, "Controller.Amplitude pole", 951, TOO_HIGH,
         "Controller.Amplitude pole 951 is above 950"),
        (START, "Controller.Contact force", 19, TOO_LOW,
         "Controller.Contact force 19 is below 20"),
        (START, "Setpoint.Voltage", 20_001, TOO_HIGH, "Setpoint.Voltage 20001 is above 20000"),
        (START, "Setpoint.COF left", 499, TOO_LOW, "Setpoint.COF left 499 is below 500"),
        (START, "Texture.Slot", 9, TOO_HIGH, "Texture.Slot 9 is above 4"),
        (START, "Statusword", 0, READ_ONLY,
         "Statusword: abort 06010002: attempt to write a read only object"),
        (START, AUTO_ZERO, 1, VALUE,
         "not tared: the value 00000001h is not the signature 6F72657Ah, 'zero'"),
        (START, AUTO_ZERO, 0x6F72657A, STATE,
         "not tared: a tare needs 64 samples, 1 were seen"),
    ],
)  # fmt: skip
def test_refused_write_changes_nothing_and_message_says_why(
    command: int, name: str, raw: int, code: int, reason: str
) -> None:
    """Instead of the reason of a refusal before."""
    line, _, stimulator = both_nodes()
    line.nmt(command)
    line.sync()
    assert line.write(stimulator, "Limit.Voltage", 20_001) == TOO_HIGH
    before = [entry.read() for entry in stimulator.od]
    parameters = stimulator.block.cascade.parameters
    assert line.write(stimulator, name, raw) == code
    assert stimulator.od["Message"].value == reason
    line.sync()
    assert stimulator.block.cascade.parameters == parameters
    changing = {"Contact", "Vibration", "Plate input", "Cycle", "AI input PV", "Drive"}
    for entry, value in zip(stimulator.od, before, strict=True):
        if entry.name.partition(".")[0] not in {*changing, "Plate temperature", "Message"}:
            assert entry.read() == value, entry.name


@pytest.mark.parametrize(
    ("name", "raw", "reason"),
    [
        ("Controlword", 8, "Controlword 0008h"),
        (AUTO_ZERO, 0x6F72657A, "not tared: disarm first"),
        (
            "Producer heartbeat time",
            0,
            "Producer heartbeat time 0 ms is refused, present value 500 ms: any but",
        ),
        (
            "Limit.Voltage",
            15_001,
            "Limit.Voltage 150010 mV is refused, present value 150000 mV: a higher",
        ),
        ("Store parameters.Save all parameters", 0x65766173, "parameters are not stored"),
    ],
)
def test_the_message_says_why_a_write_was_refused_while_running(
    name: str, raw: int, reason: str
) -> None:
    """A refused tare or watch left the texture standing there."""
    line, _, stimulator = driving()
    assert line.write(stimulator, "Mode", 6) == NO_DATA
    assert stimulator.od["Message"].value == "texture slot 1 is empty"
    assert line.write(stimulator, name, raw) in (STATE, VALUE)
    assert stimulator.od["Message"].value.startswith(reason)


def test_a_refusal_without_an_object_is_told_too() -> None:
    line, _, stimulator = both_nodes()
    entry = Entry(0x5FFF, 3, "none", DataType.UNSIGNED8, "rw")
    assert line.write_entry(stimulator, entry, 0) == 0x06020000
    assert stimulator.od["Message"].value == (
        "5FFFh sub-index 3: abort 06020000: object does not exist in the object dictionary"
    )


def test_accepted_write_clears_the_reason_of_a_refusal() -> None:
    line, _, stimulator = both_nodes()
    assert line.write(stimulator, "Setpoint.Voltage", 20_001) == TOO_HIGH
    assert line.write(stimulator, "Friction law", 0) == 0
    assert stimulator.od["Message"].value != ""
    assert line.write(stimulator, "Setpoint.Voltage", 0) == 0
    assert stimulator.od["Message"].value == ""


@pytest.mark.parametrize("by_rpdo", [False, True])
@pytest.mark.parametrize(
    ("mode", "name", "hint"),
    [
        (OFF, "Setpoint.Voltage", "running at 0 V: Mode is 0 (off), write another"),
        (OPEN_LOOP, "Setpoint.Voltage", "Setpoint.Voltage is 0 in Mode 1, write another value"),
        (AMPLITUDE, "Setpoint.Amplitude", "Setpoint.Amplitude is 0 in Mode 2, write another value"),
        (AMPLITUDE_RESONANCE, "Setpoint.Amplitude", "Setpoint.Amplitude is 0 in Mode 3"),
    ],
)
def test_run_without_mode_or_setpoint_names_the_missing_one(
    mode: int, name: str, hint: str, by_rpdo: bool
) -> None:
    line, _, stimulator = ready_both()
    for word in (0, 1):
        assert line.write(stimulator, "Controlword", word) == 0
    assert line.write(stimulator, "Mode", mode) == 0
    if by_rpdo:
        for word in (1, 3):
            line.send(Frame(0x220, bytes((word, 0, mode))))
    else:
        assert line.write(stimulator, "Controlword", 3) == 0
    assert stimulator.block.state is State.RUNNING
    for _ in range(2):
        assert hint in stimulator.od["Message"].value
        line.sync(3)
    if mode == OFF:
        assert line.write(stimulator, "Mode", OPEN_LOOP) == 0
    assert line.write(stimulator, name, 1000) == 0
    line.sync(3)
    assert stimulator.od["Message"].value == ""


def test_the_hint_of_a_run_ends_with_it() -> None:
    line, _, stimulator = ready_both()
    line.run(stimulator, OPEN_LOOP)
    assert stimulator.od["Message"].value.startswith("running at 0 V")
    assert line.write(stimulator, "Controlword", 0) == 0
    assert stimulator.od["Message"].value == ""


@pytest.mark.parametrize("mode", [OPEN_LOOP, AMPLITUDE, FRICTION])
def test_a_run_that_is_asked_for_something_says_nothing(mode: int) -> None:
    line, _, stimulator = driving(mode)
    assert stimulator.od["Message"].value == ""
    assert line.write(stimulator, "Controlword", 0) == 0
    line.run(stimulator, mode)
    assert stimulator.od["Message"].value == "", "before the first voltage, too"


def test_a_refusal_outlasts_the_hint_of_a_run() -> None:
    line, _, stimulator = ready_both()
    line.run(stimulator, OPEN_LOOP)
    line.sync()
    assert line.write(stimulator, "Limit.Voltage", 20_001) == TOO_HIGH
    assert line.write(stimulator, "Setpoint.Voltage", 2000) == 0
    line.sync(3)
    assert stimulator.od["Message"].value == "Limit.Voltage 20001 is above 20000"


def test_tare_on_request_and_at_power_on_agree() -> None:
    zeros = []
    for at_power_on in (0, 1):
        plate = PlateNode(plate_od())
        stimulator = StimulatorNode(
            stimulator_od(), plate_node_id=33, presets={"Tare at power-on": at_power_on}
        )
        line = Line(plate, stimulator)
        line.nmt(START)
        line.sync(65)
        untared = stimulator.od["Contact.Normal force"].read()
        if not at_power_on:
            assert abs(untared) > 30, "the offsets of the gauges"
            name = "AI auto-zero.AI auto-zero normal force"
            assert line.write(stimulator, name, int.from_bytes(b"zero", "little")) == 0
        zeros.append([stimulator.od[f"Gauge zero.Zero of S{n}"].value for n in range(1, 7)])
        line.sync(10)
        assert abs(stimulator.od["Contact.Normal force"].read()) < 30
        assert abs(stimulator.od["AI input PV.AI input PV force x"].read()) < 30
    assert all(zeros[0])
    assert zeros[0] == zeros[1]


def test_why_it_turned_itself_off_is_told_until_the_next_mode() -> None:
    line, plate, stimulator = ready_both()
    assert line.write(plate, "Finger.Motion", 1) == 0
    assert line.write(plate, "Simulation.Start run", 1) == 0
    assert line.write(stimulator, "Simulation.Start run", 1) == 0
    line.sync(400)
    assert stimulator.od["Contact.Touching"].value == 1
    line.run(stimulator, IDENTIFY)
    line.sync(2)
    assert "loaded" in stimulator.od["Message"].value
    assert line.read(stimulator, "Mode") == OFF
    assert line.write(stimulator, "Setpoint.Voltage", 100) == 0
    assert line.write(stimulator, "Mode", OPEN_LOOP) == 0
    line.sync()
    assert stimulator.od["Message"].value == ""


def test_bad_presets_are_refused_at_power_on() -> None:
    node = StimulatorNode(
        stimulator_od(), plate_node_id=33, presets={"Limit.Lowest frequency": 4_450_000}
    )
    with pytest.raises(Abort):
        node.start()


def test_only_a_new_run_answers_the_tick_that_was_answered_last() -> None:
    line, node = waiting()
    assert DRIVE in ids(line.send(SYNC, *measurement(7)))
    assert line.write(node, "Setpoint.Amplitude", 1000) == 0
    assert DRIVE not in ids(line.send(SYNC, *measurement(7)))
    assert line.write(node, "Simulation.Start run", 1) == 0
    assert DRIVE in ids(line.send(SYNC, *measurement(7)))


@pytest.mark.parametrize(
    ("words", "sent"),
    [
        ((0, 1), []),
        ((0, 1, 4, 0), []),
        ((0, 1, 3), []),
        ((0, 1, 3, 1), [0]),
        ((0, 1, 3, 4), [0]),
    ],
)
def test_state_change_sends_0_v_to_a_driven_plate_alone(
    words: tuple[int, ...], sent: list[int]
) -> None:
    line, _, stimulator = ready_both()
    before = len(line.frames)
    for word in words:
        assert line.write(stimulator, "Controlword", word) == 0
    assert [voltage for voltage, _, _ in driven(line.frames[before:])] == sent


def test_fault_memory_outlasts_restored_defaults_without_a_latch() -> None:
    line, _, stimulator = driven_both()
    stimulator.transmit_failed()
    memory = stimulator.od["Fault memory.Fault 1"]
    kept = memory.value
    assert line.write(stimulator, "Controlword", 0) == 0
    load = int.from_bytes(b"load", "little")
    assert line.write_entry(stimulator, stimulator.od.entry(0x1011, 1), load) == 0
    line.nmt(RESET)
    assert kept
    assert memory.value == kept
    assert stimulator.block.state is State.NOT_READY


def test_plate_links_taken_back_are_set_anew_at_the_start_only() -> None:
    rig = driven_rig()
    link = rig.od.entry(0x1404, 1)
    assert link.value == 0x1A1 != link.default
    rig.nmt(NMTCommand.ENTER_PRE_OPERATIONAL, STIMULATOR_ID)
    assert write_entry(rig, link, link.default) == 0
    rig.nmt(NMTCommand.STOP, STIMULATOR_ID)
    assert link.value == link.default
    rig.nmt(NMTCommand.START, STIMULATOR_ID)
    assert link.value == 0x1A1


# Frames to the bus unasked, without a node: which PDOs, and which emergencies.


STATUS_TPDO = 1
NMT, BUS_OFF, STUCK = 1 << 0, 1 << 7, 1 << 15
NMT_CODE, BUS_OFF_CODE, STUCK_CODE = 0x8180, 0x8141, 0x5211


class Told:
    """A publishing, and the requests to its device."""

    def __init__(self) -> None:
        self.od = stimulator_od()
        self.triggered: list[int] = []
        self.emergencies: list[tuple[int, int, bytes]] = []
        self.cleared: list[int] = []
        self.supervisor = SimpleNamespace(state=State.READY, latched=0)
        device = SimpleNamespace(
            od=self.od,
            trigger=self.triggered.append,
            emergency=lambda *emergency: self.emergencies.append(emergency),
            clear_emergency=self.cleared.append,
        )
        stand_ins: tuple[Any, Any] = (device, self.supervisor)
        self.publishing = Publishing(*stand_ins)

    def tell(self, latched: int) -> None:
        self.supervisor.latched = latched
        self.publishing.report()


@pytest.mark.sources
@pytest.mark.parametrize("event_driven", [(), (2,), (3,), (4,), (2, 3, 4)])
def test_cycle_sends_the_status_and_tpdos_of_type_254(event_driven: tuple[int, ...]) -> None:
    told = Told()
    for number in (1, *event_driven):
        told.od.entry(0x1800 + number - 1, 2).value = 254
    told.publishing.cycle()
    assert told.triggered == [STATUS_TPDO, *event_driven]


@pytest.mark.sources
def test_a_state_is_the_status_alone_and_the_last_time_is_all() -> None:
    told = Told()
    told.publishing.status()
    assert told.triggered == [STATUS_TPDO]
    told.triggered.clear()
    told.publishing.all()
    assert told.triggered == [1, 2, 3, 4]


@pytest.mark.sources
@pytest.mark.parametrize(
    ("state", "source"),
    [(State.RUNNING, STIMULATOR_ID), (State.READY, STIMULATOR_ID), (State.FAULT, 0xA0)],
)
def test_drive_check_covers_sender_and_fault(state: State, source: int) -> None:
    told = Told()
    told.supervisor.state = state
    for name, raw in (("Voltage", 2000), ("Frequency", 4_339_000), ("Tick", 7)):
        told.od[f"Drive.{name}"].value = raw
    told.publishing.drive(9)
    sent = (2000).to_bytes(2, "little") + (4_339_000).to_bytes(4, "little") + bytes((7, 9, source))
    assert told.od["Drive.Check"].value == crc8(sent)
    assert told.triggered == [DRIVE_TPDO]


@pytest.mark.sources
def test_latched_fault_is_sent_once_and_cleared_by_its_reset() -> None:
    told = Told()
    told.tell(NMT)
    assert told.emergencies == [(NMT_CODE, 0x10, bytes((0,)))]
    assert told.triggered == [STATUS_TPDO]
    told.tell(NMT)
    told.tell(NMT | STUCK)
    assert told.emergencies[1:] == [(STUCK_CODE, 0x80, bytes((15,)))]
    assert told.cleared == []
    told.tell(0)
    assert told.cleared == [NMT_CODE, STUCK_CODE]
    assert len(told.emergencies) == 2
    assert told.triggered == [STATUS_TPDO] * 2


@pytest.mark.sources
def test_nothing_latched_is_nothing_told() -> None:
    told = Told()
    told.tell(0)
    told.publishing.report_all()
    assert (told.emergencies, told.cleared, told.triggered) == ([], [], [])


@pytest.mark.sources
def test_fault_latched_before_or_in_a_reset_is_sent_after_it() -> None:
    told = Told()
    told.tell(BUS_OFF)
    told.supervisor.latched |= NMT
    told.publishing.mark_reported()
    told.publishing.report()
    assert [code for code, *_ in told.emergencies] == [BUS_OFF_CODE]
    told.publishing.report_all()
    assert [code for code, *_ in told.emergencies] == [BUS_OFF_CODE, NMT_CODE, BUS_OFF_CODE]
    assert told.cleared == []

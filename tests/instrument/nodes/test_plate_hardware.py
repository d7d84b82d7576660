"""Hardware that watches the power stage: its inputs count once they are mapped."""

from __future__ import annotations

import struct
from collections.abc import Iterable

import pytest
from line import (
    EMCY_STIMULATOR,
    PREOP,
    START,
    Line,
    both_nodes,
    cycle,
    drive,
    emergencies,
    ready_plate,
    stage,
    tick_of,
)

from smarttac_can.bench.simulation import PLATE_ID, plate_od
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.master import requests
from smarttac_can.canopen.od.cia import AbortCode
from smarttac_can.instrument.nodes.plate_node import PlateNode
from smarttac_can.instrument.nodes.stimulator_node import StimulatorNode
from smarttac_can.vocabulary.states import State
from smarttac_can.vocabulary.watchdogs import Watchdog

ENABLE, READ_BACK = 0x2031_0008, 0x2032_0010
STATE = 0x0800_0022
NOT_ENABLED, STAGE, LATE = 0x9010, 0x3311, 0x8250


def says(enable: int = 1, volts: float = 0.0) -> Frame:
    """A frame of the hardware."""
    return Frame(0x321, struct.pack("<BH", enable, round(100 * volts)))


def write(line: Line, plate: PlateNode, index: int, subindex: int, value: int) -> int:
    return line.write_entry(plate, plate.od.entry(index, subindex), value)


def map_inputs(line: Line, plate: PlateNode, *mapped: int, timer_ms: int = 3) -> None:
    """Configure RPDO 2 as a master does; by default it carries both inputs."""
    writes = [(0x1401, 5, timer_ms)]
    if mapped:
        writes += [(0x1601, subindex, value) for subindex, value in enumerate((0, *mapped))]
        writes += [(0x1601, 0, len(mapped))]
    for where in (*writes, (0x1401, 1, 0x321)):
        assert write(line, plate, *where) == 0


def configured(*mapped: int) -> tuple[Line, PlateNode]:
    """A plate at 0 V whose hardware has said nothing yet."""
    line, plate = ready_plate()
    map_inputs(line, plate, *mapped)
    return line, plate


def watched(timer_ms: int = 3) -> tuple[Line, PlateNode]:
    """A plate that puts out 20 V, with hardware that says so in each cycle."""
    line, plate = ready_plate()
    map_inputs(line, plate, timer_ms=timer_ms)
    assert cycle(line, plate, 0, says()) == 0
    assert cycle(line, plate, 20, says()) == 20
    assert cycle(line, plate, 20, says(volts=20)) == 20
    return line, plate


def assert_barred(line: Line, plate: PlateNode, *hardware: Frame) -> None:
    """Not even 0 V frees it."""
    for volts in (20, 0, 0, 20, 20):
        assert cycle(line, plate, volts, *hardware) == 0
        assert plate.block.inhibited


def assert_free_after_0_v(line: Line, plate: PlateNode) -> None:
    assert cycle(line, plate, 20, says()) == 0
    assert cycle(line, plate, 0, says()) == 0
    assert emergencies(line)[-1] == 0
    assert cycle(line, plate, 20, says()) == 20


def test_stage_hardware_is_ignored_by_default() -> None:
    line, plate = ready_plate()
    before = len(line.frames)
    assert line.send(says(enable=0)) == []
    assert cycle(line, plate, 20, says(enable=0, volts=99)) == 20
    assert line.write(plate, "Enable", 0) == 0
    assert line.write(plate, "Stage read-back", 9900) == 0
    for _ in range(50):
        assert cycle(line, plate, 20) == 20
    assert not emergencies(line)
    assert {f.can_id for f in line.frames[before:]} == {
        0x080, 0x1A1, 0x2A1, 0x3A1, 0x221, 0x321, 0x621, 0x5A1
    }  # fmt: skip


def test_hardware_stop_of_a_free_stage_makes_it_wait_for_0_v() -> None:
    line, plate = configured()
    assert cycle(line, plate, 0, says()) == 0
    assert cycle(line, plate, 20, says(enable=0), says()) == 0
    assert not emergencies(line), "the stage was not in use"
    for volts in (20, 0):
        assert cycle(line, plate, volts, says()) == 0
    assert cycle(line, plate, 20, says()) == 20


@pytest.mark.parametrize("mapped", [(), (ENABLE,), (READ_BACK,)])
def test_before_it_is_heard_the_stage_is_barred(mapped: tuple[int, ...]) -> None:
    line, plate = configured(*mapped)
    assert_barred(line, plate)
    assert emergencies(line) == [NOT_ENABLED, 0, NOT_ENABLED], "once for each time it is asked"


def test_mapping_of_hardware_input_while_in_use_is_0_v() -> None:
    line, plate = ready_plate()
    assert cycle(line, plate, 20) == 20
    map_inputs(line, plate)
    assert stage(plate) == 0
    assert emergencies(line) == [NOT_ENABLED]
    assert plate.od["Error register"].value == 0x81


def test_a_mapping_that_carries_neither_input_is_none() -> None:
    line, plate = configured(0x0005_0008)
    assert cycle(line, plate, 20, says(enable=0)) == 20


def test_enable_alone_lets_a_stage_drive_that_nobody_reads_back() -> None:
    line, plate = configured(ENABLE)
    for volts in (0, *20 * [20]):
        assert cycle(line, plate, volts, says(volts=99)) == volts
    assert cycle(line, plate, 20, says(enable=0)) == 0


def test_enable_permits_and_ends_the_drive_between_cycles() -> None:
    line, plate = watched()
    line.send(says(enable=0, volts=20))
    assert stage(plate) == 0
    assert emergencies(line) == [NOT_ENABLED]
    assert_barred(line, plate, says(enable=0))
    assert_free_after_0_v(line, plate)


def test_enable_lost_before_a_run_is_told_at_the_first_voltage() -> None:
    line, plate = configured()
    for _ in range(5):
        assert cycle(line, plate, 0, says(enable=0)) == 0
    assert not emergencies(line)
    assert cycle(line, plate, 20, says(enable=0)) == 0
    assert cycle(line, plate, 20, says(enable=0)) == 0
    assert emergencies(line) == [NOT_ENABLED]


def test_silent_hardware_is_0_v_within_its_event_timer() -> None:
    line, plate = watched()
    assert cycle(line, plate, 20) == 20
    assert cycle(line, plate, 20) == 20
    line.sync()
    assert stage(plate) == 0, "3 ms after it was heard last"
    assert emergencies(line) == [LATE, NOT_ENABLED]
    assert_barred(line, plate)
    assert_free_after_0_v(line, plate)


def test_hardware_input_out_of_range_counts_as_not_received() -> None:
    line, plate = watched()
    for _ in range(3):
        cycle(line, plate, 20, says(enable=2, volts=20))
    assert stage(plate) == 0


def test_no_event_timer_is_no_watch() -> None:
    line, plate = ready_plate()
    for timer_ms in (0, 101):
        assert write(line, plate, 0x1401, 5, timer_ms) in (
            0x0609_0031, 0x0609_0032
        )  # fmt: skip
    plate.od.entry(0x1401, 5).value = 0
    assert write(line, plate, 0x1401, 1, 0x321) == 0
    assert_barred(line, plate, says())


def cycles_to_0_v(line: Line, plate: PlateNode, told: Iterable[float], read: float) -> int:
    for count, volts in enumerate(told):
        if stage(plate) == 0:
            return count
        cycle(line, plate, volts, says(volts=read))
    raise AssertionError("it goes on")


def test_wrong_stage_read_back_is_0_v_within_5_cycles() -> None:
    line, plate = watched()
    assert cycles_to_0_v(line, plate, [20] * 9, read=140) == 4
    assert emergencies(line) == [STAGE]
    assert plate.od["Error register"].value == 0x05
    assert_barred(line, plate, says(volts=140))
    # Wrong readings are forgotten slowly: 21 right ones, and the one that has to come first.
    for _ in range(22):
        assert cycle(line, plate, 20, says()) == 0
    assert_free_after_0_v(line, plate)


def test_a_stage_that_stays_behind_is_at_0_v_within_5_cycles() -> None:
    line, plate = watched()
    assert cycles_to_0_v(line, plate, [60] * 9, read=20) <= 6, "5 after the one that told it so"
    assert emergencies(line) == [STAGE]


@pytest.mark.parametrize("when", ["before the drive", "after the drive"])
@pytest.mark.parametrize("age", [0, 1])
def test_a_reading_may_be_a_cycle_old_whatever_the_stage_is_told(age: int, when: str) -> None:
    line, plate = watched()
    told = [20.0, 20.0, 20.0] + [20 + 90 * (n * 7919 % 11) / 10 for n in range(200)]
    for n in range(3, 203):
        line.sync()
        if when == "before the drive":
            line.send(says(volts=told[n - 1 - age]))
        line.send(drive(round(100 * told[n]), tick_of(plate)))
        if when == "after the drive":
            line.send(says(volts=told[n - age]))
        assert stage(plate) == round(100 * told[n])
    assert not emergencies(line)


@pytest.mark.parametrize(("off", "ends"), [(1.0, False), (1.02, True)])
@pytest.mark.parametrize("sign", [1, -1])
def test_the_tolerance_is_1_v(off: float, ends: bool, sign: int) -> None:
    line, plate = watched()
    for _ in range(10):
        cycle(line, plate, 20, says(volts=20 + sign * off))
    assert (stage(plate) == 0) == ends


def test_two_wrong_readings_in_a_row_pass_and_the_third_does_not() -> None:
    line, plate = watched()
    for _ in range(5):
        for read in (140, 140, *[20] * 40):
            assert cycle(line, plate, 20, says(volts=read)) == 20
    for _ in range(3):
        cycle(line, plate, 20, says(volts=140))
    line.sync()
    assert stage(plate) == 0


def test_a_stage_that_is_live_at_0_v_does_not_get_a_voltage() -> None:
    line, plate = configured()
    for _ in range(5):
        cycle(line, plate, 0, says(volts=30))
    assert emergencies(line) == [STAGE]
    assert_barred(line, plate, says(volts=30))
    assert emergencies(line)[1:] == [0, STAGE, 0, STAGE], "and the register still says so"
    assert plate.od["Error register"].value == 0x05


@pytest.mark.parametrize("by_default", [True, False])
def test_third_wrong_stage_read_back_in_a_row_is_a_fault(by_default: bool) -> None:
    od = plate_od()
    if by_default:
        od.entry(0x1401, 1).default = 0x321
        od.entry(0x1401, 5).default = 3
    plate = PlateNode(od, deadline_ms=3)
    line = Line(plate)
    if not by_default:
        map_inputs(line, plate)
    line.nmt(START)
    said = []
    for _ in range(3):
        line.send(says(volts=1.5))
        line.sync()
        said.append(emergencies(line))
    assert said == [[], [], [STAGE]]


def test_unmapped_stage_read_back_does_not_inhibit_the_stage() -> None:
    line, plate = configured()
    for _ in range(5):
        cycle(line, plate, 0, says(volts=30))
    assert write(line, plate, 0x1401, 1, 0x8000_0321) == 0
    assert cycle(line, plate, 0) == 0
    assert cycle(line, plate, 20) == 20


DEFEATS = {
    "not valid": (0x1401, 1, 0x8000_0321),
    "another COB-ID": (0x1401, 1, 0x322),
    "at SYNC": (0x1401, 2, 1),
    "a longer timer": (0x1401, 5, 4),
    "nothing mapped": (0x1601, 0, 0),
    "enabled by SDO": (0x2031, 0, 0),
    "read back by SDO": (0x2032, 0, 1),
}


@pytest.mark.parametrize("value", [0x0005_0008, 0x2031_0008])
def test_the_mapping_is_protected_by_its_number_of_objects(value: int) -> None:
    line, plate = watched()
    entry = plate.od.entry(0x1601, 1)
    before = entry.value
    assert line.write_entry(plate, entry, value) == AbortCode.ACCESS
    assert line.write_entry(plate, entry, before) == AbortCode.ACCESS
    assert entry.value == before
    assert stage(plate) == 2000


@pytest.mark.parametrize(("index", "subindex", "value"), DEFEATS.values(), ids=DEFEATS)
def test_nothing_takes_the_watch_away_while_the_stage_is_in_use(
    index: int, subindex: int, value: int
) -> None:
    line, plate = watched()
    entry = plate.od.entry(index, subindex)
    before = entry.value
    assert line.write_entry(plate, entry, value) == STATE
    assert entry.value == before
    assert line.write_entry(plate, entry, before) == 0, "what it is may be written"
    assert stage(plate) == 2000


def test_event_timer_shortened_repeatedly_keeps_its_deadline() -> None:
    line, plate = watched(timer_ms=20)
    cycles = 0
    for timer_ms in range(19, 0, -1):
        for _ in range(timer_ms - 1):
            cycles += cycle(line, plate, 20) > 0
        assert write(line, plate, 0x1401, 5, timer_ms) == 0
    assert 15 <= cycles <= 20, "from the last frame of the hardware on"
    assert stage(plate) == 0


def test_a_mapped_input_is_not_written_by_sdo_at_0_v_either() -> None:
    line, plate = configured()
    line.send(says(enable=0))
    assert line.write(plate, "Enable", 1) == STATE
    cycle(line, plate, 0)
    assert cycle(line, plate, 20) == 0


def test_the_watch_may_be_taken_away_at_rest() -> None:
    line, plate = watched()
    cycle(line, plate, 0, says())
    line.nmt(PREOP)
    assert write(line, plate, 0x1401, 1, 0x8000_0321) == 0
    line.nmt(START)
    assert [cycle(line, plate, volts) for volts in (0, 0, 20)] == [0, 0, 20]


def test_hardware_inputs_are_forgotten_out_of_operational() -> None:
    line, plate = watched()
    line.nmt(PREOP)
    line.nmt(START)
    assert [cycle(line, plate, volts) for volts in (0, 20)] == [0, 0]


def driven_both() -> tuple[Line, PlateNode, StimulatorNode]:
    """Both nodes at 20 V, with hardware that the plate watches."""
    line, plate, node = both_nodes()
    map_inputs(line, plate, timer_ms=100)
    line.nmt(START)
    line.send(says())
    line.sync(70)
    assert line.write(node, "Setpoint.Voltage", 2000) == 0
    line.send(says())
    line.run(node, 1)
    line.sync(2)
    line.send(says(volts=20))
    line.sync(3)
    assert stage(plate) == 2000
    return line, plate, node


def limit(subindex: int, raw: int) -> Frame:
    """The write of a limit of the plate."""
    return requests.download(PLATE_ID, plate_od().entry(0x2041, subindex), raw)


@pytest.mark.parametrize(
    ("act", "watchdog", "code"),
    [
        (says(enable=0, volts=20), Watchdog.NOT_ENABLED, NOT_ENABLED),
        (says(volts=140), Watchdog.STAGE, STAGE),
        (limit(1, 1000), Watchdog.VOLTAGE, 0x3310),
        (limit(2, 1500), Watchdog.TEMPERATURE, 0x4210),
    ],
)
def test_the_stimulator_names_why_the_plate_goes_to_0_v(
    act: Frame, watchdog: Watchdog, code: int
) -> None:
    line, plate, node = driven_both()
    line.send(act)
    line.sync(30)
    assert (stage(plate), node.block.state) == (0, State.FAULT)
    assert node.block.supervisor.latched == 1 << watchdog
    assert line.read(node, "Diagnosis.Code") == code
    assert emergencies(line, EMCY_STIMULATOR) == [code]


def test_the_stimulator_names_it_again_when_it_tries_again() -> None:
    line, plate, node = driven_both()
    line.send(says(enable=0, volts=20))
    assert (stage(plate), node.block.state) == (0, State.FAULT), "at once"
    for _ in range(2):
        for word in (0, 0x80, 0):
            line.write(node, "Controlword", word)
        line.sync(5)
        assert node.block.state is State.READY
        line.send(says(enable=0))
        line.run(node, 1)
        line.sync(5)
        assert node.block.supervisor.latched == 1 << Watchdog.NOT_ENABLED

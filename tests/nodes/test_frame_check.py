"""The check of the loop's PDOs: what it is, what it finds, and what the nodes do then."""

from line import (
    DRIVE,
    PREOP,
    START,
    SYNC,
    cycle,
    drive,
    driven_both,
    ids,
    measurement,
    ready_plate,
    stage,
    stimulator_alone,
)

from smarttac_can.bench.simulation import STIMULATOR_ID
from smarttac_can.device.frame import Frame
from smarttac_can.vocabulary.states import State


def flipped(frame: Frame, bit: int) -> Frame:
    data = bytearray(frame.data)
    data[bit // 8] ^= 1 << bit % 8
    return Frame(frame.can_id, bytes(data))


def test_a_drive_with_any_wrong_bit_is_not_taken() -> None:
    line, plate = ready_plate()
    for bit in range(64):
        line.send(flipped(drive(2000, 0), bit))
        assert stage(plate) == 0, f"bit {bit}"
    assert plate.od["Cycle.Corrupt drives"].value == 49, "the others are outside their limits"
    line.sync(22)
    line.send(drive(0, 99), drive(2000, 22))
    assert stage(plate) == 2000


def test_a_disturbed_plate_takes_0_v_alone_until_20_cycles_without_a_wrong_check() -> None:
    line, plate = ready_plate()
    line.send(*[flipped(drive(2000, 0), 3)] * 4, drive(0, 0))
    assert [cycle(line, plate, 20) for _ in range(20)] == [0] * 20
    assert [cycle(line, plate, volts) for volts in (0, 20)] == [0, 20]


def test_a_measurement_with_any_wrong_bit_is_not_answered() -> None:
    line, stimulator = stimulator_alone()
    line.nmt(START)
    assert DRIVE in ids(line.send(SYNC, *measurement(0)))
    for part in range(3):
        for bit in range(64):
            frames = [SYNC, *measurement(1)]
            frames[part + 1] = flipped(frames[part + 1], bit)
            assert DRIVE not in ids(line.send(*frames)), f"part {part}, bit {bit}"
    assert stimulator.od["Cycle.Corrupt measurements"].value == 3 * 64
    assert DRIVE in ids(line.send(SYNC, *measurement(1)))


def test_plate_input_shows_whole_measurements_alone() -> None:
    line, stimulator = stimulator_alone()
    line.nmt(START)
    shown = [entry for entry in stimulator.od if entry.name.startswith("Plate input.")]
    frames = measurement(0)
    line.send(SYNC, *frames)
    before = [entry.value for entry in shown]
    assert stimulator.od["Plate input.Tick"].value == 0
    assert stimulator.od["Plate input.Check"].value == frames[-1].data[7]
    first, second, last = measurement(1)
    line.send(SYNC, first, second)
    assert [entry.value for entry in shown] == before, "two parts"
    line.send(flipped(last, 5))
    assert [entry.value for entry in shown] == before, "a wrong check"
    line.send(SYNC, first, second, last)
    assert stimulator.od["Plate input.Tick"].value == 1
    assert stimulator.od["Plate input.Check"].value == last.data[7]


def test_what_is_written_to_plate_input_is_used_by_no_cycle() -> None:
    """The controllers answer what has come, whatever a master writes between two PDOs of it."""
    outcomes = []
    for raw in (0, 9_000):
        line, stimulator = stimulator_alone()
        line.nmt(START)
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
        line.send(first, second, flipped(last, 5))
        assert stimulator.block.state is State.RUNNING
    sent = line.send(first)
    assert stimulator.block.state is State.FAULT
    assert [frame.data[:2] for frame in sent if frame.can_id == DRIVE] == [bytes(2)], "0 V"
    assert stimulator.od["Diagnosis.Code"].value == 0x8251


def test_a_drive_that_is_asked_for_is_0_v_once_the_stimulator_has_left_operational() -> None:
    line, plate, _ = driven_both()
    (asked,) = line.send(Frame(DRIVE, rtr=True))
    assert asked.data[:2] == b"\xd0\x07"
    line.nmt(PREOP, STIMULATOR_ID)
    line.nmt(START, STIMULATOR_ID)
    (asked,) = line.send(Frame(DRIVE, rtr=True))
    assert asked.data[:2] == bytes(2)
    line.sync(30)
    assert stage(plate) == 0

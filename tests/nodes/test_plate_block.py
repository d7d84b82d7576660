"""The function block of the plate without a node: ticks, drives that count, and 0 V."""

from __future__ import annotations

from typing import Any

import pytest

from smarttac_can.bench.simulation import plate_od
from smarttac_can.nodes.plate_block import PlateBlock, Taken
from smarttac_can.nodes.states import StageState
from smarttac_can.vocabulary.signals import Drive, Measurement

V20 = 2000
"""20 V in the unit of a drive."""


class Behind:
    """What is behind the objects: it measures one thing, and its stage obeys but for an excess."""

    cause = None
    trouble = ""

    def __init__(self) -> None:
        self.stage = Drive(0.0, 0.0)
        self.excess = 0.0
        self.measured: Measurement | None = Measurement(
            1e-6 - 2e-6j, (0.001, 0.002, 0.003, 0.004, 0.005, 0.006), 21.0, 3
        )
        self.written: list[str] = []

    def start_run(self, stage: Drive) -> None:
        self.stage = stage

    def sample(self) -> Measurement | None:
        return self.measured

    def move(self) -> None:
        self.stage = Drive(3.0, 43390.0)

    def put_out(self, drive: Drive) -> float:
        self.stage = Drive(drive.voltage + self.excess, drive.frequency)
        return self.stage.voltage

    def switch_off(self, drive: Drive) -> None:
        self.stage = drive

    def on_write(self, entry: Any, _value: int) -> None:
        self.written.append(entry.name)


def block_with(behind: Behind) -> PlateBlock:
    block = PlateBlock(plate_od())
    block.backend = behind  # type: ignore[assignment]
    block.start_run()
    return block


def take(block: PlateBlock, voltage: int, ago: int = 0, *, latched: bool = False) -> Taken:
    """What becomes of a drive that answers a tick some ticks ago."""
    od = block.od
    od["Drive.Voltage"].value = voltage
    od["Drive.Frequency"].value = 4_339_000
    od["Drive.Tick"].value = (od["Vibration.Tick"].value - ago) & 0xFF
    return block.take_drive(latched=latched)


def free() -> tuple[PlateBlock, Behind]:
    """Return a block that takes a voltage, in its first tick."""
    behind = Behind()
    block = block_with(behind)
    block.cycle()
    assert take(block, 0) is Taken.IN_TIME
    assert block.state is StageState.FREE
    return block, behind


def in_use() -> tuple[PlateBlock, Behind]:
    """Return a block at 20 V, in its second tick."""
    block, behind = free()
    block.cycle()
    assert take(block, V20) is Taken.IN_TIME
    assert block.state is StageState.IN_USE
    return block, behind


def shown(block: PlateBlock) -> int:
    return int(block.od["Stage.Voltage"].read())


def counted(block: PlateBlock) -> tuple[int, ...]:
    """Ticks, lost drives and foreign ones."""
    names = ("Ticks", "Lost drives", "Foreign ticks")
    return tuple(block.od[f"Cycle.{name}"].value for name in names)


def test_without_a_front_end_the_plate_is_simulated() -> None:
    assert PlateBlock(plate_od()).plate


def test_ticks_begin_with_0_and_wrap_after_255() -> None:
    block = block_with(Behind())
    ticks = []
    for _ in range(257):
        block.cycle()
        ticks.append(block.od["Vibration.Tick"].value)
        assert block.od["Gauge tick"].value == ticks[-1], "session 0"
    assert ticks == [*range(256), 0]
    assert counted(block) == (257, 0, 0)


def test_the_second_tick_is_ahead_by_the_session() -> None:
    block = block_with(Behind())
    block.session = 7
    block.cycle()
    assert block.od["Gauge tick"].value == 7
    block.session = 255
    block.cycle()
    assert (block.od["Vibration.Tick"].value, block.od["Gauge tick"].value) == (1, 0)


def test_a_measurement_stands_in_the_objects_and_none_leaves_the_last() -> None:
    behind = Behind()
    block = block_with(behind)
    for there in (True, False):
        assert block.cycle() is there
        assert [block.od[f"Vibration.{name}"].value for name in ("W_d", "W_q")] == [10_000, -20_000]
        assert [block.od[f"Gauge.S{number}"].value for number in range(1, 7)] == [
            10,
            20,
            30,
            40,
            50,
            60,
        ]
        assert block.od["Vibration.Temperature"].value == 2100
        assert block.od["Vibration.Saturation"].value == 3
        behind.measured = None


def test_a_stage_that_changes_by_itself_is_shown() -> None:
    block, behind = in_use()
    behind.stage = Drive(3.0, 43390.0)
    block.cycle()
    assert shown(block) == 300


def test_a_tick_that_is_overtaken_moves_the_plate_and_samples_nothing() -> None:
    block, behind = in_use()
    tick = block.tick.value
    behind.measured = Measurement(5e-6j, (0.0,) * 6, 30.0, 0)
    assert not block.cycle(overtaken=True)
    assert block.tick.value == tick + 1
    assert shown(block) == 300
    assert block.od["Vibration.Temperature"].value == 2100


def test_a_run_begins_at_0_v_and_barred() -> None:
    block, behind = in_use()
    take(block, V20, ago=9)
    block.cycle()
    block.cycle()
    assert counted(block) == (4, 1, 1)
    block.write("Simulation.Start run", 1)
    assert block.state is StageState.WAITING
    assert block.inhibited
    assert (block.commanded, behind.stage.voltage, shown(block)) == (0.0, 0.0, 0)
    assert block.od["Drive.Voltage"].value == 0
    assert counted(block) == (0, 0, 0)
    assert behind.written == []


def test_other_writes_are_for_what_is_behind() -> None:
    block, behind = in_use()
    block.write("Finger.Force", 600)
    assert behind.written == ["Finger.Force"]
    assert block.state is StageState.IN_USE


def test_no_voltage_before_the_first_tick() -> None:
    block = block_with(Behind())
    assert take(block, 0, ago=9) is Taken.LATE
    assert not block.inhibited
    assert take(block, V20) is Taken.NOT
    assert counted(block) == (0, 0, 1)


@pytest.mark.parametrize("voltage", [1, V20])
def test_while_barred_a_voltage_is_ignored_and_0_v_lifts_it(voltage: int) -> None:
    block = block_with(Behind())
    block.cycle()
    assert take(block, voltage) is Taken.NOT
    assert (block.inhibited, shown(block), counted(block)[2]) == (True, 0, 0)
    assert take(block, 0) is Taken.IN_TIME
    assert not block.inhibited
    block.cycle()
    assert take(block, voltage) is Taken.IN_TIME
    assert (block.commanded, shown(block)) == (voltage / 100, voltage)


@pytest.mark.parametrize("ago", [0, 1, 9])
def test_0_v_is_taken_whatever_it_answers(ago: int) -> None:
    block, _ = in_use()
    block.cycle()
    assert take(block, 0, ago) is (Taken.LATE if ago else Taken.IN_TIME)
    assert (block.commanded, shown(block), block.state) == (0.0, 0, StageState.IN_USE)


def test_0_v_of_one_in_fault_bars() -> None:
    block, _ = in_use()
    block.cycle()
    take(block, 0, latched=True)
    assert (block.state, shown(block)) == (StageState.WAITING, 0)


def test_a_voltage_does_not_begin_late() -> None:
    block, _ = free()
    block.cycle()
    block.cycle()
    assert take(block, V20, ago=1) is Taken.NOT
    assert (shown(block), counted(block)) == (0, (3, 0, 1))


def test_in_use_a_late_answer_counts_unless_it_was_answered_or_is_older() -> None:
    block, _ = in_use()
    block.cycle()
    assert take(block, 3000, ago=1) is Taken.NOT, "answered in time"
    block.cycle()
    assert take(block, 3000, ago=2) is Taken.NOT, "older than one tick"
    assert take(block, 3000, ago=-1) is Taken.NOT, "not begun"
    assert shown(block) == V20
    assert take(block, 3000, ago=1) is Taken.LATE
    assert take(block, 3100, ago=1) is Taken.NOT, "a second one"
    assert shown(block) == 3000
    assert take(block, 3200) is Taken.IN_TIME
    assert take(block, 3300) is Taken.NOT, "a second one"
    assert shown(block) == 3200
    assert counted(block) == (4, 1, 5), "the third tick had no answer in its time"


def test_a_lost_drive_counts_only_in_use() -> None:
    block, _ = free()
    block.cycle()
    block.cycle()
    assert counted(block) == (3, 0, 0)
    take(block, V20)
    block.cycle()
    assert counted(block) == (4, 0, 0)
    block.cycle()
    assert counted(block) == (5, 1, 0)


@pytest.mark.parametrize(
    ("excess", "taken"),
    [(0.5, Taken.IN_TIME), (1.0, Taken.IN_TIME), (-1.0, Taken.IN_TIME),
     (1.01, Taken.DISOBEYED), (-1.01, Taken.DISOBEYED)],
)  # fmt: skip
def test_a_stage_that_reads_back_1_v_beside_what_it_was_told_obeys(
    excess: float, taken: Taken
) -> None:
    block, behind = free()
    behind.excess = excess
    block.cycle()
    assert take(block, V20) is taken
    obeys = taken is Taken.IN_TIME
    assert block.state is (StageState.IN_USE if obeys else StageState.TRIPPED)
    assert behind.stage.voltage == (20.0 + excess if obeys else 0.0)


@pytest.mark.parametrize(
    ("act", "state"),
    [(PlateBlock.switch_off, StageState.FREE), (PlateBlock.inhibit, StageState.TRIPPED)],
)
def test_0_v_now(act: Any, state: StageState) -> None:
    block, behind = in_use()
    act(block)
    assert block.state is state
    assert block.inhibited == (state is StageState.TRIPPED)
    assert behind.stage == Drive(0.0, 43390.0)
    assert (block.commanded, block.od["Drive.Voltage"].value, shown(block)) == (0.0, 0, 0)

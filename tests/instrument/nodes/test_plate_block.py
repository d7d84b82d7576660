"""The function block of the plate without a node: ticks, drives that count, 0 V, the simulation."""

from __future__ import annotations

from typing import Any

import pytest

from smarttac_can.bench.simulation import plate_od
from smarttac_can.canopen.od.cia import Abort, AbortCode
from smarttac_can.instrument.nodes.plate_block import PlateBlock, Taken
from smarttac_can.instrument.nodes.states import StageState
from smarttac_can.science.plant.finger import Lifted, Stroke, Trajectory
from smarttac_can.vocabulary.faults import FaultKind
from smarttac_can.vocabulary.signals import Drive, Measurement

V20 = 2000
"""20 V in the unit of a drive."""
GAUGES = [f"Gauge.S{number}" for number in range(1, 7)]


class Behind:
    """Plate behind the objects: it measures one thing, and its stage obeys but for an excess."""

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
    """The verdict on a drive that answers a tick some ticks ago."""
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


def test_measurement_stays_in_the_objects_without_a_new_one() -> None:
    behind = Behind()
    block = block_with(behind)
    for there in (True, False):
        assert block.cycle() is there
        assert [block.od[f"Vibration.{name}"].value for name in ("W_d", "W_q")] == [10_000, -20_000]
        assert [block.od[name].value for name in GAUGES] == [10, 20, 30, 40, 50, 60]
        assert block.od["Vibration.Temperature"].value == 2100
        assert block.od["Vibration.Saturation"].value == 3
        behind.measured = None


def test_a_stage_that_changes_by_itself_is_shown() -> None:
    block, behind = in_use()
    behind.stage = Drive(3.0, 43390.0)
    block.cycle()
    assert shown(block) == 300


def test_overtaken_tick_moves_the_plate_without_a_sample() -> None:
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


def test_plate_block_passes_simulation_writes_to_its_plate() -> None:
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


def test_late_answer_counts_in_use_unless_answered_or_older() -> None:
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
def test_stage_read_back_within_1_v_of_the_command_obeys(excess: float, taken: Taken) -> None:
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


# The simulated plate behind its objects: whose finger it is, how that moves, and its faults.


RECORDING = Trajectory([(0.0, 0.0, 0.8), (1.0, 0.0, 0.8)])
NAMES = (
    "dry", "fair", "supple", "moist", "sticky", "fitted-1", "fitted-2", "fitted-3", "fitted-4"
)  # fmt: skip


def test_the_subjects_are_numbered_from_1() -> None:
    block = PlateBlock(plate_od())
    for number, name in enumerate(NAMES, 1):
        block.write("Simulation.Subject", number)
        block.write("Simulation.Start run", 1)
        assert block.plate._subject.name == name


def finger_of(block: PlateBlock, motion: int) -> object:
    block.write("Finger.Motion", motion)
    block.write("Simulation.Start run", 1)
    return block.plate._finger


def test_the_finger_is_lifted_strokes_or_is_the_recorded_one() -> None:
    block = PlateBlock(plate_od(), RECORDING)
    assert finger_of(block, 2) is RECORDING
    assert isinstance(finger_of(block, 1), Stroke)
    assert isinstance(finger_of(block, 0), Lifted)


def test_recorded_finger_without_a_recording_is_refused() -> None:
    block = PlateBlock(plate_od())
    with pytest.raises(Abort) as refused:
        block.write("Finger.Motion", 2)
    assert refused.value.code == AbortCode.STATE
    assert isinstance(finger_of(block, 1), Stroke)
    block.write("Simulation.Seed", 2)
    assert block.od["Simulation.Seed"].value == 2


def test_stored_recorded_finger_without_recording_is_lifted() -> None:
    block = PlateBlock(plate_od())
    block.od["Finger.Motion"].value = 2
    block.start_run()
    assert isinstance(block.plate._finger, Lifted)


def readings(block: PlateBlock) -> list[float]:
    """Means of 64 samples of S1..S6 in N, whose noise is 4.3 mN."""
    rows = []
    for _ in range(64):
        block.cycle()
        rows.append([block.od[name].si_value for name in GAUGES])
    return [sum(column) / 64 for column in zip(*rows, strict=True)]


def test_weight_acts_at_once_and_outlasts_start_run() -> None:
    block = PlateBlock(plate_od())
    bare = readings(block)
    for name, raw in (("Force x", 500), ("Force y", -250), ("Normal force", 2000)):
        block.write(f"Weight.{name}", raw)
    loads = [0.49, -0.27, 0.5, 0.5, 0.5, 0.5]
    for act in (lambda: None, block.start_run):
        act()
        under = readings(block)
        assert [u - b for u, b in zip(under, bare, strict=True)] == pytest.approx(loads, abs=5e-3)
    block.write("Weight.Position", 1400)  # half way to S4 and S6
    loads[2:] = [0.25, 0.75, 0.25, 0.75]
    under = readings(block)
    assert [u - b for u, b in zip(under, bare, strict=True)] == pytest.approx(loads, abs=5e-3)
    for name in ("Force x", "Force y", "Normal force"):
        block.write(f"Weight.{name}", 0)
    assert readings(block) == pytest.approx(bare, abs=5e-3)


def break_it(block: PlateBlock, kind: int, sensor: int, value: int, delay: int = 0) -> None:
    for name, raw in (("Sensor", sensor), ("Value", value), ("Delay in cycles", delay)):
        block.write(f"Fault.{name}", raw)
    block.write("Fault.Kind", kind)


def saturation(block: PlateBlock) -> int:
    """Sensors in the next tick."""
    block.cycle()
    return int(block.od["Vibration.Saturation"].value)


def test_injected_fault_waits_for_its_delay_or_ends_at_start_run() -> None:
    block = PlateBlock(plate_od())
    break_it(block, FaultKind.SATURATED, 1, 0, delay=3)
    assert [saturation(block) for _ in range(4)] == [0, 0, 0, 1]
    break_it(block, FaultKind.SATURATED, 1, 0, delay=5)
    block.start_run()
    assert [saturation(block) for _ in range(10)] == [0] * 10


@pytest.mark.parametrize(("name", "raw"), [("Fault.Kind", 0), ("Simulation.Start run", 1)])
def test_a_fault_is_cleared(name: str, raw: int) -> None:
    block = PlateBlock(plate_od())
    break_it(block, FaultKind.SATURATED, 2, 0)
    assert saturation(block) == 2
    block.write(name, raw)
    assert block.od["Fault.Kind"].value == 0
    assert saturation(block) == 0


def test_a_value_that_makes_no_sense_for_the_kind_is_refused() -> None:
    block = PlateBlock(plate_od())
    with pytest.raises(Abort) as refused:
        break_it(block, FaultKind.QUALITY, 1, 0)
    assert refused.value.code == AbortCode.VALUE
    assert block.od["Fault.Kind"].value == 0


@pytest.mark.parametrize(("value", "volts"), [(0, V20), (6000, 6000)])
def test_a_stage_gets_stuck_where_it_is_or_at_another_voltage(value: int, volts: int) -> None:
    block = PlateBlock(plate_od())
    for voltage in (0, V20):
        block.cycle()
        assert take(block, voltage) is Taken.IN_TIME
    break_it(block, FaultKind.STAGE_STUCK, 1, value)
    block.cycle()
    assert shown(block) == volts
    assert take(block, volts + 50) is Taken.IN_TIME, "within the tolerance it seems to obey"
    assert shown(block) == volts
    block.cycle()
    assert take(block, 500) is Taken.DISOBEYED
    assert shown(block) == 0
    block.write("Fault.Kind", 0)
    block.cycle()
    take(block, 0)
    block.cycle()
    assert (take(block, 700), shown(block)) == (Taken.IN_TIME, 700)

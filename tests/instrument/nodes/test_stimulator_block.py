"""The function block of the stimulator with the plate inside, cycle by cycle, without a node."""

from __future__ import annotations

import pytest
from inside import Loop

from smarttac_can.bench.simulation import plate_od, stimulator_od
from smarttac_can.instrument.nodes.plate_block import PlateBlock
from smarttac_can.instrument.nodes.stimulator_block import StimulatorBlock
from smarttac_can.science.control.mode_shape import shape_of
from smarttac_can.science.control.predictive_friction import with_mode_shape
from smarttac_can.science.plant.finger import Trajectory
from smarttac_can.vocabulary.faults import PICKUP, FaultKind
from smarttac_can.vocabulary.signals import Drive
from smarttac_can.vocabulary.states import State, Status
from smarttac_can.vocabulary.textures import Axis, TextureTable
from smarttac_can.vocabulary.watchdogs import Watchdog

OFF, OPEN_LOOP, AMPLITUDE, AMPLITUDE_RESONANCE, FRICTION, IDENTIFY, TEXTURE = range(7)
STATE, VALUE = 0x08000022, 0x06090030
ZERO_OF_S3, CALIBRATION = "Gauge zero.Zero of S3", "Calibration.Fx from S1"


@pytest.fixture
def loop() -> Loop:
    return Loop()


@pytest.fixture
def driving(loop: Loop) -> Loop:
    loop.run(OPEN_LOOP)
    loop.tick(20)
    assert loop.shown("Drive.Voltage") == [2000]
    return loop


@pytest.mark.parametrize(
    ("voltage", "modes"), [(0, [OPEN_LOOP, OPEN_LOOP]), (50, [OFF, OPEN_LOOP])]
)
def test_first_drive_of_a_run_is_0_v_and_the_voltage_follows(
    loop: Loop, voltage: int, modes: list[int]
) -> None:
    assert loop.write("Setpoint.Voltage", voltage) == 0
    assert loop.write("Simulation.Start run", 1) == 0
    loop.run(OPEN_LOOP)
    for mode, drive in zip(modes, (0, voltage), strict=True):
        loop.tick()
        assert loop.shown("Mode display", "Drive.Voltage") == [mode, drive]


@pytest.mark.parametrize("name", [ZERO_OF_S3, CALIBRATION])
def test_zeros_and_calibration_are_locked_with_a_force_fault(loop: Loop, name: str) -> None:
    (raw,) = loop.shown(name)
    assert loop.write("Controlword", 1) == 0
    loop.block.observe(Watchdog.NORMAL_FORCE, True)
    assert loop.block.state is State.FAULT
    assert loop.write(name, raw + 1) == STATE
    assert loop.write(name, raw) == 0, "what was read may be written back"
    assert loop.write("Model.Load", 900) == 0, "it hides no force"
    loop.tick()
    assert loop.write(name, raw + 1) == 0, "the force is gone"


def test_a_zero_is_in_force_from_the_next_cycle(loop: Loop) -> None:
    (zero,) = loop.shown(ZERO_OF_S3)
    assert abs(loop.shown("Contact.Normal force")[0]) < 50
    assert loop.write(ZERO_OF_S3, zero + 10_000) == 0
    loop.tick()
    assert abs(loop.shown("Contact.Normal force")[0]) > 500


def test_a_limit_is_watched_from_the_next_cycle(driving: Loop) -> None:
    assert driving.write("Limit.Temperature", 1000) == 0
    assert driving.block.state is State.RUNNING
    driving.tick()
    assert driving.latched == 1 << Watchdog.TEMPERATURE


@pytest.mark.parametrize("record", ["Model", "Controller", "Calibration", "Limit"])
def test_a_block_takes_any_value_that_its_eds_allows(loop: Loop, record: str) -> None:
    for entry in loop.block.od:
        if not entry.name.startswith(f"{record}.") or not entry.writable:
            continue
        for raw in (int(entry.low), int(entry.high), entry.default):
            # The two ends of the frequency range must not pass each other.
            meets = (entry.name, raw) in (
                ("Limit.Lowest frequency", int(entry.high)),
                ("Limit.Highest frequency", int(entry.low)),
            )
            assert loop.write(entry.name, raw) == (VALUE if meets else 0), entry.name
            loop.tick()


def test_a_fault_of_the_plate_inside_lasts_until_the_next_run(loop: Loop) -> None:
    for name, raw in (("Sensor", 5), ("Value", 0), ("Kind", FaultKind.SATURATED)):
        assert loop.write(f"Fault.{name}", raw) == 0
    loop.tick()
    assert loop.shown("Plate input.Saturation") == [1 << 4]
    assert loop.write("Simulation.Start run", 1) == 0
    loop.tick()
    assert loop.shown("Fault.Kind", "Plate input.Saturation") == [0, 0]


def test_a_plate_inside_leaves_no_time_for_late_drives(driving: Loop) -> None:
    """With a plate node, whose drives may be late by 17 ms, this would take 27 cycles."""
    for name, raw in (("Sensor", PICKUP), ("Value", 10), ("Kind", FaultKind.GAIN)):
        assert driving.write(f"Fault.{name}", raw) == 0
    driving.tick(9)
    assert driving.latched == 0
    driving.tick()
    assert driving.latched == 1 << Watchdog.PICKUP


def test_lower_limit_by_drive_cuts_the_voltage_without_a_fault(driving: Loop) -> None:
    assert driving.shown("Drive.Voltage") == [2000]
    assert driving.write("Limit.Amplitude by drive", 300) == 0
    driving.tick(200)
    assert driving.block.state is State.RUNNING
    (cut,) = driving.shown("Drive.Voltage")
    # 300 nm at 50 nm/V, of which the finger takes some.
    assert 600 <= cut < 1200
    assert driving.shown("Statusword")[0] & Status.LIMITED


def test_a_model_is_in_force_from_the_next_cycle(loop: Loop) -> None:
    before = loop.shown("Model.Quality")
    assert loop.write("Model.Tau", 18_880) == 0
    assert loop.write("Setpoint.Amplitude", 1000) == 0
    loop.tick()
    assert loop.block.cascade.model.tau == pytest.approx(1.888e-3)
    assert loop.shown("Model.Quality") == [pytest.approx(2 * before[0], abs=1)]


def test_message_has_the_fault_not_the_end_of_the_controllers(driving: Loop) -> None:
    # A value by RPDO is not refused.
    driving.block.od["Mode"].value = TEXTURE
    driving.tick()
    assert driving.latched == 1 << Watchdog.CONTROLLER
    assert driving.block.cascade.reason == "there is no texture"
    assert driving.message == "the controllers gave no finite drive"


def identified(loop: Loop) -> None:
    """Identify the plate to the end."""
    for _ in range(3000):
        loop.tick()
        if loop.shown("Model.State") != [1]:
            break
    assert loop.shown("Model.State", "Model.Progress", "Mode") == [2, 100, OFF]


def test_an_identification_shows_how_far_it_is(loop: Loop) -> None:
    loop.run(IDENTIFY)
    loop.tick(5)
    assert loop.shown("Model.State") == [1]
    loop.tick(100)
    assert 1 <= loop.shown("Model.Progress")[0] <= 50
    identified(loop)
    assert loop.message == ""


def test_identification_end_keeps_an_unrelated_message(loop: Loop) -> None:
    loop.run(IDENTIFY)
    loop.tick(5)
    assert loop.write("Texture table.Table 1", b"no table") == VALUE
    told = loop.message
    assert told.startswith("texture refused")
    identified(loop)
    assert loop.message == told


def test_finished_identification_does_not_act_on_later_modes() -> None:
    drives: list[list[Drive]] = []
    for forgotten in (False, True):
        loop = Loop()
        loop.run(IDENTIFY)
        identified(loop)
        cascade = loop.block.cascade
        if forgotten:
            cascade.identification = None
        assert loop.write("Setpoint.Amplitude", 1000) == 0
        loop.run(AMPLITUDE)
        drives.append([])
        for _ in range(50):
            loop.tick()
            drives[-1].append(cascade.drive)
    assert drives[0] == drives[1]
    assert drives[0][-1].voltage > 10.0


def test_a_fault_that_goes_is_no_other_fault() -> None:
    loop = Loop()
    loop.run(OPEN_LOOP)
    loop.tick(3)
    for watchdog in (Watchdog.HEARTBEAT, Watchdog.NMT):
        loop.block.observe(watchdog, False)
    loop.tick()
    assert loop.block.state is State.RUNNING
    assert (loop.block.supervisor.present, loop.block.supervisor.latched) == (0, 0)


def test_a_write_to_something_else_lets_a_texture_go_on() -> None:
    loop = Loop()
    table = TextureTable(Axis.TIME, True, 0, 5000, (3000, 4000)).pack()
    assert loop.write("Texture table.Table 1", table) == 0
    loop.run(TEXTURE)
    loop.tick(20)
    cascade = loop.block.cascade
    played = cascade.state.playing.ticks
    assert played > 10
    assert loop.write("Limit.Voltage", 14_000) == 0
    loop.tick()
    assert cascade.state.playing.ticks == played + 1
    assert cascade.parameters.V_max == 140.0
    assert loop.write("Texture.Slot", 1) == 0
    loop.tick()
    assert cascade.state.playing.ticks == 1


def test_mode_shape_is_stored_at_the_end_of_a_touch() -> None:
    loop = Loop(Trajectory([(0.1, 0.0, 0.5), (0.15, 5e-3, 0.5)]))
    assert loop.write("Finger.Motion", 2) == 0
    assert loop.write("Simulation.Start run", 1) == 0
    loop.tick(120)
    assert loop.shown("Contact.Touching") == [1]
    cascade = loop.block.cascade
    sliding = cascade.state.sliding
    learned = cascade.mode_shape._replace(c=0.05123, s=-0.02, cc=1e-4)
    cascade._state = cascade.state._replace(sliding=with_mode_shape(sliding, learned))
    assert loop.shown("Mode shape.Cosine", "Mode shape.Sine") == [0, 0]
    loop.tick(100)
    assert loop.shown("Contact.Touching", "Mode shape.Cosine", "Mode shape.Sine") == [0, 512, -200]
    assert cascade.mode_shape == learned, "what was learned stays exact and sure"
    assert cascade.parameters.shape_cosine == pytest.approx(0.0512)
    assert loop.write("Mode shape.Cosine", 300) == 0
    loop.tick()
    assert cascade.mode_shape == pytest.approx(shape_of(8e-3, 0.03, -0.02))
    assert loop.write("Simulation.Start run", 1) == 0
    loop.tick()
    assert loop.block.cascade.mode_shape == pytest.approx(shape_of(8e-3, 0.03, -0.02))


def test_written_zero_is_a_tare_and_other_writes_are_not() -> None:
    od = stimulator_od()
    od["Tare at power-on"].value = 0
    block = StimulatorBlock(od, PlateBlock(plate_od()))
    od["Gauge zero.Zero of S3"].value = 300
    block.write("Limit.Voltage", 14_000)
    block.tick()
    assert not block.supervisor.tared
    block.write("Gauge zero.Zero of S3", 310)
    block.tick()
    assert block.supervisor.tared
    assert block.cascade.zero[2] == pytest.approx(0.031)

"""There is no way round a fault, or into a drive, but the one that is meant."""

import pytest
from driven import (
    FAULT_RESET,
    MASTER,
    STATE,
    driven,
    reset_fault,
    write,
    write_entry,
)
from line import RESET_COMMUNICATION, START, SYNC, Line

from smarttac_can.assurance.trials.rig import Rig
from smarttac_can.bench.simulation import PLATE_ID, STIMULATOR_ID, plate_od, stimulator_od
from smarttac_can.canopen.master import requests
from smarttac_can.instrument.nodes.plate_node import PlateNode
from smarttac_can.instrument.nodes.stimulator_node import StimulatorNode
from smarttac_can.vocabulary.faults import THERMOMETER, FaultKind
from smarttac_can.vocabulary.states import Mode, State
from smarttac_can.vocabulary.watchdogs import Watchdog


def latched(rig: Rig, watchdog: Watchdog) -> bool:
    return bool(rig.od["Diagnosis.Latched"].value >> watchdog & 1)


def test_start_run_keeps_a_fault_that_is_present() -> None:
    rig = driven(Mode.AMPLITUDE_RESONANCE)
    rig.inject(FaultKind.STUCK, THERMOMETER)
    rig.cycle(110)
    assert latched(rig, Watchdog.STUCK)
    assert write_entry(rig, rig.od["Simulation.Start run"], 1) == 0
    for _ in range(20):
        assert reset_fault(rig) == STATE
        rig.cycle()
    rig.mend()
    rig.cycle(20)
    assert reset_fault(rig) == 0


def test_a_heartbeat_that_was_lost_before_a_reset_can_be_reset() -> None:
    rig = driven()
    rig.heartbeat = False
    rig.cycle(1001)
    assert latched(rig, Watchdog.HEARTBEAT)
    assert reset_fault(rig) == STATE
    rig.nmt(RESET_COMMUNICATION, 0x20)
    rig.nmt(START, 0x20)
    rig.cycle(20)
    assert reset_fault(rig) == 0


def test_a_setpoint_that_is_waited_for_no_more_can_be_reset() -> None:
    rig = driven()
    rig.each_cycle.clear()
    rig.cycle(20)
    assert latched(rig, Watchdog.SETPOINT)
    assert reset_fault(rig) == STATE
    assert write_entry(rig, rig.od.entry(0x1401, 5), 0) == 0
    assert reset_fault(rig) == 0


def test_a_period_that_disagrees_ends_the_drive_at_once() -> None:
    rig = driven()
    # No write does this to a run; a program in the device might.
    rig.od.entry(0x1006).value = 2000
    rig.cycle(2)
    assert rig.stage.read() == 0
    assert latched(rig, Watchdog.MEASUREMENT)


def test_nobody_else_produces_the_sync_of_a_producer() -> None:
    plate = PlateNode(plate_od(), deadline_ms=3)
    node = StimulatorNode(stimulator_od(), plate_node_id=PLATE_ID, produce_sync=True, deadline_ms=3)
    line = Line(plate, node, lockstep=False)
    assert line.write(node, "Drive unwatched", 1) == 0
    line.nmt(START)
    line.advance(100)
    assert line.write(node, "Setpoint.Voltage", 2000) == 0
    line.run(node, 1)
    line.advance(50)
    assert plate.od["Stage.Voltage"].read() == 2000
    line.send(SYNC)
    assert plate.od["Stage.Voltage"].read() == 0
    assert node.od["Diagnosis.Latched"].value == 1 << Watchdog.DOUBLE
    line.send(SYNC)
    line.advance(2999)
    assert line.write(node, "Controlword", 0) == 0
    assert line.write(node, "Controlword", FAULT_RESET) == STATE
    line.advance(1)
    assert line.write(node, "Controlword", 0) == 0
    assert line.write(node, "Controlword", FAULT_RESET) == 0
    line.run(node, 1)
    line.advance(50)
    assert plate.od["Stage.Voltage"].read() == 2000


def test_the_tare_at_power_on_does_not_come_while_armed() -> None:
    rig = driven(Mode.AMPLITUDE_RESONANCE)
    names = [f"Gauge zero.Zero of S{number}" for number in range(1, 7)]
    zeros = [rig.od[name].value for name in names]
    assert write(rig, "Controlword", 0) == 0
    for name in names:
        assert write(rig, name, 0) == 0
    assert write_entry(rig, rig.od["Simulation.Start run"], 1) == 0
    for name, zero in zip(names, zeros, strict=True):
        assert write(rig, name, zero) == 0
    rig.cycle(3)
    rig.drive(Mode.AMPLITUDE_RESONANCE)
    rig.cycle(100)
    assert rig.state is State.RUNNING
    assert [rig.od[name].value for name in names] == zeros


@pytest.mark.parametrize("rpdo", [0x1404, 0x1405, 0x1406])
def test_a_measurement_pdo_that_is_disabled_makes_not_ready(rpdo: int) -> None:
    rig = driven()
    assert write(rig, "Controlword", 0) == 0
    entry = rig.od.entry(rpdo, 1)
    assert write_entry(rig, entry, entry.value | 1 << 31) == 0
    rig.cycle(4)
    assert not latched(rig, Watchdog.MEASUREMENT)
    assert rig.state is State.NOT_READY


def test_foreign_sync_is_accepted_when_the_node_produces_none() -> None:
    rig = driven()
    assert write(rig, "Controlword", 0) == 0
    rig.nmt(0x80, PLATE_ID)
    for index, raw in ((0x1006, 0), (0x1019, 0), (0x1006, 1000)):
        for node_id, od in ((STIMULATOR_ID, rig.od), (PLATE_ID, rig.plate.od)):
            assert write_entry(rig, od.entry(index), raw, node_id) == 0
    rig.nmt(0x01, PLATE_ID)
    producer = rig.od.entry(0x1005)
    rig.syncs = 0
    assert write_entry(rig, producer, 0x4000_0080) == 0
    rig.bus.advance(20_000)
    assert write_entry(rig, producer, 0x80) == 0
    for _ in range(20):
        rig.bus.advance(1_000)
        rig.master.send(SYNC, requests.heartbeat(MASTER), *rig.each_cycle)
    assert rig.od["Diagnosis.Present"].value == 0
    assert rig.state is State.READY

"""The rig: time, SDO, emergencies, and a master that can fall silent."""

import pytest

from smarttac_can.assurance.trials.rig import MasterTraffic, Rig
from smarttac_can.bench.simulation import PLATE_ID, STIMULATOR_ID
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.od.cia import NMTCommand
from smarttac_can.vocabulary.faults import FaultCode
from smarttac_can.vocabulary.states import Mode


@pytest.fixture
def rig() -> Rig:
    rig = Rig()
    rig.start()
    return rig


def test_rig_reads_back_a_write_from_the_right_node(rig: Rig) -> None:
    rig.write("Setpoint.Amplitude", 700)
    rig.write("Simulation.Subject", 4)
    assert rig.read("Setpoint.Amplitude") == 700
    assert rig.plate_block.od["Simulation.Subject"].value == 4


@pytest.mark.parametrize(("plate_inside", "can_id"), [(False, 0x4A1), (True, 0x4A0)])
def test_stage_is_told_in_every_cycle_after_every_reset(plate_inside: bool, can_id: int) -> None:
    told: list[bytes] = []

    def note(_time: int, frame: Frame) -> None:
        if frame.can_id == can_id:
            told.append(frame.data[:2])

    rig = Rig(plate_inside=plate_inside, log=note)
    for command in (NMTCommand.START, NMTCommand.RESET_COMMUNICATION, NMTCommand.RESET_NODE):
        rig.nmt(command)
        rig.start()
        told.clear()
        rig.cycle(10)
        assert told == [bytes(2)] * 10
    rig.write("Setpoint.Voltage", 2000)
    rig.start_run()
    rig.drive(Mode.OPEN_LOOP)
    rig.cycle(10)
    assert told[-1] == b"\xd0\x07"


def test_notes_emergencies_of_both_nodes(rig: Rig) -> None:
    for node_id in (PLATE_ID, STIMULATOR_ID):
        rig.bus.connect(lambda frame: None).send(
            Frame(0x80 + node_id, bytes.fromhex("1052810000000000"))
        )
    codes = [(emcy.node_id, emcy.code, emcy.register) for emcy in rig.emergencies]
    assert [code for code in codes if code[1] != FaultCode.DOUBLE] == [
        (PLATE_ID, 0x5210, 0x81),
        (STIMULATOR_ID, 0x5210, 0x81),
    ]


def test_syncs_carry_a_counter_that_both_nodes_take(rig: Rig) -> None:
    rig.nmt(NMTCommand.ENTER_PRE_OPERATIONAL)
    rig.count_syncs()
    rig.nmt(NMTCommand.START)
    before = rig.plate_block.od["Cycle.Ticks"].value
    rig.cycle(500)
    assert rig.plate_block.od["Cycle.Ticks"].value == before + 500
    assert not rig.emergencies


def test_random_traffic_is_the_same_with_the_same_seed() -> None:
    def frames(seed: int) -> list[Frame]:
        heard: list[Frame] = []
        rig = Rig(log=lambda _time, frame: heard.append(frame))
        rig.start()
        traffic = MasterTraffic(rig, seed)
        for _ in range(300):
            traffic.send()
            rig.cycle()
        return heard

    assert frames(1) == frames(1)
    assert frames(1) != frames(2)

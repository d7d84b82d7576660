"""Textures of a stimulator: written over SDO, refused when they cannot be played, and played."""

import canopen
import pytest
from canopen.sdo.exceptions import SdoAbortedError
from line import Line

from smarttac_can.bench.network import LocalNetwork
from smarttac_can.bench.simulation import (
    STIMULATOR_ID,
    plate_od,
    stimulator_od,
    stimulator_with_plate,
)
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.device.storage import Memory
from smarttac_can.canopen.master import requests
from smarttac_can.canopen.od.cia import AbortCode
from smarttac_can.instrument.nodes.plate_block import PlateBlock
from smarttac_can.instrument.nodes.stimulator_node import StimulatorNode
from smarttac_can.science.control.texture import NO_TEXTURE
from smarttac_can.vocabulary.states import Control, Mode, State
from smarttac_can.vocabulary.textures import Axis, TextureTable

TABLES = 0x2061
SAVE = int.from_bytes(b"save", "little")
GRATING = TextureTable(Axis.POSITION, True, 0, 100_000, (3000,) * 10 + (4000,) * 10)
LONGEST = TextureTable(Axis.POSITION, False, -38_000_000, 18_555, tuple(range(2000, 6096)))


class Bench:
    """A stimulator with the plate inside, and python-canopen as its master."""

    def __init__(self) -> None:
        self.node = stimulator_with_plate()
        self.line = Line(self.node)
        network = LocalNetwork(self.line.bus)
        self.sdo = network.add_node(STIMULATOR_ID, canopen.ObjectDictionary()).sdo
        self.line.nmt(0x01)
        self.write("Finger.Motion", 1)
        self.write("Simulation.Subject", 2)
        self.write("Simulation.Start run", 1)
        self.line.sync(120)

    def write(self, name: str, raw: int) -> int:
        return self.line.write(self.node, name, raw)

    def download(self, slot: int, data: bytes, *, block: bool = True) -> None:
        with self.sdo.open(
            TABLES, slot, "wb", block_transfer=block, size=len(data), buffering=8192
        ) as stream:
            stream.write(data)

    def upload(self, slot: int) -> bytes:
        return bytes(self.sdo.upload(TABLES, slot))

    def run(self, mode: Mode = Mode.TEXTURE) -> None:
        assert self.write("Mode", mode) == 0
        assert self.write("Controlword", Control.ARM) == 0
        assert self.write("Controlword", Control.ARM | Control.RUN) == 0

    @property
    def message(self) -> str:
        return str(self.node.od["Message"].value)


@pytest.fixture
def bench() -> Bench:
    return Bench()


@pytest.mark.parametrize("block", [True, False])
@pytest.mark.parametrize("slot", [1, 4])
def test_a_table_is_written_and_read_back(bench: Bench, slot: int, block: bool) -> None:
    assert bench.upload(slot) == b""
    bench.download(slot, LONGEST.pack(), block=block)
    assert bench.upload(slot) == LONGEST.pack()


BROKEN = {
    "checksum": (GRATING.pack()[:-1] + b"\0", "the checksum is not that of the content"),
    "too long": (bytes(9000), "number of bytes 9000 is outside 22..8212"),
    "out of range": (
        TextureTable(Axis.POSITION, True, 0, 1000, (3000, 499)).pack(),
        "COF 0.0499 of value 1 is outside 0.05..2",
    ),
}


@pytest.mark.parametrize("what", BROKEN)
@pytest.mark.parametrize("block", [True, False])
def test_a_broken_table_is_refused_and_the_old_one_stays(
    bench: Bench, what: str, block: bool
) -> None:
    bench.download(1, GRATING.pack())
    bench.run()
    bench.line.sync(100)
    data, reason = BROKEN[what]
    with pytest.raises(SdoAbortedError) as refused:
        bench.download(1, data, block=block)
    assert refused.value.code == AbortCode.VALUE
    assert bench.message == f"texture refused: {reason}"
    assert bench.upload(1) == GRATING.pack()
    bench.line.sync(100)
    assert bench.node.block.state is State.RUNNING
    assert 0.3 <= bench.node.block.cascade.mu_ref <= 0.4


def test_a_broken_table_is_refused_in_the_last_slot_too(bench: Bench) -> None:
    with pytest.raises(SdoAbortedError) as refused:
        bench.download(4, BROKEN["checksum"][0])
    assert refused.value.code == AbortCode.VALUE


def test_slots_that_are_not_played_are_free(bench: Bench) -> None:
    assert bench.write("Setpoint.Amplitude", Mode.TEXTURE) == 0, "a number like that of the mode"
    assert bench.write("Texture.Slot", 2) == 0, "empty"
    assert bench.write("Texture.Slot", 1) == 0
    for slot in (1, 2):
        bench.download(slot, GRATING.pack())
    bench.download(1, b"", block=False)
    bench.download(1, GRATING.pack())
    bench.run()
    bench.line.sync(10)
    bench.download(2, b"", block=False)
    assert (bench.upload(1), bench.upload(2)) == (GRATING.pack(), b"")
    assert bench.node.block.state is State.RUNNING


def test_an_empty_slot_is_not_played(bench: Bench) -> None:
    assert bench.write("Mode", Mode.TEXTURE) == AbortCode.NO_DATA
    assert bench.message == "texture slot 1 is empty"
    assert bench.node.od["Mode"].value == Mode.OFF
    bench.download(1, GRATING.pack())
    bench.run()
    bench.line.sync(10)
    assert bench.write("Texture.Slot", 2) == AbortCode.NO_DATA
    assert bench.message == "texture slot 2 is empty"
    with pytest.raises(SdoAbortedError) as refused:
        bench.download(1, b"", block=False)
    assert refused.value.code == AbortCode.STATE
    assert bench.message == "texture is played: its slot cannot be emptied"
    bench.line.sync(10)
    assert bench.node.block.state is State.RUNNING


def test_another_slot_plays_from_the_next_cycle_without_a_bump(bench: Bench) -> None:
    level = TextureTable(Axis.POSITION, False, 0, 1000, (3500,))
    bench.download(1, level.pack())
    bench.download(3, level.pack())
    bench.run()
    bench.line.sync(400)
    block = bench.node.block
    assert block.cascade.mu_ref == pytest.approx(0.35)
    before = block.cascade.drive
    bench.write("Texture.Slot", 3)
    bench.line.sync()
    # The loop hunts by some volts in each cycle; from 0 it would begin 50 V below.
    assert abs(block.cascade.drive.voltage - before.voltage) < 25.0
    bench.download(3, TextureTable(Axis.POSITION, False, 0, 1000, (4000,)).pack())
    bench.line.sync()
    assert block.cascade.mu_ref == pytest.approx(0.40)


def test_the_preview_is_that_of_the_object(bench: Bench) -> None:
    assert bench.node.block.cascade.parameters.preview == 1.5e-3
    bench.write("Texture.Preview", 3500)
    bench.line.sync()
    assert bench.node.block.cascade.parameters.preview == pytest.approx(3.5e-3)


def test_tables_outlive_a_power_cycle() -> None:
    memory = Memory()
    node = StimulatorNode(stimulator_od(), PlateBlock(plate_od()), storage=memory)
    node.start()
    node.block.write("Texture table.Table 2", GRATING.pack())
    (answer,) = node.receive(requests.download(STIMULATOR_ID, node.od.entry(0x1010, 1), SAVE))
    assert answer.data[0] == 0x60
    again = StimulatorNode(stimulator_od(), PlateBlock(plate_od()), storage=memory)
    again.start()
    assert again.od["Texture table.Table 2"].value == GRATING.pack()
    again.block.write("Texture.Slot", 2)
    again.receive(Frame(0x000, bytes((1, STIMULATOR_ID))))
    again.block.write("Mode", Mode.TEXTURE)


def test_a_stored_table_that_cannot_be_played_is_an_empty_slot() -> None:
    node = StimulatorNode(
        stimulator_od(), PlateBlock(plate_od()), presets={"Texture table.Table 1": GRATING.pack()}
    )
    node.start()
    entry = node.od["Texture table.Table 1"]
    assert entry.value == GRATING.pack()
    entry.value = b"what another version stored"
    node.block.start_run()
    assert entry.value == b""
    assert node.block.cascade.plan.texture == NO_TEXTURE

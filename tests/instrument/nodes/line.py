"""A master and nodes on a local bus, and the frames that pass there."""

from __future__ import annotations

import struct
from typing import Any

from transcript import frame, microseconds

from smarttac_can.assurance.trials.rig import LocalMaster
from smarttac_can.bench.simulation import PLATE_ID, STIMULATOR_ID, plate_od, stimulator_od
from smarttac_can.canopen.bus.local_bus import LocalBus
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.master import requests
from smarttac_can.canopen.od.cia import Abort
from smarttac_can.canopen.od.entry import Entry
from smarttac_can.instrument.nodes.loop_frames import CheckedFrames, crc8
from smarttac_can.instrument.nodes.plate_block import PlateBlock
from smarttac_can.instrument.nodes.plate_node import PlateNode
from smarttac_can.instrument.nodes.stimulator_node import StimulatorNode
from smarttac_can.vocabulary.states import Mode, State

START, STOP, PREOP, RESET, RESET_COMMUNICATION = 0x01, 0x02, 0x80, 0x81, 0x82
SYNC = Frame(0x80)
EMCY_PLATE, EMCY_STIMULATOR = 0x80 + PLATE_ID, 0x80 + STIMULATOR_ID
MEASUREMENT = (0x180 + PLATE_ID, 0x280 + PLATE_ID, 0x380 + PLATE_ID)
DRIVE = 0x200 + PLATE_ID
PUBLIC = tuple(base + STIMULATOR_ID for base in (0x180, 0x280, 0x380, 0x480))


class Line:
    """A bus in lockstep, or by the clock, with every frame that passes on it."""

    def __init__(self, *nodes: PlateNode | StimulatorNode, lockstep: bool = True) -> None:
        self.frames: list[Frame] = []
        self.bus = LocalBus(log=lambda _time, frame: self.frames.append(frame))
        self.master = LocalMaster(self.bus, lambda frame: None)
        self.nodes = nodes
        self.ports = [self.bus.attach(node, lockstep=lockstep) for node in nodes]

    def send(self, *frames: Frame) -> list[Frame]:
        """Answers of the nodes to frames of the master."""
        return self.master.send(*frames)

    def nmt(self, command: int, node_id: int = 0) -> list[Frame]:
        return self.send(requests.nmt(command, node_id))

    def sync(self, count: int = 1) -> list[Frame]:
        return [frame for _ in range(count) for frame in self.master.sync()]

    def advance(self, milliseconds: int) -> list[Frame]:
        return self._pass_time(1000 * milliseconds)

    def act(self, sign: str, what: str) -> list[Frame]:
        """Let an event of a transcript happen: the master sends, or time passes without SYNC."""
        if sign == "+":
            return self._pass_time(microseconds(what))
        assert sign == ">", f"{sign} is no event of a bus"
        return self.send(frame(what))

    def _pass_time(self, us: int) -> list[Frame]:
        before = len(self.frames)
        self.bus.advance(us)
        return self.frames[before:]

    def write(self, node: PlateNode | StimulatorNode, name: str, raw: int) -> int:
        """Write by expedited SDO; return the abort code, 0 for success."""
        return self.write_entry(node, node.od[name], raw)

    def write_entry(self, node: PlateNode | StimulatorNode, entry: Entry, raw: int) -> int:
        try:
            self.master.write(node.device.node_id, entry, raw)
        except Abort as abort:
            return abort.code
        return 0

    def run(self, node: PlateNode | StimulatorNode, mode: int) -> None:
        """Arm a stimulator that is ready, and run it in a mode."""
        for name, raw in (("Controlword", 0), ("Controlword", 1), ("Mode", mode)):
            assert self.write(node, name, raw) == 0, f"{name} {raw}"
        assert self.write(node, "Controlword", 3) == 0

    def read(self, node: PlateNode | StimulatorNode, name: str) -> int:
        return int(self.master.read(node.device.node_id, node.od[name]))


def plate_alone(**options: object) -> tuple[Line, PlateNode]:
    node = PlateNode(plate_od(), **{"deadline_ms": 3, **options})  # type: ignore[arg-type]
    return Line(node), node


def ready_plate(**options: object) -> tuple[Line, PlateNode]:
    """A plate that has had tick 0, and 0 V."""
    line, plate = plate_alone(**options)
    line.nmt(START)
    line.sync()
    line.send(drive(0, 255))
    return line, plate


def driven_plate(**options: object) -> tuple[Line, PlateNode]:
    """A plate that puts out 20 V since tick 0."""
    line, plate = ready_plate(**options)
    line.send(drive(2000, 0))
    assert stage(plate) == 2000
    return line, plate


def stimulator_alone() -> tuple[Line, StimulatorNode]:
    """A stimulator that waits for the measurements of a plate node the test plays."""
    node = StimulatorNode(stimulator_od(), plate_node_id=PLATE_ID, lockstep=True, deadline_ms=3)
    return Line(node), node


def plate_inside(*, lockstep: bool = False, **presets: int) -> tuple[Line, StimulatorNode]:
    named = {name.replace("__", ".").replace("_", " "): raw for name, raw in presets.items()}
    named = {"Drive unwatched": int(not lockstep)} | named
    node = StimulatorNode(stimulator_od(), PlateBlock(plate_od()), lockstep=lockstep, presets=named)
    return Line(node, lockstep=lockstep), node


def ready_inside(*, lockstep: bool = False, **presets: int) -> tuple[Line, StimulatorNode]:
    """A stimulator with the plate inside, tared, so that it can be armed."""
    line, node = plate_inside(lockstep=lockstep, **presets)
    line.nmt(START)
    _ = line.sync(70) if lockstep else line.advance(70)
    assert node.block.state is State.READY
    return line, node


def both_nodes(
    deadline_ms: int = 3, front_end: Any = None
) -> tuple[Line, PlateNode, StimulatorNode]:
    plate = PlateNode(plate_od(), front_end=front_end, deadline_ms=deadline_ms)
    stimulator = StimulatorNode(
        stimulator_od(), plate_node_id=PLATE_ID, lockstep=True, deadline_ms=deadline_ms
    )
    return Line(plate, stimulator), plate, stimulator


def ready_both(deadline_ms: int = 3) -> tuple[Line, PlateNode, StimulatorNode]:
    """Both nodes, tared, so that the stimulator can be armed."""
    line, plate, stimulator = both_nodes(deadline_ms)
    line.nmt(START)
    line.sync(70)
    assert stimulator.block.state is State.READY
    return line, plate, stimulator


def driven_both(deadline_ms: int = 3) -> tuple[Line, PlateNode, StimulatorNode]:
    """Both nodes, with 20 V in open loop."""
    line, plate, stimulator = ready_both(deadline_ms)
    assert line.write(stimulator, "Setpoint.Voltage", 2000) == 0
    line.run(stimulator, Mode.OPEN_LOOP)
    line.sync(5)
    assert stage(plate) == 2000
    return line, plate, stimulator


def drive(
    voltage: int,
    tick: int,
    frequency: int = 4_339_000,
    *,
    session: int = 0,
    source: int = STIMULATOR_ID,
) -> Frame:
    """The drive PDO in 10 mV and 0.01 Hz, of a sender that is told by its check alone."""
    data = struct.pack("<HIB", voltage, frequency, tick)
    return Frame(DRIVE, data + bytes((crc8(data + bytes((session, source))),)))


def measurement(tick: int, gauge_tick: int | None = None, W: int = 0) -> list[Frame]:
    """The three TPDOs of a plate node."""
    gauge_tick = tick if gauge_tick is None else gauge_tick
    parts = [
        struct.pack("<hhBBh", W, 0, tick, 0, 2000),
        bytes(8),
        struct.pack("<hhBH", 0, 0, gauge_tick, 1),
    ]
    parts[2] += bytes((crc8(b"".join(parts)),))
    return [Frame(can_id, data) for can_id, data in zip(MEASUREMENT, parts, strict=True)]


def packed(frames: CheckedFrames, unsent: bytes = b"") -> bytes:
    """Values of the entries of a drive, or of a measurement, with the right check."""
    frames.write_check(unsent)
    return b"".join(entry.pack() for entry in (*frames.entries, frames.check))


def ids(frames: list[Frame]) -> list[int]:
    return [frame.can_id for frame in frames]


def stage(plate: PlateNode) -> int:
    """Voltage of the power stage in 10 mV."""
    return int(plate.od["Stage.Voltage"].read())


def tick_of(plate: PlateNode) -> int:
    return int(plate.od["Vibration.Tick"].value)


def emergency_codes(frames: list[Frame], can_id: int) -> list[int]:
    """Codes of the emergency messages of a node among frames."""
    return [int.from_bytes(frame.data[:2], "little") for frame in frames if frame.can_id == can_id]


def emergencies(line: Line, can_id: int = EMCY_PLATE) -> list[int]:
    """Codes of the emergency messages so far, by default of the plate."""
    return emergency_codes(line.frames, can_id)


def cycle(line: Line, plate: PlateNode, volts: float, *hardware: Frame) -> float:
    """One cycle: SYNC, the hardware inputs, and a drive; return the voltage of the stage."""
    line.sync()
    line.send(*hardware)
    line.send(drive(round(100 * volts), tick_of(plate), session=plate.block.session))
    return stage(plate) / 100

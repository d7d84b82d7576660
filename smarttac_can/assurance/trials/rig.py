"""Test rigs: two simulated nodes on a bus with faults and their master, and one without a bus."""

from __future__ import annotations

import random
from collections.abc import Callable, Mapping
from functools import cache
from struct import pack
from typing import Any, Final, NamedTuple

from smarttac_can.bench.simulation import PLATE_ID, STIMULATOR_ID, plate_od, stimulator_od
from smarttac_can.canopen.bus.bus import LogHook
from smarttac_can.canopen.bus.local_bus import LocalBus, Wire
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.master import requests
from smarttac_can.canopen.master.errors import HeartbeatLostError
from smarttac_can.canopen.od import cia
from smarttac_can.canopen.od.cia import Abort, NMTCommand
from smarttac_can.canopen.od.dictionary import ObjectDictionary
from smarttac_can.canopen.od.entry import Entry
from smarttac_can.host.faulty_bus import FaultyBus
from smarttac_can.instrument.nodes.plate_block import PlateBlock, SimulatedPlate
from smarttac_can.instrument.nodes.plate_node import PlateNode
from smarttac_can.instrument.nodes.stimulator_block import StimulatorBlock
from smarttac_can.instrument.nodes.stimulator_node import StimulatorNode
from smarttac_can.science.plant.finger import Finger
from smarttac_can.science.plant.plate import Plate
from smarttac_can.vocabulary.meanings import AUTO_ZERO, SIMULATION, START_RUN, STROKE, ZERO
from smarttac_can.vocabulary.signals import HARDWARE_RPDO, SHORT_DEADLINE_MS, TARE_SAMPLES, TICK_US
from smarttac_can.vocabulary.states import Control, Mode, State
from smarttac_can.vocabulary.textures import Axis, TextureTable

MASTER_ID: Final = 1
"""Node-ID of the master."""
HEARTBEAT_CYCLES: Final = 100
"""Cycles between two heartbeats of the master, as in the bench and the docs."""
MASTER_LOST_MS: Final = 1000
"""Consumer heartbeat time in ms for the master at the stimulator, as in the bench."""
PLATE_HEARTBEAT_MS: Final = 500
"""Heartbeat period in ms of the plate, as in its EDS."""
PLATE_LOST_MS: Final = 2000
"""Consumer heartbeat time in ms for the plate, the default of the stimulator."""
_STAGE: Final = cia.TPDO_COMMUNICATION + 3
"""TPDO 4, with the power stage of the plate node or of the plate inside."""
TARE_CYCLES: Final = TARE_SAMPLES + 6
"""Cycles without a finger that suffice for the tare, even if some are lost."""
_TEXTURE: Final = TextureTable(
    Axis.POSITION, repeats=True, start=0, step=100_000, values=(3000,) * 10 + (4000,) * 10
)
"""A square grating of 2 mm in the first slot, so that every mode can drive."""
_PRESETS: Final[dict[str, int | bytes]] = {"Texture table.Table 1": _TEXTURE.pack()}
_READY_CYCLES: Final = 5
"""Cycles in which the stimulator detects that no fault is left."""


class LocalMaster:
    """Sends frames to the nodes on a `LocalBus`, and reads and writes them by expedited SDO.

    Parameters
    ----------
    bus
        Bus to connect to.
    hear
        Function called with every frame of other parties.

    Attributes
    ----------
    sync_counter
        Counter of the last SYNC, 0 for SYNC without a counter.
    """

    def __init__(self, bus: LocalBus, hear: Callable[[Frame], None]) -> None:
        self.sync_counter = 0
        self._hear = hear
        self._heard: list[Frame] = []
        self._port = bus.connect(self._on_frame)

    def send(self, *frames: Frame) -> list[Frame]:
        """Send frames; return the frames that the nodes send because of them, in order."""
        self._heard = []
        for frame in frames:
            self._port.send(frame)
        heard, self._heard = self._heard, []
        return heard

    def sync(self) -> list[Frame]:
        """Send SYNC, with the next count if it has a counter; return the frames that follow."""
        if self.sync_counter:
            self.sync_counter = self.sync_counter % cia.SYNC_COUNTER_LAST + 1
        return self.send(requests.sync(self.sync_counter))

    def read(self, node_id: int, entry: Entry) -> Any:
        """Return the raw value of an entry of 1 to 4 bytes.

        Raises
        ------
        Abort
            If the node refuses.
        HeartbeatLostError
            If the node does not answer at once.
        """
        return self._transfer(requests.upload(node_id, entry), node_id, entry)

    def write(self, node_id: int, entry: Entry, raw: Any) -> None:
        """Write a raw value to an entry of 1 to 4 bytes; raises as `read`."""
        self._transfer(requests.download(node_id, entry, raw), node_id, entry)

    def _transfer(self, request: Frame, node_id: int, entry: Entry) -> Any:
        for frame in self.send(request):
            if requests.answers(frame, request):
                return requests.value(frame, entry)
        raise HeartbeatLostError(f"node {node_id} does not answer to {entry.name}")

    def _on_frame(self, frame: Frame) -> None:
        self._heard.append(frame)
        self._hear(frame)


class BlockRig:
    """A stimulator with the plate inside, without a bus, for one run after another.

    Attributes
    ----------
    block, od
        Stimulator and its object dictionary.
    plate_block
        Plate inside it.
    cycles
        Cycles that were run by `tick`.
    """

    def __init__(self) -> None:
        self.plate_block = PlateBlock(plate_od())
        self.od = stimulator_od()
        self.block = StimulatorBlock(self.od, self.plate_block)
        self.cycles = 0

    def power_on(self, stored: Mapping[str, Any]) -> None:
        """Start as a device that has stored only these values, by name."""
        self.od.reset()
        for name, value in stored.items():
            self.od[name].value = value
        self.block.power_on()

    def simulate(self, plate: Plate) -> None:
        """Put a plate and its finger in the place of the simulated ones."""
        backend = self.plate_block.backend
        assert isinstance(backend, SimulatedPlate)
        backend.plate = plate

    def tick(self, count: int = 1) -> None:
        """Run so many cycles."""
        self.cycles += count
        for _ in range(count):
            self.block.tick()

    def arm(self) -> None:
        """Arm and run; raises Abort if the stimulator refuses."""
        for word in (Control.ARM, Control.ARM | Control.RUN):
            self.block.write("Controlword", word)

    def identify(self, most_cycles: int) -> None:
        """Identify the plate, in at most so many cycles; raises Abort if it cannot be armed."""
        self.block.write("Mode", Mode.IDENTIFY)
        self.arm()
        for _ in range(most_cycles):
            self.tick()
            if self.block.state is not State.RUNNING or not self.od["Mode"].value:
                break


block_rig: Final = cache(BlockRig)
"""The rig of this process; power it on for each run."""


class Emcy(NamedTuple):
    """An emergency message received from the bus."""

    cycle: int
    """Cycle of the rig in which it was received."""
    node_id: int
    code: int
    register: int
    """Content of the error register."""


class Rig:
    """Stimulator and plate in one process, with a master.

    Only `cycle` advances time: 1 ms for every node, then a SYNC.

    Parameters
    ----------
    plate_inside
        Whether the plate is inside the stimulator node.
    seed
        Seed of all random faults.
    log
        Function that is called with each frame on the bus and its time stamp in us. With it, TPDO 4
        reports the power stage in every cycle.
    wire
        Carrier of the frames; None to keep them in the process.
    finger
        Finger of motion 2.

    Attributes
    ----------
    master
        Master, whose requests can go to either node.
    cycles
        Number of cycles so far.
    emergencies
        All emergency messages, in order.
    stage
        Object of the power stage's true voltage, in 10 mV.
    heartbeat
        Whether the master sends its heartbeat.
    syncs
        SYNCs that the master sends in a cycle; 1 unless its clock is wrong.
    observe
        Function that is called after every cycle.
    each_cycle
        Other frames that the master sends in every cycle.
    unsteady
        Function that breaks and repairs the simulated plate, called before every cycle until
        `mend`.
    hardware
        Hardware that supervises the power stage, if any.
    """

    def __init__(
        self,
        *,
        plate_inside: bool = False,
        seed: int = 1,
        log: LogHook | None = None,
        wire: Wire | None = None,
        finger: Finger | None = None,
    ) -> None:
        self.bus = FaultyBus(seed, log=log, wire=wire)
        self.cycles = 0
        self.emergencies: list[Emcy] = []
        self.heartbeat = True
        self.syncs = 1
        self.observe: Callable[[], None] | None = None
        self.each_cycle: list[Frame] = []
        self.unsteady: Callable[[], None] | None = None
        self.hardware: StageHardware | None = None
        self._emcy_ids = (cia.EMCY_ID + STIMULATOR_ID, cia.EMCY_ID + PLATE_ID)
        self.master = LocalMaster(self.bus, self._hear)
        if plate_inside:
            self.plate_block = PlateBlock(plate_od(), finger)
            od = stimulator_od() if log is None else _logged_stimulator_od()
            self.stimulator = StimulatorNode(od, self.plate_block, presets=_PRESETS)
            self.plate_port = None
        else:
            od = plate_od() if log is None else _logged_plate_od()
            plate = PlateNode(od, deadline_ms=SHORT_DEADLINE_MS, recording=finger)
            self.plate_block = plate.block
            self.stimulator = StimulatorNode(
                stimulator_od(),
                plate_node_id=PLATE_ID,
                deadline_ms=SHORT_DEADLINE_MS,
                presets=_PRESETS,
            )
            self.plate_port = self.bus.attach(plate, lockstep=False)
            self.plate = plate
        self.stimulator_port = self.bus.attach(self.stimulator, lockstep=False)
        self.od = self.stimulator.od
        self.stage: Entry = self.plate_block.od["Stage.Voltage"]

    def cycle(self, count: int = 1) -> None:
        """Advance time by 1 ms, then send SYNC; repeat this ``count`` times."""
        for _ in range(count):
            self.cycles += 1
            if self.unsteady is not None:
                self.unsteady()
            self.bus.advance(TICK_US)
            if self.heartbeat and self.cycles % HEARTBEAT_CYCLES == 0:
                self.master.send(requests.heartbeat(MASTER_ID))
            self.master.send(*self.each_cycle)
            for _ in range(self.syncs):
                self.master.sync()
            if self.observe is not None:
                self.observe()

    def nmt(self, command: int, node_id: int = 0) -> None:
        """Send an NMT command; node-ID 0 addresses all nodes."""
        self.master.send(requests.nmt(command, node_id))

    def read(self, name: str) -> int:
        """Read a raw value of the stimulator or the simulation by expedited SDO."""
        return int(self.master.read(*self._find(name)))

    def write(self, name: str, raw: int) -> None:
        """Write a raw value to the stimulator or the simulation by expedited SDO."""
        self.master.write(*self._find(name), raw)

    @property
    def state(self) -> State:
        """State of the stimulator, read by a function call, not over the bus."""
        return self.stimulator.block.state

    def configure(self) -> None:
        """Enable the supervision of the master's heartbeat, as after every reset of a node."""
        watch = self.od.entry(cia.HEARTBEAT_CONSUMER, 1)
        self.master.write(STIMULATOR_ID, watch, MASTER_ID << 16 | MASTER_LOST_MS)

    def start(self) -> None:
        """Configure and start both nodes."""
        self.configure()
        self.nmt(NMTCommand.START)
        self.cycle(HEARTBEAT_CYCLES + 1)

    def start_run(self, *, subject: int = 2, force_mN: int = 500, motion: int = STROKE) -> None:
        """Start a run with a finger that moves by `Finger.Motion`, and tare before it lands."""
        self.write("Simulation.Subject", subject)
        self.write("Finger.Force", force_mN)
        self.write("Finger.Motion", motion)
        self._write_both(START_RUN, 1)
        self.cycle(TARE_CYCLES)
        self.write(AUTO_ZERO[0], ZERO)
        self.cycle(_READY_CYCLES)

    def drive(self, mode: Mode) -> None:
        """Set a mode, arm, and run."""
        self.write("Mode", mode)
        self.write("Controlword", Control.ARM)
        self.write("Controlword", Control.ARM | Control.RUN)

    def reset_fault(self) -> None:
        """Disarm and reset the fault."""
        self.write("Controlword", 0)
        self.write("Controlword", Control.FAULT_RESET)
        self.write("Controlword", 0)

    def inject(self, kind: int, sensor: int = 1, value: int = 0) -> None:
        """Inject a fault of the simulated plate."""
        self.write("Fault.Sensor", sensor)
        self.write("Fault.Value", value)
        self.write("Fault.Delay in cycles", 0)
        self.write("Fault.Kind", kind)

    def mend(self) -> None:
        """Remove the fault of the simulated plate."""
        self.unsteady = None
        self.write("Fault.Kind", 0)

    def count_syncs(self) -> None:
        """Enable the SYNC counter at the master and at both nodes."""
        for node_id, od in self._dictionaries():
            period = od.entry(cia.SYNC_PERIOD)
            before = int(period.value)
            self.master.write(node_id, period, 0)
            self.master.write(node_id, od.entry(cia.SYNC_COUNTER), cia.SYNC_COUNTER_LAST)
            self.master.write(node_id, period, before)
        self.master.sync_counter = cia.SYNC_COUNTER_LAST

    def _dictionaries(self) -> list[tuple[int, ObjectDictionary]]:
        nodes = [(STIMULATOR_ID, self.od)]
        return nodes if self.plate_port is None else [*nodes, (PLATE_ID, self.plate.od)]

    def _write_both(self, name: str, raw: int) -> None:
        self.write(name, raw)
        if self.plate_port is not None:
            self.master.write(STIMULATOR_ID, self.od[name], raw)

    def _find(self, name: str) -> tuple[int, Entry]:
        if self.plate_port is not None and name.partition(".")[0] in SIMULATION:
            return PLATE_ID, self.plate.od[name]
        return STIMULATOR_ID, self.od[name]

    def _hear(self, frame: Frame) -> None:
        can_id = frame.can_id
        if can_id in self._emcy_ids and len(frame.data) == cia.FRAME_BYTES:
            code = int.from_bytes(frame.data[:2], "little")
            self.emergencies.append(Emcy(self.cycles, can_id - cia.EMCY_ID, code, frame.data[2]))


def _logged_plate_od() -> ObjectDictionary:
    """Load the EDS of the plate, with TPDO 4 enabled by default."""
    od = plate_od()
    cob_id = od.entry(_STAGE, cia.PDO_COB_ID)
    cob_id.default = cob_id.value = cob_id.default & ~cia.COB_INVALID
    return od


def _logged_stimulator_od() -> ObjectDictionary:
    """Load the EDS of the stimulator, with TPDO 4 sent in every cycle by default."""
    od = stimulator_od()
    transmission = od.entry(_STAGE, cia.PDO_TRANSMISSION)
    transmission.default = transmission.value = cia.EVENT_MANUFACTURER
    return od


_CAN_ID = cia.RPDO_IDS[HARDWARE_RPDO - 1] + PLATE_ID


class StageHardware:
    """Simulated hardware that reads the power stage back at each SYNC, and sends it to the plate.

    Parameters
    ----------
    rig
        Rig whose plate is configured to receive it.

    Attributes
    ----------
    enable
        Whether it enables the stage, 0 or 1.
    excess
        Error of the read-back in 10 mV.
    speaks
        Whether it sends.
    """

    def __init__(self, rig: Rig) -> None:
        self.enable = 1
        self.excess = 0
        self.speaks = True
        self._stage = rig.stage
        parameters = rig.plate.od.objects[cia.RPDO_COMMUNICATION + HARDWARE_RPDO - 1].entries
        rig.master.write(PLATE_ID, parameters[cia.PDO_EVENT], SHORT_DEADLINE_MS)
        rig.master.write(PLATE_ID, parameters[cia.PDO_COB_ID], _CAN_ID)
        self._port = rig.bus.connect(self._hear)

    def _hear(self, frame: Frame) -> None:
        if frame.can_id == cia.SYNC_ID and self.speaks:
            reading = int(self._stage.read()) + self.excess
            self._port.send(Frame(_CAN_ID, pack("<BH", self.enable, reading)))


# Cumulated probabilities of a draw from 0 to 1; above the last one the master does nothing.
_READ: Final = 0.10
_SET_POINT: Final = 0.18
_MODE: Final = 0.22
_COMMAND: Final = 0.28
_START: Final = 0.30
_DELAY: Final = 0.32


class MasterTraffic:
    """Random traffic that a master may send at any time without a fault reset.

    It reads and writes objects, and sends commands and RPDOs.

    Parameters
    ----------
    rig
        Rig whose nodes receive it.
    seed
        Seed of the traffic.
    commands
        Whether it also arms, runs and stops.
    """

    def __init__(self, rig: Rig, seed: int, *, commands: bool = True) -> None:
        self._commands = commands
        self._rig = rig
        self._random = random.Random(seed)
        od = rig.od
        self._setpoints = [entry for entry in od if entry.name.startswith("Setpoint.")]
        self._readable = [
            entry for entry in od if entry.readable and 0 < entry.size <= cia.EXPEDITED_BYTES
        ]

    def send(self) -> None:
        """Send a request, or nothing; a node may refuse it or not answer."""
        draw = self._random
        choice = draw.random()
        rig = self._rig
        try:
            if choice < _READ:
                rig.master.read(STIMULATOR_ID, draw.choice(self._readable))
            elif choice < _SET_POINT:
                entry = draw.choice(self._setpoints)
                raw = draw.randint(int(entry.low), int(entry.high))
                rig.master.write(STIMULATOR_ID, entry, raw)
            elif choice < _MODE:
                rig.write("Mode", draw.choice(tuple(Mode)))
            elif choice < _COMMAND and self._commands:
                rig.write("Controlword", draw.choice((0, 1, 3, 1, 3, 4, 7)))
            elif choice < _START:
                rig.nmt(NMTCommand.START, draw.choice((0, STIMULATOR_ID, PLATE_ID)))
            elif choice < _DELAY:
                rig.write("Fault.Delay in cycles", draw.randrange(10))
        except (Abort, HeartbeatLostError):
            return

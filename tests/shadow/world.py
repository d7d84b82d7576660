"""A stimulator and its plate on one bus, each of them twice, and a master that says what it likes.

A script is a list of acts, each the name of a method of `World` with its arguments: plain data, so
that it can be drawn, shrunk, stored and printed.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from struct import pack
from typing import Any, Final, NamedTuple

from frozen import Package
from pair import BothFailed, Difference, Pair, show, side

from smarttac_can.bench.simulation import PLATE_ID, STIMULATOR_ID
from smarttac_can.device.frame import Frame
from smarttac_can.host.faulty_bus import FaultyBus
from smarttac_can.host.frame_faults import Disturbance, FrameFault
from smarttac_can.master import requests
from smarttac_can.master.local_master import LocalMaster
from smarttac_can.od.cia import NMTCommand
from smarttac_can.od.entry import Entry
from smarttac_can.vocabulary.modes import Mode
from smarttac_can.vocabulary.objects import AUTO_ZERO, SIMULATION, START_RUN, ZERO
from smarttac_can.vocabulary.states import known_state
from smarttac_can.vocabulary.textures import Axis, TextureTable
from smarttac_can.vocabulary.watchdogs import watchdogs_in

Act = tuple[Any, ...]
MASTER_ID: Final = 1
TICK_US: Final = 1000
HEARTBEAT_CYCLES: Final = 100
SAVE: Final = int.from_bytes(b"save", "little")
LOAD: Final = int.from_bytes(b"load", "little")
ARM, RUN, FAULT_RESET = 1, 3, 0x80
MEASUREMENT: Final = tuple(base + PLATE_ID for base in (0x180, 0x280, 0x380))
DRIVE: Final = 0x200 + PLATE_ID
GROUPS: Final[dict[str, tuple[int, ...]]] = {
    "measurement": MEASUREMENT,
    "measurement 1": MEASUREMENT[:1],
    "measurement 2": MEASUREMENT[1:2],
    "measurement 3": MEASUREMENT[2:],
    "drive": (DRIVE,),
    "SYNC": (0x80,),
    "heartbeats": (0x700 + PLATE_ID, 0x700 + MASTER_ID),
    "all": (),
}
"""Frames that something may happen to, by name."""
GRATING: Final = TextureTable(
    Axis.POSITION, repeats=True, start=0, step=100_000, values=(3000,) * 10 + (4000,) * 10
).pack()
_SETPOINTS: Final = {
    "Setpoint.Voltage": 4000,
    "Setpoint.Frequency": 4_339_000,
    "Setpoint.Amplitude": 1000,
    "Setpoint.COF left": 3500,
    "Setpoint.COF right": 3500,
}
_ORDINARY: Final = frozenset(
    (
        *(0x80, DRIVE, *MEASUREMENT, 0x700 + MASTER_ID, 0x700 + PLATE_ID, 0x700 + STIMULATOR_ID),
        *(base + node for base in (0x180, 0x280, 0x380, 0x480) for node in (32, 33)),
    )
)
"""Identifiers of what passes in every cycle, so that a transcript may leave such cycles out."""
_APPROACH: Final = 100
"""Cycles after the tare in which a finger comes near; it touches 60 later."""
_SHOWN_CYCLES: Final = 2


class Setting(NamedTuple):
    """How the nodes are set up."""

    plate: str = "node"
    """Where the plate is: ``node``, ``inside``, or ``hardware`` for a node with a front end."""
    lockstep: bool = False
    """Whether SYNC is the clock of the nodes."""
    produce_sync: bool = False
    """Whether the stimulator produces SYNC."""
    deadline_ms: int = 3


class FrontEnd:
    """Hardware behind the plate, of either implementation: a plate that is stepped by sampling.

    Attributes
    ----------
    took_us
        How long the last call took.
    behaviour
        What it does: one of `BEHAVIOURS`.
    """

    BEHAVIOURS = ("sound", "fails", "nothing new", "slow", "not finite", "disobeys")

    def __init__(self, package: Package) -> None:
        plant = package.module("plant.plate")
        subjects = package.module("plant.subjects").SUBJECTS
        self._drive_type = package.module("vocabulary.signals").Drive
        finger = package.module("plant.finger").Stroke(0.5, 0.04, 0.03)
        parameters = package.module("plant.parameters").PlateParameters()
        self._plate = plant.Plate(parameters, subjects[1], finger)
        self._drive = self._drive_type(0.0, 43_390.0)
        self.took_us = 0
        self.behaviour = "sound"

    def put_out(self, drive: Any) -> float:
        self._drive = drive
        return 90.0 if self.behaviour == "disobeys" else float(drive.voltage)

    def sample(self) -> Any:
        self._plate.step(self._drive, self._drive)
        measured = self._plate.sample()
        self.took_us = 900 if self.behaviour == "slow" else 0
        if self.behaviour == "fails":
            raise OSError("no answer")
        if self.behaviour == "nothing new":
            return None
        if self.behaviour == "not finite":
            return measured._replace(temperature=float("nan"))
        return measured

    def close(self) -> None:
        pass


class Nodes(NamedTuple):
    """The nodes of one implementation."""

    stimulator: Any
    plate: Any
    """None where it is inside."""
    block: Any
    """Function block of the plate."""
    front_end: FrontEnd | None


def nodes(package: Package, setting: Setting) -> Nodes:
    """Make the nodes of a package."""
    simulation = package.module("bench.simulation")
    memory = package.module("device.storage").Memory
    stimulator = package.module("nodes.stimulator_node").StimulatorNode
    presets: dict[str, Any] = {"Texture table.Table 1": GRATING}
    if setting.plate == "inside":
        block = package.module("nodes.plate_block").PlateBlock(simulation.plate_od())
        node = stimulator(
            simulation.stimulator_od(),
            block,
            lockstep=setting.lockstep,
            presets=presets,
            storage=memory(),
        )
        return Nodes(node, None, block, None)
    front_end = FrontEnd(package) if setting.plate == "hardware" else None
    plate = package.module("nodes.plate_node").PlateNode(
        simulation.plate_od(),
        front_end=front_end,
        deadline_ms=setting.deadline_ms,
        storage=memory(),
    )
    node = stimulator(
        simulation.stimulator_od(),
        plate_node_id=PLATE_ID,
        produce_sync=setting.produce_sync,
        lockstep=setting.lockstep,
        deadline_ms=setting.deadline_ms,
        presets=presets,
        storage=memory(),
    )
    return Nodes(node, plate, plate.block, front_end)


@dataclass
class Seen:
    """What a script has reached, so that it is known what was compared."""

    ticks: int = 0
    states: dict[str, int] = field(default_factory=dict)
    """Ticks by state."""
    driven: dict[str, int] = field(default_factory=dict)
    """Ticks with a voltage, by mode."""
    latched: dict[str, int] = field(default_factory=dict)
    """How often each watchdog was latched."""
    messages: int = 0
    """How often the Message became another one."""

    def add(self, other: Seen) -> None:
        """Add what another script has reached."""
        self.ticks += other.ticks
        self.messages += other.messages
        for own, others in (
            (self.states, other.states),
            (self.driven, other.driven),
            (self.latched, other.latched),
        ):
            for name, number in others.items():
                own[name] = own.get(name, 0) + number


class World:
    """The nodes, their bus and their master.

    Parameters
    ----------
    old, new
        The implementations.
    setting
        How both are set up.
    all_every
        Every how many cycles the object dictionary and all of the device are compared; after each
        act of a script they are, too.

    Attributes
    ----------
    seen
        What was compared.
    pairs
        By node-ID.
    """

    def __init__(self, old: Package, new: Package, setting: Setting, *, all_every: int = 1) -> None:
        self._all_every = all_every
        self.setting = setting
        self.seen = Seen()
        self._old, self._new = nodes(old, setting), nodes(new, setting)
        self._frames: list[Frame] = []
        self._past: list[str] = []
        self._ordinary = 0
        self._recent: deque[list[str | Frame]] = deque()
        self._now: list[str | Frame] = []
        self.bus = FaultyBus(log=lambda _time, frame: self._now.append(frame))
        self.master = LocalMaster(self.bus, lambda _frame: None)
        self.pairs: dict[int, Pair] = {}
        self._ports: dict[int, Any] = {}
        made = [
            (PLATE_ID, "plate", "PlateNode", self._old.plate, self._new.plate),
            (
                STIMULATOR_ID, "stimulator", "StimulatorNode",
                self._old.stimulator, self._new.stimulator,
            ),
        ]  # fmt: skip
        for node_id, name, kind, before, now in made[setting.plate == "inside" :]:
            pair = Pair(name, side(old, before, kind), side(new, now, kind))
            self.pairs[node_id] = pair
            self._ports[node_id] = self.bus.attach(pair, lockstep=setting.lockstep)  # type: ignore[arg-type]
        self.od = self._new.stimulator.od
        self._stage = self._new.block.od["Stage.Voltage"]
        self._latched = self.od["Diagnosis.Latched"]
        self._statusword = self.od["Statusword"]
        self._message = self.od["Message"]
        self._mode = self.od["Mode display"]
        self._heartbeat = True
        self._syncs = 1
        self._each_cycle: list[Frame] = []
        self._before: dict[tuple[int, Entry], int] = {}
        """What was in the objects that the script has written, which `mend` puts back."""
        self._due: list[tuple[int, Callable[[], None]]] = []
        self._was = (0, "")

    def play(self, acts: Iterable[Act]) -> None:
        """Act, and compare after each act and each cycle.

        Raises
        ------
        Difference
            With the script so far as a transcript.
        """
        try:
            for act in acts:
                self._note(f"# {' '.join(map(str, act))}")
                getattr(self, act[0])(*act[1:])
                self._look()
        except Difference as difference:
            difference.add_note(self.transcript())
            raise
        except BothFailed as failure:
            failure.add_note(self.transcript())
            raise

    def _look(self, *, all_of_it: bool = True) -> None:
        for pair in self.pairs.values():
            pair.look(all_of_it=all_of_it)

    # -- time ------------------------------------------------------------------------------------

    def cycles(self, count: int) -> None:
        """Let so many ms pass, each with a SYNC."""
        for _ in range(count):
            self._end_cycle()
            self.seen.ticks += 1
            if not self.setting.lockstep:
                self._note("+ 1ms")
                self.bus.advance(TICK_US)
            if self._heartbeat and self.seen.ticks % HEARTBEAT_CYCLES == 0:
                self.send(requests.heartbeat(MASTER_ID))
            if self._each_cycle:
                self.send(*self._each_cycle)
            if not self.setting.produce_sync:
                for _ in range(self._syncs):
                    self.master.sync()
            while self._due and self._due[0][0] <= self.seen.ticks:
                self._due.pop(0)[1]()
            self._look(all_of_it=self.seen.ticks % self._all_every == 0)
            self._survey()

    def wait(self, microseconds: int) -> None:
        """Let time pass without SYNC."""
        self._note(f"+ {microseconds}us")
        self.bus.advance(microseconds)

    def syncs(self, count: int, cycles: int) -> None:
        """Send so many SYNCs in each of some cycles."""
        self._syncs = count
        self._after(cycles, lambda: setattr(self, "_syncs", 1))

    def sync_counter(self, skipped: int) -> None:
        """Have SYNC leave out some counts, if it has any."""
        if self.master.sync_counter:
            self.master.sync_counter = (self.master.sync_counter + skipped) % 240 or 1

    # -- the master ------------------------------------------------------------------------------

    def send(self, *frames: Frame) -> None:
        """Send frames."""
        self.master.send(*frames)

    def frame(self, can_id: int, data: str = "", rtr: bool = False) -> None:
        """Send a frame, its data in hex."""
        self.send(Frame(can_id, bytes.fromhex(data), rtr))

    def each_cycle(self, can_id: int, data: str, cycles: int) -> None:
        """Send a frame in each of some cycles."""
        frame = Frame(can_id, bytes.fromhex(data))
        self._each_cycle.append(frame)
        self._after(cycles, lambda: self._each_cycle.remove(frame))

    def echo(self, group: str) -> None:
        """Send frames that passed last once more, as a bridge or a stranger might."""
        passed = [line for lines in (*self._recent, self._now) for line in lines]
        newest = {line[0]: line for line in passed if not isinstance(line, str)}
        self.send(*[newest[can_id] for can_id in GROUPS[group] if can_id in newest])

    def nmt(self, command: int, node_id: int = 0) -> None:
        """Send an NMT command."""
        self.send(requests.nmt(command, node_id))

    def heartbeat(self, on: bool) -> None:
        """Have the master send its heartbeat or not."""
        self._heartbeat = on

    def write(self, node_id: int, index: int, subindex: int, raw: int) -> None:
        """Write 1 to 4 bytes by SDO, where the node is there; it may refuse."""
        if node_id not in self.pairs:
            return
        entry = self._entry(node_id, index, subindex)
        self._before.setdefault((node_id, entry), entry.read())
        self.send(requests.download(node_id, entry, raw))

    def write_long(self, node_id: int, index: int, subindex: int, data: str) -> None:
        """Write bytes in hex by a segmented SDO transfer; the node may refuse."""
        entry = self._entry(node_id, index, subindex)
        for frame in requests.downloading(node_id, entry, bytes.fromhex(data)):
            if frame.can_id == 0x600 + node_id:
                self.send(frame)

    def read(self, node_id: int, index: int, subindex: int) -> None:
        """Read by SDO, where the node is there."""
        if node_id in self.pairs:
            self.send(requests.upload(node_id, self._entry(node_id, index, subindex)))

    def put(self, name: str, raw: int) -> None:
        """Write to the stimulator, or the simulation where that is, by name."""
        self._before.setdefault((STIMULATOR_ID, self.od[name]), self.od[name].read())
        self._put(name, raw)

    def setpoints(self, number: int, data: str) -> None:
        """Send RPDO 2 to 4 of the stimulator."""
        self.send(Frame((0x300, 0x400, 0x500)[number - 2] + STIMULATOR_ID, bytes.fromhex(data)))

    def controlword(self, word: int, mode: int) -> None:
        """Send RPDO 1 of the stimulator."""
        self.send(Frame(0x200 + STIMULATOR_ID, pack("<HB", word, mode)))

    # -- what masters do in a row ----------------------------------------------------------------

    def begin(self, subject: int, force_mN: int, motion: int) -> None:
        """Configure and start the nodes, and begin a run under a finger, with a tare before it."""
        self._watch()
        self.nmt(NMTCommand.START)
        for name, raw in _SETPOINTS.items():
            self._put(name, raw)
        self.new_run(subject, force_mN, motion)

    def new_run(self, subject: int, force_mN: int, motion: int) -> None:
        """Begin a run under a finger, and tare it."""
        if self.setting.plate != "hardware":
            self._put("Simulation.Subject", subject)
            self._put("Finger.Force", force_mN)
            self._put("Finger.Motion", motion)
            self._put(START_RUN, 1)
        if self.setting.plate != "inside":
            self.send(requests.download(STIMULATOR_ID, self.od[START_RUN], 1))
        self.cycles(70)
        self._put(AUTO_ZERO[0], ZERO)
        self.cycles(_APPROACH if motion else 4)

    def drive(self, mode: int) -> None:
        """Choose a mode, arm and run."""
        self._put("Controlword", 0)
        self._put("Mode", mode)
        self._put("Controlword", ARM)
        self._put("Controlword", RUN)

    def recover(self, mode: int) -> None:
        """Start what does not run, reset the fault, and drive again."""
        if not self.od.entry(0x1019).value:
            self.master.sync_counter = 0
        self.nmt(NMTCommand.START)
        self._watch()
        self.send(requests.heartbeat(MASTER_ID))
        self.cycles(4)
        self._put("Controlword", 0)
        self._put("Controlword", FAULT_RESET)
        self.drive(mode)

    def mend(self, mode: int) -> None:
        """Put right what the script has broken or written, and drive again."""
        self._heartbeat = True
        self.front_end("sound")
        self.recover(mode)
        self._put("Controlword", 0)
        self._put("Fault.Kind", 0)
        for (node_id, entry), raw in self._before.items():
            self.send(requests.download(node_id, entry, raw))
        self._before.clear()
        self.cycles(20)
        self.recover(mode)

    def anew(self, subject: int, force_mN: int, motion: int, mode: int) -> None:
        """Forget all that was stored and written, and drive again."""
        self._heartbeat = True
        self.front_end("sound")
        self._before.clear()
        self.master.sync_counter = 0
        for node_id in self.pairs:
            self.store(node_id, 1, LOAD, 0x1011)
        self.nmt(NMTCommand.RESET_NODE)
        self.cycles(2)
        self.begin(subject, force_mN, motion)
        self.recover(mode)

    def store(self, node_id: int, group: int, signature: int, index: int = 0x1010) -> None:
        """Store a group of parameters, or with 1011h restore it."""
        entry = self._new_od(node_id).get(index, group)
        if entry is not None:
            self.send(requests.download(node_id, entry, signature))

    def remap(self, node_id: int, number: int, names: list[str], steps: int, on: bool) -> None:
        """Give a TPDO another mapping, or only the first steps of that.

        Parameters
        ----------
        node_id, number
            Which.
        names
            Objects that it is to carry.
        steps
            Requests after which the master stops.
        on
            Whether it is switched off before, as it has to be.
        """
        od = self._new_od(node_id)
        cob_id = od.entry(0x1800 + number - 1, 1)
        mapping = 0x1A00 + number - 1
        valid = int(cob_id.read()) & 0x7FF
        words = [
            entry.index << 16 | entry.subindex << 8 | 8 * entry.size
            for entry in map(od.__getitem__, names)
        ]
        writes = [
            *([(cob_id, 0x8000_0000 | valid)] if on else []),
            (od.entry(mapping, 0), 0),
            *((od.entry(mapping, place), word) for place, word in enumerate(words, 1)),
            (od.entry(mapping, 0), len(words)),
            (cob_id, valid),
        ]
        for entry, raw in writes[:steps]:
            self.send(requests.download(node_id, entry, raw))

    def count_syncs(self) -> None:
        """Have SYNC carry a counter, which all nodes expect."""
        for node_id in self.pairs:
            od = self._new_od(node_id)
            period = od.entry(0x1006)
            before = int(period.value)
            for entry, raw in ((period, 0), (od.entry(0x1019), 240), (period, before)):
                self.send(requests.download(node_id, entry, raw))
        self.master.sync_counter = 240

    def connect_hardware(self, enable: int, cycles: int) -> None:
        """Have hardware watch the stage of the plate node, in each of some cycles."""
        if PLATE_ID in self.pairs:
            od = self._new_od(PLATE_ID)
            self.send(requests.download(PLATE_ID, od.entry(0x1401, 5), 5))
            self.send(requests.download(PLATE_ID, od.entry(0x1401, 1), 0x300 + PLATE_ID))
            reading = int(self._stage.read())
            self.each_cycle(0x300 + PLATE_ID, pack("<BH", enable, reading).hex(), cycles)

    def fault(self, kind: int, sensor: int, value: int, delay: int) -> None:
        """Break something of the simulated plate, or mend it with kind 0."""
        for name, raw in (
            ("Fault.Sensor", sensor),
            ("Fault.Value", value),
            ("Fault.Delay in cycles", delay),
            ("Fault.Kind", kind),
        ):
            self._put(name, raw)

    # -- what goes wrong -------------------------------------------------------------------------

    def disturb(self, kind: str, group: str, cycles: int) -> None:
        """Have something happen to frames for some cycles."""
        disturbance = Disturbance(FrameFault[kind], frozenset(GROUPS[group]))
        self.bus.disturbances.append(disturbance)
        self._after(cycles, lambda: self.bus.disturbances.remove(disturbance))

    def power_cycle(self, node_id: int) -> None:
        """Take the power from a node, and give it back."""
        if node_id in self.pairs:
            self.bus.power_off(self._ports[node_id])
            self.bus.power_on(self._ports[node_id])

    def pause(self, node_id: int, cycles: int) -> None:
        """Stop the process of a node for some cycles."""
        if node_id in self.pairs:
            self.bus.pause(self._ports[node_id])
            self._after(cycles, lambda: self.bus.resume(self._ports[node_id]))

    def stop_clock(self, node_id: int, cycles: int) -> None:
        """Stop the clock of a node for some cycles."""
        if node_id in self.pairs:
            self.bus.stop_clock(self._ports[node_id])
            self._after(cycles, lambda: self.bus.start_clock(self._ports[node_id]))

    def jump(self, node_id: int, microseconds: int) -> None:
        """Put the clock of a node forward."""
        if node_id in self.pairs:
            self.bus.jump(self._ports[node_id], microseconds)

    def clog(self, node_id: int, cycles: int) -> None:
        """Have the CAN controller of a node take no frames for some cycles."""
        if node_id in self.pairs:
            self.bus.clog(self._ports[node_id], cycles)

    def bus_off(self, node_id: int, cycles: int) -> None:
        """Have a node be off the bus for some cycles."""
        if node_id in self.pairs:
            self.bus.bus_off(self._ports[node_id])
            self._after(cycles, lambda: self.bus.bus_recovered(self._ports[node_id]))

    def front_end(self, behaviour: str) -> None:
        """Have the hardware behave in another way."""
        for side_ in (self._old, self._new):
            if side_.front_end is not None:
                side_.front_end.behaviour = behaviour

    def off(self) -> None:
        """Shut all nodes down."""
        self.bus.shutdown()

    # -- what was seen ---------------------------------------------------------------------------

    def transcript(self) -> str:
        """Return what passed on the bus, without cycles in which nothing but the loop did."""
        for lines in [*self._recent, self._now]:
            self._say_ordinary()
            self._past += map(self._line, lines)
        return "\n".join([f"# {self.setting}", *self._past])

    def _note(self, line: str) -> None:
        self._now.append(line)

    def _end_cycle(self) -> None:
        self._recent.append(self._now)
        self._now = []
        if len(self._recent) > _SHOWN_CYCLES:
            lines = self._recent.popleft()
            if all(
                line == "+ 1ms" if isinstance(line, str) else line[0] in _ORDINARY for line in lines
            ):
                self._ordinary += 1
            else:
                self._say_ordinary()
                self._past += map(self._line, lines)

    def _say_ordinary(self) -> None:
        if self._ordinary:
            self._past.append(f"# {self._ordinary} cycles with nothing but the loop")
            self._ordinary = 0

    def _line(self, line: str | Frame) -> str:
        if isinstance(line, str):
            return line
        own = any(line[0] in pair.ids.sent for pair in self.pairs.values()) and not line[2]
        return f"{'<' if own else '>'} {show(line)}"

    def _survey(self) -> None:
        seen = self.seen
        known = known_state(self._statusword.value)
        state = "none" if known is None else known.name
        seen.states[state] = seen.states.get(state, 0) + 1
        if self._stage.read():
            mode = Mode(self._mode.value).name
            seen.driven[mode] = seen.driven.get(mode, 0) + 1
        latched, message = self._was
        now = self._latched.value, self._message.value
        if now != self._was:
            self._was = now
            for watchdog in watchdogs_in(now[0] & ~latched):
                seen.latched[watchdog.name] = seen.latched.get(watchdog.name, 0) + 1
            seen.messages += now[1] != message

    # -- helpers ---------------------------------------------------------------------------------

    def _after(self, cycles: int, act: Callable[[], None]) -> None:
        self._due.append((self.seen.ticks + cycles, act))
        self._due.sort(key=lambda due: due[0])

    def _new_od(self, node_id: int) -> Any:
        return self.pairs[node_id].od if node_id in self.pairs else self.od

    def _entry(self, node_id: int, index: int, subindex: int) -> Entry:
        entry: Entry = self._new_od(node_id).entry(index, subindex)
        return entry

    def _put(self, name: str, raw: int) -> None:
        simulated = name.partition(".")[0] in SIMULATION
        node_id = PLATE_ID if simulated and PLATE_ID in self.pairs else STIMULATOR_ID
        self.send(requests.download(node_id, self._new_od(node_id)[name], raw))

    def _watch(self) -> None:
        """Have the heartbeat of the master under watch."""
        watch = self.od.entry(0x1016, 1)
        self.send(requests.download(STIMULATOR_ID, watch, MASTER_ID << 16 | 1000))

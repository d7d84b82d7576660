"""The simulated instrument: the only module in which a client makes nodes, plate and controllers.

python-canopen is imported only when a link over CAN is opened. Its import takes about as long as
that of the rest of the bench, and a simulation on the local link does not need it.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, Literal, NoReturn, get_args

import numpy as np

from smarttac_can.bench.errors import refused_write
from smarttac_can.bench.given import finite, given, integer, outside, said, sequence, truth
from smarttac_can.bench.link import (
    PUBLISHED,
    RECORDED,
    FrameSource,
    Hear,
    Link,
    OneRun,
    Row,
    Snapshot,
    Turns,
    never,
    published_pdos,
)
from smarttac_can.bench.named_objects import find_number, raw_value
from smarttac_can.bench.traces import Trace
from smarttac_can.canopen.bus.bus import LogHook
from smarttac_can.canopen.bus.local_bus import LocalBus
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.master.errors import BenchError, RefusedError
from smarttac_can.canopen.master.requests import download, downloaded, downloading
from smarttac_can.canopen.od import cia
from smarttac_can.canopen.od.cia import Abort, AbortCode, ErrorRegister
from smarttac_can.canopen.od.dictionary import ObjectDictionary
from smarttac_can.canopen.od.eds import load_eds
from smarttac_can.canopen.od.entry import Entry
from smarttac_can.host.files import read_eds
from smarttac_can.instrument.nodes.parameters import NULL
from smarttac_can.instrument.nodes.plate_block import PlateBlock
from smarttac_can.instrument.nodes.plate_node import PlateNode
from smarttac_can.instrument.nodes.stimulator_block import StimulatorBlock
from smarttac_can.instrument.nodes.stimulator_node import StimulatorNode
from smarttac_can.science.plant.finger import GIVEN_RANGES, Finger, GuidedFinger, Trajectory
from smarttac_can.vocabulary.meanings import RECORDED as RECORDED_FINGER
from smarttac_can.vocabulary.meanings import SIMULATION
from smarttac_can.vocabulary.signals import SHORT_DEADLINE_MS, TICK_US
from smarttac_can.vocabulary.watchdogs import WATCHDOGS, watchdogs_in

STIMULATOR_ID: Final = 32
"""Default node-ID of the stimulator."""
PLATE_ID: Final = 33
"""Default node-ID of the plate node."""
LinkName = Literal["local", "bus"]
_SAMPLE: Final = (("time", "s", 1.0), ("position", "mm", 1e-3), ("normal force", "N", 1.0))
"""Name and unit of what a sample of a finger has, and the unit in SI."""
_STATUS_TPDO: Final = 1
_EMCY: Final = struct.Struct("<HBB4x")
"""Emergency error code, error register and number of the watchdog."""


def stimulator_od(node_id: int = STIMULATOR_ID) -> ObjectDictionary:
    """Load the EDS of the stimulator for a node-ID, 1..127."""
    return _with_seed(load_eds(read_eds("stimulator.eds"), node_id))


def plate_od(node_id: int = PLATE_ID) -> ObjectDictionary:
    """Load the EDS of the plate for a node-ID, 1..127."""
    return _with_seed(load_eds(read_eds("plate.eds"), node_id))


def _with_seed(od: ObjectDictionary) -> ObjectDictionary:
    """Set the seed of a simulation for which none is given; options set it, so the EDS has none."""
    seed = od["Simulation.Seed"]
    seed.default = seed.value = 1
    return od


def know_nulls(od: ObjectDictionary, nulls: Iterable[float]) -> None:
    """Set the nulls of a plate, S1..S6 in N, as defaults; stored values and presets replace them.

    The window is then as narrow as after a calibration, so that a tare under a finger is refused.
    """
    for number, null in enumerate(nulls, 1):
        entry = od[f"{NULL}.Null of S{number}"]
        entry.default = entry.value = entry.counts(f"{null} N")


def od_and_plate(recording: Finger | None = None) -> tuple[ObjectDictionary, PlateBlock]:
    """Return the object dictionary of a stimulator and a plate whose nulls are its defaults.

    A tare under a finger is then refused, as after a calibration.

    Parameters
    ----------
    recording
        Finger that motion 2 plays, or None.
    """
    od, plate = stimulator_od(), PlateBlock(plate_od(), recording)
    know_nulls(od, plate.plate.nulls)
    return od, plate


def simulated_block(presets: Mapping[str, int], recording: Finger | None = None) -> StimulatorBlock:
    """Return a stimulator with the plate inside and no CANopen, at the start of a run.

    Parameters
    ----------
    presets
        Raw values by name that replace defaults of the EDS.
    recording
        Finger that motion 2 plays, or None.
    """
    block = StimulatorBlock(*od_and_plate(recording))
    for name, raw in presets.items():
        block.write(name, raw)
    block.start_run()
    return block


def stimulator_with_plate(
    presets: Mapping[str, int] | None = None, recording: Finger | None = None
) -> StimulatorNode:
    """Return a stimulator node for lockstep with the plate inside."""
    return StimulatorNode(*od_and_plate(recording), lockstep=True, presets=presets)


def lockstep_nodes(
    *, plate_inside: bool, presets: Mapping[str, int], recording: Finger | None = None
) -> list[PlateNode | StimulatorNode]:
    """Return a stimulator for lockstep, preceded by a plate node unless the plate is inside.

    A plate node receives the presets of the simulation, because it simulates the plate.
    """
    if plate_inside:
        return [stimulator_with_plate(presets, recording)]
    simulated = {n: raw for n, raw in presets.items() if n.partition(".")[0] in SIMULATION}
    plate = PlateNode(plate_od(), simulated, recording=recording, deadline_ms=SHORT_DEADLINE_MS)
    od = stimulator_od()
    know_nulls(od, plate.block.plate.nulls)
    stimulator = StimulatorNode(
        od,
        plate_node_id=PLATE_ID,
        lockstep=True,
        deadline_ms=SHORT_DEADLINE_MS,
        presets={name: raw for name, raw in presets.items() if name not in simulated},
    )
    return [plate, stimulator]


def open_simulated_link(
    link: LinkName,
    *,
    seed: int,
    subject: int,
    plate_inside: bool,
    finger: Trace | Iterable[tuple[float, float, float]] | None,
    presets: Mapping[str, int | str],
    log: LogHook | None,
) -> tuple[Link, ObjectDictionary]:
    """Open a link to a simulation; the arguments are those of `Stimulator.simulate`.

    Raises
    ------
    ValueError
        If there is no such link, `plate_inside` is neither True nor False, a preset is not a
        value of its object or is refused at power-on, `finger` has no samples or some out of
        range, or `log` is not callable or the link has no bus.
    BenchError
        If a preset names an object that does not exist.
    """
    truth("plate_inside", plate_inside)
    raw = raw_presets(presets, seed=seed, subject=subject)
    recorded = None
    if finger is not None:
        recorded = _recorded(finger)
        raw["Finger.Motion"] = RECORDED_FINGER
    if link not in get_args(LinkName):
        raise ValueError(f"link {said(link)} is none of {', '.join(get_args(LinkName))}")
    if log is not None and not callable(log):
        raise ValueError(f"log {said(log)} is no function of a time stamp and a frame")
    if log is not None and link == "local":
        raise ValueError("there is no bus whose frames could go to log: simulate('bus')")
    bus = LocalBus(tick=TICK_US, log=log)
    try:
        if link == "local":
            block = simulated_block(raw, recorded)
            return LocalLink(block), block.od
        for node in lockstep_nodes(plate_inside=plate_inside, presets=raw, recording=recorded):
            bus.attach(node)
    except Abort as error:
        raise ValueError(f"presets {dict(presets)} are refused at power-on: {error}") from error
    from smarttac_can.bench.can_link import over_can  # noqa: PLC0415 - only over CAN
    from smarttac_can.bench.network import LocalNetwork  # noqa: PLC0415

    return over_can(
        LocalNetwork(bus),
        STIMULATOR_ID,
        None if plate_inside else PLATE_ID,
        where="the local bus",
        lockstep=True,
        timeout=0.0,
    )


def open_guided_link() -> tuple[LocalLink, ObjectDictionary, GuidedFinger]:
    """Open a simulation without a bus; return the link, its dictionary and its guided finger."""
    finger = GuidedFinger()
    block = simulated_block({"Finger.Motion": RECORDED_FINGER}, finger)
    return LocalLink(block), block.od, finger


def _of_trace(trace: Trace) -> list[tuple[float, float, float]]:
    """Return the finger of a trace, lifted at a place between its touches where it has none."""
    places = trace.position_mm
    touches = ~np.isnan(places)
    if not touches.any():
        raise ValueError("finger: nothing touches in this trace, or its file has no position")
    # A light touch tells its position badly, even as beside the plate.
    low, high = (bound * 1e3 for bound in GIVEN_RANGES[1][1:])
    there = np.clip(places[touches], low, high)
    places = np.interp(trace.time_s, trace.time_s[touches], there)
    forces = np.where(touches, trace.normal_force_n, 0.0)
    return list(zip(trace.time_s.tolist(), places.tolist(), forces.tolist(), strict=True))


def _recorded(finger: Trace | Iterable[tuple[float, float, float]]) -> Trajectory:
    samples = _of_trace(finger) if isinstance(finger, Trace) else sequence("finger", finger)
    for number, sample in enumerate(samples):
        word = f"finger sample {number}"
        row = sequence(word, sample)
        if len(row) != len(_SAMPLE):
            raise ValueError(f"{word} {said(sample)} is no (t_s, x_mm, Fn_N): give three numbers")
        for value, (name, unit, si), (_, low, high) in zip(row, _SAMPLE, GIVEN_RANGES, strict=True):
            place = finite(f"{word} {name}", value)
            if not low <= place * si <= high:
                raise ValueError(outside(f"{word} {name}", place, low / si, high / si, unit))
    try:
        return Trajectory(
            [(float(t), float(x_mm) * 1e-3, max(float(Fn), 0.0)) for t, x_mm, Fn in samples]
        )
    except ValueError as error:
        raise ValueError(f"finger: {error}") from error


def raw_presets(presets: Mapping[str, int | str], *, seed: int, subject: int) -> dict[str, int]:
    """Return the raw values of presets of a stimulator, which may be given as texts with units.

    Parameters
    ----------
    presets
        Values by name.
    seed, subject
        Seed and subject of the simulated plate, unless they are among the presets.

    Raises
    ------
    ValueError
        If `presets` is not a mapping, or a value does not suit its object or is outside its limits.
    BenchError
        If an object does not exist, or is not a number.
    """
    if not isinstance(presets, Mapping):
        raise ValueError(f"presets {said(presets)} are no mapping of names to values")
    od = stimulator_od()
    simulated = {
        "Simulation.Seed": integer("seed", seed, *_range(od, "Simulation.Seed")),
        "Simulation.Subject": integer("subject", subject, *_range(od, "Simulation.Subject")),
    }
    return simulated | {n: _raw_preset(find_number(od, n), value) for n, value in presets.items()}


def _range(od: ObjectDictionary, name: str) -> tuple[int, int]:
    return int(od[name].low), int(od[name].high)


def _raw_preset(entry: Entry, preset: int | str) -> int:
    """Return the raw value of a preset; a text is a quantity, a number is raw."""
    word = f"preset {entry.name}"
    if not isinstance(preset, str):
        return integer(word, preset, int(entry.low), int(entry.high))
    value = given(word, preset, entry.unit.symbol)
    raw = raw_value(entry, value)
    if not entry.low <= raw <= entry.high:
        number, symbol = value.quantity
        low, high = (entry.unit.times(bound, symbol) for bound in (entry.low, entry.high))
        raise ValueError(outside(word, float(number), low, high, symbol))
    return raw


class LocalLink:
    """A stimulator with the plate inside, reached by function calls.

    Values are scaled to the integers of the object dictionary as on the bus, so a run gives the
    same numbers as one over CAN.

    Parameters
    ----------
    block
        Function block of a stimulator with the plate inside.
    """

    where = "the local link"
    only_read = False
    """No other bench can reach a stimulator in this process."""

    def __init__(self, block: StimulatorBlock) -> None:
        self._block = block
        self._recorded = [block.od[name].reader for name in RECORDED]
        self._pdos = published_pdos(block.od, lambda entry: int(entry.default))
        self._readers = [[block.od[name].reader for name in pdo.names] for pdo in self._pdos]
        self._listeners: tuple[Hear, ...] = ()
        self._alone = OneRun(self.where)
        self.turn = Turns()
        self._status = b""
        self._latched = 0

    def drive(self) -> None:
        """Do nothing: this bench is always the commander of a stimulator in this process."""

    def read(self, name: str) -> Any:
        """Read an object by name.

        Raises
        ------
        RefusedError
            If the object is write-only.
        """
        entry = self._block.od[name]
        if not entry.readable:
            reason = Abort(AbortCode.WRITE_ONLY)
            raise RefusedError(f"cannot read {name}: {reason}", reason.code)
        with self.turn:
            return entry.read()

    def write(self, name: str, raw: int | bytes) -> None:
        """Write an object by name.

        Raises
        ------
        RefusedError
            If the object is read-only, or refuses the value in its present state.
        """
        with self.turn:
            self._write(self._block.od[name], raw)

    def _write(self, entry: Entry, raw: int | bytes) -> None:
        try:
            if not entry.writable:
                raise Abort(AbortCode.READ_ONLY)
            self._block.write(entry.name, raw)
        except Abort as error:
            raise refused_write(entry, raw, error) from error
        node_id = self._block.od.node_id
        if isinstance(raw, bytes):
            self._to_listeners(downloading(node_id, entry, raw))
            return
        self._to_listeners((download(node_id, entry, raw), downloaded(node_id, entry)))
        self._to_listeners(self._frames(cycle=False))

    def snapshot(self) -> Snapshot:
        """Return the present values of the published objects; their age is 0 s."""
        with self.turn:
            return Snapshot({name: int(self._block.od[name].read()) for name in PUBLISHED}, 0.0)

    def start_run(self) -> None:
        """Put the simulated plate to rest at tick 0 and reset the controllers."""
        self.write("Simulation.Start run", 1)

    def run(self, cycles: int, rows: list[Row], interrupted: Callable[[], bool] = never) -> None:
        """Run the loop for a number of cycles, and append a row of recorded values for each.

        Raises
        ------
        BusyError
            If another thread is running the loop.
        BenchError
            If the link is closed meanwhile.
        """
        tick = self._block.tick
        recorded = self._recorded
        alone, turn = self._alone, self.turn
        with alone:
            for _ in range(cycles):
                if interrupted():
                    return
                alone.require_open()
                with turn:
                    tick()
                    rows.append(tuple([read() for read in recorded]))
                    if self._listeners:
                        self._to_listeners(self._frames(cycle=True))

    def require_idle(self) -> None:
        """Raise BusyError if another thread is running the loop."""
        with self._alone:
            pass

    def source(self) -> FrameSource:
        """Return the PDOs that a stimulator with the default mapping would send."""
        return FrameSource(
            published=self._pdos,
            every_cycle=[pdo.number for pdo in self._pdos if pdo.number != _STATUS_TPDO],
            commanded=[],
            plate=None,
            clocked=False,
        )

    @contextmanager
    def frames(self, hear: Hear, *, every_cycle: bool = True) -> Iterator[None]:
        """Pass the frames that a bus would carry to `hear`, during a block."""
        with self.turn:
            self._listeners += (hear,)
        try:
            yield
        finally:
            with self.turn:
                self._listeners = tuple(other for other in self._listeners if other is not hear)

    def raw(self, path: Path) -> NoReturn:
        """Raise BenchError: without a bus there are no frames to log."""
        raise BenchError(f"there is no bus whose frames could go to {path}: simulate('bus')")

    def silent(self) -> list[int]:
        """Return an empty list: nothing can fall silent without a bus."""
        return []

    def wrong_time(self) -> str:
        """Return an empty text: time passes only in `run`."""
        return ""

    def close(self) -> None:
        """End a run of another thread; there is no bus to leave."""
        self._alone.close()

    def _to_listeners(self, frames: Iterable[Frame]) -> None:
        if self._listeners:
            for can_id, data, _ in frames:
                for hear in self._listeners:
                    hear(can_id, data)

    def _frames(self, *, cycle: bool) -> Iterator[Frame]:
        """Yield the public TPDOs, and an emergency for each watchdog that was latched or reset.

        The TPDO with the status is sent on a change, the other ones in a cycle.
        """
        for pdo, readers in zip(self._pdos, self._readers, strict=True):
            status = pdo.number == _STATUS_TPDO
            if cycle or status:
                data = pdo.layout.pack(*[read() for read in readers])
                if status:
                    before, self._status = self._status, data
                if not status or data != before:
                    yield Frame(pdo.can_id, data)
        known, self._latched = self._latched, self._block.supervisor.latched
        can_id = cia.EMCY_ID + self._block.od.node_id
        for _ in watchdogs_in(known & ~self._latched):
            yield Frame(can_id, bytes(cia.FRAME_BYTES))
        for watchdog in watchdogs_in(self._latched & ~known):
            row = WATCHDOGS[watchdog]
            register = row.register | ErrorRegister.GENERIC
            yield Frame(can_id, _EMCY.pack(row.code, register, watchdog))

"""Logs of a stimulator with a plate node, from when both are switched on, and their replay."""

from __future__ import annotations

import functools
from collections.abc import Iterable

from nodes_on_a_bus import regulate_friction

from smarttac_can.bench import Stimulator
from smarttac_can.bench.simulation import PLATE_ID, STIMULATOR_ID, plate_od, stimulator_od
from smarttac_can.device.frame import Frame
from smarttac_can.host.local_bus import LocalBus
from smarttac_can.master import requests
from smarttac_can.nodes.plate_node import PlateNode
from smarttac_can.nodes.stimulator_node import StimulatorNode
from smarttac_can.od.cia import NMTCommand
from smarttac_can.replay import Replay, Replayed
from smarttac_can.trials.rig import LocalMaster
from smarttac_can.vocabulary.meanings import START_RUN
from smarttac_can.vocabulary.states import Control, Mode

Log = list[tuple[int, Frame]]
SYNC, DRIVE, EMCY, BOOT_UP = 0x080, 0x221, 0x0A0, 0x720
SDO_TO, SDO_FROM = 0x620, 0x5A0
DEADLINE_MS = 3


@functools.cache
def _friction_run() -> tuple[tuple[int, Frame], ...]:
    log: Log = []
    with Stimulator.simulate(log=lambda *frame: log.append(frame)) as bench:
        bench.finger.stroke(2, speed=200.0, force_variation=0.2, speed_variation=0.2)
        bench.start_run()
        bench.tare()
        regulate_friction(bench)
        bench.set("Limit.Voltage", "60 V")
        bench.run(0.05)
    return tuple(log)


def friction_run() -> Log:
    """Half a second in lockstep, with set-points that change and reads that are long."""
    return list(_friction_run())


def clocked_run(*, reset: bool = False) -> Log:
    """Half a second by the clock with SYNC of the stimulator, and again after a reset of both."""
    log: Log = []
    bus = LocalBus(log=lambda *frame: log.append(frame))
    master = LocalMaster(bus, lambda frame: None)
    bus.attach(PlateNode(plate_od(), deadline_ms=DEADLINE_MS), lockstep=False)
    node = clocked_node()
    bus.attach(node, lockstep=False)
    _drive(bus, master, node)
    if reset:
        master.send(requests.nmt(NMTCommand.RESET_NODE))
        _drive(bus, master, node)
    return log


def _drive(bus: LocalBus, master: LocalMaster, node: StimulatorNode) -> None:
    def write(name: str, raw: int) -> None:
        master.write(STIMULATOR_ID, node.od[name], raw)

    write("Drive unwatched", 1)
    for node_id in (PLATE_ID, STIMULATOR_ID):
        master.send(requests.nmt(NMTCommand.START, node_id))
    bus.advance(3000)
    for name, raw in (
        ("Simulation.Subject", 2),
        ("Finger.Force", 500),
        ("Finger.Motion", 1),
        (START_RUN, 1),
    ):
        master.write(PLATE_ID, plate_od()[name], raw)
    write(START_RUN, 1)
    bus.advance(100_000)
    for name, raw in (
        ("Setpoint.COF left", 2500),
        ("Setpoint.COF right", 2500),
        ("Controlword", Control.FAULT_RESET),
        ("Controlword", 0),
        ("Controlword", Control.ARM),
        ("Mode", Mode.FRICTION),
        ("Controlword", Control.ARM | Control.RUN),
    ):
        write(name, raw)
    bus.advance(400_000)
    write("Controlword", 0)


def clocked_node(deadline_ms: int = DEADLINE_MS) -> StimulatorNode:
    return StimulatorNode(
        stimulator_od(), plate_node_id=PLATE_ID, produce_sync=True, deadline_ms=deadline_ms
    )


def lockstep_node() -> StimulatorNode:
    return StimulatorNode(
        stimulator_od(), plate_node_id=PLATE_ID, lockstep=True, deadline_ms=DEADLINE_MS
    )


def replayed(log: Iterable[tuple[int, Frame]], *, lockstep: bool = True) -> Replayed:
    power_on = lockstep_node if lockstep else clocked_node
    replay = Replay(power_on, STIMULATOR_ID, lockstep=lockstep)
    for time, frame in log:
        replay.take(time, frame)
    return replay.end()


def places(log: Log, can_id: int) -> list[int]:
    """Places of the frames with an identifier."""
    return [place for place, (_, frame) in enumerate(log) if frame.can_id == can_id]


def changed(log: Log, place: int, byte: int, value: int) -> Log:
    """Return a log in which a byte of one frame is another."""
    time, frame = log[place]
    data = bytearray(frame.data)
    assert data[byte] != value
    data[byte] = value
    return [*log[:place], (time, Frame(frame.can_id, bytes(data))), *log[place + 1 :]]

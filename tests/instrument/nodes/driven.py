"""A rig that drives, for tests to break, and writes that return the abort code."""

from __future__ import annotations

from smarttac_can.assurance.trials.fault_cases import FaultCase, nothing, send_setpoints
from smarttac_can.assurance.trials.fault_matrix import driving_rig
from smarttac_can.assurance.trials.rig import Rig
from smarttac_can.bench.simulation import PLATE_ID, STIMULATOR_ID
from smarttac_can.canopen.bus.bus import LogHook
from smarttac_can.canopen.od.cia import Abort, NMTCommand
from smarttac_can.canopen.od.entry import Entry
from smarttac_can.vocabulary.states import Mode

MASTER, SETPOINT_DEADLINE_MS = 1, 5
STATE = 0x08000022
FAULT_RESET = 0x80


def _count_and_send(rig: Rig) -> None:
    rig.count_syncs()
    send_setpoints(rig)


_SOUND = FaultCase("none", 0, None, nothing, nothing, prepare=_count_and_send)


def driven(mode: Mode = Mode.OPEN_LOOP, log: LogHook | None = None) -> Rig:
    """A rig that drives; its master counts SYNCs and sends set-points, both under watch."""
    rig = driving_rig(_SOUND, mode, log)
    assert rig.stage.read() > 0
    return rig


def driven_within(deadline_ms: int, mode: Mode = Mode.OPEN_LOOP) -> Rig:
    """A rig that drives, with other deadlines of the loop than those of lockstep."""
    rig = driven(mode)
    # Limits and watches of a run become stricter only, and a plate in use does not know its end.
    assert write(rig, "Controlword", 0) == 0
    rig.nmt(NMTCommand.ENTER_PRE_OPERATIONAL, PLATE_ID)
    assert write_entry(rig, rig.plate.od.entry(0x1400, 5), deadline_ms, PLATE_ID) == 0
    rig.nmt(NMTCommand.START, PLATE_ID)
    for index in (0x1404, 0x1405, 0x1406):
        assert write_entry(rig, rig.od.entry(index, 5), deadline_ms) == 0
    rig.cycle(5)
    rig.drive(mode)
    rig.cycle(60)
    assert rig.stage.read() > 0
    return rig


def write(rig: Rig, name: str, raw: int) -> int:
    """Write to the stimulator, or to the simulation; return the abort code, 0 for success."""
    try:
        rig.write(name, raw)
    except Abort as abort:
        return abort.code
    return 0


def write_entry(rig: Rig, entry: Entry, raw: int, node_id: int = STIMULATOR_ID) -> int:
    """Write to a node; return the abort code, 0 for success."""
    try:
        rig.master.write(node_id, entry, raw)
    except Abort as abort:
        return abort.code
    return 0


def reset_fault(rig: Rig) -> int:
    """Disarm and reset the fault; return the abort code, 0 for success."""
    assert write(rig, "Controlword", 0) == 0
    return write(rig, "Controlword", FAULT_RESET)

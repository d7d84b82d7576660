"""Every fault of the fault matrix: how it comes, how it goes, and how soon it must be at 0 V."""

from __future__ import annotations

from typing import Any, Final, NamedTuple

from smarttac_can.bench.open_link import PLATE_ID, STIMULATOR_ID
from smarttac_can.control.cascade import Mode
from smarttac_can.host.mishaps import Mishap
from smarttac_can.nodes.loop_period import SHORT_DEADLINE_MS
from smarttac_can.nodes.watchdogs import (
    AMPLITUDE_CYCLES,
    GAUGE_CYCLES,
    RESONANCE_CYCLES,
    SATURATED_CYCLES,
    SILENT_CYCLES,
    STUCK_GAUGE_CYCLES,
    STUCK_THERMOMETER_CYCLES,
    sync_window,
)
from smarttac_can.od.cia import HEARTBEAT_ID, RPDO_IDS, TPDO_IDS, NMTCommand
from smarttac_can.plant.faults import PICKUP_D, PICKUP_Q, THERMOMETER, FaultKind
from smarttac_can.trials.fault_acts import (
    SETPOINT_DEADLINE_MS,
    Act,
    another_plate,
    befall,
    bus_off,
    bus_recovered,
    calm,
    control_rightly,
    control_wrongly,
    jump,
    limit_amplitude,
    lose,
    lower_force_limit,
    nothing,
    pause_master,
    pause_plate,
    pause_stimulator,
    put,
    restart_plate,
    restart_stimulator,
    resume_master,
    resume_stimulator,
    send_setpoints,
    skip_syncs,
    start_clock,
    stop_clock,
    transmit_failed,
)
from smarttac_can.trials.rig import NODE_LOST_MS, Rig

DRIVING: Final = (
    Mode.OPEN_LOOP,
    Mode.AMPLITUDE,
    Mode.AMPLITUDE_RESONANCE,
    Mode.FRICTION,
    Mode.IDENTIFY,
)
"""Modes with a voltage."""
TRACKED: Final = (Mode.AMPLITUDE_RESONANCE, Mode.FRICTION)
"""Modes in which the frequency follows the resonance."""

MEASUREMENTS: Final = tuple(base + PLATE_ID for base in TPDO_IDS[:3])
DRIVE: Final = RPDO_IDS[0] + PLATE_ID
AT_ONCE: Final = 1
"""Acted on where it is noticed, which is by the end of the cycle."""
PDO_DEADLINE_MS: Final = SHORT_DEADLINE_MS
"""Event timers of the drive at the plate, and of the measurements at the stimulator."""
SYNC_IRREGULAR_CYCLES: Final = 2 * sync_window(PDO_DEADLINE_MS)
"""The window in which the fault comes may end too early to tell; the next one is enough."""
HUNTING_CYCLES: Final = SILENT_CYCLES
"""A loop that answers a wrong pick-up lets its excess come and go, but not for longer."""
FORCE_PATH_CYCLES: Final = 6
"""What flexure and filter of 100 Hz take to show half of a sudden force, and a cycle."""
RING_DOWN_CYCLES: Final = 3
"""Time constants of the plate, 1 ms each, until 5 % of its vibration is left."""


class FaultCase(NamedTuple):
    """One fault."""

    name: str
    bound: int
    """Cycles from the injection to the detection."""
    inject: Act
    remove: Act
    modes: tuple[Mode, ...] = DRIVING
    prepare: Act | None = None
    """What the fault needs before the run."""
    plate_inside: bool = False
    forgets: bool = False
    """Whether the stimulator starts anew, and so obeys the master again without a fault reset."""
    deaf: bool = False
    """Whether a node cannot hear or act, so that it may go on driving until its plate notices."""
    breaks_stage: bool = False
    """Whether the power stage ignores what is asked for."""
    breaks_controller: bool = False
    """Whether the controllers themselves are replaced."""
    needs_voltage: bool = False
    """Whether it shows under a voltage only, and a friction loop that pauses puts it off."""


def _broken(
    name: str,
    bound: int,
    kind: FaultKind,
    sensor: int = 1,
    value: int = 0,
    **more: Any,
) -> FaultCase:
    def inject(rig: Rig) -> None:
        rig.inject(kind, sensor, value)

    return FaultCase(name, bound, inject, Rig.mend, **more)


def _nmt(name: str, command: int, node_id: int, bound: int, inside: bool = False) -> FaultCase:
    return FaultCase(
        name, bound, lambda rig: rig.nmt(command, node_id), nothing, plate_inside=inside
    )


def _gauges() -> list[FaultCase]:
    cases = []
    for number in range(1, 7):
        cases += [
            _broken(f"S{number} stuck", STUCK_GAUGE_CYCLES, FaultKind.STUCK, number),
            _broken(f"S{number} dead", STUCK_GAUGE_CYCLES, FaultKind.DEAD, number),
            _broken(f"S{number} saturated", SATURATED_CYCLES, FaultKind.SATURATED, number),
        ]
    for number in range(3, 7):
        cases.append(_broken(f"S{number} jumps", GAUGE_CYCLES, FaultKind.OFFSET, number, 600))
    return cases


def _pickup() -> list[FaultCase]:
    cases = []
    for name, sensor in (("d", PICKUP_D), ("q", PICKUP_Q)):
        cases += [
            _broken(f"pick-up {name} stuck", STUCK_GAUGE_CYCLES, FaultKind.STUCK, sensor),
            _broken(f"pick-up {name} dead", STUCK_GAUGE_CYCLES, FaultKind.DEAD, sensor),
            _broken(f"pick-up {name} saturated", SATURATED_CYCLES, FaultKind.SATURATED, sensor),
        ]
    return cases


CASES: Final[tuple[FaultCase, ...]] = (
    _nmt("NMT stop", NMTCommand.STOP, STIMULATOR_ID, PDO_DEADLINE_MS),
    _nmt("NMT pre-operational", NMTCommand.ENTER_PRE_OPERATIONAL, STIMULATOR_ID, PDO_DEADLINE_MS),
    _nmt("NMT reset node", NMTCommand.RESET_NODE, STIMULATOR_ID, PDO_DEADLINE_MS),
    _nmt("NMT reset communication", NMTCommand.RESET_COMMUNICATION, STIMULATOR_ID, PDO_DEADLINE_MS),
    _nmt("NMT stop of the plate", NMTCommand.STOP, PLATE_ID, AT_ONCE),
    _nmt("NMT reset of the plate", NMTCommand.RESET_NODE, PLATE_ID, AT_ONCE),
    _nmt("NMT stop, plate inside", NMTCommand.STOP, STIMULATOR_ID, AT_ONCE, inside=True),
    FaultCase(
        "heartbeat of the master lost", NODE_LOST_MS, put("heartbeat", False),
        put("heartbeat", True),
    ),
    FaultCase(
        "heartbeat of the master lost, plate inside", NODE_LOST_MS, put("heartbeat", False),
        put("heartbeat", True), plate_inside=True,
    ),
    FaultCase("heartbeat of the plate lost", NODE_LOST_MS,
              befall(Mishap.LOSS, HEARTBEAT_ID + PLATE_ID), calm),
    FaultCase(
        "measurements lost", PDO_DEADLINE_MS, befall(Mishap.LOSS, *MEASUREMENTS), calm
    ),
    FaultCase("drives lost", PDO_DEADLINE_MS, befall(Mishap.LOSS, DRIVE), calm),
    FaultCase(
        "set-points lost", SETPOINT_DEADLINE_MS, lambda rig: rig.each_cycle.clear(),
        send_setpoints, prepare=send_setpoints,
    ),
    FaultCase("SYNC lost", PDO_DEADLINE_MS, put("syncs", 0), put("syncs", 1)),
    FaultCase("SYNC twice a cycle", SYNC_IRREGULAR_CYCLES, put("syncs", 2), put("syncs", 1)),
    FaultCase("SYNC counter jumps", AT_ONCE, skip_syncs, nothing, prepare=Rig.count_syncs),
    FaultCase("bus-off", AT_ONCE, bus_off, bus_recovered),
    FaultCase("transmit queue full", AT_ONCE, transmit_failed, nothing),
    FaultCase("controller asks for 999 V", AT_ONCE, control_wrongly(999.0), control_rightly,
              breaks_controller=True),
    FaultCase("controller gives NaN", AT_ONCE, control_wrongly(float("nan")), control_rightly,
              breaks_controller=True),
    FaultCase("another plate", AT_ONCE, another_plate(2), another_plate(1)),
    FaultCase("plate without a serial number", AT_ONCE, another_plate(0), another_plate(1)),
    *_gauges(),
    *_pickup(),
    _broken("S3 saturated, plate inside", SATURATED_CYCLES, FaultKind.SATURATED, 3,
            plate_inside=True),
    _broken("pick-up reads too much", HUNTING_CYCLES, FaultKind.GAIN, PICKUP_D, 6000),
    _broken("thermometer stuck", STUCK_THERMOMETER_CYCLES, FaultKind.STUCK, THERMOMETER),
    _broken("thermometer jumps", AT_ONCE, FaultKind.OFFSET, THERMOMETER, 6000),
    _broken("plate too hot", AT_ONCE, FaultKind.TEMPERATURE, 1, 7500),
    _broken("finger slams", FORCE_PATH_CYCLES, FaultKind.SLAM, 1, 9000),
    _broken("lateral force", AT_ONCE, FaultKind.OFFSET, 1, 2000, prepare=lower_force_limit),
    _broken("resonance out of reach", RING_DOWN_CYCLES + RESONANCE_CYCLES,
            FaultKind.RESONANCE_SHIFT, 1, -1500, modes=TRACKED, needs_voltage=True),
    _broken("plate cracked", RING_DOWN_CYCLES + SILENT_CYCLES, FaultKind.RESONANCE_SHIFT, 1,
            -9000, needs_voltage=True),
    FaultCase("vibration above its limit", AMPLITUDE_CYCLES, limit_amplitude(100),
              limit_amplitude(3200), tuple(mode for mode in DRIVING if mode is not Mode.IDENTIFY),
              needs_voltage=True),
    _broken("vibration above its limit, identifying", AMPLITUDE_CYCLES, FaultKind.OFFSET, PICKUP_D,
            500, modes=(Mode.IDENTIFY,), prepare=limit_amplitude(1000)),
    _broken("power stage stuck", AT_ONCE, FaultKind.STAGE_STUCK, 1, 14_000, breaks_stage=True),
    FaultCase("measurements two cycles late", PDO_DEADLINE_MS,
              befall(Mishap.DELAY, *MEASUREMENTS, cycles=2), calm),
    FaultCase("drives two cycles late", PDO_DEADLINE_MS,
              befall(Mishap.DELAY, DRIVE, cycles=2), calm),
    FaultCase("measurements swapped", PDO_DEADLINE_MS,
              befall(Mishap.REORDERING, *MEASUREMENTS), calm),
    FaultCase("drives corrupt", PDO_DEADLINE_MS, befall(Mishap.CORRUPTION, DRIVE), calm),
    FaultCase("measurements corrupt", PDO_DEADLINE_MS,
              befall(Mishap.CORRUPTION, *MEASUREMENTS), calm),
    FaultCase("a node babbles", PDO_DEADLINE_MS,
              lambda rig: rig.bus.babble(8), lambda rig: rig.bus.babble(0)),
    FaultCase("stimulator restarts", PDO_DEADLINE_MS, restart_stimulator, nothing, forgets=True),
    FaultCase("stimulator restarts, plate inside", AT_ONCE, restart_stimulator, nothing,
              plate_inside=True, forgets=True),
    FaultCase("plate restarts", AT_ONCE, restart_plate, nothing),
    FaultCase("clock of the stimulator jumps", AT_ONCE, jump(plate=False), nothing),
    FaultCase("clock of the plate jumps", AT_ONCE, jump(plate=True), nothing),
    FaultCase("clock of the stimulator stops", SYNC_IRREGULAR_CYCLES, stop_clock, start_clock),
    FaultCase("stimulator paused for 2 s", PDO_DEADLINE_MS, pause_stimulator, resume_stimulator,
              deaf=True),
    FaultCase("plate paused for 2 s", PDO_DEADLINE_MS, pause_plate, nothing, deaf=True),
    FaultCase("master paused", PDO_DEADLINE_MS, pause_master, resume_master),
)  # fmt: skip
"""Faults that have to end in 0 V."""

TOLERATED: Final[tuple[FaultCase, ...]] = (
    FaultCase("measurements twice", 0, befall(Mishap.DUPLICATION, *MEASUREMENTS), calm),
    FaultCase("drives twice", 0, befall(Mishap.DUPLICATION, DRIVE), calm),
    FaultCase("measurements late in their cycle", 0,
              befall(Mishap.DELAY, *MEASUREMENTS), calm),
    FaultCase("a cycle of measurements lost", 0, lose(*MEASUREMENTS), nothing),
    FaultCase("a drive lost", 0, lose(DRIVE), nothing),
    FaultCase("a node babbles a little", 0,
              lambda rig: rig.bus.babble(2), lambda rig: rig.bus.babble(0)),
)  # fmt: skip
"""Faults that must not end a run."""

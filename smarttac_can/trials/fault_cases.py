"""Every fault of the fault matrix: how it comes, how it goes, and how soon it must be at 0 V."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from smarttac_can.bench.simulation import PLATE_ID, STIMULATOR_ID
from smarttac_can.host.frame_faults import FrameFault
from smarttac_can.nodes.front_end import STAGE_TOLERANCE
from smarttac_can.nodes.hardware_watch import READ_BACK_CYCLES
from smarttac_can.od.cia import HEARTBEAT_ID, RPDO_IDS, TPDO_IDS, NMTCommand
from smarttac_can.trials import fault_acts as act
from smarttac_can.trials.fault_case import (
    REGULATED,
    RING_DOWN_CYCLES,
    TRACKED,
    FaultCase,
    broken,
    visible,
)
from smarttac_can.trials.rig import MASTER_LOST_MS, PLATE_LOST_MS, Rig
from smarttac_can.trials.weak_pickup import WEAK_PICKUP
from smarttac_can.vocabulary.faults import PICKUP_D, PICKUP_Q, THERMOMETER, FaultKind
from smarttac_can.vocabulary.modes import Mode
from smarttac_can.vocabulary.signals import SHORT_DEADLINE_MS
from smarttac_can.vocabulary.watchdogs import (
    AMPLITUDE_CYCLES,
    GAUGE_CYCLES,
    RESONANCE_CYCLES,
    SATURATED_CYCLES,
    SILENT_CYCLES,
    STUCK_GAUGE_CYCLES,
    STUCK_THERMOMETER_CYCLES,
    Watchdog,
    sync_window,
)

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
READ_BACK_BOUND: Final = READ_BACK_CYCLES + 2
"""A reading may be a cycle old, and so may what it is compared with."""
FORCE_PATH_CYCLES: Final = 6
"""What flexure and filter of 100 Hz take to show half of a sudden force, and a cycle."""


_BEYOND: Final = "the end of the range, less the zero, is above the limit of the force in one cycle"
_LATERAL: Final = "without a finger a lateral force contradicts the other gauges at once"
_DIAGONAL: Final = (
    "0 N contradicts the other three normal gauges before it has lasted for 24 cycles"
)
_MOVED: Final = "the texture moves the vibration away from where the reading rests"
_LOOP: Final = (
    "an amplitude loop asks for more until the other axis is at its end; an identification beside "
    "the resonance still reads that one, so that equal samples are first"
)


_NO_FRICTION_N: Final = 0.4
"""Normal force in N up to which an error of 1.7 N at a lateral gauge cannot be friction.

A lateral force may be twice the normal force and 0.2 N: 1 N at 0.4 N. For the error to hide,
friction would have to cancel 0.7 N of it, by a COF of 1.75; no simulated finger has that."""


def _nmt(
    name: str, command: int, bound: int, *, of_plate: bool = False, inside: bool = False
) -> FaultCase:
    node_id = PLATE_ID if of_plate else STIMULATOR_ID
    watchdog = Watchdog.MEASUREMENT if of_plate else Watchdog.NMT

    def inject(rig: Rig) -> None:
        rig.nmt(command, node_id)

    return FaultCase(name, bound, watchdog, inject, act.nothing, plate_inside=inside)


def _disobeys(rig: Rig) -> bool:
    """Whether the power stage puts out something else than it is told."""
    return abs(rig.plate_block.commanded - rig.stage.si_value) > STAGE_TOLERANCE


def _is_unanswered(rig: Rig) -> bool:
    """Whether the measurement of this tick was refused; 1 corrupt one in 256 passes its check."""
    plate = rig.plate_block
    return bool(plate.od["Drive.Tick"].value != plate.tick.value)


def _sensor(
    name: str,
    sensor: int,
    dead: Watchdog,
    saturated: Watchdog,
    instead: Mapping[Mode, Watchdog] = MappingProxyType({}),
    why: str = "",
) -> list[FaultCase]:
    """Return the ways in which any sensor fails; `instead` and `why` are of a dead one."""
    beyond = "" if saturated is Watchdog.SATURATED else _BEYOND
    moved = {Mode.TEXTURE: Watchdog.PICKUP} if sensor == PICKUP_D else {}
    return [
        broken(
            f"{name} stuck", STUCK_GAUGE_CYCLES, Watchdog.STUCK, FaultKind.STUCK, sensor,
            instead=moved, why=_MOVED if moved else "",
        ),
        broken(
            f"{name} dead", STUCK_GAUGE_CYCLES, dead, FaultKind.DEAD, sensor,
            instead=instead, why=why,
        ),
        broken(
            f"{name} saturated", SATURATED_CYCLES, saturated, FaultKind.SATURATED, sensor,
            why=beyond,
        ),
    ]  # fmt: skip


CASES: Final[tuple[FaultCase, ...]] = (
    _nmt("NMT stop", NMTCommand.STOP, PDO_DEADLINE_MS),
    _nmt("NMT pre-operational", NMTCommand.ENTER_PRE_OPERATIONAL, PDO_DEADLINE_MS),
    _nmt("NMT reset node", NMTCommand.RESET_NODE, PDO_DEADLINE_MS),
    _nmt("NMT reset communication", NMTCommand.RESET_COMMUNICATION, PDO_DEADLINE_MS),
    _nmt("NMT stop of the plate", NMTCommand.STOP, AT_ONCE, of_plate=True),
    _nmt("NMT reset of the plate", NMTCommand.RESET_NODE, AT_ONCE, of_plate=True),
    _nmt("NMT stop, plate inside", NMTCommand.STOP, AT_ONCE, inside=True),
    # An identification is over before a heartbeat is missed.
    FaultCase("heartbeat of the master lost", MASTER_LOST_MS, Watchdog.HEARTBEAT,
              act.put("heartbeat", False), act.put("heartbeat", True), REGULATED),
    FaultCase("heartbeat of the master lost, plate inside", MASTER_LOST_MS, Watchdog.HEARTBEAT,
              act.put("heartbeat", False), act.put("heartbeat", True), REGULATED,
              plate_inside=True),
    FaultCase("heartbeat of the plate lost", PLATE_LOST_MS, Watchdog.HEARTBEAT,
              act.disturb(FrameFault.LOSS, HEARTBEAT_ID + PLATE_ID), act.hear_plate, REGULATED,
              prepare=act.hear_plate),
    FaultCase("master boots again", AT_ONCE, Watchdog.HEARTBEAT, act.boot_again, act.nothing),
    FaultCase("measurements lost", PDO_DEADLINE_MS, Watchdog.MEASUREMENT,
              act.disturb(FrameFault.LOSS, *MEASUREMENTS), act.calm, through_loop=True),
    FaultCase("drives lost", PDO_DEADLINE_MS, Watchdog.PLATE,
              act.disturb(FrameFault.LOSS, DRIVE), act.calm, through_loop=True),
    FaultCase("set-points lost", act.SETPOINT_DEADLINE_MS, Watchdog.SETPOINT,
              lambda rig: rig.each_cycle.clear(), act.send_setpoints, prepare=act.send_setpoints),
    FaultCase("SYNC lost", PDO_DEADLINE_MS, Watchdog.SYNC_LOST, act.put("syncs", 0),
              act.put("syncs", 1)),
    FaultCase("SYNC twice a cycle", SYNC_IRREGULAR_CYCLES, Watchdog.SYNC_IRREGULAR,
              act.put("syncs", 2), act.put("syncs", 1)),
    FaultCase("SYNC counter jumps", AT_ONCE, Watchdog.SYNC_COUNTER, act.skip_syncs, act.nothing,
              prepare=Rig.count_syncs),
    FaultCase("bus-off", PDO_DEADLINE_MS, Watchdog.BUS_OFF, act.bus_off, act.bus_recovered,
              cut_off=True),
    FaultCase("transmit queue full", PDO_DEADLINE_MS, Watchdog.TRANSMIT_QUEUE,
              act.fill_queue, act.nothing),
    FaultCase("controller asks for 999 V", AT_ONCE, Watchdog.VOLTAGE,
              act.control_wrongly(999.0), act.control_rightly, breaks_controller=True),
    FaultCase("controller gives NaN", AT_ONCE, Watchdog.CONTROLLER,
              act.control_wrongly(float("nan")), act.control_rightly, breaks_controller=True),
    FaultCase("another plate", AT_ONCE, Watchdog.CALIBRATION, act.another_plate(2),
              act.another_plate(1)),
    FaultCase("plate without a serial number", AT_ONCE, Watchdog.CALIBRATION,
              act.another_plate(0), act.another_plate(1)),
    FaultCase("another node speaks as the stimulator", AT_ONCE, Watchdog.DOUBLE,
              act.speak_as(HEARTBEAT_ID + STIMULATOR_ID), act.fall_silent),
    FaultCase("another node speaks as the stimulator, plate inside", AT_ONCE, Watchdog.DOUBLE,
              act.speak_as(HEARTBEAT_ID + STIMULATOR_ID), act.fall_silent, plate_inside=True),
    FaultCase("another node speaks as the plate", AT_ONCE, Watchdog.DOUBLE,
              act.speak_as(HEARTBEAT_ID + PLATE_ID), act.fall_silent),
    FaultCase("another node sends drives", AT_ONCE, Watchdog.DOUBLE,
              act.speak_as(DRIVE), act.fall_silent),
    *(case for number in (1, 2) for case in _sensor(
        f"S{number}", number, Watchdog.STUCK, Watchdog.SATURATED,
        {Mode.IDENTIFY: Watchdog.GAUGES}, _LATERAL)),
    *_sensor("S3", 3, Watchdog.GAUGES, Watchdog.NORMAL_FORCE, why=_DIAGONAL),
    *_sensor("S4", 4, Watchdog.GAUGES, Watchdog.SATURATED, why=_DIAGONAL),
    *_sensor("S5", 5, Watchdog.GAUGES, Watchdog.NORMAL_FORCE, why=_DIAGONAL),
    *_sensor("S6", 6, Watchdog.GAUGES, Watchdog.NORMAL_FORCE, why=_DIAGONAL),
    *(broken(f"S{number} jumps", GAUGE_CYCLES, Watchdog.GAUGES, FaultKind.OFFSET, number, 600)
      for number in range(3, 7)),
    *(FaultCase(f"S{number} off in {off} of {period} cycles", bound, Watchdog.GAUGES,
                act.offset_sometimes(number, mN, off, period), Rig.mend, through_loop=True,
                shows=shows)
      for number, mN, off, period, bound, shows in
      ((1, 1700, 4, 5, 7, visible(0.0, _NO_FRICTION_N)), (3, 600, 4, 5, 7, None),
       (4, -600, 1, 2, 11, None), (6, 600, 1, 3, 16, None))),
    *_sensor("pick-up d", PICKUP_D, Watchdog.PICKUP, Watchdog.SATURATED, {
        Mode.AMPLITUDE: Watchdog.SATURATED, Mode.AMPLITUDE_RESONANCE: Watchdog.SATURATED,
        Mode.IDENTIFY: Watchdog.STUCK,
    }, _LOOP),
    *_sensor("pick-up q", PICKUP_Q, Watchdog.STUCK, Watchdog.SATURATED),
    broken("S3 saturated, plate inside", SATURATED_CYCLES, Watchdog.NORMAL_FORCE,
            FaultKind.SATURATED, 3, plate_inside=True, why=_BEYOND),
    broken("pick-up reads too much", HUNTING_CYCLES, Watchdog.SATURATED,
            FaultKind.GAIN, PICKUP_D, 6000, modes=REGULATED, shows=visible(up_to_N=1.2)),
    *WEAK_PICKUP,
    broken("thermometer stuck", STUCK_THERMOMETER_CYCLES, Watchdog.STUCK,
            FaultKind.STUCK, THERMOMETER),
    broken("thermometer jumps", AT_ONCE, Watchdog.TEMPERATURE,
            FaultKind.OFFSET, THERMOMETER, 6000),
    broken("plate too hot", AT_ONCE, Watchdog.TEMPERATURE, FaultKind.TEMPERATURE, 1, 7500),
    broken("finger slams", FORCE_PATH_CYCLES, Watchdog.NORMAL_FORCE, FaultKind.SLAM, 1, 9000),
    broken("lateral force", AT_ONCE, Watchdog.LATERAL_FORCE,
            FaultKind.OFFSET, 1, 2000, prepare=act.lower_force_limit),
    broken("resonance out of reach", RING_DOWN_CYCLES + RESONANCE_CYCLES, Watchdog.RESONANCE,
            FaultKind.RESONANCE_SHIFT, 1, -1500, modes=TRACKED, shows=visible()),
    broken("plate cracked", RING_DOWN_CYCLES + SILENT_CYCLES, Watchdog.PICKUP,
            FaultKind.RESONANCE_SHIFT, 1, -9000, shows=visible(), adds_up=False),
    FaultCase("vibration above its limit", AMPLITUDE_CYCLES, Watchdog.AMPLITUDE,
              act.limit_amplitude(100), act.limit_amplitude(3200),
              REGULATED, shows=visible(), through_loop=True),
    broken("vibration above its limit, identifying", AMPLITUDE_CYCLES, Watchdog.AMPLITUDE,
            FaultKind.OFFSET, PICKUP_D, 500, modes=(Mode.IDENTIFY,),
            prepare=act.limit_amplitude(1000)),
    broken("power stage stuck", AT_ONCE, Watchdog.STAGE,
            FaultKind.STAGE_STUCK, 1, 14_000, breaks_stage=True, shows=_disobeys,
            instead={Mode.IDENTIFY: Watchdog.PICKUP},
            why="140 V instead of 16 V are more vibration than an identification bears: it asks "
            "for 0 V, which a stuck stage obeys, before a drive could show that it does not"),
    FaultCase("hardware takes its enable away", AT_ONCE, Watchdog.NOT_ENABLED,
              act.hardware("enable", 0), act.hardware("enable", 1), prepare=act.connect_hardware),
    FaultCase("hardware falls silent", PDO_DEADLINE_MS, Watchdog.NOT_ENABLED,
              act.hardware("speaks", False), act.hardware("speaks", True),
              prepare=act.connect_hardware),
    FaultCase("hardware reads 10 V more", READ_BACK_BOUND, Watchdog.STAGE,
              act.hardware("excess", 1000), act.hardware("excess", 0),
              prepare=act.connect_hardware),
    FaultCase("measurements two cycles late", PDO_DEADLINE_MS, Watchdog.MEASUREMENT,
              act.disturb(FrameFault.DELAY, *MEASUREMENTS, cycles=2), act.calm, through_loop=True),
    FaultCase("drives two cycles late", PDO_DEADLINE_MS, Watchdog.PLATE,
              act.disturb(FrameFault.DELAY, DRIVE, cycles=2), act.calm, through_loop=True),
    FaultCase("measurements swapped", PDO_DEADLINE_MS, Watchdog.MEASUREMENT,
              act.disturb(FrameFault.REORDERING, *MEASUREMENTS), act.calm, through_loop=True),
    FaultCase("drives corrupt", PDO_DEADLINE_MS, Watchdog.PLATE,
              act.disturb(FrameFault.CORRUPTION, DRIVE), act.calm),
    FaultCase("measurements corrupt", PDO_DEADLINE_MS, Watchdog.MEASUREMENT,
              act.disturb(FrameFault.CORRUPTION, *MEASUREMENTS), act.calm,
              shows=_is_unanswered, adds_up=False),
    FaultCase("a node babbles", PDO_DEADLINE_MS, Watchdog.MEASUREMENT,
              lambda rig: rig.bus.babble(8), lambda rig: rig.bus.babble(0)),
    FaultCase("stimulator restarts", PDO_DEADLINE_MS, None, act.restart_stimulator, act.nothing,
              forgets=True),
    FaultCase("stimulator restarts, plate inside", AT_ONCE, None, act.restart_stimulator,
              act.nothing,
              plate_inside=True, forgets=True),
    FaultCase("plate restarts", AT_ONCE, Watchdog.MEASUREMENT, act.restart_plate, act.nothing),
    FaultCase("clock of the stimulator jumps", AT_ONCE, Watchdog.SYNC_LOST,
              act.jump(plate=False), act.hear_plate),
    FaultCase("clock of the plate jumps", AT_ONCE, Watchdog.PLATE, act.jump(plate=True),
              act.nothing),
    FaultCase("clock of the stimulator stops", SYNC_IRREGULAR_CYCLES, Watchdog.SYNC_IRREGULAR,
              act.stop_clock, act.start_clock),
    FaultCase("stimulator paused for 2 s", PDO_DEADLINE_MS, None,
              act.pause_stimulator, act.resume_stimulator, deaf=True),
    FaultCase("plate paused for 2 s", AT_ONCE, Watchdog.MEASUREMENT,
              act.pause_plate, act.nothing, deaf=True,
              uncovered="a process that stands cannot put its "
              "stage at 0 V, and does not hear hardware that asks for it. The stage's own hardware "
              "has to: an enable in its supply that falls when it is not served in time, by a "
              "watchdog that each cycle of the plate retriggers"),
    FaultCase("master paused", PDO_DEADLINE_MS, Watchdog.SYNC_LOST, act.pause_master,
              act.resume_master),
)  # fmt: skip
"""Faults that have to end in 0 V."""

TOLERATED: Final[tuple[FaultCase, ...]] = (
    FaultCase("measurements twice", 0, None, act.disturb(FrameFault.DUPLICATION, *MEASUREMENTS),
              act.calm,
              through_loop=True),
    FaultCase("drives twice", 0, None, act.disturb(FrameFault.DUPLICATION, DRIVE), act.calm,
              through_loop=True),
    FaultCase("measurements late in their cycle", 0, None,
              act.disturb(FrameFault.DELAY, *MEASUREMENTS), act.calm, through_loop=True),
    FaultCase("a cycle of measurements lost", 0, None, act.lose(*MEASUREMENTS), act.nothing,
              through_loop=True),
    FaultCase("a drive lost", 0, None, act.lose(DRIVE), act.nothing, through_loop=True),
    FaultCase("a node babbles a little", 0, None,
              lambda rig: rig.bus.babble(2), lambda rig: rig.bus.babble(0), through_loop=True),
)  # fmt: skip
"""Faults that must not end a run."""

"""All faults of the fault matrix: how to inject and remove each one, and its bound until 0 V."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from math import inf
from struct import pack
from types import MappingProxyType
from typing import Any, Final, NamedTuple

from smarttac_can.assurance.trials.rig import (
    MASTER_ID,
    MASTER_LOST_MS,
    PLATE_HEARTBEAT_MS,
    PLATE_LOST_MS,
    Rig,
    StageHardware,
)
from smarttac_can.bench.simulation import PLATE_ID, STIMULATOR_ID
from smarttac_can.canopen.device.device import GONE_AFTER_US
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.od import cia
from smarttac_can.canopen.od.cia import NMTCommand
from smarttac_can.host.faulty_bus import Disturbance, FrameFault
from smarttac_can.instrument.nodes.front_end import STAGE_TOLERANCE
from smarttac_can.instrument.nodes.plate_node import READ_BACK_CYCLES
from smarttac_can.science.control.cascade import Cascade
from smarttac_can.science.plant.faults import Fault
from smarttac_can.vocabulary.faults import (
    PICKUP,
    PICKUP_D,
    PICKUP_Q,
    SENSOR_KINDS,
    THERMOMETER,
    FaultKind,
)
from smarttac_can.vocabulary.signals import SHORT_DEADLINE_MS, TICK_US, Drive, Measurement, Setpoint
from smarttac_can.vocabulary.states import Mode
from smarttac_can.vocabulary.watchdogs import (
    AMPLITUDE_CYCLES,
    GAUGE_CYCLES,
    LACK_CYCLES,
    RESONANCE_CYCLES,
    SATURATED_CYCLES,
    SILENT_CYCLES,
    STUCK_GAUGE_CYCLES,
    STUCK_THERMOMETER_CYCLES,
    Watchdog,
    sync_window,
)

SETPOINT_DEADLINE_MS: Final = 5
"""Event timer in ms of the set-points at the stimulator, if the master sends them in each cycle."""
_PAUSE_CYCLES: Final = 2000
_FULL_CYCLES: Final = 20
_SETPOINT_RPDO: Final = 2
_SETPOINT_PDO: Final = Frame(
    cia.RPDO_IDS[_SETPOINT_RPDO - 1] + STIMULATOR_ID, pack("<HI", 4000, 4_339_000)
)
"""Set-points of voltage and frequency, 40 V at the resonance."""

Act = Callable[[Rig], None]


def nothing(rig: Rig) -> None:
    """Do nothing, as the cause of the fault has already gone."""


def put(name: str, value: object) -> Act:
    """Return an act that sets an attribute of the rig."""
    return lambda rig: setattr(rig, name, value)


def disturb(frame_fault: FrameFault, *can_ids: int, cycles: int = 1) -> Act:
    """Return an act after which each frame with one of these CAN-IDs is disturbed.

    The disturbance lasts until `calm`. A delayed frame is ``cycles`` late.
    """
    disturbance = Disturbance(frame_fault, frozenset(can_ids), cycles=cycles)
    return lambda rig: rig.bus.disturbances.append(disturbance)


def lose(*can_ids: int) -> Act:
    """Return an act that loses these frames in one cycle; two in a row would be a fault."""

    def act(rig: Rig) -> None:
        disturb(FrameFault.LOSS, *can_ids)(rig)
        rig.cycle()
        calm(rig)

    return act


def calm(rig: Rig) -> None:
    """End all frame faults on the bus."""
    rig.bus.disturbances.clear()


def jump(plate: bool) -> Act:
    """Return an act that advances the clock of a node by 2 s."""

    def act(rig: Rig) -> None:
        port = rig.plate_port if plate else rig.stimulator_port
        assert port is not None
        rig.bus.jump(port, _PAUSE_CYCLES * TICK_US)

    return act


def stop_clock(rig: Rig) -> None:
    """Stop the clock of the stimulator."""
    rig.bus.stop_clock(rig.stimulator_port)


def start_clock(rig: Rig) -> None:
    """Restart the clock of the stimulator."""
    rig.bus.start_clock(rig.stimulator_port)


def restart_stimulator(rig: Rig) -> None:
    """Switch the power of the stimulator off and on."""
    rig.bus.power_off(rig.stimulator_port)
    rig.bus.power_on(rig.stimulator_port)


def restart_plate(rig: Rig) -> None:
    """Switch the power of the plate off and on."""
    assert rig.plate_port is not None
    rig.bus.power_off(rig.plate_port)
    rig.bus.power_on(rig.plate_port)


def pause_stimulator(rig: Rig) -> None:
    """Stop the process of the stimulator."""
    rig.bus.pause(rig.stimulator_port)


def resume_stimulator(rig: Rig) -> None:
    """Resume the process of the stimulator after 2 s, and wait for a heartbeat of the plate."""
    rig.cycle(_PAUSE_CYCLES)
    rig.bus.resume(rig.stimulator_port)
    hear_plate(rig)


def pause_plate(rig: Rig) -> None:
    """Stop the process of the plate for 2 s and resume it; cycles count from the resumption.

    A stopped process cannot set its own stage to 0 V.
    """
    assert rig.plate_port is not None
    rig.bus.pause(rig.plate_port)
    rig.cycle(_PAUSE_CYCLES)
    rig.bus.resume(rig.plate_port)


def pause_master(rig: Rig) -> None:
    """Stop heartbeat and SYNC of the master."""
    rig.heartbeat, rig.syncs = False, 0


def resume_master(rig: Rig) -> None:
    """Restart heartbeat and SYNC of the master."""
    rig.heartbeat, rig.syncs = True, 1


class _BrokenController:
    def __init__(self, cascade: Cascade, voltage: float) -> None:
        self.cascade = cascade
        self._voltage = voltage

    def __getattr__(self, name: str) -> Any:
        return getattr(self.cascade, name)

    def update(self, measurement: Measurement, setpoint: Setpoint) -> Drive:
        drive = self.cascade.update(measurement, setpoint)
        return Drive(self._voltage, drive.frequency)


def control_wrongly(voltage: float) -> Act:
    """Return an act after which the controllers always ask for this voltage in V."""

    def act(rig: Rig) -> None:
        block = rig.stimulator.block
        block.cascade = _BrokenController(block.cascade, voltage)  # type: ignore[assignment]

    return act


def control_rightly(rig: Rig) -> None:
    """Restore the original controllers."""
    block = rig.stimulator.block
    if isinstance(block.cascade, _BrokenController):
        block.cascade = block.cascade.cascade


def another_plate(serial: int) -> Act:
    """Return an act that sets another serial number of the plate."""

    def act(rig: Rig) -> None:
        rig.plate_block.od["Plate serial number"].value = serial

    return act


def lower_force_limit(rig: Rig) -> None:
    """Set a lateral limit well within the range of the gauges."""
    rig.write("Limit.Lateral force", 1000)


def limit_amplitude(nm: int) -> Act:
    """Return an act that sets the trip limit of the amplitude, in nm peak-to-peak.

    All modes but identification drive 0.6 um or more, so 100 nm trips. An identification has to be
    limited below 1500 nm, where it ends by itself.
    """
    return lambda rig: rig.write("Limit.Amplitude trip", nm)


def speak_as(can_id: int) -> Act:
    """Return an act that sends an empty frame with another node's identifier in each cycle."""
    return lambda rig: rig.each_cycle.append(Frame(can_id))


def offset_sometimes(sensor: int, value: int, off: int, period: int) -> Act:
    """Return an act after which a sensor has an offset in `off` of every `period` cycles."""
    wrong, none = Fault(FaultKind.OFFSET, sensor, value), Fault(FaultKind.NONE, sensor, 0)

    def act(rig: Rig) -> None:
        begin = rig.cycles + 1

        def break_or_mend() -> None:
            bad = (rig.cycles - begin) % period < off
            rig.plate_block.plate.inject(wrong if bad else none)

        rig.unsteady = break_or_mend

    return act


def fall_silent(rig: Rig) -> None:
    """Stop sending with another node's identifier, and wait until the node counts as gone."""
    rig.each_cycle.clear()
    rig.cycle(GONE_AFTER_US // TICK_US)


def send_setpoints(rig: Rig) -> None:
    """Send set-points in each cycle, and set a deadline for them at the stimulator."""
    timer = rig.od.entry(cia.RPDO_COMMUNICATION + _SETPOINT_RPDO - 1, cia.PDO_EVENT)
    rig.master.write(STIMULATOR_ID, timer, SETPOINT_DEADLINE_MS)
    rig.each_cycle.append(_SETPOINT_PDO)


def skip_syncs(rig: Rig) -> None:
    """Skip numbers of the SYNC counter."""
    rig.master.sync_counter += 5


def bus_off(rig: Rig) -> None:
    """Set the CAN controller of the stimulator bus-off."""
    rig.bus.bus_off(rig.stimulator_port)


def bus_recovered(rig: Rig) -> None:
    """Recover the CAN controller of the stimulator from bus-off."""
    rig.bus.bus_recovered(rig.stimulator_port)


def fill_queue(rig: Rig) -> None:
    """Block the transmit queue of the stimulator for some cycles, then send all its frames."""
    rig.bus.clog(rig.stimulator_port, _FULL_CYCLES)


def boot_again(rig: Rig) -> None:
    """Send a boot-up message of the master."""
    rig.master.send(Frame(cia.HEARTBEAT_ID + MASTER_ID, bytes(1)))


def hear_plate(rig: Rig) -> None:
    """End all frame faults, and wait for a heartbeat of the plate."""
    calm(rig)
    rig.cycle(PLATE_HEARTBEAT_MS + 1)


def connect_hardware(rig: Rig) -> None:
    """Connect hardware that supervises the power stage."""
    rig.hardware = StageHardware(rig)


def hardware(name: str, value: int) -> Act:
    """Return an act that sets an attribute of that hardware."""
    return lambda rig: setattr(rig.hardware, name, value)


DRIVING: Final = (
    Mode.OPEN_LOOP,
    Mode.AMPLITUDE,
    Mode.AMPLITUDE_RESONANCE,
    Mode.FRICTION,
    Mode.IDENTIFY,
    Mode.TEXTURE,
)
"""Modes with a voltage."""
TRACKED: Final = (Mode.AMPLITUDE_RESONANCE, Mode.FRICTION, Mode.TEXTURE)
"""Modes in which the frequency follows the resonance."""
REGULATED: Final = tuple(mode for mode in DRIVING if mode is not Mode.IDENTIFY)
"""Modes that do not end by themselves."""
RING_DOWN_CYCLES: Final = 3
"""Cycles until 5 % of the vibration is left: 3 time constants of the plate, 1 ms each."""
_PICKUPS: Final = (PICKUP, PICKUP_D, PICKUP_Q)


Shows = Callable[[Rig], bool]
"""Function that returns whether a fault can be detected in a cycle."""


def visible(volts: float = 20.0, up_to_N: float = inf) -> Shows:
    """Return a function that tells whether a fault is certain to be detected.

    Parameters
    ----------
    volts
        Least voltage of the stage. By default the lowest one at which every plate vibrates enough
        for the check. Below it, as in a pause of a friction loop, the detection is delayed.
    up_to_N
        Largest normal force in N. The damping or the friction of a finger that presses harder may
        explain the fault.
    """
    return lambda rig: rig.stage.si_value >= volts and rig.plate_block.plate.Fn <= up_to_N


class FaultCase(NamedTuple):
    """One fault."""

    name: str
    bound: int
    """Cycles from the injection to the detection."""
    watchdog: Watchdog | None
    """Watchdog that trips first; None if none does, as the stimulator restarts or is paused."""
    inject: Act
    remove: Act
    modes: tuple[Mode, ...] = DRIVING
    instead: Mapping[Mode, Watchdog] = MappingProxyType({})
    """Watchdogs that trip before `watchdog`, by mode, as their loops react differently."""
    prepare: Act | None = None
    """Act before the run that the fault requires."""
    plate_inside: bool = False
    forgets: bool = False
    """Whether the stimulator restarts, so that it obeys the master again without a fault reset."""
    deaf: bool = False
    """Whether a node cannot receive or act, so that it may drive until the plate detects it."""
    breaks_stage: bool = False
    """Whether the power stage ignores the commanded voltage."""
    breaks_controller: bool = False
    """Whether the controllers themselves are replaced."""
    cut_off: bool = False
    """Whether frames of the stimulator are lost with the bus."""
    shows: Shows | None = None
    """Function that tells whether the fault can be detected in a cycle; None if always."""
    adds_up: bool = True
    """Whether such cycles add up, as in a leaky bucket; otherwise they must be in a row."""
    hides_vibration: bool = False
    """Whether the pick-up is faulty, so that the plate may vibrate too much until detection."""

    detunes: bool = False
    """Whether it may detune a resonance loop, whose wrong phase then ends the run later."""
    through_loop: bool = False
    """Whether its course depends on the response of a running controller."""
    predictive: bool = False
    """Whether both laws are the predictive ones instead of those of the paper."""
    why: str = ""
    """Reason why another watchdog trips first than the name suggests."""
    uncovered: str = ""
    """Reason why no software can act; the bound then counts from where the node resumes."""

    def trips(self, mode: Mode) -> Watchdog | None:
        """Return the watchdog that trips first in a mode."""
        return self.instead.get(mode, self.watchdog)

    def way(self, mode: Mode) -> str:
        """Return the name of the way to drive: the mode, and `_predictive` for predictive laws."""
        return mode.name.lower() + ("_predictive" if self.predictive else "")


def broken(
    name: str,
    bound: int,
    watchdog: Watchdog,
    kind: FaultKind,
    sensor: int = 1,
    value: int = 0,
    **more: Any,
) -> FaultCase:
    """Return the case of a fault of the simulated plate; ``more`` are fields of `FaultCase`."""

    def inject(rig: Rig) -> None:
        rig.inject(kind, sensor, value)

    hides = kind in SENSOR_KINDS and sensor in _PICKUPS
    return FaultCase(
        name, bound, watchdog, inject, Rig.mend, hides_vibration=hides, through_loop=True, **more
    )


# Losses of gain of the pick-up: those that are detected, and those that are not.


_PER_MILLE: Final = 1000
_NAMES: Final = {PICKUP: "pick-up", PICKUP_D: "pick-up d", PICKUP_Q: "pick-up q"}
LACK_BOUND: Final = 2 * LACK_CYCLES + RING_DOWN_CYCLES
"""Pauses of a friction loop interrupt a lack of vibration, but at most double its cycles."""
_EXPLAINED_N: Final = 0.6
"""Normal force in N above which strong damping by a finger explains the reading of a pick-up at 0.4
under a finger that damps little."""
_FIXED: Final = (Mode.OPEN_LOOP, Mode.AMPLITUDE)
_BY_FRICTION: Final = (Mode.FRICTION,)
"""Mode of the case with half the gain. In other modes it is at the edge of detection: the cycles
beyond the bound add up in the end."""


def _weak(
    sensor: int,
    per_mille: int,
    modes: tuple[Mode, ...] = REGULATED,
    up_to_N: float = inf,
) -> FaultCase:
    name = f"{_NAMES[sensor]} at {per_mille / _PER_MILLE:g}"
    return broken(
        name, LACK_BOUND, Watchdog.PICKUP, FaultKind.GAIN, sensor, per_mille,
        modes=modes, shows=visible(up_to_N=up_to_N), detunes=sensor == PICKUP_D,
    )  # fmt: skip


_TOO_LITTLE: Final = (
    "the vibration is too small, and its watchdog has a shorter bound than the watchdog of the "
    "phase"
)


def _detuned(per_mille: int, instead: Mapping[Mode, Watchdog]) -> FaultCase:
    """Return the loss of one axis whose wrong phase detunes the resonance loop."""
    return broken(
        f"pick-up d at {per_mille / _PER_MILLE:g}, tracked", RESONANCE_CYCLES + LACK_BOUND,
        Watchdog.RESONANCE, FaultKind.GAIN, PICKUP_D, per_mille,
        modes=TRACKED, instead=instead, shows=visible(),
        why=_TOO_LITTLE if instead else "",
    )  # fmt: skip


WEAK_PICKUP: Final = (
    _weak(PICKUP, 50),
    _weak(PICKUP, 100),
    _weak(PICKUP, 200),
    _weak(PICKUP, 300),
    _weak(PICKUP, 400, up_to_N=_EXPLAINED_N),
    _weak(PICKUP_D, 50, _FIXED),
    _weak(PICKUP_D, 100, _FIXED),
    _weak(PICKUP_D, 200, _FIXED),
    _detuned(50, {Mode.FRICTION: Watchdog.PICKUP}),
    _detuned(100, {}),
    _detuned(200, {}),
    _weak(PICKUP_D, 300),
    _weak(PICKUP_D, 400, up_to_N=_EXPLAINED_N),
)
"""Losses of gain that end a run."""
NOT_SEEN: Final = (
    _weak(PICKUP, 500, _BY_FRICTION),
    *(_weak(PICKUP, per_mille) for per_mille in (600, 700, 800, 900)),
    _weak(PICKUP_D, 500, _BY_FRICTION),
    *(_weak(PICKUP_D, per_mille) for per_mille in (600, 700, 800, 900)),
    *(_weak(PICKUP_Q, per_mille) for per_mille in (50, 300, 600, 900)),
)
"""Losses of gain that no watchdog detects, because a finger of unknown damping explains them as
well, or because the vibration does not show them."""


MEASUREMENTS: Final = tuple(base + PLATE_ID for base in cia.TPDO_IDS[:3])
DRIVE: Final = cia.RPDO_IDS[0] + PLATE_ID
AT_ONCE: Final = 1
"""Bound of faults that are acted on in the cycle in which they are detected."""
PDO_DEADLINE_MS: Final = SHORT_DEADLINE_MS
"""Event timers in ms of the drive at the plate, and of the measurements at the stimulator."""
SYNC_IRREGULAR_CYCLES: Final = 2 * sync_window(PDO_DEADLINE_MS)
"""The window in which the fault begins may end too early to detect it; the next one does."""
ABOVE_LIMIT_CYCLES: Final = 2 * AMPLITUDE_CYCLES
"""At 0 V the vibration falls below its limit between the cycles that count; the loop comes back."""
HUNTING_CYCLES: Final = SILENT_CYCLES
"""While a loop reacts to a wrong pick-up, its excess comes and goes, but within this bound."""
READ_BACK_BOUND: Final = READ_BACK_CYCLES + 2
"""Both the reading and the voltage that it is compared with may be a cycle old."""
FORCE_PATH_CYCLES: Final = 6
"""Cycles until the flexure and the filter of 100 Hz show half of a sudden force, plus one."""


_BEYOND: Final = (
    "the force at the end of the range, minus the zero of the gauge, is above the limit of the "
    "normal force, which trips in one cycle"
)
_LATERAL: Final = "without a finger a lateral force contradicts the other gauges at once"
_DIAGONAL: Final = (
    "0 N contradicts the other three normal gauges before it has lasted for 24 cycles"
)
_MOVED: Final = (
    "the texture changes the vibration, but the reading of axis d stays constant, so the two "
    "contradict each other"
)
_BESIDE: Final = (
    "off the resonance an identification still reads a vibration on axis q, so the equal samples "
    "of axis d trip first"
)
_STAYS: Final = (
    "each reading at the end of the range makes the voltage 0 V, and such a vibration does not "
    "follow from 0 V (5213h). In these modes the voltage comes in pulses, so the vibration that "
    "the model computes falls more slowly, and the limit of the amplitude trips first"
)
_PULSED: Final = MappingProxyType(
    {Mode.FRICTION: Watchdog.AMPLITUDE, Mode.TEXTURE: Watchdog.AMPLITUDE}
)


_NO_FRICTION_N: Final = 0.4
"""Normal force in N up to which an error of 1.7 N of a lateral gauge cannot be friction.

The watchdog accepts a lateral force of twice the normal force plus 0.2 N: 1 N at 0.4 N. To hide the
error, friction would have to cancel 0.7 N of it, which needs a COF of 1.75; no simulated finger has
this."""


def _nmt(
    name: str, command: int, bound: int, *, of_plate: bool = False, inside: bool = False
) -> FaultCase:
    node_id = PLATE_ID if of_plate else STIMULATOR_ID
    watchdog = Watchdog.MEASUREMENT if of_plate else Watchdog.NMT

    def inject(rig: Rig) -> None:
        rig.nmt(command, node_id)

    return FaultCase(name, bound, watchdog, inject, nothing, plate_inside=inside)


def _disobeys(rig: Rig) -> bool:
    """Return whether the power stage puts out another voltage than commanded."""
    return abs(rig.plate_block.commanded - rig.stage.si_value) > STAGE_TOLERANCE


def _is_unanswered(rig: Rig) -> bool:
    """Return whether the measurement of this tick was refused; 1 in 256 corrupt ones is not."""
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
    """Return the failures that every sensor can have; `instead` and `why` are for a dead one."""
    beyond = {Watchdog.SATURATED: "", Watchdog.PICKUP: _STAYS}.get(saturated, _BEYOND)
    pulsed = _PULSED if saturated is Watchdog.PICKUP else {}
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
            instead=pulsed, why=beyond,
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
    # An identification ends before a heartbeat is late.
    FaultCase("heartbeat of the master lost", MASTER_LOST_MS, Watchdog.HEARTBEAT,
              put("heartbeat", False), put("heartbeat", True), REGULATED),
    FaultCase("heartbeat of the master lost, plate inside", MASTER_LOST_MS, Watchdog.HEARTBEAT,
              put("heartbeat", False), put("heartbeat", True), REGULATED,
              plate_inside=True),
    FaultCase("heartbeat of the plate lost", PLATE_LOST_MS, Watchdog.HEARTBEAT,
              disturb(FrameFault.LOSS, cia.HEARTBEAT_ID + PLATE_ID), hear_plate, REGULATED,
              prepare=hear_plate),
    FaultCase("master boots again", AT_ONCE, Watchdog.HEARTBEAT, boot_again, nothing),
    FaultCase("measurements lost", PDO_DEADLINE_MS, Watchdog.MEASUREMENT,
              disturb(FrameFault.LOSS, *MEASUREMENTS), calm, through_loop=True),
    FaultCase("drives lost", PDO_DEADLINE_MS, Watchdog.PLATE,
              disturb(FrameFault.LOSS, DRIVE), calm, through_loop=True),
    FaultCase("set-points lost", SETPOINT_DEADLINE_MS, Watchdog.SETPOINT,
              lambda rig: rig.each_cycle.clear(), send_setpoints, prepare=send_setpoints),
    FaultCase("SYNC lost", PDO_DEADLINE_MS, Watchdog.SYNC_LOST, put("syncs", 0),
              put("syncs", 1)),
    FaultCase("SYNC twice a cycle", SYNC_IRREGULAR_CYCLES, Watchdog.SYNC_IRREGULAR,
              put("syncs", 2), put("syncs", 1)),
    FaultCase("SYNC counter jumps", AT_ONCE, Watchdog.SYNC_COUNTER, skip_syncs, nothing,
              prepare=Rig.count_syncs),
    FaultCase("bus-off", PDO_DEADLINE_MS, Watchdog.BUS_OFF, bus_off, bus_recovered,
              cut_off=True),
    FaultCase("transmit queue full", PDO_DEADLINE_MS, Watchdog.TRANSMIT_QUEUE,
              fill_queue, nothing),
    FaultCase("controller asks for 999 V", AT_ONCE, Watchdog.VOLTAGE,
              control_wrongly(999.0), control_rightly, breaks_controller=True),
    FaultCase("controller gives NaN", AT_ONCE, Watchdog.CONTROLLER,
              control_wrongly(float("nan")), control_rightly, breaks_controller=True),
    FaultCase("another plate", AT_ONCE, Watchdog.CALIBRATION, another_plate(2),
              another_plate(1)),
    FaultCase("plate without a serial number", AT_ONCE, Watchdog.CALIBRATION,
              another_plate(0), another_plate(1)),
    FaultCase("another node speaks as the stimulator", AT_ONCE, Watchdog.DOUBLE,
              speak_as(cia.HEARTBEAT_ID + STIMULATOR_ID), fall_silent),
    FaultCase("another node speaks as the stimulator, plate inside", AT_ONCE, Watchdog.DOUBLE,
              speak_as(cia.HEARTBEAT_ID + STIMULATOR_ID), fall_silent, plate_inside=True),
    FaultCase("another node speaks as the plate", AT_ONCE, Watchdog.DOUBLE,
              speak_as(cia.HEARTBEAT_ID + PLATE_ID), fall_silent),
    FaultCase("another node sends drives", AT_ONCE, Watchdog.DOUBLE,
              speak_as(DRIVE), fall_silent),
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
                offset_sometimes(number, mN, off, period), Rig.mend, through_loop=True,
                shows=shows)
      for number, mN, off, period, bound, shows in
      ((1, 1700, 4, 5, 7, visible(0.0, _NO_FRICTION_N)), (3, 600, 4, 5, 7, None),
       (4, -600, 1, 2, 11, None), (6, 600, 1, 3, 16, None))),
    *_sensor("pick-up d", PICKUP_D, Watchdog.PICKUP, Watchdog.PICKUP,
             {Mode.IDENTIFY: Watchdog.STUCK}, _BESIDE),
    *_sensor("pick-up q", PICKUP_Q, Watchdog.STUCK, Watchdog.PICKUP),
    broken("S3 saturated, plate inside", SATURATED_CYCLES, Watchdog.NORMAL_FORCE,
            FaultKind.SATURATED, 3, plate_inside=True, why=_BEYOND),
    broken("pick-up reads too much", HUNTING_CYCLES, Watchdog.PICKUP,
            FaultKind.GAIN, PICKUP_D, 6000, modes=REGULATED, shows=visible(up_to_N=1.2)),
    *WEAK_PICKUP,
    broken("thermometer stuck", STUCK_THERMOMETER_CYCLES, Watchdog.STUCK,
            FaultKind.STUCK, THERMOMETER),
    broken("thermometer jumps", AT_ONCE, Watchdog.TEMPERATURE,
            FaultKind.OFFSET, THERMOMETER, 6000),
    broken("plate too hot", AT_ONCE, Watchdog.TEMPERATURE, FaultKind.TEMPERATURE, 1, 7500),
    broken("finger slams", FORCE_PATH_CYCLES, Watchdog.NORMAL_FORCE, FaultKind.SLAM, 1, 9000),
    broken("lateral force", AT_ONCE, Watchdog.LATERAL_FORCE,
            FaultKind.OFFSET, 1, 2000, prepare=lower_force_limit),
    broken("resonance out of reach", RING_DOWN_CYCLES + RESONANCE_CYCLES, Watchdog.RESONANCE,
            FaultKind.RESONANCE_SHIFT, 1, -1500, modes=TRACKED, shows=visible()),
    broken("plate cracked", RING_DOWN_CYCLES + SILENT_CYCLES, Watchdog.PICKUP,
            FaultKind.RESONANCE_SHIFT, 1, -9000, shows=visible(), adds_up=False),
    FaultCase("vibration above its limit", ABOVE_LIMIT_CYCLES, Watchdog.AMPLITUDE,
              limit_amplitude(100), limit_amplitude(3200),
              REGULATED, shows=visible(), through_loop=True),
    broken("vibration above its limit, identifying", AMPLITUDE_CYCLES, Watchdog.AMPLITUDE,
            FaultKind.OFFSET, PICKUP_D, 500, modes=(Mode.IDENTIFY,),
            prepare=limit_amplitude(1000)),
    broken("power stage stuck", AT_ONCE, Watchdog.STAGE,
            FaultKind.STAGE_STUCK, 1, 14_000, breaks_stage=True, shows=_disobeys,
            instead={Mode.IDENTIFY: Watchdog.PICKUP},
            why="140 V instead of 16 V cause more vibration than is allowed in an identification, "
            "so the stimulator commands 0 V. The simulated stage is stuck only at voltages above "
            "0 V, and puts out 0 V if commanded, so no later drive shows that it is stuck"),
    FaultCase("hardware takes its enable away", AT_ONCE, Watchdog.NOT_ENABLED,
              hardware("enable", 0), hardware("enable", 1), prepare=connect_hardware),
    FaultCase("hardware falls silent", PDO_DEADLINE_MS, Watchdog.NOT_ENABLED,
              hardware("speaks", False), hardware("speaks", True),
              prepare=connect_hardware),
    FaultCase("hardware reads 10 V more", READ_BACK_BOUND, Watchdog.STAGE,
              hardware("excess", 1000), hardware("excess", 0),
              prepare=connect_hardware),
    FaultCase("measurements two cycles late", PDO_DEADLINE_MS, Watchdog.MEASUREMENT,
              disturb(FrameFault.DELAY, *MEASUREMENTS, cycles=2), calm, through_loop=True),
    FaultCase("drives two cycles late", PDO_DEADLINE_MS, Watchdog.PLATE,
              disturb(FrameFault.DELAY, DRIVE, cycles=2), calm, through_loop=True),
    FaultCase("measurements swapped", PDO_DEADLINE_MS, Watchdog.MEASUREMENT,
              disturb(FrameFault.REORDERING, *MEASUREMENTS), calm, through_loop=True),
    FaultCase("drives corrupt", PDO_DEADLINE_MS, Watchdog.PLATE,
              disturb(FrameFault.CORRUPTION, DRIVE), calm),
    FaultCase("measurements corrupt", PDO_DEADLINE_MS, Watchdog.MEASUREMENT,
              disturb(FrameFault.CORRUPTION, *MEASUREMENTS), calm,
              shows=_is_unanswered, adds_up=False),
    FaultCase("a node babbles", PDO_DEADLINE_MS, Watchdog.MEASUREMENT,
              lambda rig: rig.bus.babble(8), lambda rig: rig.bus.babble(0)),
    FaultCase("stimulator restarts", PDO_DEADLINE_MS, None, restart_stimulator, nothing,
              forgets=True),
    FaultCase("stimulator restarts, plate inside", AT_ONCE, None, restart_stimulator,
              nothing,
              plate_inside=True, forgets=True),
    FaultCase("plate restarts", AT_ONCE, Watchdog.MEASUREMENT, restart_plate, nothing),
    FaultCase("clock of the stimulator jumps", AT_ONCE, Watchdog.SYNC_LOST,
              jump(plate=False), hear_plate),
    FaultCase("clock of the plate jumps", AT_ONCE, Watchdog.PLATE, jump(plate=True),
              nothing),
    FaultCase("clock of the stimulator stops", SYNC_IRREGULAR_CYCLES, Watchdog.SYNC_IRREGULAR,
              stop_clock, start_clock),
    FaultCase("stimulator paused for 2 s", PDO_DEADLINE_MS, None,
              pause_stimulator, resume_stimulator, deaf=True),
    FaultCase("plate paused for 2 s", AT_ONCE, Watchdog.MEASUREMENT,
              pause_plate, nothing, deaf=True,
              uncovered="a stopped process cannot set its stage to 0 V, even if hardware sends "
              "Enable = 0. The supply of the stage needs a contact that opens unless each "
              "cycle of the plate retriggers it"),
    FaultCase("master paused", PDO_DEADLINE_MS, Watchdog.SYNC_LOST, pause_master,
              resume_master),
)  # fmt: skip
"""Faults that have to end in 0 V."""

TOLERATED: Final[tuple[FaultCase, ...]] = (
    FaultCase("measurements twice", 0, None, disturb(FrameFault.DUPLICATION, *MEASUREMENTS),
              calm,
              through_loop=True),
    FaultCase("drives twice", 0, None, disturb(FrameFault.DUPLICATION, DRIVE), calm,
              through_loop=True),
    FaultCase("measurements late in their cycle", 0, None,
              disturb(FrameFault.DELAY, *MEASUREMENTS), calm, through_loop=True),
    FaultCase("a cycle of measurements lost", 0, None, lose(*MEASUREMENTS), nothing,
              through_loop=True),
    FaultCase("a drive lost", 0, None, lose(DRIVE), nothing, through_loop=True),
    FaultCase("a node babbles a little", 0, None,
              lambda rig: rig.bus.babble(2), lambda rig: rig.bus.babble(0), through_loop=True),
)  # fmt: skip
"""Faults that must not end a run."""

# Rows of the fault matrix: each fault with each way to drive in which it is injected.


Row = tuple[FaultCase, Mode]
_HUNTS = "the frequency oscillates, so the wrong phase does not last; the vibration is too small"
_FIRST: Final[Mapping[str, tuple[Watchdog, str]]] = {
    "pick-up d at 0.1, tracked": (Watchdog.PICKUP, _HUNTS),
    "pick-up d at 0.2, tracked": (Watchdog.PICKUP, _HUNTS),
}
"""Watchdog that trips first under the predictive laws, if another one than under the paper's, and
why."""


def _predicted(given: Sequence[FaultCase]) -> tuple[FaultCase, ...]:
    """Return the cases that depend on a controller, for mode FRICTION with predictive laws."""
    found = []
    for case in given:
        if not case.through_loop or Mode.FRICTION not in case.modes or case.plate_inside:
            continue
        watchdog, why = _FIRST.get(case.name, (case.trips(Mode.FRICTION), ""))
        instead = {} if watchdog is None else {Mode.FRICTION: watchdog}
        found.append(
            case._replace(modes=(Mode.FRICTION,), predictive=True, instead=instead, why=why)
        )
    return tuple(found)


PREDICTED: Final = _predicted(CASES)
"""Faults whose course depends on a controller, with the predictive laws."""
WAYS: Final = (*(mode.name.lower() for mode in DRIVING), PREDICTED[0].way(Mode.FRICTION))
"""Names of the ways to drive: the modes, and the predictive laws."""


def _rows(given: Sequence[FaultCase]) -> tuple[Row, ...]:
    return tuple((case, mode) for case in given for mode in case.modes)


_ADDS_UP: Final = frozenset({"pick-up at 0.5", "pick-up d at 0.5"})
"""Losses of gain that are detected with predictive laws. Half the gain is at the edge of detection;
with other laws the vibration drops to 0 in turns, which interrupts the cycles beyond the bound."""
ALL_NOT_SEEN: Final = _rows(
    (*NOT_SEEN, *_predicted([case for case in NOT_SEEN if case.name not in _ADDS_UP]))
)
"""Every fault that is not detected, with every mode."""
ALL_TOLERATED: Final = _rows((*TOLERATED, *_predicted(TOLERATED)))
"""Every fault that must not end a run, with every mode."""


def cases(faults: Sequence[str] = (), ways: Sequence[str] = ()) -> list[Row]:
    """Return every fault with every mode in which it is injected.

    Parameters
    ----------
    faults, ways
        Names of the faults and of the ways to drive that are kept; all if empty.

    Raises
    ------
    ValueError
        There is no such fault, or it is not injected in any of these ways.
    """
    known = {case.name for case in CASES}
    for name in faults:
        if name not in known:
            raise ValueError(f"fault {name!r} is none of {', '.join(sorted(known))}")
    chosen = [
        (case, mode)
        for case, mode in _rows((*CASES, *PREDICTED))
        if (not faults or case.name in faults) and (not ways or case.way(mode) in ways)
    ]
    found = {case.name for case, _ in chosen}
    absent = " or ".join(repr(name) for name in faults if name not in found)
    if absent or not chosen:
        what = f"fault {absent} is not" if absent else "no fault is"
        raise ValueError(f"{what} injected in mode {' or '.join(ways)}")
    return chosen

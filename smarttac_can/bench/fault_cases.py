"""Every fault of the fault matrix: how it comes, how it goes, and how soon it must be at 0 V."""

from __future__ import annotations

from collections.abc import Callable
from struct import pack
from typing import Any, Final, NamedTuple

from smarttac_can.bench.open_link import PLATE_ID, STIMULATOR_ID
from smarttac_can.bench.rig import (
    NODE_LOST_MS,
    Rig,
)
from smarttac_can.control.cascade import Cascade, Mode
from smarttac_can.device.frame import Frame
from smarttac_can.host.faulty_bus import Disturbance, Mishap
from smarttac_can.nodes.watchdogs import (
    AMPLITUDE_CYCLES,
    GAUGE_CYCLES,
    RESONANCE_CYCLES,
    SATURATED_CYCLES,
    SILENT_CYCLES,
    STUCK_GAUGE_CYCLES,
    STUCK_THERMOMETER_CYCLES,
    SYNC_WINDOW_CYCLES,
)
from smarttac_can.od.cia import (
    HEARTBEAT_ID,
    PDO_EVENT,
    RPDO_COMMUNICATION,
    RPDO_IDS,
    TPDO_IDS,
    NMTCommand,
)
from smarttac_can.plant.faults import PICKUP_D, PICKUP_Q, THERMOMETER, FaultKind
from smarttac_can.signals import Drive, Measurement, Setpoint

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
PDO_DEADLINE_MS: Final = 3
"""Event timers of the drive at the plate, and of the measurements at the stimulator."""
SETPOINT_DEADLINE_MS: Final = 5
FORCE_PATH_CYCLES: Final = 6
"""What flexure and filter of 100 Hz take to show half of a sudden force, and a cycle."""
RING_DOWN_CYCLES: Final = 3
"""Time constants of the plate, 1 ms each, until 5 % of its vibration is left."""
PAUSE_CYCLES: Final = 2000
_SETPOINT_RPDO: Final = 2
_SETPOINT_PDO: Final = Frame(
    RPDO_IDS[_SETPOINT_RPDO - 1] + STIMULATOR_ID, pack("<HI", 4000, 4_339_000)
)
"""Set-points of voltage and frequency, 40 V at the resonance."""

Act = Callable[[Rig], None]


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


def _nothing(rig: Rig) -> None:
    """The cause is gone already."""


def _mend(rig: Rig) -> None:
    rig.mend()


def _broken(
    name: str,
    bound: int,
    kind: FaultKind,
    sensor: int = 1,
    value: int = 0,
    modes: tuple[Mode, ...] = DRIVING,
    plate_inside: bool = False,
) -> FaultCase:
    def inject(rig: Rig) -> None:
        rig.inject(kind, sensor, value)

    return FaultCase(name, bound, inject, _mend, modes, plate_inside=plate_inside)


def _nmt(name: str, command: int, node_id: int, bound: int, inside: bool = False) -> FaultCase:
    return FaultCase(
        name, bound, lambda rig: rig.nmt(command, node_id), _nothing, plate_inside=inside
    )


def _set(name: str, value: object) -> Act:
    return lambda rig: setattr(rig, name, value)


def _befall(mishap: Mishap, *can_ids: int, share: float = 1.0, cycles: int = 1) -> Act:
    disturbance = Disturbance(mishap, frozenset(can_ids), share, cycles)
    return lambda rig: rig.bus.disturbances.append(disturbance)


def _lose(can_ids: tuple[int, ...]) -> Act:
    """Lose these frames of one cycle; a second in a row would be a fault."""

    def act(rig: Rig) -> None:
        _befall(Mishap.LOSS, *can_ids)(rig)
        rig.cycle()
        _calm(rig)

    return act


def _calm(rig: Rig) -> None:
    rig.bus.disturbances.clear()


def _jump(plate: bool) -> Act:
    def act(rig: Rig) -> None:
        port = rig.plate_port if plate else rig.stimulator_port
        assert port is not None
        rig.bus.jump(port, 2_000_000)

    return act


def _stop_clock(rig: Rig) -> None:
    rig.bus.stop_clock(rig.stimulator_port)


def _start_clock(rig: Rig) -> None:
    rig.bus.start_clock(rig.stimulator_port)


def _restart_stimulator(rig: Rig) -> None:
    rig.bus.power_off(rig.stimulator_port)
    rig.bus.power_on(rig.stimulator_port)


def _restart_plate(rig: Rig) -> None:
    assert rig.plate_port is not None
    rig.bus.power_off(rig.plate_port)
    rig.bus.power_on(rig.plate_port)


def _pause_stimulator(rig: Rig) -> None:
    rig.bus.pause(rig.stimulator_port)


def _resume_stimulator(rig: Rig) -> None:
    rig.cycle(PAUSE_CYCLES)
    rig.bus.resume(rig.stimulator_port)


def _pause_plate(rig: Rig) -> None:
    """For the plate in its process no time passes, so the pause is over when the count begins."""
    assert rig.plate_port is not None
    rig.bus.pause(rig.plate_port)
    rig.cycle(PAUSE_CYCLES)
    rig.bus.resume(rig.plate_port)


def _pause_master(rig: Rig) -> None:
    rig.heartbeat, rig.syncs = False, 0


def _resume_master(rig: Rig) -> None:
    rig.heartbeat, rig.syncs = True, 1


class _BrokenController:
    """A cascade whose drive has another voltage than it should."""

    def __init__(self, cascade: Cascade, voltage: float) -> None:
        self._cascade = cascade
        self._voltage = voltage

    def __getattr__(self, name: str) -> Any:
        return getattr(self._cascade, name)

    def update(self, measurement: Measurement, setpoint: Setpoint) -> Drive:
        drive = self._cascade.update(measurement, setpoint)
        return Drive(self._voltage, drive.frequency)


def _control_wrongly(voltage: float) -> Act:
    def act(rig: Rig) -> None:
        block = rig.stimulator.block
        block.cascade = _BrokenController(block.cascade, voltage)  # type: ignore[assignment]

    return act


def _control_rightly(rig: Rig) -> None:
    block = rig.stimulator.block
    if isinstance(block.cascade, _BrokenController):
        block.cascade = block.cascade._cascade


def _another_plate(serial: int) -> Act:
    def act(rig: Rig) -> None:
        rig.plate_block.od["Plate serial number"].value = serial

    return act


def _lower_force_limit(rig: Rig) -> None:
    """Have a lateral limit that lies well within the range of the gauges."""
    rig.write("Limit.Lateral force", 1000)


def _limit_amplitude(nm: int) -> Act:
    """A run at 0.6 um and more is above 100 nm; an identification ends itself from 1500 nm on."""
    return lambda rig: rig.write("Limit.Amplitude trip", nm)


def _send_setpoints(rig: Rig) -> None:
    """Have the master send set-points in each cycle, and the stimulator expect them."""
    timer = rig.od.entry(RPDO_COMMUNICATION + _SETPOINT_RPDO - 1, PDO_EVENT)
    rig.write_entry(STIMULATOR_ID, timer, SETPOINT_DEADLINE_MS)
    rig.each_cycle.append(_SETPOINT_PDO)


def _skip_syncs(rig: Rig) -> None:
    rig.sync_counter += 5


def _bus_off(rig: Rig) -> None:
    rig.bus.answer(rig.stimulator_port, rig.stimulator.bus_off())


def _bus_recovered(rig: Rig) -> None:
    rig.bus.answer(rig.stimulator_port, rig.stimulator.bus_recovered())


def _transmit_failed(rig: Rig) -> None:
    rig.bus.answer(rig.stimulator_port, rig.stimulator.transmit_failed())


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
    _nmt("NMT stop of the plate", NMTCommand.STOP, PLATE_ID, 1),
    _nmt("NMT reset of the plate", NMTCommand.RESET_NODE, PLATE_ID, 1),
    _nmt("NMT stop, plate inside", NMTCommand.STOP, STIMULATOR_ID, 1, inside=True),
    FaultCase(
        "heartbeat of the master lost", NODE_LOST_MS, _set("heartbeat", False),
        _set("heartbeat", True),
    ),
    FaultCase(
        "heartbeat of the master lost, plate inside", NODE_LOST_MS, _set("heartbeat", False),
        _set("heartbeat", True), plate_inside=True,
    ),
    FaultCase("heartbeat of the plate lost", NODE_LOST_MS,
              _befall(Mishap.LOSS, HEARTBEAT_ID + PLATE_ID), _calm),
    FaultCase(
        "measurements lost", PDO_DEADLINE_MS, _befall(Mishap.LOSS, *MEASUREMENTS), _calm
    ),
    FaultCase("drives lost", PDO_DEADLINE_MS, _befall(Mishap.LOSS, DRIVE), _calm),
    FaultCase(
        "set-points lost", SETPOINT_DEADLINE_MS, lambda rig: rig.each_cycle.clear(),
        _send_setpoints, prepare=_send_setpoints,
    ),
    FaultCase("SYNC lost", PDO_DEADLINE_MS, _set("syncs", 0), _set("syncs", 1)),
    FaultCase("SYNC twice a cycle", 2 * SYNC_WINDOW_CYCLES, _set("syncs", 2), _set("syncs", 1)),
    FaultCase("SYNC counter jumps", 1, _skip_syncs, _nothing, prepare=Rig.count_syncs),
    FaultCase("bus-off", 1, _bus_off, _bus_recovered),
    FaultCase("transmit queue full", 1, _transmit_failed, _nothing),
    FaultCase("controller asks for 999 V", 1, _control_wrongly(999.0), _control_rightly,
              breaks_controller=True),
    FaultCase("controller gives NaN", 1, _control_wrongly(float("nan")), _control_rightly,
              breaks_controller=True),
    FaultCase("another plate", 1, _another_plate(2), _another_plate(1)),
    FaultCase("plate without a serial number", 1, _another_plate(0), _another_plate(1)),
    *_gauges(),
    *_pickup(),
    _broken("S3 saturated, plate inside", SATURATED_CYCLES, FaultKind.SATURATED, 3,
            plate_inside=True),
    _broken("pick-up reads too much", SILENT_CYCLES, FaultKind.GAIN, PICKUP_D, 6000),
    _broken("thermometer stuck", STUCK_THERMOMETER_CYCLES, FaultKind.STUCK, THERMOMETER),
    _broken("thermometer jumps", 1, FaultKind.OFFSET, THERMOMETER, 6000),
    _broken("plate too hot", 1, FaultKind.TEMPERATURE, 1, 7500),
    _broken("finger slams", FORCE_PATH_CYCLES, FaultKind.SLAM, 1, 9000),
    _broken("lateral force", 1, FaultKind.OFFSET, 1, 2000)._replace(prepare=_lower_force_limit),
    _broken("resonance out of reach", RING_DOWN_CYCLES + RESONANCE_CYCLES,
            FaultKind.RESONANCE_SHIFT, 1, -1500, TRACKED),
    _broken("plate cracked", RING_DOWN_CYCLES + SILENT_CYCLES, FaultKind.RESONANCE_SHIFT, 1, -9000),
    FaultCase("vibration above its limit", AMPLITUDE_CYCLES, _limit_amplitude(100),
              _limit_amplitude(3200), tuple(mode for mode in DRIVING if mode is not Mode.IDENTIFY)),
    _broken("vibration above its limit, identifying", AMPLITUDE_CYCLES, FaultKind.OFFSET, PICKUP_D,
            500, (Mode.IDENTIFY,))._replace(prepare=_limit_amplitude(1000)),
    _broken("power stage stuck", AMPLITUDE_CYCLES, FaultKind.STAGE_STUCK, 1, 14_000)._replace(
        breaks_stage=True
    ),
    FaultCase("measurements two cycles late", 2 * PDO_DEADLINE_MS,
              _befall(Mishap.DELAY, *MEASUREMENTS, cycles=2), _calm),
    FaultCase("drives two cycles late", PDO_DEADLINE_MS,
              _befall(Mishap.DELAY, DRIVE, cycles=2), _calm),
    FaultCase("measurements swapped", PDO_DEADLINE_MS,
              _befall(Mishap.REORDERING, *MEASUREMENTS), _calm),
    FaultCase("drives corrupt", PDO_DEADLINE_MS, _befall(Mishap.CORRUPTION, DRIVE), _calm),
    FaultCase("measurements corrupt", PDO_DEADLINE_MS,
              _befall(Mishap.CORRUPTION, *MEASUREMENTS), _calm),
    FaultCase("a node babbles", 2 * PDO_DEADLINE_MS,
              lambda rig: rig.bus.babble(8), lambda rig: rig.bus.babble(0)),
    FaultCase("stimulator restarts", PDO_DEADLINE_MS, _restart_stimulator, _nothing, forgets=True),
    FaultCase("stimulator restarts, plate inside", 1, _restart_stimulator, _nothing,
              plate_inside=True, forgets=True),
    FaultCase("plate restarts", 1, _restart_plate, _nothing),
    FaultCase("clock of the stimulator jumps", 1, _jump(plate=False), _nothing),
    FaultCase("clock of the plate jumps", 1, _jump(plate=True), _nothing),
    FaultCase("clock of the stimulator stops", 2 * SYNC_WINDOW_CYCLES, _stop_clock, _start_clock),
    FaultCase("stimulator paused for 2 s", PDO_DEADLINE_MS, _pause_stimulator, _resume_stimulator,
              deaf=True),
    FaultCase("plate paused for 2 s", PDO_DEADLINE_MS, _pause_plate, _nothing, deaf=True),
    FaultCase("master paused", PDO_DEADLINE_MS, _pause_master, _resume_master),
)  # fmt: skip
"""Faults that have to end in 0 V."""

TOLERATED: Final[tuple[FaultCase, ...]] = (
    FaultCase("measurements twice", 0, _befall(Mishap.DUPLICATION, *MEASUREMENTS), _calm),
    FaultCase("drives twice", 0, _befall(Mishap.DUPLICATION, DRIVE), _calm),
    FaultCase("measurements late in their cycle", 0,
              _befall(Mishap.DELAY, *MEASUREMENTS), _calm),
    FaultCase("a cycle of measurements lost", 0, _lose(MEASUREMENTS), _nothing),
    FaultCase("a drive lost", 0, _lose((DRIVE,)), _nothing),
    FaultCase("a node babbles a little", 0,
              lambda rig: rig.bus.babble(2), lambda rig: rig.bus.babble(0)),
)  # fmt: skip
"""Faults that must not end a run."""

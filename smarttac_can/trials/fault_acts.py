"""How faults come and go: acts on a rig that runs."""

from __future__ import annotations

from collections.abc import Callable
from struct import pack
from typing import Any, Final

from smarttac_can.bench.simulation import STIMULATOR_ID
from smarttac_can.control.cascade import Cascade
from smarttac_can.device.device import GONE_AFTER_US
from smarttac_can.device.frame import Frame
from smarttac_can.host.faulty_bus import Disturbance, FrameFault
from smarttac_can.od.cia import HEARTBEAT_ID, PDO_EVENT, RPDO_COMMUNICATION, RPDO_IDS
from smarttac_can.plant.faults import Fault
from smarttac_can.trials.rig import MASTER_ID, PLATE_HEARTBEAT_MS, Rig, StageHardware
from smarttac_can.vocabulary.faults import FaultKind
from smarttac_can.vocabulary.signals import TICK_US, Drive, Measurement, Setpoint

SETPOINT_DEADLINE_MS: Final = 5
"""Event timer of the set-points at the stimulator, where the master sends them in each cycle."""
_PAUSE_CYCLES: Final = 2000
_FULL_CYCLES: Final = 20
_SETPOINT_RPDO: Final = 2
_SETPOINT_PDO: Final = Frame(
    RPDO_IDS[_SETPOINT_RPDO - 1] + STIMULATOR_ID, pack("<HI", 4000, 4_339_000)
)
"""Set-points of voltage and frequency, 40 V at the resonance."""

Act = Callable[[Rig], None]


def nothing(rig: Rig) -> None:
    """Do nothing: the cause of the fault is gone by itself."""


def put(name: str, value: object) -> Act:
    """Make an act that gives an attribute of the rig another value."""
    return lambda rig: setattr(rig, name, value)


def disturb(frame_fault: FrameFault, *can_ids: int, cycles: int = 1) -> Act:
    """Make an act after which a frame_fault happens to every frame with one of these CAN-IDs.

    It lasts until `calm`; ``cycles`` is how late a delayed frame is.
    """
    disturbance = Disturbance(frame_fault, frozenset(can_ids), cycles=cycles)
    return lambda rig: rig.bus.disturbances.append(disturbance)


def lose(*can_ids: int) -> Act:
    """Make an act that loses these frames in one cycle; in two in a row that would be a fault."""

    def act(rig: Rig) -> None:
        disturb(FrameFault.LOSS, *can_ids)(rig)
        rig.cycle()
        calm(rig)

    return act


def calm(rig: Rig) -> None:
    """End all frame faults on the bus."""
    rig.bus.disturbances.clear()


def jump(plate: bool) -> Act:
    """Make an act that puts the clock of a node forward by 2 s."""

    def act(rig: Rig) -> None:
        port = rig.plate_port if plate else rig.stimulator_port
        assert port is not None
        rig.bus.jump(port, _PAUSE_CYCLES * TICK_US)

    return act


def stop_clock(rig: Rig) -> None:
    """Stop the clock of the stimulator."""
    rig.bus.stop_clock(rig.stimulator_port)


def start_clock(rig: Rig) -> None:
    """Let the clock of the stimulator go on."""
    rig.bus.start_clock(rig.stimulator_port)


def restart_stimulator(rig: Rig) -> None:
    """Take the power from the stimulator and give it back."""
    rig.bus.power_off(rig.stimulator_port)
    rig.bus.power_on(rig.stimulator_port)


def restart_plate(rig: Rig) -> None:
    """Take the power from the plate and give it back."""
    assert rig.plate_port is not None
    rig.bus.power_off(rig.plate_port)
    rig.bus.power_on(rig.plate_port)


def pause_stimulator(rig: Rig) -> None:
    """Stop the process of the stimulator."""
    rig.bus.pause(rig.stimulator_port)


def resume_stimulator(rig: Rig) -> None:
    """Let the process of the stimulator go on, 2 s later, until it has heard the plate again."""
    rig.cycle(_PAUSE_CYCLES)
    rig.bus.resume(rig.stimulator_port)
    hear_plate(rig)


def pause_plate(rig: Rig) -> None:
    """Stop the process of the plate for 2 s, and let it go on: the first cycle counts from there.

    A plate that is stopped cannot put its own stage at 0 V.
    """
    assert rig.plate_port is not None
    rig.bus.pause(rig.plate_port)
    rig.cycle(_PAUSE_CYCLES)
    rig.bus.resume(rig.plate_port)


def pause_master(rig: Rig) -> None:
    """Stop heartbeat and SYNC of the master."""
    rig.heartbeat, rig.syncs = False, 0


def resume_master(rig: Rig) -> None:
    """Let heartbeat and SYNC of the master go on."""
    rig.heartbeat, rig.syncs = True, 1


class _BrokenController:
    """A cascade whose drive has another voltage than it should."""

    def __init__(self, cascade: Cascade, voltage: float) -> None:
        self.cascade = cascade
        self._voltage = voltage

    def __getattr__(self, name: str) -> Any:
        return getattr(self.cascade, name)

    def update(self, measurement: Measurement, setpoint: Setpoint) -> Drive:
        drive = self.cascade.update(measurement, setpoint)
        return Drive(self._voltage, drive.frequency)


def control_wrongly(voltage: float) -> Act:
    """Make an act after which the controllers ask for a voltage in V, whatever they see."""

    def act(rig: Rig) -> None:
        block = rig.stimulator.block
        block.cascade = _BrokenController(block.cascade, voltage)  # type: ignore[assignment]

    return act


def control_rightly(rig: Rig) -> None:
    """Put the right controllers back."""
    block = rig.stimulator.block
    if isinstance(block.cascade, _BrokenController):
        block.cascade = block.cascade.cascade


def another_plate(serial: int) -> Act:
    """Make an act that gives the plate another serial number."""

    def act(rig: Rig) -> None:
        rig.plate_block.od["Plate serial number"].value = serial

    return act


def lower_force_limit(rig: Rig) -> None:
    """Set a lateral limit that lies well within the range of the gauges."""
    rig.write("Limit.Lateral force", 1000)


def limit_amplitude(nm: int) -> Act:
    """Make an act that sets the limit at which the vibration trips, in nm peak-to-peak.

    100 nm is below what any mode but identification drives, 0.6 um and more. An identification has
    to be limited below 1500 nm, where it ends by itself.
    """
    return lambda rig: rig.write("Limit.Amplitude trip", nm)


def speak_as(can_id: int) -> Act:
    """Send empty frames with an identifier of another node."""
    return lambda rig: rig.each_cycle.append(Frame(can_id))


def offset_sometimes(sensor: int, value: int, off: int, period: int) -> Act:
    """Make an act after which a sensor is off by a value in `off` of `period` cycles."""
    wrong, none = Fault(FaultKind.OFFSET, sensor, value), Fault(FaultKind.NONE, sensor, 0)

    def act(rig: Rig) -> None:
        begin = rig.cycles + 1

        def break_or_mend() -> None:
            bad = (rig.cycles - begin) % period < off
            rig.plate_block.plate.inject(wrong if bad else none)

        rig.unsteady = break_or_mend

    return act


def fall_silent(rig: Rig) -> None:
    """End the frames sent for another node, and wait until they are forgotten."""
    rig.each_cycle.clear()
    rig.cycle(GONE_AFTER_US // TICK_US)


def send_setpoints(rig: Rig) -> None:
    """Send set-points of the master in each cycle, with a deadline for them in the stimulator."""
    timer = rig.od.entry(RPDO_COMMUNICATION + _SETPOINT_RPDO - 1, PDO_EVENT)
    rig.master.write(STIMULATOR_ID, timer, SETPOINT_DEADLINE_MS)
    rig.each_cycle.append(_SETPOINT_PDO)


def skip_syncs(rig: Rig) -> None:
    """Leave numbers out of the SYNC counter."""
    rig.master.sync_counter += 5


def bus_off(rig: Rig) -> None:
    """Take the CAN controller of the stimulator off the bus."""
    rig.bus.bus_off(rig.stimulator_port)


def bus_recovered(rig: Rig) -> None:
    """Put it on the bus again."""
    rig.bus.bus_recovered(rig.stimulator_port)


def fill_queue(rig: Rig) -> None:
    """Let the CAN controller of the stimulator take no frames for some cycles, then all."""
    rig.bus.clog(rig.stimulator_port, _FULL_CYCLES)


def boot_again(rig: Rig) -> None:
    """Send a boot-up message of the master."""
    rig.master.send(Frame(HEARTBEAT_ID + MASTER_ID, bytes(1)))


def hear_plate(rig: Rig) -> None:
    """Let no frames get lost, until a heartbeat of the plate has come."""
    calm(rig)
    rig.cycle(PLATE_HEARTBEAT_MS + 1)


def connect_hardware(rig: Rig) -> None:
    """Connect hardware that watches the power stage."""
    rig.hardware = StageHardware(rig)


def hardware(name: str, value: int) -> Act:
    """Make an act that gives an attribute of that hardware another value."""
    return lambda rig: setattr(rig.hardware, name, value)

"""Function block of the stimulator: its object dictionary on one side, the cascade on the other."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from smarttac_can.control.cascade import Cascade, Mode
from smarttac_can.control.parameters import CascadeParameters
from smarttac_can.control.tribometer import TARE_SAMPLES
from smarttac_can.nodes.analogue_input import AUTO_ZERO, ZERO
from smarttac_can.nodes.cyclic_watchdogs import CyclicWatchdogs
from smarttac_can.nodes.interlock import Interlock
from smarttac_can.nodes.loop_period import deadlines
from smarttac_can.nodes.plate_block import FAULT_KIND, START_RUN, PlateBlock
from smarttac_can.nodes.plate_link import MEASUREMENT_RPDOS
from smarttac_can.nodes.read_back import ReadBack
from smarttac_can.nodes.settings import (
    CALIBRATION,
    DESIGN,
    cascade_parameters,
    keep_model,
    plate_model,
)
from smarttac_can.nodes.state_machine import State
from smarttac_can.nodes.watchdogs import Watchdog
from smarttac_can.od.cia import Abort, AbortCode
from smarttac_can.od.dictionary import Entry, ObjectDictionary
from smarttac_can.od.scaling import Quantiser
from smarttac_can.plant.faults import FaultKind
from smarttac_can.signals import Drive, Measurement, Setpoint

SIMULATION: Final = ("Simulation", "Finger", "Fault")
"""Records that belong to the simulated plate."""
_MODEL: Final = "Model"
_ZERO: Final = "Gauge zero"

_MEASURED: Final = (
    ("Vibration.W_d", "Plate input.W_d"),
    ("Vibration.W_q", "Plate input.W_q"),
    ("Vibration.Tick", "Plate input.Tick"),
    ("Vibration.Saturation", "Plate input.Saturation"),
    ("Vibration.Temperature", "Plate input.Temperature"),
    *((f"Gauge.S{number}", f"Plate input.S{number}") for number in range(1, 7)),
    ("Vibration.Tick", "Plate input.Gauge tick"),
    ("Plate serial number", "Plate input.Plate serial number"),
)
_DRIVE: Final = tuple((f"Drive.{name}",) * 2 for name in ("Voltage", "Frequency", "Tick"))


class StimulatorBlock:
    """The nested controllers behind the objects of ``stimulator.eds``.

    Parameters
    ----------
    od
        Object dictionary of ``stimulator.eds``.
    plate
        The plate inside; None if it is a node of its own.

    Attributes
    ----------
    cascade
        The controllers, for tests and reports.
    interlock
        State machine and faults.
    """

    def __init__(self, od: ObjectDictionary, plate: PlateBlock | None = None) -> None:
        self.od = od
        self._plate = plate
        if plate is not None:
            self._measured = _pairs(plate.od, od, _MEASURED)
            self._driven = _pairs(od, plate.od, _DRIVE)
        self._input = [od[name] for _, name in _MEASURED]
        self._si = [entry.si for entry in self._input]
        late = deadlines(od, MEASUREMENT_RPDOS) if plate is None else []
        self._watchdogs = CyclicWatchdogs(od, late)
        self._setpoint_entries = [
            od[f"Setpoint.{name}"]
            for name in ("Voltage", "Frequency", "Amplitude", "COF left", "COF right", "Boundary")
        ]
        self._raw_setpoint: list[int] = []
        self._mode = od["Mode"]
        self._controlword = od["Controlword"]
        self._voltage = od["Drive.Voltage"]
        self._frequency = od["Drive.Frequency"]
        self._put_out = Quantiser([self._voltage, self._frequency])
        self._answered_tick = od["Drive.Tick"]
        self._zeros = [od[f"{_ZERO}.Zero of S{number}"] for number in range(1, 7)]
        self._tare_at_power_on = od["Tare at power-on"]
        self._cycles = od["Cycle.Cycles"]
        self._message = od["Message"]
        self._quality = od[f"{_MODEL}.Quality"]
        self._model_state = od[f"{_MODEL}.State"]
        self._progress = od[f"{_MODEL}.Progress"]
        self._read_back = ReadBack(od)
        self.interlock = Interlock(od, self.cut, self._read_back.show_state)
        self.start_run()

    @property
    def state(self) -> State:
        """State of the device."""
        return self.interlock.machine.state

    def reset(self) -> None:
        """Begin as after power-on: every object at its default, the plate's inside as well."""
        self.od.reset()
        self.power_on()

    def power_on(self) -> None:
        """Begin with the values that the objects have now, those of the simulation included."""
        if self._plate is not None:
            self._plate.od.reset()
            for entry in self.od:
                if entry.name.partition(".")[0] in SIMULATION:
                    self._plate.od[entry.name].value = entry.value
        self.interlock.restart()
        self._watchdogs.reset()
        self.start_run()

    def start_run(self) -> None:
        """Begin anew: controllers reset and off, tick 0 next; the plate inside is at rest.

        The first drive is 0 V, whatever is asked for.

        Of a plate node it is not known what it does: the watchdogs go on.
        """
        if self._plate is not None:
            self._plate.start_run()
            self.od[FAULT_KIND].value = FaultKind.NONE
            self._watchdogs.reset()
        self.cascade = Cascade(cascade_parameters(self.od), plate_model(self.od))
        self._restore_zeros()
        self._watchdogs.configure()
        self._new_model = False
        self._redesign: CascadeParameters | None = None
        self._begun = False
        self.interlock.tared = self.cascade.tribometer.tared
        self._awaits_tare = bool(self._tare_at_power_on.value) and not self.cascade.tribometer.tared
        self._read_back.reset()
        self.cut()
        self.interlock.start_run()

    def tick(self) -> None:
        """Have one cycle with the plate inside: it steps and samples, the controllers answer."""
        plate = self._plate
        assert plate is not None
        plate.cycle()
        for source, target in self._measured:
            target.value = source.value
        self.cycle()
        for source, target in self._driven:
            target.value = source.value
        plate.take_drive()

    def cycle(self) -> None:
        """Compute the drive that answers the measurement in the object dictionary."""
        cascade = self.cascade
        if self._redesign is not None:
            self._reconfigure(self._redesign)
        interlock = self.interlock
        running = interlock.machine.state is State.RUNNING
        mode = self._mode.value if running else Mode.OFF
        if mode != cascade.mode:
            cascade.set_mode(mode)
            self._message.value = cascade.reason
        counts = [entry.value for entry in self._input]
        W_d, W_q, _, _, temperature, s1, s2, s3, s4, s5, s6, _, _ = [
            count * si for count, si in zip(counts, self._si, strict=True)
        ]
        tick, saturation, serial = counts[2], counts[3], counts[12]
        W = complex(W_d, W_q)
        gauges = (s1, s2, s3, s4, s5, s6)
        measurement = Measurement(W, gauges, temperature, saturation)
        raw = [entry.value for entry in self._setpoint_entries]
        if raw != self._raw_setpoint:
            self._raw_setpoint = raw
            self._setpoint = Setpoint(*[entry.si_value for entry in self._setpoint_entries])
        drive = cascade.update(measurement, self._setpoint)
        if not self._begun and drive.voltage > 0.0:
            # A plate takes no voltage before it was told 0 V: the mode begins with the next cycle.
            mode = Mode.OFF
            cascade.set_mode(mode)
            drive = cascade.drive
        self._begun = True
        if self._awaits_tare and self._cycles.value >= TARE_SAMPLES and not interlock.tare_barred:
            self._tare()
        watchdogs = self._watchdogs
        sensors = (*counts[5:11], counts[0], counts[1], counts[4])
        faults = watchdogs.look(
            sensors, saturation, serial, mode, cascade, W, gauges, temperature
        ) | watchdogs.sound(drive, cascade)
        if running and mode not in (cascade.mode, Mode.IDENTIFY):
            # The cascade leaves a mode by itself at the end of an identification, or in doubt.
            faults |= 1 << Watchdog.CONTROLLER
        interlock.observe(faults)
        if interlock.machine.state is not State.RUNNING:
            cascade.drive = drive = Drive(0.0, self._safe_frequency(drive.frequency))
        watchdogs.drove(drive.voltage)
        self._put_out.write(drive)
        self._answered_tick.value = tick
        self._read_back.publish(cascade, measurement.W, temperature, saturation, tick)
        if mode == Mode.IDENTIFY:
            self._follow_identification()
        if running and mode != cascade.mode:
            self._mode.value = int(cascade.mode)
            if cascade.reason:
                self._message.value = cascade.reason

    def _safe_frequency(self, frequency: float) -> float:
        """Keep a frequency within the limits; for any other take the one put out last."""
        p = self.cascade.parameters
        return frequency if p.f_min <= frequency <= p.f_max else self._frequency.si_value

    def cut(self) -> None:
        """Turn the cascade off and put the drive at 0 V, now."""
        self._mode.value = Mode.OFF
        self.cascade.set_mode(Mode.OFF)
        self._voltage.value = 0
        self._read_back.show_off()
        if self._plate is not None:
            self._plate.switch_off()

    def take_controlword(self) -> None:
        """Obey the controlword that an RPDO has brought."""
        self.interlock.take_controlword()

    def write(self, name: str, raw: int) -> None:
        """Write a raw value to an object by name; raises `Abort` as an SDO write would."""
        entry = self.od[name]
        entry.check(raw)
        self.on_write(entry, raw)
        entry.value = raw

    def on_write(self, entry: Entry, value: int) -> None:
        """Act on a write before it is made.

        Raises
        ------
        Abort
            STATE for an auto-zero without 64 samples, zeros and calibration while armed or running
            or to hide a force that has latched a fault, simulation objects without the plate
            inside, or an illegal controlword; VALUE for a wrong signature, unknown bits of the
            controlword, or limits that contradict each other.
        """
        record = entry.name.partition(".")[0]
        if entry is self._controlword:
            self.interlock.command(value)
        elif entry.name == START_RUN:
            self.start_run()
        elif record in SIMULATION:
            if self._plate is not None:
                self._plate.write(entry.name, value)
            elif value != entry.value:
                raise Abort(AbortCode.STATE)
        elif entry.name in AUTO_ZERO:
            if value != ZERO:
                raise Abort(AbortCode.VALUE)
            if self.interlock.tare_barred:
                raise Abort(AbortCode.STATE)
            try:
                self._tare()
            except RuntimeError as error:
                raise Abort(AbortCode.STATE) from error
        elif record in (*DESIGN, _MODEL, _ZERO):
            barred = record in (CALIBRATION, _ZERO) and self.interlock.tare_barred
            if barred and value != entry.value:
                raise Abort(AbortCode.STATE)
            # Worked out here, between two cycles; the next one only takes it over.
            self._redesign = cascade_parameters(self.od, (entry, value))
            self._new_model |= record == _MODEL

    def _tare(self) -> None:
        zeros = self.cascade.tribometer.tare()
        self._awaits_tare = False
        for entry, zero in zip(self._zeros, zeros, strict=True):
            entry.value = entry.quantise(zero)
        # The zeros in force are those that can be read, and stored.
        self._restore_zeros()
        self.interlock.tared = True
        self.interlock.prepare()

    def _restore_zeros(self) -> None:
        s1, s2, s3, s4, s5, s6 = [entry.si_value for entry in self._zeros]
        # All zero is the default: a plate that was never tared.
        if any((s1, s2, s3, s4, s5, s6)):
            self.cascade.tribometer.offsets = (s1, s2, s3, s4, s5, s6)
            self.interlock.tared = True
            self._awaits_tare = False

    def _reconfigure(self, parameters: CascadeParameters) -> None:
        self._redesign = None
        self._watchdogs.configure()
        if self._new_model:
            self._new_model = False
            self.cascade.adopt(plate_model(self.od))
            self._show_quality()
        self.cascade.configure(parameters)
        self._restore_zeros()

    def _show_quality(self) -> None:
        self._quality.value = self._quality.quantise(self.cascade.model.quality)

    def _follow_identification(self) -> None:
        identification = self.cascade.identification
        if identification is None:
            return
        self._progress.value = int(100.0 * identification.progress)
        self._model_state.value = int(identification.state)
        if identification.model is not None:
            # The model in force is the one that can be read, and stored.
            self.cascade.adopt(keep_model(self.od, identification.model))
            self._watchdogs.configure()
            self._show_quality()


def _pairs(
    source: ObjectDictionary, target: ObjectDictionary, names: Sequence[tuple[str, str]]
) -> list[tuple[Entry, Entry]]:
    """Link entries as a TPDO and an RPDO would."""
    return [(source[one], target[other]) for one, other in names]

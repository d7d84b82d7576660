"""The simulated plate behind its objects: finger, faults and power stage."""

from __future__ import annotations

from typing import Final

from smarttac_can.od.cia import Abort, AbortCode
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.od.entry import Entry
from smarttac_can.plant.faults import Fault
from smarttac_can.plant.finger import Finger, Lifted, Stroke, Trajectory
from smarttac_can.plant.fitted import FITTED
from smarttac_can.plant.parameters import PlateParameters
from smarttac_can.plant.plate import Plate
from smarttac_can.plant.sensors import Weight
from smarttac_can.plant.stage import PowerStage
from smarttac_can.plant.subjects import SUBJECTS
from smarttac_can.vocabulary.fault_codes import FaultCode
from smarttac_can.vocabulary.faults import FaultKind
from smarttac_can.vocabulary.objects import FAULT_KIND, RECORDED, STROKE
from smarttac_can.vocabulary.signals import Drive, Measurement

_NEVER: Final = -1
_FINGERS: Final = (*SUBJECTS, *(fitted.subject for fitted in FITTED))
"""What *Simulation.Subject* numbers, from 1."""


class SimulatedPlate:
    """The plate of the records `SIMULATION`, which moves by samples alone.

    Parameters
    ----------
    od
        Object dictionary of ``plate.eds``.
    recording
        The finger of motion 2; without one, that motion is refused.

    Attributes
    ----------
    plate
        The plate of the present run.
    stage
        What the power stage puts out.
    cause, trouble
        None and nothing: a simulation is heard.
    """

    cause: FaultCode | None = None
    trouble = ""

    def __init__(self, od: ObjectDictionary, recording: Trajectory | None = None) -> None:
        self._od = od
        self._recording = recording
        self._of_weight = [
            od[f"Weight.{name}"] for name in ("Force x", "Force y", "Normal force", "Position")
        ]

    def start_run(self, stage: Drive) -> None:
        """Begin anew: a plate at rest at ambient temperature, with a drive of 0 V."""
        od = self._od
        self.plate = Plate(
            PlateParameters(),
            _FINGERS[od["Simulation.Subject"].value - 1],
            self.finger(),
            seed=od["Simulation.Seed"].value,
            ambient=od["Simulation.Ambient temperature"].si_value,
            dead_time=od["Simulation.Drive instant"].si_value,
        )
        self._put_weight({})
        od[FAULT_KIND].value = FaultKind.NONE
        self._fault_in = _NEVER
        self._power_stage = PowerStage()
        self._moving = False
        self._old = self.stage = stage

    def sample(self) -> Measurement:
        """Step from the tick before with the drive that came since, and sample the sensors."""
        self.move()
        return self.plate.sample()

    def move(self) -> None:
        """Step from the tick before with the drive that came since."""
        if self._fault_in >= 0:
            self._approach_fault()
        if self._moving:
            self.plate.step(self._old, self.stage)
            self._old = self.stage
        self._moving = True

    def put_out(self, drive: Drive) -> float:
        """Put a drive out from the end of the dead time on; return the voltage read back in V."""
        voltage = self._power_stage.put_out(drive.voltage)
        self.stage = drive if voltage == drive.voltage else Drive(voltage, drive.frequency)
        return voltage

    def switch_off(self, stage: Drive) -> None:
        """Put a drive of 0 V out, now."""
        self._old = stage
        self.stage = stage

    def insist(self) -> None:
        """Do nothing: at 0 V a simulated stage obeys."""

    def on_write(self, entry: Entry, value: int) -> None:
        """Act on a write before it is made.

        Raises
        ------
        Abort
            STATE for the recorded finger where there is no recording; VALUE for a fault that
            makes no sense.
        """
        if entry.name == FAULT_KIND:
            self._set_fault(FaultKind(value))
        elif entry.name == "Finger.Motion" and value == RECORDED and self._recording is None:
            raise Abort(AbortCode.STATE, f"{entry.name} {value}: no finger was recorded")
        elif entry in self._of_weight:
            self._put_weight({entry: value})

    def _put_weight(self, written: dict[Entry, int]) -> None:
        """Put on the weight that the objects describe, some with what is about to be written."""
        values = {entry: entry.value for entry in self._of_weight} | written
        self.plate.put(Weight(*(entry.si * value for entry, value in values.items())))

    def _set_fault(self, kind: FaultKind) -> None:
        """Take sensor, value and delay from the object dictionary; what was broken is mended."""
        od = self._od
        fault = Fault(kind, od["Fault.Sensor"].value, od["Fault.Value"].value)
        try:
            fault.require_sense()
        except ValueError as error:
            raise Abort(AbortCode.VALUE, f"{FAULT_KIND} {kind:d}: {error}") from error
        self._power_stage.stick(0.0)
        self.plate.inject(Fault(FaultKind.NONE, 1, 0))
        self._fault = fault
        self._fault_in = od["Fault.Delay in cycles"].value if kind else _NEVER

    def _approach_fault(self) -> None:
        """Break what is due to break before the coming step."""
        self._fault_in -= 1
        if self._fault_in >= 0:
            return
        if self._fault.kind is FaultKind.STAGE_STUCK:
            counts = self._fault.value * self._od["Drive.Voltage"].si
            self._power_stage.stick(float(counts) or self.stage.voltage)
            self.put_out(self.stage)
        else:
            self.plate.inject(self._fault)

    def finger(self) -> Finger:
        """Return the finger that the objects describe."""
        od = self._od
        motion = od["Finger.Motion"].value
        if motion == STROKE:
            return Stroke(
                od["Finger.Force"].si_value,
                od["Finger.Speed"].si_value,
                od["Finger.Range"].si_value,
                force_variation=od["Finger.Force variation"].si_value,
                speed_variation=od["Finger.Speed variation"].si_value,
                seed=od["Simulation.Seed"].value,
            )
        return self._recording if motion == RECORDED and self._recording else Lifted()

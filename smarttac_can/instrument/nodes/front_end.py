"""Connect real hardware in place of the simulated plate, and check every value it returns."""

from __future__ import annotations

from cmath import isfinite
from numbers import Complex, Integral, Real
from typing import Any, Final

from smarttac_can.canopen.od.cia import Abort, AbortCode
from smarttac_can.canopen.od.dictionary import ObjectDictionary
from smarttac_can.canopen.od.entry import Entry
from smarttac_can.vocabulary.faults import FaultCode
from smarttac_can.vocabulary.meanings import SIMULATION
from smarttac_can.vocabulary.model import require
from smarttac_can.vocabulary.plate import TimedPlate
from smarttac_can.vocabulary.signals import Drive, Measurement

STAGE_TOLERANCE: Final = 1.0
"""Largest difference in V between the commanded voltage of the power stage and its read-back."""
LATE_US: Final = 500
"""Longest time in us for a call. The other half of a tick is for frames and controllers."""
SILENT_CYCLES: Final = 2
"""Cycles in a row without a measurement in time before the fault; a single one is accepted. Single
ones do not add up here: the stimulator counts them in each second, as ticks without a cycle."""
SOUND_CYCLES: Final = 20
"""Sound cycles in a row after which a fault is cleared."""
UNKNOWN: Final = 1e9
"""Voltage of a stage whose output is unknown. Its object shows the largest possible value."""
_GAUGES: Final = 6
_LONGEST_SHOWN: Final = 200
_UNHEARD: Final = "has not been heard yet"


class FrontEnd:
    """Call a front end once per cycle, and check whether its power stage may have a voltage.

    Parameters
    ----------
    plate
        Front end, with the time that each call took.
    od
        Object dictionary of ``plate.eds``. Its limits apply to the measurements.

    Attributes
    ----------
    stage
        Output of the power stage, as far as it is known.
    trouble
        Reason for the fault, as it was at its beginning; empty without a fault.
    """

    def __init__(self, plate: TimedPlate, od: ObjectDictionary) -> None:
        self._plate = plate
        self._ranges = [
            (name, entry.low * entry.si, entry.high * entry.si)
            for name, entry in (
                *((name, od[f"Vibration.{name}"]) for name in ("W_d", "W_q", "Temperature")),
                *((f"S{number}", od[f"Gauge.S{number}"]) for number in range(1, _GAUGES + 1)),
            )
        ]
        saturation = od["Vibration.Saturation"]
        self._saturation = (int(saturation.low), int(saturation.high))

    def start_run(self, stage: Drive) -> None:
        """Restart at 0 V; no voltage is allowed before the first measurement."""
        self._last: Measurement | None = None
        self._silent = 0
        self._slowest = 0
        self.trouble = _UNHEARD
        self._sound_missing = 1
        self.switch_off(stage)

    def sample(self) -> Measurement | None:
        """Return the measurement of this tick; None if it is missing or not plausible."""
        try:
            measured = self._plate.sample()
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # noqa: BLE001 (a front end raises what it likes)
            self._doubt(f"sample() failed: {_shown(error)}")
            return None
        took = max(self._slowest, self._plate.took_us)
        self._slowest = 0
        if took > LATE_US:
            self._miss(f"a call took {took} us, longer than {LATE_US} us")
            return None
        if measured is None or measured is self._last:
            self._miss("sample() has nothing new")
            return None
        self._last = measured
        try:
            sound = self._checked(measured)
        except ValueError as error:
            self._doubt(f"sample() returned {error}")
            return None
        except Exception as error:  # noqa: BLE001 (and so does what it returns)
            self._doubt(f"what sample() returned failed: {_shown(error)}")
            return None
        self._silent = 0
        if self.trouble:
            self._sound_missing -= 1
            self.trouble = self.trouble if self._sound_missing else ""
        return sound

    def move(self) -> None:
        """Do nothing: hardware moves by itself."""

    def put_out(self, drive: Drive) -> float:
        """Command a drive; return the voltage in V that is read back, or `UNKNOWN`."""
        call = f"put_out() of {drive.voltage:g} V"
        voltage = UNKNOWN
        try:
            read_back = self._plate.put_out(drive)
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # noqa: BLE001 (a front end raises what it likes)
            self._doubt(f"{call} failed: {_shown(error)}")
        else:
            number = _finite(read_back, Real)
            if number is not None:
                voltage = number.real
            if not abs(voltage - drive.voltage) <= STAGE_TOLERANCE:
                self._doubt(
                    f"{call} returned {_shown(read_back)}, no number within {STAGE_TOLERANCE:g} V"
                )
        self._slowest = max(self._slowest, self._plate.took_us)
        self._commanded = drive.voltage
        self.stage = Drive(voltage, drive.frequency)
        return voltage

    def switch_off(self, stage: Drive) -> None:
        """Command a drive of 0 V."""
        self.put_out(stage)

    def repeat_zero(self) -> None:
        """Command 0 V again if the stage has not gone to 0 V."""
        if self._at_large:
            self.put_out(Drive(0.0, self.stage.frequency))

    @property
    def cause(self) -> FaultCode | None:
        """Fault code for which the stage has to stay at 0 V; None if there is no fault.

        NOT_ENABLED after two cycles in a row without a measurement in time, or after any other
        fault. STAGE while the stage does not go to 0 V.
        """
        if self._at_large:
            return FaultCode.STAGE
        return FaultCode.NOT_ENABLED if self.trouble else None

    @property
    def _at_large(self) -> bool:
        return self._commanded == 0.0 and abs(self.stage.voltage) > STAGE_TOLERANCE

    def on_write(self, entry: Entry, value: Any) -> None:
        """Refuse a write to an object of the simulation.

        Raises
        ------
        Abort
            STATE if the value differs from the present one.
        """
        if entry.name.partition(".")[0] in SIMULATION and value != entry.value:
            raise Abort(AbortCode.STATE, f"{entry.name} is of the simulation, and this is hardware")

    def _miss(self, trouble: str) -> None:
        """Tolerate one cycle without a measurement, but not two in a row."""
        self._silent += 1
        if self._silent >= SILENT_CYCLES:
            self._doubt(trouble)

    def _doubt(self, trouble: str) -> None:
        """Keep the stage at 0 V until the front end has been sound for `SOUND_CYCLES`."""
        self._sound_missing = SOUND_CYCLES
        if self.trouble in ("", _UNHEARD):
            self.trouble = trouble

    def _checked(self, measured: Any) -> Measurement:
        """Return a measurement as Python numbers; raise ValueError for an invalid one."""
        if not isinstance(measured, Measurement):
            raise ValueError(f"{_shown(measured)}, not a Measurement")
        W, gauges, temperature, saturated = measured
        vibration = _finite(W, Complex)
        if vibration is None:
            raise ValueError(f"W {_shown(W)}")
        if not (isinstance(gauges, tuple) and len(gauges) == _GAUGES):
            raise ValueError(f"gauges {_shown(gauges)}, not a tuple of {_GAUGES}")
        numbers = [vibration.real, vibration.imag]
        for value, (name, _, _) in zip((temperature, *gauges), self._ranges[2:], strict=True):
            number = _finite(value, Real)
            if number is None:
                raise ValueError(f"{name} {_shown(value)}")
            numbers.append(number.real)
        for real, (name, low, high) in zip(numbers, self._ranges, strict=True):
            require(name, real, low, high)
        none, every = self._saturation
        if not (isinstance(saturated, Integral) and none <= int(saturated) <= every):
            raise ValueError(f"saturated {_shown(saturated)}, no integer in {none}..{every}")
        _, _, celsius, s1, s2, s3, s4, s5, s6 = numbers
        return Measurement(vibration, (s1, s2, s3, s4, s5, s6), celsius, int(saturated))


def _finite(value: object, kind: type[Complex | Real]) -> complex | None:
    """Return a finite number of a kind, also of numpy; None for a bool and for any other value."""
    if not isinstance(value, kind) or isinstance(value, bool):
        return None
    try:
        number = complex(value)
    except OverflowError:  # an integer may be larger than any float
        return None
    return number if isfinite(number) else None


def _shown(value: object) -> str:
    """Return the repr of a value from a front end, limited to one line."""
    try:
        return repr(value)[:_LONGEST_SHOWN]
    except Exception:  # noqa: BLE001 (even this is code of the front end)
        return f"a {type(value).__name__} that cannot be shown"

"""A sweep of sensor failures: the effect of each one on the plate until something ends the run.

In each cell of the sweep one sensor fails in one of the ways of `FAILURES`, while the stimulator
drives the simulated plate inside it, in lockstep and without a bus. The stimulator is a black box
here. The results are about the true vibration of the plate, not the reading of its pick-up;
`PROMISES` gives its bounds.

A cell starts from rest: tare without a finger, arm, drive, and let the sensor fail at its onset.
Some cells begin with an identification. Either the sensor has failed already during it; or all
sensors are sound, and a device stores the model and the zeros and is powered on again. A device
keeps nothing from the cell before.
"""

from __future__ import annotations

import random
import re
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, fields, replace
from functools import cache
from hashlib import sha256
from math import cos, floor, pi, sin
from typing import Any, Final, NamedTuple

from smarttac_can.assurance.trials.rig import TARE_CYCLES, BlockRig, block_rig
from smarttac_can.canopen.od.cia import Abort
from smarttac_can.canopen.od.dictionary import ObjectDictionary
from smarttac_can.instrument.nodes.parameters import GAUGE_ZERO, MODEL
from smarttac_can.instrument.nodes.stimulator_block import StimulatorBlock
from smarttac_can.science.plant.faults import SOUND
from smarttac_can.science.plant.finger import Finger, FingerState, smooth
from smarttac_can.science.plant.parameters import (
    PlateParameters,
    ResonatorParameters,
    SensorParameters,
)
from smarttac_can.science.plant.plate import Plate
from smarttac_can.science.plant.subjects import SUBJECTS, Subject
from smarttac_can.vocabulary.meanings import AUTO_ZERO, START_RUN, ZERO
from smarttac_can.vocabulary.signals import PICKUP_SATURATED, TICK, Measurement
from smarttac_can.vocabulary.states import Control, Law, Mode, State, Status, VibrationLaw
from smarttac_can.vocabulary.textures import Axis, TextureTable
from smarttac_can.vocabulary.watchdogs import watchdogs_in

# --- Promises ----------------------------------------------------------------------------------


class Promise(NamedTuple):
    """Bounds of the true vibration while one sensor fails, for any 10 s of a run.

    What a fingertip bears is heat: 0.2 J warm 0.1 g of skin by 0.6 K, if all of it goes there. A
    plate of 40 degC may then still be touched for any time, which IEC 60601-1 allows to 43 degC.
    """

    bare_um: float = 3.27
    """Bound without contact in um peak-to-peak: the range of the pick-up."""
    touched_um: float = 5.0
    """Bound with contact in um peak-to-peak."""
    contact_N: float = 0.1
    """Normal force in N from which on the gauges show a contact."""
    model_share: float = 0.99
    """Least ratio of an identified gain to the true one, from its uncertainty of 1 %. The bound
    without contact is divided by it."""
    lowest_gain: float = 0.9
    """Least ratio of an identified gain to that of the data sheet that is accepted. It replaces
    `model_share` without an identification, or if the pick-up had failed before."""
    cycles: int = 20
    """Largest number of cycles above the bound in 10 s."""
    gauge_lag: int = 7
    """Additional cycles if a finger lands or lifts once, for flexure and filter of the gauges."""
    lift_cycles: int = 150
    """Additional cycles if it taps: what lifts may release in 10 s is 0.16 J, and a cycle above the
    bound is 1.05 mJ or more."""
    energy_J: float = 0.2
    """Largest energy dissipated in the plate in the cycles above the bound in 10 s."""
    peak_um: float = 9.0
    """Largest amplitude in um: a lift may release 8 um of a plate of `lowest_gain`."""


PROMISES: Final = Promise()


# --- Failures of a sensor ----------------------------------------------------------------------

PICKUP_SENSORS: Final = ("d", "q", "both")
GAUGE_SENSORS: Final = ("S1", "S2", "S3", "S4", "S5", "S6")
THERMOMETER: Final = "T"
SENSORS: Final = (*PICKUP_SENSORS, *GAUGE_SENSORS, THERMOMETER)
KINDS: Final = ("gain", "offset", "stuck", "noise", "delayed", "swapped")
"""Kinds of failure. The size of a gain is a factor. The size of offset, noise (standard deviation)
and stuck (noise on the held value) is in converter counts of 0.1 nm, 0.1 mN or 10 mK. The size of
delayed is in cycles."""


FORMS: Final = ("sine", "ramp", "step")
"""How the size of a failure changes with time: to and fro; once; at once after a while."""


class Failure(NamedTuple):
    """Failure of a sensor in the first `on` of every `of` cycles."""

    sensor: str
    kind: str
    size: float = 0.0
    on: int = 1
    of: int = 1
    to: float = 0.0
    """The other size of one that varies."""
    form: str = ""
    """How it varies, one of `FORMS`; empty for not at all."""
    over: int = 1
    """Cycles of a period, of a ramp, or until the step."""

    def __str__(self) -> str:
        varies = f">{self.to:g}:{self.form}:{self.over}" if self.form else ""
        sometimes = f":{self.on}/{self.of}" if self.of > 1 else ""
        return f"{self.sensor}:{self.kind}:{self.size:g}{varies}{sometimes}"

    def size_at(self, cycle: int) -> float:
        """Return the size so many cycles after the onset."""
        if not self.form:
            return self.size
        if self.form == "sine":
            share = 0.5 - 0.5 * cos(2.0 * pi * cycle / self.over)
        elif self.form == "ramp":
            share = min(cycle / self.over, 1.0)
        else:
            share = float(cycle >= self.over)
        return self.size + (self.to - self.size) * share

    @property
    def name(self) -> str:
        """Name of the row of a summary."""
        sensor = {"T": "thermometer"}.get(self.sensor, self.sensor)
        if self.sensor in PICKUP_SENSORS:
            sensor = f"pick-up {self.sensor}"
        elif self.sensor in GAUGE_SENSORS:
            sensor = "lateral gauge" if self.sensor in ("S1", "S2") else "normal gauge"
        kind = self.kind
        if kind == "gain":
            kind = "gain below 1" if self.size < 1.0 else "gain above 1"
        elif kind == "stuck" and self.size:
            kind = "stuck with noise"
        if self.form:
            kind = f"{self.kind} that varies"
        return f"{sensor}: {kind}{' now and then' if self.of > 1 else ''}"


_FAILURE: Final = re.compile(
    rf"({'|'.join(SENSORS)}):({'|'.join(KINDS)}):(-?[0-9.e+-]+)"
    rf"(?:>(-?[0-9.e+-]+):({'|'.join(FORMS)}):([1-9][0-9]*))?(?::([0-9]+)/([1-9][0-9]*))?"
)


def parse_failure(text: str) -> Failure:
    """Return the failure whose `str` is the text.

    Raises
    ------
    ValueError
        The text is no failure.
    """
    found = _FAILURE.fullmatch(text)
    if found is None:
        raise ValueError(
            f"failure {text!r} is not SENSOR:KIND:SIZE[>SIZE:FORM:CYCLES][:ON/OF], FORM one of "
            + ", ".join(FORMS)
        )
    sensor, kind, size, to, form, over, on, of = found.groups()
    return Failure(
        sensor, kind, float(size), int(on or 1), int(of or 1),
        float(to or 0.0), form or "", int(over or 1),
    )  # fmt: skip


GAINS: Final = (0.0, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.8, 1.2, 1.5, 2.0)
FINE_GAINS: Final = tuple(n / 20 for n in (*range(20), *range(21, 41)))
_SOMETIMES: Final = ((4, 5), (1, 2), (1, 5))


def failures(gains: Sequence[float] = GAINS) -> list[Failure]:
    """Return all failures of sensors, with these gains."""
    found = [Failure(axis, "gain", gain) for axis in PICKUP_SENSORS for gain in gains]
    for axis in ("d", "q"):
        found += [Failure(axis, "offset", size) for size in (-10000, -500, 500, 10000)]
        found += [Failure(axis, "stuck", size) for size in (0, 1, 5)]
        found += [Failure(axis, "noise", size) for size in (500, 5000)]
        found += [Failure(axis, "gain", 0.0, on, of) for on, of in _SOMETIMES]
        found += [Failure(axis, "delayed", size) for size in (1, 2, 5)]
    found += [Failure("both", "delayed", size) for size in (1, 2, 3, 4, 5)]
    found += [Failure("both", "swapped")]
    found += [Failure("both", "gain", 0.0, on, of) for on, of in _SOMETIMES]
    for gauge in GAUGE_SENSORS:
        found += [Failure(gauge, "gain", gain) for gain in (0.0, 0.5, 1.5, 2.0)]
        found += [Failure(gauge, "offset", size) for size in (-20000, -500, 500, 20000)]
        found += [Failure(gauge, "stuck", size) for size in (0, 1)]
        found += [Failure(gauge, "noise", 2000), Failure(gauge, "delayed", 5)]
        found += [Failure(gauge, "offset", 20000, on, of) for on, of in _SOMETIMES]
    found += [Failure(THERMOMETER, "gain", gain) for gain in (0.0, 0.5, 2.0)]
    found += [Failure(THERMOMETER, "offset", size) for size in (-2000, -100, 100, 2000)]
    found += [Failure(THERMOMETER, "stuck", size) for size in (0, 1)]
    found += [Failure(THERMOMETER, "noise", 200), Failure(THERMOMETER, "offset", 2000, 1, 2)]
    return found


_SENSORS: Final = SensorParameters()
_PLATE: Final = ResonatorParameters()


class FailingSensors:
    """The sensors of a plate, one of which fails from a tick on.

    A gain of the pick-up applies before its converter, every other failure to the converter counts.

    Parameters
    ----------
    failure
        Sensor that fails, and how.
    onset
        First tick in which it fails.
    seed
        Seed of the noise that a failure adds.
    """

    __slots__ = ("_draw", "_failure", "_held", "_onset", "_past", "_size")

    def __init__(self, failure: Failure, onset: int, seed: int) -> None:
        self._failure = failure
        self._onset = onset
        self._size = failure.size
        self._draw = random.Random(seed)
        self._held: dict[str, float] = {}
        self._past: deque[Measurement] = deque(
            maxlen=int(failure.size) + 1 if failure.kind == "delayed" else 1
        )

    def gains(self, tick: int) -> tuple[float, float]:
        """Return the gains of both axes of the pick-up, before their converters, at a tick."""
        sensor = self._failure.sensor
        if not (self._weakens and self._fails(tick)):
            return SOUND
        size = self._failure.size_at(tick - self._onset)
        return (1.0 if sensor == "q" else size, 1.0 if sensor == "d" else size)

    def measure(self, tick: int, sound: Measurement) -> Measurement:
        """Return the measurement at a tick; call it once for each tick, in order."""
        sensor, kind = self._failure[:2]
        self._size = self._failure.size_at(tick - self._onset)
        if kind == "delayed":
            self._past.append(sound)
        if self._weakens or not self._fails(tick):
            return sound
        W, gauges, temperature, saturated = sound
        if kind == "swapped":
            return sound._replace(W=complex(W.imag, W.real))
        if sensor == "both":
            return sound._replace(W=self._past[0].W)
        if sensor in GAUGE_SENSORS:
            number = int(sensor[1]) - 1
            count, ended = self._count(sensor, gauges[number], _SENSORS.gauge_resolution)
            changed = list(gauges)
            changed[number] = count * _SENSORS.gauge_resolution
            bit = 1 << number
            saturated = saturated & ~bit | (bit if ended else 0)
            s1, s2, s3, s4, s5, s6 = changed
            return sound._replace(gauges=(s1, s2, s3, s4, s5, s6), saturated=saturated)
        if sensor == THERMOMETER:
            step = _SENSORS.temperature_resolution
            return sound._replace(temperature=self._count(sensor, temperature, step)[0] * step)
        step = _SENSORS.pickup_resolution
        value = W.real if sensor == "d" else W.imag
        count, ended = self._count(sensor, value, step)
        W = complex(count * step, W.imag) if sensor == "d" else complex(W.real, count * step)
        return sound._replace(W=W, saturated=saturated | (PICKUP_SATURATED if ended else 0))

    @property
    def _weakens(self) -> bool:
        return self._failure.kind == "gain" and self._failure.sensor in PICKUP_SENSORS

    def _fails(self, tick: int) -> bool:
        since = tick - self._onset
        return since >= 0 and since % self._failure.of < self._failure.on

    def _count(self, sensor: str, si: float, step: float) -> tuple[int, bool]:
        """Return the count of a failed sensor, and whether it is at the end of the range."""
        kind, size = self._failure.kind, self._size
        count = si / step
        if kind == "gain":
            count *= size
        elif kind == "offset":
            count += size
        elif kind == "noise":
            count += self._draw.gauss(0.0, size)
        elif kind == "stuck":
            count = self._held.setdefault(sensor, count)
            if size:
                count += self._draw.gauss(0.0, size)
        elif kind == "delayed":
            past = self._past[0]
            if sensor in GAUGE_SENSORS:
                count = past.gauges[int(sensor[1]) - 1] / step
            else:
                count = (past.W.real if sensor == "d" else past.W.imag) / step
        whole, limit = floor(count + 0.5), _SENSORS.full_scale
        return max(-limit, min(limit, whole)), abs(whole) >= limit


# --- A cell ------------------------------------------------------------------------------------

LEAST_DAMPING, MOST_DAMPING = 5.0, 14.0
"""Least and largest damping in N s/m that a finger of 0.5 N adds, of all simulated fingertips."""
MOTIONS: Final = ("none", "holding", "landing", "lifting")
TAPPING: Final = "tapping"
ONSETS: Final = ("before", "steady", "step")
IDENTIFIED: Final = ("no", "sound", "failed")
"""Whether the plate was identified; `failed`: with the sensor already failed."""
DRIVING: Final = tuple(mode for mode in Mode if mode is not Mode.OFF)
TUNED: Final = (Mode.OPEN_LOOP, Mode.AMPLITUDE)
"""Modes with the frequency of the set-point."""
BY_FRICTION: Final = (Mode.FRICTION, Mode.TEXTURE)


@dataclass(frozen=True, slots=True)
class Cell:
    """One run of the sweep."""

    failure: str = "d:gain:0.05"
    onset: str = "steady"
    mode: str = "AMPLITUDE"
    law: str = "PI"
    """Name of the vibration law."""
    friction: str = "MEASURED"
    """Name of the friction law."""
    detuning: float = 0.0
    """Frequency of the set-point minus the resonance at 20 degC, in Hz."""
    setpoint: float = 3.0
    """Amplitude in um. In open loop the set-point is the voltage that makes this amplitude at the
    resonance; in friction modes it is the amplitude without a finger."""
    cof: float = 0.3
    """Lower reference of the COF; the upper one is 0.1 more."""
    motion: str = "none"
    force: float = 0.5
    """Normal force in N."""
    damping: float = 8.0
    """Damping in N s/m that the finger adds at 0.5 N."""
    dead_time: int = 0
    """Time from the tick until a drive is in force, in us."""
    identified: str = "no"
    ambient: float = 20.0
    """Temperature of plate and environment in degC."""
    softening: float = 0.0
    """Fall of the resonance with the amplitude in Hz/um."""
    cycles: int = 300
    """Number of cycles after the onset."""
    seed: int = 1
    period: float = 0.5
    """Time in s from tap to tap."""
    touch: float = 0.6
    """Fraction of this time from the landing to the lift."""
    lift: float = 5.0
    """Duration of a lift in ms."""

    def __str__(self) -> str:
        return ",".join(
            f"{field.name}={value:g}" if isinstance(value, float) else f"{field.name}={value}"
            for field in fields(self)
            if (value := getattr(self, field.name)) != field.default
            or field.name in ("failure", "mode")
        )


def parse_cell(text: str) -> Cell:
    """Return the cell whose `str` is the text: NAME=VALUE, separated by commas.

    Raises
    ------
    ValueError
        The text is no cell.
    """
    chosen: dict[str, Any] = {}
    kinds: dict[str, Callable[[str], Any]] = {
        name: type(value) for name, value in asdict(Cell()).items()
    }
    for part in text.split(","):
        name, equals, value = part.partition("=")
        if not equals or name not in kinds:
            raise ValueError(f"{part!r} is not NAME=VALUE with one of {', '.join(kinds)}")
        try:
            chosen[name] = kinds[name](value)
        except ValueError:
            raise ValueError(f"{name} {value!r} is no number") from None
    cell = Cell(**chosen)
    parse_failure(cell.failure)
    for name, value, known in (
        ("onset", cell.onset, ONSETS),
        ("mode", cell.mode, [mode.name for mode in DRIVING]),
        ("law", cell.law, [law.name for law in VibrationLaw]),
        ("friction", cell.friction, [law.name for law in Law]),
        ("motion", cell.motion, (*MOTIONS, TAPPING)),
        ("identified", cell.identified, IDENTIFIED),
    ):
        if value not in known:
            raise ValueError(f"{name} {value!r} is none of {', '.join(known)}")
    return cell


@dataclass(frozen=True, slots=True)
class Result:
    """Result of a cell."""

    cell: str
    failure: str
    """Name of the failure mode."""
    ended_by: str
    """Watchdogs that tripped first, joined by +; empty if nothing ended the run."""
    after: int
    """Cycles until the fault, from the onset or from the first drive, whichever is later. Below 0
    for a fault before that, 0 without a fault."""
    peak_um: float
    """Largest true amplitude in um peak-to-peak."""
    in_a_row: int
    """Most cycles in a row with a true amplitude above the bound."""
    above: int
    """Number of all cycles with a true amplitude above the bound."""
    energy_J: float
    """Energy dissipated in the plate in these cycles."""
    limited: int
    """Cycles with the status bit LIMITED."""
    cof_error: float
    """Mean true error of the COF under a sliding finger, from the onset on."""
    violation: str = ""
    """Promise that the cell breaks, and how; empty for none."""


_FIRST_DRIVE: Final = TARE_CYCLES + 4
_STEADY: Final = _FIRST_DRIVE + 120
NOT_ARMED: Final = "not armed"
"""End of a cell that never drove, as the failure was detected before."""
_RING: Final = 10
"""Cycles after the end of a run in which the plate still vibrates."""
_IDENTIFY_CYCLES: Final = 2500
_PRESS: Final = 20e-3
_LIFT: Final = 5e-3
_LOW: Final = 0.2
"""Set-point before a step, as a fraction of that after it."""
_STROKE, _OMEGA = 12e-3, 2.0 * pi * 0.8
_SLIDING: Final = 0.5


class CellFinger:
    """A finger that slides to and fro, lands once, and may lift.

    Parameters
    ----------
    force
        Normal force in N.
    lands, lifts
        Times in s at which the finger lands and lifts; None for never.
    """

    __slots__ = ("_force", "_lands", "_lifts")

    def __init__(self, force: float, lands: float | None, lifts: float | None) -> None:
        self._force = force
        self._lands = lands
        self._lifts = lifts

    def at(self, time: float) -> FingerState:
        """Return the state at a time in s from the start of the run."""
        Fn = 0.0 if self._lands is None else self._force * smooth((time - self._lands) / _PRESS)
        if self._lifts is not None:
            Fn *= 1.0 - smooth((time - self._lifts) / _LIFT)
        return FingerState(_STROKE * sin(_OMEGA * time), Fn)


class TappingFinger:
    """A finger that slides to and fro, and taps.

    Parameters
    ----------
    cell
        Cell with force, period, touch and lift.
    lands
        Time in s at which it lands first.
    """

    __slots__ = ("_cell", "_lands", "_lift", "_press")

    def __init__(self, cell: Cell, lands: float) -> None:
        self._cell = cell
        self._lands = lands
        self._press = min(_PRESS, 0.3 * cell.touch * cell.period)
        self._lift = min(1e-3 * cell.lift, 0.9 * (1.0 - cell.touch) * cell.period)

    def at(self, time: float) -> FingerState:
        """Return the state at a time in s from the start of the run."""
        cell, Fn = self._cell, 0.0
        if time > self._lands:
            since = (time - self._lands) % cell.period
            Fn = cell.force * smooth(since / self._press)
            Fn *= 1.0 - smooth((since - cell.touch * cell.period) / self._lift)
        return FingerState(_STROKE * sin(_OMEGA * time), Fn)


_LIFTED: Final = CellFinger(0.0, None, None)
_TEXTURE: Final = "Texture table.Table 1"


@cache
def _plate(softening: float) -> PlateParameters:
    return PlateParameters(resonator=ResonatorParameters(softening=1e6 * softening))


@cache
def _subject(damping: float) -> Subject:
    return replace(SUBJECTS[1], load_damping=damping)


_STORED: Final = (MODEL, GAUGE_ZERO)
"""Records that an identification, and the tare before it, store."""


def _stored(od: ObjectDictionary) -> dict[str, Any]:
    """Return the values that the present identification would store."""
    return {
        entry.name: entry.value
        for entry in od
        if entry.writable and entry.name.partition(".")[0] in _STORED
    }


def _begin(rig: BlockRig, cell: Cell, finger: Finger, failure: Failure, onset: int) -> None:
    """Start a run, and tare without a finger."""
    write = rig.block.write
    low = round(cell.cof * 1e4)
    grating = TextureTable(
        Axis.POSITION, repeats=True, start=0, step=100_000,
        values=(low,) * 10 + (low + 1000,) * 10,
    )  # fmt: skip
    frequency = _PLATE.f0 + cell.detuning
    for name, raw in (
        (_TEXTURE, grating.pack()),
        ("Controller.Vibration law", VibrationLaw[cell.law]),
        ("Friction law", Law[cell.friction]),
        ("Controller.Dead time", cell.dead_time),
        ("Simulation.Drive instant", cell.dead_time),
        ("Setpoint.Frequency", round(frequency * 100.0)),
        ("Setpoint.COF left", low),
        ("Setpoint.COF right", low + 1000),
    ):
        write(name, raw)
    write(START_RUN, 1)
    rig.simulate(Plate(
        _plate(cell.softening), _subject(cell.damping), finger, ambient=cell.ambient,
        dead_time=cell.dead_time * 1e-6, seed=cell.seed,
        failing=FailingSensors(failure, onset, cell.seed),
    ))  # fmt: skip
    rig.tick(TARE_CYCLES)
    with suppress(Abort):  # a gauge that has failed prevents its tare
        write(AUTO_ZERO[0], ZERO)
    rig.tick(_FIRST_DRIVE - TARE_CYCLES - 1)


def _end(block: StimulatorBlock) -> None:
    """Disarm, and reset a fault without a failing sensor."""
    block.write("Controlword", 0)
    if block.state is State.FAULT:
        block.write(START_RUN, 1)
        block.tick()
        block.write("Controlword", Control.FAULT_RESET)
        block.write("Controlword", 0)


def _ask(block: StimulatorBlock, cell: Cell, share: float) -> None:
    """Write a fraction of the set-point of the cell."""
    um = cell.setpoint * share
    block.write("Setpoint.Amplitude", round(um * 1e3))
    block.write("Setpoint.Voltage", min(round(um * 1e-6 / _PLATE.gain * 100.0), 20000))


def _identify(rig: BlockRig, cell: Cell, failure: Failure, onset: int) -> None:
    """Identify the plate without a finger; the result stays in force."""
    _begin(rig, cell, _LIFTED, failure, onset)
    with suppress(Abort):  # a sensor that has failed prevents it
        rig.identify(_IDENTIFY_CYCLES)
    _end(rig.block)


_NEVER: Final = 1 << 40


@cache
def _identification(dead_time: int, softening: float) -> dict[str, Any]:
    """Return the stored values of a plate that was identified with sound sensors."""
    rig = block_rig()
    rig.power_on({})
    sound = Cell(dead_time=dead_time, softening=softening)
    _identify(rig, sound, parse_failure(sound.failure), _NEVER)
    return _stored(rig.od)


def run_cell(cell: Cell) -> Result:
    """Run a cell and return its result."""
    failure = parse_failure(cell.failure)
    mode = Mode[cell.mode]
    sound = cell.identified == "sound" and mode is not Mode.IDENTIFY
    stored = _identification(cell.dead_time, cell.softening) if sound else {}
    rig = block_rig()
    rig.power_on(stored)
    onset = wrong_from = 0 if cell.onset == "before" else _STEADY
    if cell.identified == "failed":
        before = rig.block.cascade.model
        _identify(rig, cell, failure, 0)
        if rig.block.cascade.model != before:
            wrong_from = 0  # The device has believed the failed sensor.
    lands = None if cell.motion == "none" else (_FIRST_DRIVE + 10) * TICK
    lifts = None
    reference = max(onset, _FIRST_DRIVE)
    if cell.motion == "landing":
        lands = (reference + 60) * TICK
    elif cell.motion == "lifting":
        lifts = (reference + 100) * TICK
    finger: Finger = CellFinger(cell.force, lands, lifts)
    if cell.motion == TAPPING:
        finger = TappingFinger(cell, (_FIRST_DRIVE + 10) * TICK)
    _begin(rig, cell, finger, failure, onset)
    return _watched(cell, failure, rig, (wrong_from, reference))


def bounds(cell: Cell) -> tuple[float, float]:
    """Return the bounds of the true amplitude in m, without and with contact."""
    sound = cell.identified == "sound" and cell.mode != Mode.IDENTIFY.name
    share = PROMISES.model_share if sound else PROMISES.lowest_gain
    return PROMISES.bare_um * 1e-6 / share, PROMISES.touched_um * 1e-6


class _Meter:
    """Running figures of the true vibration.

    Parameters
    ----------
    plate
        Plate whose vibration is measured.
    bare, touched
        Bounds of the amplitude in m without and with contact.
    """

    def __init__(self, plate: Plate, bare: float, touched: float) -> None:
        self._plate = plate
        self._bare, self._touched = bare, touched
        self.peak = self._square = 0.0
        self.above = self._row = self.in_a_row = 0

    def look(self) -> None:
        """Update the figures after a cycle."""
        plate = self._plate
        W = abs(plate.W)
        self.peak = max(self.peak, W)
        if self._bare < W and (plate.Fn <= PROMISES.contact_N or self._touched < W):
            self._square += W * W
            self.above += 1
            self._row += 1
            self.in_a_row = max(self.in_a_row, self._row)
        else:
            self._row = 0

    @property
    def energy(self) -> float:
        """Energy in J that the bare plate dissipates in the cycles above the bound."""
        velocity = pi * _PLATE.f0
        return 0.5 * _PLATE.damping * velocity * velocity * self._square * TICK


def _watched(cell: Cell, failure: Failure, rig: BlockRig, ticks: tuple[int, int]) -> Result:
    """Drive, and return the result.

    ``ticks`` are the tick from which the sensor, or the model in force, is wrong, and the tick from
    which cycles count.
    """
    wrong_from, reference = ticks
    block, tick = rig.block, rig.block.tick
    plate, supervisor = rig.plate_block.plate, block.supervisor
    meter = _Meter(plate, *bounds(cell))
    look = meter.look
    steps = cell.onset == "step"
    _ask(block, cell, _LOW if steps else 1.0)
    block.write("Mode", Mode[cell.mode])
    ended, after = "", 0
    last = reference + cell.cycles
    try:
        rig.arm()
    except Abort:  # a sensor that has failed prevents it
        block.write("Mode", Mode.OFF)
        ended, after, last = NOT_ARMED, 0, _FIRST_DRIVE + _RING
    status, bit = block.od["Statusword"], int(Status.LIMITED)
    limited = 0
    errors: list[float] = []
    while plate.tick < last:
        if steps and plate.tick == reference:
            _ask(block, cell, 1.0)
        tick()
        look()
        limited += bool(status.value & bit)
        mu_ref = block.cascade.mu_ref
        if mu_ref and plate.tick > reference and _slides(plate):
            errors.append(abs(plate.mu_true - mu_ref))
        if not ended and supervisor.latched:
            ended = "+".join(w.name for w in watchdogs_in(supervisor.latched))
            after = plate.tick - reference
            last = min(last, plate.tick + _RING)
    _end(block)
    result = Result(
        str(cell), failure.name, ended, after, round(meter.peak * 1e6, 3), meter.in_a_row,
        meter.above, round(meter.energy, 4), limited,
        round(sum(errors) / len(errors), 4) if errors else 0.0,
    )  # fmt: skip
    violation = broken_promise(cell, result)
    if ended and reference + after < wrong_from:
        violation = f"{ended} tripped {-after} cycles before the failure: a false trip"
    return replace(result, violation=violation)


def _slides(plate: Plate) -> bool:
    return plate.Fn > PROMISES.contact_N and abs(cos(_OMEGA * plate.tick * TICK)) > _SLIDING


def broken_promise(cell: Cell, result: Result) -> str:
    """Return the promise that a cell breaks, and how; empty for none."""
    most = PROMISES.cycles
    if cell.motion in ("landing", "lifting"):
        most += PROMISES.gauge_lag
    elif cell.motion == TAPPING:
        most += PROMISES.lift_cycles
    bare, touched = bounds(cell)
    where = f"{bare * 1e6:.2f} um without contact, {touched * 1e6:.2f} um with it"
    if result.above > most:
        return f"{result.above} cycles above {where}; {most} are promised"
    if result.energy_J > PROMISES.energy_J:
        return f"{result.energy_J:g} J above {where}; {PROMISES.energy_J:g} J are promised"
    if result.peak_um > PROMISES.peak_um:
        return f"{result.peak_um:g} um; {PROMISES.peak_um:g} um are promised"
    return ""


# --- Choice of cells ---------------------------------------------------------------------------

_DETUNINGS: Final = (0.0, -90.0, 90.0, -300.0, 300.0, -690.0, 610.0)
"""Detuning in Hz; the last two are the ends of the frequency range."""
_FORCES: Final = (0.05, 0.2, 0.5, 1.0, 2.0)
_DEAD_TIMES: Final = (0, 540, 999)


def _drawn(draw: random.Random, failure: Failure, mode: Mode, cycles: int, *, grid: bool) -> Cell:
    """Draw all fields of a cell except failure and mode."""

    def number(choices: Sequence[float], low: float, high: float) -> float:
        return draw.choice(choices) if grid else round(draw.uniform(low, high), 3)

    motion = draw.choice(MOTIONS if mode is not Mode.IDENTIFY else ("none", "none", "landing"))
    if mode in BY_FRICTION and motion == "none" and draw.randrange(4):
        motion = "holding"
    # Where the resonance is tracked, the frequency of the set-point has little effect.
    detuned = mode in TUNED or not draw.randrange(3)
    return Cell(
        failure=str(failure),
        onset=draw.choice(ONSETS),
        mode=mode.name,
        law=draw.choice(list(VibrationLaw)).name,
        friction=draw.choice(list(Law)).name,
        detuning=number(_DETUNINGS, -400.0, 400.0) if detuned else 0.0,
        setpoint=number((1.0, 3.0, 3.0), 0.3, 3.0),
        cof=number((0.25, 0.35), 0.2, 0.5),
        motion=motion,
        force=number(_FORCES, 0.03, 2.2),
        damping=number((LEAST_DAMPING, MOST_DAMPING), LEAST_DAMPING, MOST_DAMPING),
        dead_time=draw.choice(_DEAD_TIMES) if grid else draw.randrange(1000),
        identified=draw.choices(IDENTIFIED, (4, 4, 1))[0],
        ambient=20.0 if grid else round(draw.uniform(15.0, 35.0), 1),
        cycles=900 if mode is Mode.IDENTIFY else cycles,
        seed=draw.randrange(1, 1 << 16),
    )


_OF_PICKUP: Final = 2
"""Cells for each failure of the pick-up in a mode; every other failure has one."""


def grid_cells(seed: int, *, fine: bool = False) -> list[Cell]:
    """Return the cells of the grid, with every failure in every mode.

    Parameters
    ----------
    seed
        Seed with which all other factors are drawn from their grids.
    fine
        Whether to use more gains, and more cells for each failure in a mode.
    """
    draw = random.Random(seed)
    cells = []
    for failure in failures(FINE_GAINS if fine else GAINS):
        pickup = failure.sensor in PICKUP_SENSORS
        for mode in DRIVING:
            count = (16 if pickup else 4) if fine else (_OF_PICKUP if pickup else 1)
            if mode is Mode.IDENTIFY:
                count = count // 4 if fine else int(pickup and failure.kind == "gain")
            cells += [
                _drawn(draw, failure, mode, 1000 if fine else 200, grid=True) for _ in range(count)
            ]
    return cells


def random_cells(count: int, seed: int) -> list[Cell]:
    """Return cells drawn from the continuous ranges.

    In every third cell the finger taps for 10 s, and half of the failures vary or come rarely.

    Parameters
    ----------
    count
        Number of cells; a larger number adds cells at the end.
    seed
        Seed of all draws.
    """
    draw = random.Random(seed)
    return [_random_cell(draw) if n % 3 else _tapping_cell(draw) for n in range(count)]


def _random_cell(draw: random.Random) -> Cell:
    known = failures()
    failure = draw.choice(known)
    if failure.kind == "gain":
        failure = failure._replace(size=round(draw.uniform(0.0, 2.0), 3))
    elif failure.kind in ("offset", "noise"):
        failure = failure._replace(size=round(failure.size * draw.uniform(0.05, 1.5)))
    if failure.of > 1 or not draw.randrange(10):
        of = draw.randrange(2, 12)
        failure = failure._replace(on=draw.randrange(1, of), of=of)
    mode = draw.choices(DRIVING, (2, 4, 4, 4, 1, 4))[0]
    return _drawn(draw, failure, mode, draw.choice((250, 1000)), grid=False)


_VARYING: Final = {"gain": (0.2, 1.4), "offset": (-1500.0, 1500.0), "noise": (0.0, 2000.0)}
"""Range of the sizes of failures that vary, by kind."""


def _tapping_cell(draw: random.Random) -> Cell:
    cell = _random_cell(draw)
    failure = parse_failure(cell.failure)
    if failure.kind in _VARYING and draw.randrange(2):
        low, high = _VARYING[failure.kind]
        failure = failure._replace(
            size=round(draw.uniform(low, high), 3),
            to=round(draw.uniform(low, high), 3),
            form=draw.choice(FORMS),
            over=round(10.0 ** draw.uniform(0.5, 3.5)),
        )
    if not draw.randrange(6):
        of = round(10.0 ** draw.uniform(1.0, 3.0))
        failure = failure._replace(of=of, on=draw.randrange(1, min(of, 60)))
    mode = draw.choice([mode for mode in DRIVING if mode is not Mode.IDENTIFY])
    return replace(
        cell,
        failure=str(failure),
        mode=mode.name,
        motion=TAPPING,
        force=round(draw.uniform(0.05, 2.2), 3),
        softening=draw.choice((0.0, 0.0, 60.0, 150.0)),
        identified="sound",
        cycles=10_000,
        period=round(10.0 ** draw.uniform(-1.0, 0.3), 3),
        touch=round(draw.uniform(0.3, 0.9), 3),
        lift=round(draw.choice((2.0, 5.0, draw.uniform(2.0, 50.0))), 1),
    )


# --- Results -----------------------------------------------------------------------------------


_WORST: Final = ("peak_um", "in_a_row", "above", "energy_J", "after", "cof_error")
"""Fields of a result of which the largest value is shown."""


def summary(
    results: Sequence[Result], row_of: Callable[[Result], str] = lambda result: result.failure
) -> dict[str, dict[str, Any]]:
    """Return the worst values of each row, and how often each watchdog ended a run.

    Parameters
    ----------
    results
        Results of the cells.
    row_of
        Function that returns the row of a result; by default its failure mode.
    """
    table: dict[str, dict[str, Any]] = {}
    for result in results:
        row = table.setdefault(
            row_of(result),
            {"cells": 0, "ended": {}, **dict.fromkeys(_WORST, 0), "violations": 0},
        )
        row["cells"] += 1
        by = result.ended_by or "nothing"
        row["ended"][by] = row["ended"].get(by, 0) + 1
        for name in _WORST:
            row[name] = max(row[name], getattr(result, name))
        row["violations"] += bool(result.violation)
    return table


def fingerprint(results: Sequence[Result]) -> str:
    """Return a hash of the results of all cells."""
    lines = (
        f"{r.cell} {r.ended_by} {r.after} {r.peak_um:.2f} {r.above} {r.limited}" for r in results
    )
    return sha256("\n".join(lines).encode()).hexdigest()[:16]


def as_json(results: Sequence[Result]) -> dict[str, Any]:
    """Return the results as JSON values."""
    return {
        "promise": PROMISES._asdict(),
        "cells": len(results),
        "violations": sum(bool(result.violation) for result in results),
        "fingerprint": fingerprint(results),
        "summary": summary(results),
        "results": [asdict(result) for result in results],
    }

"""Runs without a failure, which no watchdog may end, with any inputs that users may choose."""

from __future__ import annotations

import random
from dataclasses import asdict, dataclass, replace
from math import sin
from typing import Any, Final, NamedTuple

from smarttac_can.assurance.trials.invariants import TripCause
from smarttac_can.assurance.trials.rig import TARE_CYCLES, BlockRig, block_rig
from smarttac_can.canopen.od.cia import Abort
from smarttac_can.instrument.nodes.stimulator_block import StimulatorBlock
from smarttac_can.science.plant.finger import FingerState, Lifted, smooth
from smarttac_can.science.plant.parameters import (
    PlateParameters,
    ResonatorParameters,
    SensorParameters,
)
from smarttac_can.science.plant.plate import Plate
from smarttac_can.science.plant.subjects import SUBJECTS, Subject
from smarttac_can.vocabulary.meanings import AUTO_ZERO, START_RUN, ZERO
from smarttac_can.vocabulary.signals import TICK
from smarttac_can.vocabulary.states import Law, Mode, State, Status, VibrationLaw
from smarttac_can.vocabulary.textures import Axis, TextureTable
from smarttac_can.vocabulary.watchdogs import watchdogs_in

_DRIVING: Final = (
    Mode.OPEN_LOOP,
    Mode.AMPLITUDE,
    Mode.AMPLITUDE_RESONANCE,
    Mode.FRICTION,
    Mode.TEXTURE,
)
_WEIGHTS: Final = (1, 4, 2, 4, 6)
_DEAD_TIMES: Final = (0, 540, 999)
_SOFTENINGS: Final = (0.0, 60e6, 150e6)
_WINDOWS: Final = (0.0, 461e-6)
_IDENTIFY_CYCLES: Final = 2500
_LEAST_COF, _MOST_COF = 500, 20000
"""Bounds of a COF in 1e-4, as in the EDS."""


@dataclass(frozen=True, slots=True)
class HealthyRun:
    """Result of a run without a failure."""

    seed: int
    what: str
    """Description of the inputs."""
    cycles: int
    """Cycles of driving."""
    ended_by: str
    """Watchdogs that tripped, joined by +; empty if none did."""
    cause: str
    """Cause of the trip in the true vibration of the plate; empty for a false trip, which each trip
    of a tapping finger is."""
    after: int
    """Cycle of driving in which they tripped; -1 for none."""
    peak_um: float
    """Largest true amplitude in um peak-to-peak."""
    limited: int
    """Cycles with the status bit LIMITED."""

    @property
    def false(self) -> bool:
        """Whether a watchdog tripped without a cause at the plate."""
        return bool(self.ended_by) and not self.cause


class _Finger:
    __slots__ = ("_force", "_lifted", "_lifts", "_omega", "_period", "_press", "_travel")

    def __init__(self, draw: random.Random) -> None:
        self._force = draw.choice((0.0, 0.05, 0.2, 0.5, 1.0, 1.5, draw.uniform(0.05, 1.5)))
        self._travel = draw.uniform(5e-3, 15e-3)
        self._omega = draw.uniform(0.01, 0.15) / self._travel
        self._lifts = bool(draw.randrange(2))
        self._period = draw.uniform(0.1, 0.6)
        self._lifted = draw.uniform(0.2, 0.7)
        self._press = draw.choice((10e-3, 20e-3, 100e-3))

    def __str__(self) -> str:
        lifting = f", lifting each {self._period:.2f} s" if self._lifts else ""
        return f"{self._force:.2f} N at {1e3 * self._omega * self._travel:.0f} mm/s{lifting}"

    def at(self, time: float) -> FingerState:
        """Return the state at a time in s from the start of the run."""
        begin = (TARE_CYCLES + 20) * TICK
        Fn = self._force * smooth((time - begin) / self._press)
        if self._lifts and time > begin + self._press:
            phase = (time - begin) / self._period % 1.0
            Fn *= 1.0 - smooth((phase - 1.0 + self._lifted) * self._period / self._press)
            if time - begin > self._period:
                Fn = min(Fn, self._force * smooth(phase * self._period / self._press))
        return FingerState(self._travel * sin(self._omega * time), Fn)


class TappingFinger:
    """A finger that taps, strokes with lifts, or knocks, from 0.5 to 10 times a second."""

    __slots__ = ("_force", "_lift", "_omega", "_period", "_press", "_touch", "_travel")

    def __init__(self, draw: random.Random) -> None:
        self._travel = draw.uniform(5e-3, 30e-3)
        self._omega = draw.choice((0.0, draw.uniform(0.02, 0.25))) / self._travel
        self._period = 10.0 ** draw.uniform(-1.0, 0.3)
        if draw.randrange(5):
            self._force = draw.uniform(0.1, 2.0)
            self._touch = self._period * draw.uniform(0.3, 0.95)
            room = self._period - self._touch
            self._lift = min(draw.choice((2e-3, 3e-3, 8e-3, draw.uniform(2e-3, 50e-3))), room)
            self._press = min(draw.choice((5e-3, 16e-3, 30e-3)), 0.5 * self._touch)
        else:  # a knock of 12 ms
            self._force = draw.uniform(1.0, 4.0)
            self._touch = self._lift = self._press = 6e-3

    def __str__(self) -> str:
        return (
            f"{self._force:.2f} N at {1e3 * self._omega * self._travel:.0f} mm/s, "
            f"{1.0 / self._period:.1f} taps/s of {1e3 * self._touch:.0f} ms, lifted in "
            f"{1e3 * self._lift:.0f} ms"
        )

    def at(self, time: float) -> FingerState:
        """Return the state at a time in s from the start of the run."""
        begin, Fn = (TARE_CYCLES + 20) * TICK, 0.0
        if time > begin:
            since = (time - begin) % self._period
            Fn = self._force * smooth(since / self._press)
            Fn *= 1.0 - smooth((since - self._touch) / self._lift)
        return FingerState(self._travel * sin(self._omega * time), Fn)


def _plate(seed: int) -> tuple[float, float]:
    """Draw the softening in Hz/m and the pick-up's window in s, apart from all other draws."""
    draw = random.Random(f"plate {seed}")
    return draw.choice(_SOFTENINGS), draw.choice(_WINDOWS)


def _subject(draw: random.Random) -> Subject:
    """Draw one of the subjects, or a random fingertip of the population."""
    if not draw.randrange(3):
        return draw.choice(SUBJECTS)
    return replace(
        SUBJECTS[1],
        mu0=draw.uniform(0.3, 0.9),
        rho=draw.uniform(0.15, 0.5),
        W0=draw.uniform(0.8e-6, 3e-6),
        p=draw.uniform(1.0, 2.0),
        load_damping=draw.choice((5.0, 14.0, draw.uniform(5.0, 14.0))),
        exponent=draw.uniform(0.7, 1.0),
    )


def _texture(draw: random.Random) -> TextureTable:
    """Draw a legal texture; many ask for more than any finger can give."""
    count = draw.choice((2, 5, 20, 100))
    low = draw.choice((_LEAST_COF, draw.randrange(_LEAST_COF, 5000)))
    high = draw.choice((_MOST_COF, 6000, draw.randrange(low + 1, _MOST_COF)))
    if draw.randrange(2):
        values = (low,) * count + (high,) * count
    else:
        values = tuple(draw.randrange(low, high + 1) for _ in range(2 * count))
    if draw.randrange(2):
        return TextureTable(Axis.POSITION, True, 0, draw.randrange(20_000, 500_000), values)
    return TextureTable(Axis.TIME, True, 0, draw.randrange(500, 20_000), values)


def _try(block: StimulatorBlock, name: str, raw: int | bytes) -> None:
    """Write a value that the stimulator may refuse, as a user's script would."""
    try:
        block.write(name, raw)
    except Abort:
        return


def healthy_run(seed: int) -> HealthyRun:
    """Run without a failure for one to two seconds, or for four to eight with a tapping finger.

    In two of five runs the finger taps, and set-points are up to 2.5 um. No such run may end by a
    fault, whatever the plate does when the finger lifts.

    Parameters
    ----------
    seed
        Seed of all random draws, 0 or more.
    """
    tapping = seed % 5 > _WILD_OF_FIVE
    draw = random.Random(seed)
    rig = block_rig()
    rig.power_on({})
    block = rig.block
    dead_time = draw.choice(_DEAD_TIMES)
    softening, window = _plate(seed)
    half = round(0.5e6 * window)
    if dead_time + half > _DEAD_TIMES[-1]:
        window, half = 0.0, 0
    parameters = PlateParameters(
        resonator=ResonatorParameters(softening=softening),
        sensors=SensorParameters(pickup_window=window),
    )
    law, friction = draw.choice(list(VibrationLaw)), draw.choice(list(Law))
    for name, raw in (
        ("Controller.Vibration law", law),
        ("Friction law", friction),
        ("Controller.Dead time", dead_time + half),
        ("Simulation.Drive instant", dead_time),
        ("Texture table.Table 1", _texture(draw).pack()),
    ):
        block.write(name, raw)
    block.write(START_RUN, 1)
    finger = TappingFinger(draw) if tapping else _Finger(draw)
    ambient = draw.choice((20.0, draw.uniform(15.0, 30.0)))
    plate = Plate(
        parameters, _subject(draw), finger, seed=seed, ambient=ambient,
        dead_time=dead_time * 1e-6,
    )  # fmt: skip
    identifies = tapping or not draw.randrange(4)
    if identifies:
        # There is no finger during the identification.
        rig.simulate(Plate(
            parameters, SUBJECTS[0], Lifted(), seed=seed, ambient=ambient,
            dead_time=dead_time * 1e-6,
        ))  # fmt: skip
        _tare(rig)
        rig.identify(_IDENTIFY_CYCLES)
        block.write("Controlword", 0)
        block.write(START_RUN, 1)
    rig.simulate(plate)
    _tare(rig)
    kind = f"{dead_time} us, {softening * 1e-6:.0f} Hz/um, window {2 * half} us"
    what = f"{law.name} {friction.name} {kind}, {finger}"
    return _driven(seed, draw, rig, what, _GENTLE if tapping else _WILD)


def _tare(rig: BlockRig) -> None:
    rig.tick(TARE_CYCLES)
    rig.block.write(AUTO_ZERO[0], ZERO)
    rig.tick(4)


class _Inputs(NamedTuple):
    """Ranges of what a user asks for."""

    most_um: float
    most_volts: float
    hops: bool
    cycles: tuple[int, int]
    pauses: tuple[int, ...]
    """Cycles from one change of the set-points to the next."""


_WILD: Final = _Inputs(3.0, 150.0, True, (1000, 2000), (3, 10, 30, 100, 400))
_WILD_OF_FIVE: Final = 2
"""Last remainder by 5 of the seeds of runs with wild inputs."""
_GENTLE: Final = _Inputs(2.5, 60.0, False, (4000, 8000), (400, 1500, 9000))


def _driven(
    seed: int, draw: random.Random, rig: BlockRig, what: str, inputs: _Inputs
) -> HealthyRun:
    block, od, plate = rig.block, rig.od, rig.plate_block.plate
    low = od["Limit.Lowest frequency"].value
    high = od["Limit.Highest frequency"].value
    resonance = round(plate.resonance * 100.0)
    mode = draw.choices(_DRIVING, _WEIGHTS)[0]
    hops = inputs.hops and not draw.randrange(3)
    most = round(1000.0 * inputs.most_um)

    def jump() -> None:
        nm = draw.choice((0, 500, 1000, 2000, most, draw.randrange(most + 1)))
        _try(block, "Setpoint.Amplitude", nm)
        _try(block, "Setpoint.Voltage", draw.randrange(round(100.0 * inputs.most_volts) + 1))
        cof = draw.choice((2000, 3000, draw.randrange(_LEAST_COF, _MOST_COF)))
        _try(block, "Setpoint.COF left", cof)
        _try(block, "Setpoint.COF right", min(cof + draw.randrange(3000), _MOST_COF))
        if hops:
            near = resonance + draw.randrange(-30_000, 30_001)
            frequency = draw.choice((near, resonance, low, high))
            _try(block, "Setpoint.Frequency", min(max(frequency, low), high))

    jump()
    block.write("Mode", mode)
    rig.arm()
    modes = [mode.name]
    cycles = draw.randint(*inputs.cycles)
    pause = draw.choice(inputs.pauses)
    trip_cause, cause = TripCause(rig), ""
    status, bit = od["Statusword"], int(Status.LIMITED)
    limited, peak, ended, after = 0, 0.0, "", -1
    for cycle in range(cycles):
        if cycle and not cycle % pause:
            jump()
            if not draw.randrange(8):
                mode = draw.choices(_DRIVING, _WEIGHTS)[0]
                modes.append(mode.name)
                _try(block, "Mode", mode)
        rig.tick()
        trip_cause.look()
        peak = max(peak, abs(plate.W))
        limited += bool(status.value & bit)
        if block.supervisor.latched:
            ended = "+".join(w.name for w in watchdogs_in(block.supervisor.latched))
            if inputs is _WILD:
                cause = trip_cause.of(block.supervisor.latched) or ""
            after = cycles = cycle
            break
        if block.state is not State.RUNNING:
            ended, after = block.od["Message"].value or "not running", cycle
            break
    block.write("Controlword", 0)
    return HealthyRun(
        seed=seed,
        what=f"{'+'.join(modes)} {what}{', hops of the frequency' if hops else ''}",
        cycles=cycles,
        ended_by=ended,
        cause=cause,
        after=after,
        peak_um=round(peak * 1e6, 3),
        limited=limited,
    )


def healthy_as_json(runs: list[HealthyRun]) -> dict[str, Any]:
    """Return the runs as JSON values; those that ended in a fault are listed."""
    ended = [asdict(run) | {"false": run.false} for run in runs if run.ended_by]
    return {
        "runs": len(runs),
        "cycles": sum(run.cycles for run in runs),
        "limited": sum(run.limited for run in runs),
        "ended": len(ended),
        "false": sum(run.false for run in runs),
        "faults": ended,
    }

"""Play a texture under a stroking finger, and record its true COF."""

from __future__ import annotations

from typing import Final, NamedTuple

from smarttac_can.bench.simulation import plate_od, stimulator_od
from smarttac_can.bench.textures import Texture
from smarttac_can.instrument.nodes.plate_block import PlateBlock
from smarttac_can.instrument.nodes.stimulator_block import StimulatorBlock
from smarttac_can.vocabulary.meanings import AUTO_ZERO, START_RUN, STROKE, ZERO
from smarttac_can.vocabulary.signals import TARE_SAMPLES
from smarttac_can.vocabulary.states import Control, Mode, State, VibrationLaw

LEVELS: Final = {1: (0.2, 0.3), 2: (0.3, 0.4), 3: (0.4, 0.5), 4: (0.5, 0.6)}
"""COF of a subject between and on the ridges: references of the paper that it can reach."""
_TARES: Final = 16
_TARE_AND_PRESS: Final = 320
_TRAVEL_MM: Final = 30
_ZEROS: Final = tuple(f"Gauge zero.Zero of S{number}" for number in range(1, 7))
_PASS_CYCLES: Final = 1.2
"""Duration of a pass with its turns, relative to a pass at full speed."""


class Stroke(NamedTuple):
    """Position in mm, true COF, measured COF and COF reference in each cycle of 1 ms."""

    position: list[float]
    cof: list[float]
    measured: list[float]
    reference: list[float]


def play(
    texture: Texture,
    subject: int,
    *,
    passes: int = 20,
    force: float = 1.0,
    speed: float = 60.0,
    seed: int = 1,
    preview_us: int = 1500,
    dead_time_us: int = 0,
    vibration_law: VibrationLaw = VibrationLaw.PI,
    tares: int = _TARES,
) -> Stroke:
    """Play a texture under a finger that strokes to and fro, from the first pass on.

    Parameters
    ----------
    texture
        Texture to play.
    subject
        Number of the simulated finger.
    passes
        Number of passes, 1 or more, without the first one, in which the finger presses.
    force, speed
        Normal force in N, and speed in mm/s.
    seed
        Seed of the sensor noise.
    preview_us
        Time in us by which the reference is ahead.
    dead_time_us
        Time from the tick until a drive is in force, in us; the controllers know it.
    vibration_law
        Law of the inner loops.
    tares
        Number of tares of 64 samples over which the zero is averaged. A single one gives an error
        of 0.03 mm at 1 N.

    Raises
    ------
    RuntimeError
        The run ends by itself.
    """
    plate = PlateBlock(plate_od())
    block = StimulatorBlock(stimulator_od(), plate)
    for name, raw in (
        ("Simulation.Subject", subject),
        ("Simulation.Seed", seed),
        ("Finger.Force", round(force * 1e3)),
        ("Finger.Speed", round(speed * 1e1)),
        ("Finger.Range", _TRAVEL_MM * 100),
        ("Finger.Force variation", 0),
        ("Finger.Speed variation", 0),
        ("Setpoint.Amplitude", 1000),
        ("Texture.Preview", preview_us),
        ("Controller.Dead time", dead_time_us),
        ("Simulation.Drive instant", dead_time_us),
        ("Controller.Vibration law", vibration_law),
    ):
        block.write(name, raw)
    block.write("Texture table.Table 1", texture.table.pack())
    _tare(block, tares)
    block.write("Finger.Motion", STROKE)
    block.write(START_RUN, 1)
    _cycle(block, TARE_SAMPLES)
    for word in (0, Control.ARM, Control.ARM | Control.RUN):
        block.write("Controlword", word)
    block.write("Mode", Mode.TEXTURE)
    one = round(_PASS_CYCLES * _TRAVEL_MM / speed * 1e3)
    _cycle(block, _TARE_AND_PRESS - TARE_SAMPLES + one)
    stroke = Stroke([], [], [], [])
    for _ in range(passes * one):
        block.tick()
        finger = plate.plate
        cascade = block.cascade
        row = (finger.position * 1e3, finger.mu_true, cascade.contact.mu, cascade.mu_ref)
        for column, value in zip(stroke, row, strict=True):
            column.append(value)
    if block.state is not State.RUNNING:
        raise RuntimeError(f"the run has ended: {block.od['Message'].value}")
    return stroke


def _tare(block: StimulatorBlock, tares: int) -> None:
    """Set the zero to the mean of some tares, without a finger."""
    zeros = []
    block.write(START_RUN, 1)
    for _ in range(tares):
        _cycle(block, TARE_SAMPLES)
        block.write(AUTO_ZERO[0], ZERO)
        zeros.append([block.od[name].value for name in _ZEROS])
    for name, values in zip(_ZEROS, zip(*zeros, strict=True), strict=True):
        block.write(name, round(sum(values) / tares))


def _cycle(block: StimulatorBlock, count: int) -> None:
    for _ in range(count):
        block.tick()

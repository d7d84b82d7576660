"""Loads on a plate: a simulated finger, or known weights for a calibration."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import cos, radians, sin
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from smarttac_can.bench.given import Given, finite, given, given_integer, said, stays_in_process
from smarttac_can.canopen.master.errors import BenchError, RefusedError
from smarttac_can.canopen.od.cia import AbortCode
from smarttac_can.host.files import in_words, read_numbers
from smarttac_can.vocabulary.meanings import LIFTED, RECORDED, STROKE

STANDARD_GRAVITY: Final = 9.80665
"""Standard gravity in m/s^2."""
_RANGES: Final = {
    "mass_g": (1.0, 800.0),
    "angle_deg": (0.0, 60.0),
    "azimuth_deg": (-360.0, 360.0),
    "x_mm": (-38.0, 38.0),
}
_SPEED: Final = 50.0
_FORCE: Final = 1.0
"""Assumed of a finger that nobody has put on the plate, in mm/s and N."""
_MOST_ROWS: Final = 100


class SimulatedFinger:
    """Finger of a simulated plate; a change is in force from the next `Stimulator.start_run` on.

    A hardware plate refuses every change.

    Parameters
    ----------
    read
        Function that reads an object by name in a unit: `Stimulator.get`.
    write
        Function that writes given values to objects by name, all or none.

    Attributes
    ----------
    speed : float
        Speed in mm/s of the last `stroke`; 50 before the first.
    subject : int
        Number of the subject that strokes or is played, in force since the last start of a run that
        this bench has made; 0 if it has put no finger on the plate.
    """

    __reduce_ex__ = stays_in_process("a finger")

    def __init__(
        self,
        read: Callable[[str, str], float],
        write: Callable[[Mapping[str, Given]], None],
    ) -> None:
        self._read = read
        self._write = write
        self.speed = _SPEED
        self.force = _FORCE
        self.subject = self._next_subject = 0

    def __repr__(self) -> str:
        try:
            return f"<SimulatedFinger: {self._moves()}; {self._surroundings()}>"
        except BenchError as error:
            return f"<SimulatedFinger: {error}>"

    def _moves(self) -> str:
        motion = self._read("Finger.Motion", "")
        if motion == LIFTED:
            return "lifted"
        if motion == RECORDED:
            return "as recorded"
        force, more = self._read("Finger.Force", "N"), self._read("Finger.Force variation", "%")
        speed, faster = (
            self._read("Finger.Speed", "mm/s"),
            self._read("Finger.Speed variation", "%"),
        )
        return (
            f"subject {self._read('Simulation.Subject', ''):.0f}, {force:.3f} N +-{more:.0f} %, "
            f"{speed:.1f} mm/s +-{faster:.0f} %, travel {self._read('Finger.Range', 'mm'):.1f} mm"
        )

    def _surroundings(self) -> str:
        return (
            f"seed {self._read('Simulation.Seed', ''):.0f}, "
            f"{self._read('Simulation.Ambient temperature', 'degC'):.1f} degC, "
            f"drive instant {self._read('Simulation.Drive instant', 'us'):.0f} us"
        )

    def recall(self) -> None:
        """Take the subject from the simulation, which this process has just made."""
        there = self._read("Finger.Motion", "") != LIFTED
        self.subject = self._next_subject = int(self._read("Simulation.Subject", "")) * there

    def begin(self) -> None:
        """Note that a run begins, with which the last change is in force."""
        self.subject = self._next_subject

    def lift(self) -> None:
        """Lift the finger off the plate."""
        self._write({"Finger.Motion": given("motion", LIFTED, "")})
        self._next_subject = 0

    def play_recording(self) -> None:
        """Play the recorded finger of the plate: ``finger=`` of `simulate`, or ``--finger FILE``.

        Raises
        ------
        RefusedError
            If the plate was started without a recorded finger.
        """
        try:
            self._write({"Finger.Motion": given("motion", RECORDED, "")})
        except RefusedError as error:
            if error.code != AbortCode.STATE:
                raise
            text = (
                f"{error}: the plate's node was started without a recording: give simulate "
                "finger=, or the node --finger FILE"
            )
            raise RefusedError(text, error.code) from error
        self._next_subject = int(self._read("Simulation.Subject", ""))

    def stroke(
        self,
        subject: int,
        *,
        force: float | str = 0.5,
        speed: float | str = _SPEED,
        travel: float | str = 20.0,
        force_variation: float | str = 0.0,
        speed_variation: float | str = 0.0,
    ) -> None:
        """Stroke to and fro over the middle of the plate.

        Quantities may also be texts with a unit: ``500 mN``.

        Parameters
        ----------
        subject
            Number of the subject: 1..5 are presets, 6..9 are fitted to Table I.
        force
            Normal force in N, 0.05..2.
        speed
            Sliding speed in mm/s, 5..300.
        travel
            Distance between the turning points in mm, 1..50.
        force_variation, speed_variation
            Variation from pass to pass, as a fraction, 0..0.5.

        Raises
        ------
        RefusedError
            If a value is out of range; nothing has changed then.
        ValueError
            If a value is not a number or text with such a unit, or `subject` is not an integer.
        """
        self._write(
            {
                "Simulation.Subject": given_integer("subject", subject),
                "Finger.Force": (pressed := given("force", force, "N")),
                "Finger.Speed": (now := given("speed", speed, "mm/s")),
                "Finger.Range": given("travel", travel, "mm"),
                "Finger.Force variation": given("force_variation", force_variation, ""),
                "Finger.Speed variation": given("speed_variation", speed_variation, ""),
                "Finger.Motion": given("motion", STROKE, ""),
            }
        )
        self.speed = now.quantity.in_unit("mm/s")
        self.force = pressed.quantity.in_unit("N")
        self._next_subject = int(subject)

    def put(self, placing: Placing, gravity: float = STANDARD_GRAVITY) -> None:
        """Put a weight on the simulated plate, with the tilt of the placing; the last one leaves.

        It acts at once, until another placing is put; ``placing.empty`` takes it away. Lift the
        finger first.

        Parameters
        ----------
        placing
            Weight, tilt and position, as for `weigh`.
        gravity
            Gravity in m/s^2.

        Raises
        ------
        RefusedError
            If a force is above 8 N, or the plate is hardware.
        ValueError
            If `placing` is not a `Placing`.
        """
        if not isinstance(placing, Placing):
            raise ValueError(f"placing {said(placing)} is no Placing")
        numbers = Placing(*map(finite, Placing._fields, placing))
        names = ("Weight.Force x", "Weight.Force y", "Weight.Normal force")
        words = ("force along x", "force along y", "normal force")
        forces = numbers.load(finite("gravity", gravity))
        try:
            self._write(
                {
                    **{
                        name: given(word, 1e-3 * round(1e3 * force), "N")
                        for name, word, force in zip(names, words, forces, strict=True)
                    },
                    "Weight.Position": given("x_mm", numbers.x_mm, "mm"),
                }
            )
        except RefusedError as error:
            if error.code != AbortCode.STATE:
                raise
            text = f"{error}: only a simulated plate puts weights on by itself"
            raise RefusedError(text, error.code) from error

    def surroundings(
        self,
        *,
        seed: int | None = None,
        temperature: float | str | None = None,
        drive_instant: float | str | None = None,
    ) -> None:
        """Set other conditions of a run; omitted ones are not changed.

        Parameters
        ----------
        seed
            Seed of noise and finger, 0..2^32 - 1.
        temperature
            Ambient temperature in degC, 0..60.
        drive_instant
            Time in us from the tick until the plate puts a drive in force, 0..999.

        Raises
        ------
        RefusedError, ValueError
            As for `stroke`.
        """
        values: dict[str, Given] = {}
        if seed is not None:
            values["Simulation.Seed"] = given_integer("seed", seed)
        if temperature is not None:
            values["Simulation.Ambient temperature"] = given("temperature", temperature, "degC")
        if drive_instant is not None:
            values["Simulation.Drive instant"] = given("drive_instant", drive_instant, "us")
        self._write(values)


class Placing(NamedTuple):
    """Position of a weight and tilt of the plate.

    As a text it is an instruction: ``put 200 g at -20 mm``.
    """

    mass_g: float
    angle_deg: float
    """Angle between the plate and the horizontal."""
    azimuth_deg: float
    """Direction in which the plate falls: 0 along x, 90 along y."""
    x_mm: float
    """Position of the weight from the middle; used only if the plate is level."""

    @property
    def level(self) -> bool:
        """Whether the plate is level, so that the weight loads no lateral gauge."""
        return self.angle_deg == 0.0

    @property
    def empty(self) -> Placing:
        """Placing with the same tilt without a weight."""
        return self._replace(mass_g=0.0)

    def __str__(self) -> str:
        if self.mass_g:
            return f"put {self.mass_g:g} g at {self.x_mm:g} mm"
        tilt = f"tilt the plate by {self.angle_deg:g} degrees towards {self.azimuth_deg:g}"
        return f"{'level the plate' if self.level else tilt}, nothing on it"

    def load(self, gravity: float) -> tuple[float, float, float]:
        """Return Fx, Fy and Fn in N under a gravity in m/s^2."""
        weight = self.mass_g * 1e-3 * gravity
        along = weight * sin(radians(self.angle_deg))
        azimuth = radians(self.azimuth_deg)
        return along * cos(azimuth), along * sin(azimuth), weight * cos(radians(self.angle_deg))


class Weighing(NamedTuple):
    """A weight, with the gauge readings at the same tilt without it and with it."""

    placing: Placing
    empty: npt.NDArray[np.float64]
    """Raw S1..S6 in N."""
    loaded: npt.NDArray[np.float64]
    """Raw S1..S6 in N."""

    @property
    def gauges(self) -> npt.NDArray[np.float64]:
        """Change of S1..S6 by the weight in N, shape (6,)."""
        return self.loaded - self.empty

    def as_json(self) -> dict[str, Any]:
        """Return the weighing for a certificate."""
        raw = {"empty_mN": self.empty, "loaded_mN": self.loaded}
        return self.placing._asdict() | {
            name: [round(float(value) * 1e3, 3) for value in values] for name, values in raw.items()
        }


@in_words()
def read_plan(path: Path | str) -> list[Placing]:
    """Read the placings of a CSV file with the columns mass_g, angle_deg, azimuth_deg, x_mm.

    Raises
    ------
    ValueError
        If the file has another form, or a number is out of range; the message names the line.
    OSError
        If the file cannot be read.
    """
    path = Path(path)
    plan = [Placing(*row) for _, row in read_numbers(path, _RANGES, most_rows=_MOST_ROWS)]
    if not plan:
        raise ValueError(f"{path}: no weighing")
    return plan

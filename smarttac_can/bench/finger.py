"""The finger of a simulated plate, and the room it stands in."""

from __future__ import annotations

from collections.abc import Callable

from smarttac_can.bench.weighings import STANDARD_GRAVITY, Placing
from smarttac_can.master.errors import BenchError, RefusedError
from smarttac_can.od.cia import AbortCode
from smarttac_can.vocabulary.objects import LIFTED, RECORDED, STROKE


class SimulatedFinger:
    """What a simulated plate plays; every change is in force from the next `Stimulator.start_run`.

    A plate of hardware refuses all of it.

    Parameters
    ----------
    read
        Reads an object by name in a unit, `Stimulator.get`.
    write
        Writes an object by name, `Stimulator.set`.
    """

    def __init__(
        self, read: Callable[[str, str], float], write: Callable[[str, float | str], None]
    ) -> None:
        self._read = read
        self._write = write

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

    def lift(self) -> None:
        """Lift the finger off the plate."""
        self._write("Finger.Motion", LIFTED)

    def play_recording(self) -> None:
        """Play the recorded finger that the plate was started with, ``--finger FILE``.

        Raises
        ------
        RefusedError
            If it was started without one.
        """
        try:
            self._write("Finger.Motion", RECORDED)
        except RefusedError as error:
            if error.code != AbortCode.STATE:
                raise
            text = f"{error}: the plate's node was started without a recording, --finger FILE"
            raise RefusedError(text, error.code) from error

    def stroke(
        self,
        subject: int,
        *,
        force: float = 0.5,
        speed: float = 50.0,
        travel: float = 20.0,
        force_variation: float = 0.0,
        speed_variation: float = 0.0,
    ) -> None:
        """Slide to and fro over the middle of the plate.

        Parameters
        ----------
        subject
            Number of the subject: 1..5 the presets, 6..9 those fitted to Table I.
        force
            Normal force in N, 0.05..2.
        speed
            Sliding speed in mm/s, 5..300.
        travel
            Distance between the turning points in mm, 1..50.
        force_variation, speed_variation
            How far they vary from pass to pass, as a fraction, 0..0.5.
        """
        self._write("Simulation.Subject", subject)
        self._write("Finger.Force", f"{force} N")
        self._write("Finger.Speed", f"{speed} mm/s")
        self._write("Finger.Range", f"{travel} mm")
        self._write("Finger.Force variation", f"{force_variation}")
        self._write("Finger.Speed variation", f"{speed_variation}")
        self._write("Finger.Motion", STROKE)

    def put(self, placing: Placing, gravity: float = STANDARD_GRAVITY) -> None:
        """Put a weight on the simulated plate, tilted as told, instead of the one before.

        It lies there at once, and until another is put: ``placing.empty`` takes it away. Lift the
        finger first.

        Parameters
        ----------
        placing
            Weight, tilt and place, as for `weigh`.
        gravity
            In m/s^2.

        Raises
        ------
        RefusedError
            If a force is above 8 N; also of a plate of hardware.
        ValueError
            If it is no `Placing`.
        """
        if not isinstance(placing, Placing):
            raise ValueError(f"placing {placing!r} is no Placing")
        names = ("Weight.Force x", "Weight.Force y", "Weight.Normal force")
        try:
            for name, force in zip(names, placing.load(gravity), strict=True):
                self._write(name, round(1e3 * force))
            self._write("Weight.Position", f"{placing.x_mm} mm")
        except RefusedError as error:
            if error.code != AbortCode.STATE:
                raise
            text = f"{error}: only a simulated plate puts weights on by itself"
            raise RefusedError(text, error.code) from error

    def surroundings(
        self,
        *,
        seed: int | None = None,
        temperature: float | None = None,
        drive_instant: float | None = None,
    ) -> None:
        """Set what else a run depends on; what is not given stays.

        Parameters
        ----------
        seed
            Seed of noise and finger, 0..2^32 - 1.
        temperature
            Ambient temperature in degC, 0..60.
        drive_instant
            When the plate puts a drive in force, in us after the tick, 0..999.
        """
        if seed is not None:
            self._write("Simulation.Seed", seed)
        if temperature is not None:
            self._write("Simulation.Ambient temperature", f"{temperature} degC")
        if drive_instant is not None:
            self._write("Simulation.Drive instant", f"{drive_instant} us")

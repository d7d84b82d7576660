"""The command ``fit-finger``: the numbers of a fingertip out of a recording."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final, NamedTuple

import click
import numpy as np

from smarttac_can.bench.lab_csv import (
    ACCELERATIONS_M,
    FORCES_N,
    LENGTHS_MM,
    SPEEDS_MM,
    TIMES_S,
    Floats,
    read_table,
    size_of,
)
from smarttac_can.cli.shared import (
    OLD_FILE,
    FiniteRange,
    in_steps,
    json_options,
    reporting,
    warn_without_numba,
    with_options,
)
from smarttac_can.host.terminal import progress_bar
from smarttac_can.science.plant.parameters import SensorParameters
from smarttac_can.science.population.finger_fit import FingerFit, FingerRecording
from smarttac_can.science.population.finger_fit import fit_finger as fitted_to
from smarttac_can.science.population.fingers import F0

_MM: Final = 1e-3
_UM_IN_MM: Final = 1e-3
_OF_LIMITS: Final = 0.1
"""Step in which a number is shown, as a fraction of what its limits leave open."""
_FINEST: Final = 1e-4
"""Finest step, as a fraction of the number; a recording without noise has no limits to speak of."""
_BY_GAUGES: Final = "position_mm"
"""Column of a trace whose position is that of the gauges."""


class _Kind(NamedTuple):
    """What a column may be in."""

    units: Mapping[str, float]
    usual: float
    """Size of the unit if the file does not tell one."""
    si: float


_KINDS: Final = {
    "time": _Kind(TIMES_S, 1.0, 1.0),
    "lateral": _Kind(FORCES_N, 1.0, 1.0),
    "normal": _Kind(FORCES_N, 1.0, 1.0),
    "position": _Kind(LENGTHS_MM, 1.0, _MM),
    "speed": _Kind(SPEEDS_MM, 1.0, _MM),
    "amplitude": _Kind(LENGTHS_MM, _UM_IN_MM, _MM),
    "acceleration": _Kind(ACCELERATIONS_M, 1.0, 1.0),
}
_SHOWN: Final = {
    "occlusion_time": (1.0, "s"),
    "W0": (1e6, "um"),
    "stribeck_speed": (1e3, "mm/s"),
    "relaxation_length": (1e6, "um"),
    "skin_mass": (1e6, "mg"),
    "skin_stiffness": (1.0, "N/m"),
    "skin_damping": (1.0, "N s/m"),
    "creep_time": (1e3, "ms"),
    "release_time": (1e3, "ms"),
    "load_damping": (1.0, "N s/m"),
    "load_stiffness": (1.0, "N/m"),
}
"""Factor and unit in which a number is shown; the others have none."""

_columns = with_options(
    click.option("--time", default="time_s", show_default=True, help="Column of the time, in s."),
    click.option(
        "--lateral",
        default="tangential_force_n",
        show_default=True,
        help="Column of the lateral force, in N; its sign is adapted to the motion.",
    ),
    click.option(
        "--normal",
        default="normal_force_n",
        show_default=True,
        help="Column of the normal force, in N.",
    ),
    click.option(
        "--position",
        default=_BY_GAUGES,
        show_default=True,
        help=f"Column of the position, in mm. The position in a trace, {_BY_GAUGES}, is computed"
        " from the gauges and lags behind the finger; for another column the fit assumes no lag.",
    ),
    click.option("--speed", help="Column of the speed, in mm/s, instead of --position."),
    click.option(
        "--amplitude",
        default="amplitude_um",
        show_default=True,
        help="Column of the vibration, in um peak-to-peak.",
    ),
    click.option("--bare", is_flag=True, help="The plate did not vibrate; leave out --amplitude."),
    click.option("--acceleration", help="Column of the acceleration of the skin, in m/s^2."),
)


@click.command(
    epilog="\b\nExamples:\n  smarttac fit-finger trace.csv --json finger.json\n"
    "  smarttac fit-finger lab.csv --time t --lateral Fx --normal Fz --position x --amplitude W\n"
    "  smarttac fit-finger trial.csv --bare --time t --lateral Fx --normal Fz --speed v "
    "--acceleration a --path 1000"
)
@click.argument("file", type=OLD_FILE)
@_columns
@click.option(
    "--path",
    "path_frequency",
    type=FiniteRange(min=1.0, max=1e5),
    default=SensorParameters().path_frequency,
    show_default=True,
    help="Natural frequency of the force path in Hz.",
)
@click.option(
    "--frequency",
    type=FiniteRange(min=5e3, max=1e6),
    default=F0,
    show_default=True,
    help="Frequency of the vibration in Hz.",
)
@click.option("--name", default="fitted", show_default=True, help="Name of the subject.")
@json_options()
def fit_finger(
    *,
    file: Path,
    position: str,
    speed: str | None,
    amplitude: str,
    bare: bool,
    path_frequency: float,
    frequency: float,
    name: str,
    json_file: Path | None,
    **columns: str | None,
) -> None:
    """Fit a fingertip to the recording FILE, and show its parameters with 95 % limits.

    Parameters that the recording does not determine are named. FILE is the CSV file of a trace or
    of a lab; the name of a column may end in a unit. Rows with an empty cell are left out, and the
    finger is lifted there. The file of --json has the parameters
    of the class Subject of smarttac_can.science.plant.
    """
    wanted = {what: column for what, column in columns.items() if column is not None}
    wanted["position" if speed is None else "speed"] = speed or position
    if not bare:
        wanted["amplitude"] = amplitude
    with reporting(json_file, ValueError) as write_results:
        found = _read(file, wanted)
        if speed is not None:
            found["position"] = _way(found["time"], found.pop("speed"))
        warn_without_numba()
        recording = FingerRecording(
            **found,
            path_frequency=path_frequency,
            frequency=frequency,
            position_by_gauges=speed is None and position == _BY_GAUGES,
        )
        with progress_bar("fitting") as progress:
            fit = fitted_to(recording, name=name, progress=progress)
        write_results(as_json(fit), lines(fit))


def _read(file: Path, wanted: dict[str, str]) -> dict[str, Floats]:
    """Read columns in SI units; raises as `read_table`."""
    names = list(wanted.values())
    if twice := {column for column in names if names.count(column) > 1}:
        raise ValueError(f"column {twice.pop()!r} is named twice: give each its own")
    table = read_table(file, names)
    found = {}
    for what, values, unit in zip(wanted, table.values, table.units, strict=True):
        kind, column = _KINDS[what], wanted[what]
        if unit and unit not in kind.units:
            known = ", ".join(kind.units)
            raise ValueError(f"{file}: column {column!r} is in {unit!r}, and not in {known}")
        size = kind.units[unit] if unit else size_of(column, "", kind.units)
        found[what] = values * ((size or kind.usual) * kind.si)
    return found


def _way(time: Floats, speed: Floats) -> Floats:
    """Return the way at a speed, by trapezoids."""
    steps = 0.5 * (speed[1:] + speed[:-1]) * np.diff(time)
    return np.concatenate([[0.0], np.cumsum(steps)])


def as_json(fit: FingerFit) -> dict[str, Any]:
    """Return a fit as JSON has it, in SI units."""
    return {
        "subject": asdict(fit.subject),
        "numbers": {name: estimate._asdict() for name, estimate in fit.numbers.items()},
        "residual_n": fit.residual,
        "rows": fit.rows,
        "independent_rows": fit.independent,
    }


def lines(fit: FingerFit) -> list[str]:
    """Return a fit as lines of text."""
    shown = [f"{'number':<18} {'value':>9}  95 % limits"]
    for name, estimate in fit.numbers.items():
        factor, unit = _SHOWN.get(name, (1.0, ""))
        if estimate.told:
            value, low, high = (factor * number for number in estimate[:3])
            step = max(_OF_LIMITS * (high - low), _FINEST * abs(value)) or 1.0
            least, most, found = (in_steps(number, step) for number in (low, high, value))
            shown.append(f"{name:<18} {found:>9}  {least} .. {most} {unit}".rstrip())
        else:
            shown.append(f"{name:<18} {'not told':>9}  {estimate.reason}")
    shown.append(
        f"{fit.rows} ms compared, as good as {fit.independent:.0f} independent ones; "
        f"{1e3 * fit.residual:.3g} mN are left"
    )
    return shown

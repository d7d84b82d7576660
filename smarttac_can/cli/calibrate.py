"""The command that calibrates a tribometer by known weights: ``calibrate``."""

from __future__ import annotations

import json
from contextlib import ExitStack
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any, Final

import click
import numpy as np

from smarttac_can import __version__
from smarttac_can.bench import Stimulator, stimulator_od
from smarttac_can.bench.calibration import (
    POSITIONS,
    Calibration,
    mean_gauges,
    require_two_directions,
    weigh,
    write_calibration,
)
from smarttac_can.bench.plate_loads import STANDARD_GRAVITY, Placing, Weighing, read_plan
from smarttac_can.cli.options import OLD_FILE, BusChoice, FiniteRange, stimulator_options
from smarttac_can.cli.plain_errors import naming, one_line, plain_errors
from smarttac_can.cli.process import lockstep_option
from smarttac_can.cli.result_file import force_option, result_path
from smarttac_can.host.result_file import result_file
from smarttac_can.vocabulary.objects import LIFTED

_LEVEL: Final = Placing(0.0, 0.0, 0.0, 0.0)


@click.command(
    epilog="\b\nExample:\n  smarttac calibrate weights.csv --certificate plate-1.json"
    " --interface socketcan --channel can0 --write"
)
@click.argument("plan", type=OLD_FILE)
@click.option("--certificate", type=result_path, required=True, help="JSON file for the results.")
@force_option()
@stimulator_options
@click.option(
    "--gravity",
    type=FiniteRange(9.7, 9.9),
    default=STANDARD_GRAVITY,
    show_default=True,
    help="At the place of the weighings in m/s^2.",
)
@click.option(
    "--rehearse",
    is_flag=True,
    help="Have a simulated plate put the weights on by itself; nothing is asked.",
)
@lockstep_option
@click.option("--write", is_flag=True, help="Set the calibration in the stimulator, and tare.")
def calibrate(
    *,
    plan: Path,
    certificate: Path,
    bus: BusChoice,
    node_id: int,
    plate_node: int | None,
    gravity: float,
    rehearse: bool,
    lockstep: bool,
    write: bool,
) -> None:
    """Calibrate the tribometer by the weights of PLAN, asking for one after the other.

    PLAN is CSV with mass_g,angle_deg,azimuth_deg,x_mm: a weight, the tilt of the plate, the
    direction in which it falls (0 along x, 90 along y), and where the weight is. A fit that leaves
    too much ends with 1, and changes nothing in the stimulator; the certificate says what.
    """
    _refuse_the_plan(certificate, plan)
    with plain_errors(), ExitStack() as stack:
        with plain_errors(ValueError):
            placings = read_plan(plan)
            with naming(plan, ValueError):
                require_two_directions(placings)
        file = stack.enter_context(result_file(certificate))
        stimulator = stack.enter_context(
            Stimulator.connect(
                node_id=node_id, plate_node_id=plate_node, lockstep=lockstep, **bus.options
            )
        )
        stimulator.claim()
        before = [stimulator.get(f"Calibration.{name}", "mm") for name in POSITIONS]
        weighings: list[Weighing] = []

        def do(placing: Placing, number: str = "") -> None:
            text = f"{number}{placing}"
            if rehearse:
                click.echo(text, err=True)
                stimulator.finger.put(placing, gravity)
            else:
                _ask(text)

        try:
            if rehearse and stimulator.get("Finger.Motion") != LIFTED:
                stimulator.finger.lift()
                stimulator.start_run()
            for number, placing in enumerate(placings, 1):
                weighings.append(weigh(stimulator, placing, partial(do, number=f"{number}: ")))
            do(_LEVEL)
            nulls = mean_gauges(stimulator)
        except (click.Abort, KeyboardInterrupt) as error:
            raise click.ClickException(
                f"interrupted after {len(weighings)} of {len(placings)} weighings: none is kept, "
                "and nothing was set in the stimulator"
            ) from error
        with plain_errors(ValueError):
            calibration = Calibration.fit(weighings, before, gravity)
        results: dict[str, Any] = {
            "version": __version__,
            "time": datetime.now(UTC).isoformat(timespec="seconds"),
            "plate_serial_number": round(stimulator.get("Calibration.Plate serial number")),
            "temperature_degC": stimulator.get("Plate temperature", "degC"),
            "gravity_m_s2": gravity,
            "weighings": [weighing.as_json() for weighing in weighings],
            "nulls_mN": [round(float(null) * 1e3, 3) for null in nulls],
            "calibration": calibration.as_json(),
            "written": {},
        }
        shortcomings = calibration.shortcomings()
        if write and not shortcomings:
            results["written"] = write_calibration(stimulator, calibration, nulls)
            stimulator.tare()
        file.write(json.dumps(results, indent=2) + "\n")
        _tell(calibration)
    if shortcomings:
        raise click.ClickException(
            one_line(f"not to be used: {'; '.join(shortcomings)}; {certificate} has all of it")
        )


def _refuse_the_plan(certificate: Path, plan: Path) -> None:
    """Refuse to write over the plan, under whatever name, also while the certificate is made."""
    for path in (
        certificate,
        certificate.resolve().with_name(f"{certificate.resolve().name}.part"),
    ):
        if path.exists() and path.samefile(plan):
            raise click.UsageError(f"--certificate {certificate} would take the place of the plan")


def _ask(what: str) -> None:
    click.prompt(f"{what}; Enter", default="", show_default=False, prompt_suffix=" ", err=True)


def _tell(calibration: Calibration) -> None:
    od = stimulator_od()
    for name, value in calibration.objects().items():
        click.echo(f"{name}: {value:.4f} {od[name].unit.symbol}".rstrip())
    names = (("Fx", "N"), ("Fy", "N"), ("Fn", "N"), ("x", "mm"))
    for (name, unit), rms in zip(names, calibration.rms, strict=True):
        if not np.isnan(rms):
            click.echo(f"residual of {name}: {rms:.4f} {unit} rms")
    click.echo(f"S3 to S6 show {calibration.scale:.4f} of the weights")

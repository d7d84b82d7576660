"""The command that judges a stimulator and its plate: ``selftest``."""

from __future__ import annotations

from contextlib import ExitStack
from math import isfinite
from pathlib import Path

import click

from smarttac_can import __version__
from smarttac_can.bench import Stimulator
from smarttac_can.bench.errors import in_shell_words
from smarttac_can.bench.self_test import Check
from smarttac_can.bench.self_test import selftest as judge
from smarttac_can.cli.options import BusChoice, stimulator_options
from smarttac_can.cli.plain_errors import one_line, plain_errors
from smarttac_can.cli.process import lockstep_option
from smarttac_can.cli.result_file import (
    force_option,
    json_file_option,
    opened_results,
    report_results,
)


@click.command(
    epilog="\b\nExamples:\n  smarttac selftest --interface socketcan --channel can0\n"
    "  smarttac selftest --interface socketcan --channel can0 --plate-node 33 --json selftest.json"
)
@stimulator_options
@lockstep_option
@json_file_option
@force_option()
def selftest(
    *,
    bus: BusChoice,
    node_id: int,
    plate_node: int | None,
    lockstep: bool,
    json_file: Path | None,
) -> None:
    """Judge timing, gauges, pick-up and resonance of a stimulator; 1 if a check fails.

    Nothing may rest on the plate: it vibrates with 0.5 um at most, and is left at 0 V on every way
    out, Ctrl-C included. Checks are told on stderr as they are made.
    """
    with plain_errors(), ExitStack() as stack:
        file = opened_results(stack, json_file)
        stimulator = stack.enter_context(
            Stimulator.connect(
                node_id=node_id, plate_node_id=plate_node, lockstep=lockstep, **bus.options
            )
        )
        serial = round(stimulator.get("Calibration.Plate serial number"))
        checks = judge(stimulator, lambda check: click.echo(_line(check), err=True))
        failed = [check for check in checks if not check.passed]
        results = {
            "version": __version__,
            "node_id": node_id,
            "plate_serial_number": serial,
            "passed": not failed,
            "checks": [check.as_json() for check in checks],
        }
        report_results(results, [_summary(checks, failed)], file)
    if failed:
        raise click.exceptions.Exit(1)


def _summary(checks: list[Check], failed: list[Check]) -> str:
    if not failed:
        return f"passed: {len(checks)} checks"
    names = ", ".join(check.name for check in failed)
    return f"FAILED: {len(failed)} of {len(checks)} checks: {names}"


def _line(check: Check) -> str:
    verdict = "ok    " if check.passed else "FAILED"
    if check.value is None:
        return one_line(f"{verdict}  {check.name}: {in_shell_words(check.text)}")
    low, high = (f"{bound:g}" if isfinite(bound) else "" for bound in (check.low, check.high))
    limits = low if low == high else f"{low}..{high}"
    return f"{verdict}  {check.name:<28} {check.value:>10.6g} {check.unit:<5} ({limits})"

"""The command that judges a device: ``conform``."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from contextlib import ExitStack, closing
from functools import partial
from pathlib import Path

import click

from smarttac_can.cli.options import EDS_FILE, NODE_ID, SECONDS, BusChoice, bus_options
from smarttac_can.cli.plain_errors import naming, plain_errors
from smarttac_can.cli.result_file import (
    force_option,
    json_file_option,
    opened_results,
    report_results,
    result_path,
)
from smarttac_can.conformance.case import Case, DeviceDescription, Failure
from smarttac_can.conformance.examiner import Examiner
from smarttac_can.conformance.general import differences
from smarttac_can.conformance.run import CASES, as_json, failed, line, markdown, run_cases, summary
from smarttac_can.host.files import read_eds_file, result_file


def _chosen(
    _ctx: click.Context, _param: click.Parameter, values: tuple[str, ...]
) -> Sequence[Case]:
    """Return the cases of numbers such as ``SDO-07`` and groups such as ``SDO``; all if none."""
    groups = dict.fromkeys(case.group for case in CASES)
    known = {case.number for case in CASES} | set(groups)
    for value in values:
        if value.upper() not in known:
            raise click.BadParameter(
                f"{value!r} is neither a case nor a group of cases; groups are {', '.join(groups)}"
            )
    wanted = {value.upper() for value in values} or known
    return [case for case in CASES if case.number in wanted or case.group in wanted]


@click.command(
    epilog="\b\nExamples:\n"
    "  smarttac conform --eds device.eds --node-id 5 --interface socketcan --channel can0\n"
    "  smarttac conform --eds device.eds --node-id 5 --case SDO --case PDO-09"
)
@click.option(
    "--eds",
    type=EDS_FILE,
    required=True,
    help="Data sheet of the device.",
)
@click.option("--node-id", type=NODE_ID, required=True)
@bus_options
@click.option(
    "--timeout",
    type=SECONDS,
    default=0.3,
    show_default=True,
    help="Longest time for an answer in s; all other times are multiples of it.",
)
@click.option(
    "--case",
    "cases",
    multiple=True,
    callback=_chosen,
    metavar="ID",
    help="Case such as SDO-07, or group such as SDO; may come several times.",
)
@click.option("--report", type=result_path, help="Markdown file for the report.")
@json_file_option
@force_option()
def conform(
    *,
    eds: Path,
    node_id: int,
    bus: BusChoice,
    timeout: float,
    cases: Sequence[Case],
    report: Path | None,
    json_file: Path | None,
) -> None:
    """Judge a CANopen device by its data sheet, and leave with 1 if a case fails.

    The device should be alone on the bus. It is reset before and after each case, and what is
    writable is written: disconnect what must not move.
    """
    with plain_errors(), ExitStack() as stack:
        file = opened_results(stack, json_file)
        page = None if report is None else stack.enter_context(result_file(report))
        say: Callable[[str], None] = partial(click.echo, err=file is sys.stdout)
        with naming(eds):
            sheet = DeviceDescription(read_eds_file(eds), node_id)
        with closing(bus.open()) as connection:
            examiner = Examiner(connection, sheet, timeout=timeout)
            try:
                examiner.require_device()
            except Failure as failure:
                text = f"node {node_id} does not answer on {bus.where}: {failure}"
                raise click.ClickException(text) from failure
            if others := differences(examiner):
                text = f"{eds.name} may be of another device than node {node_id}"
                click.echo(f"{text}: {', '.join(others)}", err=True)
            results = run_cases(examiner, cases, lambda result: say(line(result)))
        device = f"node {node_id} by {eds.name}"
        say(summary(results))
        if page is not None:
            page.write(markdown(results, device))
        report_results(as_json(results, device), (), file)
    if failed(results):
        raise click.exceptions.Exit(1)

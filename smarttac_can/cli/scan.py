"""The command that lists what is on a bus: ``scan``."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import click

from smarttac_can.cli.options import (
    OLD_FILE,
    BusChoice,
    bus_options,
    closing_network,
    timeout_option,
)
from smarttac_can.cli.plain_errors import naming, one_line, plain_errors
from smarttac_can.cli.result_file import (
    force_option,
    json_option,
    opened_results,
    report_results,
)
from smarttac_can.commissioning.scan import FoundDevice
from smarttac_can.commissioning.scan import scan as scan_bus
from smarttac_can.host.files import read_eds, read_eds_file
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.od.eds import load_eds

PACKAGED = ("stimulator.eds", "plate.eds")
_HEAD = ("node", "state", "name", "vendor", "product", "revision", "serial", "EDS")


@click.command(
    epilog="\b\nExamples:\n  smarttac scan --interface socketcan --channel can0\n"
    "  smarttac scan --interface socketcan --channel can0 --eds drive.eds --json"
)
@bus_options
@timeout_option
@click.option(
    "--eds",
    "eds_files",
    multiple=True,
    type=OLD_FILE,
    help="Compare with this EDS, too.",
)
@json_option
@force_option()
def scan(
    bus: BusChoice, timeout: float, eds_files: tuple[Path, ...], json_file: Path | None
) -> None:
    """List the devices on a bus with state, identity and the EDS that describes them.

    Devices with a node-ID are found by SDO and heartbeat, those without one by LSS fastscan. A
    node-ID of two devices is an error, exit code 1, and named on stderr.
    """
    with plain_errors(), ExitStack() as stack:
        results = opened_results(stack, json_file)
        texts = {name: read_eds(name) for name in PACKAGED}
        texts |= {str(path): read_eds_file(path) for path in eds_files}
        known = {name: _load(name, text) for name, text in texts.items()}
        with closing_network(bus) as network:
            found = scan_bus(network, known, timeout)
        lines = _lines(found) if found else []
        report_results([_row(device) for device in found], lines, results)
    if not found:
        raise click.ClickException(f"no device answers on {bus.where}")
    doubled = [device.node_id for device in found if device.doubled]
    for node_id in doubled:
        click.echo(
            f"node {node_id}: more than one device has this node-ID, and the row is of either; "
            "give one of them another by LSS or --node-id",
            err=True,
        )
    if doubled:
        raise SystemExit(1)


def _lines(found: list[FoundDevice]) -> Iterator[str]:
    lines = [_HEAD, *(_cells(device) for device in found)]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    for line in lines:
        padded = (cell.ljust(width) for cell, width in zip(line, widths, strict=True))
        yield "  ".join(padded).rstrip()


def _load(name: str, text: str) -> ObjectDictionary:
    with naming(name):
        return load_eds(text, 1)


def _row(device: FoundDevice) -> dict[str, object]:
    identity = None if device.identity is None else device.identity._asdict()
    return {**device._asdict(), "identity": identity}


def _cells(device: FoundDevice) -> tuple[str, ...]:
    numbers = device.identity
    return (
        "-" if device.node_id is None else f"{device.node_id}",
        device.state,
        one_line(device.name) or "-",
        *(("-",) * 4 if numbers is None else [f"{number:08X}" for number in numbers]),
        device.eds or "-",
    )

"""The commands about EDS files."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from datetime import datetime
from importlib.util import find_spec
from pathlib import Path
from typing import TypeVar

import click

from smarttac_can.cli.options import (
    EDS_FILE,
    NODE_ID,
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
    result_path,
)
from smarttac_can.cli.scan import PACKAGED
from smarttac_can.commissioning.dcf import make_dcf
from smarttac_can.commissioning.default_reads import compare_reads
from smarttac_can.host.files import (
    MAX_EDS_BYTES,
    read_bounded,
    read_eds,
    read_eds_file,
    result_file,
)
from smarttac_can.od.cia import IDENTITY
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.od.eds import load_eds
from smarttac_can.od.eds_check import check_eds
from smarttac_can.od.finding import shown
from smarttac_can.od.ini import read_sections
from smarttac_can.od.object_reference import LEGEND, object_reference
from smarttac_can.vocabulary.meanings import EMERGENCIES, FIELDS

_Made = TypeVar("_Made")
_VENDOR_AND_PRODUCT = (1, 2)
"""Sub-indices of the identity object."""

eds_file = click.argument("file", type=EDS_FILE, metavar="EDS")
_output_option = click.option(
    "--output",
    type=result_path,
    help="File to write instead of stdout.",
)


@click.group()
def eds() -> None:
    """Check an EDS, and make documents and files for other tools of it.

    EDS is a file, or the name of a node of this package: stimulator or plate.
    """


@eds.command(
    epilog="\b\nExamples:\n  smarttac eds check drive.eds\n"
    "  smarttac eds check plate --device --node-id 33 --interface socketcan --channel can0"
)
@eds_file
@click.option("--device", is_flag=True, help="Compare what a device on the bus reads, too.")
@click.option("--node-id", type=NODE_ID, help="Node-ID of that device.")
@timeout_option
@bus_options
@json_option
@force_option()
def check(
    file: Path,
    device: bool,
    node_id: int | None,
    timeout: float,
    bus: BusChoice,
    json_file: Path | None,
) -> None:
    """Check an EDS by the rules of CiA 306 and CiA 301; errors end with exit code 1.

    With --device every object of a device is read, and compared with the default of the EDS.
    """
    if device and node_id is None:
        raise click.UsageError("--device needs --node-id")
    if node_id is not None and not device:
        raise click.UsageError("--node-id is that of a --device: none is to be compared")
    with plain_errors(), ExitStack() as stack:
        results = opened_results(stack, json_file)
        text = read_eds_file(file)
        findings = check_eds(text, file.name)
        if device and node_id is not None:
            od = _made(file, lambda text: load_eds(text, node_id))
            with closing_network(bus) as network:
                findings += compare_reads(network, od, read_sections(text, []), timeout)
        rows = [
            {"section": shown(f.section), "message": f.message, "error": f.error} for f in findings
        ]
        lines = [one_line(f"{file}: {finding}") for finding in findings]
        report_results({"file": str(file), "findings": rows}, lines, results)
    if any(finding.error for finding in findings):
        raise SystemExit(1)


@eds.command(epilog="Example: smarttac eds show stimulator --output stimulator.eds")
@eds_file
@_output_option
@force_option()
def show(file: Path, output: Path | None) -> None:
    """Write the EDS itself, byte for byte, for a master that wants the file."""
    with plain_errors():
        data = read_bounded(file, MAX_EDS_BYTES)
        if output is None:
            click.echo(data, nl=False)
        else:
            with result_file(output) as made:
                made.buffer.write(data)


@eds.command(epilog="Example: smarttac eds doc plate --output plate.md")
@eds_file
@_output_option
@force_option()
def doc(file: Path, output: Path | None) -> None:
    """Write the reference of all PDOs and objects in Markdown."""
    with plain_errors():
        head = (f"# {file.name}", "", LEGEND, "")
        _write(_made(file, lambda text: "\n".join([*head, *object_reference(text)])), output)


@eds.command(epilog="Example: smarttac eds dbc stimulator --node-id 32 --output run.dbc")
@eds_file
@click.option("--node-id", type=NODE_ID, default=1, show_default=True)
@_output_option
@force_option()
def dbc(file: Path, node_id: int, output: Path | None) -> None:
    """Write a DBC of the default PDOs, EMCY and heartbeat, with scales and units, for analysers.

    Of stimulator and plate it has names for modes, states, bits of the words, and emergencies.
    """
    if find_spec("cantools") is None:
        raise click.ClickException("a DBC needs cantools: pip install 'smarttac-can[dbc]'")
    from smarttac_can.commissioning.dbc import NO_NAMES, Names, make_dbc  # noqa: PLC0415 - an extra

    def made(text: str) -> str:
        od = load_eds(text, node_id)
        return make_dbc(od, Names(FIELDS, EMERGENCIES) if _is_ours(od) else NO_NAMES)

    with plain_errors():
        _write(_made(file, made), output)


def _is_ours(od: ObjectDictionary) -> bool:
    """Tell whether an EDS is that of a stimulator or plate, by vendor-ID and product code."""
    ours = [load_eds(read_eds(name), od.node_id) for name in PACKAGED]
    return any(
        all(od.number(IDENTITY, sub) == known.number(IDENTITY, sub) for sub in _VENDOR_AND_PRODUCT)
        for known in ours
    )


def _values(_ctx: click.Context, _param: click.Parameter, given: tuple[str, ...]) -> dict[str, str]:
    values = {}
    for text in given:
        name, separator, value = text.partition("=")
        if not separator or not name or not value:
            raise click.BadParameter(f"{text!r} is not NAME=VALUE")
        values[name.strip()] = value.strip()
    return values


@eds.command(
    epilog="Example: smarttac eds dcf stimulator --node-id 32 --bitrate 1000000"
    " --set 1017=500 --set 'Limit.Voltage=80 V' --output stimulator-32.dcf"
)
@eds_file
@click.option("--node-id", type=NODE_ID, required=True)
@click.option(
    "--bitrate",
    type=click.IntRange(min=1),
    required=True,
    help="Bit rate in bit/s.",
)
@click.option(
    "--set",
    "values",
    multiple=True,
    metavar="NAME=VALUE",
    callback=_values,
    help="Value of an object, by name (Limit.Voltage) or section (1017, 2010sub1): raw, or with a"
    " unit as in '80 V'.",
)
@_output_option
@force_option()
def dcf(
    file: Path, node_id: int, bitrate: int, values: dict[str, str], output: Path | None
) -> None:
    """Write the DCF of one device: the EDS with its node-ID, bit rate and values."""
    with plain_errors():
        made = _made(
            file,
            lambda text: make_dcf(
                text,
                node_id=node_id,
                bit_rate=bitrate,
                values=values,
                eds_name=file.name,
                dcf_name=output.name if output is not None else f"{file.stem}.dcf",
                now=datetime.now(),
            ),
        )
        _write(made, output)


def _made(file: Path, make: Callable[[str], _Made]) -> _Made:
    """Read an EDS file and make a document of it.

    Raises
    ------
    click.ClickException
        If the document cannot be made; the message begins with the name of the file.
    """
    with naming(file, ValueError):
        return make(read_eds_file(file))


def _write(text: str, output: Path | None) -> None:
    """Write a text to a file, or to stdout if none is given, ending in a new line."""
    if output is None:
        click.echo(text, nl=not text.endswith("\n"))
    else:
        with result_file(output) as made:
            made.write(text)

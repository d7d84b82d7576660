"""Commands for any CANopen device: ``scan``, ``lss``, ``eds`` and ``conform``."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing
from datetime import datetime
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Final, TypeVar

import click

from smarttac_can.canopen.commissioning.dcf import bit_rates, make_dcf, save_dcf
from smarttac_can.canopen.commissioning.node_ids import Identity, assign_node_id
from smarttac_can.canopen.commissioning.scan import FoundDevice
from smarttac_can.canopen.commissioning.scan import scan as scan_bus
from smarttac_can.canopen.commissioning.values import (
    compare_reads,
    compare_values,
    read_device_eds,
    read_values,
    stated_values,
    take_files,
    write_dcf,
)
from smarttac_can.canopen.conformance.case import Case, DeviceDescription, Failure
from smarttac_can.canopen.conformance.examiner import TIMEOUT_S, Examiner
from smarttac_can.canopen.conformance.general import differences
from smarttac_can.canopen.conformance.run import (
    CASES,
    as_json,
    junit,
    known_deviations,
    line,
    markdown,
    run_cases,
    summary,
    unexpected,
)
from smarttac_can.canopen.master.errors import NodeNotFoundError
from smarttac_can.canopen.od import cia
from smarttac_can.canopen.od.dictionary import ObjectDictionary
from smarttac_can.canopen.od.eds import (
    COMMISSIONING,
    Sections,
    load_eds,
    node_id_of,
    read_sections,
    write_out,
)
from smarttac_can.canopen.od.eds_check import check_eds, shown
from smarttac_can.canopen.od.object_reference import LEGEND, object_reference
from smarttac_can.cli.shared import (
    EDS_FILE,
    NODE_ID,
    OLD_FILE,
    PACKAGED,
    SECONDS,
    BusChoice,
    WholeRange,
    bus_options,
    closing_network,
    force_option,
    is_ours,
    json_options,
    load_file,
    naming,
    one_line,
    plain_errors,
    reporting,
    result_path,
    timeout_option,
)
from smarttac_can.host.files import (
    MAX_EDS_BYTES,
    decode_eds,
    read_bounded,
    read_eds,
    read_eds_file,
    result_file,
)
from smarttac_can.host.terminal import progress_bar
from smarttac_can.vocabulary.meanings import EMERGENCIES, FIELDS

_LONG_S: Final = 1.0
"""Time in s after which the progress of a transfer is shown."""
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
    help="EDS of a device, in addition to the packaged ones.",
)
@json_options(bare=True)
def scan(
    bus: BusChoice, timeout: float, eds_files: tuple[Path, ...], json_file: Path | None
) -> None:
    """List the devices on a bus with state, identity and the EDS that describes them.

    Devices with a node-ID are found by SDO and heartbeat, devices without one by LSS fastscan. If
    two devices have the same node-ID, it is printed on stderr, and the exit code is 1.
    """
    with reporting(json_file) as write_results:
        texts = {name: read_eds(name) for name in PACKAGED}
        texts |= {str(path): read_eds_file(path) for path in eds_files}
        known = {name: _load(name, text) for name, text in texts.items()}
        with closing_network(bus) as network, progress_bar("fastscan", _LONG_S) as progress:
            found = scan_bus(network, known, timeout, progress)
        lines = _lines(found) if found else []
        write_results([_row(device) for device in found], lines)
    if not found:
        raise click.ClickException(f"no device answers on {bus.where}")
    doubled = [device.node_id for device in found if device.doubled]
    for node_id in doubled:
        click.echo(
            f"node {node_id}: more than one device has this node-ID, and the row may show any of "
            "them; give one of them another by LSS or --node-id",
            err=True,
        )
    if doubled:
        raise SystemExit(1)


def _lines(found: list[FoundDevice]) -> Iterator[str]:
    lines = [_HEAD, *(_cells(device) for device in found)]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    for cells in lines:
        padded = (cell.ljust(width) for cell, width in zip(cells, widths, strict=True))
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


def _identity(_ctx: click.Context, _param: click.Parameter, text: str | None) -> Identity | None:
    if text is None:
        return None
    try:
        numbers = [int(part, 16) for part in text.split(":")]
    except ValueError:
        numbers = []
    if len(numbers) != len(Identity._fields) or not all(
        0 <= number < 1 << 32 for number in numbers
    ):
        raise click.BadParameter(
            f"{text!r} is not VENDOR:PRODUCT:REVISION:SERIAL, four hexadecimal numbers of 32 bits"
        )
    return Identity(*numbers)


@click.command(
    epilog="\b\nExamples:\n  smarttac lss 12 --store --interface socketcan --channel can0\n"
    "  smarttac lss 12 --identity 0:534D5401:10000:1 --interface socketcan --channel can0"
)
@click.argument("node_id", type=NODE_ID)
@click.option(
    "--identity",
    callback=_identity,
    metavar="V:P:R:S",
    help="Vendor, product, revision and serial number in hexadecimal. Without this option the "
    "command finds the device by fastscan.",
)
@click.option(
    "--store", is_flag=True, help="Store it in the device, so that it stays after a power cut."
)
@click.option(
    "--force", is_flag=True, help="Set it even if a device already answers with that node-ID."
)
@bus_options
@timeout_option
def lss(
    node_id: int,
    identity: Identity | None,
    store: bool,
    force: bool,
    bus: BusChoice,
    timeout: float,
) -> None:
    """Give the node-ID NODE_ID to the device with --identity, or to a device without a node-ID.

    If another device already uses this node-ID, the command refuses it.

    A device that has a node-ID already is reset (NMT reset communication) to take the new one.
    """
    with plain_errors():
        with closing_network(bus) as network, progress_bar("fastscan", _LONG_S) as progress:
            assigned = assign_node_id(
                network,
                node_id,
                identity=identity,
                store=store,
                timeout=timeout,
                force=force,
                progress=progress,
            )
        if not assigned.booted:
            raise NodeNotFoundError(
                f"{assigned.identity} has taken node-ID {node_id}, but sent no boot-up within "
                f"{timeout:g} s"
            )
    before = "none" if assigned.previous is None else f"{assigned.previous}"
    stored = ", stored" if store else ""
    click.echo(f"{assigned.identity} has node-ID {node_id}{stored}; it had {before}")


_Made = TypeVar("_Made")

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
@click.option("--device", is_flag=True, help="Compare the EDS with a device on the bus, too.")
@click.option("--node-id", type=NODE_ID, help="Node-ID of that device.")
@timeout_option
@bus_options
@json_options(bare=True)
def check(
    file: Path,
    device: bool,
    node_id: int | None,
    timeout: float,
    bus: BusChoice,
    json_file: Path | None,
) -> None:
    """Check an EDS by the rules of CiA 306 and CiA 301; after an error the exit code is 1.

    With --device every object of a device is read, and compared with the default of the EDS.
    """
    if device and node_id is None:
        raise click.UsageError("--device needs --node-id")
    if node_id is not None and not device:
        raise click.UsageError("--node-id needs --device")
    with reporting(json_file) as write_results:
        text = read_eds_file(file)
        findings = check_eds(text, file.name)
        if device and node_id is not None:
            od = load_file(file, node_id)
            with closing_network(bus) as network, progress_bar("reading", _LONG_S) as progress:
                findings += compare_reads(
                    network, od, _written_out(text), timeout, progress=progress
                )
        rows = [
            {"section": shown(f.section), "message": f.message, "error": f.error} for f in findings
        ]
        lines = [one_line(f"{file}: {finding}") for finding in findings]
        write_results({"file": str(file), "findings": rows}, lines)
    if any(finding.error for finding in findings):
        raise SystemExit(1)


@eds.command(
    epilog="Example: smarttac eds load stimulator-32.dcf --interface socketcan --channel can0"
)
@click.argument("file", type=OLD_FILE, metavar="DCF")
@click.option("--node-id", type=NODE_ID, help="Node-ID, for a DCF without one.")
@click.option(
    "--any-device", is_flag=True, help="Write also if vendor or product differ from the DCF."
)
@timeout_option
@bus_options
@json_options(bare=True)
def load(
    *,
    file: Path,
    node_id: int | None,
    any_device: bool,
    timeout: float,
    bus: BusChoice,
    json_file: Path | None,
) -> None:
    """Write the values of a DCF to a device, and read them back.

    The identity of the device is compared first. Communication parameters are written by the
    procedures of CiA 301. If an entry of the DCF names a DownloadFile, the content of that file is
    written to the entry. The device stores nothing permanently: write 1010h for that. If the device
    refuses a value, the exit code is 1.
    """
    with reporting(json_file) as write_results:
        with naming(file, ValueError):
            text = read_eds_file(file)
            own = node_id_of(read_sections(text, []), node_id)
            if own is None:
                raise click.UsageError(f"{file} has no node-ID: give --node-id")
            od, sections = load_eds(text, own), _written_out(text)
            values = stated_values(od, sections)
            if not values:
                raise ValueError("it has no values for the device: it is an EDS, not a DCF")
            take_files(values, sections, partial(_file_beside, file))
        with closing_network(bus) as network, progress_bar("writing", _LONG_S) as progress:
            found = write_dcf(
                network, od, sections, timeout, any_device=any_device, progress=progress
            )
            findings = list(found)
        wrong = [finding for finding in findings if finding.error]
        rows = [{"section": shown(f.section), "message": f.message} for f in wrong]
        lines = [one_line(f"{file}: {finding}") for finding in findings]
        done = f"node {od.node_id}: {len(values)} values, {len(wrong)} refused or different"
        made = {"file": str(file), "node_id": od.node_id, "values": len(values), "findings": rows}
        write_results(made, [*lines, done])
    if wrong:
        raise SystemExit(1)


def _file_beside(dcf: Path, name: str) -> bytes:
    """Return the content of a file that a DCF names; one in another folder is refused."""
    path = dcf.parent / name.replace("\\", "/")
    if dcf.parent.resolve() not in path.resolve().parents:
        raise ValueError(f"DownloadFile={name} is not in the folder of the DCF: copy it there")
    return read_bounded(path, MAX_EDS_BYTES)


@eds.command(
    epilog="\b\nExamples:\n"
    "  smarttac eds save --node-id 5 drive-5.dcf --eds drive.eds --interface socketcan"
    " --channel can0\n"
    "  smarttac eds save --node-id 32 stimulator-32.dcf --interface socketcan --channel can0"
)
@click.argument("file", type=result_path, metavar="DCF")
@click.option("--node-id", "--node", type=NODE_ID, required=True, help="Node-ID of the device.")
@click.option(
    "--eds", type=EDS_FILE, help="EDS of the device.  [default: read it from 1021h of the device]"
)
@click.option("--any-device", is_flag=True, help="Save also if vendor or product differ.")
@timeout_option
@bus_options
@json_options(bare=True)
def save(
    *,
    file: Path,
    node_id: int,
    eds: Path | None,
    any_device: bool,
    timeout: float,
    bus: BusChoice,
    json_file: Path | None,
) -> None:
    """Save the values of a device as a DCF, which 'smarttac eds load' writes back.

    The DCF has every value that can be read and written. A value that cannot be read is printed,
    and is a comment in the DCF; the exit code is then 1.
    """
    with reporting(json_file) as write_results, ExitStack() as stack:
        name = f"{cia.STORE_EDS:X}h" if eds is None else eds.name
        text = "" if eds is None else read_eds_file(eds)
        network = stack.enter_context(closing_network(bus))
        if eds is None:
            text = decode_eds(read_device_eds(network, node_id, timeout))
        with naming(name, ValueError):
            node_id_of(read_sections(text, []), node_id)
            od, sections = load_eds(text, node_id), _written_out(text)
        with progress_bar("reading", _LONG_S) as progress:
            found = read_values(
                network, od, sections, timeout, any_device=any_device, progress=progress
            )
        made, left = save_dcf(
            text,
            found.values,
            od=od,
            bit_rate=bus.bitrate,
            serial=found.serial,
            unread=[one_line(finding) for finding in found.unread],
            eds_name=name,
            dcf_name=file.name,
            now=datetime.now(),
        )
        with result_file(file) as output:
            output.write(made)
        unread = [one_line(finding) for finding in found.unread if finding.error]
        unread += [f"{e.index:04x}sub{e.subindex:x}: its value has no form in a DCF" for e in left]
        count = len(found.values) - len(left)
        done = f"node {node_id}: {count} values saved, {len(unread)} not"
        results = {"file": str(file), "node_id": node_id, "values": count, "unread": unread}
        write_results(results, [*(f"{file}: {line}" for line in unread), done])
    if unread:
        raise SystemExit(1)


@eds.command(
    epilog="\b\nExamples:\n  smarttac eds diff before.dcf after.dcf\n"
    "  smarttac eds diff drive-5.dcf --interface socketcan --channel can0"
)
@click.argument("file", type=EDS_FILE, metavar="DCF")
@click.argument("other", type=EDS_FILE, required=False, metavar="[OTHER]")
@click.option("--node-id", "--node", type=NODE_ID, help="Node-ID, for a file without one.")
@timeout_option
@bus_options
@json_options(bare=True)
def diff(
    *,
    file: Path,
    other: Path | None,
    node_id: int | None,
    timeout: float,
    bus: BusChoice,
    json_file: Path | None,
) -> None:
    """Compare two DCFs, or a DCF and its device; if they differ, the exit code is 1.

    Each line has an object, its value in the first DCF, and its value in OTHER or in the device.
    """
    with reporting(json_file) as write_results:
        od = load_file(file, node_id)
        lines: list[str] = []
        if other is None:
            sections = _written_out(read_eds_file(file))
            if node_id is None and node_id_of(sections) is None:
                raise click.UsageError(f"{file} has no node-ID: give --node-id, or another file")
            with closing_network(bus) as network, progress_bar("reading", _LONG_S) as progress:
                found = read_values(network, od, sections, timeout, progress=progress)
            first = {entry: entry.default for entry in found.values}
            differences = compare_values(first, found.values)
            lines += [str(finding) for finding in found.unread]
        else:
            second = load_file(other, node_id, od.node_id)
            both = [(entry, entry.default) for entry in second]
            differences = compare_values({e: e.default for e in od}, dict(both))
            lines += _commissioned_otherwise(file, other)
        lines += [str(difference) for difference in differences]
        rows = [
            difference._asdict()
            | {"first": _plain(difference.first), "second": _plain(difference.second)}
            for difference in differences
        ]
        write_results({"differences": rows}, [one_line(line) for line in lines])
    if lines:
        raise SystemExit(1)


def _commissioned_otherwise(file: Path, other: Path) -> Iterator[str]:
    """Yield the keys of node and network that differ in two DCFs."""
    first, second = (
        next((sections[name] for name in COMMISSIONING if name in sections), {})
        for sections in (read_sections(read_eds_file(path), []) for path in (file, other))
    )
    for key in sorted({*first, *second}):
        if (one := first.get(key, "-")) != (two := second.get(key, "-")):
            yield f"{key}: {one} | {two}"


def _plain(value: object) -> object:
    return value.hex(" ") if isinstance(value, bytes) else value


@eds.command(epilog="Example: smarttac eds show stimulator --output stimulator.eds")
@eds_file
@_output_option
@force_option()
def show(file: Path, output: Path | None) -> None:
    """Write the EDS itself, byte for byte, for a master that needs the file."""
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
@click.option(
    "--node-id", type=NODE_ID, help="Node-ID of the device. Without it, that of a DCF, else 1."
)
@_output_option
@force_option()
def dbc(file: Path, node_id: int | None, output: Path | None) -> None:
    """Write a DBC of the default PDOs, EMCY and heartbeat, with scales and units, for analysers.

    For stimulator and plate the DBC also names modes, states, status bits and emergency codes.
    """
    if find_spec("cantools") is None:
        raise click.ClickException("a DBC needs cantools: pip install 'smarttac-can[dbc]'")
    from smarttac_can.canopen.commissioning.dbc import NO_NAMES, Names, make_dbc  # noqa: PLC0415 - an extra

    with plain_errors():
        od = load_file(file, node_id)
        with naming(file, ValueError):
            made = make_dbc(od, Names(FIELDS, EMERGENCIES) if is_ours(od) else NO_NAMES)
        _write(made, output)


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
@click.option("--node-id", type=NODE_ID, required=True, help="Node-ID of the device.")
@click.option(
    "--bitrate",
    type=WholeRange(min=1),
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
        if not bit_rates(_made(file, lambda text: load_eds(text, node_id))):
            click.echo(f"{file}: it lists no bit rate, so {bitrate} bit/s is not checked", err=True)
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
        The document cannot be made; the message begins with the name of the file.
    """
    with naming(file, ValueError):
        return make(read_eds_file(file))


def _written_out(text: str) -> Sections:
    sections = read_sections(text, [])
    write_out(sections)
    return sections


def _write(text: str, output: Path | None) -> None:
    if output is None:
        click.echo(text, nl=not text.endswith("\n"))
    else:
        with result_file(output) as made:
            made.write(text)


def _chosen(
    _ctx: click.Context, _param: click.Parameter, values: tuple[str, ...]
) -> Sequence[Case]:
    """Return the cases with numbers such as ``SDO-07`` or groups such as ``SDO``; all if none."""
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
    help="EDS of the device.",
)
@click.option("--node-id", type=NODE_ID, required=True, help="Node-ID of the device.")
@bus_options
@click.option(
    "--timeout",
    type=SECONDS,
    default=TIMEOUT_S,
    show_default=True,
    help="Longest time for an answer in s, where CiA 301 gives no time. A start may take 2.5 times "
    "as long.",
)
@click.option(
    "--case",
    "cases",
    multiple=True,
    callback=_chosen,
    metavar="ID",
    help="Case such as SDO-07, or group such as SDO; may be given again.",
)
@click.option("--report", type=result_path, help="Markdown file for the report.")
@click.option("--junit", "junit_file", type=result_path, help="JUnit XML file, for a CI service.")
@click.option(
    "--known",
    type=OLD_FILE,
    help="TOML file of known deviations, CASE = 'reason': these may fail.",
)
@json_options()
def conform(
    *,
    eds: Path,
    node_id: int,
    bus: BusChoice,
    timeout: float,
    cases: Sequence[Case],
    report: Path | None,
    junit_file: Path | None,
    known: Path | None,
    json_file: Path | None,
) -> None:
    """Test a CANopen device by its EDS; if a case fails, the exit code is 1.

    The device should be alone on the bus. It is reset before each case and at the end, and all
    writable objects are written: disconnect everything that must not move. If a device refuses a
    request with an unusual abort code, the case passes with a remark. Known deviations may fail;
    if one of them passes, the exit code is 1.
    """
    with reporting(json_file) as write_results, ExitStack() as stack:
        page = None if report is None else stack.enter_context(result_file(report))
        xml = None if junit_file is None else stack.enter_context(result_file(junit_file))
        deviations = {}
        if known is not None:
            with naming(known, ValueError):
                deviations = known_deviations(known.read_text(encoding="utf-8"))
        show: Callable[[str], None] = partial(click.echo, err=json_file == Path("-"))
        with naming(eds):
            node_id_of(read_sections(read_eds_file(eds), []), node_id)
            sheet = DeviceDescription(read_eds_file(eds), node_id)
        with closing(bus.open()) as connection:
            examiner = Examiner(connection, sheet, timeout=timeout)
            try:
                examiner.require_device()
            except Failure as failure:
                text = f"node {node_id} does not answer on {bus.where}: {failure}"
                raise click.ClickException(text) from failure
            if others := differences(examiner):
                text = f"{eds.name} may describe another device than node {node_id}"
                click.echo(f"{text}: {', '.join(others)}", err=True)
            results = run_cases(examiner, cases, lambda result: show(line(result)))
        device = f"node {node_id} by {eds.name}"
        show(summary(results))
        if page is not None:
            page.write(markdown(results, device))
        if xml is not None:
            xml.write(junit(results, device, deviations))
        write_results(as_json(results, device), ())
        wrong = unexpected(results, deviations)
        if known is not None:
            for text in wrong:
                click.echo(text, err=True)
    if wrong:
        raise click.exceptions.Exit(1)

"""Command ``sdo``: read or write one object of any CANopen device."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import click
from canopen.sdo.exceptions import SdoAbortedError, SdoError

from smarttac_can.canopen.commissioning.dcf import find_entry, value_of
from smarttac_can.canopen.master.errors import NodeNotFoundError, RefusedError
from smarttac_can.canopen.master.sdo_client import SharedSdoClient
from smarttac_can.canopen.od.cia import Abort
from smarttac_can.canopen.od.data_types import pack, unpack
from smarttac_can.canopen.od.dictionary import ObjectDictionary
from smarttac_can.canopen.od.entry import Entry
from smarttac_can.cli.shared import (
    EDS_FILE,
    NODE_ID,
    BusChoice,
    bus_options,
    closing_network,
    is_ours,
    json_options,
    load_file,
    naming,
    one_line,
    reporting,
    timeout_option,
)
from smarttac_can.vocabulary.meanings import FIELDS, meaning

_ADDRESS: Final = re.compile(
    r"(?:0x)?([0-9a-f]{4})h?(?:(?:sub|:)(?:0x)?([0-9a-f]{1,2})h?)?", re.IGNORECASE
)
"""Index and sub-index, both hexadecimal: 1018, 1018sub1, 1018h:1, 0x1018:0x01."""


@click.group()
def sdo() -> None:
    """Read or write one object of any CANopen device.

    OBJECT is its name by the EDS, as Limit.Voltage, or index and sub-index in hexadecimal, as 1017
    or 2010sub1.
    """


@sdo.command(
    epilog="\b\nExamples:\n  smarttac sdo read 32 Limit.Voltage --eds stimulator --channel can0\n"
    "  smarttac sdo read 5 1018sub1 --interface socketcan --channel can0 --json"
)
@click.argument("node_id", type=NODE_ID, metavar="NODE")
@click.argument("name", metavar="OBJECT")
@click.option("--eds", type=EDS_FILE, help="EDS of the device; without it, only bytes are shown.")
@timeout_option
@bus_options
@json_options(bare=True)
def read(
    *,
    node_id: int,
    name: str,
    eds: Path | None,
    timeout: float,
    bus: BusChoice,
    json_file: Path | None,
) -> None:
    """Read an object, and show its value with the unit."""
    with reporting(json_file) as write_results:
        od, entry = _entry(eds, node_id, name)
        index, subindex = _address(name) if entry is None else (entry.index, entry.subindex)
        where = _named(index, subindex, entry)
        with closing_network(bus) as network, _errors(node_id, f"read {where}"):
            client = SharedSdoClient(network, node_id, timeout)
            data = client.upload(index, subindex)
        row: dict[str, object] = {"node_id": node_id, "index": index, "subindex": subindex}
        row["bytes"] = data.hex(" ")
        text = row["bytes"]
        if entry is not None and od is not None:
            value = unpack(entry.data_type, data)
            text = meaning(entry, value, FIELDS if is_ours(od) else {})
            row |= {"name": entry.name, "value": _plain(value), "text": text}
            row |= {"unit": entry.unit.symbol, "in_unit": _in_unit(entry, value)}
        write_results(row, [one_line(f"{where} = {text}")])


@sdo.command(
    epilog="\b\nExamples:\n  smarttac sdo write 32 Limit.Voltage '80 V' --eds stimulator\n"
    "  smarttac sdo write 5 1017 500 --eds drive.eds --interface socketcan --channel can0"
)
@click.argument("node_id", type=NODE_ID, metavar="NODE")
@click.argument("name", metavar="OBJECT")
@click.argument("value")
@click.option("--eds", type=EDS_FILE, required=True, help="EDS of the device.")
@timeout_option
@bus_options
def write(
    *, node_id: int, name: str, value: str, eds: Path, timeout: float, bus: BusChoice
) -> None:
    """Write VALUE to an object: raw as in an EDS, or with a unit as in '80 V'.

    A value outside the limits of the EDS is refused before it is sent.
    """
    with reporting(None) as write_results:
        od, entry = _entry(eds, node_id, name)
        with naming(eds, ValueError):
            if od is None or entry is None:
                raise ValueError(f"{name} is not in the EDS")
            raw = value_of(entry, value, node_id)
        where = _named(entry.index, entry.subindex, entry)
        with closing_network(bus) as network, _errors(node_id, f"write {value} to {where}"):
            client = SharedSdoClient(network, node_id, timeout)
            client.download(entry.index, entry.subindex, pack(entry.data_type, raw))
        text = meaning(entry, raw, FIELDS if is_ours(od) else {})
        write_results({}, [one_line(f"{where} = {text}")])


def _entry(
    eds: Path | None, node_id: int, name: str
) -> tuple[ObjectDictionary | None, Entry | None]:
    """Return the object dictionary and the entry of a name, or of an index that is in the EDS."""
    if eds is None:
        return None, None
    od = load_file(eds, node_id)
    found = _ADDRESS.fullmatch(name)
    if found is not None and name not in od:
        return od, od.get(*_address(name))
    with naming(eds, ValueError):
        return od, find_entry(od, name)


def _address(name: str) -> tuple[int, int]:
    found = _ADDRESS.fullmatch(name)
    if found is None:
        raise click.UsageError(
            f"{name!r} is no index such as 1017 or 2010sub1: for a name give --eds"
        )
    return int(found[1], 16), int(found[2] or "0", 16)


def _named(index: int, subindex: int, entry: Entry | None) -> str:
    return f"{index:04X}h:{subindex}{'' if entry is None else f' {entry.name}'}"


def _plain(value: object) -> object:
    return value.hex(" ") if isinstance(value, bytes) else value


def _in_unit(entry: Entry, value: Any) -> float | None:
    scaled = isinstance(value, int | float) and entry.unit.symbol
    return float(entry.unit.number) * value if scaled else None


@contextmanager
def _errors(node_id: int, action: str) -> Iterator[None]:
    """Convert the errors of an SDO transfer to those of a bench."""
    try:
        yield
    except SdoAbortedError as error:
        text = f"node {node_id} refuses to {action}: {Abort(error.code)}"
        raise RefusedError(text, error.code) from error
    except SdoError as error:
        raise NodeNotFoundError(f"node {node_id} does not answer") from error

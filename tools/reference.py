"""Write docs/reference from the EDS files and the command line; --check fails when it is stale."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from enum import IntEnum
from pathlib import Path
from typing import Any

import click

from smarttac_can.bench.open_link import PLATE_ID, STIMULATOR_ID
from smarttac_can.cli import main as smarttac
from smarttac_can.control.cascade import Mode
from smarttac_can.control.friction import Law
from smarttac_can.control.identification import State
from smarttac_can.host.eds_files import read_eds
from smarttac_can.nodes.read_back import Status
from smarttac_can.od import cia
from smarttac_can.od.data_types import bounds
from smarttac_can.od.dictionary import Entry, ObjectDictionary
from smarttac_can.od.eds import load_eds

FOLDER = Path(__file__).resolve().parent.parent / "docs" / "reference"
NODES = (("stimulator.eds", STIMULATOR_ID), ("plate.eds", PLATE_ID))
AREAS = (
    ("Communication profile (CiA 301)", 0x1000, 0x13FF),
    ("Manufacturer-specific", 0x2000, 0x5FFF),
    ("Device profile (CiA 404)", 0x6000, 0x9FFF),
)
PDOS = (
    ("RPDO", cia.RPDO_COMMUNICATION, cia.RPDO_MAPPING),
    ("TPDO", cia.TPDO_COMMUNICATION, cia.TPDO_MAPPING),
)


def _table(*rows: tuple[str, ...]) -> Iterator[str]:
    head, *body = rows
    yield f"| {' | '.join(head)} |"
    yield "|" + "---|" * len(head)
    for row in body:
        yield f"| {' | '.join(row)} |"
    yield ""


def _number(entry: Entry) -> str:
    value = entry.default
    plain = entry.unit or entry.data_type is not cia.DataType.UNSIGNED32
    if plain or (value < 10_000 and "COB-ID" not in entry.name):
        return str(value)
    return f"{value:X}h"


def _limits(entry: Entry) -> str:
    whole = (entry.low, entry.high) == bounds(entry.data_type)
    return "" if whole else f"{entry.low}..{entry.high}"


def _default(entry: Entry, neighbour: Entry) -> str:
    """Show a default; the dictionaries of entry and neighbour are those of node-ID 1 and 2."""
    if entry.default == neighbour.default:
        return _number(entry)
    return f"{entry.default - 1 & ~cia.COB_INVALID:X}h + node-ID"


def _count(entry: Entry) -> str:
    if not entry.unit:
        return "" if entry.factor == 1 else f"{entry.factor:g}"
    return entry.unit if entry.factor == 1 else f"{entry.factor:g} {entry.unit}"


def _rows(
    od: ObjectDictionary, other: ObjectDictionary, low: int, high: int
) -> Iterator[tuple[str, ...]]:
    yield "Index", "Sub", "Name", "Type", "Access", "PDO", "Limits", "Default", "One count"
    for entry in od:
        counts_members = entry.subindex == 0 and entry.access == "const" and "." in entry.name
        if not low <= entry.index <= high or counts_members:
            continue
        yield (
            f"{entry.index:04X}h",
            f"{entry.subindex}",
            entry.name,
            entry.data_type.name,
            entry.access,
            "yes" if entry.pdo else "",
            _limits(entry),
            _default(entry, other.entry(entry.index, entry.subindex)),
            _count(entry),
        )


def _pdo_rows(od: ObjectDictionary, other: ObjectDictionary) -> Iterator[tuple[str, ...]]:
    yield "PDO", "COB-ID", "Type", "Event timer", "Content, bits"
    for kind, communication, mapping in PDOS:
        for index in [i for i in od.objects if communication <= i < communication + cia.PDO_COUNT]:
            cob_id = od.entry(index, cia.PDO_COB_ID)
            can_id = _default(cob_id, other.entry(index, cia.PDO_COB_ID))
            if cob_id.default & cia.COB_INVALID:
                can_id = f"off ({can_id})" if cob_id.default & cia.CAN_ID_MASK else "off"
            mapped = index - communication + mapping
            contents = [
                od.entry(mapped, position).default for position in range(1, od.number(mapped) + 1)
            ]
            yield (
                f"{kind} {index - communication + 1}",
                can_id,
                f"{od.number(index, cia.PDO_TRANSMISSION)}",
                f"{od.number(index, cia.PDO_EVENT)} ms",
                ", ".join(
                    f"{od.entry(value >> 16, value >> 8 & 0xFF).name} {value & 0xFF}"
                    for value in contents
                ),
            )


def _members(choices: type[IntEnum]) -> str:
    return ", ".join(f"{int(member)} {member.name.lower()}" for member in choices)


def objects() -> str:
    """Return the object dictionaries as Markdown."""
    lines = [
        "# Objects",
        "",
        "Made by `tools/reference.py` from `eds/stimulator.eds` and `eds/plate.eds`: change those.",
        "",
        "Limits and defaults are raw counts; *one count* says what a count stands for, and is "
        "empty for a plain number. Sub-index 0 of arrays and records, the number of members, is "
        "left out. Every mapping record has 8 places, and any object marked *PDO* may be mapped: "
        "`ro` and `rwr` into a TPDO, `rww` into an RPDO, `rw` into both.",
        "",
        "## Values",
        "",
        *_table(
            ("Object", "Values"),
            ("Mode, Mode display", _members(Mode)),
            ("Friction law", _members(Law)),
            (
                "Statusword, bits",
                ", ".join(
                    f"{int(bit).bit_length() - 1} {(bit.name or '').lower()}" for bit in Status
                ),
            ),
            ("Model.State", _members(State)),
            ("Finger.Motion", "0 lifted, 1 stroke, 2 recorded"),
            ("Saturation, bits", "0..5 S1..S6, 6 pick-up"),
            ("AI status, bits", "0 not valid, 1 positive overload"),
        ),
    ]
    for file, node_id in NODES:
        od, other = (load_eds(read_eds(file), number) for number in (1, 2))
        product = od.entry(cia.IDENTITY, 2).default
        lines += [
            f"## `{file}`",
            "",
            f"Product code {product:08X}h; node-ID {node_id} unless `--node-id` says otherwise.",
            "",
            "### PDOs",
            "",
            *_table(*_pdo_rows(od, other)),
        ]
        for title, low, high in AREAS:
            rows = list(_rows(od, other, low, high))
            if len(rows) > 1:
                lines += [f"### {title}", "", *_table(*rows)]
    return "\n".join(lines)


def _argument(kind: click.ParamType[Any]) -> str:
    if isinstance(kind, click.Choice):
        return "|".join(kind.choices)
    if isinstance(kind, click.IntRange):
        return f"{kind.min}.." if kind.max is None else f"{kind.min}..{kind.max}"
    return {"text": "TEXT", "file": "FILE", "directory": "DIR"}.get(kind.name, kind.name.upper())


def _parameter(parameter: click.Parameter) -> tuple[str, str, str]:
    if isinstance(parameter, click.Argument):
        many = "..." if parameter.nargs == -1 else ""
        return f"`{_argument(parameter.type)}{many}`".replace("|", "\\|"), "", ""
    assert isinstance(parameter, click.Option)
    name = ", ".join(parameter.opts)
    if not parameter.is_flag:
        name += f" {parameter.metavar or _argument(parameter.type)}"
    default = f"`{parameter.default}`" if parameter.show_default else ""
    return f"`{name}`".replace("|", "\\|"), default, parameter.help or ""


def command_line() -> str:
    """Return the help of every command as Markdown."""
    lines = [
        "# Command line",
        "",
        "Made by `tools/reference.py` from the commands themselves. `python -m smarttac_can` is "
        "the same as `smarttac`.",
        "",
    ]
    for name, command in smarttac.commands.items():
        text = " ".join((command.help or "").split()).replace("``", "`")
        example = (command.epilog or "").replace("\b", "").partition(":")[2]
        lines += [
            f"## `smarttac {name}`",
            "",
            text,
            "",
            *_table(("Parameter", "Default", "Meaning"), *map(_parameter, command.params)),
            "```console",
            *(f"$ {line.strip()}" for line in example.strip().splitlines()),
            "```",
            "",
        ]
    lines += [
        "## Exit codes",
        "",
        *_table(
            ("Code", "Meaning"),
            ("0", "done; a node was ended by Ctrl-C or SIGTERM and left the plate at 0 V"),
            ("1", "bus, device, EDS or file: one line on stderr says what"),
            ("2", "a wrong option or argument: usage and one line on stderr"),
        ),
    ]
    return "\n".join(lines)


def main() -> int:
    """Write the pages, or with --check return 1 if one of them is not what would be written."""
    pages = {FOLDER / "objects.md": objects(), FOLDER / "cli.md": command_line()}
    if sys.argv[1:] == ["--check"]:
        stale = [
            path
            for path, text in pages.items()
            if not path.exists() or path.read_text(encoding="utf-8") != text
        ]
        for path in stale:
            print(f"{path.name} is stale: run tools/reference.py")
        return 1 if stale else 0
    FOLDER.mkdir(exist_ok=True)
    for path, text in pages.items():
        path.write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())

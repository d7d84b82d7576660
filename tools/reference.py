"""Write docs/reference and the hazards from their sources; --check fails when a page is stale.

Example: python tools/reference.py --check
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from enum import IntEnum
from typing import Any

import click
from fmeda_page import fmeda_page
from hazards_page import hazards_page
from pages import EXPLANATION, REFERENCE, Pages, made, write
from python_reference import python_pages
from safety_reference import safety

from smarttac_can.bench.simulation import PLATE_ID, STIMULATOR_ID
from smarttac_can.cli import main as smarttac
from smarttac_can.host.files import read_eds
from smarttac_can.od import cia
from smarttac_can.od.eds import load_eds
from smarttac_can.od.object_reference import LEGEND, object_reference, table
from smarttac_can.vocabulary.modes import Law, Mode, VibrationLaw
from smarttac_can.vocabulary.states import Control, IdentificationState, State, Status
from smarttac_can.vocabulary.watchdogs import Watchdog

NODES = (("stimulator.eds", STIMULATOR_ID), ("plate.eds", PLATE_ID))


def _members(choices: type[IntEnum]) -> str:
    return ", ".join(f"{int(member)} {member.name.lower()}" for member in choices)


def objects() -> str:
    """Return the object dictionaries as Markdown."""
    lines = [
        "# Objects",
        "",
        "Made by `tools/reference.py` from `eds/stimulator.eds` and `eds/plate.eds`: change those.",
        "",
        f"{LEGEND} "
        "A mapping record has 8 places; one of the loop is constant and has those that it maps.",
        "",
        "## Values",
        "",
        *table(
            ("Object", "Values"),
            ("Mode, Mode display", _members(Mode)),
            ("Friction law", _members(Law)),
            ("Controller.Vibration law", _members(VibrationLaw)),
            (
                "Statusword, bits",
                ", ".join(
                    f"{int(bit).bit_length() - 1} {(bit.name or '').lower()}" for bit in Status
                ),
            ),
            ("Statusword, bits 8 to 10", _members(State)),
            (
                "Controlword, bits",
                ", ".join(
                    f"{int(bit).bit_length() - 1} {(bit.name or '').lower().replace('_', ' ')}"
                    for bit in Control
                ),
            ),
            ("Diagnosis.Present, Diagnosis.Latched, bits", _members(Watchdog)),
            ("Model.State", _members(IdentificationState)),
            ("Finger.Motion", "0 lifted, 1 stroke, 2 recorded"),
            ("Saturation, bits", "0..5 S1..S6, 6 pick-up"),
            ("AI status, bits", "0 not valid, 1 positive overload"),
        ),
    ]
    for file, node_id in NODES:
        text = read_eds(file)
        product = load_eds(text, node_id).entry(cia.IDENTITY, 2).default
        lines += [
            f"## `{file}`",
            "",
            f"Product code {product:08X}h; node-ID {node_id} unless `--node-id` says otherwise.",
            "",
            *object_reference(text, level=3),
        ]
    return "\n".join(lines)


def _argument(kind: click.ParamType[Any]) -> str:
    if isinstance(kind, click.Choice):
        return "|".join(kind.choices)
    if isinstance(kind, click.IntRange):
        return f"{kind.min}.." if kind.max is None else f"{kind.min}..{kind.max}"
    return {"text": "TEXT", "file": "FILE", "directory": "DIR"}.get(kind.name, kind.name.upper())


def _parameter(context: click.Context, parameter: click.Parameter) -> tuple[str, str, str]:
    if isinstance(parameter, click.Argument):
        # As the usage line of --help has it.
        name, takes = parameter.make_metavar(context), _argument(parameter.type)
        return f"`{name}`", "", "" if takes in name else f"`{takes}`"
    assert isinstance(parameter, click.Option)
    name = ", ".join(parameter.opts)
    if not parameter.is_flag:
        name += f" {parameter.metavar or _argument(parameter.type)}"
    default = f"`{parameter.default}`" if parameter.show_default else ""
    if parameter.required:
        default = "required"
    return f"`{name}`", default, parameter.help or ""


def _commands(group: click.Group, prefix: str) -> Iterator[tuple[str, click.Command]]:
    context = click.Context(group)
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        assert command is not None
        full = f"{prefix} {name}"
        if isinstance(command, click.Group):
            yield from _commands(command, full)
        else:
            yield full, command


def command_line() -> str:
    """Return the help of every command as Markdown."""
    lines = [
        "# Command line",
        "",
        "Made by `tools/reference.py` from the commands themselves. `python -m smarttac_can` is "
        "the same as `smarttac`.",
        "",
    ]
    for name, command in _commands(smarttac, "smarttac"):
        text = " ".join((command.help or "").split())
        parameters = [_parameter(click.Context(command), each) for each in command.params]
        example = (command.epilog or "").replace("\b", "").partition(":")[2]
        lines += [
            f"## `{name}`",
            "",
            text,
            "",
            *table(("Parameter", "Default", "Meaning"), *parameters),
            "```console",
            *(f"$ {line.strip()}" for line in example.strip().splitlines()),
            "```",
            "",
        ]
    lines += [
        "## Exit codes",
        "",
        *table(
            ("Code", "Meaning"),
            ("0", "done; a node was ended by Ctrl-C or SIGTERM and left the plate at 0 V"),
            ("1", "bus, device, EDS or file: one line on stderr says what"),
            ("1", "`Aborted!`: ended by Ctrl-C or SIGTERM before it was done, without its files"),
            ("2", "a wrong option or argument: usage and one line on stderr"),
        ),
    ]
    return "\n".join(lines)


def pages(_draw: bool = False) -> Pages:
    """Return all pages."""
    return {
        REFERENCE / "objects.md": objects(),
        REFERENCE / "cli.md": command_line(),
        REFERENCE / "safety.md": safety(),
        REFERENCE / "fmeda.md": fmeda_page(),
        EXPLANATION / "hazards.md": hazards_page(),
        **{REFERENCE / page: text for page, text in python_pages()},
    }


def write_pages() -> None:
    """Write all pages anew."""
    write(pages())


if __name__ == "__main__":
    sys.exit(made(__doc__, pages))

"""Write docs/reference and the hazards from their sources; --check fails when a page is stale.

Example: tools/pages/make reference --check
"""

from __future__ import annotations

import ast
import inspect
from collections import Counter
from collections.abc import Iterator
from enum import IntEnum, IntFlag
from functools import cache
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from typing import Any, Final, NamedTuple

import click
from fmeda import fmeda_page
from hazards import hazards_page
from pages import REFERENCE, Pages, columns, made, renewed

from smarttac_can.bench.simulation import PLATE_ID, STIMULATOR_ID
from smarttac_can.canopen.od import cia
from smarttac_can.canopen.od.eds import load_eds
from smarttac_can.canopen.od.object_reference import LEGEND, object_reference, table
from smarttac_can.cli import main as smarttac
from smarttac_can.cli.evidence import main as evidence
from smarttac_can.host.files import read_eds
from smarttac_can.instrument.nodes.lock import OF_PLATE, OF_STIMULATOR, Place, Table
from smarttac_can.instrument.nodes.states import (
    STAGE_TRANSITIONS,
    TRANSITIONS,
    Guard,
    StageState,
)
from smarttac_can.vocabulary.states import (
    Control,
    IdentificationState,
    Law,
    Mode,
    State,
    Status,
    VibrationLaw,
)
from smarttac_can.vocabulary.watchdogs import FORGOTTEN, WATCHDOGS, Watchdog

NODES = (("stimulator.eds", STIMULATOR_ID), ("plate.eds", PLATE_ID))
PACKAGE: Final = Path(__file__).resolve().parents[2] / "smarttac_can"
FACES: Final = (
    "bench", "vocabulary", "instrument.nodes", "host", "canopen.bus", "canopen.device",
    "canopen.od", "canopen.master", "science.plant", "science.control", "canopen.commissioning",
    "canopen.conformance", "studies.paper", "science.population", "studies.campaign",
    "assurance.trials", "assurance.timing", "instrument.replay", "bench.watch",
    "bench.panel",
)  # fmt: skip
"""From the most to the least imported; a name that several have is of the first."""


SHARED_BY: Final = 2
"""Commands that an option has to be the same in, to be listed once for all of them."""


def _members(choices: type[IntEnum]) -> str:
    return ", ".join(f"{int(member)} {member.name.lower()}" for member in choices)


def _bits(flags: type[IntFlag]) -> str:
    return ", ".join(f"{int(bit).bit_length() - 1} {(bit.name or '').lower()}" for bit in flags)


def objects() -> Pages:
    """Return the page of the object dictionaries."""
    values = {
        "Mode, Mode display": _members(Mode),
        "Friction law": _members(Law),
        "Controller.Vibration law": _members(VibrationLaw),
        "Statusword, bits": _bits(Status),
        "Statusword, bits 8 to 10": _members(State),
        "Controlword, bits": _bits(Control).replace("_", " "),
        "Diagnosis.Present, Diagnosis.Latched, bits": _members(Watchdog),
        "Model.State": _members(IdentificationState),
        "Finger.Motion": "0 lifted, 1 stroke, 2 recorded",
        "Saturation, bits": "0..5 S1..S6, 6 pick-up",
        "AI status, bits": "0 not valid, 1 positive overload",
    }
    lines: list[str] = []
    for file, node_id in NODES:
        text = read_eds(file)
        product = load_eds(text, node_id).entry(cia.IDENTITY, 2).default
        rows = [
            row for row in object_reference(text, level=3) if row not in lines or _is_frame(row)
        ]
        others = ["Objects that are as those above are left out."] if lines else []
        lines += [
            f"## `{file}`",
            "",
            f"Product code {product:08X}h; node-ID {node_id} unless `--node-id` says otherwise.",
            *others,
            "",
            *rows,
        ]
    table_of_values = columns("Object|Values", values.items())
    fields = {"legend": [LEGEND], "values": table_of_values, "nodes": lines}
    return renewed(REFERENCE / "objects.md", fields)


def _is_frame(line: str) -> bool:
    """Whether a line is no object: a heading, the head of a table, or a line between tables."""
    return not line.startswith("| ") or line.startswith(("| Object | Name |", "| PDO |"))


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
    value = parameter.default
    if isinstance(value, list):
        value = ", ".join(value)
    default = f"`{value}`" if parameter.show_default else ""
    if parameter.required:
        default = "required"
    return f"`{name}`", default, parameter.help or ""


def _option(row: tuple[str, str, str]) -> str:
    """Return the name of the option in a row."""
    return row[0].strip("`").split()[0]


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


def command_line() -> Pages:
    """Return the page with the help of every command."""
    head = ("Parameter", "Default", "Meaning")
    all_commands = [
        *_commands(smarttac, "smarttac"),
        *_commands(evidence, str(evidence.name)),
    ]
    parameters = {
        name: [
            _parameter(click.Context(command), each)
            for each in command.params
            if not getattr(each, "hidden", False)
        ]
        for name, command in all_commands
    }
    counts = Counter(row for rows in parameters.values() for row in rows)
    # Two options of one name are not both listed: a command names its shared options alone.
    most = {_option(row): row for row, _ in reversed(counts.most_common())}
    shared = [
        row
        for row, count in counts.items()
        if _option(row).startswith("--") and count >= SHARED_BY and most[_option(row)] == row
    ]
    lines: list[str] = []
    for name, command in all_commands:
        text = " ".join((command.help or "").split())
        own = [row for row in parameters[name] if row not in shared]
        others = [f"`{_option(row)}`" for row in parameters[name] if row in shared]
        example = (command.epilog or "").replace("\b", "").partition(":")[2]
        lines += [
            f"## `{name}`",
            "",
            text,
            "",
            *(table(head, *own) if own else ()),
            *((f"[Shared](#shared-options): {', '.join(others)}.", "") if others else ()),
            "```console",
            *(f"$ {line.strip()}" for line in example.strip().splitlines()),
            "```",
            "",
        ]
    return renewed(REFERENCE / "cli.md", {"shared": table(head, *shared), "commands": lines})


def _title(name: str | None) -> str:
    return (name or "").lower().replace("_", " ")


def _guard(guard: Guard) -> str:
    return _title(guard.name) if guard else ""


def _where(place: Place) -> str:
    """Name the objects of a place."""
    where = f"{place.first:04X}h"
    if place.last != place.first:
        where += f" to {place.last:04X}h"
    if place.subindices:
        where += " sub-index " + ", ".join(str(subindex) for subindex in place.subindices)
    return where


def _relaxing(rules: Table) -> Iterator[str]:
    """List the objects that no write relaxes under a drive."""
    return table(
        ("Object", "Refused"),
        *((f"`{name}`", rule.text) for name, rule in rules.by_name.items()),
        *((_where(place), place.rule.text) for place in rules.by_index),
    )


def _stage() -> list[str]:
    """List the states of the plate's power stage, and their transitions."""
    return [
        *table(("State", "Meaning"), *((_title(s.name), s.value) for s in StageState)),
        *table(
            ("State", "Event", "Meaning", "Next"),
            *(
                (
                    _title(row.state.name),
                    _title(row.event.name),
                    row.event.value,
                    _title(row.next.name),
                )
                for row in STAGE_TRANSITIONS
            ),
        ),
    ]


def safety() -> Pages:
    """Return the page with its fields made anew."""
    bits = ((f"{int(bit).bit_length() - 1}", _title(bit.name)) for bit in Control)
    transitions = (
        (
            _title(row.state.name),
            _title(row.event.name),
            row.event.value,
            _guard(row.guard),
            _title(row.next.name),
        )
        for row in TRANSITIONS
    )
    watchdogs = (
        (
            f"{int(watchdog)}",
            row.text,
            row.looks_at,
            f"{row.code:04X}h",
            f"{int(row.register):02X}h",
            f"{row.bound}",
            row.why,
            row.forgets,
            row.limit,
            row.remedy,
        )
        for watchdog, row in WATCHDOGS.items()
    )
    head = "Bit|Fault|Looks at|EMCY|Error register|Bound|Why|Forgets|Limit|Next step"
    return renewed(
        REFERENCE / "safety.md",
        {
            "states": columns("Number|State", ((f"{int(s)}", _title(s.name)) for s in State)),
            "transitions": columns("State|Event|Meaning|Guard|Next", transitions),
            "controlword": columns("Bit|Command", bits),
            "watchdogs": columns(head, watchdogs),
            "forgotten": f"{FORGOTTEN}",
            "one_more": f"{FORGOTTEN + 1}",
            "stimulator_limits": _relaxing(OF_STIMULATOR),
            "plate_limits": _relaxing(OF_PLATE),
            "stage": _stage(),
        },
    )


class Name(NamedTuple):
    """The names of a face."""

    face: str
    name: str
    value: Any

    @property
    def summary(self) -> str:
        """First line of its docstring; of a constant, that below its assignment."""
        text = _constants(self.face)[self.name] if self.is_constant else inspect.getdoc(self.value)
        lines = (text or "").splitlines() or [""]
        return lines[0].replace("``", "`").replace("|", "\\|")

    @property
    def is_constant(self) -> bool:
        """Whether it is neither class nor function."""
        return not (inspect.isclass(self.value) or inspect.isroutine(self.value))

    @property
    def directive(self) -> str:
        """Name of the directive of autodoc that shows it."""
        if self.is_constant:
            return "py:data"
        return "autoclass" if inspect.isclass(self.value) else "autofunction"


@cache
def _constants(face: str) -> dict[str, str]:
    """Return the text below each assignment in the modules of a package, by name."""
    found = {}
    for path in sorted((PACKAGE / face.replace(".", "/")).glob("*.py")):
        for before, after in pairwise(ast.parse(path.read_text(encoding="utf-8")).body):
            match before, after:
                case (
                    ast.AnnAssign(target=ast.Name(id=name))
                    | ast.Assign(targets=[ast.Name(id=name)]),
                    ast.Expr(value=ast.Constant(value=str(text))),
                ):
                    found[name] = inspect.cleandoc(text)
    return found


def _names(face: str) -> list[Name]:
    module = import_module(f"smarttac_can.{face}")
    return [Name(face, name, getattr(module, name)) for name in module.__all__]


def python_pages() -> Iterator[tuple[str, str]]:
    """Give the path of each page, from docs/reference, and its text."""
    seen: dict[int, Name] = {}
    rows = []
    for face in FACES:
        names = _names(face)
        own = [name for name in names if seen.setdefault(id(name.value), name) is name]
        doc = (import_module(f"smarttac_can.{face}").__doc__ or "").strip()
        rows.append((f"[`smarttac_can.{face}`](python/{face}.md)", doc))
        yield f"python/{face}.md", _page(face, doc, names, own, seen)
    lines = [
        "# Python",
        "",
        "These packages name what you can import, such as `from smarttac_can.bench import "
        "Stimulator`. Names in other modules may change in any version.",
        "",
        "These pages are made by `tools/pages/make reference` from the docstrings: change those.",
        "",
    ]
    yield "python.md", "\n".join([*lines, *table(("Package", "Summary"), *rows)])


def _page(face: str, head: str, names: list[Name], own: list[Name], seen: dict[int, Name]) -> str:
    rows = []
    for name in names:
        home = seen[id(name.value)].face
        where = "" if home == face else f" ([{home}]({home}.md))"
        rows.append((f"`{name.name}`{where}", name.summary))
    lines = [f"# `smarttac_can.{face}`", "", head, "", *table(("Name", "Summary"), *rows)]
    if own:
        lines += ["```{eval-rst}"]
        for name in own:
            lines += [f".. {name.directive}:: smarttac_can.{face}.{name.name}"]
            if name.is_constant:
                lines += ["", f"   {name.summary}", ""]
            if name.directive == "autoclass":
                lines += ["   :inherited-members: object, int, tuple, Exception, Enum"]
                if issubclass(name.value, BaseException):
                    lines += ["   :exclude-members: add_note, with_traceback"]
        lines += ["```", ""]
    return "\n".join(lines)


def pages(_draw: bool = False) -> Pages:
    """Return all pages."""
    return {
        **objects(),
        **command_line(),
        **safety(),
        **fmeda_page(),
        **hazards_page(),
        **{REFERENCE / page: text for page, text in python_pages()},
    }


def main() -> int:
    """Write the page, or compare it."""
    return made(__doc__, pages)

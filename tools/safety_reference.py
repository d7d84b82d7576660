"""The tables of states and watchdogs, from those in the code; `tools/reference.py` writes them."""

from __future__ import annotations

from collections.abc import Iterator

from pages import REFERENCE, Pages, columns, renewed

from smarttac_can.nodes.lock import OF_PLATE, OF_STIMULATOR, Place, Table
from smarttac_can.nodes.states import (
    STAGE_TRANSITIONS,
    TRANSITIONS,
    Guard,
    StageState,
)
from smarttac_can.od.object_reference import table
from smarttac_can.vocabulary.states import Control, State
from smarttac_can.vocabulary.watchdogs import FORGOTTEN, WATCHDOGS


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


def _stricter(laxer: Table) -> Iterator[str]:
    """List what a write does not make laxer under a drive."""
    return table(
        ("Object", "Laxer is"),
        *((f"`{name}`", rule.text) for name, rule in laxer.by_name.items()),
        *((_where(place), place.rule.text) for place in laxer.by_index),
    )


def _stage() -> list[str]:
    """List the states of the plate's power stage, and what leads from one to another."""
    return [
        *table(("State", "What it is"), *((_title(s.name), s.value) for s in StageState)),
        *table(
            ("State", "Event", "What it is", "Next"),
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
        )
        for watchdog, row in WATCHDOGS.items()
    )
    head = "Bit|Fault|Looks at|EMCY|Error register|Bound|Why|Forgets|Limit"
    return renewed(
        REFERENCE / "safety.md",
        {
            "states": columns("Number|State", ((f"{int(s)}", _title(s.name)) for s in State)),
            "transitions": columns("State|Event|What it is|Guard|Next", transitions),
            "controlword": columns("Bit|Command", bits),
            "watchdogs": columns(head, watchdogs),
            "forgotten": f"{FORGOTTEN}",
            "one_more": f"{FORGOTTEN + 1}",
            "stimulator_limits": _stricter(OF_STIMULATOR),
            "plate_limits": _stricter(OF_PLATE),
            "stage": _stage(),
        },
    )

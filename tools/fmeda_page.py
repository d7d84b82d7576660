"""The page of failing sensors, from tools/fmeda.json, which tools/fmeda.py writes."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Mapping
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, NamedTuple

from pages import REFERENCE, Pages, renewed

from smarttac_can.od.object_reference import table
from smarttac_can.trials.sensor_sweep import Promise, Result, parse_cell

SUMMARY = Path(__file__).resolve().parent / "fmeda.json"
_FACTORS = {
    "identified": {
        "no": "never identified: the model of the EDS",
        "sound": "identified with all sensors sound",
        "failed": "identified while the sensor had failed",
    },
    "motion": {
        "none": "no finger",
        "holding": "finger on the plate",
        "landing": "finger lands",
        "lifting": "finger lifts",
    },
    "mode": {},
}
"""Factors of a cell by the name of its field, and how their values are called."""


class Found(NamedTuple):
    """What some rows of the sweep have come to."""

    cells: int
    violations: int
    above: int
    """Most cycles of a cell above its bound."""
    peak_um: float
    """Largest true vibration of all cells, peak-to-peak."""
    energy_J: float
    """Most energy that the plate of a cell lost above its bound."""

    def __str__(self) -> str:
        if self.violations:
            return f"{self.violations} of {self.cells} cells beyond the promise"
        return f"none in {self.cells} cells"


def summary() -> dict[str, Any]:
    """Return the summary that the pages are made of."""
    read: dict[str, Any] = json.loads(SUMMARY.read_text(encoding="utf-8"))
    return read


def row_of_factor(factor: str) -> Callable[[Result], str]:
    """Return what names the row of a result by a factor of its cell, such as ``motion``."""
    names = _FACTORS[factor]

    def row_of(result: Result) -> str:
        value: str = getattr(parse_cell(result.cell), factor)
        return names.get(value, value.lower().replace("_", " "))

    return row_of


def found(patterns: list[str], made: Mapping[str, Any]) -> Found:
    """Sum up the rows of failures or factors that match one of some patterns.

    Parameters
    ----------
    patterns
        Such as ``pick-up *: stuck*``.
    made
        The summary.

    Raises
    ------
    ValueError
        If no row matches one of them.
    """
    rows = made["failures"] | {
        name: row for factor in made["factors"].values() for name, row in factor.items()
    }
    matched = {pattern: [n for n in rows if fnmatchcase(n, pattern)] for pattern in patterns}
    if missing := [pattern for pattern, names in matched.items() if not names]:
        raise ValueError(f"{SUMMARY.name} has no row {', '.join(missing)}")
    chosen = [rows[name] for name in {name for names in matched.values() for name in names}]
    return Found(
        sum(row["cells"] for row in chosen),
        sum(row["violations"] for row in chosen),
        *(max(row[name] for row in chosen) for name in ("above", "peak_um", "energy_J")),
    )


def fmeda_page(made: Mapping[str, Any] | None = None) -> Pages:
    """Return the page with its fields made anew.

    Parameters
    ----------
    made
        A summary; that of the repository unless given.
    """
    made = made or summary()
    promise, runs = Promise(**made["promise"]), made["healthy"]
    sweep = ("name", "seed", "cells", "violations", "fingerprint")
    factors = [
        (name, rows[name])
        for factor, rows in made["factors"].items()
        for name in _FACTORS[factor].values() or rows
        if name in rows
    ]
    numbers = promise._asdict() | {
        "sound_um": f"{promise.bare_um / promise.model_share:.2f}",
        "unsound_um": f"{promise.bare_um / promise.lowest_gain:.2f}",
        "runs": runs["runs"],
        "seed": runs["seed"],
        "false": runs["false"],
        "true": runs["ended"] - runs["false"],
        "limited": f"{100.0 * runs['limited'] / runs['cycles']:.1f}",
    }
    tables = {
        "sweeps": (
            ("Sweep", "Seed", "Cells", "Beyond the promise", "Fingerprint"),
            *(tuple(str(each[name]) for name in sweep) for each in made["sweeps"]),
        ),
        "failures": (_head("Failure"), *map(_row, made["failures"].items())),
        "factors": (_head("Circumstance"), *map(_row, factors)),
    }
    return renewed(
        REFERENCE / "fmeda.md",
        {
            "command": f"`{made['command']}`",
            **{name: f"{n:g}" if isinstance(n, float) else str(n) for name, n in numbers.items()},
            **{name: table(*rows) for name, rows in tables.items()},
        },
    )


_SHOWN = 4
"""Watchdogs of a row that are named."""


def _head(what: str) -> tuple[str, ...]:
    return (what, "Cells", "Ended by", "After [cycles]", "Reached [um]", "Above the bound [cycles]")


def _row(named: tuple[str, Mapping[str, Any]]) -> tuple[str, ...]:
    name, row = named
    ended = [f"{count} {by}" for by, count in Counter(row["ended"]).most_common(_SHOWN)]
    if others := row["cells"] - sum(sorted(row["ended"].values())[-_SHOWN:]):
        ended.append(f"{others} others")
    return (
        name,
        f"{row['cells']}",
        ", ".join(ended),
        f"{row['after']}",
        f"{row['peak_um']:.2f}",
        f"{row['above']}",
    )

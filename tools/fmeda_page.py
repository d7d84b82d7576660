"""The page of failing sensors, from tools/fmeda.json, which tools/fmeda.py writes."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, NamedTuple

from smarttac_can.od.object_reference import table
from smarttac_can.trials.sensor_sweep import EXCLUSIONS, Promise, Result, parse_cell

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

HEAD = """# Sensors that fail (FMEDA)

Made by `tools/reference.py` from `tools/fmeda.json`, which `{command}` has written.

One sensor fails in each cell of a sweep, in one way, while the stimulator drives the simulated
plate. What counts is the true vibration of the plate, whatever its pick-up reads. `smarttac fmeda`
runs the same cells: `--json` has each of them, and `--cell` runs one alone. The
[hazards](../explanation/hazards.md) take their figures of the sensors from here.

This is the part of a failure modes, effects and diagnostic analysis that a simulation can give:
modes, effects, and what notices them. There are no failure rates in it, and so no share of failures
that are noticed.

## What is promised

The promise was written down [before it was
swept](../decisions/0053-the-bound-limits-the-drive.md). Whatever one sensor does:

- The true vibration is above its bound for at most {cycles} cycles (ms) of a run, and for
  {gauge_lag} more where a finger lands or lifts, because the gauges lag.
- The plate loses at most {energy_J:g} J in these cycles.
- Nothing trips before the sensor fails.

The bound with contact, which is more than {contact_N:g} N, is {touched_um:g} um peak-to-peak.
Without contact it is {bare_um:g} um over the share of the true gain that the model has at least:

- {sound_um:.2f} um for a share of {model_share:g}, after an identification with sound sensors;
- {unsound_um:.2f} um for a share of {lowest_gain:g} otherwise.

## What was run
"""

CELLS = """\
A cell joins a failure and its onset (before the tare, while driven, or with a step of the
set-point), a mode, a law of the vibration and one of the friction, detuning, set-point, COF, a
finger with its force and damping, the dead time of the loop, and whether the plate was identified.

- In a grid each failure meets each mode, and the seed draws the rest. The coarse one goes on for
  200 cycles after the failure, the fine one for 1000, with all gains in steps of 0.05.
- Random cells draw sizes and all else from the ranges between, for 250 or 1000 cycles.
- Identifications go on for 900 cycles.

`smarttac fmeda --seed SEED`, `--fine` and `--random N` run each with other seeds. The fingerprint
is that of what came of all cells.
"""
HEALTHY = """## Runs in which nothing fails

{runs} runs of one to two seconds, seeds from {seed} on: any mode, law, texture, dead time and
finger, with set-points that jump, of which many ask for more than there is, and hops of the
frequency.

- {false} of them ended in a fault for which the plate gave no cause.
- {true} ended because the true vibration was beyond a limit.
- The drive was limited in {limited:.1f} % of the cycles.

## How it fails, and what ends it

- **Ended by**: how many cells each watchdog has ended first. *Not armed*: the failure was noticed
  before anything was driven. *Nothing*: the run went on to the end of the cell. The four most
  frequent ones are named; `tools/fmeda.json` has all.
- **After**: most cycles from the failure, or from the first drive if that is later, until something
  ended the run. A failure may show only when a finger comes.
- **Reached**: largest true vibration, also in cycles above the bound.
"""


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


def fmeda_page(made: Mapping[str, Any] | None = None) -> str:
    """Return the page as Markdown.

    Parameters
    ----------
    made
        A summary; that of the repository unless given.
    """
    made = made or summary()
    promise, runs = Promise(**made["promise"]), made["healthy"]
    lines = [
        HEAD.format(
            command=made["command"],
            sound_um=promise.bare_um / promise.model_share,
            unsound_um=promise.bare_um / promise.lowest_gain,
            **promise._asdict(),
        ),
        *_sweeps(made["sweeps"]),
        CELLS,
        HEALTHY.format(
            true=runs["ended"] - runs["false"],
            limited=100.0 * runs["limited"] / runs["cycles"],
            **{name: runs[name] for name in ("runs", "seed", "false")},
        ),
        *table(
            ("Failure", *_COLUMNS),
            *((name, *_row(row)) for name, row in made["failures"].items()),
        ),
        "## Under which circumstances",
        "",
        "The same cells again.",
        "",
        *table(
            ("Circumstance", *_COLUMNS),
            *(
                (name, *_row(rows[name]))
                for factor, rows in made["factors"].items()
                for name in _FACTORS[factor].values() or rows
                if name in rows
            ),
        ),
    ]
    return "\n".join(lines).rstrip() + "\n"


_SHOWN = 4
"""Watchdogs of a row that are named."""
_COLUMNS = (
    "Cells", "Ended by", "After [cycles]", "Reached [um]", "Above the bound [cycles]",
)  # fmt: skip


def _row(row: Mapping[str, Any]) -> tuple[str, ...]:
    ended = [f"{count} {by}" for by, count in Counter(row["ended"]).most_common(_SHOWN)]
    if others := row["cells"] - sum(sorted(row["ended"].values())[-_SHOWN:]):
        ended.append(f"{others} others")
    return (
        f"{row['cells']}",
        ", ".join(ended),
        f"{row['after']}",
        f"{row['peak_um']:.2f}",
        f"{row['above']}",
    )


def _sweeps(sweeps: list[dict[str, Any]]) -> Iterator[str]:
    names = ("name", "seed", "cells", "violations", "fingerprint")
    yield from table(
        ("Sweep", "Seed", "Cells", "Beyond the promise", "Fingerprint"),
        *(tuple(str(sweep[name]) for name in names) for sweep in sweeps),
    )
    if excluded := sum(sweep["excluded"] for sweep in sweeps):
        yield f"{excluded} of the cells are excluded, because physics forbids them to hold:"
        yield from ("", *(f"- {exclusion.why}" for exclusion in EXCLUSIONS), "")

"""Sweep the failures of the sensors, and sum them up in tools/pages/fmeda.json.

    tools/pages/make fmeda [--fine] [--random N] [--healthy N] [--seed SEED]
    tools/pages/make fmeda --check

The runs: the coarse sweep of `python -m smarttac_can.assurance sensors`, a minute of processor
time, runs without a failure, and the options given; then the coarse sweep on plates that
soften and were identified. Then tools/pages/make reference makes the pages. A check runs
the coarse sweep alone: it has to keep the promise, and to give the figures of the file.

Example: tools/pages/make fmeda --fine --healthy 5000 --seed 7
"""

from __future__ import annotations

import json
import os
import sys
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, NamedTuple

import click
from pages import REFERENCE, Pages, renewed

from smarttac_can.assurance.trials.healthy_runs import healthy_as_json, healthy_run
from smarttac_can.assurance.trials.sensor_sweep import (
    PROMISES,
    Cell,
    Promise,
    Result,
    fingerprint,
    grid_cells,
    parse_cell,
    random_cells,
    run_cell,
    summary,
)
from smarttac_can.assurance.trials.workers import in_order
from smarttac_can.canopen.od.object_reference import table
from smarttac_can.host.terminal import progress_bar
from smarttac_can.vocabulary.states import VibrationLaw

SUMMARY = Path(__file__).resolve().parent / "fmeda.json"
COARSE_SEED = 1
"""Default seed of `python -m smarttac_can.assurance sensors`."""
SENSORS = "python -m smarttac_can.assurance sensors"
JOBS = os.cpu_count() or 1
SOFTENINGS = (60.0, 150.0)
"""Of the plates in Hz/um."""
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
        "tapping": "finger taps",
    },
    "mode": {},
}
"""Factors of a cell by the name of its field, and how their values are called."""


class Found(NamedTuple):
    """Results of some rows of the sweep."""

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


def summed_up() -> dict[str, Any]:
    """Return the summary that the pages are made of."""
    read: dict[str, Any] = json.loads(SUMMARY.read_text(encoding="utf-8"))
    return read


def row_of_factor(factor: str) -> Callable[[Result], str]:
    """Return the name of the row of a result by a factor of its cell, such as ``motion``."""
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
    made = made or summed_up()
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
        "lifts": (
            ("Set-point [um]", "Law", *(f"Lifted in {ms:g} ms" for ms in _LIFTS_MS)),
            *map(_lift, made["lifts"]),
        ),
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


def _lift(row: Mapping[str, Any]) -> tuple[str, ...]:
    shown = [
        f"{peak:.2f} um, {above}" for peak, above in zip(row["peaks_um"], row["above"], strict=True)
    ]
    return (f"{row['setpoint']:g}", row["law"], *shown)


def swept(name: str, seed: int, cells: Sequence[Cell]) -> tuple[dict[str, Any], list[Result]]:
    """Run cells; return the sweep as in the file, and the results."""
    with progress_bar(f"{name} cells") as progress:
        results = list(in_order(run_cell, cells, JOBS, progress))
    for result in results:
        if result.violation:
            print(f"{result.violation}: {SENSORS} --cell {result.cell}")
    return {
        "name": name,
        "seed": seed,
        "cells": len(results),
        "violations": sum(bool(result.violation) for result in results),
        "fingerprint": fingerprint(results),
    }, results


def softened(cells: Sequence[Cell], softening: float) -> list[Cell]:
    """Return the cells on a plate that softens, in Hz/um, and was identified in each of them."""
    return [
        replace(
            cell,
            softening=softening,
            identified="sound" if cell.identified == "no" else cell.identified,
        )
        for cell in cells
    ]


_LIFTS_MS = (2.0, 8.0, 20.0)
_TAPS = Cell(
    failure="d:gain:1", mode="AMPLITUDE_RESONANCE", motion="tapping", force=1.2,
    identified="sound", cycles=3000, period=0.5,
)  # fmt: skip
"""Six lifts of a sound device."""


def lifts() -> list[dict[str, Any]]:
    """Return how far a sound plate goes when a finger lifts, by set-point, law and lift."""
    found = []
    for setpoint in (1.0, 2.0, 2.5, 3.0):
        for law in VibrationLaw:
            results = [
                run_cell(replace(_TAPS, setpoint=setpoint, law=law.name, lift=lift))
                for lift in _LIFTS_MS
            ]
            found.append(
                {
                    "setpoint": setpoint,
                    "law": law.name.lower(),
                    "ended": sum(bool(result.ended_by) for result in results),
                    "peaks_um": [result.peak_um for result in results],
                    "above": [result.above for result in results],
                }
            )
    return found


def healthy_runs(count: int, seed: int) -> dict[str, Any]:
    """Run without a failure; return the entry of the file."""
    with progress_bar("healthy runs") as progress:
        seeds = range(seed, seed + count)
        runs = list(in_order(healthy_run, seeds, JOBS, progress))
    for run in runs:
        if run.false:
            print(f"false trip by {run.ended_by}: {SENSORS} --healthy 1 --seed {run.seed}")
    found = healthy_as_json(runs)
    return {"seed": seed} | {name: n for name, n in found.items() if name != "faults"}


def check() -> int:
    """Return 1 if the coarse sweep breaks the promise, or comes to something else than before."""
    now, _ = swept("coarse", COARSE_SEED, grid_cells(COARSE_SEED))
    then = summed_up()["sweeps"][0]
    print(f"{now['cells']} cells, {now['violations']} violations")
    if now != then:
        print(f"{SUMMARY.name} is stale, {then} is now {now}: run {__file__} as fmeda.md says")
    return 1 if now["violations"] or now != then else 0


@click.command(help=__doc__)
@click.option("--fine", is_flag=True, help="The fine sweep as well, 40 minutes of processor time.")
@click.option(
    "--random", "drawn", type=click.IntRange(min=1), default=60, help="So many random cells."
)
@click.option(
    "--healthy", type=click.IntRange(min=1), default=100, help="So many runs without a failure."
)
@click.option("--seed", type=click.IntRange(min=0), default=COARSE_SEED, help="Of all of these.")
@click.option("--check", "checks", is_flag=True, help="Write nothing.")
def main(*, fine: bool, drawn: int, healthy: int, seed: int, checks: bool) -> None:
    """Write the summary; exit with 1 if a promise is broken, or the summary is stale."""
    if checks:
        sys.exit(check())
    coarse = grid_cells(COARSE_SEED)
    asked = [("coarse", COARSE_SEED, coarse)]
    if fine:
        asked.append(("fine", seed, grid_cells(seed, fine=True)))
    asked.append(("random", seed, random_cells(drawn, seed)))
    sweeps, results = [], []
    for sweep in asked:
        said, found = swept(*sweep)
        sweeps.append(said)
        results += found
    for each in SOFTENINGS:  # not in the sums below
        cells = softened(coarse, each)
        sweeps.append(swept(f"coarse, {each:g} Hz/um", COARSE_SEED, cells)[0])
    runs = healthy_runs(healthy, seed)
    made = {
        "command": f"tools/pages/make fmeda {'--fine ' * fine}--random {drawn} --healthy {healthy} "
        f"--seed {seed}",
        "promise": PROMISES._asdict(),
        "sweeps": sweeps,
        "failures": summary(results),
        "factors": {factor: summary(results, row_of_factor(factor)) for factor in _FACTORS},
        "healthy": runs,
        "lifts": lifts(),
    }
    SUMMARY.write_text(json.dumps(made, indent=1) + "\n", encoding="utf-8")
    run, broken = (sum(sweep[name] for sweep in sweeps) for name in ("cells", "violations"))
    print(f"{run} cells, {broken} violations; {runs['false']} false trips")
    sys.exit(1 if broken or runs["false"] else 0)

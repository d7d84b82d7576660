"""Sweep the failures of the sensors, sum them up in tools/fmeda.json, and write its pages anew.

    python tools/fmeda.py [--fine] [--random N] [--healthy N] [--seed SEED]
    python tools/fmeda.py --check

What is run: the coarse sweep of `smarttac fmeda`, a minute of processor time, runs without a
failure, and what is asked for besides; then the coarse sweep on plates that soften and were
identified. A check runs the coarse sweep alone: it has to keep the promise, and to come to what the
file says.

Example: python tools/fmeda.py --fine --healthy 5000 --seed 7
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Sequence
from typing import Any

import click
from fmeda_page import SUMMARY, row_of_factor
from reference import write_pages

from smarttac_can.host.terminal import progress_bar
from smarttac_can.trials.healthy_runs import healthy_as_json, healthy_run
from smarttac_can.trials.sensor_sweep import (
    PROMISES,
    Cell,
    Result,
    fingerprint,
    grid_cells,
    random_cells,
    run_cell,
    softened,
    summary,
)
from smarttac_can.trials.workers import in_order

COARSE_SEED = 1
"""That of `smarttac fmeda` unless told otherwise."""
JOBS = os.cpu_count() or 1
SOFTENINGS = (60.0, 150.0)
"""Of the plates in Hz/um."""
FACTORS = ("identified", "motion", "mode")


def swept(name: str, seed: int, cells: Sequence[Cell]) -> tuple[dict[str, Any], list[Result]]:
    """Run cells; return what the file says of the sweep, and the results."""
    with progress_bar(f"{name} cells") as progress:
        results = list(in_order(run_cell, cells, JOBS, progress))
    for result in results:
        if result.violation:
            print(f"{result.violation}: smarttac fmeda --cell {result.cell}")
    return {
        "name": name,
        "seed": seed,
        "cells": len(results),
        "violations": sum(bool(result.violation) for result in results),
        "fingerprint": fingerprint(results),
    }, results


def healthy_runs(count: int, seed: int) -> dict[str, Any]:
    """Run without a failure; return what the file says of it."""
    with progress_bar("healthy runs") as progress:
        seeds = range(seed, seed + count)
        runs = list(in_order(healthy_run, seeds, JOBS, progress))
    for run in runs:
        if run.false:
            print(f"false trip by {run.ended_by}: smarttac fmeda --healthy 1 --seed {run.seed}")
    found = healthy_as_json(runs)
    return {"seed": seed} | {name: n for name, n in found.items() if name != "faults"}


def check() -> int:
    """Return 1 if the coarse sweep breaks the promise, or comes to something else than before."""
    now, _ = swept("coarse", COARSE_SEED, grid_cells(COARSE_SEED))
    then = json.loads(SUMMARY.read_text(encoding="utf-8"))["sweeps"][0]
    print(f"{now['cells']} cells, {now['violations']} violations")
    if now != then:
        print(f"{SUMMARY.name} is stale, {then} is now {now}: run tools/fmeda.py as fmeda.md says")
    return 1 if now["violations"] or now != then else 0


@click.command(help=__doc__)
@click.option("--fine", is_flag=True, help="The fine sweep as well, 40 minutes of processor time.")
@click.option("--random", "drawn", type=click.IntRange(min=1), help="So many random cells as well.")
@click.option(
    "--healthy", type=click.IntRange(min=1), default=100, help="So many runs without a failure."
)
@click.option("--seed", type=click.IntRange(min=0), default=COARSE_SEED, help="Of all of these.")
@click.option("--check", "checks", is_flag=True, help="Write nothing.")
def main(*, fine: bool, drawn: int | None, healthy: int, seed: int, checks: bool) -> None:
    """Write summary and pages; exit with 1 if a promise is broken, or the summary is stale."""
    if checks:
        sys.exit(check())
    coarse = grid_cells(COARSE_SEED)
    asked = [("coarse", COARSE_SEED, coarse)]
    if fine:
        asked.append(("fine", seed, grid_cells(seed, fine=True)))
    if drawn is not None:
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
        "command": " ".join(
            (
                "tools/fmeda.py",
                *(("--fine",) if fine else ()),
                *((f"--random {drawn}",) if drawn else ()),
                f"--healthy {healthy} --seed {seed}",
            )
        ),
        "promise": PROMISES._asdict(),
        "sweeps": sweeps,
        "failures": summary(results),
        "factors": {factor: summary(results, row_of_factor(factor)) for factor in FACTORS},
        "healthy": runs,
    }
    SUMMARY.write_text(json.dumps(made, indent=1) + "\n", encoding="utf-8")
    write_pages()
    run, broken = (sum(sweep[name] for sweep in sweeps) for name in ("cells", "violations"))
    print(f"{run} cells, {broken} violations; {runs['false']} false trips")
    sys.exit(1 if broken or runs["false"] else 0)


if __name__ == "__main__":
    main()

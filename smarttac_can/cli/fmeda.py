"""The command ``fmeda``: sensors that fail one at a time, and what the plate does meanwhile."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import Final

import click

from smarttac_can.cli.options import seed_option
from smarttac_can.cli.plain_errors import plain_errors
from smarttac_can.cli.result_file import (
    force_option,
    json_file_option,
    opened_results,
    report_results,
)
from smarttac_can.host.terminal import progress_bar
from smarttac_can.trials.healthy_runs import HealthyRun, healthy_as_json, healthy_run
from smarttac_can.trials.sensor_sweep import (
    Cell,
    Result,
    as_json,
    grid_cells,
    parse_cell,
    random_cells,
    run_all,
    run_cell,
    summary,
)

_WORST: Final = 20
"""Violations that are printed."""


def _cell(_ctx: click.Context, _param: click.Parameter, texts: tuple[str, ...]) -> list[Cell]:
    try:
        return [parse_cell(text) for text in texts]
    except ValueError as error:
        raise click.BadParameter(str(error)) from None


@click.command(
    epilog="\b\nExamples:\n  smarttac fmeda --json fmeda.json\n"
    "  smarttac fmeda --random 5000 --seed 7 --workers 2\n"
    "  smarttac fmeda --healthy 1000 --seed 3\n"
    "  smarttac fmeda --cell failure=d:gain:0.05,mode=AMPLITUDE,detuning=-90"
)
@click.option(
    "--coarse/--fine",
    "coarse",
    default=True,
    show_default=True,
    help="The sweep of a minute, or that of 20 minutes on two processors.",
)
@click.option(
    "--random",
    "random_",
    type=click.IntRange(min=1),
    help="Instead, so many cells that --seed draws from the continuous ranges.",
)
@click.option(
    "--healthy",
    type=click.IntRange(min=1),
    help="Instead, so many runs without a failure: none may end in a fault that has no cause.",
)
@click.option(
    "--cell",
    "cells",
    multiple=True,
    callback=_cell,
    metavar="NAME=VALUE,...",
    help="Instead, this cell alone, as a line of the results names it; may be given again.",
)
@seed_option("Seed of the cells, or of the first healthy run.")
@click.option(
    "--workers",
    type=click.IntRange(min=1),
    default=1,
    show_default=True,
    help="Processes that share the work.",
)
@json_file_option
@force_option()
def fmeda(
    *,
    coarse: bool,
    random_: int | None,
    healthy: int | None,
    cells: list[Cell],
    seed: int,
    workers: int,
    json_file: Path | None,
) -> None:
    """Let one sensor fail in many ways, modes and set-points, and hold the plate to its bounds.

    Shown are what ended the runs of each failure mode, and the worst true vibration of the plate
    meanwhile. A cell beyond what is promised is a violation.
    """
    if sum((random_ is not None, healthy is not None, bool(cells))) > 1:
        raise click.UsageError("--random, --healthy and --cell exclude each other")
    with plain_errors(), ExitStack() as stack:
        file = opened_results(stack, json_file)
        with progress_bar("cells") as progress:
            if healthy is not None:
                seeds = range(seed, seed + healthy)
                runs = list(run_all(healthy_run, seeds, workers=workers, progress=progress))
            else:
                if random_ is not None:
                    cells = random_cells(random_, seed)
                chosen = cells or grid_cells(seed, fine=not coarse)
                results = list(run_all(run_cell, chosen, workers=workers, progress=progress))
        if healthy is not None:
            report_results(healthy_as_json(runs), _healthy_lines(runs), file)
            bad, what = sum(run.false for run in runs), "healthy runs ended in a false trip"
        else:
            report_results(as_json(results), _lines(results), file)
            bad, what = sum(bool(r.violation) for r in results), "cells break the promise"
    if bad:
        raise click.ClickException(f"{bad} {what}")


def _lines(results: list[Result]) -> list[str]:
    worst = sorted((r for r in results if r.violation), key=lambda r: -r.energy_J)
    lines = []
    for name, row in summary(results).items():
        ended = ", ".join(
            f"{n} {by}" for by, n in sorted(row["ended"].items(), key=lambda i: -i[1])
        )
        lines.append(
            f"{name:<42} {row['cells']:5d} cells  {row['peak_um']:6.2f} um  "
            f"{row['above']:5d} cycles  {row['energy_J']:7.3f} J  "
            f"{row['violations']:4d} violations  {ended}"
        )
    if len(results) == 1:
        lines = [f"{name}: {getattr(results[0], name)}" for name in Result.__slots__]
    for result in worst[:_WORST] if len(results) > 1 else []:
        lines.append(
            f"{result.peak_um:.2f} um, {result.energy_J:.2f} J, {_ended(result)}: "
            f"{result.violation}\n    smarttac fmeda --cell {result.cell}"
        )
    if len(worst) > _WORST:
        lines.append(f"and {len(worst) - _WORST} more: --json has them all")
    lines.append(f"{len(results)} cells, {len(worst)} violations")
    return lines


def _ended(result: Result) -> str:
    return f"{result.ended_by} after {result.after}" if result.ended_by else "not ended"


def _healthy_lines(runs: list[HealthyRun]) -> list[str]:
    lines = [
        f"{'FALSE' if run.false else 'true '} seed {run.seed}: {run.ended_by} after {run.after} "
        f"cycles, {run.peak_um:.2f} um, {run.cause or 'no cause'}: {run.what}"
        for run in sorted(runs, key=lambda run: run.false)
        if run.ended_by
    ]
    cycles = sum(run.cycles for run in runs)
    limited = sum(run.limited for run in runs)
    lines.append(
        f"{len(runs)} healthy runs, {len(lines)} of them ended in a fault, "
        f"{sum(run.false for run in runs)} without a cause in the vibration of the plate; "
        f"{100.0 * limited / cycles:.1f} % of the cycles limited"
    )
    return lines

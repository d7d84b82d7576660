"""The command for evidence, ``python -m smarttac_can.assurance``.

Its subcommands break things on purpose: ``faults``, ``sensors``, ``attack`` and ``soak``.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from difflib import get_close_matches
from pathlib import Path
from typing import Final

import click

from smarttac_can.assurance.trials.fault_cases import CASES, WAYS, cases
from smarttac_can.assurance.trials.fault_matrix import (
    HOLD_CYCLES,
    FaultRow,
    fault_matrix,
    rows_as_json,
)
from smarttac_can.assurance.trials.healthy_runs import HealthyRun, healthy_as_json, healthy_run
from smarttac_can.assurance.trials.hostile import Hostile, HostileReport
from smarttac_can.assurance.trials.sensor_sweep import (
    Cell,
    Result,
    as_json,
    grid_cells,
    parse_cell,
    random_cells,
    run_cell,
    summary,
)
from smarttac_can.assurance.trials.soak import (
    CYCLES_PER_HOUR,
    SoakReport,
    Table,
    margin_rows,
    parts,
    soak_in_parts,
)
from smarttac_can.assurance.trials.workers import in_order
from smarttac_can.cli.shared import (
    FiniteRange,
    WholeRange,
    json_options,
    reporting,
    seed_option,
)
from smarttac_can.host.process_signals import endings_interrupt
from smarttac_can.host.terminal import progress_bar

_NAMES = sorted({case.name for case in CASES})
_MOST_NEAR: Final = 3


def _fault(_ctx: click.Context, _param: click.Parameter, names: tuple[str, ...]) -> tuple[str, ...]:
    for name in names:
        if name not in _NAMES:
            near = [known for known in _NAMES if name.lower() in known.lower()][:_MOST_NEAR]
            near = near or get_close_matches(name, _NAMES, _MOST_NEAR)
            hint = f", perhaps {' or '.join(map(repr, near))}" if near else ""
            raise click.BadParameter(
                f"there is no fault {name!r}{hint}: faults --list shows all {len(_NAMES)}"
            )
    return names


def _list_faults(ctx: click.Context, _param: click.Parameter, value: bool) -> None:
    if value:
        click.echo("\n".join(_NAMES))
        ctx.exit()


_jobs_option = click.option(
    "--jobs",
    type=WholeRange(min=1),
    help="Processes that share the work.  [default: one for each processor]",
)


_SELF: Final = "python -m smarttac_can.assurance"


@click.group(
    name=_SELF,
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog=f"Example: {_SELF} soak --hours 0.1",
)
@click.pass_context
def main(context: click.Context) -> None:
    """Evidence that the instrument fails safe: faults, sensors, attacks and hours of use."""
    context.with_resource(endings_interrupt())


@main.command(
    epilog=f"\b\nExamples:\n  {_SELF} faults --json faults.json\n"
    f'  {_SELF} faults --fault "S3 stuck" --mode friction'
)
@json_options()
@click.option(
    "--fault",
    "faults_",
    multiple=True,
    callback=_fault,
    metavar="NAME",
    help="Only this fault; may be given again.",
)
@click.option(
    "--list",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_list_faults,
    help="Show the names of all faults, and end.",
)
@click.option(
    "--mode",
    "modes",
    multiple=True,
    type=click.Choice(WAYS),
    help="Only in this mode, or under these laws; may be given again.",
)
@click.option(
    "--hold",
    type=WholeRange(min=0),
    default=HOLD_CYCLES,
    show_default=True,
    help="Cycles to stay at 0 V while the master sends at random.",
)
@_jobs_option
@click.option(
    "--channel",
    help="SocketCAN interface that carries the frames, such as vcan0. It allows one job only.",
)
def faults(
    *,
    json_file: Path | None,
    faults_: tuple[str, ...],
    modes: tuple[str, ...],
    hold: int,
    jobs: int | None,
    channel: str | None,
) -> None:
    """Inject every fault in every mode that drives, and show how soon the plate is at 0 V.

    Faults in which the controllers play a part are also injected with the predictive laws, as mode
    friction_predictive.

    Stimulator, plate and master are simulated, on a bus inside the process or on --channel. No
    other node may send on this channel. The rows are the same on both buses.
    """
    try:
        chosen = cases(faults_, modes)
    except ValueError as error:
        raise click.UsageError(str(error)) from error
    if channel is not None and jobs not in (None, 1):
        raise click.UsageError(f"--jobs {jobs}: with --channel there is one process")
    if channel is not None or len(chosen) == 1:
        jobs = 1
    with reporting(json_file) as write_results:
        rows = []
        with progress_bar("faults") as progress:
            for row in fault_matrix(
                chosen, hold=hold, jobs=jobs or os.cpu_count() or 1, channel=channel
            ):
                rows.append(row)
                progress(len(rows) / len(chosen))
        write_results(rows_as_json(rows), map(_row_line, rows))
    failed = [row for row in rows if not row.passed]
    if failed:
        raise click.ClickException(f"{len(failed)} of {len(rows)} faults did not end as required")


@main.command(epilog=f"Example: {_SELF} soak --hours 0.1 --seed 7 --json soak.json")
@click.option(
    "--hours",
    type=FiniteRange(min=0.0, max=10_000.0, min_open=True),
    required=True,
    help="Simulated time in hours.",
)
@seed_option("Seed of all that happens.")
@_jobs_option
@json_options()
def soak(hours: float, seed: int, jobs: int | None, json_file: Path | None) -> None:
    """Simulate hours of random runs and faults, and check every cycle.

    Modes, laws, set-points, fingers, SDO traffic, faults and restarts come at random, in parts of
    an hour at most. The same seed and time give the same run, whatever the number of processes.
    """
    with reporting(json_file) as write_results:
        with progress_bar("soaking") as progress:
            report = soak_in_parts(
                parts(max(1, round(hours * CYCLES_PER_HOUR)), seed),
                jobs=jobs or os.cpu_count() or 1,
                progress=progress,
            )
        write_results(report.as_json(), [_soak_summary(report)])
    if not report.passed:
        raise click.ClickException(f"{report.violated} violated invariants")


def _row_line(row: FaultRow) -> str:
    zero = "never at 0 V" if row.cycles_to_zero is None else f"0 V after {row.cycles_to_zero:4d}"
    verdict = "ok    " if row.passed else "FAILED"
    return (
        f"{verdict} {row.fault:<44} {row.mode:<20} {row.voltage_before_v:6.2f} V  {zero} "
        f"(bound {row.detection_bound_cycles})  EMCY {row.emcy_code or 'none'}  "
        f"{row.state_after}{'' if row.held else ', did not stay at 0 V'}"
        f"{'' if row.recovered else ', did not recover'}"
    )


def _soak_summary(report: SoakReport) -> str:
    laws = ", ".join(
        f"{kind} {law} {seconds:.0f} s"
        for kind, times in (
            ("friction", report.friction_law_s),
            ("vibration", report.vibration_law_s),
        )
        for law, seconds in times.items()
    )
    lines = [
        f"seed {report.seed}: {report.simulated_s:.0f} s simulated in {report.wall_s:.0f} s of a "
        f"process, {report.speed:.1f} times real time",
        f"{report.runs} runs, {sum(report.driving_s.values()):.0f} s of them with a voltage",
        f"under the laws: {laws}",
        f"{sum(report.faults.values())} faults, {report.latched} of them latched; "
        f"{sum(report.tolerated.values())} tolerated ones",
        f"{report.emergencies} emergency messages, {report.master_restarts} restarts of the "
        f"master, {report.transfers} of its transfers at random",
        "runs ended by set-points at random: "
        + (", ".join(f"{n} by {cause}" for cause, n in report.tripped.items()) or "none"),
        "largest level of each watchdog while nothing was broken; 1.0 is a fault:",
        *_margins(report.margins),
        f"fingerprint {report.fingerprint}, {report.violated} violated invariants",
        *report.violations,
    ]
    return "\n".join(lines)


def _margins(margins: Table) -> Iterator[str]:
    """Yield the levels by mode, a watchdog per line; events have none."""
    for at, (name, what, *levels) in enumerate(margin_rows(margins)):
        cells = levels if what != "event" else ["event"]
        first = name if at else ""
        yield f"{first:<20}" + "".join(f"{cell:>21}" for cell in cells)


@main.command(epilog=f"Example: {_SELF} attack --actions 100000 --seed 7 --json attack.json")
@click.option("--actions", type=WholeRange(min=1), required=True, help="Frames to send.")
@seed_option("Seed of all that happens.")
@json_options()
def attack(actions: int, seed: int, json_file: Path | None) -> None:
    """Attack a driven stimulator and plate from a third node, and check every cycle.

    The third node sends random SDO requests, PDOs, SYNC, EMCY, heartbeats, NMT commands and invalid
    frames. A master arms again and resets faults. The same seed and number give the same run.
    """
    with reporting(json_file) as write_results:
        with progress_bar("attacking") as progress:
            report = Hostile(actions, seed, progress).run()
        write_results(report.as_json(), [_attack_summary(report)])
    if not report.passed:
        raise click.ClickException(f"{report.violated} violations")


def _attack_summary(report: HostileReport) -> str:
    lines = [
        f"seed {report.seed}: {sum(report.actions.values())} frames in {report.cycles} cycles, "
        f"{report.wall_s:.0f} s",
        *(f"{count:9d} {kind}" for kind, count in report.actions.items()),
        f"running {100 * report.running_share:.1f} % of the cycles, "
        f"{100 * report.running_share_alone:.1f} % of those without a double; a voltage in "
        f"{100 * report.driven_share:.1f} %",
        f"{report.resets} faults reset, {report.arms} times armed, {report.repairs} objects put "
        "right by the master",
        f"at most {report.peak_um:.2f} um and {report.peak_v:.2f} V, {report.violated} violations",
        *report.violations,
    ]
    return "\n".join(lines)


_WORTH_A_PROCESS: Final = 8
"""Least number of cells for which starting a process saves time."""
_WORST: Final = 20
"""Most violations that are printed."""


def _cell(_ctx: click.Context, _param: click.Parameter, texts: tuple[str, ...]) -> list[Cell]:
    try:
        return [parse_cell(text) for text in texts]
    except ValueError as error:
        raise click.BadParameter(str(error)) from None


@main.command(
    epilog=f"\b\nExamples:\n  {_SELF} sensors --json sensors.json\n"
    f"  {_SELF} sensors --random 5000 --seed 7 --jobs 2\n"
    f"  {_SELF} sensors --healthy 1000 --seed 3\n"
    f"  {_SELF} sensors --cell failure=d:gain:0.05,mode=AMPLITUDE,detuning=-90"
)
@click.option(
    "--coarse/--fine",
    "coarse",
    default=True,
    show_default=True,
    help="Coarse sweep (about a minute) or fine sweep (20 minutes on two processors).",
)
@click.option(
    "--random",
    "random_",
    type=WholeRange(min=1),
    help="Run this number of random cells instead, drawn with --seed.",
)
@click.option(
    "--healthy",
    type=WholeRange(min=1),
    help="Run this number of runs without a failure instead; none may end in a false alarm.",
)
@click.option(
    "--cell",
    "cells",
    multiple=True,
    callback=_cell,
    metavar="NAME=VALUE,...",
    help="Run only this cell, written as in the results; may be given again.",
)
@seed_option("Seed of the cells, or of the first healthy run.")
@_jobs_option
@json_options()
def sensors(
    *,
    coarse: bool,
    random_: int | None,
    healthy: int | None,
    cells: list[Cell],
    seed: int,
    jobs: int | None,
    json_file: Path | None,
) -> None:
    """Inject failures of a sensor in many modes and set-points, and check the bounds of the plate.

    The results show what ended the runs of each failure mode, and the largest true vibration of
    the plate until then. A cell is one run of the sweep, with one failure in one mode. A cell whose
    vibration exceeds the documented bounds is a violation.
    """
    if sum((random_ is not None, healthy is not None, bool(cells))) > 1:
        raise click.UsageError("--random, --healthy and --cell exclude each other")
    with reporting(json_file) as write_results:
        with progress_bar("cells") as progress:
            if healthy is not None:
                seeds = range(seed, seed + healthy)
                runs = list(in_order(healthy_run, seeds, jobs or _jobs_for(healthy), progress))
            else:
                if random_ is not None:
                    cells = random_cells(random_, seed)
                chosen = cells or grid_cells(seed, fine=not coarse)
                each = jobs or _jobs_for(len(chosen))
                results = list(in_order(run_cell, chosen, each, progress))
        if healthy is not None:
            write_results(healthy_as_json(runs), _healthy_lines(runs))
            bad, what = sum(run.false for run in runs), "healthy runs ended in a false trip"
        else:
            write_results(as_json(results), _sweep_lines(results))
            bad, what = sum(bool(r.violation) for r in results), "cells break the promise"
    if bad:
        raise click.ClickException(f"{bad} {what}")


def _jobs_for(items: int) -> int:
    """Return the number of processes for so many items: one for each processor that has work."""
    return min(os.cpu_count() or 1, -(-items // _WORTH_A_PROCESS))


def _sweep_lines(results: list[Result]) -> list[str]:
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
            f"{result.violation}\n    {_SELF} sensors --cell {result.cell}"
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

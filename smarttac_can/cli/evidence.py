"""Commands that inject faults on purpose: ``faults``, ``soak``, ``hostile`` and ``fmeda``."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Final

import click
from click.core import ParameterSource

from smarttac_can.assurance.audit import verify_rows
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
from smarttac_can.bench.simulation import plate_od, stimulator_od
from smarttac_can.cli.shared import (
    FiniteRange,
    json_options,
    naming,
    plain_errors,
    reporting,
    result_path,
    seed_option,
)
from smarttac_can.host.files import read_bounded, result_file
from smarttac_can.host.log_file import CandumpWriter, read_candump
from smarttac_can.host.terminal import progress_bar

_NAMES = sorted({case.name for case in CASES})
_ROWS_MAX_BYTES: Final = 4 << 20


def _fault(_ctx: click.Context, _param: click.Parameter, names: tuple[str, ...]) -> tuple[str, ...]:
    for name in names:
        if name not in _NAMES:
            near = get_close_matches(name, _NAMES)
            hint = f"perhaps {_quoted(near, ' or ')}" if near else _quoted(_NAMES, ", ")
            raise click.BadParameter(f"there is no fault {name!r}: {hint}")
    return names


def _quoted(names: Iterable[str], separator: str) -> str:
    return separator.join(map(repr, names))


def _log_file(_ctx: click.Context, _param: click.Parameter, path: Path | None) -> Path | None:
    if path == Path("-"):
        raise click.BadParameter("'-' is no file: stdout is for the rows")
    return path


_jobs_option = click.option(
    "--jobs",
    type=click.IntRange(min=1),
    help="Processes that share the work.  [default: one for each processor]",
)


@click.command(
    epilog="\b\nExamples:\n  smarttac faults --json faults.json --log faults.log\n"
    '  smarttac faults --fault "S3 stuck" --mode friction\n'
    "  smarttac faults --verify faults.log faults.json"
)
@json_options()
@click.option(
    "--log",
    "log_file",
    type=result_path,
    callback=_log_file,
    help="File for the frames around each fault, as candump -L has them.",
)
@click.option(
    "--fault",
    "faults_",
    multiple=True,
    callback=_fault,
    metavar="NAME",
    help="Only this fault; may be given again.",
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
    type=click.IntRange(min=0),
    default=HOLD_CYCLES,
    show_default=True,
    help="Cycles to stay at 0 V while the master sends at random.",
)
@_jobs_option
@click.option(
    "--channel",
    help="SocketCAN interface that carries the frames, such as vcan0; then there is one process.",
)
@click.option(
    "--verify",
    nargs=2,
    type=click.Path(path_type=Path),
    metavar="LOG ROWS",
    help="Inject nothing: recompute the rows of a --json file from its --log, and compare.",
)
@click.pass_context
def faults(
    context: click.Context,
    *,
    json_file: Path | None,
    log_file: Path | None,
    faults_: tuple[str, ...],
    modes: tuple[str, ...],
    hold: int,
    jobs: int | None,
    channel: str | None,
    verify: tuple[Path, Path] | None,
) -> None:
    """Inject every fault in every mode that drives, and show how soon the plate is at 0 V.

    What acts through the loop comes under the predictive laws as well, as friction_predictive.

    Everything is simulated: stimulator, plate and master, on a bus inside the process unless there
    is a --channel. Nothing else may send there. The rows are the same either way.
    """
    if verify is not None:
        _require_alone(context, "verify")
        _verify(*verify)
        return
    try:
        chosen = cases(faults_, modes)
    except ValueError as error:
        raise click.UsageError(str(error)) from error
    if channel is not None and jobs not in (None, 1):
        raise click.UsageError(f"--jobs {jobs}: with --channel there is one process")
    if channel is not None or len(chosen) == 1:
        jobs = 1
    with reporting(json_file) as write_results, ExitStack() as stack:
        log = None
        if log_file is not None:
            log = CandumpWriter(stack.enter_context(result_file(log_file))).write
        rows = []
        with progress_bar("faults") as progress:
            for row in fault_matrix(
                chosen, hold=hold, log=log, jobs=jobs or os.cpu_count() or 1, channel=channel
            ):
                rows.append(row)
                progress(len(rows) / len(chosen))
        write_results(rows_as_json(rows), map(_row_line, rows))
    failed = [row for row in rows if not row.passed]
    if failed:
        raise click.ClickException(f"{len(failed)} of {len(rows)} faults did not end as they must")


def _require_alone(context: click.Context, name: str) -> None:
    """Refuse any other option beside one that excludes all others."""
    for parameter in context.command.params:
        source = context.get_parameter_source(str(parameter.name))
        if parameter.name != name and source is ParameterSource.COMMANDLINE:
            raise click.UsageError(f"{parameter.opts[0]} has no meaning with --{name}")


def _verify(log: Path, rows: Path) -> None:
    """Print how many fields of rows a log confirms; the first wrong one is an error."""
    with plain_errors(ValueError, RecursionError):
        with naming(rows, ValueError, RecursionError):
            stated = _read_rows(rows)
        found = verify_rows(read_candump(log), stated, stimulator_od(), plate_od())
    click.echo(
        f"rows: {found.rows}, fields as the log shows them: {found.fields}, "
        f"fields it does not show: {found.not_shown}"
    )


def _read_rows(rows: Path) -> Any:
    try:
        return json.loads(read_bounded(rows, _ROWS_MAX_BYTES))
    except json.JSONDecodeError as error:
        raise ValueError(f"is no --json file ({error}); --verify takes LOG ROWS") from error


@click.command(epilog="Example: smarttac soak --hours 0.1 --seed 7 --json soak.json")
@click.option(
    "--hours",
    type=FiniteRange(min=0.0, max=10_000.0, min_open=True),
    required=True,
    help="Simulated time.",
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


@click.command(epilog="Example: smarttac hostile --actions 100000 --seed 7 --json hostile.json")
@click.option("--actions", type=click.IntRange(min=1), required=True, help="Frames that are sent.")
@seed_option("Seed of all that happens.")
@json_options()
def hostile(actions: int, seed: int, json_file: Path | None) -> None:
    """Attack a driven stimulator and plate from a third node, and check every cycle.

    SDO requests, PDOs, SYNC, EMCY, heartbeats, NMT and garbage come at random, while a master arms
    again and resets faults. The same seed and number give the same run.
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


@click.command(
    epilog="\b\nExamples:\n  smarttac fmeda --json fmeda.json\n"
    "  smarttac fmeda --random 5000 --seed 7 --jobs 2\n"
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
@_jobs_option
@click.option("--workers", type=click.IntRange(min=1), hidden=True)
@json_options()
def fmeda(
    *,
    coarse: bool,
    random_: int | None,
    healthy: int | None,
    cells: list[Cell],
    seed: int,
    jobs: int | None,
    workers: int | None,
    json_file: Path | None,
) -> None:
    """Inject failures of a sensor in many modes and set-points, and check the bounds of the plate.

    Shown are what ended the runs of each failure mode, and the worst true vibration of the plate
    meanwhile. A cell beyond what is promised is a violation.
    """
    if sum((random_ is not None, healthy is not None, bool(cells))) > 1:
        raise click.UsageError("--random, --healthy and --cell exclude each other")
    if workers is not None:
        click.echo("--workers is deprecated: use --jobs", err=True)
        jobs = jobs or workers
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

"""The command that records a stimulator while others drive it: ``record``."""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from time import monotonic, sleep

import click

from smarttac_can.bench.recording import Recording
from smarttac_can.bench.recording_file import METADATA, Summary, make_recording, require_new
from smarttac_can.bench.stimulator import Stimulator
from smarttac_can.cli.options import (
    NEW_FILE,
    OLD_FILE,
    BusChoice,
    FiniteRange,
    stimulator_options,
    timeout_option,
)
from smarttac_can.cli.plain_errors import plain_errors
from smarttac_can.cli.result_file import (
    force_option,
    json_file_option,
    opened_results,
    report_results,
)
from smarttac_can.host.process_signals import stop_on_signals

_LONGEST_S = 7 * 24 * 3600.0
_LOOK_S = 0.1
_SILENT_S = 1.0


@click.command(
    epilog="\b\nExamples:\n  smarttac record run.h5 --interface socketcan --channel can0\n"
    "  smarttac record run.h5 --interface socketcan --channel can0 --seconds 60 --raw run.blf\n"
    "  smarttac record run.h5 --channel can0 --subject P07 --operator jd --notes 'dry finger'\n"
    "  smarttac record --recover run.h5.log run.h5"
)
@click.argument("file", type=NEW_FILE)
@stimulator_options
@click.option(
    "--seconds",
    type=FiniteRange(min=0.1, max=_LONGEST_S),
    help="How long; without, until Ctrl-C or SIGTERM.",
)
@click.option(
    "--raw",
    type=NEW_FILE,
    help="File for all frames on the bus besides: .asc, .blf, .csv, .log, .trc and so on.",
)
@click.option("--subject", metavar="TEXT", help="Who is recorded, for the file.")
@click.option("--operator", metavar="TEXT", help="Who records, for the file.")
@click.option("--notes", metavar="TEXT", help="What else is to be known, for the file.")
@click.option(
    "--recover",
    "log",
    type=OLD_FILE,
    metavar="LOG",
    help="Make FILE of the log that a killed recording has left, FILE.log; no bus is needed.",
)
@timeout_option
@json_file_option
@force_option("Replace an older --json file; FILE and --raw are never replaced.")
def record(
    *,
    file: Path,
    bus: BusChoice,
    node_id: int,
    plate_node: int | None,
    seconds: float | None,
    raw: Path | None,
    subject: str | None,
    operator: str | None,
    notes: str | None,
    log: Path | None,
    timeout: float,
    json_file: Path | None,
) -> None:
    """Record every cycle of a stimulator into the HDF5 file FILE, whoever drives it.

    It starts the nodes and only reads: set-points, modes and voltage stay others' business, and
    Ctrl-C ends the recording, not the drive. If no cycle came, the exit code is 1.
    """
    _refuse_twice(file, raw, json_file)
    said = zip(METADATA, (subject, operator, notes), strict=True)
    metadata = {name: text for name, text in said if text is not None}
    with plain_errors(ValueError), ExitStack() as stack:
        require_new(file)
        results = opened_results(stack, json_file)
        if log is not None:
            _refuse_bus(bus, seconds, raw, *metadata)
            summary = make_recording(log, file)
        else:
            summary = _record(
                file,
                lambda: Stimulator.connect(
                    **bus.options, node_id=node_id, plate_node_id=plate_node, timeout=timeout
                ),
                seconds,
                raw,
                metadata,
            )
        report_results({"file": str(file), **summary._asdict()}, _lines(file, summary), results)
        if log is None and summary.rows == 0:
            raise ValueError(
                f"{file} has no row: no cycle came. The loop needs SYNC and both nodes "
                "OPERATIONAL; nodes in lockstep run only while a script calls run()"
            )


def _refuse_twice(file: Path, *others: Path | None) -> None:
    """Refuse another file in the place of the recording, or of what stands beside it."""
    own = [file.with_name(file.name + suffix).resolve() for suffix in ("", ".log", ".part")]
    for other in others:
        if other is not None and other.resolve() in own:
            raise click.UsageError(f"{other} is a file of the recording itself: choose another")


def _refuse_bus(bus: BusChoice, *others: object) -> None:
    if bus.options or any(other is not None for other in others):
        raise click.UsageError("--recover needs a log and no bus: leave out the other options")


def _record(
    file: Path,
    connect: Callable[[], Stimulator],
    seconds: float | None,
    raw: Path | None,
    metadata: dict[str, str],
) -> Summary:
    with stop_on_signals() as stopped, connect() as bench:
        with bench.record(file, raw=raw, **metadata) as recording:
            if recording.raw_note:
                click.echo(recording.raw_note, err=True)
            click.echo(f"recording {file}", err=True)  # scripts wait for it
            _wait(recording, stopped, seconds)
        assert recording.summary is not None
        return recording.summary


def _wait(recording: Recording, stopped: Callable[[], bool], seconds: float | None) -> None:
    """Wait until the recording is to end, and say on stderr how it goes."""
    begun = said = monotonic()
    cycles = recording.cycles
    silent = False
    while not stopped() and (seconds is None or monotonic() < begun + seconds):
        sleep(_LOOK_S)
        recording.check()
        now = monotonic()
        if now < said + _SILENT_S:
            continue
        said, before, cycles = now, cycles, recording.cycles
        if sys.stderr.isatty():
            click.echo(f"\r{now - begun:.0f} s, {cycles} cycles", err=True, nl=False)
        if (cycles == before) is not silent:
            silent = not silent
            words = "no cycle comes; it goes on when one does" if silent else "cycles come again"
            click.echo(f"{now - begun:.0f} s: {words}", err=True)


def _lines(file: Path, summary: Summary) -> list[str]:
    counts = [
        _counted(summary.rows, "row"),
        f"{_counted(summary.lost, 'lost tick')} in {_counted(summary.gaps, 'gap')}",
        _counted(summary.runs, "run"),
        _counted(summary.markers, "marker"),
        f"{_counted(summary.set_points, 'change')} of set-points",
        _counted(summary.textures, "texture"),
        f"{summary.emergencies} {'emergency' if summary.emergencies == 1 else 'emergencies'}",
    ]
    lines = [f"{file}: {', '.join(counts)}"]
    if summary.damaged:
        were = "was" if summary.damaged == 1 else "were"
        records = _counted(summary.damaged, "record")
        lines.append(f"{records} of the log {were} cut or damaged, and left out")
    return lines


def _counted(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"

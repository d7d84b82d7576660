"""Commands that make a recording and compute it again: ``record`` and ``replay``."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from time import monotonic, sleep
from typing import Any, Final

import click
from click.core import ParameterSource

from smarttac_can.bench.network import require_folder, require_raw
from smarttac_can.bench.recording import Recording
from smarttac_can.bench.recording_file import METADATA, Summary, make_recording, require_new
from smarttac_can.bench.simulation import PLATE_ID, STIMULATOR_ID
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.device.storage import Memory
from smarttac_can.cli.nodes import blaming, load_node
from smarttac_can.cli.shared import (
    NEW_FILE,
    NODE_ID,
    OLD_FILE,
    BusChoice,
    FiniteRange,
    StimulatorChoice,
    WholeRange,
    json_options,
    one_line,
    refuse_own_files,
    reporting,
    require_image,
    require_two_nodes,
    stimulator_options,
    timeout_option,
)
from smarttac_can.host.log_file import read_log
from smarttac_can.host.process_signals import stop_on_signals
from smarttac_can.instrument.nodes.stimulator_node import StimulatorNode
from smarttac_can.instrument.replay import DifferenceError, Replay, Replayed
from smarttac_can.vocabulary.signals import SHORT_DEADLINE_MS

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
    help="Length of the recording in s.  [default: until Ctrl-C or SIGTERM]",
)
@click.option(
    "--raw",
    type=NEW_FILE,
    help="Additional file for all frames on the bus: .asc, .blf, .csv, .log, .trc and so on.",
)
@click.option("--subject", metavar="TEXT", help="Person who is recorded, stored in the file.")
@click.option("--operator", metavar="TEXT", help="Person who records, stored in the file.")
@click.option("--notes", metavar="TEXT", help="Notes, stored in the file.")
@click.option(
    "--recover",
    "log",
    type=OLD_FILE,
    metavar="LOG",
    help="Make FILE from the log of a killed recording, FILE.log; no bus is needed.",
)
@timeout_option
@json_options(force="Replace an older --json file; FILE and --raw are never replaced.")
def record(
    *,
    file: Path,
    at: StimulatorChoice,
    seconds: float | None,
    raw: Path | None,
    subject: str | None,
    operator: str | None,
    notes: str | None,
    log: Path | None,
    timeout: float,
    json_file: Path | None,
) -> None:
    """Record every cycle of a stimulator into the HDF5 file FILE, while another program drives it.

    This command starts the nodes. Then it only reads: it changes no set-point, mode or voltage.
    Ctrl-C ends the recording, not the drive. If no cycle came, the exit code is 1.
    """
    own = [file.with_name(file.name + suffix) for suffix in ("", ".log")]
    refuse_own_files(own, (raw, json_file), "the recording")
    given = dict(zip(METADATA, (subject, operator, notes), strict=True))
    with reporting(json_file, ValueError) as write_results:
        require_new(file)
        if log is not None:
            _refuse_bus(
                at.bus, seconds, raw, *(name for name, text in given.items() if text is not None)
            )
            summary = make_recording(log, file)
        else:
            require_folder(file)
            if raw is not None:
                require_raw(raw)
            with stop_on_signals() as stopped, at.connect(timeout=timeout) as bench:
                recording = bench.record(
                    file, raw=raw, subject=subject or "", operator=operator or "", notes=notes or ""
                )
                summary = _recorded(recording, stopped, seconds)
        write_results({"file": str(file), **summary._asdict()}, _lines(file, summary))
        if log is None and summary.rows == 0:
            raise ValueError(
                f"{file} has no row: no cycle came. The loop needs SYNC and both nodes "
                "OPERATIONAL; nodes in lockstep run only while a script calls run()"
            )


def _refuse_bus(bus: BusChoice, *others: object) -> None:
    if bus.options or any(other is not None for other in others):
        raise click.UsageError("--recover needs a log and no bus: leave out the other options")


def _recorded(recording: Recording, stopped: Callable[[], bool], seconds: float | None) -> Summary:
    with recording:
        if recording.raw_note:
            click.echo(recording.raw_note, err=True)
        click.echo(f"recording {recording.path}", err=True)  # scripts wait for it
        _wait(recording, stopped, seconds)
    assert recording.summary is not None
    return recording.summary


def _wait(recording: Recording, stopped: Callable[[], bool], seconds: float | None) -> None:
    begun = shown_at = monotonic()
    cycles = recording.cycles
    silent = False
    while not stopped() and (seconds is None or monotonic() < begun + seconds):
        sleep(_LOOK_S)
        recording.check()
        now = monotonic()
        if now < shown_at + _SILENT_S:
            continue
        shown_at, before, cycles = now, cycles, recording.cycles
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
        f"{_counted(summary.limited, 'row')} at a limit",
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


_FRAMES: Final = 1000
"""Number of frames that are replayed between two checks of the clock."""
_SHOWN_S: Final = 1.0
_EARLY_S: Final = 1.0
_START_OPTIONS: Final = ("lockstep", "produce_sync", "plate_node", "deadline", "eds", "storage")
"""Parameters that describe how the stimulator was started."""


@click.command(
    epilog="\b\nExamples:\n  smarttac replay run.log\n"
    "  smarttac replay run.blf --node-id 32 --plate-node 33 --json replay.json\n"
    "  smarttac replay lockstep.log --lockstep"
)
@click.argument("log", type=OLD_FILE)
@click.option(
    "--node-id",
    type=NODE_ID,
    default=STIMULATOR_ID,
    show_default=True,
    help="Node-ID of the stimulator.",
)
@click.option(
    "--plate-node",
    type=NODE_ID,
    default=PLATE_ID,
    show_default=True,
    help="Node-ID of the plate.",
)
@click.option("--produce-sync", is_flag=True, help="The stimulator ran with --produce-sync.")
@click.option("--lockstep", is_flag=True, help="The stimulator ran with --lockstep.")
@click.option(
    "--deadline",
    type=WholeRange(min=1, max=1000),
    metavar="MS",
    help="Deadline of the loop in ms, if it was not that of the EDS. In lockstep and with"
    f" --realtime it is {SHORT_DEADLINE_MS}.",
)
@click.option("--eds", type=OLD_FILE, metavar="FILE", help="EDS that the stimulator had.")
@click.option(
    "--storage",
    type=OLD_FILE,
    metavar="FILE",
    help="File of --storage as it was when the stimulator started; it is only read.",
)
@json_options()
def replay(
    *,
    log: Path,
    node_id: int,
    plate_node: int,
    produce_sync: bool,
    lockstep: bool,
    deadline: int | None,
    eds: Path | None,
    storage: Path | None,
    json_file: Path | None,
) -> None:
    """Recompute the frames of a stimulator from a log, and report the first difference.

    LOG is a candump, ASC, BLF, CSV or TRC file with the frames of stimulator and plate node, for
    example from smarttac record --raw. It has to begin before the stimulator is switched on or
    reset. A new stimulator with the same EDS receives the frames of the other nodes, at the times
    of the log. Each frame that it sends is compared with the log: drives, public TPDOs,
    emergencies, SDO answers. The exit code is 0 if every frame of the stimulator in LOG was
    recomputed and is equal. It is 1 at a difference, and 3 if a part of LOG could not be judged;
    the error then names the part and its share.
    """
    require_two_nodes(node_id, plate_node)
    if lockstep and produce_sync:
        raise click.UsageError("in --lockstep the bench produces SYNC: leave out --produce-sync")
    with reporting(json_file) as write_results, blaming(eds):
        if deadline is None and lockstep:
            deadline = SHORT_DEADLINE_MS
        memory = Memory()
        if storage is not None:
            memory.write(require_image(storage))

        def power_on() -> StimulatorNode:
            return StimulatorNode(
                load_node("stimulator.eds", eds, node_id, False, STIMULATOR_ID)[0],
                plate_node_id=plate_node,
                produce_sync=produce_sync,
                lockstep=lockstep,
                deadline_ms=deadline,
                storage=memory,
            )

        power_on()  # refuse a wrong EDS before the log is read
        found = _replay(log, Replay(power_on, node_id, lockstep=lockstep))
        write_results({"log": str(log), **_as_json(found)}, [_line(log, found)])
    if isinstance(found, DifferenceError):
        raise click.ClickException(one_line(f"{log}: {found}{_missing_options(found.so_far)}"))
    if found.unjudged:
        raise _NotJudgedError(one_line(f"{log}: {_not_judged(found)}"))


class _NotJudgedError(click.ClickException):
    """A log, or a part of it, that could not be judged."""

    exit_code = 3


def _not_judged(found: Replayed) -> str:
    percent = 100 * found.unjudged_share
    parts = "; ".join(map(str, found.unjudged))
    return f"{percent:.1f} % of the {found.ended_s:.3f} s could not be judged: {parts}"


def _missing_options(done: Replayed) -> str:
    """Return a hint to options that may be missing, if a log differs from its start on."""
    given = click.get_current_context().get_parameter_source
    left = [
        f"--{o.replace('_', '-')}" for o in _START_OPTIONS if given(o) is ParameterSource.DEFAULT
    ]
    if not left or done.ended_s - done.begun_s > _EARLY_S:
        return ""
    return (
        f"; so early, it may have been started with an option that is not given: {', '.join(left)}"
    )


def _replay(log: Path, run: Replay) -> Replayed | DifferenceError:
    try:
        for time, frame in _showing(
            read_log(log, lambda line: click.echo(one_line(line), err=True))
        ):
            run.take(time, frame)
        return run.end()
    except DifferenceError as difference:
        return difference
    except (ValueError, EOFError) as error:
        text = str(error)
        raise _NotJudgedError(
            one_line(text if text.startswith(str(log)) else f"{log}: {text}")
        ) from error


def _showing(frames: Iterable[tuple[int, Frame]]) -> Iterator[tuple[int, Frame]]:
    """Yield the frames, and print the progress of the replay on a terminal once a second."""
    shown_at = monotonic()
    first: int | None = None
    for number, (time, frame) in enumerate(frames):
        first = time if first is None else first
        if number % _FRAMES == 0 and sys.stderr.isatty() and monotonic() > shown_at + _SHOWN_S:
            shown_at = monotonic()
            click.echo(f"\r{(time - first) * 1e-6:.0f} s, {number} frames", err=True, nl=False)
        yield time, frame


def _as_json(found: Replayed | DifferenceError) -> dict[str, Any]:
    done, difference = found, None
    if isinstance(found, DifferenceError):
        done, difference = found.so_far, found.difference.as_json()
    assert isinstance(done, Replayed)
    return {
        "same": difference is None and not done.unjudged,
        **done._asdict(),
        "unjudged": [part._asdict() for part in done.unjudged],
        "unjudged_share": done.unjudged_share,
        "difference": difference,
    }


def _line(log: Path, found: Replayed | DifferenceError) -> str:
    done = found.so_far if isinstance(found, DifferenceError) else found
    other = done.compared - done.drives
    return (
        f"{log}: {done.frames} frames up to {done.ended_s:.3f} s, from the boot-up at "
        f"{done.begun_s:.3f} s on; {done.drives} drives and {other} other frames of the node "
        "recomputed and the same"
    )

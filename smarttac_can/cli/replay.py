"""The command that replays a log through the controllers: ``replay``."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from pathlib import Path
from time import monotonic
from typing import Any, Final

import click
from click.core import ParameterSource

from smarttac_can.bench.simulation import PLATE_ID, STIMULATOR_ID
from smarttac_can.cli.nodes import blaming, load_device
from smarttac_can.cli.options import NODE_ID, OLD_FILE, require_image
from smarttac_can.cli.plain_errors import one_line, plain_errors
from smarttac_can.cli.process import lockstep_option
from smarttac_can.cli.result_file import (
    force_option,
    json_file_option,
    opened_results,
    report_results,
)
from smarttac_can.device.frame import Frame
from smarttac_can.device.storage import Memory
from smarttac_can.host.log_file import read_log
from smarttac_can.nodes.stimulator_node import StimulatorNode
from smarttac_can.replay import DifferenceError, Replay, Replayed
from smarttac_can.vocabulary.signals import SHORT_DEADLINE_MS

_FRAMES: Final = 1000
"""How many are replayed between two looks at the clock."""
_SAID_S: Final = 1.0
_EARLY_S: Final = 1.0
_TOLD: Final = ("lockstep", "produce_sync", "plate_node", "deadline", "eds", "storage")
"""Parameters that say how the stimulator was started."""


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
@click.option("--produce-sync", is_flag=True, help="The stimulator was told to produce SYNC.")
@lockstep_option
@click.option(
    "--deadline",
    type=click.IntRange(min=1, max=1000),
    metavar="MS",
    help="Deadline of the loop in ms, where it was not that of the EDS; in lockstep and with"
    f" --realtime it is {SHORT_DEADLINE_MS}.",
)
@click.option("--eds", type=OLD_FILE, metavar="FILE", help="EDS of the stimulator, if another.")
@click.option(
    "--storage",
    type=OLD_FILE,
    metavar="FILE",
    help="What it had stored as it was switched on; the file stays as it is.",
)
@json_file_option
@force_option()
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
    """Have the controllers compute again what they sent, and name the first sample that differs.

    LOG is a candump, ASC, BLF, CSV or TRC of stimulator and plate node, such as smarttac record
    --raw makes; it has to begin before the stimulator is switched on or reset. What the stimulator
    heard is given to one from the same EDS, at the times of the log, and each frame that it sends
    is compared: drives, public TPDOs, emergencies, SDO answers. A difference ends with exit code 1.
    """
    if plate_node == node_id:
        raise click.UsageError(f"--plate-node {plate_node} is the --node-id of the stimulator")
    if lockstep and produce_sync:
        raise click.UsageError("in --lockstep the bench produces SYNC: leave out --produce-sync")
    with plain_errors(), blaming(eds), ExitStack() as stack:
        results = opened_results(stack, json_file)
        if deadline is None and lockstep:
            deadline = SHORT_DEADLINE_MS
        memory = Memory()
        if storage is not None:
            memory.write(require_image(storage))

        def power_on() -> StimulatorNode:
            return StimulatorNode(
                load_device("stimulator.eds", eds, node_id),
                plate_node_id=plate_node,
                produce_sync=produce_sync,
                lockstep=lockstep,
                deadline_ms=deadline,
                storage=memory,
            )

        power_on()  # an EDS that does not suit is refused before the log is read
        found = _replay(log, Replay(power_on, node_id, lockstep=lockstep))
        report_results({"log": str(log), **_as_json(found)}, [_line(log, found)], results)
    if isinstance(found, DifferenceError):
        raise click.ClickException(one_line(f"{log}: {found}{_perhaps_told(found.so_far)}"))


def _perhaps_told(done: Replayed) -> str:
    """Name the options of which one may be missing, if a log differs from its beginning on."""
    given = click.get_current_context().get_parameter_source
    left = [f"--{o.replace('_', '-')}" for o in _TOLD if given(o) is ParameterSource.DEFAULT]
    if not left or done.ended_s - done.begun_s > _EARLY_S:
        return ""
    return (
        f"; so early, it may have been started with an option that is not given: {', '.join(left)}"
    )


def _replay(log: Path, run: Replay) -> Replayed | DifferenceError:
    """Replay all of a log, or up to the first difference."""
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
        raise click.ClickException(
            one_line(text if text.startswith(str(log)) else f"{log}: {text}")
        ) from error


def _showing(frames: Iterable[tuple[int, Frame]]) -> Iterator[tuple[int, Frame]]:
    """Say on the terminal once a second how far the replay is."""
    said = monotonic()
    first: int | None = None
    for number, (time, frame) in enumerate(frames):
        first = time if first is None else first
        if number % _FRAMES == 0 and sys.stderr.isatty() and monotonic() > said + _SAID_S:
            said = monotonic()
            click.echo(f"\r{(time - first) * 1e-6:.0f} s, {number} frames", err=True, nl=False)
        yield time, frame


def _as_json(found: Replayed | DifferenceError) -> dict[str, Any]:
    if isinstance(found, DifferenceError):
        return {"same": False, **found.so_far._asdict(), "difference": found.difference.as_json()}
    return {"same": True, **found._asdict(), "difference": None}


def _line(log: Path, found: Replayed | DifferenceError) -> str:
    done = found.so_far if isinstance(found, DifferenceError) else found
    other = done.compared - done.drives
    return (
        f"{log}: {done.frames} frames up to {done.ended_s:.3f} s, from the boot-up at "
        f"{done.begun_s:.3f} s on; {done.drives} drives and {other} other frames of the node "
        "recomputed and the same"
    )

"""The command ``jitter``, which measures the timing of the loop on this machine and bus."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import click

from smarttac_can import build
from smarttac_can.assurance.timing.loop_run import LoopRun, measure_loop
from smarttac_can.assurance.timing.loop_timing import CURVES, DEADLINE_RULE, SHORTEST_MS, LoopTiming
from smarttac_can.cli.shared import (
    NODE_ID,
    BusChoice,
    WholeRange,
    bus_options,
    json_options,
    need_matplotlib,
    reporting,
    result_folder,
    result_folder_path,
)
from smarttac_can.host.process_signals import stop_on_signals
from smarttac_can.vocabulary.states import State

PICTURE = "jitter.png"
_SECONDS_MAX = 86_400
_PROGRESS_S = 3.0


@click.command(
    epilog="\b\nExamples:\n"
    "  smarttac jitter --interface udp_multicast --channel 239.74.163.2\n"
    "  smarttac jitter --interface socketcan --channel can0 --plate-node 33 --realtime 50",
    help=f"""Measure how punctual the 1 kHz loop is on this machine and bus.

    The command starts a stimulator and a simulated plate, each in its own process, which regulate
    the friction of a finger. With --plate-node it uses a plate that is already on the bus, and
    keeps it at 0 V. The times of the frames are those of the kernel.

    The deadline that the machine can keep is {DEADLINE_RULE}. Ctrl-C ends the measurement early,
    and prints the result so far.
    """,
)
@bus_options
@click.option(
    "--plate-node", type=NODE_ID, help="Node-ID of a plate on the bus.  [default: simulate one]"
)
@click.option(
    "--realtime",
    type=WholeRange(1, 99),
    metavar="PRIORITY",
    help="Run the nodes with this SCHED_FIFO priority, 1..99.",
)
@click.option(
    "--seconds",
    type=WholeRange(1, _SECONDS_MAX),
    default=10,
    show_default=True,
    help="Length of the measurement in s.",
)
@json_options()
@click.option(
    "--output",
    type=result_folder_path,
    help=f"Folder for a histogram, {PICTURE}.",
)
def jitter(
    bus: BusChoice,
    plate_node: int | None,
    realtime: int | None,
    seconds: int,
    json_file: Path | None,
    output: Path | None,
) -> None:
    """Measure how punctual the 1 kHz loop is on this machine and bus."""
    with reporting(json_file) as write_results, ExitStack() as stack:
        folder = None
        if output is not None:
            need_matplotlib()
            folder = stack.enter_context(result_folder(output, ()))
        stop = stack.enter_context(stop_on_signals())
        run = measure_loop(
            bus.options,
            plate_node=plate_node,
            realtime=realtime,
            seconds=seconds,
            stop=stop,
            progress=_progress(seconds),
        )
        for line in run.refused:
            click.echo(line, err=True)
        if not run.timing.ran:
            raise click.ClickException(f"the loop never ran: no drive came on {bus.where}")
        figures = run.timing.as_json()
        state = None if run.state is None else run.state.name.lower()
        ending = {"state": state, "message": run.message, "refused": run.refused, "build": build()}
        write_results(figures | ending, _table(figures, run, plate_node))
        if folder is not None:
            _draw(run.timing, folder / PICTURE)
    if plate_node is None and not run.ran:
        raise click.ClickException(f"the loop never ran: {run.message}")


def _draw(timing: LoopTiming, file: Path) -> None:
    from smarttac_can.assurance.timing.loop_timing import histogram  # noqa: PLC0415
    from smarttac_can.bench.drawing import save  # noqa: PLC0415 - matplotlib is an extra

    save(histogram(timing), file)


def _progress(seconds: int) -> Callable[[float, LoopTiming], None]:
    """Return a function that prints the progress every few seconds, on a terminal only."""
    shown_at = 0.0

    def show(elapsed: float, timing: LoopTiming) -> None:
        nonlocal shown_at
        if elapsed - shown_at < _PROGRESS_S or not sys.stderr.isatty():
            return
        shown_at = elapsed
        click.echo(
            f"{elapsed:.0f} s of {seconds} s: {timing.ticks} ticks, {timing.missed} missed, "
            f"at most {timing.gap_s * 1e3:.1f} ms between two drives",
            err=True,
        )

    return show


def _table(figures: dict[str, Any], run: LoopRun, plate_node: int | None) -> Iterator[str]:
    yield f"{'us':<40}{'median':>10}{'99 %':>10}{'99.9 %':>10}{'max':>10}"
    for key, name in CURVES.items():
        row = figures[key]
        yield f"{name:<40}" + "".join(
            f"{row[column]:>10}" for column in ("p50_us", "p99_us", "p999_us", "max_us")
        )
    yield f"{figures['missed']} of {figures['ticks']} ticks missed their SYNC or their drive"
    if figures["lost"]:
        yield f"{figures['lost']} more were not received by this command, and do not count"
    yield f"at most {figures['gap_max_us'] / 1e3:.2f} ms between two drives"
    yield from _promise(figures)
    yield _end(run, plate_node)
    yield f"what runs in a cycle: {'compiled modules' if build() == 'compiled' else 'the sources'}"


def _promise(figures: dict[str, Any]) -> Iterator[str]:
    stage = figures["stage"]
    if stage is None:
        yield f"this machine can promise no deadline: it is {DEADLINE_RULE}"
        return
    yield f"deadline that this machine can promise: {figures['deadline_ms']} ms"
    yield (
        f"a stage frozen at {stage['voltage_v']:g} V until then: "
        f"{100 * stage['reached_share']:.1f} % of {stage['final_um']:g} um, "
        f"below 5 % after {stage['below_5_percent_ms']:.1f} ms"
    )
    if figures["deadline_ms"] > SHORTEST_MS:
        yield (
            f"its dose: {stage['dose_ratio']:.1f} times that of {SHORTEST_MS} ms, "
            f"{stage['dose_ratio_from_rest']:.1f} times if the plate was at rest"
        )


def _end(run: LoopRun, plate_node: int | None) -> str:
    if plate_node is not None:
        return f"the plate {plate_node} was there already and stayed at 0 V"
    if not run.ran:
        return "the loop was timed at 0 V"
    if run.state is State.RUNNING:
        return "the loop was RUNNING to the end"
    return f"the loop left RUNNING: {run.message}"

"""The command ``hostile``: a third node that attacks a driven pair."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

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
from smarttac_can.trials.hostile import Hostile, HostileReport


@click.command(epilog="Example: smarttac hostile --actions 100000 --seed 7 --json hostile.json")
@click.option("--actions", type=click.IntRange(min=1), required=True, help="Frames that are sent.")
@seed_option("Seed of all that happens.")
@json_file_option
@force_option()
def hostile(actions: int, seed: int, json_file: Path | None) -> None:
    """Let a third node send anything to a driven pair, and check every cycle.

    SDO requests, PDOs, SYNC, EMCY, heartbeats, NMT and garbage come at random, while a master arms
    again and resets faults. The same seed and number give the same run.
    """
    with plain_errors(), ExitStack() as stack:
        results = opened_results(stack, json_file)
        with progress_bar("attacking") as progress:
            report = Hostile(actions, seed, progress).run()
        report_results(report.as_json(), [_summary(report)], results)
    if not report.passed:
        raise click.ClickException(f"{report.violated} violations")


def _summary(report: HostileReport) -> str:
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

"""The command ``campaign``: the laws on thousands of random fingers."""

from __future__ import annotations

import os
from contextlib import ExitStack
from pathlib import Path

import click
from click.core import ParameterSource

from smarttac_can.campaign.cluster import ClusterError
from smarttac_can.campaign.folder import FILES, PICTURE, write_folder
from smarttac_can.campaign.record import Record, RecordError
from smarttac_can.campaign.runner import run_campaign
from smarttac_can.campaign.summary import lines, summary
from smarttac_can.cli.options import NEW_FILE, law_option, seed_option
from smarttac_can.cli.plain_errors import need_matplotlib, plain_errors
from smarttac_can.cli.reproduction import dead_time_option
from smarttac_can.cli.result_file import (
    force_option,
    json_file_option,
    opened_results,
    report_results,
    result_folder,
    result_folder_path,
)
from smarttac_can.host.terminal import progress_bar
from smarttac_can.population.cases import CASES
from smarttac_can.population.compiled import can_compile
from smarttac_can.population.trial import Campaign
from smarttac_can.vocabulary.modes import Law, VibrationLaw

_FINGERS_MAX = 1_000_000


@click.command(
    epilog="\b\nExamples:\n  smarttac campaign --fingers 1000 --dead-time auto --json -\n"
    "  smarttac campaign --fingers 1000 --law predictive --vibration-law predictive --seed 2\n"
    "  smarttac campaign --fingers 10000 --case lifting --resume lifting.rows --output lifting"
)
@click.option(
    "--fingers", type=click.IntRange(1, _FINGERS_MAX), required=True, help="How many fingers."
)
@seed_option("Seed of the fingers, their motion and the noise.")
@law_option("--law", Law, "Friction law.")
@law_option("--vibration-law", VibrationLaw, "How amplitude and resonance are regulated.")
@dead_time_option
@click.option(
    "--case",
    type=click.Choice(list(CASES)),
    default="nominal",
    show_default=True,
    help="What differs from what the laws were tuned for.",
)
@click.option(
    "--workers",
    type=click.IntRange(min=1),
    help="Threads that share the work.  [default: one for each processor]",
)
@click.option(
    "--dask",
    "cluster",
    metavar="ADDRESS",
    help="Scheduler of a Dask cluster that does the work, such as tcp://10.0.0.1:8786.",
)
@click.option(
    "--resume",
    type=NEW_FILE,
    help="File that keeps the fingers that were run, and from which an interrupted run goes on.",
)
@json_file_option
@click.option(
    "--output",
    type=result_folder_path,
    help="Folder for results, a table of all fingers, and a picture.",
)
@force_option()
@click.pass_context
def campaign(
    context: click.Context,
    *,
    fingers: int,
    seed: int,
    law: Law,
    vibration_law: VibrationLaw,
    dead_time: float,
    case: str,
    workers: int | None,
    cluster: str | None,
    resume: Path | None,
    json_file: Path | None,
    output: Path | None,
) -> None:
    """Regulate the friction of many random fingers, and show how it went for all of them.

    Each finger is a function of the seed and its number, so the results are the same to the bit
    whoever shares the work. True figures come first; those that begin with measured_ are what the
    gauges show.
    """
    if (
        cluster is not None
        and context.get_parameter_source("workers") is ParameterSource.COMMANDLINE
    ):
        raise click.UsageError("--workers has no meaning with --dask: the cluster has its own")
    chosen = Campaign(
        seed=seed,
        law=law,
        vibration_law=vibration_law,
        dead_time=dead_time * 1e-6,
        case=case,
    )
    if output is not None:
        need_matplotlib()
    if not can_compile():
        click.echo(
            "numba is not installed, or this is a build by mypyc: it takes some 30 times as long, "
            "and more workers do not help: pip install 'smarttac-can[campaign]'",
            err=True,
        )
    with plain_errors(ClusterError, RecordError), ExitStack() as stack:
        results_file = opened_results(stack, json_file)
        folder = None if output is None else stack.enter_context(result_folder(output, FILES))
        record = None if resume is None else stack.enter_context(Record(resume, chosen))
        result = run_campaign(
            chosen,
            fingers,
            workers=workers or os.cpu_count() or 1,
            cluster=cluster,
            record=record,
            progress=stack.enter_context(progress_bar("campaign")),
        )
        if result.compiled is None:
            click.echo(
                f"some of the fingers in {resume} were run without numba, others with it: "
                "their last digits may differ from those of one run",
                err=True,
            )
        results = summary(chosen, result)
        if folder is not None:
            write_folder(folder, results, result.rows)
        report_results(results, lines(results), results_file)
    if output is not None:
        click.echo(f"picture: {output / PICTURE}", err=json_file == Path("-"))

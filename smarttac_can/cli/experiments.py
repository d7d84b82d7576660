"""Commands of simulated experiments: ``demo``, ``reproduce``, ``report`` and ``campaign``."""

from __future__ import annotations

import json
import os
from contextlib import ExitStack
from datetime import datetime
from pathlib import Path
from typing import Any, get_args

import click
from click.core import ParameterSource

from smarttac_can.bench.simulation import LinkName
from smarttac_can.bench.traces import Trace, read_csv
from smarttac_can.cli.shared import (
    NEW_FILE,
    WholeRange,
    force_option,
    json_options,
    law_option,
    naming,
    need_matplotlib,
    one_line,
    plain_errors,
    refuse_own_files,
    reporting,
    result_folder,
    result_folder_path,
    result_path,
    seed_option,
    warn_without_numba,
)
from smarttac_can.host.files import read_bounded
from smarttac_can.host.terminal import progress_bar
from smarttac_can.science.population.fingers import CASES, PLATES
from smarttac_can.science.population.trial import Campaign
from smarttac_can.studies.campaign.runner import (
    ClusterError,
    Record,
    RecordError,
    run_campaign,
)
from smarttac_can.studies.campaign.summary import FILES as CAMPAIGN_FILES
from smarttac_can.studies.campaign.summary import PICTURE, as_json, lines, summary, write_folder
from smarttac_can.studies.paper.experiments import (
    LOAD_MAX,
    LOAD_MIN,
    Conditions,
    SubjectSet,
    loop_dead_time,
)
from smarttac_can.studies.paper.report import (
    FILES,
    INDEX,
    dead_time_table,
    table_text,
    vibration_table,
    write_report,
)
from smarttac_can.studies.paper.reproduce import (
    FIGURES,
    RESULTS,
    TRACES,
)
from smarttac_can.studies.paper.reproduce import reproduce as run_reproduction
from smarttac_can.vocabulary.states import Law, VibrationLaw

_DEAD_TIME_MAX_US = 999.0
BIT_RATE = 1_000_000
"""Bit rate in bit/s that ``--dead-time auto`` assumes."""
_RESULTS_MAX_BYTES = 4 << 20
"""Largest size of results.json; that of all experiments has 20 KB."""
_VIBRATION = frozenset({"fig5", "fig6"})


def _dead_time(_ctx: click.Context, _param: click.Parameter, value: str) -> float:
    """Return ``auto``, or a number of us, as a time in us."""
    if value == "auto":
        return loop_dead_time(BIT_RATE)
    try:
        dead_time = float(value)
    except ValueError:
        raise click.BadParameter(f"{value!r} is neither 'auto' nor a number of us") from None
    if not 0.0 <= dead_time <= _DEAD_TIME_MAX_US:
        raise click.BadParameter(f"{value} us is outside 0..999")
    return dead_time


def _load(_ctx: click.Context, _param: click.Parameter, load: float) -> float:
    if load != 0.0 and not LOAD_MIN <= load <= LOAD_MAX:
        raise click.BadParameter(f"{load:g} N is neither 0 nor in {LOAD_MIN:g}..{LOAD_MAX:g}")
    return load


_noise_seed_option = seed_option("Seed of sensor noise and of the fingers' force and speed.")
dead_time_option = click.option(
    "--dead-time",
    callback=_dead_time,
    metavar="US|auto",
    default="0",
    show_default=True,
    help="Time in us from the start of a cycle until the drive of this cycle acts, 0 to 999;"
    f" auto: computed from the lengths of the CAN frames at {BIT_RATE // 1000} kbit/s.",
)
output_option = click.option(
    "--output",
    type=result_folder_path,
    help="Folder for traces, results and, over the bus, the candump log.",
)


@click.command(epilog="Example: smarttac demo")
@_noise_seed_option
@output_option
@force_option()
def demo(seed: int, output: Path | None) -> None:
    """Run all experiments over a virtual CAN bus and show them beside the paper.

    Bench, stimulator node and plate node communicate by CANopen. You need no CAN bus, no hardware
    and no privileges. The figures are written to a new folder, with an index.html.
    """
    with plain_errors():
        need_matplotlib()
        made = output or Path(f"smarttac-demo-{datetime.now():%Y%m%d-%H%M%S}")
        conditions = Conditions(seed=seed)
        with result_folder(made, FILES) as folder:
            with progress_bar("running") as progress:
                traces, results = run_reproduction(
                    frozenset(FIGURES), conditions, link="bus", folder=folder, progress=progress
                )
            late = Conditions(seed=seed, dead_time=loop_dead_time(BIT_RATE))
            with progress_bar("running with dead time") as progress:
                _, delayed = run_reproduction(_VIBRATION, late, progress=progress)
            click.echo(table_text(results))
            click.echo(
                "The same with the time that the loop's frames take at worst on a real bus:\n"
            )
            click.echo(dead_time_table(results, delayed))
            with progress_bar("drawing") as progress:
                write_report(folder, traces, results, progress)
    click.echo(f"pictures: {made / INDEX}")


@click.command(
    epilog="\b\nExamples:\n  smarttac reproduce table1 --seed 7\n"
    "  smarttac reproduce all --link bus --output run --json run.json"
)
@click.argument("what", nargs=-1, type=click.Choice([*FIGURES, "all"]))
@click.option(
    "--link",
    type=click.Choice(get_args(LinkName)),
    default="local",
    show_default=True,
    help="Use CANopen nodes on a virtual bus, or function calls; the numbers are the same.",
)
@law_option(
    "--law",
    Law,
    "Law that sets the amplitude to regulate the COF; the paper does not have predictive.",
)
@law_option(
    "--vibration-law",
    VibrationLaw,
    "How amplitude and resonance are controlled; pi is the paper's.",
)
@click.option(
    "--load",
    type=float,
    callback=_load,
    metavar="N",
    default=0.0,
    show_default=True,
    help=f"Force of a finger on the plate in fig5 and fig6, {LOAD_MIN:g}..{LOAD_MAX:g} N; with a"
    " finger the amplitude makes a second step, from 1 to 1.5 um.",
)
@dead_time_option
@click.option(
    "--subjects",
    type=click.Choice(get_args(SubjectSet)),
    default="presets",
    show_default=True,
    help="Fingers of Fig. 7 and Table I: all with the same force and speed, or each with its own.",
)
@_noise_seed_option
@json_options()
@output_option
@click.option(
    "--animate",
    type=result_path,
    help="GIF of a finger that crosses the boundary, and of the COF that follows; runs table1.",
)
def reproduce(
    *,
    what: tuple[str, ...],
    link: LinkName,
    law: Law,
    vibration_law: VibrationLaw,
    load: float,
    dead_time: float,
    subjects: SubjectSet,
    seed: int,
    json_file: Path | None,
    output: Path | None,
    animate: Path | None,
) -> None:
    """Run the experiments of some figures, or all, and show the results beside the paper's."""
    wanted = frozenset(FIGURES if not what or "all" in what else what)
    if animate is not None:
        wanted |= {"table1"}
        if animate.suffix.lower() != ".gif":
            raise click.UsageError(f"--animate {animate}: its name has to end in .gif")
    if load and not wanted & _VIBRATION:
        raise click.UsageError("--load is for fig5 and fig6: the others bring their own finger")
    conditions = Conditions(
        seed=seed,
        law=law,
        dead_time=dead_time,
        vibration_law=vibration_law,
        load=load,
        subjects=subjects,
    )
    with reporting(json_file) as write_results, ExitStack() as stack:
        if animate is not None:
            need_matplotlib()
            moving = stack.enter_context(result_folder(animate.parent, {animate.name}))
        folder = None if output is None else stack.enter_context(result_folder(output, FILES))
        with progress_bar("running") as progress:
            traces, results = run_reproduction(
                wanted, conditions, link=link, folder=folder, progress=progress
            )
        tables = [table_text(results)]
        if wanted & _VIBRATION:
            tables.append(vibration_table(results))
        if animate is not None:
            from smarttac_can.studies.paper.figures import save_crossing  # noqa: PLC0415 - an extra

            with progress_bar("drawing") as progress:
                save_crossing(traces, moving / animate.name, progress)
        write_results(results, tables)


@click.command(epilog="Example: smarttac reproduce all --output run && smarttac report run")
@click.argument("folder", type=click.Path(exists=True, file_okay=False, path_type=Path))
def report(folder: Path) -> None:
    """Draw the figures and index.html of a folder that reproduce --output wrote."""
    with plain_errors():
        need_matplotlib()
        traces, results = _read_run(folder)
        with progress_bar("drawing") as progress:
            page = write_report(folder, traces, results, progress)
    click.echo(f"pictures: {page}")


def _read_run(folder: Path) -> tuple[list[Trace], dict[str, Any]]:
    with naming(file := _made(folder, RESULTS), ValueError, RecursionError):
        results = json.loads(read_bounded(file, _RESULTS_MAX_BYTES))
        if not isinstance(results, dict) or "trace_sha256" not in results:
            raise ValueError("it holds no results of reproduce")
    with plain_errors(ValueError):
        return read_csv(_made(folder, TRACES)), results


def _made(folder: Path, name: str) -> Path:
    """Return the path of a file from ``reproduce --output``; refuse if it is missing."""
    file = folder / name
    if not file.exists():
        cure = f"smarttac reproduce --output {folder} makes it"
        raise click.ClickException(one_line(f"there is no {file}: {cure}"))
    return file


_FINGERS_MAX = 1_000_000


@click.command(
    epilog="\b\nExamples:\n  smarttac campaign --fingers 1000 --dead-time auto --json -\n"
    "  smarttac campaign --fingers 1000 --law measured --vibration-law pi --law predictive "
    "--vibration-law predictive --output laws\n"
    "  smarttac campaign --fingers 10000 --case lifting --resume lifting.rows --output lifting"
)
@click.option(
    "--fingers", type=WholeRange(1, _FINGERS_MAX), required=True, help="How many fingers."
)
@seed_option("Seed of the fingers, their motion and the noise.")
@law_option(
    "--law",
    Law,
    "Law that sets the amplitude to regulate the COF; repeat it to run the same fingers with other "
    "laws.",
    multiple=True,
)
@law_option(
    "--vibration-law",
    VibrationLaw,
    "How amplitude and resonance are controlled; give it once for all --law, or once for each.",
    multiple=True,
)
@dead_time_option
@click.option(
    "--plates",
    type=click.Choice(PLATES),
    default=PLATES[0],
    show_default=True,
    help="model: the default plate; varied: random plates; identified: the same random plates, "
    "with gain, Q, softening and delay known to the laws.",
)
@click.option(
    "--case",
    type=click.Choice(list(CASES)),
    default="nominal",
    show_default=True,
    help="Difference between the simulated fingers or plates and those for which the laws were "
    "tuned.",
)
@click.option(
    "--workers",
    type=WholeRange(min=1),
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
@json_options()
@click.option(
    "--output",
    type=result_folder_path,
    help="Folder for results, a table of all fingers, and a picture.",
)
@click.pass_context
def campaign(
    context: click.Context,
    *,
    fingers: int,
    seed: int,
    law: list[Law],
    vibration_law: list[VibrationLaw],
    dead_time: float,
    plates: str,
    case: str,
    workers: int | None,
    cluster: str | None,
    resume: Path | None,
    json_file: Path | None,
    output: Path | None,
) -> None:
    """Regulate the friction of many random fingers, and show how it went for all of them.

    Each finger is computed from the seed and the number of the finger, so the results are the same
    to the bit on any number of processes. The numbers of the true COF come first; those that begin
    with measured_ are of the COF that the gauges measure.
    """
    if (
        cluster is not None
        and context.get_parameter_source("workers") is ParameterSource.COMMANDLINE
    ):
        raise click.UsageError("--workers has no meaning with --dask: the cluster has its own")
    campaigns = [
        Campaign(seed, *laws, dead_time=dead_time * 1e-6, case=case, plates=plates)
        for laws in _pairs(law, vibration_law)
    ]
    if output is not None:
        need_matplotlib()
    kept = _kept_in(resume, campaigns)
    made = [] if output is None else [output / name for name in CAMPAIGN_FILES]
    refuse_own_files(kept, [json_file, *made], "--resume")
    warn_without_numba(", and more workers do not help")
    with reporting(json_file, ClusterError, RecordError) as write_results, ExitStack() as stack:
        folder = (
            None if output is None else stack.enter_context(result_folder(output, CAMPAIGN_FILES))
        )
        records = _records(stack, kept, campaigns)
        results = []
        for number, (chosen, record) in enumerate(zip(campaigns, records, strict=True), 1):
            label = f"campaign {number} of {len(campaigns)}" if len(campaigns) > 1 else "campaign"
            with progress_bar(label) as progress:
                results.append(
                    run_campaign(
                        chosen,
                        fingers,
                        workers=workers or os.cpu_count() or 1,
                        cluster=cluster,
                        record=record,
                        progress=progress,
                    )
                )
            if results[-1].not_kept:
                click.echo(one_line(results[-1].not_kept), err=True)
        if any(result.compiled is None for result in results):
            click.echo(
                f"some of the fingers in {resume} were run without numba, others with it: "
                "their last digits may differ from those of one run",
                err=True,
            )
        summaries = [summary(*one) for one in zip(campaigns, results, strict=True)]
        if folder is not None:
            write_folder(folder, summaries, [result.rows for result in results])
        write_results(as_json(summaries), lines(summaries))
    if output is not None:
        click.echo(f"picture: {output / PICTURE}", err=json_file == Path("-"))


def _pairs(laws: list[Law], vibration_laws: list[VibrationLaw]) -> list[tuple[Law, VibrationLaw]]:
    """Return each friction law with its vibration law; refused if it is not clear which is."""
    if len(vibration_laws) == 1:
        vibration_laws = vibration_laws * len(laws)
    if len(laws) == 1:
        laws = laws * len(vibration_laws)
    if len(laws) != len(vibration_laws):
        raise click.UsageError(
            f"--vibration-law is given {len(vibration_laws)} times, --law {len(laws)} times: "
            "give one of them once, or both as often"
        )
    pairs = list(zip(laws, vibration_laws, strict=True))
    if twice := {pair for pair in pairs if pairs.count(pair) > 1}:
        law, vibration_law = (one.name.lower() for one in twice.pop())
        raise click.UsageError(f"law {law} with vibration law {vibration_law} is given twice")
    return pairs


def _kept_in(resume: Path | None, campaigns: list[Campaign]) -> list[Path]:
    """Return the file that keeps each campaign: with its laws in the name if there are several."""
    if resume is None:
        return []
    if len(campaigns) == 1:
        return [resume]
    laws = (f"{one.law.name}-{one.vibration_law.name}".lower() for one in campaigns)
    return [resume.with_name(f"{resume.name}.{name}") for name in laws]


def _records(stack: ExitStack, kept: list[Path], campaigns: list[Campaign]) -> list[Record | None]:
    """Open the files; None for each campaign if there are none."""
    if not kept:
        return [None] * len(campaigns)
    return [stack.enter_context(Record(*pair)) for pair in zip(kept, campaigns, strict=True)]

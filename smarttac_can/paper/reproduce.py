"""Run the paper's experiments and keep what they gave in a folder."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

from smarttac_can.bench.open_link import LinkName
from smarttac_can.bench.stimulator import Stimulator
from smarttac_can.bench.traces import Trace, sha256, write_csv
from smarttac_can.control.friction import limited_step
from smarttac_can.control.parameters import CascadeParameters
from smarttac_can.host.log_file import CandumpWriter
from smarttac_can.paper.experiments import Conditions, experiments
from smarttac_can.paper.summary import summary

FIGURES: Final = ("fig2", "fig3", "fig5", "fig6", "fig7", "table1")
TRACES: Final = "traces.csv"
RESULTS: Final = "results.json"
CANDUMP: Final = "candump.log"

Progress = Callable[[float], None]
"""Called after every run with the share that is done, 0..1."""


def friction_step(E: float) -> float:
    """Step of the amplitude in m for a friction error in %: eq. (9) with the paper's numbers."""
    p = CascadeParameters()
    return limited_step(p.slope, p.step_max, E)


def reproduce(
    wanted: frozenset[str],
    conditions: Conditions,
    *,
    link: LinkName = "local",
    folder: Path | None = None,
    progress: Progress = lambda _: None,
) -> tuple[list[Trace], dict[str, Any]]:
    """Run experiments on a simulated stimulator and compute their results.

    Parameters
    ----------
    wanted
        Some of `FIGURES`.
    conditions
        Seed, law, dead time and fingers.
    link
        ``local`` without a bus, ``bus`` over two CANopen nodes on a virtual CAN bus: the same
        numbers.
    folder
        Where `TRACES`, `RESULTS` and, over the bus, `CANDUMP` are written; made if it does not
        exist. None keeps nothing.
    progress
        Told of every run.

    Returns
    -------
    traces : list of Trace
        Every run.
    results : dict
        As from `smarttac_can.paper.summary.summary`.
    """
    with ExitStack() as stack:
        if folder is None:
            folder = Path(stack.enter_context(TemporaryDirectory()))
        folder.mkdir(parents=True, exist_ok=True)
        traces = _run(wanted, conditions, link, folder, progress)
        write_csv(folder / TRACES, traces)
        digest = sha256(folder / TRACES)
        results = summary(traces, conditions, link=link, trace_sha256=digest)
        if "fig3" in wanted:
            errors = list(range(-50, 51, 5))
            results["fig3"] = {
                "error_percent": errors,
                "step_um": [friction_step(E) * 1e6 for E in errors],
            }
        (folder / RESULTS).write_text(json.dumps(results, indent=2) + "\n", encoding="utf-8")
    return traces, results


def _run(
    wanted: frozenset[str], conditions: Conditions, link: LinkName, folder: Path, progress: Progress
) -> list[Trace]:
    runs = experiments(wanted, conditions)
    total = sum(run.seconds for run in runs)
    traces: list[Trace] = []
    done = 0.0
    with _log(folder, link) as log, Stimulator.simulate(link, log=log) as bench:
        for run in runs:
            traces += run.run(bench)
            done += run.seconds
            progress(done / total)
    return traces


@contextmanager
def _log(folder: Path, link: LinkName) -> Iterator[Callable[..., None] | None]:
    if link == "local":
        yield None
        return
    with (folder / CANDUMP).open("w", encoding="ascii") as file:
        yield CandumpWriter(file).write

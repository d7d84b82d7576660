"""Run the paper's experiments, and make tables and figures of docs/explanation/results.md; minutes.

Example: tools/pages/make results
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, Final, NamedTuple

import numpy as np
from pages import EXPLANATION, Pages, columns, made, renewed

from smarttac_can.bench.drawing import GREEN, RED, canvas, save
from smarttac_can.bench.simulation import LocalLink, plate_od, stimulator_od
from smarttac_can.bench.stimulator import Stimulator
from smarttac_can.bench.traces import Trace
from smarttac_can.instrument.nodes.plate_block import PlateBlock, SimulatedPlate
from smarttac_can.instrument.nodes.stimulator_block import StimulatorBlock
from smarttac_can.science.plant.parameters import (
    ContactParameters,
    PlateParameters,
    SensorParameters,
)
from smarttac_can.science.plant.plate import Plate
from smarttac_can.science.plant.subjects import SUBJECTS
from smarttac_can.science.population.steps import STEP_METRICS, Step
from smarttac_can.studies.paper.experiments import (
    Conditions,
    SubjectSet,
    experiments,
    loop_dead_time,
)
from smarttac_can.studies.paper.figures import BAND, CURVES
from smarttac_can.studies.paper.metrics import align_at_switch, find, from_switch_on
from smarttac_can.studies.paper.references import PUBLISHED
from smarttac_can.studies.paper.report import INSIDE, compare
from smarttac_can.studies.paper.reproduce import reproduce, summary
from smarttac_can.vocabulary.states import Law

SEEDS: Final = range(1, 12)
BAND_SEEDS: Final = range(1, 6)
"""Seeds of which all figures with a band are judged."""
FITTED_SEEDS: Final = range(1, 11)
"""Seeds that the fingers were not fitted with."""
FEW_SEEDS: Final = range(1, 3)
"""Seeds of the variations."""
NEAR: Final = {"rise_time_ms": 0.5, "overshoot_percent": 5.0}
"""Distance from a figure of the paper beyond which a seed is off."""
TABLE = frozenset({"table1"})
VIBRATION = frozenset({"fig5", "fig6"})
Results = Mapping[str, Any]


class Variation(NamedTuple):
    """Differences from the plate and the fingers of Table I."""

    plate: PlateParameters = PlateParameters()
    W0: float = 1.0
    """Factor of the characteristic amplitude of the finger."""
    force: float = 0.5
    """In N."""
    speed: float = 60.0
    """In mm/s."""
    dead_time: float = 0.0
    """In us, known to the controllers."""


def with_path(frequency: float = 100.0, damping: float = 0.7, **contact: float) -> PlateParameters:
    """Return the plate with another force path in Hz, and another contact."""
    sensors = SensorParameters(path_frequency=frequency, path_damping=damping)
    return PlateParameters(sensors=sensors, contact=ContactParameters(**contact))


AS_IT_IS: Final = Variation()
MODE_SHAPE: Final = Variation(with_path(ripple=0.1))
VARIATIONS: Final[Mapping[str, tuple[Variation, ...]]] = {
    "as it is": (AS_IT_IS,),
    "force path 80 and 120 Hz": (Variation(with_path(80.0)), Variation(with_path(120.0))),
    "force path, damping 0.6 and 0.85": (
        Variation(with_path(damping=0.6)),
        Variation(with_path(damping=0.85)),
    ),
    "no lag: force path 1 kHz": (Variation(with_path(1000.0)),),
    "no lag, W0 halved": (Variation(with_path(1000.0), W0=0.5),),
    "force path 250 Hz": (Variation(with_path(250.0)),),
    "force path 250 Hz, film lag 2 ms": (Variation(with_path(250.0, film_lag=2e-3)),),
    "film lag 2 ms": (Variation(with_path(film_lag=2e-3)),),
    "mode shape of 0.1": (MODE_SHAPE,),
    "W0 x 0.5, 0.75 and 1.25": tuple(Variation(W0=factor) for factor in (0.5, 0.75, 1.25)),
    "0.4 and 0.7 N": (Variation(force=0.4), Variation(force=0.7)),
    "40 and 80 mm/s": (Variation(speed=40.0), Variation(speed=80.0)),
    "dead time 0.45 ms": (Variation(dead_time=450.0),),
    "gauges of serial 2 and 3": tuple(
        Variation(PlateParameters(sensors=SensorParameters(serial=serial))) for serial in (2, 3)
    ),
}
"""The variations of Table I, by their names in the page."""


class VariedPlate(PlateBlock):
    """The plate of a variation."""

    def __init__(self, variation: Variation) -> None:
        self._variation = variation
        super().__init__(plate_od())

    def start_run(self) -> None:
        """Begin anew with the varied plate."""
        od, varied = self.od, self._variation
        for name, value in (("Finger.Force", varied.force), ("Finger.Speed", 1e-3 * varied.speed)):
            od[name].value = round(value / od[name].si)
        super().start_run()
        subject = SUBJECTS[od["Simulation.Subject"].value - 1]
        assert isinstance(self.backend, SimulatedPlate)
        self.backend.plate = Plate(
            varied.plate,
            replace(subject, W0=varied.W0 * subject.W0),
            self.backend.finger(),
            seed=od["Simulation.Seed"].value,
            ambient=od["Simulation.Ambient temperature"].si_value,
            dead_time=od["Simulation.Drive instant"].si_value,
        )


def run_varied(
    variation: Variation = AS_IT_IS, law: Law = Law.MEASURED, seed: int = 1
) -> list[Trace]:
    """Run Table I with a variation, another law or another seed."""
    block = StimulatorBlock(stimulator_od(), VariedPlate(variation))
    conditions = Conditions(seed=seed, law=law, dead_time=variation.dead_time)
    traces: list[Trace] = []
    with Stimulator(LocalLink(block), block.od) as bench:
        for run in experiments(TABLE, conditions):
            traces += run.run(bench)
    return traces


def table1(traces: Iterable[Trace]) -> Results:
    """Return the results of Table I."""
    table: Results = summary(traces, Conditions(), link="local", trace_sha256="")["table1"]
    return table


def number(value: float | None, digits: int = 1) -> str:
    """Show a result; one that does not exist is a dash."""
    return "-" if value is None else f"{value:.{digits}f}"


def verdicts(results: Results) -> dict[str, str]:
    """Return the verdict on each result, by its key."""
    return {item.published.key: item.verdict for item in compare(results)}


def bands_table(runs: Sequence[Results]) -> Iterator[str]:
    """Least and most of each figure with a band over the runs, and how many runs are inside."""
    rows = []
    for beside in zip(*map(compare, runs), strict=True):
        one = beside[0].published
        if one.low is None or one.high is None:
            continue
        values = [item.value for item in beside if item.value is not None]
        digits = 0 if one.unit == "Hz" else 2
        inside = sum(item.verdict == INSIDE for item in beside)
        rows.append(
            [
                f"{one.name}, {one.unit}",
                f"{number(min(values), digits)} to {number(max(values), digits)}",
                f"{one.low:g} to {one.high:g}",
                f"{inside} of {len(runs)}",
            ]
        )
    return columns(" | over the seeds | band | inside", rows)


def vibration_table(runs: Sequence[Results]) -> Iterator[str]:
    """Fig. 5 and 6 at several dead times, beside the paper."""
    rows = [
        [beside[0].published.name, *(number(each.value, 2) for each in beside),
         f"{beside[0].published.value:g}"]
        for beside in zip(*map(compare, runs), strict=True)
    ]  # fmt: skip
    heads = " | ".join(f"dead time {run['dead_time_us']:.0f} us" for run in runs)
    return columns(f" | {heads} | paper", rows)


def seeds_table(runs: Sequence[Results]) -> Iterator[str]:
    """Means over the four subjects: mean over the seeds, and least and most of a seed."""
    up = [run["table1"] for run in runs]
    down = [table["down"] for table in up]
    kinds = {
        "up, mean curve": up,
        "up, single touches": [table["touches"] for table in up],
        "down, mean curve": down,
        "down, single touches": [table["touches"] for table in down],
    }
    rows = []
    for name, tables in kinds.items():
        cells = []
        for metric in STEP_METRICS:
            values = [table["mean"][metric] for table in tables]
            low, high = min(values), max(values)
            cells.append(f"{np.mean(values):.3g} ({low:.3g} to {high:.3g})")
        rows.append([name, *cells])
    return columns("|rise, ms|overshoot, %|static error, %", rows)


def paper_value(i: int, metric: str) -> float:
    """Return the paper's figure of subject i + 1."""
    key = f"table1.subjects[{i}].{metric}"
    return next(row.value for row in PUBLISHED if row.key == key and row.value is not None)


def off(runs: Sequence[Results], i: int, metric: str) -> int:
    """Count the seeds that are off the paper's figure of subject i + 1 by more than `NEAR`."""
    paper = paper_value(i, metric)
    values = [run["table1"]["subjects"][i][metric] for run in runs]
    return sum(abs(value - paper) > NEAR[metric] for value in values)


def off_in_all(runs: Sequence[Results]) -> str:
    """Return how many figures of a subject and a seed are off, of how many."""
    found = sum(off(runs, i, metric) for i in range(4) for metric in NEAR)
    return f"{found} of {4 * len(NEAR) * len(runs)}"


def subjects_table(runs: Sequence[Results]) -> Iterator[str]:
    """Table I by subject: mean and spread over the seeds, beside the paper."""
    rows = []
    for i in range(4):
        cells = []
        for metric in STEP_METRICS:
            values = [run["table1"]["subjects"][i][metric] for run in runs]
            cells.append(f"{np.mean(values):.2f} +-{np.std(values, ddof=1):.2f}")
            if metric in NEAR:
                cells += [f"{paper_value(i, metric):g}", str(off(runs, i, metric))]
        rows.append([str(i + 1), *cells])
    return columns("subject|rise, ms|paper|off|overshoot, %|paper|off|static error, %", rows)


def variations_table(runs: Mapping[str, Sequence[Sequence[Results]]]) -> Iterator[str]:
    """Means over subjects and seeds of each variation."""
    rows = []
    for name, variations in runs.items():
        cells = []
        for metric in STEP_METRICS:
            values = [[table["mean"][metric] for table in tables] for tables in variations]
            cells.append(" ".join(f"{np.mean(value):.2g}" for value in values))
        rows.append([name, *cells])
    return columns("|rise, ms|overshoot, %|static error, %", rows)


def chatter(traces: Iterable[Trace]) -> float:
    """Mean over the subjects of the standard deviation of mu in the 20 ms before an up-step."""
    deviations = []
    for trace in traces:
        steps = align_at_switch([trace], up=True).steps
        deviations.append(np.mean([np.std(step.mu[step.time_ms <= 0]) for step in steps]))
    return float(np.mean(deviations))


def lowest_amplitude(traces: Iterable[Trace]) -> float:
    """Smallest amplitude in um within 40 ms after an up-step of the reference."""
    lowest = []
    for trace in traces:
        # Without a reference it is NaN, which does not rise.
        for switch in np.flatnonzero(np.diff(trace.cof_reference) > 0).tolist():
            lowest.append(np.min(trace.amplitude_um[switch : switch + 40]))
    return float(np.min(lowest))


def laws_table(runs: Mapping[str, list[Trace]], shaped: Mapping[str, list[Trace]]) -> Iterator[str]:
    """Compare the laws, on a plate without and with a mode shape."""
    rows = []
    both = [
        (name, shape, plate[name])
        for name in runs
        for shape, plate in (("0", runs), ("0.1", shaped))
    ]
    for name, shape, traces in both:
        subjects = table1(traces)["subjects"]
        rows.append(
            [
                f"`{name}`",
                shape,
                *(
                    " ".join(number(row[metric]) for row in subjects)
                    for metric in ("rise_time_ms", "overshoot_percent", "static_error_percent")
                ),
                f"{chatter(traces):.3f}",
            ]
        )
    head = (
        "law | mode shape | rise, ms | overshoot, % | static error, % | chatter of single touches"
    )
    return columns(head, rows)


def plot_vibration(runs: list[list[Trace]], dead_times: list[float]) -> None:
    """Amplitude, voltage and frequency of Fig. 5 and 6, with and without dead time."""
    columns = (
        ("amplitude_um", "amplitude (µm)"),
        ("voltage_v", "voltage (V)"),
        ("frequency_hz", "frequency (Hz)"),
    )
    with canvas(7.2, 7.6) as figure:
        axes = figure.subplots(3, 1, sharex=True)
        for traces, dead_time, style in zip(runs, dead_times, ("-", "--"), strict=True):
            for loops, colour in (("amplitude_only", GREEN), ("amplitude_and_frequency", RED)):
                trace = find(traces, f"fig5.{loops}")
                for axis, (column, label) in zip(axes, columns, strict=True):
                    values = from_switch_on(trace, getattr(trace, column))[:31]
                    name = f"{loops.replace('_', ' ')}, dead time {dead_time:.0f} us"
                    axis.plot(values, style, color=colour, label=name)
                    axis.set_ylabel(label)
        axes[0].axhspan(0.95, 1.05, color=BAND, zorder=0)
        axes[0].legend(fontsize=8, loc="lower right")
        axes[0].set_title("Fig. 5 and 6 (simulated)")
        axes[-1].set_xlabel("time after switch-on (ms)")
        save(figure, EXPLANATION / "figures" / "vibration.svg")


def plot_touches(variants: Mapping[str, list[Trace]]) -> None:
    """Five up-steps and the mean curve of subject 2 for each variant."""
    with canvas(10, 6) as figure:
        axes = figure.subplots(2, 3, sharex=True, sharey=True)
        for axis, (name, traces) in zip(axes.flat, variants.items(), strict=True):
            touches = align_at_switch([find(traces, "table1", 2)], up=True)
            for step in touches.steps[:5]:
                axis.plot(step.time_ms, step.mu, **CURVES["touches"])
            mean: Step = touches.mean_curve()
            reference = [mean.before, mean.after, mean.after]
            axis.step([-20, 0, 80], reference, where="post", **CURVES["reference"])
            axis.plot(mean.time_ms, mean.mu, **CURVES["mean"])
            axis.set_title(name, fontsize=10.5, pad=6)
            axis.set_xlim(-20, 60)
        figure.supxlabel("time after the switch of the reference (ms)")
        figure.supylabel("coefficient of friction, subject 2")
        save(figure, EXPLANATION / "figures" / "friction.svg")


def runs_of(subjects: SubjectSet, seeds: range) -> list[Results]:
    """Return the results of Table I for each seed."""
    return [reproduce(TABLE, Conditions(seed=seed, subjects=subjects))[1] for seed in seeds]


def pages(draw: bool) -> Pages:
    """Run everything, fill the template, draw the figures."""
    dead_time = loop_dead_time(1_000_000)
    vibration = [reproduce(VIBRATION, Conditions(dead_time=us)) for us in (0.0, dead_time)]
    seeds, fitted = runs_of("presets", SEEDS), runs_of("fitted", FITTED_SEEDS)
    banded = [reproduce(VIBRATION | TABLE, Conditions(seed=seed))[1] for seed in BAND_SEEDS]
    papers = (Law.MEASURED, Law.ACCUMULATE, Law.NOMINAL)
    laws = {law.name.lower(): run_varied(law=law) for law in papers}
    shaped = {law.name.lower(): run_varied(MODE_SHAPE, law) for law in papers}
    halved = run_varied(Variation(W0=0.5))
    varied = {
        name: [[table1(run_varied(each, seed=seed)) for seed in FEW_SEEDS] for each in variations]
        for name, variations in VARIATIONS.items()
    }
    judged = ("table1.mean.rise_time_ms", "table1.mean.overshoot_percent")
    fields: dict[str, str | Iterator[str]] = {
        "vibration": vibration_table([results for _, results in vibration]),
        "bands": bands_table(banded),
        "subjects": subjects_table(seeds),
        "subjects_off": off_in_all(seeds),
        "seeds": seeds_table(seeds),
        "inside": str(sum(all(verdicts(run)[key] == INSIDE for key in judged) for run in seeds)),
        "total": str(len(SEEDS)),
        "fitted": subjects_table(fitted),
        "fitted_off": off_in_all(fitted),
        "variations": variations_table(varied),
        "laws": laws_table(laws, shaped),
        "lowest": f"{lowest_amplitude(laws['measured']):.2f}",
        "halved": " ".join(f"{chatter([trace]):.3f}" for trace in halved),
        "dead_time": f"{dead_time:.0f}",
    }
    if draw:
        plot_vibration([traces for traces, _ in vibration], [0.0, dead_time])
        plot_touches(
            {
                **{f"law {name}": traces for name, traces in laws.items()},
                "force path without lag (1 kHz)": run_varied(Variation(with_path(1000.0))),
                "W0 halved": halved,
                "W0 a quarter larger": run_varied(Variation(W0=1.25)),
            }
        )
    return renewed(EXPLANATION / "results.md", fields)


def main() -> int:
    """Write the page, or compare it."""
    return made(__doc__, pages)

"""Run the paper's experiments, and write docs/explanation/results.md with its figures.

Example: python tools/results.py
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from pages import EXPLANATION, Pages, columns, filled, made

from smarttac_can.bench.drawing import GREEN, RED, canvas, save
from smarttac_can.bench.simulation import LocalLink, plate_od, stimulator_od
from smarttac_can.bench.stimulator import Stimulator
from smarttac_can.bench.traces import Trace
from smarttac_can.nodes.plate_block import PlateBlock, SimulatedPlate
from smarttac_can.nodes.stimulator_block import StimulatorBlock
from smarttac_can.paper.experiments import Conditions, experiments, loop_dead_time
from smarttac_can.paper.figures import BAND, CURVES
from smarttac_can.paper.metrics import align_at_switch, find, from_switch_on
from smarttac_can.paper.references import PUBLISHED
from smarttac_can.paper.reproduce import reproduce, summary
from smarttac_can.plant.parameters import PlateParameters, SensorParameters
from smarttac_can.plant.plate import Plate
from smarttac_can.plant.subjects import SUBJECTS
from smarttac_can.population.steps import Step
from smarttac_can.vocabulary.states import Law

SEEDS = range(1, 12)
TABLE = frozenset({"table1"})
VIBRATION = frozenset({"fig5", "fig6"})
PUBLISHED_BY_KEY = {published.key: published for published in PUBLISHED}
Results = Mapping[str, Any]


class VariedPlate(PlateBlock):
    """The plate with another force path, or with fingers whose W0 is scaled."""

    def __init__(self, path_frequency: float = 100.0, W0_factor: float = 1.0) -> None:
        sensors = SensorParameters(path_frequency=path_frequency)
        self._parameters = PlateParameters(sensors=sensors)
        self._W0_factor = W0_factor
        super().__init__(plate_od())

    def start_run(self) -> None:
        """Begin anew with the varied plate."""
        super().start_run()
        od = self.od
        subject = SUBJECTS[od["Simulation.Subject"].value - 1]
        assert isinstance(self.backend, SimulatedPlate)
        self.backend.plate = Plate(
            self._parameters,
            replace(subject, W0=self._W0_factor * subject.W0),
            self.backend.finger(),
            seed=od["Simulation.Seed"].value,
            ambient=od["Simulation.Ambient temperature"].si_value,
            dead_time=od["Simulation.Drive instant"].si_value,
        )


def run_varied(plate: PlateBlock, law: Law = Law.MEASURED) -> list[Trace]:
    """Run Table I with a varied plate, or another law."""
    block = StimulatorBlock(stimulator_od(), plate)
    traces: list[Trace] = []
    with Stimulator(LocalLink(block), block.od) as bench:
        for run in experiments(TABLE, Conditions(law=law)):
            traces += run.run(bench)
    return traces


def number(value: float | None, digits: int = 1) -> str:
    """Show a result; one that does not exist is a dash."""
    return "-" if value is None else f"{value:.{digits}f}"


def get(results: Results, key: str) -> Any:
    """Look up a dotted key."""
    value: Any = results
    for part in key.split("."):
        value = value[part]
    return value


def inside(results: Results, key: str) -> bool:
    """Whether a result keeps to the band of the paper."""
    published, value = PUBLISHED_BY_KEY[key], get(results, key)
    assert published.low is not None and published.high is not None
    return value is not None and published.low <= value <= published.high


def vibration_table(runs: Sequence[Results]) -> Iterator[str]:
    """Fig. 5 and 6 at several dead times, beside the paper."""
    rows = [
        [published.name, *(number(get(run, key), 2) for run in runs), f"{published.value:g}"]
        for key, published in PUBLISHED_BY_KEY.items()
        if key.startswith(("fig5", "fig6"))
    ]
    heads = " | ".join(f"dead time {run['dead_time_us']:.0f} us" for run in runs)
    return columns(f" | {heads} | paper", rows)


def seeds_table(runs: Sequence[Results]) -> Iterator[str]:
    """Table I of every seed: mean over the four subjects, of mean curves and of single touches."""
    rows = []
    for run in runs:
        up, down = run["table1"], run["table1"]["down"]
        curves = [
            number(up["mean"]["rise_time_ms"], 2),
            number(up["mean"]["overshoot_percent"]),
            number(up["mean"]["static_error_percent"], 2),
        ]
        others = [
            number(part["mean"][metric], digits)
            for part in (up["touches"], down, down["touches"])
            for metric, digits in (("rise_time_ms", 2), ("overshoot_percent", 1))
        ]
        touches = min(row["whole"] for row in up["touches"]["subjects"])
        rows.append([str(run["seed"]), str(touches), *curves, *others])
    return columns(
        "seed | touches | rise, ms | overshoot, % | static, % | touches: rise | overshoot "
        "| down: rise | overshoot | down, touches: rise | overshoot",
        rows,
    )


def subjects_table(runs: Sequence[Results]) -> Iterator[str]:
    """Table I by subject: mean and spread over the seeds, beside the paper."""
    rows = []
    for i in range(4):
        cells = []
        for metric in ("rise_time_ms", "overshoot_percent", "static_error_percent"):
            values = [run["table1"]["subjects"][i][metric] for run in runs]
            cells.append(f"{np.mean(values):.2f} +- {np.std(values, ddof=1):.2f}")
            published = PUBLISHED_BY_KEY.get(f"table1.subjects[{i}].{metric}")
            if published:
                cells.append(f"{published.value:g}")
        rows.append([str(i + 1), *cells])
    return columns("subject | rise, ms | paper | overshoot, % | paper | static, %", rows)


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


def laws_table(runs: Mapping[str, list[Trace]]) -> Iterator[str]:
    """Compare the laws."""
    rows = []
    for name, traces in runs.items():
        result = summary(traces, Conditions(), link="local", trace_sha256="")["table1"]
        subjects = result["subjects"]
        rows.append(
            [
                f"`{name}`",
                *(
                    " ".join(number(row[metric]) for row in subjects)
                    for metric in ("rise_time_ms", "overshoot_percent", "static_error_percent")
                ),
                f"{chatter(traces):.3f}",
            ]
        )
    head = "law | rise, ms | overshoot, % | static error, % | chatter of single touches"
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


def pages(draw: bool) -> Pages:
    """Run everything, fill the template, draw the figures."""
    dead_time = loop_dead_time(1_000_000)
    vibration = [reproduce(VIBRATION, Conditions(dead_time=us)) for us in (0.0, dead_time)]
    seeds = [reproduce(TABLE, Conditions(seed=seed))[1] for seed in SEEDS]
    papers = (Law.MEASURED, Law.ACCUMULATE, Law.NOMINAL)
    laws = {law.name.lower(): run_varied(VariedPlate(), law) for law in papers}
    variants = {
        "law measured": laws["measured"],
        "law accumulate": laws["accumulate"],
        "law nominal": laws["nominal"],
        "force path without lag (1 kHz)": run_varied(VariedPlate(path_frequency=1000.0)),
        "W0 halved": run_varied(VariedPlate(W0_factor=0.5)),
        "W0 a quarter larger": run_varied(VariedPlate(W0_factor=1.25)),
    }
    judged = ("table1.mean.rise_time_ms", "table1.mean.overshoot_percent")
    fields: dict[str, str | Iterator[str]] = {
        "vibration": vibration_table([results for _, results in vibration]),
        "subjects": subjects_table(seeds),
        "seeds": seeds_table(seeds),
        "inside": str(sum(all(inside(run, key) for key in judged) for run in seeds)),
        "total": str(len(SEEDS)),
        "laws": laws_table(laws),
        "lowest": f"{lowest_amplitude(laws['measured']):.2f}",
        "halved": " ".join(f"{chatter([trace]):.3f}" for trace in variants["W0 halved"]),
        "dead_time": f"{dead_time:.0f}",
    }
    if draw:
        plot_vibration([traces for traces, _ in vibration], [0.0, dead_time])
        plot_touches(variants)
    return {EXPLANATION / "results.md": filled(__file__, fields)}


if __name__ == "__main__":
    sys.exit(made(__doc__, pages))

"""Compare the laws of the vibration: tables of docs/explanation/vibration.md and docs/dev.

The cost of an update is that on this machine, so --check finds another one.

Example: tools/pages/make vibration
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from itertools import product
from time import perf_counter
from typing import Any

import numpy as np
from pages import DOCS, EXPLANATION, Pages, columns, made, renewed

from smarttac_can.bench.drawing import GREEN, INK, RED, canvas, save
from smarttac_can.science.control.cascade import Cascade
from smarttac_can.science.control.identification import Identification
from smarttac_can.science.control.parameters import CascadeParameters
from smarttac_can.science.plant import motion
from smarttac_can.science.plant.finger import FingerState
from smarttac_can.science.plant.parameters import (
    PlateParameters,
    ResonatorParameters,
    SensorParameters,
)
from smarttac_can.science.plant.plate import Plate
from smarttac_can.science.plant.resonator import Response, vibrate
from smarttac_can.science.plant.subjects import SUBJECTS
from smarttac_can.studies.paper.experiments import Conditions, loop_dead_time
from smarttac_can.studies.paper.reproduce import reproduce
from smarttac_can.vocabulary.model import PlateModel
from smarttac_can.vocabulary.signals import Drive, Setpoint
from smarttac_can.vocabulary.states import Mode, VibrationLaw

BUS = 540e-6
WINDOW = 461e-6
"""Of the pick-up in s."""
STEP = 2e-6
"""Amplitude of a step from rest in m."""
LOOPS = {"both loops": Mode.AMPLITUDE_RESONANCE, "alone": Mode.AMPLITUDE}
WARM = 43_250.0
LINES = ((GREEN, "--"), (INK, ":"), (RED, "-"))
"""Colour and line of each law."""
PI, SCHEDULED, PREDICTIVE = VibrationLaw
BARE = (PI, PREDICTIVE)
"""Laws that differ without a finger."""
LOADED = {0.0: BARE, 0.5: tuple(VibrationLaw)}
"""Laws to compare under a force in N."""


class Press:
    """A finger that comes down on the middle of the plate after the tare."""

    def __init__(self, Fn: float) -> None:
        self.Fn = Fn

    def at(self, time: float) -> FingerState:
        """Return the state at a time in s."""
        return FingerState(0.0, self.Fn * min(1.0, max(0.0, (time - 0.08) / 0.02)))


class WatchedPlate(Plate):
    """The plate, with the largest vibration at any sub-step; one in a process."""

    def __init__(self, *what: Any, **more: Any) -> None:
        super().__init__(*what, **more)
        self.peak = 0.0
        vars(motion)["vibrate"] = self._vibrate

    def _vibrate(self, step: Response, W: complex, rate: complex) -> tuple[complex, complex]:
        W, rate = vibrate(step, W, rate)
        self.peak = max(self.peak, abs(W))
        return W, rate


@cache
def identified(
    parameters: PlateParameters, subject: int, dead_time: float, seed: int
) -> PlateModel:
    """Return the model that `identify` finds by the plate's data sheet, and a press its load."""
    true = parameters.resonator
    known = PlateModel(gain=true.gain, tau=true.tau)
    plate = Plate(parameters, SUBJECTS[0], Press(0.0), seed=seed, dead_time=dead_time)
    sheet = CascadeParameters(sheet_gain=true.gain, sheet_tau=true.tau)
    found = Identification(known, WARM, sheet)
    old = Drive(0.0, WARM)
    while (drive := found.update(plate.sample().W)) is not None:
        plate.step(old, drive)
        old = drive
    if found.model is None:
        raise RuntimeError(found.failure)
    plate = Plate(parameters, SUBJECTS[subject], Press(0.5), seed=seed, dead_time=dead_time)
    drive, W = Drive(20.0, found.model.f0), []
    for _ in range(200):
        W.append(plate.sample().W)
        plate.step(drive, drive)
    load = found.model.load_of_press(drive.voltage, complex(np.mean(W[150:])), 0.5)
    return replace(found.model, load=load)


class Rig:
    """Plate, finger and controllers at rest, tared."""

    def __init__(
        self,
        law: VibrationLaw,
        dead_time: float,
        *,
        assumed: float | None = None,
        Fn: float = 0.0,
        subject: int = 0,
        seed: int = 1,
        wrong: tuple[float, float, float] = (1.0, 1.0, 0.0),
        softening: float = 0.0,
        window: float = 0.0,
        lag: float = 0.0,
        beside: tuple[float, float] = (0.0, 600.0),
        identify: bool = False,
    ) -> None:
        gain, tau, off = wrong
        share, offset = beside
        true = ResonatorParameters(
            gain=50e-9 * gain,
            tau=PlateModel().tau * tau,
            f0=43_390.0 + off,
            softening=softening,
            neighbour_share=share,
            neighbour_offset=offset,
        )
        sensors = SensorParameters(pickup_window=window, pickup_lag=lag)
        parameters = PlateParameters(resonator=true, sensors=sensors)
        self.plate = WatchedPlate(
            parameters, SUBJECTS[subject], Press(Fn), seed=seed, dead_time=dead_time
        )
        assumed = dead_time if assumed is None else assumed
        model = identified(parameters, subject, dead_time, seed) if identify else PlateModel()
        self.cascade = Cascade(CascadeParameters(vibration_law=law, dead_time=assumed), model)
        self.old = Drive(0.0, WARM)
        self.voltages: list[float] = []
        self.run(70, 0.0, Mode.OFF)
        self.cascade.zero = self.cascade.null()
        self.run(60, 0.0, Mode.OFF)

    def run(self, ticks: int, W_ref: float, mode: Mode) -> np.ndarray[Any, Any]:
        """Return the true amplitude in m at each tick."""
        self.cascade.set_mode(mode)
        self.plate.peak, self.voltages = 0.0, []
        W = []
        target = Setpoint(0.0, WARM, W_ref, 0.3, 0.4, 0.0)
        for _ in range(ticks):
            W.append(abs(self.plate.W))
            drive = self.cascade.update(self.plate.sample(), target)
            self.plate.step(self.old, drive)
            self.old = drive
            self.voltages.append(drive.voltage)
        return np.array(W)


def settled(W: np.ndarray[Any, Any], reference: float, band: float) -> float:
    """Return the last entry into the band in ms, NaN if there is none."""
    outside = np.abs(W - reference) > band
    if outside[-1]:
        return float("nan")
    if not outside.any():
        return 0.0
    last = int(np.flatnonzero(outside)[-1])
    edge = reference + (band if W[last] > reference else -band)
    return last + float((edge - W[last]) / (W[last + 1] - W[last]))


def steps(law: VibrationLaw, dead_time: float, mode: Mode, **rig: Any) -> list[float]:
    """From rest to 1 um, then to 1.5: times in ms to 5 % of the step, overshoots in %."""
    bench, found, last = Rig(law, dead_time, **rig), [], 0.0
    for W_ref in (1e-6, 1.5e-6):
        W = bench.run(80, W_ref, mode)
        found += [settled(W, W_ref, 0.05 * (W_ref - last))]
        found += [100.0 * max(0.0, bench.plate.peak - W_ref) / (W_ref - last)]
        last = W_ref
    return found


def cell(time: float, overshoot: float) -> str:
    """Return a time in ms and an overshoot in %."""
    return f"{time:.1f}; {overshoot:.0f}"


def loads_table() -> Iterator[str]:
    """Settling of each law without and with a finger, means over the five subjects."""
    rows = []
    for law in VibrationLaw:
        for dead_time in (0.0, BUS):
            row = [law.name.lower(), f"{1e6 * dead_time:.0f}"]
            for Fn in (0.0, 0.5, 1.0):
                for mode in LOOPS.values():
                    runs = [
                        steps(law, dead_time, mode, Fn=Fn, subject=k, seed=k + 1) for k in range(5)
                    ]
                    row.append("/".join(f"{t:.1f}" for t in np.mean(runs, axis=0)[::2]))
            rows.append(row)
    head = "law|dead time|" + "|".join(f"{Fn} N, {x}" for Fn in ("0", "0.5", "1") for x in LOOPS)
    return columns(head, rows)


def wrong_table(drawn: int) -> Iterator[str]:
    """Draw 300 plates that are not the model's."""
    rows = []
    for law in BARE:
        for dead_time in (0.0, BUS, 950e-6):
            row = [law.name.lower(), f"{1e6 * dead_time:.0f}"]
            for mode in LOOPS.values():
                draw = np.random.default_rng(drawn)
                runs = []
                for seed in range(300):
                    wrong = (*draw.uniform(0.8, 1.2, 2).tolist(), float(draw.uniform(-200, 200)))
                    runs.append(steps(law, dead_time, mode, seed=seed, wrong=wrong)[:2])
                times, overshoots = np.array(runs).T
                times = np.nan_to_num(times, nan=80.0)
                row += [
                    " ".join(f"{np.percentile(times, q):.1f}" for q in (50, 95, 100)),
                    " ".join(f"{np.percentile(overshoots, q):.0f}" for q in (50, 95, 100)),
                ]
            rows.append(row)
    return columns("law|dead time|both: ms|both: %|alone: ms|alone: %", rows)


def delay_table() -> Iterator[str]:
    """Assume another dead time than the true one."""
    rows = []
    for assumed, trues in (
        (BUS, (0, 270, 378, 540, 702, 810, 900)),
        (0.0, (100, 200, 540)),
    ):
        for true in trues:
            runs = [
                steps(law, 1e-6 * true, Mode.AMPLITUDE_RESONANCE, assumed=assumed, Fn=Fn)
                for Fn, laws in LOADED.items()
                for law in laws
            ]
            cells = [cell(*run[:2]).replace("nan", "never") for run in runs]
            rows.append([f"{1e6 * assumed:.0f}", f"{true}", *cells])
    names = (f"{law.name.lower()}, {Fn:g} N" for Fn, laws in LOADED.items() for law in laws)
    return columns("assumed|true|" + "|".join(names), rows)


def softening_table() -> Iterator[str]:
    """From rest to 2.5 um on the model's plate, which softens: ms; overshoot in %."""
    rows = []
    for law in VibrationLaw:
        for dead_time in (0.0, BUS):
            for Fn in (0.0, 0.5):
                row = [law.name.lower(), f"{1e6 * dead_time:.0f}", f"{Fn:g}"]
                for softening in (0.0, 60e6, 100e6, 150e6):
                    rig = Rig(law, dead_time, Fn=Fn, softening=softening)
                    W = rig.run(80, 2.5e-6, Mode.AMPLITUDE_RESONANCE)
                    over = 100.0 * max(0.0, rig.plate.peak / 2.5e-6 - 1.0)
                    row.append(cell(settled(W, 2.5e-6, 0.125e-6), over).replace("nan", "never"))
                rows.append(row)
    return columns("law|dead time|force, N|0 Hz/um|60 Hz/um|100 Hz/um|150 Hz/um", rows)


def plates_table(drawn: int) -> Iterator[str]:
    """Laws against plates that soften, behind a pick-up with a window; 300 corners a cell."""
    rows = []
    assumed = BUS + 0.5 * WINDOW
    for law, (identify, dead_time, window, written) in product(
        VibrationLaw,
        (
            (False, 0.0, 0.0, 0.0),
            (False, BUS, 0.0, BUS),
            (False, BUS, WINDOW, assumed),
            (False, BUS, WINDOW, BUS),
            (True, BUS, 0.0, BUS),
            (True, BUS, WINDOW, assumed),
        ),
    ):
        times_us = (f"{1e6 * time:.0f}" for time in (dead_time, window, written))
        row = [law.name.lower(), "identified" if identify else "default", *times_us]
        for softening in (0.0, 100e6, 150e6):
            draw = np.random.default_rng(drawn)
            runs = []
            for seed in range(300):
                wrong = (*draw.uniform(0.8, 1.2, 2).tolist(), float(draw.uniform(-200, 200)))
                Fn, subject = float(draw.choice((0.0, 0.5, 1.0))), int(draw.integers(5))
                rig = Rig(
                    law, dead_time, assumed=written, Fn=Fn, subject=subject, seed=seed,
                    wrong=wrong, softening=softening, window=window, identify=identify,
                )  # fmt: skip
                W = rig.run(80, STEP, Mode.AMPLITUDE_RESONANCE)
                over = 100.0 * max(0.0, rig.plate.peak / STEP - 1.0)
                runs.append((settled(W, STEP, 0.05 * STEP), over))
            times, overshoots = np.array(runs).T
            never = int(np.isnan(times).sum())
            times = np.nan_to_num(times, nan=80.0)
            row.append(
                " ".join(f"{np.percentile(times, q):.1f}" for q in (50, 95, 100))
                + "; "
                + " ".join(f"{np.percentile(overshoots, q):.0f}" for q in (50, 95, 100))
                + (f"; {never} never" if never else "")
            )
        rows.append(row)
    return columns("law|model|dead time|window|assumed|0 Hz/um|100 Hz/um|150 Hz/um", rows)


def pickup_table() -> Iterator[str]:
    """Laws behind a pick-up that sees a mode beside this one, or has a filter; 540 us."""
    pickups: list[tuple[str, dict[str, Any]]] = [
        (f"{share:.0%} at {offset:+.0f} Hz", {"beside": (share, offset)})
        for share, offset in product((0.1, 0.3), (-900.0, -300.0, 300.0, 900.0))
    ]
    for lag in (150e-6, 300e-6):
        for assumed in (BUS, BUS + lag):
            text = f"filter {1e6 * lag:.0f} us, {1e6 * assumed:.0f} assumed"
            pickups.append((text, {"lag": lag, "assumed": assumed}))
    rows = []
    for text, pickup in pickups:
        row = [text]
        for law, Fn in product(VibrationLaw, (0.0, 0.5)):
            rig = Rig(law, BUS, Fn=Fn, **pickup)
            W = rig.run(80, STEP, Mode.AMPLITUDE_RESONANCE)
            over = 100.0 * max(0.0, rig.plate.peak / STEP - 1.0)
            row.append(f"{over:.0f}; {100.0 * (W[-20:].mean() / STEP - 1.0):+.1f}")
        rows.append(row)
    names = (f"{law.name.lower()}, {Fn:g} N" for law, Fn in product(VibrationLaw, (0.0, 0.5)))
    return columns("pick-up|" + "|".join(names), rows)


def small_table() -> Iterator[str]:
    """Small and large amplitudes, and the effect of the noise of the pick-up."""
    rows = []
    for law in BARE:
        for W_ref in (0.05e-6, 0.1e-6, 1e-6, 2.5e-6):
            bench = Rig(law, BUS)
            W = bench.run(1000, W_ref, Mode.AMPLITUDE_RESONANCE)
            over = 100.0 * max(0.0, bench.plate.peak / W_ref - 1.0)
            rows.append(
                [
                    law.name.lower(),
                    f"{1e6 * W_ref:g}",
                    f"{settled(W, W_ref, 0.05 * W_ref):.1f}",
                    f"{over:.1f}",
                    f"{1e9 * W[200:].std():.2f}",
                    f"{1e3 * np.std(bench.voltages[200:]):.0f}",
                ]
            )
    return columns("law|um|ms to 5 %|overshoot, %|std of W, nm|std of V, mV", rows)


def friction_table() -> Iterator[str]:
    """Table I with each law: the loop of the friction was designed around the slowest."""
    rows = []
    for law in VibrationLaw:
        for dead_time in (0.0, BUS):
            conditions = Conditions(vibration_law=law, dead_time=1e6 * dead_time)
            mean = reproduce(frozenset({"table1"}), conditions)[1]["table1"]["mean"]
            names = ("rise_time_ms", "overshoot_percent", "static_error_percent")
            rows.append(
                [law.name.lower(), f"{1e6 * dead_time:.0f}", *(f"{mean[n]:.1f}" for n in names)]
            )
    return columns("law|dead time|rise, ms|overshoot, %|static error, %", rows)


def cost_table() -> Iterator[str]:
    """Median time of an update in closed loop, the laws in turn, and over that of `pi`."""
    benches = {law: Rig(law, BUS, Fn=0.5) for law in VibrationLaw}
    taken: dict[VibrationLaw, list[float]] = {law: [] for law in VibrationLaw}
    for tick in range(3000):
        W_ref = 1e-6 if tick // 50 % 2 else 1.5e-6
        target = Setpoint(0.0, WARM, W_ref, 0.3, 0.4, 0.0)
        for law, bench in benches.items():
            bench.cascade.set_mode(Mode.AMPLITUDE_RESONANCE)
            measurement = bench.plate.sample()
            start = perf_counter()
            drive = bench.cascade.update(measurement, target)
            taken[law].append(perf_counter() - start)
            bench.plate.step(bench.old, drive)
            bench.old = drive
    median = {law: float(np.median(times)) for law, times in taken.items()}
    rows = [
        [law.name.lower(), f"{1e6 * time:.1f} us", f"{time / median[PI]:.1f}"]
        for law, time in median.items()
    ]
    return columns("law|an update|over `pi`", rows)


def figure() -> None:
    """Draw 0 to 1 to 1.5 um under 0.5 N with the dead time of a bus."""
    with canvas(7.2, 5) as picture:
        axes = picture.subplots(2, 1, sharex=True)
        for law, (colour, line) in zip(VibrationLaw, LINES, strict=True):
            bench = Rig(law, BUS, Fn=0.5)
            W, V = [], []
            for W_ref in (1e-6, 1.5e-6):
                W += [*bench.run(30, W_ref, Mode.AMPLITUDE_RESONANCE)]
                V += bench.voltages
            name = law.name.lower()
            axes[0].plot(1e6 * np.array(W), line, color=colour, label=name)
            axes[1].plot(V, line, color=colour, drawstyle="steps-post")
        axes[0].set_title("1 and 1.5 µm under 0.5 N (simulated)")
        axes[0].legend(loc="lower right")
        axes[0].set_ylabel("amplitude (µm)")
        axes[1].set_ylabel("voltage (V)")
        axes[1].set_xlabel("time (ms)")
        save(picture, EXPLANATION / "figures" / "laws.svg")


def pages(draw: bool, seed: int) -> Pages:
    """Run everything, fill the template, draw the figure."""
    if draw:
        figure()
    model = PlateModel()
    fastest = -1e3 * model.tau * np.log(1.0 - 0.95e-6 / (model.gain * 150.0))
    fields: dict[str, str | Iterator[str]] = {
        "loads": loads_table(),
        "delay": delay_table(),
        "friction": friction_table(),
        "fastest": f"{fastest:.2f}",
        "dead_time": f"{loop_dead_time(1_000_000):.0f}",
    }
    plates = {
        "softening": softening_table(),
        "wrong": wrong_table(seed),
        "plates": plates_table(seed),
        "pickup": pickup_table(),
        "small": small_table(),
        "cost": cost_table(),
    }
    return {
        **renewed(EXPLANATION / "vibration.md", fields),
        **renewed(DOCS / "dev" / "measurements.md", plates),
    }


def main() -> int:
    """Write the page, or compare it."""
    return made(__doc__, pages, seed=17)

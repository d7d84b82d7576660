"""Compare the laws of the vibration: tables of docs/explanation/vibration.md.

Example: python tools/vibration.py
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from typing import Any

import numpy as np
from pages import EXPLANATION, Pages, columns, made, renewed

from smarttac_can.bench.drawing import GREEN, INK, RED, canvas, save
from smarttac_can.control.cascade import Cascade
from smarttac_can.control.parameters import CascadeParameters
from smarttac_can.paper.experiments import Conditions, loop_dead_time
from smarttac_can.paper.reproduce import reproduce
from smarttac_can.plant import motion
from smarttac_can.plant.finger import FingerState
from smarttac_can.plant.parameters import PlateParameters
from smarttac_can.plant.plate import Plate
from smarttac_can.plant.resonator import Response, vibrate
from smarttac_can.plant.subjects import SUBJECTS
from smarttac_can.vocabulary.model import PlateModel
from smarttac_can.vocabulary.signals import Drive, Setpoint
from smarttac_can.vocabulary.states import Mode, VibrationLaw

BUS = 540e-6
LOOPS = {"both loops": Mode.AMPLITUDE_RESONANCE, "alone": Mode.AMPLITUDE}
WARM = 43_250.0
LINES = ((GREEN, "--"), (INK, ":"), (RED, "-"))
"""Colour and line of each law."""
LOADED = {0.0: (VibrationLaw.PI, VibrationLaw.PREDICTIVE), 0.5: tuple(VibrationLaw)}
"""Laws to compare under a force in N; without a finger two are the same."""


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


class Rig:
    """Plate, finger and controllers at rest, tared."""

    def __init__(
        self,
        law: VibrationLaw,
        dead_time: float,
        *,
        told: float | None = None,
        Fn: float = 0.0,
        subject: int = 0,
        seed: int = 1,
    ) -> None:
        self.plate = WatchedPlate(
            PlateParameters(), SUBJECTS[subject], Press(Fn), seed=seed, dead_time=dead_time
        )
        told = dead_time if told is None else told
        parameters = CascadeParameters(vibration_law=law, dead_time=told)
        self.cascade = Cascade(parameters, PlateModel())
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


def told_table() -> Iterator[str]:
    """Tell another dead time than the true one."""
    rows = []
    for told, trues in (
        (BUS, (0, 270, 378, 540, 702, 810, 900)),
        (0.0, (100, 200, 540)),
    ):
        for true in trues:
            runs = [
                steps(law, 1e-6 * true, Mode.AMPLITUDE_RESONANCE, told=told, Fn=Fn)
                for Fn, laws in LOADED.items()
                for law in laws
            ]
            cells = [cell(*run[:2]).replace("nan", "never") for run in runs]
            rows.append([f"{1e6 * told:.0f}", f"{true}", *cells])
    names = (f"{law.name.lower()}, {Fn:g} N" for Fn, laws in LOADED.items() for law in laws)
    return columns("told|true|" + "|".join(names), rows)


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


def pages(draw: bool) -> Pages:
    """Run everything, fill the template, draw the figure."""
    if draw:
        figure()
    model = PlateModel()
    fastest = -1e3 * model.tau * np.log(1.0 - 0.95e-6 / (model.gain * 150.0))
    fields: dict[str, str | Iterator[str]] = {
        "loads": loads_table(),
        "told": told_table(),
        "friction": friction_table(),
        "fastest": f"{fastest:.2f}",
        "dead_time": f"{loop_dead_time(1_000_000):.0f}",
    }
    return renewed(EXPLANATION / "vibration.md", fields)


if __name__ == "__main__":
    sys.exit(made(__doc__, pages))

"""The paper's Fig. 2, 3, 5, 6 and 7, and an animation of Fig. 7, drawn from recorded traces.

The colours differ for all common kinds of colour vision, and curves differ not only by colour.
Needs matplotlib (extra ``report``); draws without a window and without the state of pyplot.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.animation import FuncAnimation, PillowWriter
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Ellipse
from matplotlib.ticker import MaxNLocator

from smarttac_can.bench.drawing import GREEN, INK, PALE, RED, canvas
from smarttac_can.bench.traces import Floats, Trace
from smarttac_can.science.population.steps import Step, UndefinedError, overshoot_percent, rise_time
from smarttac_can.studies.paper.metrics import (
    LOOPS,
    Touches,
    align_at_switch,
    final_mean,
    find,
    friction_amplitudes,
    friction_ratio_percent,
    from_switch_on,
    response_time,
    subjects_of,
    voltage_difference_percent,
)
from smarttac_can.studies.paper.references import AMPLITUDE_UM, RESPONSE_BAND, published

BAND = "#e9eef3"
SUBJECTS = (
    ("#0072b2", "o"),
    ("#e69f00", "s"),
    ("#56b4e9", "^"),
    ("#8f4f86", "D"),
    ("#5a5a5a", "v"),
)
"""Colour and marker of each subject of Fig. 2, after Okabe and Ito."""
RUNS = {
    "amplitude_and_frequency": (RED, "o", "-", "amplitude and frequency loops"),
    "amplitude_only": (GREEN, "s", "--", "amplitude loop only"),
}
"""Colour, marker, line and name of the two runs of Fig. 5 and 6."""
CURVES: dict[str, dict[str, Any]] = {
    "touches": {"linestyle": ":", "color": "#3d7ea6", "linewidth": 0.6, "alpha": 0.5},
    "reference": {"linestyle": "--", "color": RED, "linewidth": 1.5},
    "mean": {"linestyle": "-", "color": "black", "linewidth": 2.2},
}
"""Line styles of Fig. 7."""
_IN_LEGEND: dict[str, dict[str, Any]] = {"touches": {"linewidth": 1.5, "alpha": 1.0}}
"""What differs in the legend: one touch alone is too thin to be seen."""
_MOVING_SUBJECT, _MOVING_FROM, _MOVING_MS, _FRAME_MS = 3, 2000, 960, 10
"""Subject of the animation, its first tick, its length and the time between frames in ms."""
_UNTIL_MS = 20
"""End of the time axis of Fig. 5 and 6 in ms."""
_SLOWER = 5
"""Factor by which the animation is slower than the finger."""
_ACROSS_MM = 16.0
"""Half of the width of the plate in the animation in mm."""


def fig2(traces: Iterable[Trace]) -> Figure:
    """Draw the friction left at each amplitude: a point per subject, the mean in red (Fig. 2).

    Raises
    ------
    UndefinedError
        If there are no traces of it.
    """
    traces = list(traces)
    amplitudes, subjects = friction_amplitudes(traces), subjects_of(traces, "fig2")
    if not subjects:
        raise UndefinedError("fig2 was not run")
    ratios = np.array(
        [
            [_ratio_or_nan(traces, subject, amplitude) for amplitude in amplitudes]
            for subject in subjects
        ]
    )
    with canvas(7.2, 4.6) as figure:
        axes = figure.subplots()
        aside = 0.025 * (np.arange(len(subjects)) - (len(subjects) - 1) / 2)
        for subject, row, shift in zip(subjects, ratios, aside, strict=True):
            colour, marker = SUBJECTS[(subject - 1) % len(SUBJECTS)]
            points: dict[str, Any] = {
                "color": colour,
                "ms": 7.5,
                "mec": "white",
                "mew": 0.8,
                "zorder": 3,
            }
            axes.plot(amplitudes + shift, row, marker, label=f"subject {subject}", **points)
        axes.plot(amplitudes, ratios.mean(axis=0), "-", color=RED, lw=2.4, label="mean")
        axes.set(
            ylim=(0, 109), xticks=amplitudes, title="Friction left by the vibration (simulated)"
        )
        axes.set_xlabel("vibration amplitude, peak-to-peak (µm)")
        axes.set_ylabel("friction ratio µ₁/µ₀ (%)")
        axes.legend(loc="lower left", ncols=2)
    return figure


def fig3(law: Callable[[float], float]) -> Figure:
    """Draw the friction law: increment dW of the amplitude over the friction error E (Fig. 3).

    Parameters
    ----------
    law
        Function of eq. (9): takes E in %, returns dW in m peak-to-peak.
    """
    error = np.linspace(-50, 50, 401)
    increment_um = np.array([1e6 * law(e) for e in error.tolist()])
    with canvas(6.4, 4.2) as figure:
        axes = figure.subplots()
        axes.axhline(0, color=PALE, lw=0.8)
        axes.axvline(0, color=PALE, lw=0.8)
        axes.plot(error, increment_um, color=INK, lw=2.4)
        axes.set(xlim=(-50, 50), title="Friction law, eq. (9)")
        axes.set_xlabel("friction error E (%)")
        axes.set_ylabel("amplitude increment ΔW, peak-to-peak (µm)")
        axes.margins(y=0.12)
    return figure


def fig5(traces: Iterable[Trace]) -> Figure:
    """Draw the amplitude after switch-on with both loops and with one; the 5 % band (Fig. 5)."""
    traces = list(traces)
    low, high = (AMPLITUDE_UM * (1 + sign * RESPONSE_BAND) for sign in (-1, 1))
    with canvas(7.2, 4.6) as figure:
        axes = figure.subplots()
        axes.axhspan(low, high, color=BAND, zorder=0)
        axes.text(_UNTIL_MS, high, "±5 % ", ha="right", va="bottom", color=PALE)
        entries = []
        for loops, (colour, marker, line, name) in RUNS.items():
            trace = find(traces, f"fig5.{loops}")
            amplitude = from_switch_on(trace, trace.amplitude_um)
            _plot_run(axes, amplitude, colour, marker, line, name, drawstyle="default")
            with suppress(UndefinedError):
                paper = published(f"fig5.{loops}.response_time_ms")
                entries.append((response_time(amplitude, AMPLITUDE_UM), paper, colour))
        # Each line ends at its note, so that the note of an earlier line below lies over none.
        for row, (entry, paper, colour) in enumerate(sorted(entries)):
            height = 0.04 + 0.09 * row
            axes.plot([entry] * 2, [height, low], ":", color=colour, lw=1.6)
            axes.text(entry, height, f" {entry:.1f} ms{paper}", color=colour, weight="bold")
        axes.set(xlim=(0, _UNTIL_MS), xticks=range(0, _UNTIL_MS + 1, 2))
        axes.set(title="Amplitude after switch-on, 140 Hz off (simulated)")
        axes.set_ylim(0, max(1.15, axes.get_ylim()[1]))
        axes.set_xlabel("time (ms)")
        axes.set_ylabel("vibration amplitude W, peak-to-peak (µm)")
        axes.legend(loc="lower right", bbox_to_anchor=(1, 0.12))
    return figure


def fig6(traces: Iterable[Trace]) -> Figure:
    """Draw the voltage that holds the amplitude with both loops and with one (Fig. 6)."""
    traces = list(traces)
    runs = {loops: find(traces, f"fig5.{loops}") for loops in LOOPS}
    finals = [final_mean(runs[loops], runs[loops].voltage_v) for loops in LOOPS]
    percent = voltage_difference_percent(*(runs[loops] for loops in LOOPS))
    with canvas(7.2, 4.6) as figure:
        axes = figure.subplots()
        for loops, (colour, marker, line, name) in RUNS.items():
            voltage = from_switch_on(runs[loops], runs[loops].voltage_v)
            _plot_run(axes, voltage, colour, marker, line, name, drawstyle="steps-post")
        at = 0.93 * _UNTIL_MS
        axes.annotate("", (at, finals[0]), (at, finals[1]), arrowprops={"arrowstyle": "<->"})
        note = f"{percent:+.1f} %{published('fig6.voltage_difference_percent')}"
        axes.text(at, float(np.mean(finals)), note + "  ", ha="right", va="center", weight="bold")
        axes.set(xlim=(0, _UNTIL_MS), xticks=range(0, _UNTIL_MS + 1, 2))
        axes.set(title=f"Voltage for {AMPLITUDE_UM:g} µm (simulated)")
        axes.set_ylim(0, 1.08 * axes.get_ylim()[1])
        axes.set_xlabel("time (ms)")
        axes.set_ylabel("voltage V (V)")
        axes.legend(loc="lower right")
    return figure


def fig7(traces: Iterable[Trace], law: str) -> Figure:
    """Draw the COF around each switch of the reference: touches, mean, reference (Fig. 7).

    There are two panels per subject: up-steps on the left, down-steps on the right.

    Parameters
    ----------
    traces
        Traces of the runs.
    law
        Name of their friction law, for the title.

    Raises
    ------
    UndefinedError
        If there are no traces of Table I.
    """
    traces = list(traces)
    subjects = subjects_of(traces, "table1")
    if not subjects:
        raise UndefinedError("table1 was not run")
    rows = (len(subjects) + 1) // 2
    title = f"Controlled friction around the switch of its reference, law {law} (simulated)"
    with canvas(11, 0.7 + 3.5 * rows) as figure:
        figure.suptitle(title, x=0.012, ha="left", weight="bold", fontsize=13)
        # One grid, so that the panels of all rows are aligned.
        panels = figure.subplots(rows, 4, squeeze=False).reshape(2 * rows, 2)
        for subject, pair in zip(subjects, panels, strict=False):
            trace = find(traces, "table1", subject)
            _draw_subject(pair, subject, [align_at_switch([trace], up=up) for up in (True, False)])
        for axes in panels[len(subjects) :].flat:
            axes.remove()
        lines = [
            Line2D([], [], **style | _IN_LEGEND.get(name, {})) for name, style in CURVES.items()
        ]
        figure.legend(lines, list(CURVES), loc="outside lower right", ncols=len(CURVES))
    return figure


def save_crossing(
    traces: Iterable[Trace], file: Path, progress: Callable[[float], None] = lambda _share: None
) -> None:
    """Write an animated GIF of a finger that crosses the boundary, and of the COF.

    The upper part shows the plate from the side, with the finger, its forces and a wave whose
    height is the vibration (not to scale). The lower part shows the COF and its reference.

    Parameters
    ----------
    traces
        Traces, including those of ``table1``.
    file
        Path of the file, with the suffix .gif.
    progress
        Function called with the fraction of the frames that are drawn, 0..1.
    """
    part = slice(_MOVING_FROM, _MOVING_FROM + _MOVING_MS)
    trace = find(traces, "table1", _MOVING_SUBJECT)
    x, W = trace.position_mm[part], trace.amplitude_um[part]
    Ft, Fn = trace.tangential_force_n[part], trace.normal_force_n[part]
    mu, reference = trace.cof[part], trace.cof_reference[part]
    time = np.arange(len(x))
    with canvas(7.2, 4.6) as figure:
        plate, chart = figure.subplots(2, height_ratios=(2, 3))
        wave, finger, arrows = _draw_plate(plate, float(np.nanmin(reference)))
        chart.plot(time, reference, label="reference", **CURVES["reference"])
        (curve,) = chart.plot([], [], label="measured", **CURVES["mean"])
        chart.set(xlim=(0, len(x)), ylim=(0, 0.7), xlabel="time (ms)", ylabel="COF")
        chart.legend(loc="lower right", ncols=2)
        across = np.linspace(-_ACROSS_MM, _ACROSS_MM, 400)

        def draw(tick: int) -> None:
            wave.set_data(across, 0.5 * W[tick] * np.cos(1.5 * across))
            finger.set_center((x[tick], 4.8))
            arrows.set_offsets(np.tile((x[tick], 4.8), (2, 1)))
            # The force on the finger opposes its motion; the position is noisy.
            before, after = x[max(tick - _FRAME_MS, 0)], x[min(tick + _FRAME_MS, len(x) - 1)]
            pull = 20.0 * np.sign(before - after) * Ft[tick]
            arrows.set_UVC([0.0, pull], [-8.0 * Fn[tick], 0.0])
            curve.set_data(time[:tick], mu[:tick])

        ticks = range(0, len(x), _FRAME_MS)
        moving = FuncAnimation(figure, draw, ticks, blit=False)
        moving.save(
            file,
            PillowWriter(fps=round(1000 / _FRAME_MS / _SLOWER)),
            dpi=80,
            progress_callback=lambda number, _total: progress((number + 1) / len(ticks)),
        )


def _draw_plate(axes: Axes, lower: float) -> tuple[Line2D, Ellipse, Any]:
    """Draw the plate from the side; return the moving parts: wave, finger and forces."""
    axes.axvspan(-_ACROSS_MM, 0, color=BAND)
    for side, mu in ((-1, lower), (1, lower + 0.1)):
        axes.text(side * _ACROSS_MM / 2, 9.3, f"COF {mu:.1f}", ha="center", color=INK)
    axes.axvline(0, color=PALE, lw=1, linestyle=":")
    (wave,) = axes.plot([], [], color=GREEN, lw=1.8)
    finger = Ellipse((0, 4.8), 5.5, 6.5, facecolor="#e0ac8b", edgecolor=INK, lw=1.2)
    axes.add_patch(finger)
    zeros = [0.0, 0.0]
    arrows = axes.quiver(
        zeros,
        zeros,
        zeros,
        zeros,
        color=[INK, RED],
        angles="xy",
        scale_units="xy",
        scale=1,
        zorder=3,
    )
    axes.set(xlim=(-_ACROSS_MM, _ACROSS_MM), ylim=(-3, 11), yticks=[], xlabel="position (mm)")
    axes.set_title("A finger crosses the boundary (simulated, 5 times slower)")
    axes.grid(visible=False)
    return wave, finger, arrows


def _draw_subject(pair: Iterable[Axes], subject: int, directions: Sequence[Touches]) -> None:
    left, right = pair
    right.sharey(left)
    right.tick_params(labelleft=False)
    for axes, touches, name in zip((left, right), directions, ("up", "down"), strict=True):
        axes.set_xlabel("time after the switch (ms)")
        axes.set_title(f"Subject {subject}, {name}-step", fontsize=10.5, pad=6)
        try:
            mean = touches.mean_curve()
        except UndefinedError as reason:
            axes.text(0.5, 0.5, str(reason), ha="center", transform=axes.transAxes, color=PALE)
            continue
        for step in touches.steps:
            axes.plot(step.time_ms, step.mu, **CURVES["touches"])
        reference = np.where(mean.time_ms < 0, mean.before, mean.after)
        axes.plot(mean.time_ms, reference, drawstyle="steps-post", **CURVES["reference"])
        axes.plot(mean.time_ms, mean.mu, **CURVES["mean"])
        axes.set_xlim(mean.time_ms[0], mean.time_ms[-1])
        y, va = (0.95, "top") if name == "down" else (0.06, "bottom")
        note = _step_note(touches, mean, subject)
        axes.text(0.97, y, note, ha="right", va=va, transform=axes.transAxes, fontsize=8)
    left.set_ylabel("coefficient of friction µ")
    left.yaxis.set_major_locator(MaxNLocator(steps=[1, 2, 5, 10], nbins=7))


def _step_note(touches: Touches, mean: Step, subject: int) -> str:
    """Return a note on the dynamics of a step; for up-steps with the numbers of Table I."""
    count = len(touches.steps)
    up = mean.after > mean.before
    row = f"table1.subjects[{subject - 1}]"
    rise, overshoot = (
        published(f"{row}.{name}") if up else "" for name in ("rise_time_ms", "overshoot_percent")
    )
    try:
        dynamics = (
            f"{'rise' if up else 'fall'} {rise_time(mean):.1f} ms{rise}\n"
            f"overshoot {overshoot_percent(mean):.0f} %{overshoot}"
        )
    except UndefinedError as reason:
        dynamics = str(reason)
    return f"{dynamics}\n{count} touches"


def _plot_run(
    axes: Axes, values: Floats, colour: str, marker: str, line: str, name: str, *, drawstyle: str
) -> None:
    axes.plot(
        values,
        line,
        color=colour,
        marker=marker,
        ms=4.5,
        mec="white",
        mew=0.5,
        lw=1.8,
        label=name,
        drawstyle=drawstyle,
    )


def _ratio_or_nan(traces: list[Trace], subject: int, amplitude: float) -> float:
    try:
        return friction_ratio_percent(traces, subject, amplitude)
    except UndefinedError:
        return float("nan")

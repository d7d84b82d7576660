"""Summary of the rows of a campaign: data for JSON, lines, and a figure of all fingers."""

from __future__ import annotations

import json
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from smarttac_can.campaign.runner import COLUMNS, Result, Rows, parameters
from smarttac_can.population.trial import Campaign

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LIMIT_CYCLE: Final = 0.03
"""Chatter of the true COF above which a finger is in a limit cycle."""
_QUANTILES: Final = {"p5": 0.05, "p50": 0.5, "p95": 0.95}


def summary(campaign: Campaign, result: Result) -> dict[str, Any]:
    """Return the results of a campaign.

    Percentiles are values of a finger, not between two. A finger that makes no step counts as
    slower than any, and as 100 % of overshoot; a percentile that falls on such a rise time is None.
    """
    rows = result.rows
    metrics = {name: _percentiles(rows[:, at]) for at, name in enumerate(COLUMNS[:-1])}
    return {
        **parameters(campaign),
        "fingers": len(rows),
        "metrics": metrics,
        "limit_cycle_share": float(np.mean(rows[:, COLUMNS.index("chatter")] > LIMIT_CYCLE)),
        "without_rise": int(np.count_nonzero(np.isinf(rows[:, COLUMNS.index("rise_time_ms")]))),
        "finger_seconds": float(rows[:, -1].sum()),
        "finger_seconds_per_second": result.ran_s / result.wall_s if result.ran_s else None,
        "compile_s": round(result.compile_s, 3),
        "compiled": result.compiled,
        "rows_sha256": sha256(rows.astype("<f8").tobytes()).hexdigest(),
    }


def _percentiles(column: Rows) -> dict[str, float | None]:
    """Return percentiles over the fingers that have the metric; None without one, or of no rise."""
    known = column[~np.isnan(column)]
    if not len(known):
        return dict.fromkeys(_QUANTILES)
    values = np.quantile(known, list(_QUANTILES.values()), method="inverted_cdf").tolist()
    return {
        name: value if np.isfinite(value) else None
        for name, value in zip(_QUANTILES, values, strict=True)
    }


def lines(results: dict[str, Any]) -> list[str]:
    """Return the summary as lines."""
    r = results
    speed = r["finger_seconds_per_second"]
    pace = "nothing left to run" if speed is None else f"{speed:.0f} finger-seconds a second"
    head = (
        f"{r['fingers']} {'finger' if r['fingers'] == 1 else 'fingers'}, seed {r['seed']}, "
        f"law {r['law']}, vibration law {r['vibration_law']}, "
        f"dead time {r['dead_time_us']:.0f} us, case {r['case']}"
    )
    rows = [
        f"{name:<32}" + "".join(f"{_number(of[q]):>10}" for q in _QUANTILES)
        for name, of in r["metrics"].items()
    ]
    return [
        head,
        f"{'':<32}" + "".join(f"{q:>10}" for q in _QUANTILES),
        *rows,
        f"in a limit cycle: {100 * r['limit_cycle_share']:.2f} %, without a rise: "
        f"{r['without_rise']}",
        f"{r['finger_seconds']:.0f} finger-seconds, {pace}, {r['compile_s']:.1f} s to compile",
    ]


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"


RESULTS, FINGERS, PICTURE = "campaign.json", "fingers.csv", "campaign.png"
FILES: Final = (RESULTS, FINGERS, PICTURE, "campaign.svg")
"""All that `write_folder` writes."""


def write_folder(folder: Path, results: dict[str, Any], rows: Rows) -> Path:
    """Write a folder, and return the path of the PNG; the same results make the same bytes.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    # matplotlib is an extra.
    from smarttac_can.bench.drawing import save  # noqa: PLC0415

    folder.mkdir(parents=True, exist_ok=True)
    text = json.dumps(results, indent=2) + "\n"
    (folder / RESULTS).write_text(text, encoding="utf-8")
    with (folder / FINGERS).open("w", encoding="ascii", newline="") as file:
        file.write(",".join(("finger", *COLUMNS)) + "\n")
        for number, row in enumerate(rows):
            file.write(",".join((str(number), *map(repr, row.tolist()))) + "\n")
    picture = folder / PICTURE
    save(distributions(rows, lines(results)[0]), picture)
    return picture


_PANELS: Final = {
    "rise_time_ms": "rise time (ms)",
    "overshoot_percent": "overshoot (% of the step)",
    "static_error_percent": "static error (% of the reference)",
    "chatter": "chatter of the COF (standard deviation)",
}
_FEW_DECADES, _MANY_DECADES = 1.0, 2.5


def distributions(rows: Rows, title: str) -> Figure:
    """Draw the share of fingers below each value, of the true and of the measured COF.

    Needs matplotlib (extra ``report``).

    Parameters
    ----------
    rows
        A row a finger; columns as in `COLUMNS`.
    title
        What was run, below the heading.
    """
    from smarttac_can.bench.drawing import GREEN, RED, canvas  # noqa: PLC0415

    curves = {"": (RED, "-", "true COF"), "measured_": (GREEN, "--", "measured COF")}
    with canvas(9.0, 7.0) as figure:
        figure.suptitle(f"Random fingers under control (simulated)\n{title}", fontsize=11)
        panels = figure.subplots(2, 2, sharey=True)
        for axes, (name, label) in zip(panels.flat, _PANELS.items(), strict=True):
            for prefix, (colour, line, legend) in curves.items():
                column = rows[:, COLUMNS.index(prefix + name)]
                known = np.sort(column[np.isfinite(column)])
                share = 100.0 * np.arange(len(known) + 1) / len(rows)
                # From 0 on, so that a single finger shows as well.
                values = [*known[:1], *known]
                axes.plot(values, share[: len(values)], color=colour, linestyle=line, label=legend)
            if name == "chatter":
                _mark_limit_cycles(axes)
            axes.set_xscale("log")
            _label_few(axes)
            axes.set_xlabel(label)
            axes.set_ylim(0.0, 100.0)
        for axes in panels[:, 0]:
            axes.set_ylabel("fingers below (%)")
        handles, labels = panels[0, 0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=len(labels))
    return figure


def _mark_limit_cycles(axes: Axes) -> None:
    from smarttac_can.bench.drawing import PALE  # noqa: PLC0415

    axes.axvline(LIMIT_CYCLE, color=PALE, linewidth=1.2, linestyle=":")
    axes.annotate(
        f"limit cycle above {LIMIT_CYCLE:g}",
        (LIMIT_CYCLE, 3.0),
        (-3.0, 0.0),
        textcoords="offset points",
        ha="right",
        va="bottom",
        rotation=90,
        fontsize=9,
    )


def _label_few(axes: Axes) -> None:
    """Label a logarithmic axis by plain numbers, so few that they do not touch."""
    from matplotlib.ticker import (  # noqa: PLC0415
        FuncFormatter,
        LogLocator,
        MaxNLocator,
        NullFormatter,
    )

    low, high = axes.get_xlim()
    decades = np.log10(high / low)
    if decades < _FEW_DECADES:
        axes.xaxis.set_major_locator(MaxNLocator(4))
    else:
        subs = (1.0,) if decades > _MANY_DECADES else (1.0, 2.0, 5.0)
        axes.xaxis.set_major_locator(LogLocator(subs=subs, numticks=8))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())

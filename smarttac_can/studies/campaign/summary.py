"""Summary of the rows of a campaign: data for JSON, lines, and a figure of all fingers."""

from __future__ import annotations

import json
from collections.abc import Sequence
from hashlib import sha256
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from smarttac_can.science.population.trial import TOUCH_FIGURES, Campaign
from smarttac_can.studies.campaign.runner import COLUMNS, CURVES, Result, Rows, parameters

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LIMIT_CYCLE: Final = 0.03
"""Chatter of the true COF above which a finger is in a limit cycle."""
_QUANTILES: Final = {"p5": 0.05, "p50": 0.5, "p95": 0.95}


RISE_SPREAD: Final = "rise_spread_ms"
"""Metric of a finger: its longest rise time of a touch minus the shortest."""
TOLD_APART: Final = 2.3
"""Least difference in ms of transition times of friction that people tell apart; Gueorguiev et al.,
IEEE Trans. Haptics 12 (2019) 179."""


def column(rows: Rows, name: str) -> Rows:
    """Return a figure of all fingers; if its name begins with ``touch_``, of all touches, flat."""
    if name == RISE_SPREAD:
        return _spread(_of_touches(rows, "rise_time_ms"))
    if name.startswith("touch_"):
        return _of_touches(rows, name.removeprefix("touch_")).ravel()
    return rows[:, COLUMNS.index(name)]


def _of_touches(rows: Rows, name: str) -> Rows:
    """Return a figure of each touch, a row per finger."""
    return rows[:, len(CURVES) + TOUCH_FIGURES.index(name) : -1 : len(TOUCH_FIGURES)]


def _spread(values: Rows) -> Rows:
    """Return the largest minus the smallest of each row, infinite with an infinite value.

    It is NaN for fewer than two values.
    """
    known = ~np.isnan(values)
    most = np.max(values, axis=1, where=known, initial=-np.inf)
    least = np.min(values, axis=1, where=known, initial=np.inf)
    spread = np.full(len(values), np.inf)
    finite = np.isfinite(most)
    spread[finite] = most[finite] - least[finite]
    spread[known.sum(axis=1) <= 1] = np.nan
    return spread


def summary(campaign: Campaign, result: Result) -> dict[str, Any]:
    """Return the results of a campaign.

    Percentiles are values of a finger, or of a touch, without interpolation. A finger or touch
    without a step counts with an infinite rise time and an overshoot of 100 %. A percentile that is
    such a rise time is None. The edges of a finger are even if its touches, two or more, differ in
    rise time by `TOLD_APART` at most.
    """
    rows = result.rows
    names = (*CURVES, *(f"touch_{name}" for name in TOUCH_FIGURES), RISE_SPREAD)
    metrics = {name: _percentiles(column(rows, name)) for name in names}
    # Without the touches, which follow from the same curves.
    judged = np.delete(rows, np.s_[len(CURVES) : -1], axis=1)
    return {
        **parameters(campaign),
        "fingers": len(rows),
        "metrics": metrics,
        "limit_cycle_share": float(np.mean(column(rows, "chatter") > LIMIT_CYCLE)),
        "even_edges_share": float(np.mean(column(rows, RISE_SPREAD) <= TOLD_APART)),
        "without_rise": int(np.count_nonzero(np.isinf(column(rows, "rise_time_ms")))),
        "finger_seconds": float(rows[:, -1].sum()),
        "finger_seconds_per_second": result.ran_s / result.wall_s if result.ran_s else None,
        "compile_s": round(result.compile_s, 3),
        "compiled": result.compiled,
        "rows_sha256": sha256(judged.astype("<f8").tobytes()).hexdigest(),
    }


def _percentiles(values: Rows) -> dict[str, float | None]:
    """Return percentiles over the known values; None if there are none, or for infinite ones."""
    known = values[~np.isnan(values)]
    if not len(known):
        return dict.fromkeys(_QUANTILES)
    found = np.quantile(known, list(_QUANTILES.values()), method="inverted_cdf").tolist()
    return {
        name: value if np.isfinite(value) else None
        for name, value in zip(_QUANTILES, found, strict=True)
    }


def lines(campaigns: Sequence[dict[str, Any]]) -> list[str]:
    """Return summaries of the same fingers under several laws as lines, with one table."""
    several = len(campaigns) > 1
    names = "".join(f"{_laws(r):>{10 * len(_QUANTILES)}}" for r in campaigns)
    rows = [
        f"{name:<32}"
        + "".join(f"{_number(r['metrics'][name][q]):>10}" for r in campaigns for q in _QUANTILES)
        for name in campaigns[0]["metrics"]
    ]
    return [
        _head(campaigns[0], several),
        *([f"{'':<32}{names}"] if several else []),
        f"{'':<32}" + "".join(f"{q:>10}" for _ in campaigns for q in _QUANTILES),
        *rows,
        *(line for r in campaigns for line in _ends(r, f"{_laws(r)}: " if several else "")),
    ]


def _laws(r: dict[str, Any]) -> str:
    return f"{r['law']} + {r['vibration_law']}"


def _head(r: dict[str, Any], several: bool = False) -> str:
    laws = "" if several else f"law {r['law']}, vibration law {r['vibration_law']}, "
    plates = "" if r["plates"] == "model" else f", plates {r['plates']}"
    return (
        f"{r['fingers']} {'finger' if r['fingers'] == 1 else 'fingers'}, seed {r['seed']}, {laws}"
        f"dead time {r['dead_time_us']:.0f} us, case {r['case']}{plates}"
    )


def _ends(r: dict[str, Any], laws: str) -> list[str]:
    speed = r["finger_seconds_per_second"]
    pace = "nothing left to run" if speed is None else f"{speed:.0f} finger-seconds a second"
    return [
        f"{laws}in a limit cycle: {100 * r['limit_cycle_share']:.2f} %, without a rise: "
        f"{r['without_rise']}, edges within {TOLD_APART:g} ms: {100 * r['even_edges_share']:.1f} %",
        f"{laws}{r['finger_seconds']:.0f} finger-seconds, {pace}, "
        f"{r['compile_s']:.1f} s to compile",
    ]


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"


RESULTS, FINGERS, PICTURE = "campaign.json", "fingers.csv", "campaign.png"
FILES: Final = (RESULTS, FINGERS, PICTURE, "campaign.svg")
"""All files that `write_folder` writes."""


def write_folder(folder: Path, campaigns: Sequence[dict[str, Any]], rows: Sequence[Rows]) -> Path:
    """Write a folder, and return the path of the PNG; the same results make the same bytes.

    Parameters
    ----------
    folder
        Folder to write; created if it does not exist.
    campaigns
        Summaries of the same fingers under one or more laws.
    rows
        Rows of each campaign.

    Raises
    ------
    OSError
        If the folder cannot be written.
    """
    # matplotlib is an extra.
    from smarttac_can.bench.drawing import save  # noqa: PLC0415

    folder.mkdir(parents=True, exist_ok=True)
    text = json.dumps(as_json(campaigns), indent=2) + "\n"
    (folder / RESULTS).write_text(text, encoding="utf-8")
    with (folder / FINGERS).open("w", encoding="ascii", newline="") as file:
        file.write(",".join(("finger", *COLUMNS, "law", "vibration_law")) + "\n")
        for r, of_law in zip(campaigns, rows, strict=True):
            laws = (r["law"], r["vibration_law"])
            for number, row in enumerate(of_law):
                file.write(",".join((str(number), *map(repr, row.tolist()), *laws)) + "\n")
    picture = folder / PICTURE
    save(distributions(campaigns, rows), picture)
    return picture


def as_json(campaigns: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return the summary of one campaign, or several summaries under ``campaigns``, for JSON."""
    return campaigns[0] if len(campaigns) == 1 else {"campaigns": list(campaigns)}


_PANELS: Final = {
    "rise_time_ms": "rise time (ms)",
    "overshoot_percent": "overshoot (% of the step)",
    "static_error_percent": "static error (% of the reference)",
    "chatter": "chatter of the COF (standard deviation)",
}
_MORE: Final = ("#0072b2", "#e69f00", "#8f4f86")
"""Colours of the laws after the second one."""
_FEW_DECADES, _MANY_DECADES = 1.0, 2.5


def distributions(campaigns: Sequence[dict[str, Any]], rows: Sequence[Rows]) -> Figure:
    """Draw the fraction of fingers, and of single touches, below each value.

    Needs matplotlib (extra ``report``).

    Parameters
    ----------
    campaigns
        Summaries of the same fingers under one or more laws. For a single law the measured COF is
        drawn as well.
    rows
        Rows of each campaign.
    """
    from smarttac_can.bench.drawing import GREEN, RED, canvas  # noqa: PLC0415

    curves = []
    for colour, r, of_law in zip(cycle((RED, GREEN, *_MORE)), campaigns, rows, strict=False):
        law = "true COF" if len(rows) == 1 else _laws(r)
        curves += [
            ("", colour, "-", law, of_law),
            ("touch_", colour, ":", f"{law}, single touches", of_law),
        ]
    if len(rows) == 1:
        curves.append(("measured_", GREEN, "--", "measured COF", rows[0]))
    head = _head(campaigns[0], len(rows) > 1)
    with canvas(9.0, 7.0) as figure:
        figure.suptitle(f"Random fingers under control (simulated)\n{head}", fontsize=11)
        panels = figure.subplots(2, 2, sharey=True)
        for axes, (name, label) in zip(panels.flat, _PANELS.items(), strict=True):
            for prefix, colour, line, legend, of_law in curves:
                if prefix == "touch_" and name not in TOUCH_FIGURES:
                    continue
                found = column(of_law, prefix + name)
                found = found[~np.isnan(found)]
                known = np.sort(found[np.isfinite(found)])
                share = 100.0 * np.arange(len(known) + 1) / max(len(found), 1)
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
        columns = 3 if len(rows) == 1 else 2
        figure.legend(handles, labels, loc="outside lower center", ncols=columns)
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
    """Label a logarithmic axis with plain numbers, few enough not to overlap."""
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

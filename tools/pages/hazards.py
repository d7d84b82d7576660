"""The tables of hazards, from hazards.toml; their bounds are computed from the code."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from math import exp, pi, sqrt
from pathlib import Path
from typing import Any

from fmeda import Found, found, summed_up
from pages import EXPLANATION, Pages, renewed

from smarttac_can.assurance.trials.fault_cases import AT_ONCE, READ_BACK_BOUND
from smarttac_can.canopen.od.dictionary import ObjectDictionary
from smarttac_can.canopen.od.eds import load_eds
from smarttac_can.canopen.od.object_reference import table
from smarttac_can.host.files import read_eds
from smarttac_can.instrument.nodes import plate_node
from smarttac_can.instrument.nodes.hard_caps import AMPLITUDE_TRIP_MAX
from smarttac_can.instrument.nodes.loop_time import deadlines
from smarttac_can.instrument.nodes.stimulator_node import NOT_OPERATIONAL_US
from smarttac_can.science.control.step import FREQUENCY_STEP
from smarttac_can.science.plant.parameters import ResonatorParameters, SensorParameters
from smarttac_can.vocabulary import watchdogs
from smarttac_can.vocabulary.signals import DRIVE_RPDO, HARDWARE_RPDO, SHORT_DEADLINE_MS, TICK_US

HAZARDS = Path(__file__).resolve().parent / "hazards.toml"
MATRIX = HAZARDS.parents[2] / "docs" / "reference" / "faults.md"
CI = HAZARDS.parents[2] / ".ci" / "run"
_PLATE = ResonatorParameters()
_TRIP = "Limit.Amplitude trip"
_VOLTAGE = "Limit.Voltage"
_REACHED = "Reached [um]"
_IN_TEXT = ("A", "BY_DRIVE", "V", "K", "tau", "d", "f0", "DEADLINE", "SHORT_DEADLINE")
"""Other names in the text of the page."""
_JOULE_FROM_MJ = 100.0


def hazards_page() -> Pages:
    """Return the page with its fields made anew."""
    source = tomllib.loads(HAZARDS.read_text(encoding="utf-8"))
    stimulator, plate = (load_eds(read_eds(f"{name}.eds"), 1) for name in ("stimulator", "plate"))
    times = bounds(stimulator, plate)
    lines: list[str] = []
    for hazard in source["hazard"]:
        rows = _rows(hazard["cause"], times, stimulator)
        lines += [f"## {hazard['name']}", "", hazard["harm"], "", *rows]
    return renewed(
        EXPLANATION / "hazards.md",
        {
            **{name: str(times[name]) for name in _IN_TEXT},
            "hazards": lines,
            "common": _common(source["common"], times),
        },
    )


def bounds(stimulator: ObjectDictionary, plate: ObjectDictionary) -> dict[str, float]:
    """Return the names for head and rows: times in cycles or ms, which are the same, and others.

    Watchdogs stand for their bound, constants of the code for themselves.
    """
    deadline, silence = (entry.default for entry in deadlines(plate, (DRIVE_RPDO, HARDWARE_RPDO)))
    sensors = SensorParameters()
    swing = 2 * pi * sensors.path_frequency * sqrt(1 - sensors.path_damping**2)
    tolerance = _default(stimulator, "Model.Data sheet tolerance")
    constants = {name: value for name, value in vars(watchdogs).items() if name.isupper()}
    return {
        **{name: value for name, value in constants.items() if isinstance(value, int)},
        **{
            watchdog.name: row.bound
            for watchdog, row in watchdogs.WATCHDOGS.items()
            if isinstance(row.bound, int)
        },
        "AT_ONCE": AT_ONCE,
        "DEADLINE": deadline,
        "SHORT_DEADLINE": SHORT_DEADLINE_MS,
        "HARDWARE": silence,
        "READ_BACK": READ_BACK_BOUND,
        "LATE": deadline - SHORT_DEADLINE_MS,
        "SURPLUS_WINDOW": watchdogs.sync_window(deadline),
        "SYNC_DRIFT": watchdogs.sync_drift_tolerance(deadline),
        "NOT_OPERATIONAL": NOT_OPERATIONAL_US // TICK_US,
        "FORCE_PATH": round(1e3 * pi / swing),
        "WRONG_MAX": plate_node.WRONG_MAX,
        "FORGOTTEN": watchdogs.FORGOTTEN,
        "MISSED_PERCENT": stimulator["Limit.Missed ticks"].default,
        "BY_DRIVE": round(1e6 * _default(stimulator, "Limit.Amplitude by drive")),
        "HZ": round(FREQUENCY_STEP),
        "BARE": round(1e6 * AMPLITUDE_TRIP_MAX / (1.0 - tolerance), 2),
        "SHEET": stimulator["Model.Data sheet tolerance"].default,
        "A": round(1e6 * _default(stimulator, _TRIP), 2),
        "V": round(_default(stimulator, _VOLTAGE)),
        "K": round(1e9 * _PLATE.gain, 1),
        "tau": round(1e3 * _PLATE.tau, 3),
        "d": round(_PLATE.damping, 1),
        "f0": round(_PLATE.f0),
    }


def _rows(
    causes: list[dict[str, Any]], times: dict[str, float], od: ObjectDictionary
) -> Iterator[str]:
    return table(
        (
            "Cause", "Common cause", "Safety function", "Watchdogs", "Bound", "Reached",
            "Not covered", "Shown by",
        ),
        *(
            (
                cause["name"],
                cause.get("common", ""),
                cause["function"].format_map(times),
                ", ".join(cause["watchdogs"]),
                cause["bound"].format_map(times),
                "; ".join(_reached(cause, times, od)),
                cause["residual"].format_map(times | _tried(cause)),
                ", ".join(f"`{test.partition('::')[2]}`" for test in cause["tests"]),
            )
            for cause in causes
        ),
    )  # fmt: skip


def _reached(cause: dict[str, Any], times: dict[str, float], od: ObjectDictionary) -> Iterator[str]:
    """Say the largest vibration, for how long, and the energy that it loses in the plate."""
    until = cause["until"]
    if until == "no drive":
        yield "0 V"
        return
    milliseconds = sum(times[name] for name in until) if isinstance(until, list) else 0.0
    limited = cause.get("limited")
    if limited:
        amplitude = _default(od, limited)
    else:
        amplitude = grown(milliseconds * 1e-3, od) if milliseconds else settled(od)
    power = loss(amplitude)
    if until == "for ever":
        yield f"{amplitude * 1e6:.1f} um for as long as it lasts, {power:.1f} W"
    elif milliseconds:
        yield f"{amplitude * 1e6:.1f} um for {milliseconds:g} ms, {_energy(power * milliseconds)}"
    else:
        yield f"{amplitude * 1e6:.1f} um"
    if faults := cause.get("simulated"):
        yield f"{max(simulated(faults).values()):.2f} um in the matrix"
    if rows := cause.get("swept"):
        yield _swept(found(rows, summed_up()))


def _swept(figures: Found) -> str:
    above = f", {figures.above} ms of it above the bound" if figures.above else ""
    return f"{figures.peak_um:.2f} um{above} in the sweep"


def _tried(cause: dict[str, Any]) -> dict[str, str]:
    """Return the trials in place of a proof, and their findings."""
    made = summed_up()
    runs = made["healthy"]
    tried = {
        "HOSTILE": f"{_hostile_actions():,}".replace(",", " "),
        "HEALTHY": f"{runs['false'] or 'no'} false trips in {runs['runs']} runs without a failure",
    }
    if faults := cause.get("simulated"):
        runs = sum(modes for _, modes in simulated(faults))
        tried["MATRIX"] = f"none in {runs} runs of the matrix"
    if rows := cause.get("swept"):
        tried["SWEEP"] = f"{found(rows, made)} of the sweep"
    return tried


def _hostile_actions() -> int:
    """Return how many frames a hostile node sends in each run of continuous integration.

    Raises
    ------
    ValueError
        If none does.
    """
    said = re.search(r"attack --actions (\d+)", CI.read_text(encoding="utf-8"))
    if said is None:
        raise ValueError(f"{CI} runs no hostile node with --actions")
    return int(said.group(1))


def _common(causes: list[dict[str, Any]], times: dict[str, float]) -> Iterator[str]:
    return table(
        ("Source", "Feeds the loop", "Feeds its watch", "Independent source", "Found"),
        *(
            (
                cause["name"],
                cause["loop"],
                cause["watch"],
                cause["tie"].format_map(times),
                f"{figures} of the sweep; {_swept(figures)}",
            )
            for cause in causes
            for figures in [found(cause["swept"], summed_up())]
        ),
    )


def _energy(millijoules: float) -> str:
    if millijoules < _JOULE_FROM_MJ:
        return f"{millijoules:.2g} mJ"
    return f"{millijoules * 1e-3:.2g} J"


def settled(od: ObjectDictionary) -> float:
    """Return the vibration in m of the bare plate at the default limit of the voltage."""
    return _PLATE.gain * _default(od, _VOLTAGE)


def grown(seconds: float, od: ObjectDictionary) -> float:
    """Return the vibration in m that this voltage makes, in a time, of one at its limit."""
    end, before = settled(od), _default(od, _TRIP)
    return end - (end - before) * exp(-seconds / _PLATE.tau)


def loss(amplitude: float) -> float:
    """Return the power in W that the plate turns to heat by a vibration in m peak-to-peak."""
    velocity = pi * _PLATE.f0 * amplitude
    return 0.5 * _PLATE.damping * velocity * velocity


def simulated(faults: list[str]) -> dict[tuple[str, int], float]:
    """Return the vibration in um of each fault of the matrix that begins so, by name and runs.

    Raises
    ------
    ValueError
        If a fault has no row.
    """
    reached = {}
    columns: list[str] = []
    for line in MATRIX.read_text(encoding="utf-8").splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if not line.startswith("|"):
            columns = []
        elif _REACHED in cells:
            columns = cells
        elif columns and cells[0].startswith(tuple(faults)):
            row = dict(zip(columns, cells, strict=True))
            reached[row["Fault"], int(row["Modes"])] = float(row[_REACHED])
    names = " | ".join(name for name, _ in reached)
    if missing := [fault for fault in faults if fault not in names]:
        raise ValueError(f"{MATRIX.name} has no row {', '.join(missing)}")
    return reached


def _default(od: ObjectDictionary, name: str) -> float:
    entry = od[name]
    return float(entry.default * entry.si)

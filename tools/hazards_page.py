"""The page of hazards, from tools/hazards.toml."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from math import pi
from pathlib import Path
from typing import Any

from smarttac_can.od.object_reference import table
from smarttac_can.plant.parameters import ResonatorParameters

HAZARDS = Path(__file__).resolve().parent / "hazards.toml"


def hazards_page() -> str:
    """Return the page as Markdown."""
    source = tomllib.loads(HAZARDS.read_text(encoding="utf-8"))
    lines = [source["head"]]
    for hazard in source["hazard"]:
        lines += [f"## {hazard['name']}", "", hazard["what"], "", *_rows(hazard["cause"])]
    return "\n".join(lines).rstrip() + "\n"


def _rows(causes: list[dict[str, Any]]) -> Iterator[str]:
    return table(
        (
            "Cause", "Common cause", "Safety function", "Watchdogs", "Bound", "Reached",
            "What is left", "Shown by",
        ),
        *(
            (
                cause["what"],
                cause.get("common", ""),
                cause["function"],
                ", ".join(cause["watchdogs"]),
                cause["bound"],
                _reached(*cause["reached"]),
                cause["residual"],
                ", ".join(f"`{test.partition('::')[2]}`" for test in cause["tests"]),
            )
            for cause in causes
        ),
    )  # fmt: skip


def _reached(amplitude_um: float, milliseconds: float) -> str:
    """Say a vibration, for how long, and the energy that the plate turns to heat by it."""
    if not amplitude_um:
        return "0 V"
    mode = ResonatorParameters()
    velocity = pi * mode.f0 * amplitude_um * 1e-6
    energy = 0.5 * mode.damping * velocity * velocity * milliseconds
    if not milliseconds:
        return f"{amplitude_um:g} um"
    return f"{amplitude_um:g} um for {milliseconds:g} ms, {energy:.2g} mJ"

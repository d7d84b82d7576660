"""What the paper has no number for: overshoot of the amplitude, and a step under a finger."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from smarttac_can.paper.metrics import LOOPS

_NAMES = dict(zip(LOOPS, ("amplitude loop alone", "both loops"), strict=True))


def vibration_table(results: Mapping[str, Any]) -> str:
    """Show overshoot, and settling after a step if there was one, as plain text.

    Parameters
    ----------
    results
        As from `smarttac_can.paper.summary.summary`, with Fig. 5.
    """
    lines = []
    for loops, name in _NAMES.items():
        run = results["fig5"][loops]
        lines.append(f"0 to 1 um, {name}: overshoot {_percent(run)}")
        step = run["step"]
        if step["settling_time_ms"] is not None:
            settled = f"settles in {step['settling_time_ms']:.2f} ms, overshoot {_percent(step)}"
            lines.append(f"1 to 1.5 um, {name}: {settled}")
    return "\n".join(lines) + "\n"


def _percent(run: Mapping[str, Any]) -> str:
    overshoot = run["overshoot_percent"]
    return "-" if overshoot is None else f"{overshoot:.1f} %"

"""What the bus costs the loop: its dead time, and the results with it beside those without."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from smarttac_can.bench.simulation import PLATE_ID, plate_od, stimulator_od
from smarttac_can.nodes.stimulator_node import StimulatorNode
from smarttac_can.od.cia import SYNC_ID
from smarttac_can.od.timing import cycle_seconds, cyclic_frames
from smarttac_can.paper.report import compare
from smarttac_can.vocabulary.signals import TICK


def loop_dead_time(bit_rate: int) -> float:
    """Return the longest time in us from the plate's tick to the new drive, over the bus.

    Sum of the plate's measurement TPDOs and the drive, from the EDS files; the tick is the end of
    SYNC, and computing time is left out.

    Parameters
    ----------
    bit_rate
        In bit/s, above 0.
    """
    stimulator = StimulatorNode(stimulator_od(), plate_node_id=PLATE_ID)
    stimulator.start()
    frames = cyclic_frames([plate_od(), stimulator.od], TICK)
    loop = [frame for frame in frames if frame.period <= TICK and frame.can_id != SYNC_ID]
    return 1e6 * cycle_seconds(loop, bit_rate)


def dead_time_table(without: Mapping[str, Any], with_it: Mapping[str, Any]) -> str:
    """Lay the vibration results without and with dead time side by side, as plain text.

    Parameters
    ----------
    without, with_it
        Results as from `smarttac_can.paper.summary.summary`.
    """
    heads = [f"dead time {results['dead_time_us']:.0f} us" for results in (without, with_it)]
    lines = [f"{'':<40}" + "".join(f"{head:>20}" for head in heads) + f"{'paper':>10}"]
    others = {item.published.key: item for item in compare(with_it)}
    for one in compare(without):
        published = one.published
        other = others.get(published.key)
        if other is None or not published.key.startswith(("fig5", "fig6")):
            continue
        cells = "".join(
            f"{'-' if item.value is None else f'{item.value:.2f} {published.unit}':>20}"
            for item in (one, other)
        )
        lines.append(f"{published.name:<40}{cells}{published.value:>10g}")
    return "\n".join(lines) + "\n"

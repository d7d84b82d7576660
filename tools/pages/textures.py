"""Measure how textures are followed, and make the tables of docs/explanation/textures.md; minutes.

Example: tools/pages/make textures
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from itertools import product
from typing import NamedTuple

import numpy as np
from pages import EXPLANATION, Pages, made, renewed
from texture_playing import LEVELS, Stroke, play

from smarttac_can.bench import Texture, Tracking, track
from smarttac_can.bench.drawing import INK, RED, canvas
from smarttac_can.canopen.od.object_reference import table
from smarttac_can.vocabulary.states import VibrationLaw

PERIOD_MM = 2.0
SHAPES = ("sine", "square")
PREVIEWS_US = (0, 500, 1000, 1500, 2000, 2500, 3000)
DEAD_TIMES_US = (0, 540)
FORCES = (0.5, 1.0, 1.5)


def grating(subject: int, shape: str) -> Texture:
    """Return the grating of a subject."""
    low, high = LEVELS[subject]
    return Texture.grating(PERIOD_MM, low, high, shape=shape)


class Conditions(NamedTuple):
    """Conditions of a texture that is played."""

    preview_us: int = 1500
    dead_time_us: int = 0
    vibration_law: VibrationLaw = VibrationLaw.PI
    force: float = 1.0
    tares: int = 16
    seed: int = 1


DEFAULT = Conditions()


@cache
def stroke(subject: int, shape: str, conditions: Conditions) -> Stroke:
    """Return the played texture."""
    return play(grating(subject, shape), subject, **conditions._asdict())


@cache
def tracked(subject: int, shape: str, conditions: Conditions = DEFAULT) -> Tracking:
    """Return how the true COF follows."""
    played = stroke(subject, shape, conditions)
    return track(grating(subject, shape), played.position, played.cof)


def followed() -> Iterator[str]:
    """Return the table of subjects and shapes."""
    rows = []
    for shape in SHAPES:
        for subject, (low, high) in LEVELS.items():
            found = tracked(subject, shape)
            third = f"{found.harmonics[1].gain:.2f}" if shape == "square" else ""
            rows.append(
                (
                    f"{shape}, {low:g} to {high:g}",
                    f"{np.mean(found.correlations):.3f} ({min(found.correlations):.3f})",
                    f"{found.mean_correlation:.3f}",
                    f"{found.rms:.4f}",
                    f"{found.harmonics[0].gain:.2f}",
                    third,
                )
            )
    head = ("Grating", "One pass", "20 passes", "rms error", "Gain, 0.5/mm", "1.5/mm")
    return table(head, *rows)


def one_pass(subject: int, shape: str, conditions: Conditions) -> float:
    """Return the mean correlation of the passes."""
    return float(np.mean(tracked(subject, shape, conditions).correlations))


def laws() -> Iterator[str]:
    """Return the table of laws of the vibration and dead times."""
    rows = []
    for law, dead_time_us in product(VibrationLaw, DEAD_TIMES_US):
        conditions = Conditions(dead_time_us=dead_time_us, vibration_law=law)
        cells = []
        for shape in SHAPES:
            found = [tracked(subject, shape, conditions) for subject in LEVELS]
            cells.append(f"{min(min(one.correlations) for one in found):.3f}")
            cells.append(f"{min(one.mean_correlation for one in found):.3f}")
        rows.append((f"`{law.name.lower()}`", f"{dead_time_us} us", *cells))
    head = ("Law", "Dead time", "Sine, a pass", "20 passes", "Square, a pass", "20 passes")
    return table(head, *rows)


def forces() -> Iterator[str]:
    """Return the table of normal forces."""
    rows = [
        (shape, *(f"{one_pass(2, shape, Conditions(force=Fn)):.3f}" for Fn in FORCES))
        for shape in SHAPES
    ]
    return table(("Force in N", *(f"{Fn:g}" for Fn in FORCES)), *rows)


def previews() -> Iterator[str]:
    """Return the table of previews."""
    rows = [
        (shape, *(f"{one_pass(2, shape, Conditions(preview_us=us)):.3f}" for us in PREVIEWS_US))
        for shape in SHAPES
    ]
    return table(("Preview in ms", *(f"{us / 1000:g}" for us in PREVIEWS_US)), *rows)


def one_tare() -> Iterator[str]:
    """Return the table of single tares."""
    found = [tracked(2, "square", Conditions(tares=1, seed=seed)) for seed in range(1, 6)]
    return table(
        ("Seed", *(str(seed) for seed in range(1, 6))),
        ("One pass", *(f"{np.mean(one.correlations):.3f}" for one in found)),
        ("20 passes", *(f"{one.mean_correlation:.3f}" for one in found)),
    )


def picture() -> None:
    """Draw one pass of subject 2."""
    with canvas(7.2, 6.0) as figure:
        for axes, shape in zip(figure.subplots(2, 1, sharex=True), SHAPES, strict=True):
            played = stroke(2, shape, DEFAULT)
            places = np.linspace(-8.0, 8.0, 4001)
            axes.plot(places, grating(2, shape).cof(places), color=INK, lw=1.0, label="texture")
            one = slice(0, 600)
            axes.plot(played.position[one], played.cof[one], color=RED, lw=1.6, label="COF")
            axes.set(
                xlim=(-8, 8),
                ylim=(0.2, 0.45),
                title=f"One pass over a {shape}, 60 mm/s (simulated)",
            )
            axes.set_ylabel("COF")
        axes.set_xlabel("position on the plate (mm)")
        axes.legend(loc="lower left", ncols=2)
        figure.savefig(EXPLANATION / "figures" / "texture.png", dpi=150)


def pages(draw: bool) -> Pages:
    """Return the page, and draw its picture."""
    if draw:
        picture()
    fields = {
        "FOLLOWED": followed(),
        "LAWS": laws(),
        "FORCE": forces(),
        "PREVIEW": previews(),
        "TARE": one_tare(),
    }
    return renewed(EXPLANATION / "textures.md", fields)


def main() -> int:
    """Write the page, or compare it."""
    return made(__doc__, pages)

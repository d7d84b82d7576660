"""Measure how textures are followed, write docs/explanation/textures.md; by hand, minutes."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np

from smarttac_can.bench import Texture, Tracking, track
from smarttac_can.bench.drawing import INK, RED, canvas
from smarttac_can.od.object_reference import table
from smarttac_can.trials.texture_playing import LEVELS, Stroke, play

FOLDER = Path(__file__).resolve().parent.parent / "docs" / "explanation"
TEMPLATE = Path(__file__).with_suffix(".md")
PERIOD_MM = 2.0
SHAPES = ("sine", "square")
PREVIEWS_US = (0, 1000, 1500, 2000, 2500, 3000, 4000)


def grating(subject: int, shape: str) -> Texture:
    """Return the grating of a subject."""
    low, high = LEVELS[subject]
    return Texture.grating(PERIOD_MM, low, high, shape=shape)


@cache
def stroke(subject: int, shape: str, preview_us: int, tares: int, seed: int) -> Stroke:
    """Return what was played."""
    return play(grating(subject, shape), subject, preview_us=preview_us, tares=tares, seed=seed)


def tracked(
    subject: int, shape: str, preview_us: int = 2000, tares: int = 16, seed: int = 1
) -> Tracking:
    """Return how the true COF follows."""
    played = stroke(subject, shape, preview_us, tares, seed)
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
                    f"{shape}, subject {subject}, {low:g} to {high:g}",
                    f"{np.mean(found.correlations):.3f} ({min(found.correlations):.3f})",
                    f"{found.mean_correlation:.3f}",
                    f"{found.rms:.4f}",
                    f"{found.harmonics[0].gain:.2f}",
                    third,
                )
            )
    head = ("Grating", "One pass", "20 passes", "rms error", "Gain, 0.5/mm", "1.5/mm")
    return table(head, *rows)


def previews() -> Iterator[str]:
    """Return the table of previews."""
    rows = [
        (shape, *(f"{np.mean(tracked(2, shape, us).correlations):.3f}" for us in PREVIEWS_US))
        for shape in SHAPES
    ]
    return table(("Preview in ms", *(f"{us / 1000:g}" for us in PREVIEWS_US)), *rows)


def one_tare() -> Iterator[str]:
    """Return the table of single tares."""
    found = [tracked(2, "square", tares=1, seed=seed) for seed in range(1, 6)]
    return table(
        ("Seed", *(str(seed) for seed in range(1, 6))),
        ("One pass", *(f"{np.mean(one.correlations):.3f}" for one in found)),
        ("20 passes", *(f"{one.mean_correlation:.3f}" for one in found)),
    )


def picture() -> None:
    """Draw one pass of subject 2."""
    with canvas(7.2, 6.0) as figure:
        for axes, shape in zip(figure.subplots(2, 1, sharex=True), SHAPES, strict=True):
            played = stroke(2, shape, 2000, 16, 1)
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
        figure.savefig(FOLDER / "figures" / "texture.png", dpi=150)


def main() -> None:
    """Write the page and its picture."""
    squares = [tracked(subject, "square").mean_correlation for subject in LEVELS]
    text = TEMPLATE.read_text(encoding="utf-8")
    for mark, value in (
        ("{FOLLOWED}", "\n".join(followed()).strip()),
        ("{SQUARE}", f"{min(squares):.3f} to {max(squares):.3f}"),
        ("{PREVIEW}", "\n".join(previews()).strip()),
        ("{TARE}", "\n".join(one_tare()).strip()),
    ):
        text = text.replace(mark, value)
    (FOLDER / "textures.md").write_text(text, encoding="utf-8")
    picture()


if __name__ == "__main__":
    main()

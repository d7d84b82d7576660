"""Make files in the forms of three public data sets, and draw docs/images/lab-data.png of them.

The forms are those of the format pages that docs/how-to/lab-data.md names; the numbers are made up.

Example: tools/pages/make lab_data /tmp/sets --draw
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas
from PIL import Image

from smarttac_can.bench import Stimulator, Texture
from smarttac_can.bench.drawing import INK, RED, canvas

Samples = tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]
PICTURE = Path(__file__).resolve().parents[2] / "docs" / "images" / "lab-data.png"


def make_files(folder: Path) -> dict[str, Samples]:
    """Make the files in a folder; return the positions in mm and COF that they hold."""
    draw = np.random.default_rng(1)
    t, t_x = np.arange(0, 2, 1 / 6000), np.arange(0, 2, 0.01)
    vibration = np.sin(2 * np.pi * 40 * (t - 1) / 8) + draw.normal(0, 0.1, t.size)
    name = "0_90_40_500_0.csv"
    for kind in ("accel", "position"):
        (folder / kind).mkdir(parents=True, exist_ok=True)
    accel = pandas.DataFrame({"time": t, "X": vibration, "Y": 0, "Z": -1})
    accel.to_csv(folder / "accel" / name, index=False)
    track = pandas.DataFrame({"time": t_x, "X": 40 * (t_x - 1), "Y": 45})
    track.to_csv(folder / "position" / name, index=False)

    scale = np.linspace(-30, 30, 6000)
    worn = 32768 + 20000 * np.sin(2 * np.pi * scale / 6.7) + draw.normal(0, 1000, scale.size)
    Image.fromarray(np.tile(worn, (40, 1)).astype(np.uint16)).save(folder / "height.png")

    places = np.arange(0, 60, 0.0125)
    heights = 0.02 * np.sign(np.sin(2 * np.pi * places / 10)) + draw.normal(0, 0.002, places.size)
    profile = pandas.DataFrame({"X": places, "Y": 0, "Z": heights})
    profile.to_csv(folder / "profile.dat", sep="\t", index=False)
    return {
        "cluster": (40 * (t - 1), 0.35 + 0.03 * vibration / vibration.std()),
        "wear": (scale, 0.3 + 0.1 * worn / 65535),
        "rough": (places - places.mean(), 0.35 + 0.05 * heights / np.abs(heights).max()),
    }


def textures(folder: Path) -> dict[str, Texture]:
    """Return the textures of the files, as the page makes them."""
    accel = pandas.read_csv(folder / "accel" / "0_90_40_500_0.csv")
    track = pandas.read_csv(folder / "position" / "0_90_40_500_0.csv")
    profile = pandas.read_csv(folder / "profile.dat", sep="\t")
    times = (track.time, accel.time)
    height = 0.35 + 0.05 * profile.Z / profile.Z.abs().max()
    return {
        "cluster": Texture.over_position(
            track.X, 0.35 + 0.03 * accel.X / accel.X.std(), times=times
        ),
        "wear": Texture.from_picture(folder / "height.png", 20, 0.3, 0.4, 60),
        "rough": Texture.over_position(profile.X - profile.X.mean(), height),
    }


def played(texture: Texture) -> Samples:
    """Return position in mm and COF of one pass over a texture, without its turns."""
    with Stimulator.simulate("local", subject=2) as bench:
        bench.finger.stroke(2, force=1.0, speed=60, travel=30)
        bench.start_run()
        bench.amplitude, bench.texture, bench.mode = 1.0, texture, "texture"
        trace = bench.run(0.9)
    slides = (np.abs(trace.position_mm) < 13) & (trace.normal_force_n > 0.5)
    return trace.position_mm[slides], trace.cof[slides]


def picture(originals: dict[str, Samples], tables: dict[str, Texture]) -> None:
    """Draw the samples of the files, the tables and the played texture."""
    places = np.linspace(-14, 14, 4001)
    with canvas(7.2, 6.0) as figure:
        for axes, (name, table) in zip(
            figure.subplots(3, sharex=True), tables.items(), strict=True
        ):
            axes.plot(*originals[name], ".", color="0.75", markersize=1)
            axes.plot(places, table.cof(places), color=INK, lw=0.8)
            axes.plot(*played(table), color=RED, lw=1.2)
            axes.set(title=name, ylabel="COF", xlim=(-14, 14), ylim=(0.25, 0.45))
        axes.set_xlabel("position on the plate (mm)")
        figure.savefig(PICTURE, dpi=110)


def main() -> None:
    """Make the files, and the picture if asked for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--draw", action="store_true", help=f"renew {PICTURE.name}")
    arguments = parser.parse_args()
    originals = make_files(arguments.folder)
    if arguments.draw:
        picture(originals, textures(arguments.folder))

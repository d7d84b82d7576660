"""Settings that are global in a Python process change no result of a bench, and lose no file.

This file is also the program that the test starts: it runs a whole bench script under settings by
name, in a fork for each, and prints the digests of all results.
"""

import csv
import decimal
import gc
import hashlib
import json
import locale
import logging
import os
import random
import socket
import subprocess
import sys
import threading
import time
import traceback
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="it forks, and makes a locale")

COMMA = """LC_NUMERIC
decimal_point "<U002C>"
thousands_sep "<U002E>"
grouping 3;3
END LC_NUMERIC
"""
"""Source of a locale with a decimal comma, as glibc reads it."""
FIRST, MIDST = "first", "in the midst"
GUARD_S = 240


# -- Settings ----------------------------------------------------------------------------------


def few_digits() -> None:
    for context in (decimal.getcontext(), decimal.DefaultContext):
        context.prec, context.rounding, context.capitals = 2, decimal.ROUND_UP, 0
        context.Emax, context.Emin = 2, -2


def decimal_traps() -> None:
    for signal in (decimal.Inexact, decimal.Rounded, decimal.FloatOperation, decimal.Subnormal):
        decimal.getcontext().traps[signal] = True


def numpy_raises() -> None:
    np.seterr(all="raise")
    np.setbufsize(16)
    np.random.seed(0)
    random.seed(0)
    np.set_printoptions(precision=1, threshold=2, sign="+", floatmode="fixed")


def figures() -> None:
    import matplotlib as mpl  # noqa: PLC0415

    mpl.use("svg")
    mpl.rcParams.update(
        {
            "axes.formatter.use_locale": True,
            "figure.dpi": 50,
            "font.size": 30,
            "lines.linewidth": 5,
            "path.sketch": (1, 100, 2),
            "savefig.bbox": "tight",
            "savefig.dpi": 30,
            "savefig.transparent": True,
            "svg.fonttype": "none",
            "text.usetex": True,
            "xtick.direction": "in",
        }
    )


def files() -> None:
    import can  # noqa: PLC0415
    import h5py  # noqa: PLC0415
    import pandas  # noqa: PLC0415
    import PIL.Image  # noqa: PLC0415

    h5py.get_config().track_order = True
    h5py.get_config().bool_names = ("N", "Y")
    PIL.Image.MAX_IMAGE_PIXELS = 400  # below the pixels of a picture, from where it warns
    pandas.set_option("display.precision", 1)
    pandas.set_option("mode.string_storage", "python")
    csv.field_size_limit(2)
    csv.register_dialect("excel", delimiter=";", quoting=csv.QUOTE_NONE)
    can.rc.update({"interface": "nonsense", "channel": "x", "fd": True})
    os.environ.update({"CAN_CONFIG": "{", "CAN_INTERFACE": "nonsense", "TMPDIR": "/nowhere"})
    os.umask(0o077)


def output() -> None:
    for name in ("stdin", "stdout", "stderr"):
        setattr(sys, name, None)
    logging.disable(logging.CRITICAL)
    sys.tracebacklimit = 0


def runtime() -> None:
    gc.disable()
    sys.setswitchinterval(1e-5)
    sys.setrecursionlimit(250)
    sys.set_int_max_str_digits(640)
    threading.stack_size(1 << 16)
    socket.setdefaulttimeout(1e-6)
    os.environ["TZ"] = "Pacific/Kiritimati"
    time.tzset()


SETTINGS: dict[str, Callable[[], object]] = {
    "few digits of decimal": few_digits,
    "traps of decimal": decimal_traps,
    "locale": lambda: locale.setlocale(locale.LC_NUMERIC, "comma.UTF-8"),
    "numpy": numpy_raises,
    "warnings are errors": lambda: warnings.simplefilter("error"),
    "matplotlib": figures,
    "files": files,
    "output": output,
    "runtime": runtime,
    "another folder": lambda: os.chdir("/"),
}


# -- The program -------------------------------------------------------------------------------


def bench_script(folder: Path, change: Callable[[], object]) -> dict[str, bytes]:
    """Run, record, trace, play textures and draw; the settings change in the midst of it."""
    import h5py  # noqa: PLC0415

    from smarttac_can.bench import (  # noqa: PLC0415
        BenchError,
        Stimulator,
        Texture,
        read_csv,
        read_recording,
        write_csv,
    )

    kept: dict[str, bytes] = {}

    def textures() -> Iterator[Texture]:
        yield Texture.from_csv(folder / "forces.csv", position="x", lateral="Fx", normal="Fz")
        yield Texture.from_csv(folder / "cof.csv", position="x", cof="mu", comment="!")
        for end in ("png", "jpg", "tif"):
            yield Texture.from_picture(folder / f"row.{end}", row=1, low=0.3, high=0.4)

    def texts(bench: Stimulator) -> Iterator[object]:
        yield from map(bench.get, ("Limit.Voltage", "Setpoint.COF left", "Model.Load"))
        yield bench.nearest("Limit.Voltage", "80.0005 V")
        for value in (250.5, "1 um"):
            try:
                bench.voltage = value
            except (BenchError, ValueError) as error:
                yield error

    os.chdir(folder)
    with Stimulator.simulate(seed=3, presets={"Setpoint.Amplitude": "0.8 um"}) as bench:
        bench.finger.stroke(2)
        bench.start_run()
        bench.tare()
        bench.texture = next(textures())
        metadata: dict[str, str | float] = {"Prüfling": "Glas", "humidity": 45.5}
        with (
            bench.events() as events,
            bench.record("run.h5", raw="run.asc", metadata=metadata) as recording,
        ):
            bench.mode = "texture"
            bench.mark("Anfang")
            one = bench.run(0.15)
            change()
            bench.set_all({"Setpoint.COF left": "35 %", "Setpoint.COF right": 0.36})
            bench.mode = "friction"
            two = bench.run(0.05, experiment="two", metadata=metadata)
            kept["events"] = repr([event.text for event in events.within(0)]).encode()
        kept["texts"] = "\n".join(map(str, texts(bench))).encode()
    for number, texture in enumerate(textures()):
        kept[f"texture {number}"] = f"{texture} {texture.table}".encode()
    write_csv(folder / "run.csv", [one, two])
    kept["CSV"] = (folder / "run.csv").read_bytes()
    again = read_csv(folder / "run.csv")
    kept["CSV read"] = b"".join(trace.counts.tobytes() for trace in again)
    kept["table"] = one.to_dataframe().to_numpy().tobytes()
    recorded = read_recording(folder / "run.h5")
    kept["recording"] = repr(
        (
            recording.summary,
            {name: values.tobytes() for name, values in recorded.channels.items()},
            recorded.settings,
            recorded.metadata,
            [marker[1:] for marker in recorded.markers],
            [point[1:] for point in recorded.set_points],
            [texture.texture for texture in recorded.textures],
        )
    ).encode()
    with h5py.File(folder / "run.h5") as file:
        kept["HDF5"] = repr([*file, *file["channels"], file.attrs["clocked"].dtype]).encode()
    frames = (folder / "run.asc").read_text("utf-8").splitlines()
    kept["raw frames"] = repr([line.split()[2:] for line in frames[4:-1]]).encode()
    kept["plot"] = one.plot()._repr_png_()  # type: ignore[attr-defined]
    texture.save_figure(folder / "texture.svg")
    kept["figure"] = (folder / "texture.svg").read_bytes()
    kept["files"] = repr(sorted(path.name for path in folder.iterdir())).encode()
    return kept


def prepare(folder: Path) -> None:
    """Write the files of a lab into a folder."""
    from PIL import Image  # noqa: PLC0415

    folder.mkdir()
    grey = np.arange(256, dtype=np.uint8)[None].repeat(3, 0)
    for end in ("png", "jpg"):
        Image.fromarray(grey).save(folder / f"row.{end}")
    Image.fromarray(grey.astype(np.uint16) * 257).save(folder / "row.tif")
    x = np.linspace(-30, 30, 601)
    rows = zip(x * 1e-3, 0.35 + 0.05 * np.sin(x), strict=True)
    (folder / "forces.csv").write_text(
        "x [m];Fx;Fz;note\n"
        + "".join(f'{a:.6f};{b:.5f};1,0;"a; b"\n'.replace(".", ",") for a, b in rows)
    )
    np.savetxt(folder / "cof.csv", np.c_[x, 0.3 + 0.01 * np.cos(x)], delimiter=",", header="x,mu")


def digests(folder: Path, names: list[str], begin: bool) -> dict[str, str]:
    """Run the script in a fork, under settings from the beginning or from its midst on."""

    def change() -> None:
        for name in names:
            SETTINGS[name]()

    prepare(folder)
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            if begin:
                change()
            kept = bench_script(folder, (lambda: None) if begin else change)
            found = {name: hashlib.sha256(data).hexdigest() for name, data in kept.items()}
        except BaseException:  # noqa: BLE001 - whatever it is, the other process tells it
            found = {"error": traceback.format_exc()}
        os.write(writing, json.dumps(found).encode())
        os._exit(0)
    os.close(writing)
    with os.fdopen(reading, "rb") as answer:
        text = answer.read()
    os.waitpid(child, 0)
    result: dict[str, str] = json.loads(text or '{"error": "it crashed"}')
    return result


def main(folder: str, *groups: str) -> None:
    """Print the digests without settings, and under each group: when, and names of settings."""
    import can  # noqa: F401, PLC0415
    import h5py  # noqa: F401, PLC0415
    import matplotlib.figure  # noqa: F401, PLC0415
    import pandas  # noqa: F401, PLC0415

    found = {"none": digests(Path(folder) / "none", [], True)}
    for group in groups:
        when, *names = group.split(",")
        found[group] = digests(Path(folder) / group, names, when == FIRST)
    sys.stdout.write(json.dumps(found))


if __name__ == "__main__":
    main(*sys.argv[1:])


# -- The tests ---------------------------------------------------------------------------------


def under(
    folder: Path, groups: list[list[str]], *options: str, **environment: str
) -> dict[str, dict[str, str]]:
    """Return the digests without and under groups of settings, in a process with options."""
    folder.mkdir()
    source = folder / "comma"
    source.write_text(COMMA)
    # It warns, and fails by its return code, as the other categories are missing.
    subprocess.run(
        ["localedef", "-c", "--no-archive", "-i", source, "-f", "UTF-8", folder / "comma.UTF-8"],
        capture_output=True,
        check=False,
    )
    ended = subprocess.run(
        [sys.executable, *options, __file__, folder, *map(",".join, groups)],
        env={**os.environ, "LOCPATH": str(folder), **environment},
        capture_output=True,
        text=True,
        timeout=GUARD_S,
        check=False,
    )
    assert ended.returncode == 0, ended.stderr
    found: dict[str, dict[str, str]] = json.loads(ended.stdout)
    return found


def require_alike(found: dict[str, dict[str, str]]) -> None:
    """Compare all results with those of the process without settings."""
    plain = found["none"]
    assert "error" not in plain, plain["error"]
    for when, results in found.items():
        assert "error" not in results, f"{when}: {results['error']}"
        assert [name for name in plain if results[name] != plain[name]] == [], when


def test_settings_changed_between_two_calls_change_no_result(tmp_path: Path) -> None:
    require_alike(under(tmp_path / "settings", [[MIDST, *SETTINGS]]))


@pytest.mark.long
def test_settings_from_the_beginning_change_no_result(tmp_path: Path) -> None:
    found = under(tmp_path / "settings", [[FIRST, *SETTINGS]])
    started = under(
        tmp_path / "start", [], "-O", "-bb", "-W", "error", PYTHONHASHSEED="7", PYTHONUTF8="0",
        PYTHONCOERCECLOCALE="0", LC_ALL="C", OPENBLAS_NUM_THREADS="1",
    )  # fmt: skip
    require_alike(found | {"other start": started["none"]})


@pytest.mark.long
@pytest.mark.parametrize("name", SETTINGS)
def test_each_setting_alone_changes_no_result(name: str, tmp_path: Path) -> None:
    require_alike(under(tmp_path / "settings", [[FIRST, name], [MIDST, name]]))

"""What a script names and is not there is said in one line, not in Python's own words."""

from collections.abc import Callable
from pathlib import Path

import pytest

from smarttac_can.bench import (
    Stimulator,
    Texture,
    Trace,
    make_recording,
    read_csv,
    read_plan,
    sha256,
    write_csv,
)


@pytest.fixture(scope="module")
def trace() -> Trace:
    with Stimulator.simulate("local") as bench:
        return bench.run(0.01)


@pytest.mark.parametrize(
    "read",
    [
        read_csv,
        sha256,
        read_plan,
        lambda path: Texture.from_png(path, 0, 0.2, 0.3),
        lambda path: Texture.from_csv(path, time="t", cof="mu"),
        lambda path: make_recording(path, path.with_name("run.h5")),
    ],
)
def test_a_file_that_is_not_there(read: Callable[[Path], object], tmp_path: Path) -> None:
    for path, why in (
        (tmp_path / "none", "there is no such file"),
        (tmp_path / "no" / "none", f"the folder {tmp_path / 'no'} does not exist"),
    ):
        with pytest.raises(FileNotFoundError) as told:
            read(path)
        assert str(told.value) == f"{path}: {why}"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "write",
    [
        lambda path, trace: trace.to_csv(path),
        lambda path, trace: write_csv(path, [trace]),
        lambda path, _: Texture.grating(2.0, 0.2, 0.3).save_figure(path.with_suffix(".png")),
    ],
)
def test_a_folder_that_is_not_there(
    write: Callable[[Path, Trace], object], trace: Trace, tmp_path: Path
) -> None:
    path = tmp_path / "no" / "x.csv"
    with pytest.raises(FileNotFoundError, match=r"[\\/]x\.(csv|png): the folder .*no does not ex"):
        write(path, trace)

"""A trace as a table: units in names, nothing where there is nothing, what holds for all."""

import csv
import importlib
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from smarttac_can.bench import BenchError, Stimulator, Trace, read_csv, write_csv

NAMES = [
    *("time_s", "cof", "cof_reference", "amplitude_um", "voltage_v", "frequency_hz"),
    *("tangential_force_n", "normal_force_n", "position_mm", "statusword"),
]


@pytest.fixture(scope="module")
def trace() -> Iterator[Trace]:
    with Stimulator.simulate("local") as bench:
        bench.finger.stroke(2)
        bench.start_run()
        bench.tare()
        bench.amplitude = 1.0
        bench.mode = "friction"
        yield bench.run(0.5, "rough.b", 2)


def test_a_data_frame(trace: Trace) -> None:
    frame = trace.to_dataframe()
    assert list(frame.columns) == NAMES
    assert frame["cof"].isna().sum() == (trace.mu == 0).sum() > 0
    for name in NAMES[:-1]:
        np.testing.assert_allclose(frame[name], getattr(trace, name), err_msg=name)
    assert frame["statusword"].tolist() == trace.status.tolist()  # type: ignore[union-attr]
    assert frame.attrs["experiment"] == "rough.b"
    assert frame.attrs["rows"] == 500


def test_csv_is_the_data_frame(trace: Trace, tmp_path: Path) -> None:
    trace.to_csv(tmp_path / "t.csv")
    read = pd.read_csv(tmp_path / "t.csv", comment="#")
    pd.testing.assert_frame_equal(read, trace.to_dataframe())


def test_csv_for_who_has_no_pandas(trace: Trace, tmp_path: Path) -> None:
    trace.to_csv(tmp_path / "t.csv")
    lines = (tmp_path / "t.csv").read_text(encoding="ascii").splitlines()
    said = dict(line[2:].split(": ") for line in lines if line.startswith("# "))
    assert said["experiment"] == "rough.b"
    assert (said["subject"], said["rows"], said["lost_ticks"]) == ("2", "500", "0")
    rows = list(csv.DictReader(line for line in lines if not line.startswith("#")))
    assert [row["cof"] == "" for row in rows] == (trace.mu == 0).tolist()
    assert rows[-1]["cof"] == f"{trace.mu[-1] / 1e4:.4f}"


def test_a_trace_that_was_read_has_no_position(trace: Trace, tmp_path: Path) -> None:
    write_csv(tmp_path / "t.csv", [trace])
    (read,) = read_csv(tmp_path / "t.csv")
    assert (read.position, read.status, read.position_mm) == (None, None, None)
    assert list(read.to_dataframe().columns) == NAMES[:-2]


def test_pandas_is_imported_on_call(trace: Trace, monkeypatch: pytest.MonkeyPatch) -> None:
    tidy = importlib.import_module("smarttac_can.bench.tidy")
    assert not hasattr(tidy, "pandas")
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(BenchError, match="a data frame needs pandas: pip install pandas"):
        trace.to_dataframe()

"""A trace as a table: units in names, nothing where there is nothing, what holds for all."""

import csv
import importlib
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from smarttac_can.bench import BenchError, Stimulator, Trace

NAMES = [
    *("time_s", "cof", "cof_reference", "amplitude_um", "voltage_v", "frequency_hz"),
    *("tangential_force_n", "normal_force_n", "position_mm", "status"),
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
    assert frame["cof"].isna().sum() == np.isnan(trace.cof).sum() > 0
    for name in NAMES:
        np.testing.assert_allclose(frame[name], getattr(trace, name), err_msg=name)
    assert frame.attrs["units"]["amplitude_um"] == "um"
    frame.loc[0, "cof"] = 0.5  # it is a copy: arrays of a trace are read-only
    assert frame.attrs["experiment"] == "rough.b"
    assert frame.attrs["rows"] == 500


def test_csv_is_the_data_frame(trace: Trace, tmp_path: Path) -> None:
    trace.to_csv(tmp_path / "t.csv")
    read = pd.read_csv(tmp_path / "t.csv", comment="#")
    pd.testing.assert_frame_equal(read[NAMES], trace.to_dataframe())
    assert set(read["experiment"]) == {"rough.b"}
    assert set(read["subject"]) == {2}


def test_csv_for_who_has_no_pandas(trace: Trace, tmp_path: Path) -> None:
    trace.to_csv(tmp_path / "t.csv")
    first, *lines = (tmp_path / "t.csv").read_text(encoding="ascii").splitlines()
    assert first == "# format: SMARTTAC traces 2"
    rows = list(csv.DictReader(lines))
    assert [row["cof"] == "" for row in rows] == np.isnan(trace.cof).tolist()
    assert rows[-1]["cof"] == f"{trace.cof[-1]:.4f}"


def test_pandas_is_imported_on_call(trace: Trace, monkeypatch: pytest.MonkeyPatch) -> None:
    assert not hasattr(importlib.import_module("smarttac_can.bench.traces"), "pandas")
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(BenchError, match="a data frame needs pandas: pip install pandas"):
        trace.to_dataframe()

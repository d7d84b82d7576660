"""A trace for a person: tables with units in their names, and pictures in a notebook."""

import importlib
import pickle
import re
import sys
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure

from smarttac_can.bench import BenchError, Stimulator, Trace, read_csv, write_csv

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


OWN = {"humidity_percent": 45, "room": 21.5, "sample": "PMMA, \N{GREEK SMALL LETTER MU}"}


def test_own_metadata_of_traces_is_read_back_from_a_csv(trace: Trace, tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    rows = trace.counts.tolist()
    described = [Trace.from_rows("a", n, rows, {**OWN, "sample": str(n)}) for n in range(3)]
    write_csv(path, [*described, trace])
    read = read_csv(path)
    assert [one.metadata for one in read] == [one.metadata for one in (*described, trace)]
    assert [one.subject for one in read] == [0, 1, 2, 2]
    np.testing.assert_array_equal(read[1].counts, trace.counts)
    assert pickle.loads(pickle.dumps(read[1])).metadata == read[1].metadata
    assert read[2].to_dataframe().attrs["metadata"] == {**OWN, "sample": "2"}
    write_csv(path, trace)
    assert b"metadata" not in path.read_bytes(), "without metadata the file is as before"


@pytest.mark.parametrize(
    ("line", "refusal"),
    [
        ('# metadata: ["a", 0, {"x": 1', "run.csv: line 2: the metadata are damaged"),
        ('# metadata: ["a", 0, ["x"]]', "run.csv: line 2: the metadata are damaged"),
        ('# metadata: ["a", 0, {"x": null}]', "run.csv: line 2: x None is not a finite number"),
        ('# metadata: ["a", 0, {}]\nfoo', "run.csv: line 3 is not experiment,subject,time_s"),
    ],
)
def test_damaged_metadata_of_a_csv_are_refused(line: str, refusal: str, tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text(f"# format: SMARTTAC traces 2\n{line}\n", encoding="ascii")
    with pytest.raises(ValueError, match=re.escape(refusal)):
        read_csv(path)


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


def test_pandas_is_imported_on_call(trace: Trace, monkeypatch: pytest.MonkeyPatch) -> None:
    assert not hasattr(importlib.import_module("smarttac_can.bench.traces"), "pandas")
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(BenchError, match="a data frame needs pandas: pip install pandas"):
        trace.to_dataframe()


PANELS = [
    "COF",
    "force (N)",
    "amplitude (\N{MICRO SIGN}m)",
    "voltage (V)",
    "frequency (Hz)",
    "position (mm)",
]


def without(trace: Trace, first: int, last: int) -> Trace:
    rows = np.r_[0:first, last : len(trace)]
    return Trace(trace.experiment, trace.subject, trace.counts[rows])


def test_a_picture(trace: Trace, tmp_path: Path) -> None:
    figure = trace.plot()
    assert [axes.get_ylabel() for axes in figure.axes] == PANELS
    cof = figure.axes[0]
    measured, reference = cof.lines
    share = f"{trace.limited / len(trace):.1%}"
    assert cof.get_title(loc="left") == f"rough.b, subject 2, {share} limited"
    np.testing.assert_array_equal(measured.get_xdata(), trace.time_s)
    np.testing.assert_array_equal(measured.get_ydata(), trace.cof)
    np.testing.assert_array_equal(reference.get_ydata(), trace.cof_reference)
    assert [text.get_text() for text in cof.get_legend().get_texts()] == ["measured", "reference"]
    assert figure.axes[-1].get_xlabel() == "time (s)"
    figure.savefig(tmp_path / "t.svg")
    assert (tmp_path / "t.svg").stat().st_size > 20_000
    notebook: Any = figure
    assert notebook._repr_png_().startswith(b"\x89PNG"), "it needs no pyplot"


def test_it_is_drawn_into_a_figure_that_is_given(trace: Trace) -> None:
    figure = Figure(layout="constrained")
    left, right = figure.subfigures(1, 2)
    assert trace.plot(left) is left
    assert without(trace, 1, 2).plot(right) is right
    assert [len(left.axes), len(right.axes)] == [6, 6]


@pytest.mark.parametrize("given", ["run.png", 3, []])
def test_plot_refuses_figures_of_another_type(trace: Trace, given: Any) -> None:
    with pytest.raises(ValueError, match=r" is no figure of matplotlib$"):
        trace.plot(given)


def test_a_line_ends_where_ticks_are_missing(trace: Trace) -> None:
    figure = without(trace, 300, 310).plot()
    assert figure.axes[0].get_title(loc="left").startswith("rough.b, subject 2, 10 ticks lost, ")
    (voltage,) = figure.axes[3].lines
    x, y = (np.asarray(data) for data in voltage.get_data())
    assert np.flatnonzero(np.isnan(y)).tolist() == np.flatnonzero(np.isnan(x)).tolist() == [300]
    assert (len(y), y[299], y[301]) == (491, trace.voltage_v[299], trace.voltage_v[310])


def test_plot_omits_panels_without_values() -> None:
    """Without contact, as also a file of format 1 without position."""
    figure = Trace.from_rows("bare", 0, [(k, 0, 0, 1, 1, 1, 1, 1) for k in range(5)]).plot()
    assert [axes.get_ylabel() for axes in figure.axes] == PANELS[1:-1]
    assert len(Trace.from_rows("one", 0, [(0,) * 10]).plot().axes) == 4


def test_a_long_trace_keeps_its_peaks(trace: Trace) -> None:
    counts = np.tile(trace.counts, (200, 1))
    counts[:, 0] = np.arange(len(counts)) + 1000 * (np.arange(len(counts)) >= 50_000)
    counts[70_001, 4] = 19_000
    (voltage,) = Trace("long", 1, counts).plot().axes[3].lines
    x, y = (np.asarray(data) for data in voltage.get_data())
    assert len(y) == 4001
    assert np.nanmax(y) == 190.0
    assert x[np.nanargmax(y)] == pytest.approx(71.0, abs=0.06)
    assert np.isnan(x).sum() == 1
    gap = int(np.flatnonzero(np.isnan(x))[0])
    assert (x[gap - 1], x[gap + 1]) == (pytest.approx(49.95), 51.0)


def test_pictures_without_matplotlib(trace: Trace, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("smarttac_can.bench.traces.find_spec", lambda name: None)
    with pytest.raises(
        BenchError, match=r"^the pictures need matplotlib: pip install 'smarttac-can\[report\]'$"
    ):
        trace.plot()
    assert "rough.b" in trace._repr_html_()


def test_a_table_in_a_notebook(trace: Trace) -> None:
    page = ET.fromstring(f"<div>{trace._repr_html_()}</div>")
    assert page.findtext(".//caption") == repr(trace)[1:-1]
    rows = [[cell.text for cell in row] for row in page.iter("tr")]
    assert rows[0][1:] == ["unit", "least", "median", "greatest", "rows without"]
    by_name = {row[0]: row[1:] for row in rows[1:]}
    touched = trace.cof[~np.isnan(trace.cof)]
    assert by_name["cof"] == [
        *("1", f"{touched.min():.4f}", f"{np.median(touched):.4f}", f"{touched.max():.4f}"),
        str(len(trace) - len(touched)),
    ]
    assert by_name["frequency_hz"][0] == "Hz"
    assert list(by_name)[-1] == "position_mm"
    assert f"LIVE in {len(trace)} rows" in (page.findtext("p") or "")


def test_a_table_of_nothing() -> None:
    page = Trace.from_rows("bare", 0, [(0,) * 8])._repr_html_()
    assert "<td>cof</td><td>1</td><td>-</td><td>-</td><td>-</td><td>1</td>" in page
    assert "status: no bit set" in page

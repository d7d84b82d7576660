import hashlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from synthetic_traces import all_experiments, trace

from smarttac_can.bench.traces import COLUMNS, Trace, read_csv, sha256, write_csv

integers = st.integers(-(2**31), 2**31 - 1)
rows = st.lists(st.tuples(*[integers] * 7), min_size=1, max_size=20).map(
    lambda values: [(3 * k, *value) for k, value in enumerate(values)]
)


def same(one, other):
    return (one.experiment, one.subject) == (other.experiment, other.subject) and all(
        np.array_equal(getattr(one, c.name), getattr(other, c.name)) for c in COLUMNS
    )


def written(path, *traces):
    write_csv(path, traces)
    return path.read_bytes().decode("ascii")


@settings(max_examples=60)
@given(first=rows, second=rows)
def test_any_integers_come_back_exactly(tmp_path_factory, first, second):
    path = tmp_path_factory.mktemp("traces") / "traces.csv"
    traces = [Trace.from_rows("a.b", 0, first), Trace.from_rows("a.b", 1, second)]
    write_csv(path, traces)
    assert [same(*pair) for pair in zip(read_csv(path), traces, strict=True)] == [True, True]


def test_the_file_holds_decimals_of_the_documented_units(tmp_path):
    row = (7, 3012, 3000, 10_004, 2_150, 4_339_012, -51, 500)
    text = written(tmp_path / "t.csv", Trace.from_rows("table1", 2, [row]))
    assert text == (
        "experiment,subject,tick,mu,mu_ref,W,V,f,Ft,Fn\n"
        "table1,2,7,0.3012,0.3000,1.0004,21.50,43390.12,-0.051,0.500\n"
    )


def test_a_path_may_be_a_string(tmp_path):
    path = tmp_path / "t.csv"
    one = Trace.from_rows("run", 0, [(0,) * 8])
    write_csv(str(path), [one])
    assert same(read_csv(str(path))[0], one)
    assert sha256(str(path)) == sha256(path)


def test_one_changed_bit_changes_the_hash(tmp_path):
    runs = all_experiments()
    write_csv(tmp_path / "a.csv", runs)
    write_csv(tmp_path / "b.csv", runs)
    mu = runs[-1].mu.copy()
    mu[100] += 1
    columns = {c.name: getattr(runs[-1], c.name) for c in COLUMNS} | {"mu": mu}
    write_csv(tmp_path / "c.csv", [*runs[:-1], Trace("table1", 4, **columns)])
    a, b, c = (sha256(tmp_path / f"{name}.csv") for name in "abc")
    assert a == b == hashlib.sha256((tmp_path / "a.csv").read_bytes()).hexdigest()
    assert a != c


def test_scales():
    one = trace("x", 0, mu=[0, 3012], mu_ref=[0, 3000], W=[10_004, 0], V=[2_150, 0])
    assert np.isnan(one.cof[0])
    assert one.cof[1] == pytest.approx(0.3012)
    assert np.isnan(one.cof_reference[0])
    assert one.cof_reference[1] == pytest.approx(0.3)
    assert one.amplitude_um[0] == pytest.approx(1.0004)
    assert one.voltage_v[0] == pytest.approx(21.5)
    forces = trace("x", 0, f=[4_339_012], Ft=[-51], Fn=[500])
    assert forces.frequency_hz[0] == pytest.approx(43_390.12)
    assert forces.tangential_force_n[0] == pytest.approx(-0.051)
    assert forces.normal_force_n[0] == pytest.approx(0.5)


def test_columns_are_copies_nobody_can_write_to():
    source = np.arange(3)
    one = trace("x", 0, W=source)
    source[0] = 99
    assert one.W[0] == 0
    with pytest.raises(ValueError, match="read-only"):
        one.W[0] = 1


@pytest.mark.parametrize(
    ("experiment", "subject", "bad_rows", "message"),
    [
        ("Fig 5", 0, [(0,) * 8], "'Fig 5' is not made of"),
        ("fig5", -1, [(0,) * 8], "subject -1 is below 0"),
        ("fig5", 0, [(0,) * 7], "does not have 8 or 10 values"),
        ("fig5", 0, [(0,) * 7 + (0.5,)], "tick is not a list of integers"),
        ("fig5", 0, [(1,) + (0,) * 7, (1,) + (0,) * 7], "do not increase"),
        ("fig5", 0, [], "not a list of integers"),
    ],
)
def test_a_wrong_trace_is_refused(experiment, subject, bad_rows, message):
    with pytest.raises(ValueError, match=message):
        Trace.from_rows(experiment, subject, bad_rows)


def test_columns_of_unequal_length_are_refused():
    with pytest.raises(ValueError, match="column Fn has 2 of 3 rows"):
        three = np.zeros(3, dtype=int)
        Trace("x", 0, np.arange(3), three, three, three, three, three, three, three[:2])


def test_a_label_may_appear_once(tmp_path):
    one = trace("fig2.0.5", 3, W=[1])
    with pytest.raises(ValueError, match=r"fig2\.0\.5 of subject 3 appears twice"):
        write_csv(tmp_path / "t.csv", [one, one])
    assert not (tmp_path / "t.csv").exists()


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("mu_ref", "reference", "line 1 is not experiment,subject"),
        ("0.3012", "0.301", "line 2: mu '0.301' is not a number with 4 decimals"),
        ("0.3012", "3e-1", "line 2: mu '3e-1' is not"),
        ("21.50", "nan", "line 2: V 'nan' is not"),
        (",7,", ",7.0,", "line 2: tick '7.0' is not"),
        (",2,", ",two,", "line 2: subject 'two' is not a whole number"),
        (",0.500\n", "\n", "line 2 has 9 of 10 fields"),
    ],
)
def test_a_damaged_file_is_refused_by_line(tmp_path, old, new, message):
    row = (7, 3012, 3000, 10_004, 2_150, 4_339_012, 51, 500)
    text = written(tmp_path / "t.csv", Trace.from_rows("table1", 2, [row]))
    assert text.count(old) == 1
    (tmp_path / "t.csv").write_text(text.replace(old, new))
    with pytest.raises(ValueError, match=message):
        read_csv(tmp_path / "t.csv")


def test_time_and_lost_ticks():
    trace = Trace.from_rows("run", 0, [(tick, 0, 0, 0, 0, 0, 0, 0) for tick in (5, 6, 9)])
    assert trace.time_s == pytest.approx([0.005, 0.006, 0.009])
    assert trace.lost == 2

import copy
import hashlib
import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from synthetic_traces import all_experiments, trace

from smarttac_can.bench.traces import COLUMNS, Trace, read_csv, sha256, write_csv

integers = st.integers(-(2**31), 2**31 - 1)


def rows_of(width):
    return st.lists(st.tuples(*[integers] * (width - 1)), min_size=1, max_size=20).map(
        lambda values: [(3 * k, *value) for k, value in enumerate(values)]
    )


def same(one, other):
    return (one.experiment, one.subject) == (other.experiment, other.subject) and np.array_equal(
        one.counts, other.counts
    )


def written(path, *traces):
    write_csv(path, traces)
    return path.read_bytes().decode("ascii")


@settings(max_examples=60)
@given(first=rows_of(10), second=rows_of(8))
def test_any_integers_come_back_exactly(tmp_path_factory, first, second):
    path = tmp_path_factory.mktemp("traces") / "traces.csv"
    traces = [Trace.from_rows("a.b", 0, first), Trace.from_rows("a.b", 1, second)]
    write_csv(str(path), traces)
    assert [same(*pair) for pair in zip(read_csv(str(path)), traces, strict=True)] == [True, True]


def test_the_file_holds_decimals_of_the_documented_units(tmp_path):
    row = (7, 3012, 3000, 10_004, 2_150, 4_339_012, -51, 500, -1205, 1031)
    lifted = (8, 0, 0, 0, 0, 4_339_012, 0, 0, -1205, 1031)
    text = written(tmp_path / "t.csv", Trace.from_rows("table1", 2, [row, lifted]))
    assert text == (
        "# format: SMARTTAC traces 2\n"
        "experiment,subject,time_s,cof,cof_reference,amplitude_um,voltage_v,frequency_hz,"
        "tangential_force_n,normal_force_n,position_mm,status\n"
        "table1,2,0.007,0.3012,0.3000,1.0004,21.50,43390.12,-0.051,0.500,-12.05,1031\n"
        "table1,2,0.008,,,0.0000,0.00,43390.12,0.000,0.000,,1031\n"
    )


def test_without_contact_there_is_no_position(tmp_path):
    """The node goes on to publish where the finger was last, 0 before it came."""
    rows = [(0, 0, *[5] * 6, 0, 1), (1, 30, *[5] * 6, 0, 1), (2, 0, *[5] * 6, 700, 1)]
    one = Trace.from_rows("run", 0, rows)
    assert np.isnan(one.position_mm).tolist() == np.isnan(one.cof).tolist() == [True, False, True]
    write_csv(tmp_path / "t.csv", one)
    (read,) = read_csv(tmp_path / "t.csv")
    assert same(read, one)
    lines = (tmp_path / "t.csv").read_text().splitlines()[2:]
    assert [line.split(",")[-2] for line in lines] == ["", "0.00", ""]


def test_floats_are_those_of_the_decimals_in_the_file(tmp_path):
    """A product with 1e-4 would be the neighbour of some: 3500 * 1e-4 is 0.35000000000000003."""
    counts = [3500, 42, 2999, 6, 1234]
    one = Trace.from_rows("run", 0, [(k, *[count] * 8, 1) for k, count in enumerate(counts)])
    assert one.cof.tolist() == [0.35, 0.0042, 0.2999, 0.0006, 0.1234]
    lines = [line.split(",") for line in written(tmp_path / "t.csv", one).splitlines()[1:]]
    for name in ("time_s", "amplitude_um", "voltage_v", "frequency_hz", "normal_force_n"):
        at = lines[0].index(name)
        assert [float(line[at]) for line in lines[1:]] == getattr(one, name).tolist(), name


def test_one_changed_bit_changes_the_hash(tmp_path):
    runs = all_experiments()
    write_csv(tmp_path / "a.csv", runs)
    write_csv(tmp_path / "b.csv", runs)
    counts = runs[-1].counts.copy()
    counts[100, 1] += 1
    write_csv(tmp_path / "c.csv", [*runs[:-1], Trace("table1", 4, counts)])
    a, b, c = (sha256(tmp_path / f"{name}.csv") for name in "abc")
    assert a == b == hashlib.sha256((tmp_path / "a.csv").read_bytes()).hexdigest()
    assert a != c


ARRAYS = [*(column.name for column in COLUMNS), "tick", "counts"]


def test_arrays_are_copies():
    source = np.zeros((3, 10), int)
    source[:, 0] = range(3)
    one = Trace("x", 0, source)
    source[0, 3] = 99
    assert one.amplitude_um[0] == 0


@pytest.mark.parametrize(
    "again", [copy.deepcopy, copy.copy, lambda t: pickle.loads(pickle.dumps(t))]
)
@pytest.mark.parametrize("rows", [(1,) * 10, (1,) * 8])
def test_arrays_are_read_only_also_those_of_a_copy(again, rows):
    one = Trace.from_rows("x", 3, [rows])
    assert one.voltage_v.flags.writeable is False  # made before the copy
    other = again(one)
    assert same(other, one)
    for name in ARRAYS:
        for shown in (one, other):
            with pytest.raises(ValueError, match="read-only"):
                getattr(shown, name)[0] = 1


@pytest.mark.parametrize(
    ("former", "name", "count"),
    [
        ("mu", "cof", 2),
        ("mu_ref", "cof_reference", 3),
        ("W", "amplitude_um", 4),
        ("V", "voltage_v", 5),
        ("f", "frequency_hz", 6),
        ("Ft", "tangential_force_n", 7),
        ("Fn", "normal_force_n", 8),
        ("position", "position_mm", 9),
    ],
)
def test_former_names_still_give_integers_and_say_the_new_one(former, name, count):
    one = Trace.from_rows("x", 0, [tuple(range(1, 11))])
    with pytest.warns(DeprecationWarning, match=f"take Trace.{name}, which"):
        assert getattr(one, former).tolist() == [count]


def test_each_array_has_one_public_name():
    one = Trace.from_rows("x", 0, [tuple(range(1, 11))])
    formers = {name for name in vars(Trace) if type(vars(Trace)[name]).__name__ == "_Former"}
    public = {name for name in dir(one) if not name.startswith("_")} - formers
    arrays = {name for name in public if isinstance(getattr(one, name), np.ndarray)}
    assert arrays == set(ARRAYS)


@pytest.mark.parametrize(
    ("experiment", "subject", "bad_rows", "message"),
    [
        ("Fig 5", 0, [(0,) * 8], "'Fig 5' is not made of"),
        ("fig5", -1, [(0,) * 8], "subject -1 is below 0"),
        ("fig5", 0, [(0,) * 7], "has 7 values, not 10, or 8 without"),
        ("fig5", 0, [(0,) * 7 + (0.5,)], "are no table of integers"),
        ("fig5", 0, [(2**63,) * 10], "are no table of integers"),  # it would become negative
        ("fig5", 0, [(1,) + (0,) * 7, (1,) + (0,) * 7], "do not increase"),
        ("fig5", 0, [], "are no table of integers"),
    ],
)
def test_a_wrong_trace_is_refused(experiment, subject, bad_rows, message):
    with pytest.raises(ValueError, match=message):
        Trace.from_rows(experiment, subject, bad_rows)


def test_rows_of_unequal_length_are_refused():
    with pytest.raises(ValueError, match="the rows of x differ in length"):
        Trace.from_rows("x", 0, [(0,) * 8, (1,) * 10])


def test_a_label_may_appear_once(tmp_path):
    one = trace("fig2.0.5", 3, W=[1])
    with pytest.raises(ValueError, match=r"fig2\.0\.5 of subject 3 appears twice"):
        write_csv(tmp_path / "t.csv", [one, one])
    assert not (tmp_path / "t.csv").exists()


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("0.3012", "0.30\xb5m", "line 3: cof '0.30\xb5m' is not a number with 4 decimals"),
        ("traces 2", "traces 3", "line 1 is neither # format: SMARTTAC traces 2 nor experiment,"),
        ("cof_reference", "reference", "line 2 is not experiment,subject"),
        ("0.3012", "0.301", "line 3: cof '0.301' is not a number with 4 decimals"),
        ("0.3012", "3e-1", "line 3: cof '3e-1' is not"),
        ("21.50", "nan", "line 3: voltage_v 'nan' is not"),
        ("21.50", "", "line 3: voltage_v '' is not"),
        (",0.007,", ",7,", "line 3: time_s '7' is not"),
        (",2,", ",two,", "line 3: subject 'two' is not a whole number"),
        (",-12.05,1031\n", "\n", "line 3 has 10 of 12 fields"),
    ],
)
def test_a_damaged_file_is_refused_by_line(tmp_path, old, new, message):
    row = (7, 3012, 3000, 10_004, 2_150, 4_339_012, 51, 500, -1205, 1031)
    text = written(tmp_path / "t.csv", Trace.from_rows("table1", 2, [row]))
    assert text.count(old) == 1
    (tmp_path / "t.csv").write_text(text.replace(old, new))
    with pytest.raises(ValueError, match=f"^{tmp_path}/t.csv: {message}"):
        read_csv(tmp_path / "t.csv")


def test_bytes_that_are_no_text_are_named_by_line(tmp_path):
    write_csv(tmp_path / "t.csv", Trace.from_rows("run", 0, [tuple(range(10))]))
    data = (tmp_path / "t.csv").read_bytes()
    (tmp_path / "t.csv").write_bytes(data.replace(b"0.0001", b"0.0\xff01"))
    with pytest.raises(ValueError, match=r"/t\.csv: line 3: cof '0\.0\\\\xff01' is not a number"):
        read_csv(tmp_path / "t.csv")


def test_a_byte_order_mark_is_taken(tmp_path):
    one = Trace.from_rows("run", 0, [tuple(range(10))])
    write_csv(tmp_path / "t.csv", one)
    (tmp_path / "t.csv").write_bytes(b"\xef\xbb\xbf" + (tmp_path / "t.csv").read_bytes())
    assert same(read_csv(tmp_path / "t.csv")[0], one)


def test_time_and_lost_ticks():
    trace = Trace.from_rows("run", 0, [(tick, 0, 0, 0, 0, 0, 0, 0) for tick in (5, 6, 9)])
    assert trace.time_s == pytest.approx([0.005, 0.006, 0.009])
    assert trace.lost == 2

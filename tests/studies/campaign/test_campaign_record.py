import json

import numpy as np
import pytest

from smarttac_can.science.population.trial import Campaign
from smarttac_can.studies.campaign.runner import COLUMNS, Record, RecordError

CAMPAIGN = Campaign(seed=3)
ODD = np.random.default_rng(1).standard_normal((3, len(COLUMNS)))
ODD[0, 0], ODD[1, 2] = np.inf, np.nan


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "rows"
    with Record(path, CAMPAIGN) as record:
        record.add(range(2, 5), ODD)
        record.add(range(7, 10), 2.0 * ODD)
    return path


def read(path, fingers=12):
    rows = np.full((fingers, len(COLUMNS)), np.nan)
    with Record(path, CAMPAIGN) as record:
        record.fill(rows)
    return rows


def test_rows_come_back_to_the_bit(file):
    rows = read(file)
    assert rows[2:5].tobytes() == ODD.tobytes()
    assert rows[7:10].tobytes() == (2.0 * ODD).tobytes()
    assert np.isnan(rows[[0, 1, 5, 6, 10, 11]]).all()


def test_two_that_write_one_file_lose_nothing(tmp_path):
    path = tmp_path / "rows"
    with Record(path, CAMPAIGN) as one, Record(path, CAMPAIGN) as other:
        one.add(range(2, 5), ODD)
        other.add(range(2, 5), ODD)
        other.add(range(7, 10), 2.0 * ODD)
        one.add(range(10, 12), ODD[:2])
    rows = read(path)
    assert rows[2:5].tobytes() == ODD.tobytes()
    assert rows[7:10].tobytes() == (2.0 * ODD).tobytes()
    assert rows[10:12].tobytes() == ODD[:2].tobytes()


def test_fewer_fingers_than_there_are_leave_the_rest(file):
    assert read(file, 3)[2].tobytes() == ODD[0].tobytes()


def test_a_line_that_was_not_finished_is_none(file):
    whole = file.read_bytes()
    file.write_bytes(whole[:-20])
    rows = read(file)
    assert rows[2:5].tobytes() == ODD.tobytes()
    assert np.isnan(rows[7:10]).all()
    with Record(file, CAMPAIGN) as record:
        record.add(range(7, 10), 2.0 * ODD)
    assert file.read_bytes() == whole


def test_nothing_is_left_of_a_line_that_was_not_finished(file):
    whole = file.read_bytes()
    file.write_bytes(whole + b'{"first": 10, "rows": [[' + b" " * 5000)
    read(file)
    assert file.read_bytes() == whole


@pytest.mark.parametrize(
    "line",
    [
        b"nonsense",
        b"[]",
        b"{}",
        b"\xff\xfe",
        b"[" * 10000,
        b'{"first": 0, "rows": [[1, 2]], "crc": 0}',
        b'{"first": -1, "rows": [], "crc": 0}',
        b'{"first": 0, "rows": "x", "crc": 0}',
        b'{"first": 0, "rows": [[1], [2, 3]], "crc": 0}',
        b"0" * 70000,
    ],
)
@pytest.mark.parametrize("at", [0, 2])
def test_a_damaged_line_is_named(file, line, at):
    lines = file.read_bytes().splitlines()
    lines[at] = line
    file.write_bytes(b"\n".join(lines) + b"\n")
    with pytest.raises(RecordError, match=rf"rows: line {at + 1} is damaged$"):
        Record(file, CAMPAIGN)


def test_a_changed_digit_is_damage(file):
    lines = file.read_text().splitlines()
    said = json.loads(lines[1])
    said["rows"][1][3] += 1e-9
    lines[1] = json.dumps(said)
    file.write_text("\n".join(lines) + "\n")
    with pytest.raises(RecordError, match=r"line 2 is damaged$"):
        Record(file, CAMPAIGN)


@pytest.mark.parametrize(
    ("other", "what"),
    [
        (Campaign(seed=4), "seed 3, not 4"),
        (Campaign(seed=3, case="wider"), "case 'nominal', not 'wider'"),
        (Campaign(seed=3, dead_time=540e-6), "dead_time_us 0.0, not 540.0"),
        (Campaign(seed=3, plates="varied"), "plates 'model', not 'varied'"),
    ],
)
def test_another_campaign_is_refused_and_the_file_kept(file, other, what):
    before = file.read_bytes()
    with pytest.raises(RecordError, match=f"is of another campaign: {what}$"):
        Record(file, other)
    assert file.read_bytes() == before


def test_campaign_file_of_another_version_is_refused_and_kept(file):
    first, *rows = file.read_text().splitlines(keepends=True)
    header = json.loads(first)
    del header["plates"]
    file.write_text(json.dumps(header) + "\n" + "".join(rows))
    before = file.read_bytes()
    with pytest.raises(RecordError, match=r"rows: is of another version: "):
        Record(file, CAMPAIGN)
    assert file.read_bytes() == before


@pytest.mark.parametrize("cut", [0, 1, 20, 60])
def test_a_header_that_was_not_finished_is_none(file, cut):
    header = file.read_bytes().splitlines()[0]
    file.write_bytes(header[:cut])
    assert np.isnan(read(file)).all()


@pytest.mark.parametrize("text", [b"notes of years", b'{"a": 1}', b"\x89PNG\x0d\x1a", b"\0"])
def test_a_file_of_something_else_is_kept(tmp_path, text):
    path = tmp_path / "rows"
    path.write_bytes(text)
    with pytest.raises(RecordError, match=r"rows: is no file of a campaign$"):
        Record(path, CAMPAIGN)
    assert path.read_bytes() == text


def test_campaign_record_refuses_other_than_regular_files(tmp_path):
    with pytest.raises(OSError, match="no regular file"):
        Record(tmp_path, CAMPAIGN)

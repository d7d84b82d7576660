"""Front ends are found by name, timed, closed, and ended when they hang."""

from __future__ import annotations

import subprocess
import sys
import time
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import pytest

from smarttac_can.host import front_ends
from smarttac_can.host.front_ends import (
    FrontEndError,
    TimedFrontEnd,
    find_front_end,
    opened_front_end,
)
from smarttac_can.vocabulary.signals import Drive, Measurement

MODULE = '''
import time
from smarttac_can.vocabulary import Drive, Measurement

def told(what):
    with open("told", "a") as file:
        file.write(f"{what}\\n")

class Rest:
    """Hardware at rest."""
    def put_out(self, drive):
        told(drive.voltage)
        return drive.voltage
    def sample(self):
        return Measurement(0j, (0.0,) * 6, 20.0, 0)
    def close(self):
        told("closed")

class Hung(Rest):
    def sample(self):
        told("hangs")
        time.sleep(3600)

class HungForGood(Hung):
    def put_out(self, drive):
        told(drive.voltage)
        if drive.frequency > 1:
            time.sleep(3600)
        return drive.voltage

class Unopened(Rest):
    def __init__(self):
        raise OSError("no such card")

class Deaf:
    def sample(self):
        return None

class Stays(Rest):
    def close(self):
        raise OSError("busy")

class HungAtTheEnd(Rest):
    def close(self):
        told("hangs")
        time.sleep(3600)

NUMBER = 7
'''


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "lab_front_ends.py").write_text(MODULE)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.chdir(tmp_path)
    monkeypatch.delitem(sys.modules, "lab_front_ends", raising=False)
    (tmp_path / "told").touch()
    return tmp_path


def test_by_module_and_class(lab: Path) -> None:
    with opened_front_end("lab_front_ends:Rest", by_clock=True) as plate:
        assert plate.put_out(Drive(3.0, 43e3)) == 3.0
        assert plate.sample() == Measurement(0j, (0.0,) * 6, 20.0, 0)
        assert plate.took_us < 1_000_000
    assert (lab / "told").read_text() == "3.0\nclosed\n"


def test_by_entry_point(lab: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    point = EntryPoint("rest", "lab_front_ends:Rest", front_ends.GROUP)
    asked: list[dict[str, str]] = []

    def entry_points(**selection: str) -> list[EntryPoint]:
        asked.append(selection)
        return [point]

    monkeypatch.setattr(front_ends, "entry_points", entry_points)
    assert find_front_end("rest").__name__ == "Rest"
    assert asked == [{"group": "smarttac_can.front_ends"}]
    with pytest.raises(FrontEndError, match=r"no front end 'other' \(rest\)"):
        find_front_end("other")


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("nothing", "no front end 'nothing' (none is installed); it may also be module:Class"),
        ("", "no front end ''"),
        ("lab_front_ends:", "no front end 'lab_front_ends:'"),
        ("no_such_module:Rest", "cannot import front end no_such_module:Rest: No module named"),
        ("lab_front_ends:Nope", "has no attribute 'Nope'"),
        ("lab_front_ends:Unopened", "cannot be opened: no such card"),
        ("lab_front_ends:NUMBER", "cannot be opened: 'int' object is not callable"),
        ("lab_front_ends:Deaf", "has no put_out, close"),
    ],
)
def test_front_end_is_refused_with_the_reason_of_each_name(
    lab: Path, name: str, reason: str
) -> None:
    with pytest.raises(FrontEndError) as caught, opened_front_end(name, by_clock=True):
        pass
    assert reason in str(caught.value)
    assert (lab / "told").read_text() == ""


def test_it_is_closed_when_the_run_fails(lab: Path) -> None:
    with (
        pytest.raises(ValueError, match="run"),
        opened_front_end("lab_front_ends:Rest", by_clock=True),
    ):
        raise ValueError("run")
    assert (lab / "told").read_text() == "closed\n"


def test_one_that_does_not_close_says_so(lab: Path) -> None:
    with (
        pytest.raises(FrontEndError, match="lab_front_ends:Stays does not close: busy"),
        opened_front_end("lab_front_ends:Stays", by_clock=True) as plate,
    ):
        plate.put_out(Drive(0.0, 1.0))
    assert (lab / "told").read_text() == "0.0\n"


class Slow:
    """Takes time of a clock that the test has."""

    def __init__(self) -> None:
        self.now = 5_000_000_000

    def put_out(self, drive: Drive) -> float:
        self.now += 700_000
        return drive.voltage

    def sample(self) -> Any:
        self.now += 1_200_999
        raise OSError("failed late")

    def close(self) -> None:
        pass


def test_each_call_is_timed_one_that_fails_too() -> None:
    slow = Slow()
    plate = TimedFrontEnd(slow, lambda: slow.now)
    assert plate.took_us == 0
    plate.put_out(Drive(0.0, 1.0))
    assert plate.took_us == 700
    with pytest.raises(OSError, match="failed late"):
        plate.sample()
    assert plate.took_us == 1200
    assert plate.calls == 4


HANGING = """
import sys
from smarttac_can.host import front_ends
from smarttac_can.host.front_ends import opened_front_end
from smarttac_can.vocabulary import Drive
front_ends._LAST_WORD_S = 3.0  # a busy machine
with opened_front_end(sys.argv[1], by_clock=True) as plate:
    plate.put_out(Drive(9.0, 1.0))
    plate.last = Drive(9.0, float(sys.argv[2]))
    if not sys.argv[1].endswith("HungAtTheEnd"):
        plate.sample()
"""


@pytest.mark.parametrize(
    ("name", "frequency", "said"),
    [
        ("Hung", 1, "0 V was asked for"),
        ("HungForGood", 2, "nor does it take 0 V"),
        ("HungAtTheEnd", 1, "0 V was asked for"),
    ],
)
def test_a_call_that_hangs_ends_the_process_at_0_v(
    lab: Path, name: str, frequency: int, said: str
) -> None:
    run = subprocess.run(
        [sys.executable, "-c", HANGING, f"lab_front_ends:{name}", str(frequency)],
        check=False, capture_output=True, text=True, timeout=60,
    )  # fmt: skip
    assert run.returncode == 1
    assert run.stderr == f"Error: front end lab_front_ends:{name} hangs in a call: ended, {said}\n"
    assert (lab / "told").read_text() == "9.0\nhangs\n0.0\n"


def test_a_call_that_takes_long_but_ends_is_none_that_hangs(lab: Path) -> None:
    with opened_front_end("lab_front_ends:Rest", by_clock=True) as plate:
        for _ in range(8):
            plate.sample()
            time.sleep(0.03)  # between two calls nothing hangs
    assert (lab / "told").read_text() == "closed\n"

"""Lines that are kept in a file, by a thread, at most so often."""

import threading
import time
from itertools import count
from pathlib import Path

from smarttac_can.host.fault_file import FaultFile, read_lines
from smarttac_can.host.storage_file import StorageFile

GUARD_S = 60.0


def never(error: OSError) -> None:
    raise AssertionError(error)


class CountingFile(StorageFile):
    writes = 0

    def write(self, data: bytes) -> None:
        self.writes += 1
        super().write(data)


def test_lines_come_back(tmp_path: Path) -> None:
    file = StorageFile(tmp_path / "kept")
    assert read_lines(file) == ()
    lines: tuple[str, ...] = ()
    with FaultFile(file, lambda: lines, never):
        lines = ("new", "old \xb5")
    assert read_lines(file) == ("new", "old ?")


def test_what_is_no_text_does_no_harm(tmp_path: Path) -> None:
    path = tmp_path / "kept"
    path.write_bytes(b"\xff\x1b[2J\n" + b"x" * 10_000)
    assert read_lines(StorageFile(path)) == ("??[2J", "x" * 500)


def test_they_are_written_while_it_lasts_and_not_more_often(tmp_path: Path) -> None:
    file = CountingFile(tmp_path / "kept")
    number = 0
    with FaultFile(file, lambda: (str(number),), never, 0.05):
        start = time.monotonic()
        while file.writes < 3:
            number += 1
            assert time.monotonic() < start + GUARD_S
        assert time.monotonic() >= start + 0.1
    assert read_lines(file) == (str(number),)


def test_by_default_they_are_looked_at_once_a_second(tmp_path: Path) -> None:
    waits: list[float] = []

    class Second(threading.Event):
        """Lets three seconds pass at once."""

        def wait(self, timeout: float | None = None) -> bool:
            assert timeout is not None
            waits.append(timeout)
            return len(waits) > 3

    file = CountingFile(tmp_path / "kept")
    numbers = count()
    kept = FaultFile(file, lambda: (str(next(numbers)),), never)
    kept._over = Second()
    with kept:
        pass
    assert waits == [1.0] * 4
    assert file.writes == 4, "after each second, and at the end"


def test_what_has_not_changed_is_not_written(tmp_path: Path) -> None:
    file = CountingFile(tmp_path / "kept")
    with FaultFile(file, lambda: ("same",), never, 0.01):
        time.sleep(0.05)
    assert file.writes == 0


def test_a_file_that_fails_is_said_once_and_tried_again(tmp_path: Path) -> None:
    folder = tmp_path / "gone"
    file = StorageFile(folder / "kept")
    said: list[OSError] = []
    lines: tuple[str, ...] = ()
    with FaultFile(file, lambda: lines, said.append, 0.01):
        lines = ("fault",)
        end = time.monotonic() + GUARD_S
        while not said:
            assert time.monotonic() < end
        time.sleep(0.05)
        folder.mkdir()
    assert len(said) == 1
    assert read_lines(file) == ("fault",)

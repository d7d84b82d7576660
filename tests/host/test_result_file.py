"""Files for results that cannot be written to the end: a full disk, or an interrupt."""

import contextlib
import errno
import gc
import resource
import signal
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest
from interrupts import interrupted

from smarttac_can.bench import Trace, read_csv, write_csv
from smarttac_can.host import result_file as module
from smarttac_can.host.file_errors import in_words
from smarttac_can.host.result_file import result_file

TRACE = Trace.from_rows("a", 0, [(k, *range(9)) for k in range(2000)])


@contextmanager
def nearly_full() -> Iterator[None]:
    """Let a file have 4 kB: its errors come where those of a full disk do."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    ignored = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, ignored)


def test_a_file_that_fails_leaves_the_old_one(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_text("old")
    with pytest.raises(OSError) as told, result_file(path) as file, nearly_full():
        file.write("x" * 100_000)
    assert (told.value.errno, told.value.filename) == (errno.EFBIG, str(path))
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_what_is_written_as_it_is_closed(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    with pytest.raises(OSError) as told, nearly_full(), result_file(path) as file:
        file.write("x" * 5000)
    assert told.value.filename == str(path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.filterwarnings("ignore:unclosed file:ResourceWarning")
def test_an_interrupt_at_any_instruction_leaves_no_half_of_a_file(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"

    def ended(instruction: int) -> bool:
        try:
            with interrupted(instruction, module, contextlib), ExitStack() as stack:
                stack.enter_context(result_file(path)).write("new")
        except KeyboardInterrupt:
            return False
        return True

    instruction = 0
    while not ended(instruction):
        gc.collect(1)  # as a process does that ends: what the traceback kept alive is closed
        left = {file.name: file.read_text() for file in tmp_path.iterdir()}
        assert left in ({}, {"t.csv": "new"}), instruction
        path.unlink(missing_ok=True)
        instruction += 1
    assert instruction > 100
    assert path.read_text() == "new"


def test_a_device_is_written_itself() -> None:
    with pytest.raises(OSError) as told, result_file(Path("/dev/full")) as file:
        file.write("x")
    assert (told.value.errno, told.value.filename) == (errno.ENOSPC, "/dev/full")


def test_traces_on_a_full_disk_leave_those_before(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    write_csv(path, TRACE)
    other = Trace.from_rows("b", 0, TRACE.counts)
    with pytest.raises(OSError, match=rf"^{path}: File too large$"), nearly_full():
        write_csv(path, other)
    assert read_csv(path)[0].experiment == "a"
    write_csv(path, other)
    assert read_csv(path)[0].experiment == "b"
    assert list(tmp_path.iterdir()) == [path]


def test_a_link_stays_one(tmp_path: Path) -> None:
    (tmp_path / "link.csv").symlink_to(tmp_path / "t.csv")
    write_csv(tmp_path / "link.csv", TRACE)
    assert (tmp_path / "link.csv").is_symlink()
    assert read_csv(tmp_path / "t.csv")[0].experiment == "a"


def test_an_error_that_has_no_number_is_as_it_was() -> None:
    error = OSError("of another")
    with pytest.raises(OSError) as told, in_words("t.csv"):
        raise error
    assert told.value is error

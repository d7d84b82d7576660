"""Progress is shown where somebody looks; lines for a terminal never make their writer wait."""

import fcntl
import os
import re
import sys
from collections.abc import Iterator
from io import StringIO
from types import SimpleNamespace
from typing import Any

import pytest
from nodes_on_a_bus import GUARD_S

from smarttac_can.bench import Stimulator
from smarttac_can.host import terminal as module
from smarttac_can.host.terminal import LineWriter, progress_bar

# A bar for a person, and a few lines for a log file.


class Terminal(StringIO):
    def isatty(self) -> bool:
        return True


class Broken(Terminal):
    def write(self, text: str) -> int:
        raise OSError(5, "Input/output error")


def on_terminal(monkeypatch: pytest.MonkeyPatch) -> Terminal:
    """Begin to look on; pytest puts back changes of a fixture to sys.stderr."""
    stream = Terminal()
    monkeypatch.setattr(sys, "stderr", stream)
    return stream


class Clock:
    """Seconds that pass by 0.01 each time that somebody looks."""

    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        self.now += 0.01
        return self.now


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    made = Clock()
    monkeypatch.setattr(module, "monotonic", made)
    return made


@pytest.mark.parametrize(("stream", "shown"), [(Terminal(), True), (StringIO(), False)])
def test_progress_is_for_a_terminal(
    stream: StringIO, shown: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "stderr", stream)
    with progress_bar("soaking") as progress:
        progress(0.5)
        progress(1.0)
    said = stream.getvalue()
    assert ("soaking" in said and "100%" in said and said.endswith("\n")) if shown else said == ""


def test_a_long_run_without_a_terminal_prints_few_lines(
    monkeypatch: pytest.MonkeyPatch, clock: Clock
) -> None:
    monkeypatch.setattr(sys, "stderr", file := StringIO())
    with progress_bar("campaign") as progress:
        for tick in range(1, 400):
            clock.now += 1.0
            progress(tick / 400)
        progress(1.0)
    first, *others = file.getvalue().splitlines()
    assert re.fullmatch(r"campaign: 2% after 1\d s, about [345]\d\d s left", first)
    assert 5 <= len(others) <= 10
    shown = re.compile(r"campaign: \d+% after \d+ s, about \d+ s left")
    assert all(shown.fullmatch(line) for line in others)


def test_progress_of_nothing_yet_has_no_time_left(
    monkeypatch: pytest.MonkeyPatch, clock: Clock
) -> None:
    monkeypatch.setattr(sys, "stderr", file := StringIO())
    with progress_bar("compiling") as progress:
        clock.now += 20.0
        progress(0.0)
    assert file.getvalue() == "compiling: 0% after 20 s\n"


def test_a_process_without_stderr_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    closed = Terminal()
    closed.close()
    for stream in (None, closed, Broken()):
        monkeypatch.setattr(sys, "stderr", stream)
        with progress_bar("soaking") as progress:
            progress(0.5)
            progress(1.0)


def test_an_error_of_the_block_is_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = on_terminal(monkeypatch)
    with pytest.raises(OSError, match="of the run"), progress_bar("soaking"):
        raise OSError("of the run")
    with progress_bar("after") as progress:
        progress(1.0)
    assert "after" in terminal.getvalue()


def test_a_block_has_to_last(monkeypatch: pytest.MonkeyPatch, clock: Clock) -> None:
    terminal = on_terminal(monkeypatch)
    with progress_bar("short", after=2.0) as progress:
        progress(0.5)
        progress(1.0)
    assert terminal.getvalue() == ""
    with progress_bar("long", after=2.0) as progress:
        progress(0.25)
        clock.now += 2.0
        progress(0.5)
        progress(0.75)
    said = terminal.getvalue()
    assert "long" in said and "50%" in said
    assert "25%" not in said and "75%" not in said  # not each call is drawn


def test_one_is_shown_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = on_terminal(monkeypatch)
    with progress_bar("outer") as outer, progress_bar("inner") as inner:
        inner(0.5)
        outer(1.0)
    assert "inner" not in terminal.getvalue()
    assert "100%" in terminal.getvalue()


def test_a_worker_process_shows_none(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = on_terminal(monkeypatch)
    monkeypatch.setattr(module, "parent_process", object)
    with progress_bar("cells") as progress:
        progress(1.0)
    assert terminal.getvalue() == ""


@pytest.fixture
def notebook(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, str]]:
    """Objects that a notebook shows, and their replacements."""
    shown: list[tuple[str, str]] = []

    def display(html: str, display_id: bool) -> Any:
        assert display_id
        shown.append(("new", html))
        return SimpleNamespace(update=lambda other: shown.append(("update", other)))

    ipython: Any = SimpleNamespace(get_ipython=lambda: SimpleNamespace(kernel=object()))
    monkeypatch.setitem(sys.modules, "IPython", ipython)
    monkeypatch.setitem(
        sys.modules,
        "IPython.display",
        SimpleNamespace(HTML=str, display=display),  # type: ignore[arg-type]
    )
    return shown


def test_a_bar_in_a_notebook(notebook: list[tuple[str, str]], capfd: Any) -> None:
    with progress_bar("a < b") as progress:
        progress(1.0)
    assert notebook == [
        ("new", 'a &lt; b <progress value="0.000" max="1"></progress> 0%'),
        ("update", 'a &lt; b <progress value="1.000" max="1"></progress> 100%'),
    ]
    assert capfd.readouterr() == ("", "")


@pytest.fixture
def bench() -> Iterator[Stimulator]:
    with Stimulator.simulate("local") as made:
        yield made


def test_a_long_run_shows_how_far_it_is(
    bench: Stimulator, monkeypatch: pytest.MonkeyPatch, clock: Clock
) -> None:
    terminal = on_terminal(monkeypatch)
    bench.run(0.15, "short")
    assert terminal.getvalue() == ""
    trace = bench.run(0.5, "fig5.long")
    said = terminal.getvalue()
    assert "fig5.long" in said and "100%" in said
    assert len(trace) == 500


# Lines for a pipe that somebody reads, nobody reads, or nobody can read any more.


MOST_LINES = 1000
FILLING = 5000
"""Lines that no pipe and no queue has room for."""


class Pipe:
    """A pipe with a writer of lines."""

    def __init__(self) -> None:
        self.reader, self.end = os.pipe()
        self.writer = LineWriter(self.end)
        self.thread = self.writer._thread
        self.said = 0

    def fill(self) -> None:
        """Say more than anybody keeps."""
        for _ in range(FILLING):
            self.say()

    def say(self) -> None:
        self.writer.write(f"{self.said:099}")
        self.said += 1

    def read(self) -> list[str]:
        """Read all there is until the writer has gone."""
        os.close(self.end)
        with os.fdopen(self.reader) as file:
            return file.read().splitlines()


@pytest.fixture
def pipe() -> Iterator[Pipe]:
    made = Pipe()
    yield made
    if made.thread.ident is not None:
        made.thread.join(GUARD_S)


def test_a_line_arrives_without_another(pipe: Pipe) -> None:
    with pipe.writer as writer:
        for number in range(3):
            writer.write(f"line {number}")
            assert os.read(pipe.reader, 100) == f"line {number}\n".encode()
    assert pipe.read() == []


def test_a_line_longer_than_the_pipe_arrives_whole(pipe: Pipe) -> None:
    with pipe.writer as writer:
        writer.write("x" * 1_000_000)
        writer.write("end \xb5")
    assert pipe.read() == ["x" * 1_000_000, "end \xb5"]
    assert writer.dropped == 0


def test_unread_pipe_does_not_hold_up_its_writer(pipe: Pipe) -> None:
    with pipe.writer:
        pipe.fill()
    assert pipe.thread.is_alive(), "it is still waiting for a reader, alone"
    assert pipe.thread.daemon, "which does not keep the process"
    assert FILLING > pipe.writer.dropped > FILLING - MOST_LINES - 2000
    pipe.read()


def test_dropped_terminal_lines_are_counted_and_reported_later(pipe: Pipe) -> None:
    pipe.fill()
    with pipe.writer:
        pass
    assert pipe.writer.dropped == FILLING - MOST_LINES
    said = [f"{number:099}" for number in range(MOST_LINES)]
    told = f"({FILLING - MOST_LINES} lines dropped: nobody read them)"
    assert pipe.read() == [told, *said], "the newest are dropped"


def test_lines_go_on_when_somebody_reads_again(pipe: Pipe) -> None:
    pipe.fill()
    with pipe.writer, os.fdopen(os.dup(pipe.reader)) as file:
        for _ in range(1 + MOST_LINES):
            file.readline()
        for _ in range(10):
            pipe.say()
            assert file.readline() == f"{pipe.said - 1:099}\n"
    assert pipe.writer.dropped == FILLING - MOST_LINES
    assert pipe.read() == []


def test_a_closed_reader_ends_the_thread_and_nobody_else(pipe: Pipe) -> None:
    os.close(pipe.reader)
    with pipe.writer:
        pipe.say()
        pipe.thread.join(GUARD_S)
        assert not pipe.thread.is_alive()
        pipe.fill()
    assert pipe.writer.dropped >= FILLING - MOST_LINES
    os.close(pipe.end)


def test_the_descriptor_stays_open_as_it_is(pipe: Pipe) -> None:
    flags = fcntl.fcntl(pipe.end, fcntl.F_GETFL)
    assert not flags & os.O_NONBLOCK
    with pipe.writer as writer:
        writer.write("last words")
        assert fcntl.fcntl(pipe.end, fcntl.F_GETFL) == flags
    assert os.read(pipe.reader, 100) == b"last words\n"
    os.write(pipe.end, b"still open\n")
    assert pipe.read() == ["still open"]


def test_a_descriptor_that_another_program_has_made_non_blocking() -> None:
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    received = bytearray()
    with LineWriter(writer) as lines:
        for number in range(20):
            lines.write(f"{number} " + "x" * 20_000)
        while received.count(b"\n") < 20:
            received += os.read(reader, 1 << 16)
    os.close(reader)
    os.close(writer)
    assert [line.split()[0] for line in received.splitlines()] == [b"%d" % n for n in range(20)]

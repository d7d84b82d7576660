"""Lines for a pipe that somebody reads, nobody reads, or nobody can read any more."""

import fcntl
import os
import re
from collections.abc import Iterator

import pytest
from conftest import GUARD_S

from smarttac_can.host.line_writer import LineWriter

MOST_LINES = 1000
FILLING = 5000
"""Lines that no pipe and no queue has room for."""
DROPPED = re.compile(r"\(([0-9]+) lines dropped: nobody read them\)")


class Pipe:
    """A pipe with a writer of lines."""

    def __init__(self) -> None:
        self.reader, self.end = os.pipe()
        self.flags = fcntl.fcntl(self.end, fcntl.F_GETFL)
        self.writer = LineWriter(self.end)
        self.thread = self.writer._thread
        self.said = 0

    def fill(self) -> None:
        """Say more than anybody keeps."""
        for _ in range(FILLING):
            self.say()

    def say(self) -> None:
        self.writer.say(f"{self.said:099}")
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


def test_lines_arrive_in_order(pipe: Pipe) -> None:
    with pipe.writer as writer:
        for number in range(500):
            writer.say(f"line {number} with µ")
    assert pipe.read() == [f"line {number} with µ" for number in range(500)]
    assert writer.dropped == 0


def test_a_line_arrives_without_another(pipe: Pipe) -> None:
    with pipe.writer as writer:
        for number in range(3):
            writer.say(f"line {number}")
            assert os.read(pipe.reader, 100) == f"line {number}\n".encode()
    assert pipe.read() == []


def test_a_line_longer_than_the_pipe_arrives_whole(pipe: Pipe) -> None:
    with pipe.writer as writer:
        writer.say("x" * 1_000_000)
        writer.say("end")
    assert pipe.read() == ["x" * 1_000_000, "end"]


def test_a_pipe_that_nobody_reads_holds_nobody_up(pipe: Pipe) -> None:
    with pipe.writer:
        pipe.fill()
    assert pipe.thread.is_alive(), "it is still waiting for a reader, alone"
    assert pipe.thread.daemon, "which does not keep the process"
    assert FILLING > pipe.writer.dropped > FILLING - MOST_LINES - 2000
    pipe.read()


def test_what_was_dropped_is_counted_and_told_when_somebody_reads(pipe: Pipe) -> None:
    pipe.fill()
    with pipe.writer:
        pass
    assert pipe.writer.dropped == FILLING - MOST_LINES
    said = [f"{number:099}" for number in range(MOST_LINES)]
    told = f"({FILLING - MOST_LINES} lines dropped: nobody read them)"
    assert pipe.read() == [told, *said], "the newest are dropped"


def test_none_that_was_dropped_is_forgotten(pipe: Pipe) -> None:
    with pipe.writer:
        pipe.fill()
    lines = pipe.read()
    told = [int(found[1]) for line in lines if (found := DROPPED.fullmatch(line))]
    numbers = [int(line) for line in lines if not DROPPED.fullmatch(line)]
    assert sum(told) == pipe.writer.dropped == FILLING - len(numbers)
    assert numbers == sorted(set(numbers))


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


def test_a_reader_that_goes_while_the_pipe_is_full(pipe: Pipe) -> None:
    with pipe.writer:
        pipe.fill()
        os.close(pipe.reader)
        pipe.thread.join(GUARD_S)
    assert not pipe.thread.is_alive()
    os.close(pipe.end)


def test_the_descriptor_stays_as_it_is(pipe: Pipe) -> None:
    assert not pipe.flags & os.O_NONBLOCK
    with pipe.writer:
        pipe.fill()
        assert fcntl.fcntl(pipe.end, fcntl.F_GETFL) == pipe.flags
    assert fcntl.fcntl(pipe.end, fcntl.F_GETFL) == pipe.flags
    pipe.read()


def test_the_descriptor_stays_open(pipe: Pipe) -> None:
    with pipe.writer as writer:
        writer.say("last words")
    assert os.read(pipe.reader, 100) == b"last words\n"
    os.write(pipe.end, b"still open\n")
    assert pipe.read() == ["still open"]


def test_a_descriptor_that_another_program_has_made_non_blocking() -> None:
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    received = bytearray()
    with LineWriter(writer) as lines:
        for number in range(20):
            lines.say(f"{number} " + "x" * 20_000)
        while received.count(b"\n") < 20:
            received += os.read(reader, 1 << 16)
    os.close(reader)
    os.close(writer)
    assert [line.split()[0] for line in received.splitlines()] == [b"%d" % n for n in range(20)]

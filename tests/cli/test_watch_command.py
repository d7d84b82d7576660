"""``smarttac watch`` as a command: in a terminal of its own, and what it refuses."""

import fcntl
import os
import pty
import select
import signal
import struct
import subprocess
import sys
import termios
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from click.testing import CliRunner
from nodes_on_a_bus import GUARD_S, multicast_options, processes

from smarttac_can.cli import main


def refusal(*arguments: str) -> tuple[int, str]:
    result = CliRunner().invoke(main, ["watch", *arguments])
    assert isinstance(result.exception, SystemExit), result.exception
    return result.exit_code, result.stderr.splitlines()[-1]


class Terminal:
    """A command in a pseudo-terminal, as at the far end of ssh."""

    def __init__(self, *arguments: str, columns: int = 80, lines: int = 24) -> None:
        self._end, theirs = pty.openpty()
        fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", lines, columns, 0, 0))
        self.process = subprocess.Popen(
            [sys.executable, "-W", "error", "-m", "smarttac_can", "watch", *arguments],
            stdin=theirs,
            stdout=theirs,
            stderr=theirs,
            env=os.environ | {"TERM": "xterm-256color"},
            start_new_session=True,
        )
        os.close(theirs)
        self.seen = ""

    def read(self) -> bool:
        """Take what has come; False if nothing comes any more."""
        if not select.select([self._end], [], [], 0.1)[0]:
            return True
        try:
            data = os.read(self._end, 65536)
        except OSError:  # Linux says so that the other end is closed
            return False
        self.seen += data.decode(errors="replace")
        return bool(data)

    def wait_for(self, text: str) -> None:
        guard = time.monotonic() + GUARD_S
        while text not in self.seen:
            assert self.read() or text in self.seen, self.seen
            assert time.monotonic() < guard, self.seen

    def press(self, keys: str) -> None:
        os.write(self._end, keys.encode())

    def end(self) -> int:
        guard = time.monotonic() + GUARD_S
        while self.read() and time.monotonic() < guard:
            pass
        try:
            return self.process.wait(GUARD_S)
        finally:
            self.process.kill()
            self.process.wait()
            os.close(self._end)


@contextmanager
def terminal(*arguments: str, **size: int) -> Iterator[Terminal]:
    made = Terminal(*arguments, **size)
    try:
        yield made
    finally:
        if made.process.returncode is None:
            made.process.kill()
            made.end()


def test_in_a_terminal_against_a_node(multicast: dict[str, Any]) -> None:
    with (
        processes(multicast, "node"),
        terminal(*multicast_options(multicast)) as watch,
    ):
        watch.wait_for("stimulator 32: pre-operational")
        watch.wait_for("is pre-operational: it publishes nothing")
        watch.press("q")
        assert watch.end() == 0
    assert "Traceback" not in watch.seen


def test_a_watch_that_drives_leaves_0_v_with_ctrl_c(multicast: dict[str, Any]) -> None:
    options = multicast_options(multicast)
    with processes(multicast, "node") as (node,), terminal(*options, "--drive") as watch:
        watch.wait_for("ready")
        watch.press("mode open_loop\r")
        node.wait_for("stimulator 32 mode open_loop")
        watch.press("\x03")
        node.wait_for("stimulator 32 mode off")
        assert watch.end() == 0
    assert "Traceback" not in watch.seen


def test_a_watch_that_is_killed_leaves_0_v(multicast: dict[str, Any]) -> None:
    options = multicast_options(multicast)
    with processes(multicast, "node") as (node,), terminal(*options, "--drive") as watch:
        watch.wait_for("ready")
        watch.press("mode open_loop\r")
        node.wait_for("stimulator 32 mode open_loop")
        watch.process.send_signal(signal.SIGKILL)
        node.wait_for("stimulator 32 mode off")
        node.wait_for("stimulator 32 fault 8131h: the heartbeat of a watched node is lost")


def test_nobody_to_drive_is_one_line(multicast: dict[str, Any]) -> None:
    with terminal(*multicast_options(multicast), "--drive") as watch:
        assert watch.end() == 1
    said = watch.seen.strip().splitlines()
    assert len(said) == 1
    assert said[0].startswith("Error: no node 32 answers on udp_multicast:239.74.163.3")


def test_a_bus_that_cannot_be_opened_is_one_line() -> None:
    with terminal("--interface", "socketcan", "--channel", "nocan7") as watch:
        assert watch.end() == 1
    (line,) = watch.seen.strip().splitlines()
    assert line.startswith("Error: cannot open the socketcan bus, channel nocan7")


def test_without_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("smarttac_can.cli.bench.find_spec", lambda name: None)
    said = (1, "Error: watch needs Textual: pip install 'smarttac-can[watch]'")
    assert refusal("--interface", "virtual") == said


def test_without_a_terminal() -> None:
    said = (1, "Error: watch needs a terminal; for a file, take a log of the bus")
    assert refusal("--interface", "virtual") == said


def test_what_drives_has_to_write() -> None:
    assert refusal("--drive", "--no-sdo") == (
        2, "Error: --drive writes by SDO: leave out --no-sdo",
    )  # fmt: skip

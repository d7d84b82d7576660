"""The parties of a test on vcan0, each a process of its own."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import can

from smarttac_can.host.log_file import read_candump

CHANNEL = "vcan0"
PLATE_ID = 33
GUARD_S = 60.0
"""Only ever waited for by a test that is about to fail."""
LAST_ID = 0x7FF
"""Of the frame that ends a log; no CANopen device sends it."""
_BUFFER = str(1 << 24)
"""Bytes that wait for candump: on a busy machine it may come late, and has to miss nothing."""


def is_up(interface: str) -> bool:
    flags = Path("/sys/class/net", interface, "flags")
    return flags.exists() and bool(int(flags.read_text(), 0) & 1)


class NodeProcess:
    """``smarttac node`` or ``smarttac plate``, ready when made; in real time or in lockstep."""

    def __init__(self, command: str, *options: str, lockstep: bool = True) -> None:
        bus = ("--interface", "socketcan", "--channel", CHANNEL)
        pace = ("--lockstep",) if lockstep else ()
        self.process = subprocess.Popen(
            [sys.executable, "-u", "-m", "smarttac_can", command, *bus, *pace, *options],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        assert self.process.stdout is not None
        self.said = [self.process.stdout.readline()]
        assert " ready on socketcan:vcan0" in self.said[0]

    def terminate(self) -> int:
        """Send SIGTERM; return the exit status."""
        self.process.terminate()
        return self.ended()

    def ended(self) -> int:
        assert self.process.stdout is not None
        said, _ = self.process.communicate(timeout=GUARD_S)
        self.said += said.splitlines()
        return self.process.returncode

    def __enter__(self) -> NodeProcess:
        return self

    def __exit__(self, *_: object) -> None:
        if self.process.poll() is None:
            self.process.kill()
        self.process.communicate()


@contextmanager
def candump(log: Path) -> Iterator[None]:
    """Have can-utils' candump log all of the bus while the block runs, to the last frame."""
    with (
        log.open("wb") as file,
        subprocess.Popen(["candump", "-L", "-r", _BUFFER, CHANNEL], stdout=file) as process,
        can.Bus(channel=CHANNEL, interface="socketcan") as bus,
    ):
        try:
            # It hears nothing before it has bound its socket: its first frame says that it has.
            _until_logged(log, bus, b"\x00")
            yield
            _until_logged(log, bus, b"\xff")
        finally:
            process.terminate()


def _until_logged(log: Path, bus: can.BusABC, mark: bytes) -> None:
    line = f"{LAST_ID:03X}#{mark.hex().upper()}\n".encode()
    end = time.monotonic() + GUARD_S
    while not log.read_bytes().endswith(line):
        assert time.monotonic() < end, "candump logs nothing"
        bus.send(can.Message(arbitration_id=LAST_ID, is_extended_id=False, data=mark))
        time.sleep(0.05)


def logged_frames(log: Path) -> list[tuple[int, bytes]]:
    """CAN-ID and data of what was logged, in order, without the marks."""
    frames = [(frame.can_id, frame.data) for _, frame in read_candump(log)]
    return [frame for frame in frames if frame[0] != LAST_ID]

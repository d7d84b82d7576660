"""The parties of a test on vcan0, each a process of its own."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from nodes_on_a_bus import GUARD_S

CHANNEL = "vcan0"
PLATE_ID = 33


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

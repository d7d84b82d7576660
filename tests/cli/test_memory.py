"""What a process of the command takes."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import psutil
from nodes_on_a_bus import processes

from smarttac_can.bench import Stimulator

DEMO = """
import atexit, pathlib, re
def tell():
    status = pathlib.Path("/proc/self/status").read_text()
    pathlib.Path("size").write_text(re.search(r"VmHWM:\\s+(\\d+) kB", status)[1])
atexit.register(tell)
from smarttac_can.paper import experiments
from smarttac_can.cli import main
experiments.PASSES = 10
main(["demo"])
"""


def test_the_demo_takes_less_than_500_mb(tmp_path: Path) -> None:
    """By what it says itself: the system counts what it forked from, too."""
    subprocess.run([sys.executable, "-c", DEMO], cwd=tmp_path, capture_output=True, check=True)
    assert int((tmp_path / "size").read_text()) * 1024 < 500e6


def test_a_running_node_takes_less_than_120_mb(multicast: dict[str, Any]) -> None:
    with (
        processes(multicast, "node --lockstep") as (node,),
        Stimulator.connect(**multicast, lockstep=True) as bench,
    ):
        bench.run(0.3)
        status = Path(f"/proc/{node.process.pid}/status")
        if status.exists():
            peak = next(line for line in status.read_text().splitlines() if "VmHWM" in line)
            assert int(peak.split()[1]) < 120_000, peak
        assert psutil.Process(node.process.pid).memory_info().rss < 120e6

"""What a process of the command takes."""

import subprocess
import sys
from pathlib import Path

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


def test_a_node_does_not_load_what_only_reports_need() -> None:
    code = "import smarttac_can.cli.nodes, sys; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = set(done.stdout.split())
    assert not {"matplotlib", "scipy", "pytest", "hypothesis"} & loaded

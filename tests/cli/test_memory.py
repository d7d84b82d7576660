"""What a process of the command takes."""

import os
import subprocess
import sys
from pathlib import Path

DEMO = """
from smarttac_can.paper import experiments
from smarttac_can.cli import main
experiments.PASSES = 10
main(["demo"])
"""


def test_the_demo_takes_less_than_500_mb(tmp_path: Path) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", DEMO],
        cwd=tmp_path,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    ) as child:
        _, status, usage = os.wait4(child.pid, 0)
        child.returncode = os.waitstatus_to_exitcode(status)
    assert child.returncode == 0
    # In KiB on Linux, in bytes on macOS.
    assert usage.ru_maxrss * (1 if sys.platform == "darwin" else 1024) < 500e6


def test_a_node_does_not_load_what_only_reports_need() -> None:
    code = "import smarttac_can.cli, sys; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = set(done.stdout.split())
    assert "smarttac_can.cli.nodes" in loaded
    assert not {"matplotlib", "scipy", "pytest", "hypothesis"} & loaded

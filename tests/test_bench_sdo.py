"""``tools/bench_sdo``: what it gives, not how good a machine is."""

import json
import subprocess
import sys
from pathlib import Path

TOOL = Path(__file__).parents[1] / "tools" / "bench_sdo"


def test_the_results() -> None:
    process = subprocess.run(
        [sys.executable, TOOL, "--reads", "20", "--bytes", "5000", "--transfers", "2", "--json"],
        capture_output=True,
        text=True,
        check=False,
    )
    if not process.stdout:
        # A machine that is too busy may trip the loop before there are results, and has to say so.
        assert process.returncode == 1
        assert process.stderr.splitlines()[-1].startswith("Error: ")
        assert "changed the data" not in process.stderr
        return
    results = json.loads(process.stdout)
    assert process.returncode == bool(results["trips"])
    assert results["transfers"] == 2
    assert 0 < results["answer_p50_ms"] <= results["answer_p99_ms"]
    assert results["bare_frames_per_s"] > 0
    for way in ("down", "up"):
        assert results[f"block_{way}load_share_of_bare"] > 0

"""Each script of the gallery runs, prints the text of its page, and draws its figure."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SCRIPTS = sorted((ROOT / "examples" / "gallery").glob("*.py"))
MOST_LINES = 60
RUN = """
import runpy, sys
import matplotlib.pyplot as plt
plt.show = lambda: plt.savefig(sys.argv[2])
runpy.run_path(sys.argv[1], run_name="__main__")
"""
SAID = {
    "plot_1_step": ["pi: 0.95 um after 5 ms", "predictive: 0.95 um after 2 ms"],
    "plot_2_temperature": ["resonance 43530 Hz at 10 degC, 43250 Hz at 30 degC"],
    "plot_3_friction": ["subject 2: 71 % of the friction is left at 2 um"],
    "plot_4_texture": ["3 passes, rms difference 0.011"],
    "plot_5_own_finger": ["median COF 0.350"],
    "plot_6_staircase": ["threshold 0.040 after 43 trials"],
    "plot_7_fault": ["node 32: fault: a sensor is stuck", "node 32: state: fault"],
    "plot_8_bluesky": ["'plate-amplitude': 0.4,", "'plate-cof': 0.321"],
}


def test_there_are_eight_short_ones() -> None:
    assert [script.stem for script in SCRIPTS] == list(SAID)
    for script in SCRIPTS:
        assert len(script.read_text("utf-8").splitlines()) <= MOST_LINES, script.name


@pytest.mark.long  # the site draws them all
@pytest.mark.parametrize("script", SCRIPTS, ids=[script.stem for script in SCRIPTS])
def test_it_runs_and_draws(script: Path, tmp_path: Path) -> None:
    picture = tmp_path / "figure.png"
    done = subprocess.run(
        [sys.executable, "-c", RUN, script, picture],
        cwd=tmp_path, env={**os.environ, "MPLBACKEND": "Agg"}, capture_output=True, text=True,
        timeout=240, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    for said in SAID[script.stem]:
        assert said in done.stdout
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert picture.stat().st_size > 10_000


def test_only_the_packages_of_the_extra_are_imported() -> None:
    imported = {
        name
        for script in SCRIPTS
        for name in re.findall(r"^(?:from|import) (\w+)", script.read_text("utf-8"), re.MULTILINE)
    }
    extra = {"SweetSpot", "bluesky", "ophyd_async"}
    assert imported == {"asyncio", "matplotlib", "numpy", "smarttac_can"} | extra

"""``tools/soak.py`` makes a page of the report of a soak."""

import json
import runpy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from smarttac_can.trials.soak import WHAT, SoakReport

TOOL = Path(__file__).parents[2] / "tools" / "soak.py"


@pytest.fixture
def report() -> dict[str, Any]:
    margins = {
        name: {"off": 0.0, "amplitude_resonance": 0.333}
        for name, what in WHAT.items()
        if what != "event"
    }
    return SoakReport(
        seed=3,
        simulated_s=86_401.5,
        driving_s={"open_loop": 120.4},
        friction_law_s={"predictive": 60.2},
        vibration_law_s={"pi": 80.6},
        faults={"S1 dead": 7},
        tripped={"vibration above its limit": 5},
        margins=margins,
        rss_mib=[50.1, 53.2, 52.0],
        wall_s=8640.15,
        fingerprint="0123abcd",
    ).as_json()


@pytest.fixture
def page() -> Callable[[dict[str, Any]], str]:
    made: Callable[[dict[str, Any]], str] = runpy.run_path(str(TOOL))["page"]
    return made


def test_page_of_a_report(page: Callable[[dict[str, Any]], str], report: dict[str, Any]) -> None:
    lines = page(json.loads(json.dumps(report))).splitlines()
    for line in (
        "| Simulated time | 24.00 h |",
        "| Speed | 10 times real time on one core |",
        "| Runs ended by set-points at random: vibration above its limit | 5 |",
        "| Size of the process | 50.1 MiB after a minute, 53.2 MiB at most |",
        "| **Violated invariants** | **0** |",
        "| Watch | Level | off | amplitude resonance |",
        "| nmt | event |  |  |",
        "| gauges | cycles with a contradiction, of what is a fault | 0.00 | 0.33 |",
        "| friction: predictive | 60 |",
        "| vibration: pi | 81 |",
        "| S1 dead | 7 |",
    ):
        assert line in lines
    assert lines[2].startswith("`smarttac soak --hours 24 --seed 3`;")


def test_violations_are_on_the_page(
    page: Callable[[dict[str, Any]], str], report: dict[str, Any]
) -> None:
    report |= {"violated": 1, "violations": ["cycle 5: it"]}
    assert page(report).splitlines()[-1] == "- cycle 5: it"

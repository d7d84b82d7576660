"""A long soak is the same whatever the number of processes, and ends when it is told to."""

import json
import subprocess
import sys

import pytest

from smarttac_can.trials.margins import WHAT
from smarttac_can.trials.soak_parts import Part, parts, soak_in_parts
from smarttac_can.trials.soak_report import SoakReport, merged

HOUR = 3_600_000


def test_an_hour_is_one_part() -> None:
    assert parts(1, 7) == [Part(1, 7)]
    assert parts(HOUR, 7) == [Part(HOUR, 7)]


@pytest.mark.parametrize(("hours", "count"), [(1.5, 2), (4.0, 4), (24.0, 24), (24.01, 25)])
def test_parts_are_equal_and_have_seeds_of_their_own(hours: float, count: int) -> None:
    cycles = round(hours * HOUR)
    found = parts(cycles, 2**32 - 1)
    assert len(found) == count
    assert sum(part.cycles for part in found) == cycles
    assert max(part.cycles for part in found) - min(part.cycles for part in found) <= 1
    assert found[0].seed == 2**32 - 1
    assert len({part.seed for part in found}) == count
    assert all(0 <= part.seed < 2**32 for part in found)


def report(seed: int, **more: object) -> SoakReport:
    margins = {name: {"off": 0.1 * seed} for name, what in WHAT.items() if what != "event"}
    values = {
        "simulated_s": 1.5,
        "violated": 0,
        "runs": 2,
        "driving_s": {"open_loop": 0.25, "friction": 0.5},
        "friction_law_s": {"measured": 0.125, "predictive": 0.375},
        "vibration_law_s": {"pi": 0.5, "predictive": 0.0},
        "faults": {"S1 dead": 1},
        "latched": 1,
        "tripped": {},
        "margins": margins,
        "tolerated": {"drives twice": 1},
        "emergencies": 3,
        "master_restarts": 1,
        "transfers": 4,
        "rss_mib": [50.0 + seed],
        "fingerprint": f"0000000{seed}",
        "wall_s": 0.5,
    }
    return SoakReport(seed, **{**values, **more})  # type: ignore[arg-type]


def test_report_of_one_part_is_its_own() -> None:
    one = report(1)
    assert merged([one]) is one


def test_reports_are_added_up() -> None:
    first = report(1, violated=1, violations=["cycle 5: it"], tripped={"a": 1})
    second = report(2, faults={"S1 dead": 2, "bus-off": 1}, tripped={"a": 1, "b": 2})
    both = merged([first, second])
    assert both.seed == 1
    assert (both.simulated_s, both.wall_s, both.speed) == (3.0, 1.0, 3.0)
    assert (both.runs, both.latched, both.emergencies) == (4, 2, 6)
    assert (both.master_restarts, both.transfers) == (2, 8)
    assert both.driving_s == {"open_loop": 0.5, "friction": 1.0}
    assert both.friction_law_s == {"measured": 0.25, "predictive": 0.75}
    assert both.vibration_law_s == {"pi": 1.0, "predictive": 0.0}
    assert list(both.faults.items()) == [("S1 dead", 3), ("bus-off", 1)]
    assert both.tripped == {"a": 2, "b": 2}
    assert both.tolerated == {"drives twice": 2}
    assert both.margins["gauges"] == {"off": 0.2}
    assert both.rss_mib == [51.0, 52.0]
    assert both.violated == 1 and not both.passed
    assert both.violations == ["part 1 of seed 1, cycle 5: it"]


def test_fingerprint_depends_on_every_part_and_on_their_order() -> None:
    first, second, third = report(1), report(2), report(3)
    fingerprints = {
        merged(reports).fingerprint
        for reports in ([first, second], [second, first], [first, third], [first, second, third])
    }
    assert len(fingerprints) == 4


def test_only_the_first_violations_of_all_parts_are_kept() -> None:
    lines = [f"cycle {n}: it" for n in range(15)]
    both = merged([report(n, violated=15, violations=lines) for n in (1, 2)])
    assert both.violated == 30
    assert len(both.violations) == 20


def test_progress_goes_over_all_parts() -> None:
    shares: list[float] = []
    soak_in_parts([Part(500, 1), Part(500, 2)], progress=shares.append)
    assert shares == sorted(shares) and shares[-1] == 1.0
    assert any(0.0 < share <= 0.5 for share in shares)


TWO_JOBS = """
import json, sys
from smarttac_can.trials.soak_parts import Part, soak_in_parts
shares = []
report = soak_in_parts(
    [Part(4000, 5), Part(3000, 6), Part(2000, 7)], jobs=int(sys.argv[1]), progress=shares.append
)
print(json.dumps({**report.as_json(), "shares": shares}))
"""


def test_two_processes_give_the_same_report() -> None:
    found = []
    for jobs in ("1", "2"):
        # A process of its own: that of multiprocessing which tracks resources outlives the pool.
        done = subprocess.run(
            [sys.executable, "-c", TWO_JOBS, jobs], check=True, capture_output=True, text=True
        )
        made = json.loads(done.stdout)
        shares = made.pop("shares")
        assert shares == sorted(shares) and shares[-1] == 1.0
        for key in ("wall_s", "speed", "rss_mib"):
            del made[key]
        found.append(made)
    assert found[0] == found[1]
    assert found[0]["simulated_s"] >= 9.0

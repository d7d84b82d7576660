"""What a soak did, for programs and readers."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Any
from zlib import crc32

from smarttac_can.trials.invariants import MOST_VIOLATIONS
from smarttac_can.trials.margins import Table, largest


@dataclass
class SoakReport:
    """What a soak did, and what did not hold."""

    seed: int
    simulated_s: float = 0.0
    violated: int = 0
    violations: list[str] = field(default_factory=list)
    runs: int = 0
    driving_s: dict[str, float] = field(default_factory=dict)
    friction_law_s: dict[str, float] = field(default_factory=dict)
    """Seconds with a voltage by friction law, in the modes in which one acts."""
    vibration_law_s: dict[str, float] = field(default_factory=dict)
    """The same by vibration law."""
    faults: dict[str, int] = field(default_factory=dict)
    """How often each fault was injected, all while driving."""
    latched: int = 0
    """How many of them ended in FAULT, the others in a restart."""
    tripped: dict[str, int] = field(default_factory=dict)
    """How often set-points at random ended a run, by what was seen at the plate to be the cause."""
    margins: Table = field(default_factory=dict)
    """How near each watch came to a fault, 1.0, while nothing was broken, mode by mode."""
    tolerated: dict[str, int] = field(default_factory=dict)
    emergencies: int = 0
    master_restarts: int = 0
    transfers: int = 0
    """Acts of the master beside the scenes."""
    rss_mib: list[float] = field(default_factory=list)
    """Size of the process at simulated minutes; empty where the system does not say."""
    fingerprint: str = ""
    """Check sum of the voltage in every cycle: the same for the same seed and time."""
    wall_s: float = 0.0

    @property
    def passed(self) -> bool:
        """Whether everything held."""
        return self.violated == 0

    @property
    def speed(self) -> float:
        """Simulated time over real time."""
        return self.simulated_s / self.wall_s if self.wall_s else 0.0

    def as_json(self) -> dict[str, Any]:
        """Return the report as JSON has it."""
        return asdict(self) | {"passed": self.passed, "speed": round(self.speed, 1)}


def merged(reports: Sequence[SoakReport]) -> SoakReport:
    """Return the report of a soak from those of its parts, one or more, in their order.

    That of one part is its own. The fingerprint of several is the check sum of theirs, and their
    wall time is that of all processes together.
    """
    if len(reports) == 1:
        return reports[0]
    return SoakReport(
        seed=reports[0].seed,
        simulated_s=round(sum(r.simulated_s for r in reports), 3),
        violated=sum(r.violated for r in reports),
        violations=[
            f"part {n} of seed {r.seed}, {line}"
            for n, r in enumerate(reports, 1)
            for line in r.violations
        ][:MOST_VIOLATIONS],
        runs=sum(r.runs for r in reports),
        driving_s=_seconds([r.driving_s for r in reports]),
        friction_law_s=_seconds([r.friction_law_s for r in reports]),
        vibration_law_s=_seconds([r.vibration_law_s for r in reports]),
        faults=_sum([r.faults for r in reports]),
        latched=sum(r.latched for r in reports),
        tripped=_sum([r.tripped for r in reports]),
        margins=largest([r.margins for r in reports]),
        tolerated=_sum([r.tolerated for r in reports]),
        emergencies=sum(r.emergencies for r in reports),
        master_restarts=sum(r.master_restarts for r in reports),
        transfers=sum(r.transfers for r in reports),
        rss_mib=[mib for r in reports for mib in r.rss_mib],
        fingerprint=f"{crc32(' '.join(r.fingerprint for r in reports).encode()):08x}",
        wall_s=round(sum(r.wall_s for r in reports), 2),
    )


def _seconds(times: Sequence[dict[str, float]]) -> dict[str, float]:
    return {name: round(sum(time[name] for time in times), 3) for name in times[0]}


def _sum(counts: Sequence[dict[str, int]]) -> dict[str, int]:
    total: Counter[str] = Counter()
    for count in counts:
        total.update(count)
    return dict(sorted(total.items()))

"""What a soak did, for programs and readers."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

from smarttac_can.trials.margins import Table


@dataclass
class SoakReport:
    """What a soak did, and what did not hold."""

    seed: int
    simulated_s: float = 0.0
    violated: int = 0
    violations: list[str] = field(default_factory=list)
    runs: int = 0
    driving_s: dict[str, float] = field(default_factory=dict)
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

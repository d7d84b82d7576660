"""How large the process is while simulated time passes."""

from __future__ import annotations

from pathlib import Path
from typing import Final

SAMPLE_CYCLES: Final = 60_000
"""Cycles between two samples: a simulated minute."""
RSS_GROWTH_MIB: Final = 8.0
"""How much the process may grow after its first two simulated minutes."""
_WARM_UP_SAMPLES: Final = 2
_PAGE: Final = 4096


class ProcessSize:
    """Samples of the size of this process.

    Attributes
    ----------
    mib
        Sizes in MiB; empty where the system does not say.
    """

    def __init__(self) -> None:
        self.mib: list[float] = []

    def sample(self) -> None:
        """Take a sample."""
        try:
            pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
        except OSError:
            return
        self.mib.append(round(pages * _PAGE / 2**20, 1))

    def complaint(self) -> str | None:
        """Say how much the process grew if that is too much, else None."""
        sizes = self.mib[_WARM_UP_SAMPLES:]
        if sizes and max(sizes) - sizes[0] > RSS_GROWTH_MIB:
            return f"the process grew from {sizes[0]} to {max(sizes)} MiB"
        return None

"""What may happen to frames on their way to a bus."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from smarttac_can.od.cia import CAN_ID_MASK


class FrameFault(Enum):
    """What happens to a frame between its sender and the bus."""

    LOSS = "loss"
    """It is never sent."""
    DUPLICATION = "duplication"
    """It is sent twice in a row."""
    REORDERING = "reordering"
    """It is sent after the sender's next frame."""
    DELAY = "delay"
    """It is sent some cycles later, before the sender's own frames of that cycle."""
    CORRUPTION = "corruption"
    """One bit of its data is another, as from a bad memory: the CAN controller's CRC is right."""


def require_can_id(can_id: int) -> None:
    """Raise ValueError for what is no identifier of 11 bits."""
    if not 0 <= can_id <= CAN_ID_MASK:
        raise ValueError(f"identifier {can_id:X}h is outside 0h..{CAN_ID_MASK:X}h")


@dataclass(frozen=True, slots=True)
class Disturbance:
    """Which frames a frame_fault befalls."""

    frame_fault: FrameFault
    can_ids: frozenset[int] = frozenset()
    """Identifiers; none stands for every frame."""
    share: float = 1.0
    """Share of these frames, 0..1, drawn at random."""
    cycles: int = 1
    """Cycles of a delay, 1 or more."""

    def __post_init__(self) -> None:
        if not 0.0 <= self.share <= 1.0:
            raise ValueError(f"share {self.share} is outside 0..1")
        if self.cycles < 1:
            raise ValueError(f"cycles {self.cycles} is below 1")
        for can_id in self.can_ids:
            require_can_id(can_id)

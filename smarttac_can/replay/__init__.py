"""A log of frames replayed: what a stimulator says to what it heard, against what it said then."""

from __future__ import annotations

from typing import TYPE_CHECKING

from smarttac_can._faces import lazily

if TYPE_CHECKING:
    from smarttac_can.replay.difference import Difference
    from smarttac_can.replay.replay import DifferenceError, Replay, Replayed

__all__ = ["Difference", "DifferenceError", "Replay", "Replayed"]

__getattr__ = lazily(
    __name__,
    {
        "Difference": "difference",
        "DifferenceError": "replay",
        "Replay": "replay",
        "Replayed": "replay",
    },
)

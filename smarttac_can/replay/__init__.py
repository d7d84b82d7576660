"""A log of frames replayed: what a stimulator says to what it heard, against what it said then."""

from smarttac_can.replay.replay import Difference, DifferenceError, Replay, Replayed

__all__ = ["Difference", "DifferenceError", "Replay", "Replayed"]

"""Replay of a log: compare the frames that a stimulator recomputes with those in the log."""

from smarttac_can.replay.replay import Difference, DifferenceError, Replay, Replayed

__all__ = ["Difference", "DifferenceError", "Replay", "Replayed"]

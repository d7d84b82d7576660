"""Replay of a log: compare the frames that a stimulator recomputes with those in the log."""

from smarttac_can.instrument.replay.difference import Difference
from smarttac_can.instrument.replay.replay import DifferenceError, Replay, Replayed, Unjudged

__all__ = ["Difference", "DifferenceError", "Replay", "Replayed", "Unjudged"]

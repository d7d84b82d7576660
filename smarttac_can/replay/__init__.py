"""A log of frames replayed: what a stimulator says to what it heard, against what it said then."""

from smarttac_can.replay.difference import Difference
from smarttac_can.replay.replay import DifferenceError, Replay, Replayed

__all__ = ["Difference", "DifferenceError", "Replay", "Replayed"]

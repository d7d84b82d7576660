"""SMARTTAC as a CANopen instrument: friction-modulation plate, nested controllers, two nodes."""

__version__ = "0.1.0"

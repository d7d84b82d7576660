"""Live view of a stimulator from the frames of its bus, and a screen for it."""

from smarttac_can.bench.watch.watcher import View, Watcher

__all__ = ["View", "Watcher"]

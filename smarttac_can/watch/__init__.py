"""What a bus tells of a stimulator, live: frames and time in, a view out, and a screen for it."""

from smarttac_can.watch.watcher import View, Watcher

__all__ = ["View", "Watcher"]

"""A bus inside one process, and what a bus and a node are to each other."""

from smarttac_can.canopen.bus.local_bus import LocalBus

__all__ = ["LocalBus"]

"""What a bus tells of a stimulator, live: frames and time in, a view out, and a screen for it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from smarttac_can._faces import lazily

if TYPE_CHECKING:
    from smarttac_can.watch.watcher import View, Watcher

__all__ = ["View", "Watcher"]

__getattr__ = lazily(
    __name__,
    {
        "View": "watcher",
        "Watcher": "watcher",
    },
)

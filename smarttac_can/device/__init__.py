"""A CiA 301 device that knows nothing of what it is used for: frames and time in, frames out."""

from __future__ import annotations

from typing import TYPE_CHECKING

from smarttac_can._faces import lazily

if TYPE_CHECKING:
    from smarttac_can.device.application import Application
    from smarttac_can.device.device import Device
    from smarttac_can.device.frame import Frame
    from smarttac_can.device.nmt import NMTState

__all__ = ["Application", "Device", "Frame", "NMTState"]

__getattr__ = lazily(
    __name__,
    {
        "Application": "application",
        "Device": "device",
        "Frame": "frame",
        "NMTState": "nmt",
    },
)

"""A CiA 301 device, independent of its application: frames and time in, frames out."""

from smarttac_can.device.device import Device
from smarttac_can.device.frame import Frame
from smarttac_can.device.nmt import NMTState
from smarttac_can.device.service import Application

__all__ = ["Application", "Device", "Frame", "NMTState"]

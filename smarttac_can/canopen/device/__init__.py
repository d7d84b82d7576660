"""A CiA 301 device, independent of its application: frames and time in, frames out."""

from smarttac_can.canopen.device.device import Device
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.device.nmt import NMTState
from smarttac_can.canopen.device.service import Application

__all__ = ["Application", "Device", "Frame", "NMTState"]

"""What an interface of python-can needs that python-can does not bring."""

from __future__ import annotations

from importlib.util import find_spec
from typing import Final, NamedTuple


class _Package(NamedTuple):
    module: str
    """What is imported."""
    pip: str
    """What pip installs it by."""


_SERIAL: Final = _Package("serial", "python-can[serial]")
_PACKAGES: Final = {
    "canalystii": _Package("canalystii", "python-can[canalystii]"),
    "cantact": _Package("cantact", "python-can[cantact]"),
    "gs_usb": _Package("gs_usb", "python-can[gs-usb]"),
    "neovi": _Package("ics", "python-can[neovi]"),
    "nixnet": _Package("nixnet", "python-can[nixnet]"),
    "robotell": _SERIAL,
    "seeedstudio": _SERIAL,
    "serial": _SERIAL,
    "slcan": _SERIAL,
    "udp_multicast": _Package("msgpack", "smarttac-can[multicast]"),
}
"""Packages by interface, as the extras of python-can 4.6 name them."""
_MAKERS: Final = {
    "etas": "BOA of ETAS",
    "ixxat": "VCI of HMS",
    "kvaser": "CANlib of Kvaser",
    "nican": "NI-CAN of National Instruments",
    "pcan": "PCAN-Basic of PEAK-System",
    "systec": "USBCAN of SYS TEC",
    "usb2can": "USB2CAN of 8devices",
    "vector": "XL Driver Library of Vector",
}
"""Libraries that come with the adapter, and not from PyPI."""


def cure(interface: str | None) -> str:
    """Say what may be missing when an interface of python-can could not be opened.

    Returns
    -------
    str
        To be put behind the error; empty if nothing is known to be missing.
    """
    package = _PACKAGES.get(interface or "")
    if package is not None and find_spec(package.module) is None:
        return f"; it needs a package: pip install '{package.pip}'"
    if interface in _MAKERS:
        return f"; is the library {_MAKERS[interface]} installed?"
    return ""

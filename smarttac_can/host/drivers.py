"""Additions to the interfaces of python-can: missing packages, unknown options, clear errors."""

from __future__ import annotations

import errno
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from difflib import get_close_matches
from importlib import import_module
from importlib.util import find_spec
from inspect import signature
from traceback import walk_tb
from types import FunctionType
from typing import Final, NamedTuple


class _Package(NamedTuple):
    module: str
    """Name of the module to import."""
    pip: str
    """Name of the package for pip."""


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
_OF_ALL: Final = ("can_filters", "config_context", "fd", "ignore_config", "timing")
"""Options of python-can itself."""
_NOT_LISTED: Final = frozenset({"self", "args", "kwargs", "kwds", "channel", "bitrate"})
"""Arguments of a driver that are not options, or have their own argument here."""
_NO_ROUTE: Final = (
    "no route to the group: ip link set lo up; for IPv4 ip route add 239.0.0.0/8 dev lo"
)
_NO_GROUP: Final = "name the group as the channel, such as --channel 239.74.163.2"
"""Without a channel, python-can uses an IPv6 group, to which many computers have no route."""
_NO_BUS: Final = (
    "no bus was named: give interface and channel, such as --interface socketcan --channel can0 "
    "(in Python interface='socketcan', channel='can0'), "
    "or set them in python-can's configuration (CAN_INTERFACE, CAN_CHANNEL, ~/.canrc)"
)
_PORT_TAKEN: Final = (
    "UDP port {} is taken by another program, or by nodes of another user, which ss -ulnp shows: "
    "end that, or give all that share the bus another port, --bus-option port=N"
)
_NO_SOCKETCAN: Final = (
    "this kernel has no SocketCAN; udp_multicast needs none, and tools/with-vcan has its own"
)
_BY_NUMBER: Final[dict[tuple[str | None, int | None], str]] = {
    ("socketcan", errno.EAFNOSUPPORT): _NO_SOCKETCAN,
    ("socketcan", errno.ENODEV): "there is no such interface; ip link lists those there are",
    ("udp_multicast", errno.ENODEV): _NO_ROUTE,
    ("udp_multicast", errno.ENETUNREACH): _NO_ROUTE,
    ("udp_multicast", errno.EADDRNOTAVAIL): _NO_ROUTE,
    ("udp_multicast", errno.EINVAL): "the channel has to be a group, such as 239.74.163.2",
}
"""Meaning of the error number of the system, by interface."""
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
"""Libraries that come with the adapter and not from PyPI."""


def unknown_options(interface: str | None, names: Iterable[str]) -> list[str]:
    """Return the options that an interface of python-can would silently ignore.

    The result is empty for an unknown interface, and for one whose driver is missing.

    Returns
    -------
    list of str
        A line per option, with a similar known option, or else with all known ones.
    """
    from can.interfaces import BACKENDS  # noqa: PLC0415 - not loaded when no bus is used

    place = BACKENDS.get(interface or "")
    if place is None:
        return []
    module, name = place
    try:
        backend = getattr(import_module(module), name)
    except Exception:  # noqa: BLE001 - drivers raise any error; opening the bus reports it
        return []
    inits = [vars(kind).get("__init__") for kind in backend.__mro__]
    own = [init for init in inits if isinstance(init, FunctionType)]
    named = {name for init in own for name in signature(init).parameters}
    # Some drivers read options from ``**kwargs``; their names are constants of the code.
    known = {*_OF_ALL, *named, *(text for init in own for text in init.__code__.co_consts)}
    listed = sorted(named - _NOT_LISTED)
    return [
        f"{interface} has no option {name!r}{_perhaps(name, known, listed)}"
        for name in names
        if name not in known
    ]


def _perhaps(name: str, known: Iterable[object], listed: list[str]) -> str:
    """Return a hint after a refusal: similar names, or else all known ones."""
    words = [text for text in known if isinstance(text, str) and text.isidentifier()]
    if near := get_close_matches(name, words, 1):
        return f"; perhaps {near[0]!r}"
    return f"; it has such as {', '.join(listed)}" if listed else ""


@contextmanager
def opening(
    interface: str | None, channel: object, kind: Callable[[str], Exception]
) -> Iterator[None]:
    """If a block cannot open a bus of python-can, raise an error with the cause and the cure.

    Parameters
    ----------
    interface, channel
        Interface and channel as given; None if they come from python-can's configuration.
    kind
        Class of the error to raise.
    """
    try:
        yield
    except Exception as error:  # drivers raise any error, even NameError
        _close_half_made(error)
        raise kind(_cannot_open(interface, channel, error)) from error


def _close_half_made(error: BaseException) -> None:
    """Close a bus whose constructor has failed: only the exception still refers to it."""
    from can import BusABC  # noqa: PLC0415 - not loaded when no bus is used

    for frame, _ in walk_tb(error.__traceback__):
        made = frame.f_locals.get("self")
        if isinstance(made, BusABC):
            # Only the driver knows which parts of it exist.
            with suppress(Exception):
                made.shutdown()


def _is_taken(system: BaseException) -> bool:
    return isinstance(system, OSError) and system.errno == errno.EADDRINUSE


def _port(error: BaseException) -> object:
    for frame, _ in walk_tb(error.__traceback__):
        if (port := getattr(frame.f_locals.get("self"), "port", None)) is not None:
            return port
    return "of the bus"


def _cannot_open(interface: str | None, channel: object, error: BaseException) -> str:
    if interface is None:
        if '"None"' in str(error):  # python-can's text for a missing interface
            return _NO_BUS
        asked = "bus of python-can's configuration (no interface was given)"
    elif channel:
        asked = f"{interface} bus, channel {channel}"
    elif (configured := _configured_channel(interface)) is not None:
        asked = f"{interface} bus, channel {configured} of python-can's configuration"
    else:
        asked = f"{interface} bus, which has no channel"
        system = error.__cause__ or error
        no_route = isinstance(system, OSError) and not _is_taken(system)
        if interface == "udp_multicast" and no_route:
            return f"cannot open the {asked}: {error}; {_NO_GROUP}"
    return f"cannot open the {asked}: {error}{cure(interface, error)}"


def _configured_channel(interface: str) -> object:
    """Return the channel of an interface in python-can's configuration; None if there is none."""
    from can.util import load_config  # noqa: PLC0415 - not loaded when no bus is used

    # The user must see the error about the interface, not one of the configuration here.
    with suppress(Exception):
        return load_config(config={"interface": interface})["channel"]
    return None


def cure(interface: str | None, error: BaseException) -> str:
    """Return a hint on what is missing when an interface of python-can could not be opened.

    Parameters
    ----------
    error
        Error raised by opening it.

    Returns
    -------
    str
        Text to append to the error; empty if nothing is known to be missing.
    """
    from can.interfaces import BACKENDS  # noqa: PLC0415 - slow, and the bench needs no bus

    if interface is not None and interface not in BACKENDS:
        return _perhaps(interface, BACKENDS, []) or f"; there are {', '.join(sorted(BACKENDS))}"
    package = _PACKAGES.get(interface or "")
    if package is not None and find_spec(package.module) is None:
        return f"; it needs a package: pip install '{package.pip}'"
    system = error.__cause__ or error
    if interface == "udp_multicast" and _is_taken(system):
        return f"; {_PORT_TAKEN.format(_port(error))}"
    if isinstance(system, OSError) and (interface, system.errno) in _BY_NUMBER:
        return f"; {_BY_NUMBER[interface, system.errno]}"
    if interface in _MAKERS:
        return f"; is the library {_MAKERS[interface]} installed?"
    return ""

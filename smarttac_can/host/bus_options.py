"""The options that a bus of python-can is opened with."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, cast

from can.util import load_config

_THIS_COMPUTER: Final = 0
"""Hop limit of IP; 1 is the network that the computer is in."""


def configured(options: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the options that `can.Bus` makes of these: with its files, and texts understood."""
    if options.get("ignore_config"):
        return options
    # Which bus it is comes from the configuration if it is not given.
    left = [key for key in ("interface", "channel") if options.get(key) is None]
    given = {key: value for key, value in options.items() if key not in left}
    context = options.get("config_context", options.get("context"))  # its older name
    return cast("Mapping[str, Any]", load_config(config=given, context=context))


def kept_here(options: Mapping[str, Any]) -> dict[str, Any]:
    """Return options of `can.Bus` with which frames of udp_multicast stay on this computer.

    Unless ``hop_limit`` is among the options or in python-can's configuration. By python-can's own
    default they go out into the local network, to whoever uses the same group there.
    """
    known = configured(options)
    if known.get("interface") != "udp_multicast" or "hop_limit" in known:
        return dict(options)
    return {**options, "hop_limit": _THIS_COMPUTER}

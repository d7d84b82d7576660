"""A CAN data or remote frame with an 11-bit identifier."""

from __future__ import annotations

from typing import NamedTuple


class Frame(NamedTuple):
    """One classical CAN frame, the only input and output of a device."""

    can_id: int
    """Identifier, 0..0x7FF."""
    data: bytes = b""
    """0..8 data bytes; empty in a remote frame."""
    rtr: bool = False
    """True for a remote frame."""

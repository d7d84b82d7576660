"""Whether a stimulator keeps the time that its link believes in: SYNC's, or the clock's."""

from __future__ import annotations

from collections.abc import Iterable
from time import monotonic, sleep
from typing import Final

from smarttac_can.bench.published import PublishedPdo
from smarttac_can.bench.remote_device import RemoteDevice

_SETTLE_S: Final = 0.1
"""What still comes of the last SYNC has come by then."""
_EVENT_S: Final = 0.25
"""In real time the event timers of the TPDOs, 0.1 s by default, send within it."""
_HEARTBEATS: Final = 3
_POLL_S: Final = 0.01


def wrong_time(device: RemoteDevice, pdos: Iterable[PublishedPdo], lockstep: bool) -> str:
    """Listen without sending SYNC, and say that the link is for another time; empty if it is not.

    Parameters
    ----------
    device
        The stimulator, OPERATIONAL.
    pdos
        Its TPDOs, whose times of arrival are those of `time.monotonic`.
    lockstep
        Whether the link produces the SYNC.
    """
    node = f"node {device.od.node_id}"
    if lockstep:
        sleep(_SETTLE_S)
        if _speaks(device, pdos, _EVENT_S):
            return (
                f"{node} runs in real time: connect without lockstep=True, or start all nodes with "
                "--lockstep"
            )
    elif device.heartbeat_s and not _speaks(device, pdos, _HEARTBEATS * device.heartbeat_s):
        return (
            f"the time of {node} stands still without SYNC: connect with lockstep=True, or start "
            "all nodes without --lockstep"
        )
    return ""


def _speaks(device: RemoteDevice, pdos: Iterable[PublishedPdo], seconds: float) -> bool:
    """Tell whether a heartbeat or TPDO comes within a time in s."""
    begun = monotonic()
    while monotonic() - begun < seconds:
        heard = [device.heartbeat_at, *(pdo.received for pdo in pdos)]
        if any(at is not None and at > begun for at in heard):
            return True
        sleep(_POLL_S)
    return False

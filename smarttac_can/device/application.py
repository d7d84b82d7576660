"""What a device tells its application."""

from __future__ import annotations

from typing import Any

from smarttac_can.device.nmt import NMTState
from smarttac_can.od.entry import Entry


class Application:
    """Hooks, all of which do nothing until overridden.

    They run inside `Device.start`, `receive` and `advance`; what the application triggers in them
    goes out with the frames that call returns.
    """

    def on_state(self, state: NMTState) -> None:
        """Follow the NMT state.

        RESET_APPLICATION comes with all objects at their defaults, RESET_COMMUNICATION with those
        of the communication profile area, before the services read them: the place to put
        in other values, whose PDO and other parameters then are in force from the boot-up on.
        """

    def on_sync(self) -> bool:
        """Act at SYNC, in PRE-OPERATIONAL and OPERATIONAL; return whether to sample TPDOs.

        The values of synchronous RPDOs are in force by then. On False the synchronous TPDOs miss
        this SYNC.
        """
        return True

    def on_rpdo(self, number: int) -> None:
        """Act on an RPDO, from 1, whose values are in the object dictionary."""

    def on_loop_rpdo(self, number: int, data: bytes) -> None:
        """Act on the bytes of an RPDO, from 1, that is in `loop_rpdos` of the device.

        Length and limits have been checked. It is called instead of `on_rpdo`, and the application
        itself writes the object dictionary.
        """

    def on_rpdo_timeout(self, number: int, late: bool) -> None:
        """Act on an RPDO, from 1, that is late, or is not late any more.

        It is late from its deadline on, until it comes (then before `on_rpdo`) or is no longer
        waited for.
        """

    def on_error_control(self, node_id: int, lost: bool) -> None:
        """Act on the heartbeat of a watched node that is lost, or heard again.

        It comes before what the error behaviour object asks for. Node-ID 0 is life guarding.
        """

    def on_heartbeat(self, node_id: int, state: int) -> None:
        """Act on a heartbeat of a watched node with its NMT state, INITIALISING at its boot-up.

        It comes after `on_error_control`.
        """

    def on_collision(self, heard: bool) -> None:
        """Act on another device that sends with an identifier of this one, or does no more.

        It comes once for all the frames of such devices, until there is none for 3 s; nor does it
        come when a reset forgets them.
        """

    def on_store(self) -> None:
        """Refuse, by raising `Abort`, to store parameters now: it may take a while."""

    def on_emergency(self, code: int) -> None:
        """Act on an emergency message of the node that the device listens to."""

    def on_parameters(self) -> None:
        """Act on parameters of a service that were written by SDO, and are in force."""

    def on_write(self, entry: Entry, value: Any) -> None:
        """Refuse an SDO write by raising `Abort`; the entry still has its old value."""

    def on_refused(self, name: str, reason: str) -> None:
        """Act on an SDO write that was refused, by `on_write` or before it, with why in one line.

        The name is that of the entry; without an entry it has index and sub-index.
        """

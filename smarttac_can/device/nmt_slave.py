"""The NMT slave of a device (CiA 301, 7.3.2): power-on, resets, and the states that last."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from smarttac_can.device.application import Application
from smarttac_can.device.heartbeat import HeartbeatProducer
from smarttac_can.device.lss import LSS
from smarttac_can.device.nmt import NMTState, commands_to
from smarttac_can.device.service import Service
from smarttac_can.device.storage import ParameterStorage
from smarttac_can.od.cia import (
    COMMUNICATION_FIRST,
    COMMUNICATION_LAST,
    LAST_INDEX,
    NMT_STARTUP,
    UNCONFIGURED,
)
from smarttac_can.od.dictionary import ObjectDictionary

_NO_AUTOSTART: Final = 4


class NMTSlave:
    """Leads object dictionary, services and application through the NMT states.

    Parameters
    ----------
    od, application, autostart
        As for `Device`.
    listen
        Called in each state that lasts, when the services live or rest as it asks.

    Attributes
    ----------
    state
        Present NMT state; INITIALISING before the power is on.
    on_frame
        Takes NMT frames.
    """

    def __init__(
        self,
        od: ObjectDictionary,
        application: Application,
        autostart: bool,
        listen: Callable[[], None],
    ) -> None:
        self._od = od
        self._application = application
        self._autostart = autostart
        self._listen = listen
        self._off = True
        self.state = NMTState.INITIALISING
        self.on_frame = commands_to(lambda: self._lss.node_id, self._request)

    def lead(
        self,
        services: tuple[Service, ...],
        lss: LSS,
        storage: ParameterStorage,
        heartbeat: HeartbeatProducer,
    ) -> None:
        """Take the services, in the order in which they enter a state, and three that do more."""
        self._services = services
        self._lss = lss
        self._storage = storage
        self._heartbeat = heartbeat

    def power_on(self) -> None:
        """Begin as at power-on, whatever was before."""
        self._off = True
        self.begin()

    def begin(self) -> None:
        """Begin anew with the node-ID of LSS."""
        self._initialise(NMTState.RESET_APPLICATION)

    def enter(self, state: NMTState) -> None:
        """Enter a state that lasts."""
        self.state = state
        for service in self._services:
            service.enter(state)
        self._listen()
        self._application.on_state(state)

    def _request(self, state: NMTState) -> None:
        if state in (NMTState.RESET_APPLICATION, NMTState.RESET_COMMUNICATION):
            self._initialise(state)
        elif state != self.state and not self._off:
            self.enter(state)

    def _initialise(self, state: NMTState) -> None:
        self.state = state
        for service in self._services:
            service.enter(state)
        self._lss.node_id = self._lss.pending
        if self._lss.node_id == UNCONFIGURED:
            self._off = True
            self.enter(NMTState.INITIALISING)
            return
        self._od.renumber(self._lss.node_id)
        power_on = self._off or state is NMTState.RESET_APPLICATION
        first, last = (0, LAST_INDEX) if power_on else (COMMUNICATION_FIRST, COMMUNICATION_LAST)
        self._off = False
        self._od.reset(first, last)
        self._storage.restore(first, last)
        if power_on:
            self.state = NMTState.RESET_APPLICATION
            self._application.on_state(self.state)
        self.state = NMTState.RESET_COMMUNICATION
        self._application.on_state(self.state)
        self._storage.note_presets()
        for service in self._services:
            service.configure()
        self._heartbeat.boot_up()
        self._storage.report()
        self.enter(NMTState.PRE_OPERATIONAL)
        startup = self._od.number(NMT_STARTUP, absent=_NO_AUTOSTART)
        if power_on and (self._autostart or not startup & _NO_AUTOSTART):
            self.enter(NMTState.OPERATIONAL)

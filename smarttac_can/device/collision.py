"""Frames of another device with an identifier of this one: CiA 301 gives each to one device."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import ClassVar, Final

from smarttac_can.device.application import Application
from smarttac_can.device.frame import Frame
from smarttac_can.device.nmt import ALL_STATES
from smarttac_can.device.port import Port
from smarttac_can.device.service import Service
from smarttac_can.od.dictionary import ObjectDictionary

GONE_AFTER_US: Final = 3_000_000
"""Silence after which the other device counts as gone: three heartbeats of one a second."""


class Collision(Service):
    """Hears the identifiers that the device itself sends with; a bus gives no sender its own back.

    Remote frames do not count: they ask for a frame, and are anybody's.

    Parameters
    ----------
    services
        Gives those whose identifiers are heard.

    Attributes
    ----------
    can_id
        Identifier by which the other device was noticed, 0 while there is none.
    """

    states: ClassVar = ALL_STATES

    def __init__(
        self,
        port: Port,
        od: ObjectDictionary,
        application: Application,
        services: Callable[[], Iterable[Service]],
    ) -> None:
        super().__init__(port, od, ())
        self._application = application
        self._services = services
        self._timer = port.clock.timer(self._on_silence)
        self.can_id = 0

    def cease(self) -> None:
        """Forget the other device: a reset begins anew."""
        self._timer.stop()
        self.can_id = 0

    def listen(self) -> None:
        """Hear what is this device's alone."""
        for can_id in sorted({can_id for service in self._services() for can_id in service.sends}):
            self.port.listen(can_id, self._receive)

    def _receive(self, frame: Frame) -> None:
        if frame.rtr:
            return
        self._timer.start(GONE_AFTER_US)
        if not self.can_id:
            self.can_id = frame.can_id
            self._application.on_collision(True)

    def _on_silence(self) -> None:
        self.can_id = 0
        self._application.on_collision(False)

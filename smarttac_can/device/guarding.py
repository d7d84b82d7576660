"""Node and life guarding (CiA 301, 7.2.8.3.2.1); rests while the heartbeat is on."""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar

from smarttac_can.device.application import Application
from smarttac_can.device.emcy import Emergency
from smarttac_can.device.frame import Frame
from smarttac_can.device.nmt import ALL_STATES, NMTState
from smarttac_can.device.port import Port
from smarttac_can.device.service import Service
from smarttac_can.od.cia import (
    GUARD_TIME,
    HEARTBEAT_ID,
    HEARTBEAT_PRODUCER,
    LIFE_TIME_FACTOR,
    EmergencyCode,
    ErrorRegister,
)
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.od.entry import Entry

_TOGGLE = 0x80


class Guarding(Service):
    """Answers the master's remote frames with the NMT state, and misses them.

    The first remote frame starts the life guarding. Once none came for the life time, EMCY 8130h
    goes out; the next remote frame takes it back.

    Attributes
    ----------
    timer
        Runs from one remote frame to the next.
    """

    states: ClassVar = ALL_STATES

    def __init__(
        self,
        port: Port,
        od: ObjectDictionary,
        emergency: Emergency,
        application: Application,
        on_loss: Callable[[], None],
    ) -> None:
        super().__init__(port, od, (GUARD_TIME, LIFE_TIME_FACTOR, HEARTBEAT_PRODUCER))
        self._emergency = emergency
        self._application = application
        self._lost = False
        self._on_loss = on_loss
        self.timer = port.clock.timer(self._on_life_time)
        self._state = NMTState.INITIALISING
        self._toggle = 0
        self._active = False
        self._life_time = 0

    @property
    def in_time(self) -> bool:
        """Whether the master's remote frames come, and are missed if they do not."""
        return self.timer.running

    def configure(self) -> None:
        """Read the parameters; the guard time is in ms."""
        number = self.od.number
        supported = GUARD_TIME in self.od.objects and LIFE_TIME_FACTOR in self.od.objects
        self._active = supported and not number(HEARTBEAT_PRODUCER)
        self._life_time = 1000 * number(GUARD_TIME) * number(LIFE_TIME_FACTOR)
        self._toggle = 0

    def enter(self, state: NMTState | None) -> None:
        """Remember the NMT state, which the next answer carries."""
        if state is not None:
            self._state = state
        super().enter(state)

    def apply(self, entry: Entry) -> None:
        """Take new parameters; another life time counts from the last remote frame that came."""
        self.configure()
        if self.timer.running and self._active and self._life_time:
            self.timer.follow(self._life_time)
        else:
            super().apply(entry)

    def cease(self) -> None:
        """Wait for a first remote frame again."""
        self.timer.stop()
        self._found()

    def listen(self) -> None:
        """Listen to remote frames that ask for the NMT state, unless the heartbeat is on."""
        if self._active:
            self.port.listen(HEARTBEAT_ID + self.od.node_id, self.receive)

    def receive(self, frame: Frame) -> None:
        """Answer a remote frame with state and toggle bit, and begin the life time anew."""
        if not frame.rtr:
            return
        self.port.out.append(Frame(frame.can_id, bytes((self._toggle | self._state,))))
        self._toggle ^= _TOGGLE
        if self._life_time:
            self.timer.start(self._life_time)
            self._found()

    def _found(self) -> None:
        self._emergency.clear(EmergencyCode.ERROR_CONTROL)
        if self._lost:
            self._lost = False
            self._application.on_error_control(0, False)

    def _on_life_time(self) -> None:
        self._emergency.report(EmergencyCode.ERROR_CONTROL, ErrorRegister.COMMUNICATION)
        self._lost = True
        self._application.on_error_control(0, True)
        self._on_loss()

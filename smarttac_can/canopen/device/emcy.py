"""Emergency producer and consumer, and error behaviour (CiA 301, 7.2.7, 1001h to 1015h, 1029h)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar, Final

from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.device.nmt import ALL_STATES, CONFIGURABLE, NMTState
from smarttac_can.canopen.device.port import Port
from smarttac_can.canopen.device.service import Application, Service, check_cob_id, usable
from smarttac_can.canopen.od import cia
from smarttac_can.canopen.od.cia import Abort, AbortCode, EmergencyCode, ErrorRegister
from smarttac_can.canopen.od.data_types import UNSIGNED
from smarttac_can.canopen.od.dictionary import ObjectDictionary
from smarttac_can.canopen.od.entry import Entry

QUEUE_LENGTH: Final = 16
"""Most messages that wait for the inhibit time; beyond it the oldest one is dropped."""


class Emergency(Service):
    """Report each error once when it comes, and once as 0000h when it goes."""

    states: ClassVar = CONFIGURABLE

    def __init__(self, port: Port, od: ObjectDictionary) -> None:
        super().__init__(port, od, (cia.ERROR_FIELD, cia.EMCY_COB_ID, cia.EMCY_INHIBIT))
        self._active: dict[tuple[int, int], int] = {}
        self._queue: list[bytes] = []
        self._inhibit = port.clock.timer(self._send_next)
        self._inhibit_time = 0
        self._cob_id = cia.COB_INVALID
        self._register = od.get(cia.ERROR_REGISTER)
        field = od.objects.get(cia.ERROR_FIELD)
        members = {} if field is None else field.entries
        count = members.get(0)
        # A foreign EDS may give it any type.
        counts = count is not None and count.data_type in UNSIGNED
        self._count = count if counts else None
        self._history = [entry for subindex, entry in sorted(members.items()) if subindex]

    def report(self, code: int, register: int, vendor: bytes = b"", source: int = 0) -> None:
        """Report an error, unless it is already reported.

        Parameters
        ----------
        code
            Emergency error code.
        register
            Bits of the error register that the error sets; the generic bit is always added.
        vendor
            Up to 5 manufacturer-specific bytes; the first two also go into the history.
        source
            Number that distinguishes errors with the same code, such as the RPDO number.
        """
        if (code, source) in self._active:
            return
        self._active[code, source] = register | ErrorRegister.GENERIC
        vendor = vendor.ljust(5, b"\0")
        if self._history and self._count is not None:
            for newer, older in zip(self._history[-2::-1], self._history[:0:-1], strict=True):
                older.value = newer.value
            newest = code | int.from_bytes(vendor[:2], "little") << 16
            self._history[0].value = newest & (1 << 8 * self._history[0].size) - 1
            self._count.value = min(self._count.value + 1, len(self._history))
        self._enqueue(code, vendor)

    def clear(self, code: int, source: int = 0) -> bool:
        """Clear an error, and return whether there was one.

        When no error with this code is left, 0000h is sent.
        """
        if self._active.pop((code, source), None) is None:
            return False
        if any(other == code for other, _ in self._active):
            self._update_register()
        else:
            self._enqueue(EmergencyCode.RESET, bytes(5))
        return True

    def check_read(self, entry: Entry) -> None:
        """Refuse to read an unused entry of the history.

        Raises
        ------
        Abort
            NO_DATA for an unused entry.
        """
        used = self._history if self._count is None else self._history[: self._count.value]
        if entry in self._history and entry not in used:
            raise Abort(AbortCode.NO_DATA)

    def check(self, entry: Entry, value: Any) -> None:
        """Refuse any value but 0 for the history, and another CAN-ID while EMCY is valid."""
        if entry.index == cia.ERROR_FIELD and value != 0:
            raise Abort(AbortCode.VALUE)
        if entry.index == cia.EMCY_COB_ID:
            check_cob_id(entry, value)

    def apply(self, entry: Entry) -> None:
        """Clear the history, or apply the new COB-ID or inhibit time; active errors stay."""
        if entry.index == cia.ERROR_FIELD:
            for place in self._history:
                place.value = 0
        else:
            self._read_parameters()

    def configure(self) -> None:
        """Clear all errors and the queue, and read the parameters."""
        self._active.clear()
        self._queue.clear()
        self._update_register()
        self._read_parameters()

    def begin(self) -> None:
        """Send only the latest of the messages that have waited, as when STOPPED is left."""
        del self._queue[:-1]
        self._send_next()

    def cease(self) -> None:
        """Keep the waiting messages until EMCY may be sent again."""
        self._inhibit.stop()

    @property
    def can_id(self) -> int:
        """CAN-ID of the emergency messages."""
        return self._cob_id & cia.CAN_ID_MASK

    @property
    def sends(self) -> tuple[int, ...]:
        """CAN-ID of the emergency messages, if they are enabled."""
        return () if self._cob_id & cia.COB_INVALID else (self.can_id,)

    def _read_parameters(self) -> None:
        cob_id = self.od.number(cia.EMCY_COB_ID, absent=cia.COB_INVALID)
        self._cob_id = cob_id if usable(cob_id) else cia.COB_INVALID
        self._inhibit_time = 100 * self.od.number(cia.EMCY_INHIBIT)

    def _update_register(self) -> int:
        register = 0
        for bits in self._active.values():
            register |= bits
        if self._register is not None:
            self._register.value = register
        return register

    def _enqueue(self, code: int, vendor: bytes) -> None:
        register = self._update_register()
        self._queue.append(code.to_bytes(2, "little") + bytes((register,)) + vendor)
        del self._queue[:-QUEUE_LENGTH]
        if self.alive and not self._inhibit.running:
            self._send_next()

    def _send_next(self) -> None:
        if not self._queue:
            return
        data = self._queue.pop(0)
        if not self._cob_id & cia.COB_INVALID:
            self.port.out.append(Frame(self._cob_id & cia.CAN_ID_MASK, data))
        if self._inhibit_time:
            self._inhibit.start(self._inhibit_time)
        elif self._queue:
            self._send_next()


class EmergencyConsumer(Service):
    """Receive the emergency messages of a node at its default EMCY identifier.

    Parameters
    ----------
    node_id
        Node-ID, 1..127; 0 for none.
    """

    states: ClassVar = CONFIGURABLE

    def __init__(
        self, port: Port, od: ObjectDictionary, application: Application, node_id: int
    ) -> None:
        super().__init__(port, od, ())
        self._application = application
        self._node_id = node_id

    def listen(self) -> None:
        """Listen to the EMCY identifier of the node, if there is one."""
        if self._node_id:
            self.port.listen(cia.EMCY_ID + self._node_id, self._receive)

    def _receive(self, frame: Frame) -> None:
        if len(frame.data) == cia.FRAME_BYTES and not frame.rtr:
            self._application.on_emergency(int.from_bytes(frame.data[:2], "little"))


_COMMUNICATION: Final = 1
"""Sub-index of the behaviour at a communication error."""
_PRE_OPERATIONAL: Final = 0
_STOPPED: Final = 2


class ErrorBehaviour(Service):
    """Change the NMT state after a communication error, as the error behaviour object says.

    Parameters
    ----------
    enter_state
        Function that brings the device into another NMT state.
    """

    states: ClassVar = ALL_STATES

    def __init__(
        self, port: Port, od: ObjectDictionary, enter_state: Callable[[NMTState], None]
    ) -> None:
        super().__init__(port, od, (cia.ERROR_BEHAVIOUR,))
        self._enter_state = enter_state

    def check(self, entry: Entry, value: Any) -> None:
        """Refuse a value other than 0, 1 and 2, which CiA 301 defines."""
        if entry.subindex and not _PRE_OPERATIONAL <= value <= _STOPPED:
            raise Abort(AbortCode.VALUE)

    def apply(self, entry: Entry) -> None:
        """Do nothing: the value is read at the next error."""

    def react(self) -> None:
        """React to a communication error; without the object it ends OPERATIONAL."""
        behaviour = self.od.number(cia.ERROR_BEHAVIOUR, _COMMUNICATION, _PRE_OPERATIONAL)
        if behaviour == _PRE_OPERATIONAL and self.state is NMTState.OPERATIONAL:
            self._enter_state(NMTState.PRE_OPERATIONAL)
        elif behaviour == _STOPPED and self.alive and self.state is not NMTState.STOPPED:
            self._enter_state(NMTState.STOPPED)

"""What the services of CiA 301 have in common: NMT states, objects, who hears of it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, ClassVar

from smarttac_can.device.nmt import NMTState
from smarttac_can.device.port import Port
from smarttac_can.od.cia import (
    CAN_ID_MASK,
    COB_EXTENDED,
    COB_INVALID,
    STRUCTURE_SUBINDEX,
    Abort,
    AbortCode,
    restricted,
)
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.od.entry import MAX_BYTES, Entry


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


class Service:
    """One communication service.

    Attributes
    ----------
    states
        NMT states it lives in; a service that is not alive neither listens nor sends.
    objects
        Indices whose values are its parameters.
    begins_anew
        Whether it acts on a write of the value that an object has already, as on any other.
    """

    states: ClassVar[frozenset[NMTState]] = frozenset()
    begins_anew: ClassVar[bool] = False

    def __init__(self, port: Port, od: ObjectDictionary, objects: tuple[int, ...]) -> None:
        self.port = port
        self.od = od
        self.objects = objects
        self.alive = False

    def check_read(self, entry: Entry) -> None:
        """Raise `Abort` if one of its objects has nothing to read."""

    def check(self, entry: Entry, value: Any) -> None:
        """Raise `Abort` if one of its objects must not take the value now."""

    def apply(self, entry: Entry) -> None:
        """Act on the value one of its objects has just taken."""
        alive = self.alive
        self.enter(None)
        self.configure()
        if alive:
            self.alive = True
            self.begin()

    def configure(self) -> None:
        """Read the parameters from the object dictionary; the service is not alive."""

    def enter(self, state: NMTState | None) -> None:
        """Begin or cease as the NMT state asks; None, no state, makes the service cease."""
        alive = state in self.states
        if alive != self.alive:
            self.alive = alive
            if alive:
                self.begin()
            else:
                self.cease()

    def begin(self) -> None:
        """Start what the service does while it is alive."""

    def cease(self) -> None:
        """Stop timers and drop what is pending."""

    def listen(self) -> None:
        """Register with the port for the CAN-IDs it listens to while it is alive."""

    @property
    def sends(self) -> tuple[int, ...]:
        """Identifiers that it sends with in one state or another, and no other device may."""
        return ()


def check_cob_id(old: int, new: int) -> None:
    """Refuse a COB-ID that an object with a valid bit (PDO, EMCY, SDO server) must not take.

    Raises
    ------
    Abort
        STATE if the CAN-ID would change while the object is valid, VALUE for 29-bit and
        restricted CAN-IDs.
    """
    if new & COB_INVALID:
        return
    if not old & COB_INVALID and (old ^ new) & (COB_EXTENDED | (COB_EXTENDED - 1)):
        raise Abort(AbortCode.STATE)
    if new & (COB_EXTENDED | ((COB_EXTENDED - 1) & ~CAN_ID_MASK)) or restricted(new & CAN_ID_MASK):
        raise Abort(AbortCode.VALUE)


class Access:
    """Reads and writes for SDO servers.

    Parameters
    ----------
    on_change
        Called after a service has taken a new parameter.
    """

    def __init__(
        self,
        od: ObjectDictionary,
        application: Application,
        on_change: Callable[[], None],
    ) -> None:
        self._od = od
        self._owners: dict[int, list[Service]] = {}
        self._application = application
        self._on_change = on_change

    def ask(self, services: Iterable[Service]) -> None:
        """Ask services from now on about the objects that are theirs."""
        for service in services:
            for index in service.objects:
                self._owners.setdefault(index, []).append(service)

    def read(self, index: int, subindex: int) -> bytes:
        """Read the bytes of an entry.

        Raises
        ------
        Abort
            NO_OBJECT, NO_SUBINDEX, WRITE_ONLY, NO_DATA.
        """
        if subindex == STRUCTURE_SUBINDEX and (structure := self._structure(index)) is not None:
            return structure.to_bytes(4, "little")
        entry = self._od.entry(index, subindex)
        if not entry.readable:
            raise Abort(AbortCode.WRITE_ONLY)
        for owner in self._owners.get(index, ()):
            owner.check_read(entry)
        return entry.pack()

    def writable(self, index: int, subindex: int, size: int | None) -> Entry:
        """Find the entry to write.

        Parameters
        ----------
        size
            Bytes to come, None if the client does not say.

        Raises
        ------
        Abort
            NO_OBJECT, NO_SUBINDEX, READ_ONLY, TOO_LONG, TOO_SHORT.
        """
        try:
            return self._writable(index, subindex, size)
        except Abort as abort:
            self._report(index, subindex, abort)
            raise

    def _writable(self, index: int, subindex: int, size: int | None) -> Entry:
        if subindex == STRUCTURE_SUBINDEX and self._structure(index) is not None:
            raise Abort(AbortCode.READ_ONLY)
        entry = self._od.entry(index, subindex)
        if not entry.writable:
            raise Abort(AbortCode.READ_ONLY)
        if size is not None and size > (entry.size or MAX_BYTES):
            raise Abort(AbortCode.TOO_LONG)
        if size is not None and size < entry.size:
            raise Abort(AbortCode.TOO_SHORT)
        return entry

    def write(self, entry: Entry, data: bytes) -> None:
        """Write bytes to an entry from `writable`.

        Raises
        ------
        Abort
            By type and limits, by the rules of the service that owns the object, or by the
            application; the entry then has its old value.
        """
        try:
            self._write(entry, data)
        except Abort as abort:
            self._report(entry.index, entry.subindex, abort)
            raise

    def _write(self, entry: Entry, data: bytes) -> None:
        value: Any = entry.unpack(data)
        owners: Sequence[Service] = self._owners.get(entry.index, ())
        for owner in owners:
            owner.check(entry, value)
        self._application.on_write(entry, value)
        # A master that writes back what it read must not restart timers and counts.
        if value == entry.value:
            owners = [owner for owner in owners if owner.begins_anew]
        self._put(entry, value, owners)

    def put(self, entry: Entry, value: Any) -> None:
        """Give the services a value of the application, without the checks of a write."""
        self._put(entry, value, self._owners.get(entry.index, ()))

    def _put(self, entry: Entry, value: Any, owners: Sequence[Service]) -> None:
        entry.value = value
        for owner in owners:
            owner.apply(entry)
        if owners:
            self._on_change()

    def _report(self, index: int, subindex: int, abort: Abort) -> None:
        """Report to the application why a write was refused."""
        entry = self._od.get(index, subindex)
        name = f"{index:04X}h sub-index {subindex}" if entry is None else entry.name
        self._application.on_refused(name, abort.explain(name))

    def _structure(self, index: int) -> int | None:
        """Return the content of sub-index FFh; None if there is no object or the EDS has one."""
        item = self._od.objects.get(index)
        return None if item is None or STRUCTURE_SUBINDEX in item.entries else item.structure

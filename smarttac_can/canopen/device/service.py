"""Common base of the services of CiA 301: NMT states, objects, and application hooks."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, ClassVar

from smarttac_can.canopen.device.nmt import NMTState
from smarttac_can.canopen.device.port import Port
from smarttac_can.canopen.od import cia
from smarttac_can.canopen.od.cia import Abort, AbortCode, restricted, standard_type
from smarttac_can.canopen.od.dictionary import ObjectDictionary
from smarttac_can.canopen.od.entry import MAX_BYTES, Entry


class Application:
    """Application hooks. Each one does nothing unless overridden.

    They are called from `Device.start`, `receive` and `advance`. Frames that the application
    triggers in them are returned by that call.
    """

    def on_state(self, state: NMTState) -> None:
        """Follow the NMT state.

        RESET_APPLICATION comes with all objects at their defaults, RESET_COMMUNICATION with those
        of the communication profile area, in both cases before the services read them. Values that
        the application sets here, such as PDO parameters, are therefore in force from the boot-up
        on.
        """

    def on_sync(self) -> bool:
        """Act at SYNC, in PRE-OPERATIONAL and OPERATIONAL; return whether to sample TPDOs.

        The values of synchronous RPDOs are already in force. If it returns False, the synchronous
        TPDOs skip this SYNC.
        """
        return True

    def on_rpdo(self, number: int) -> None:
        """Act on an RPDO, numbered from 1, whose values are in the object dictionary."""

    def on_loop_rpdo(self, number: int, data: bytes) -> None:
        """Act on the bytes of an RPDO, numbered from 1, that is in `loop_rpdos` of the device.

        Length and limits were checked. It is called instead of `on_rpdo`; the application itself
        writes the object dictionary.
        """

    def on_rpdo_timeout(self, number: int, late: bool) -> None:
        """Act on an RPDO, numbered from 1, that becomes late, or is no longer late.

        It is late from its deadline until the next PDO (the call then precedes `on_rpdo`), or until
        it is no longer expected.
        """

    def on_error_control(self, node_id: int, lost: bool) -> None:
        """Act on the loss or the return of a supervised node's heartbeat.

        It is called before the reaction of the error behaviour object. Node-ID 0 is life guarding.
        """

    def on_heartbeat(self, node_id: int, state: int) -> None:
        """Act on a heartbeat of a supervised node with its NMT state, INITIALISING at its boot-up.

        It is called after `on_error_control`.
        """

    def on_collision(self, heard: bool) -> None:
        """Act on another device that starts or stops sending with an identifier of this one.

        It is called once for all frames of such devices, until there was none for 3 s. It is not
        called when a reset clears the detection.
        """

    def on_store(self) -> None:
        """Raise `Abort` to refuse to store parameters now; storing may take a while."""

    def on_emergency(self, code: int) -> None:
        """Act on an emergency message of the node in `emergencies_of` of the device."""

    def on_parameters(self) -> None:
        """Act on parameters of a service that were written by SDO, and are already in force."""

    def on_write(self, entry: Entry, value: Any) -> None:
        """Refuse an SDO write by raising `Abort`; the entry still has its old value."""

    def on_refused(self, name: str, reason: str) -> None:
        """Act on an SDO write that was refused; the reason is one line.

        `on_write` or an earlier check has refused it. The name is that of the entry; without an
        entry it consists of index and sub-index.
        """


class Service:
    """One communication service.

    Attributes
    ----------
    states
        NMT states in which the service is active; in other states it neither listens nor sends.
    objects
        Indices of the objects that hold its parameters.
    begins_anew
        Whether a write of an unchanged value has the same effect as any other write.
    state
        NMT state that was entered last.
    alive
        Whether the service is active.
    """

    states: ClassVar[frozenset[NMTState]] = frozenset()
    begins_anew: ClassVar[bool] = False

    def __init__(self, port: Port, od: ObjectDictionary, objects: tuple[int, ...]) -> None:
        self.port = port
        self.od = od
        self.objects = objects
        self.state = NMTState.INITIALISING
        self.alive = False

    def check_read(self, entry: Entry) -> None:
        """Raise `Abort` if one of its objects has no value to read."""

    def check(self, entry: Entry, value: Any) -> None:
        """Raise `Abort` if one of its objects must not be set to the value now."""

    def apply(self, entry: Entry) -> None:
        """Act on the value to which one of its objects was set."""
        if self.alive:
            self.cease()
        self.configure()
        if self.alive:
            self.begin()

    def configure(self) -> None:
        """Read the parameters from the object dictionary; the service is then not active."""

    def enter(self, state: NMTState) -> None:
        """Start or stop as the NMT state requires."""
        self.state = state
        alive = state in self.states
        if alive != self.alive:
            self.alive = alive
            if alive:
                self.begin()
            else:
                self.cease()

    def begin(self) -> None:
        """Start the activity of the service."""

    def cease(self) -> None:
        """Stop timers, and drop pending actions."""

    def listen(self) -> None:
        """Register with the port for the CAN-IDs that the service needs while it is active."""

    @property
    def sends(self) -> tuple[int, ...]:
        """CAN-IDs with which only this service may send, in any state."""
        return ()


def usable(cob_id: int) -> bool:
    """Return whether the CAN-ID of a COB-ID has 11 bits and is not restricted."""
    wide = cia.COB_EXTENDED | ((cia.COB_EXTENDED - 1) & ~cia.CAN_ID_MASK)
    return not (cob_id & wide or restricted(cob_id & cia.CAN_ID_MASK))


def check_can_id(cob_id: int) -> None:
    """Raise `Abort` with VALUE for a COB-ID with a 29-bit or restricted CAN-ID."""
    if not usable(cob_id):
        raise Abort(AbortCode.VALUE)


def settable(entry: Entry | None, value: int) -> bool:
    """Return whether an entry can be set to a value, by its access and limits in the EDS.

    CiA 301 has procedures that begin with such a write, as of the valid bit of a COB-ID. Where the
    EDS rules it out, the procedure cannot be followed, and must not be required.
    """
    return entry is not None and entry.writable and entry.low <= value <= entry.high


def check_cob_id(entry: Entry, new: int) -> None:
    """Check a COB-ID that is written to an object with a valid bit (PDO, EMCY, SDO server).

    Raises
    ------
    Abort
        STATE if the CAN-ID would change while the object is valid, and could be made invalid
        before; else as `check_can_id`.
    """
    if new & cia.COB_INVALID:
        return
    old = entry.value
    changed = (old ^ new) & (cia.COB_EXTENDED | (cia.COB_EXTENDED - 1))
    if not old & cia.COB_INVALID and changed and settable(entry, old | cia.COB_INVALID):
        raise Abort(AbortCode.STATE)
    check_can_id(new)


class Access:
    """Reads and writes for SDO servers.

    Parameters
    ----------
    on_change
        Function that is called after a service has applied a new parameter.
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
        """Register services as owners of their objects."""
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
        if subindex == cia.STRUCTURE_SUBINDEX and (structure := self._structure(index)) is not None:
            return structure.to_bytes(4, "little")
        entry = self._od.entry(index, subindex)
        if not entry.readable:
            raise Abort(AbortCode.WRITE_ONLY)
        for owner in self._owners_of(entry):
            owner.check_read(entry)
        return entry.pack()

    def writable(self, index: int, subindex: int, size: int | None) -> Entry:
        """Find the entry to write.

        Parameters
        ----------
        size
            Number of bytes of the download; None if the client does not announce it.

        Raises
        ------
        Abort
            NO_OBJECT, NO_SUBINDEX, READ_ONLY, TOO_LONG, TOO_SHORT.
        """
        with self._reporting(index, subindex):
            if subindex == cia.STRUCTURE_SUBINDEX and self._structure(index) is not None:
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
            For a wrong type or limit, or as the service that owns the object or the application
            requires; the value of the entry is then unchanged.
        """
        with self._reporting(entry.index, entry.subindex):
            value: Any = entry.unpack(data)
            owners = self._owners_of(entry)
            for owner in owners:
                owner.check(entry, value)
            self._application.on_write(entry, value)
            # A master that writes back what it read must not restart timers and counts.
            if value == entry.value:
                owners = [owner for owner in owners if owner.begins_anew]
            self._put(entry, value, owners)

    def put(self, entry: Entry, value: Any) -> None:
        """Set a value of the application, and apply it in the services, without checks."""
        self._put(entry, value, self._owners_of(entry))

    def _owners_of(self, entry: Entry) -> Sequence[Service]:
        """Return the services of an entry, none for a sub-index that CiA 301 does not have.

        Such an entry of a service's object may be of any type, and is only stored.
        """
        owners = self._owners.get(entry.index, [])
        if owners and entry.subindex and standard_type(entry.index, entry.subindex) is None:
            return []
        return owners

    def _put(self, entry: Entry, value: Any, owners: Sequence[Service]) -> None:
        entry.value = value
        for owner in owners:
            owner.apply(entry)
        if owners:
            self._on_change()

    @contextmanager
    def _reporting(self, index: int, subindex: int) -> Iterator[None]:
        """Report a write to the application if it is refused."""
        try:
            yield
        except Abort as abort:
            entry = self._od.get(index, subindex)
            name = f"{index:04X}h sub-index {subindex}" if entry is None else entry.name
            self._application.on_refused(name, abort.explain(name))
            raise

    def _structure(self, index: int) -> int | None:
        """Return the content of sub-index FFh; None without the object, or if it is in the EDS."""
        item = self._od.objects.get(index)
        return None if item is None or cia.STRUCTURE_SUBINDEX in item.entries else item.structure

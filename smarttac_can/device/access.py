"""Object dictionary access of an SDO client: first all rules are checked, then all happens."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

from smarttac_can.device.application import Application
from smarttac_can.device.service import Service
from smarttac_can.od.cia import STRUCTURE_SUBINDEX, Abort, AbortCode
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.od.entry import MAX_BYTES, Entry


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
        """Have the services take a value from the application, without the checks of a write."""
        self._put(entry, value, self._owners.get(entry.index, ()))

    def _put(self, entry: Entry, value: Any, owners: Sequence[Service]) -> None:
        entry.value = value
        for owner in owners:
            owner.apply(entry)
        if owners:
            self._on_change()

    def _report(self, index: int, subindex: int, abort: Abort) -> None:
        """Tell the application why a write was refused."""
        entry = self._od.get(index, subindex)
        name = f"{index:04X}h sub-index {subindex}" if entry is None else entry.name
        self._application.on_refused(name, abort.explain(name))

    def _structure(self, index: int) -> int | None:
        """Return the content of sub-index FFh; None if there is no object or the EDS has one."""
        item = self._od.objects.get(index)
        return None if item is None or STRUCTURE_SUBINDEX in item.entries else item.structure

"""Non-volatile parameters (CiA 301, 7.5.2.13 and 7.5.2.14), also those of LSS."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from typing import Any, ClassVar, Final, Protocol
from zlib import crc32

from smarttac_can.canopen.device.emcy import Emergency
from smarttac_can.canopen.device.nmt import CONFIGURABLE
from smarttac_can.canopen.device.port import Port
from smarttac_can.canopen.device.service import Application, Service
from smarttac_can.canopen.od import cia
from smarttac_can.canopen.od.cia import Abort, AbortCode, EmergencyCode, ErrorRegister
from smarttac_can.canopen.od.data_types import pack
from smarttac_can.canopen.od.dictionary import ObjectDictionary
from smarttac_can.canopen.od.entry import Entry

Identity = tuple[int, int, int]
"""Vendor-ID, product code and revision number."""

NOT_STORED: Final = 0
"""Stored node-ID that means no node-ID."""
UNCHANGED: Final = 0xFF
"""Stored bit timing that means no bit timing."""

# The stored bytes show whether they are complete and belong to the device. Layout, little-endian:
# magic, format version, identity, node-ID and bit timing of LSS, number of records; each record
# with index, sub-index, length, bytes; at the end the CRC-32 of all bytes before.
_MAGIC: Final = b"CO-STORE"
_VERSION: Final = 1
_HEADER: Final = struct.Struct("<8sHIIIBBI")
_RECORD: Final = struct.Struct("<HBI")
_CHECKSUM: Final = struct.Struct("<I")


@dataclass(slots=True)
class Image:
    """Content of the storage.

    Attributes
    ----------
    node_id
        Node-ID of LSS; `NOT_STORED` for none, 255 for unconfigured.
    bit_timing
        Index into the table of CiA 305; `UNCHANGED` for none.
    values
        Bytes of each value, by index and sub-index.
    """

    node_id: int = NOT_STORED
    bit_timing: int = UNCHANGED
    values: dict[tuple[int, int], bytes] = field(default_factory=dict)


def pack_image(identity: Identity, image: Image) -> bytes:
    """Return the bytes to store: header, values and check sum."""
    parts = [
        _HEADER.pack(
            _MAGIC, _VERSION, *identity, image.node_id, image.bit_timing, len(image.values)
        )
    ]
    for (index, subindex), data in sorted(image.values.items()):
        parts += (_RECORD.pack(index, subindex, len(data)), data)
    body = b"".join(parts)
    return body + _CHECKSUM.pack(crc32(body))


def begins_as_image(data: bytes) -> bool:
    """Return whether bytes begin like an image of `pack_image`, complete or torn; b"" does."""
    return data[: len(_MAGIC)] == _MAGIC[: len(data)]


def unpack_image(identity: Identity, data: bytes) -> Image:
    """Read an image that `pack_image` made.

    Raises
    ------
    ValueError
        The bytes are torn, have another format, or belong to another device.
    """
    body, checksum = data[: -_CHECKSUM.size], data[-_CHECKSUM.size :]
    if len(body) < _HEADER.size or crc32(body) != _CHECKSUM.unpack(checksum)[0]:
        raise ValueError("stored parameters are torn")
    magic, version, *stored, node_id, bit_timing, count = _HEADER.unpack_from(body)
    if (magic, version) != (_MAGIC, _VERSION):
        raise ValueError("stored parameters are of another format")
    if tuple(stored) != identity:
        raise ValueError("stored parameters are those of another device")
    image = Image(node_id, bit_timing)
    position = _HEADER.size
    try:
        for _ in range(count):
            index, subindex, length = _RECORD.unpack_from(body, position)
            position += _RECORD.size + length
            image.values[index, subindex] = body[position - length : position]
    except struct.error:
        raise ValueError("stored parameters are torn") from None
    if position != len(body):
        raise ValueError("stored parameters are torn")
    return image


_SIGNATURES: Final = {cia.STORE_PARAMETERS: b"save", cia.RESTORE_DEFAULTS: b"load"}
_ALL: Final = (0, cia.LAST_INDEX)
_GROUPS: Final = {
    1: _ALL,
    2: (cia.COMMUNICATION_FIRST, cia.COMMUNICATION_LAST),
    3: (cia.PROFILE_FIRST, cia.PROFILE_LAST),
    4: (cia.MANUFACTURER_FIRST, cia.PROFILE_FIRST - 1),
}
"""Index ranges by sub-index; higher sub-indices also mean the manufacturer's range."""
_NOT_PARAMETERS: Final = (cia.ERROR_FIELD, cia.STORE_PARAMETERS, cia.RESTORE_DEFAULTS)


class Storage(Protocol):
    """Storage of bytes by the host."""

    def read(self) -> bytes | None:
        """Return the bytes that were written last, None if there are none.

        Raises
        ------
        OSError
            The storage cannot be read.
        """
        ...

    def write(self, data: bytes) -> None:
        """Replace the stored bytes.

        Raises
        ------
        OSError
            The storage cannot be written; the bytes stored before are still there.
        """
        ...


class Memory:
    """Storage that lasts as long as the device."""

    def __init__(self) -> None:
        self._data: bytes | None = None

    def read(self) -> bytes | None:
        """Return the bytes that were written last, None if there are none."""
        return self._data

    def write(self, data: bytes) -> None:
        """Store the bytes until the next write."""
        self._data = data


class ParameterStorage(Service):
    """Store parameters on command, and restore them after a reset.

    Only values that differ from the default are stored, so that the others follow a new node-ID.
    Mappable objects are process data, and are not stored. If the application has preset a value at
    a reset, the value before is stored as long as the preset value is unchanged.

    Attributes
    ----------
    image
        Stored content.
    torn
        Whether the stored parameters were invalid, so that the defaults apply.
    """

    states: ClassVar = CONFIGURABLE

    def __init__(
        self,
        port: Port,
        od: ObjectDictionary,
        emergency: Emergency,
        storage: Storage,
        application: Application,
    ) -> None:
        super().__init__(port, od, (*_SIGNATURES, cia.VERIFY_CONFIGURATION))
        self._emergency = emergency
        self._storage = storage
        self._application = application
        self._identity: Identity = (
            od.number(cia.IDENTITY, 1), od.number(cia.IDENTITY, 2), od.number(cia.IDENTITY, 3),
        )  # fmt: skip
        self._parameters = {(e.index, e.subindex): e for e in od if _is_parameter(e)}
        self._before: dict[Entry, Any] = {}
        self._presets: dict[Entry, tuple[Any, Any]] = {}
        self._loaded: dict[Entry, Any] = {}
        self.image = Image()
        self.torn = False
        self._is_signed = False

    def load(self) -> None:
        """Read the stored parameters; ignore torn or foreign ones, which `report` reports."""
        self.image = Image()
        self.torn = self._is_signed = False
        try:
            data = self._storage.read()
            if data is not None:
                image = unpack_image(self._identity, data)
                self._loaded = self._values(image)
                self.image = image
            else:
                self._loaded = {}
        except (ValueError, OSError):
            self._loaded = {}
            self.torn = True

    def restore(self, first: int, last: int) -> None:
        """Set the objects first..last to their stored values."""
        for entry, value in self._loaded.items():
            if first <= entry.index <= last:
                entry.value = value
        self._before = {e: e.value for e in self._parameters.values() if first <= e.index <= last}

    def note_presets(self) -> None:
        """Record the values that the application has preset since `restore`."""
        for entry, value in self._before.items():
            if entry.value == value:
                self._presets.pop(entry, None)
            else:
                self._presets[entry] = (value, entry.value)
        self._before = {}

    def report(self) -> None:
        """Report an error if the stored parameters were invalid."""
        if self.torn:
            self._emergency.report(EmergencyCode.DATA_STORAGE, ErrorRegister.GENERIC)

    def store_lss(self, node_id: int, bit_timing: int) -> None:
        """Store the node-ID and the index of the bit timing that LSS has configured.

        Raises
        ------
        OSError
            The storage fails.
        Abort
            The application refuses to store now.
        """
        self._application.on_store()
        self._write(Image(node_id, bit_timing, self.image.values))

    def check(self, entry: Entry, value: Any) -> None:
        """Refuse any value but the signature of store or restore, even the value read there.

        Raises
        ------
        Abort
            STORE for a wrong signature; the error of the application if it refuses to store now.
        """
        signature = _SIGNATURES.get(entry.index)
        if signature is None:
            return
        if not entry.subindex or value != int.from_bytes(signature, "little"):
            raise Abort(AbortCode.STORE)
        self._application.on_store()

    def apply(self, entry: Entry) -> None:
        """Store or restore the group of objects whose sub-index was written.

        Raises
        ------
        Abort
            HARDWARE if the storage fails; nothing is then changed.
        """
        if entry.index == cia.VERIFY_CONFIGURATION:
            self._is_signed = True
            return
        entry.value = entry.default
        first, last = _GROUPS.get(entry.subindex, _GROUPS[4])
        values = {a: data for a, data in self.image.values.items() if not first <= a[0] <= last}
        if entry.index == cia.STORE_PARAMETERS:
            values |= self._changed(first, last)
        verify = {a: data for a, data in values.items() if a[0] == cia.VERIFY_CONFIGURATION}
        others = {a: data for a, data in values.items() if a not in verify}
        before = {a: d for a, d in self.image.values.items() if a[0] != cia.VERIFY_CONFIGURATION}
        outdated = others != before and not self._is_signed
        try:
            self._write(
                Image(self.image.node_id, self.image.bit_timing, others if outdated else values)
            )
        except OSError:
            raise Abort(AbortCode.HARDWARE) from None
        self._is_signed = False
        if outdated:
            for (index, _), signed in self._parameters.items():
                if index == cia.VERIFY_CONFIGURATION:
                    signed.value = signed.default

    def _changed(self, first: int, last: int) -> dict[tuple[int, int], bytes]:
        changed = {}
        for entry in self._parameters.values():
            if first <= entry.index <= last:
                replaced, preset = self._presets.get(entry, (None, None))
                value = entry.value if preset is None or entry.value != preset else replaced
                if value != entry.default:
                    changed[entry.index, entry.subindex] = pack(entry.data_type, value)
        return changed

    def _write(self, image: Image) -> None:
        self._storage.write(pack_image(self._identity, image))
        self.image = image
        self._loaded = self._values(image)
        self.torn = False
        self._emergency.clear(EmergencyCode.DATA_STORAGE)

    def _values(self, image: Image) -> dict[Entry, Any]:
        """Return the stored values by entry.

        Raises
        ------
        ValueError
            A value does not fit this object dictionary.
        """
        try:
            return {
                self._parameters[address]: self._parameters[address].unpack(data)
                for address, data in image.values.items()
            }
        except (KeyError, Abort):
            raise ValueError("stored parameters do not fit the object dictionary") from None


def _is_parameter(entry: Entry) -> bool:
    return (
        entry.readable and entry.writable and not entry.pdo and entry.index not in _NOT_PARAMETERS
    )

"""What the device keeps over a power cycle, as bytes that tell whether they are whole and its own.

Layout, little-endian: magic, format version, identity (vendor, product, revision), node-ID and
bit timing of LSS, number of records; a record is index, sub-index, length, bytes; at the end the
CRC-32 of all before.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from typing import Final
from zlib import crc32

Identity = tuple[int, int, int]
"""Vendor-ID, product code and revision number."""

NOT_STORED: Final = 0
"""Node-ID that stands for none."""
UNCHANGED: Final = 0xFF
"""Bit timing that stands for none."""

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
        Of LSS; `NOT_STORED` for none, 255 for unconfigured.
    bit_timing
        Index into the table of CiA 305; `UNCHANGED` for none.
    values
        Bytes by index and sub-index.
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
    """Whether bytes begin as what `pack_image` makes, whole or torn; nothing does."""
    return data[: len(_MAGIC)] == _MAGIC[: len(data)]


def unpack_image(identity: Identity, data: bytes) -> Image:
    """Read what `pack_image` made.

    Raises
    ------
    ValueError
        The bytes are torn, not of this format, or those of another device.
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

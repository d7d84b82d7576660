"""Pictures written from the definitions of PNG (ISO/IEC 15948) and TIFF 6.0, without a library."""

from __future__ import annotations

import struct
import zlib

import numpy as np

GREY, RGB, PALETTE, GREY_ALPHA, RGB_ALPHA = 0, 2, 3, 4, 6
"""Colour types of a PNG."""


def chunk(kind: bytes, data: bytes) -> bytes:
    """Return a chunk of a PNG."""
    check = struct.pack(">I", zlib.crc32(kind + data))
    return struct.pack(">I", len(data)) + kind + data + check


def packed(samples: np.ndarray, depth: int, order: str = ">") -> list[bytes]:
    """Return the bytes of each row of samples (rows, columns or more) of 1 to 16 bits."""
    rows = samples.reshape(len(samples), -1)
    if depth == 16:
        return [row.astype(f"{order}u2").tobytes() for row in rows]
    if depth == 8:
        return [row.astype(np.uint8).tobytes() for row in rows]
    bits = (rows[..., None] >> np.arange(depth - 1, -1, -1)) & 1
    return [np.packbits(row.astype(np.uint8).ravel()).tobytes() for row in bits]


def png(
    samples: np.ndarray,
    depth: int,
    colour: int = GREY,
    palette: np.ndarray | None = None,
    *,
    extra: bytes = b"",
) -> bytes:
    """Return a PNG of samples (rows, columns, channels or none); `extra` are chunks before IDAT."""
    height, width = samples.shape[:2]
    head = struct.pack(">IIBBBBB", width, height, depth, colour, 0, 0, 0)
    plte = b"" if palette is None else chunk(b"PLTE", palette.astype(np.uint8).tobytes())
    body = zlib.compress(b"".join(b"\0" + row for row in packed(samples, depth)))
    parts = (chunk(b"IHDR", head), plte, extra, chunk(b"IDAT", body), chunk(b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


def tiff(
    samples: np.ndarray,
    depth: int,
    photometric: int = 1,
    *,
    order: str = "<",
    pages: int = 1,
    sample_format: int = 1,
    extra_samples: int | None = None,
    palette: np.ndarray | None = None,
) -> bytes:
    """Return an uncompressed TIFF in one strip; photometric 0 is grey with 0 as white."""
    height, width = samples.shape[:2]
    channels = samples.shape[2] if samples.ndim == 3 else 1
    data = b"".join(packed(samples, depth, order))
    out = bytearray(b"II*\0" if order == "<" else b"MM\0*") + bytes(4)
    at = len(out)
    out += data + bytes(len(data) % 2)
    link = 4
    for _ in range(pages):
        tags = [
            (256, 4, [width]),
            (257, 4, [height]),
            (258, 3, [depth] * channels),
            (259, 3, [1]),
            (262, 3, [photometric]),
            (273, 4, [at]),
            (277, 3, [channels]),
            (278, 4, [height]),
            (279, 4, [len(data)]),
        ]
        if palette is not None:
            tags.append((320, 3, (palette.T.astype(int) * 257).ravel().tolist()))
        if extra_samples is not None:
            tags.append((338, 3, [extra_samples]))
        tags.append((339, 3, [sample_format] * channels))
        struct.pack_into(f"{order}I", out, link, len(out))
        link = _directory(out, tags, order)
    return bytes(out)


def _directory(out: bytearray, tags: list[tuple[int, int, list[int]]], order: str) -> int:
    """Append a directory with its long values; return where the next one's offset stands."""
    start = len(out)
    out += struct.pack(f"{order}H", len(tags)) + bytes(12 * len(tags) + 4)
    for number, (tag, kind, values) in enumerate(tags):
        value = struct.pack(f"{order}{len(values)}{'H' if kind == 3 else 'I'}", *values)
        if len(value) > 4:
            place = struct.pack(f"{order}I", len(out))
            out += value
        else:
            place = value.ljust(4, b"\0")
        entry = struct.pack(f"{order}HHI", tag, kind, len(values)) + place
        out[start + 2 + 12 * number : start + 14 + 12 * number] = entry
    return start + 2 + 12 * len(tags)

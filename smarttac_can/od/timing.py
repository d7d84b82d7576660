"""Worst-case length of CAN frames on the wire."""

from __future__ import annotations


def frame_bits(data_bytes: int) -> int:
    """Longest a classical 11-bit frame can be, in bit times, with stuff bits and interframe space.

    Parameters
    ----------
    data_bytes
        Number of data bytes, 0..8.

    Notes
    -----
    47 fixed bits including the 3 of the interframe space, of which the 34 before the CRC delimiter
    are subject to stuffing together with the data: one stuff bit after the first five equal bits
    and then one every four (Davis, Burns, Bril, Lukkien, Real-Time Systems 35 (2007) 239,
    doi:10.1007/s11241-007-9012-7). 8 bytes give 135.
    """
    if not 0 <= data_bytes <= 8:
        raise ValueError(f"data_bytes {data_bytes} is outside 0..8")
    return 47 + 8 * data_bytes + (34 + 8 * data_bytes - 1) // 4


def frame_seconds(data_bytes: int, bit_rate: int) -> float:
    """Longest time in s one frame holds the bus at a bit rate in bit/s (above 0)."""
    if bit_rate <= 0:
        raise ValueError(f"bit_rate {bit_rate} is not above 0")
    return frame_bits(data_bytes) / bit_rate

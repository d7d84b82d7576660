import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from smarttac_can.canopen.od.cia import Abort, AbortCode, DataType
from smarttac_can.canopen.od.data_types import (
    REAL,
    SIGNED,
    SIZES,
    UNSIGNED,
    bounds,
    pack,
    unpack,
    zero,
)


@pytest.mark.parametrize(
    ("data_type", "value", "data"),
    [
        (DataType.BOOLEAN, 1, "01"),
        (DataType.INTEGER8, -1, "ff"),
        (DataType.INTEGER24, -2, "feffff"),
        (DataType.UNSIGNED16, 0x1234, "3412"),
        (DataType.UNSIGNED40, 1 << 39, "0000000080"),
        (DataType.REAL32, 1.5, "0000c03f"),
        (DataType.REAL64, -2.25, "00000000000002c0"),
        (DataType.VISIBLE_STRING, "ab", "6162"),
        (DataType.UNICODE_STRING, "ab", "61006200"),
        (DataType.OCTET_STRING, b"\x00\xff", "00ff"),
        (DataType.TIME_OF_DAY, b"\1\2\3\4\5\6", "010203040506"),
        (DataType.DOMAIN, b"", ""),
    ],
)
def test_transfer_syntax(data_type: DataType, value: object, data: str) -> None:
    assert pack(data_type, value).hex() == data
    assert unpack(data_type, bytes.fromhex(data)) == value


@pytest.mark.parametrize("data_type", [*SIGNED, *UNSIGNED])
@given(data=st.data())
@settings(max_examples=20)
def test_integers_survive(data_type: DataType, data: st.DataObject) -> None:
    low, high = bounds(data_type)
    for value in (low, high, data.draw(st.integers(int(low), int(high)))):
        packed = pack(data_type, value)
        assert len(packed) == SIZES[data_type]
        assert unpack(data_type, packed) == value


@pytest.mark.parametrize("data_type", list(SIZES))
def test_wrong_length_is_refused(data_type: DataType) -> None:
    for size, code in ((SIZES[data_type] + 1, AbortCode.TOO_LONG), (0, AbortCode.TOO_SHORT)):
        with pytest.raises(Abort) as refusal:
            unpack(data_type, bytes(size))
        assert refusal.value.code == code


@pytest.mark.parametrize(
    ("data_type", "data", "code"),
    [
        (DataType.VISIBLE_STRING, b"\x80", AbortCode.VALUE),
        (DataType.VISIBLE_STRING, b"\x0b", AbortCode.VALUE),
        (DataType.UNICODE_STRING, b"abc", AbortCode.LENGTH),
        (DataType.UNICODE_STRING, b"\x00\xd8", AbortCode.VALUE),
    ],
)
def test_visible_string_refuses_other_characters(
    data_type: DataType, data: bytes, code: int
) -> None:
    with pytest.raises(Abort) as refusal:
        unpack(data_type, data)
    assert refusal.value.code == code


def test_visible_characters() -> None:
    """CiA 301: 0 and 20h to 7Eh; data sheets contain tabs and line ends as well."""
    for byte in range(256):
        data = b"ab" + bytes((byte,)) + b"c"
        if byte in (0x00, 0x09, 0x0A, 0x0D) or 0x20 <= byte <= 0x7E:
            assert unpack(DataType.VISIBLE_STRING, data) == data.decode("ascii")
        else:
            with pytest.raises(Abort):
                unpack(DataType.VISIBLE_STRING, data)


@pytest.mark.parametrize("data_type", list(DataType))
def test_zero_can_be_packed(data_type: DataType) -> None:
    assert set(pack(data_type, zero(data_type))) <= {0}


@pytest.mark.parametrize("data_type", list(REAL))
def test_real_bounds_can_be_packed_and_are_finite(data_type: DataType) -> None:
    for bound in bounds(data_type):
        assert math.isfinite(bound)
        assert unpack(data_type, pack(data_type, bound)) == bound


def test_each_text_that_is_read_may_be_written_back() -> None:
    """A client that writes back all that it has read is refused nothing."""
    for data_type in (DataType.VISIBLE_STRING, DataType.UNICODE_STRING):
        for code in (*range(256), 0x20AC, 0xD800, 0x1F600):
            served = pack(data_type, f"a{chr(code)}b")
            assert pack(data_type, unpack(data_type, served)) == served

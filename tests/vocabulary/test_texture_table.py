from binascii import crc32

import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttac_can.vocabulary.textures import MAX_BYTES, Axis, TextureTable

RAMP = TextureTable(Axis.POSITION, False, -2_000_000, 1_000_000, (3000, 3500, 4500))
GRATING = TextureTable(Axis.POSITION, True, 0, 500_000, (2500, 2500, 4000, 4000))

tables = st.builds(
    TextureTable,
    st.just(Axis.POSITION),
    st.booleans(),
    st.integers(-100_000_000, 100_000_000),
    st.integers(1, 10_000_000),
    st.lists(st.integers(1, 0xFFFF), min_size=1, max_size=50).map(tuple),
)


def sealed(body: bytes) -> bytes:
    return body + crc32(body).to_bytes(4, "little")


@given(tables)
def test_a_table_comes_back_from_its_bytes(table: TextureTable) -> None:
    assert TextureTable.unpack(table.pack()) == table


def test_the_bytes_are_these() -> None:
    table = TextureTable(Axis.TIME, True, 0, 1000, (0x0BB8, 0x0FA0))
    body = bytes.fromhex("53 54 58 31 01 01 02 00 00 00 00 00 E8 03 00 00 B8 0B A0 0F")
    assert table.pack() == sealed(body)


@given(tables, st.data())
def test_a_changed_byte_is_found(table: TextureTable, data: st.DataObject) -> None:
    sound = bytearray(table.pack())
    where = data.draw(st.integers(0, len(sound) - 1))
    sound[where] ^= data.draw(st.integers(1, 255))
    with pytest.raises(ValueError, match=r"checksum|begin with"):
        TextureTable.unpack(bytes(sound))


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", "number of bytes 0 is outside 22..8212"),
        (GRATING.pack()[:21], "number of bytes 21 is outside 22..8212"),
        (bytes(MAX_BYTES + 1), "number of bytes 8213 is outside 22..8212"),
        (sealed(b"RIFF" + bytes(18)), "they begin with 52 49 46 46, not 53 54 58 31"),
        (GRATING.pack()[:-1], "the checksum is not that of the content"),
        (sealed(GRATING.pack()[:-6]), "number of values 4 is not that of 26 bytes"),
        (sealed(b"STX1\x02\x00\x01\x00" + bytes(8) + b"\x01\x00"), "axis 2 is outside 0..1"),
        (sealed(b"STX1\x00\x02\x01\x00" + bytes(8) + b"\x01\x00"), "repeat flag 2 is outside 0..1"),
        (sealed(b"STX1\x00\x00\x01\x00" + bytes(8) + b"\x01\x00"), "step 0 is outside 1..10000000"),
        (
            sealed(b"STX1\x00\x00\x01\x00\0\0\0\0\x01\0\0\0\0\0"),
            "value 0 is outside 1..65535",
        ),
        (
            sealed(b"STX1\x01\x00\x01\x00\x05\0\0\0\x01\0\0\0\x01\0"),
            "start 5 is outside 0..0",
        ),
    ],
)
def test_malformed_texture_table_is_refused_with_one_reason(data: bytes, reason: str) -> None:
    with pytest.raises(ValueError) as refused:
        TextureTable.unpack(data)
    assert str(refused.value) == reason


def test_a_table_of_too_many_values_is_refused() -> None:
    TextureTable(Axis.POSITION, False, 0, 1, (3000,) * 4096)
    with pytest.raises(ValueError, match=r"^number of values 4097 is outside 1\.\.4096$"):
        TextureTable(Axis.POSITION, False, 0, 1, (3000,) * 4097)


@pytest.mark.parametrize(("low", "high"), [(2501, 20000), (500, 3999)])
def test_values_beyond_the_bounds_of_a_device_are_named(low: int, high: int) -> None:
    GRATING.require_within(2500, 4000)
    with pytest.raises(ValueError, match=r"^COF 0\.\d+ of value \d is outside 0\.\d+\.\.\d"):
        GRATING.require_within(low, high)


@pytest.mark.parametrize(
    ("mm", "cof"),
    [(-9.0, 0.30), (-2.0, 0.30), (-1.5, 0.325), (-1.0, 0.35), (-0.1, 0.44), (0.0, 0.45), (9, 0.45)],
)
def test_lines_between_values_and_held_ends(mm: float, cof: float) -> None:
    assert RAMP.at(1e6 * mm) == pytest.approx(cof, abs=1e-12)


@pytest.mark.parametrize(("mm", "cof"), [(0.0, 0.25), (0.75, 0.325), (1.2, 0.4), (1.75, 0.325)])
@pytest.mark.parametrize("periods", [-3, 0, 5])
def test_a_table_that_repeats_goes_on_on_both_sides(mm: float, cof: float, periods: int) -> None:
    assert GRATING.at(1e6 * (mm + 2 * periods)) == pytest.approx(cof, abs=1e-12)


@given(tables, st.floats(-1e12, 1e12))
def test_no_place_is_beyond_the_values(table: TextureTable, place: float) -> None:
    assert min(table.values) - 1e-6 <= 1e4 * table.at(place) <= max(table.values) + 1e-6


def test_just_before_0_is_the_end_of_a_period() -> None:
    assert GRATING.at(-1e-12) == pytest.approx(0.25)

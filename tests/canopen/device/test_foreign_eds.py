"""Devices of foreign EDS files: omitted, compact, or impossible to write."""

import pytest
from small_eds import entry, read, record, small_eds, started, write

from smarttac_can.canopen.device.frame import Frame

NO_SUBINDEX, ACCESS, STATE, LENGTH = -0x06090011, -0x06010000, -0x08000022, -0x06040042
STATUS = entry("2000", 6, "ro", "0x1234", "PDOMapping=1")
TARGET = entry("2001", 6, "rww", "0", "PDOMapping=1")
START = Frame(0, b"\x01\x00")


def communication(index: str, *cob_id: str) -> str:
    """Communication record; `cob_id` is access, default and more lines of sub-index 1."""
    access, *rest = cob_id
    return record(
        index,
        entry(f"{index}sub0", 5, "const", "3"),
        entry(f"{index}sub1", 7, access, *rest),
        entry(f"{index}sub2", 5, "rw", "255"),
        entry(f"{index}sub3", 6, "rw", "0"),
    )


def mapping(index: str, count_access: str, count: str, *objects: str, access: str = "rw") -> str:
    entries = [entry(f"{index}sub{n:X}", 7, access, value) for n, value in enumerate(objects, 1)]
    return record(index, entry(f"{index}sub0", 5, count_access, count), *entries)


# Sub-index FFh and sub-index 0.


@pytest.mark.parametrize(
    ("subindices", "kind", "structure"),
    [
        (("C",), 8, 0x0608),
        (("0", "C"), 8, 0x0608),
        (("0",), 8, 0x0508),
        (("C",), 9, 0x0009),
    ],
)
def test_ffh_reads_without_subindex_1(
    subindices: tuple[str, ...], kind: int, structure: int
) -> None:
    entries = [entry(f"4602sub{s}", 6 if s != "0" else 5, "ro", "3") for s in subindices]
    device = started(small_eds(record("4602", *entries, kind=kind)))
    assert read(device, 0x4602, 0xFF) == structure
    assert read(device, 0x4602, 0x01) == NO_SUBINDEX
    assert read(device, 0x4602, 0x0C) == (3 if "C" in subindices else NO_SUBINDEX)


@pytest.mark.parametrize(
    ("index", "access", "values", "count"),
    [
        ("1016", "ro", ("0", "0", "0"), 3),
        ("2100", "const", ("", ""), 2),
        ("2100", "rw", ("", ""), 2),
        ("1003", "rw", ("0", "0"), 0),
        ("1A00", "rw", ("0x20000010", "0", "0"), 1),
        ("1A00", "rw", ("0", "0"), 0),
    ],
)
def test_subindex_0_without_default_counts(
    index: str, access: str, values: tuple[str, ...], count: int
) -> None:
    """The error history and a mapping count their entries in use."""
    entries = [entry(f"{index}sub{n}", 7, "rw", value) for n, value in enumerate(values, 1)]
    text = small_eds(STATUS + record(index, entry(f"{index}sub0", 5, access), *entries))
    assert read(started(text), int(index, 16)) == count


def test_subindex_0_without_default_stays_in_its_limits() -> None:
    count = entry("2100sub0", 5, "ro", "", "HighLimit=1")
    text = small_eds(record("2100", count, entry("2100sub1", 7, "rw"), entry("2100sub2", 7, "rw")))
    assert read(started(text), 0x2100) == 1


# The node-ID.


@pytest.mark.parametrize("stated", ["0x601", "$NODEID+0x600", ""])
def test_1200h_follows_the_node_id(stated: str) -> None:
    sdo = record(
        "1200",
        entry("1200sub0", 5, "const", "2"),
        entry("1200sub1", 7, "ro", stated),
        entry("1200sub2", 7, "ro", "0x581"),
    )
    device = started(small_eds(sdo), 12)
    assert (read(device, 0x1200, 1), read(device, 0x1200, 2)) == (0x60C, 0x58C)
    assert any("1200sub1" in line for line in device.od.warnings) == (stated == "0x601")


# CompactSubObj and CompactPDO.


def compact(index: str, count: int, *lines: str) -> str:
    head = (f"[{index}]", f"ParameterName=Object {index}", f"CompactSubObj={count}")
    return "\n".join((*head, "AccessType=rw", "DataType=7", *lines, ""))


def test_a_compact_error_history_counts_errors() -> None:
    device = started(small_eds(compact("1003", 4, "ObjectType=8")))
    assert read(device, 0x1003) == 0
    device.emergency(0x5000, 1)
    assert (read(device, 0x1003), read(device, 0x1003, 1)) == (1, 0x5000)
    assert write(device, 0x1003, 0, 0, 1) == 0
    assert read(device, 0x1003) == 0


def test_a_compact_heartbeat_consumer_supervises() -> None:
    values = "[1016Value]\nNrOfEntries=1\n2=0x00400064\n"
    device = started(small_eds(compact("1016", 2, "ObjectType=8") + values))
    assert (read(device, 0x1016), read(device, 0x1016, 2)) == (2, 0x00400064)
    device.receive(Frame(0x740, b"\x05"))
    assert device.supervised_in_time == {0x40}


def test_a_compact_mapping_is_mapped_again() -> None:
    values = "[1A00Value]\nNrOfEntries=1\n1=0x20000010\n"
    text = communication("1800", "rw", "$NODEID+0x180") + compact("1A00", 8, "ObjectType=9")
    device = started(small_eds(STATUS + text + values, tx=1))
    assert read(device, 0x1A00) == 1
    device.receive(START)
    device.trigger(1)
    assert device.take() == [Frame(0x189, b"\x34\x12")]
    assert write(device, 0x1800, 1, 0x80000189, 4) == 0
    assert write(device, 0x1A00, 0, 0, 1) == 0
    assert write(device, 0x1A00, 1, 0x10010008, 4) == -0x06040041, "1001h is not mappable here"
    assert write(device, 0x1A00, 0, 1, 1) == 0


def test_a_compact_communication_record_has_its_types() -> None:
    text = compact("1800", 3, "ObjectType=9") + mapping("1A00", "rw", "1", "0x20000010")
    device = started(small_eds(STATUS + text, tx=1))
    assert write(device, 0x1800, 1, 0x80000000 + 0x189, 4) == 0
    assert write(device, 0x1800, 2, 254, 1) == 0, "UNSIGNED8"
    assert write(device, 0x1800, 3, 100, 2) == 0, "UNSIGNED16"


@pytest.mark.parametrize(("mask", "present"), [("0x3F", range(1, 7)), ("23", (1, 2, 3, 5))])
def test_compactpdo_has_the_subindices_of_its_mask(mask: str, present: tuple[int, ...]) -> None:
    text = small_eds(STATUS, info=f"CompactPDO={mask}\n", rx=5, tx=1)
    device = started(text)
    assert device.od.warnings == []
    for index, cob_id in ((0x1400, 0x209), (0x1403, 0x509), (0x1404, 1 << 31), (0x1800, 0x189)):
        assert read(device, index, 1) == cob_id
        assert [sub for sub in range(1, 7) if read(device, index, sub) >= 0] == [*present]
        assert read(device, index) == max(present)
    assert read(device, 0x1405, 1) == read(device, 0x1801, 1) == -0x06020000
    assert write(device, 0x1800, 1, 0x80000189, 4) == 0
    assert write(device, 0x1A00, 1, 0x20000010, 4) == 0
    assert write(device, 0x1A00, 0, 1, 1) == 0
    assert write(device, 0x1800, 2, 254, 1) == 0
    assert write(device, 0x1800, 1, 0x189, 4) == 0
    device.receive(START)
    device.trigger(1)
    assert device.take() == [Frame(0x189, b"\x34\x12")]


def test_compactpdo_adds_the_missing_record_of_a_pdo() -> None:
    """It counts a PDO of which one record has a section, and adds the other record."""
    text = small_eds(STATUS + mapping("1A01", "rw", "1", "0x20000010"), info="CompactPDO=3\n", tx=2)
    device = started(text)
    assert (read(device, 0x1800, 1), read(device, 0x1801, 1)) == (0x189, 0x289)
    assert (read(device, 0x1A01), read(device, 0x1A01, 2)) == (1, NO_SUBINDEX)
    assert read(device, 0x1802, 1) == -0x06020000


# Combinations of access: an object that needs it is written without the procedure.


def test_a_mapping_with_a_fixed_count_is_written() -> None:
    text = communication("1800", "ro", "$NODEID+0x180") + mapping("1A00", "ro", "2", "0", "0")
    device = started(small_eds(STATUS + TARGET + text, tx=1))
    assert write(device, 0x1A00, 1, 0x20000010, 4) == 0
    assert write(device, 0x1A00, 2, 0x20000010, 4) == 0
    device.receive(START)
    device.trigger(1)
    assert device.take() == [Frame(0x189, b"\x34\x12\x34\x12")]
    assert write(device, 0x1A00, 2, 0x20010010, 4) == -0x06040041, "rww, so for an RPDO"
    assert write(device, 0x1A00, 2, 0, 4) == 0
    assert read(device, 0x1800, 1) == 0x189


def test_a_fixed_count_waits_for_a_cob_id_that_can_be_off() -> None:
    text = communication("1800", "rw", "$NODEID+0x180") + mapping("1A00", "const", "1", "0")
    device = started(small_eds(STATUS + text, tx=1))
    assert write(device, 0x1A00, 1, 0x20000010, 4) == STATE
    assert write(device, 0x1800, 1, 0x80000189, 4) == 0
    assert write(device, 0x1A00, 1, 0x20000010, 4) == 0


def test_a_mapping_is_written_while_the_cob_id_is_ro() -> None:
    text = communication("1400", "const", "$NODEID+0x200") + mapping(
        "1600", "rw", "1", "0x20010010", "0"
    )
    device = started(small_eds(TARGET + text, rx=1))
    assert write(device, 0x1600, 1, 0x20010010, 4) == ACCESS, "the number can be set to 0"
    assert write(device, 0x1600, 0, 0, 1) == 0
    assert write(device, 0x1600, 1, 0x00050008, 4) == 0
    assert write(device, 0x1600, 2, 0x20010010, 4) == 0
    assert write(device, 0x1600, 0, 2, 1) == 0
    device.receive(START)
    device.receive(Frame(0x209, b"\x00\x07\x00"))
    assert read(device, 0x2001) == 7


@pytest.mark.parametrize(
    ("cob_id", "inhibit"),
    [
        (("ro", "$NODEID+0x180"), 0),
        (("rw", "$NODEID+0x180", "HighLimit=0x7FF"), 0),
        (("rw", "$NODEID+0x180"), STATE),
    ],
)
def test_inhibit_time_of_a_tpdo_that_cannot_be_off(cob_id: tuple[str, ...], inhibit: int) -> None:
    text = communication("1800", *cob_id) + mapping("1A00", "const", "1", "0x20000010")
    device = started(small_eds(STATUS + text, tx=1))
    assert write(device, 0x1800, 3, 100, 2) == inhibit


@pytest.mark.parametrize("limit", ["", "HighLimit=0x7FF"])
def test_another_can_id_where_the_valid_bit_is_no_value(limit: str) -> None:
    text = (
        communication("1800", "rw", "$NODEID+0x180", limit)
        + mapping("1A00", "const", "1", "0x20000010")
        + entry("1014", 7, "rw", "$NODEID+0x80", limit)
    )
    device = started(small_eds(STATUS + text, tx=1))
    assert write(device, 0x1800, 1, 0x1A0, 4) == (0 if limit else STATE)
    assert write(device, 0x1014, 0, 0xA0, 4) == (0 if limit else STATE)


def test_the_sync_counter_where_the_period_is_ro() -> None:
    text = (
        entry("1005", 7, "rw", "0x80")
        + entry("1006", 7, "ro", "1000")
        + entry("1019", 5, "rw", "0")
    )
    device = started(small_eds(text))
    assert write(device, 0x1019, 0, 10, 1) == 0
    device = started(small_eds(text.replace("AccessType=ro", "AccessType=rw")))
    assert write(device, 0x1019, 0, 10, 1) == STATE


# Values that no service can work with.


@pytest.mark.parametrize("cob_id", ["0", "0x80", "0x5FF", "0x20000180"])
def test_a_pdo_with_a_reserved_can_id_is_off(cob_id: str) -> None:
    """Its frames would be commands of NMT, or answers of an SDO."""
    text = communication("1800", "rw", cob_id) + mapping("1A00", "const", "1", "0x20000010")
    device = started(small_eds(STATUS + text, tx=1))
    device.receive(START)
    device.trigger(1)
    sent = device.take()
    if cob_id == "0x80":
        assert [frame.can_id for frame in sent] == [0x80], "that of SYNC is not restricted"
    else:
        assert sent == []
        assert read(device, 0x1800, 1) >> 31


def test_emcy_and_sync_with_can_id_0_are_off() -> None:
    text = entry("1014", 7, "rw", "0") + entry("1005", 7, "rw", "0x40000000")
    device = started(small_eds(text + entry("1006", 7, "rw", "1000")))
    device.emergency(0x5000, 1)
    assert device.take() == []
    assert device.advance(10_000) == []


def test_a_mapping_of_2_to_the_32_objects_is_off() -> None:
    text = communication("1800", "rw", "$NODEID+0x180") + entry("1A00", 7, "rw", "0xFFFFFFFF")
    device = started(small_eds(STATUS + text, tx=1))
    assert read(device, 0x1800, 1) == 0x80000189


def test_a_pdo_without_a_cob_id_does_nothing() -> None:
    text = record("1800", entry("1800sub0", 5, "const", "2"), entry("1800sub2", 5, "rw", "1"))
    device = started(small_eds(STATUS + text + mapping("1A00", "const", "1", "0x20000010")))
    assert read(device, 0x1800, 2) == 1
    assert device.receive(START) == []


@pytest.mark.parametrize(
    ("data_type", "value", "read_back"), [(3, "200", 200), (9, "200", 200), (6, "200", 200)]
)
def test_a_heartbeat_time_of_another_type(data_type: int, value: str, read_back: int) -> None:
    device = started(small_eds(entry("1017", data_type, "rw", value)))
    assert read(device, 0x1017) == read_back
    warnings = [line for line in device.od.warnings if "1017" in line]
    assert len(warnings) == (data_type != 6)

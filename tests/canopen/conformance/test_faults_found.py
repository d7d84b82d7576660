"""A device that breaks a rule fails the case of that rule."""

import pytest
from altered_device import (
    EMCY,
    HEARTBEAT,
    SDO,
    TPDO,
    Change,
    alter,
    drop,
    is_frame,
    judge,
    twice,
)
from rich_eds import changed, without

from smarttac_can.canopen.conformance.case import Result
from smarttac_can.canopen.conformance.run import CASES, failed


def _swap_states(data: bytes) -> bytes:
    return bytes(({5: 0x7F, 0x7F: 5}.get(data[0], data[0]),))


OUTWARDS = {
    "no boot-up": (drop(is_frame(HEARTBEAT, first=0)), "HB-01 BOTH-05 TRANS-03 TRANS-04"),
    "boot-up twice": (twice(HEARTBEAT), "BOTH-05"),
    "wrong states": (alter(is_frame(HEARTBEAT), _swap_states), "GUARD-03 HB-04 STATE-02 TRANS-01"),
    "toggle bit stays 0": (
        alter(is_frame(HEARTBEAT), lambda data: bytes((data[0] & 0x7F,))),
        "GUARD-02",
    ),
    "no EMCY": (drop(is_frame(EMCY)), "EMCY-01 EMCY-02 GUARD-04 HB-06 SYNC-10 PDO-24 PDO-25"),
    "EMCY twice": (twice(EMCY), "EMCY-01"),
    "EMCY without register": (
        alter(is_frame(EMCY), lambda data: data[:2] + b"\0" + data[3:]),
        "EMCY-01",
    ),
    "TPDO too short": (alter(is_frame(TPDO), lambda data: data[:-1]), "PDO-01"),
    "no TPDO": (drop(is_frame(TPDO)), "PDO-01 PDO-02 PDO-03 PDO-09 PDO-13 PDO-19 SYNC-01 STATE-03"),
    "no SYNC": (drop(lambda f: f.can_id == 0x80), "SYNC-04 SYNC-06 SYNC-07"),
    "SDO data wrong": (
        alter(is_frame(SDO, first=0x43), lambda data: data[:4] + bytes((data[4] ^ 1,)) + data[5:]),
        "SDO-02 OD-03 OTHER-01",
    ),
    "abort without multiplexer": (
        alter(is_frame(SDO, first=0x80), lambda data: data[:1] + bytes(3) + data[4:]),
        "SDO-22",
    ),
    "answer of 7 bytes": (alter(is_frame(SDO), lambda data: data[:7]), "SDO-01 OD-01"),
    # Every refusal is a case of its own.
    "refusals confirmed": (
        alter(is_frame(SDO, first=0x80), lambda data: b"\x60" + data[1:4] + bytes(4)),
        "SDO-07 SDO-08 SDO-09 SDO-10 SDO-11 SDO-13 SDO-14 SDO-15 SDO-16 SDO-17 SDO-18 SDO-19 "
        "SDO-20 SDO-22 SDO-28 SDO-29 SDO-30 PDO-12 PDO-14 PDO-15 PDO-17 PDO-28 PDO-29 PDO-30 "
        "PDO-31 PDO-32 PDO-33 OD-01 OD-02 OD-04 OD-05 OD-06 EMCY-04 EMCY-05 SYNC-03 SYNC-05 "
        "SYNC-08 HB-07 OTHER-04 OTHER-06 OTHER-09",
    ),
    # Long values are read in segments by each of these cases.
    "toggle of upload segments stays 0": (
        alter(
            lambda f: f.can_id == SDO and f.data[0] >> 5 == 0,
            lambda data: bytes((data[0] & 0xEF,)) + data[1:],
        ),
        "SDO-04 OD-01 OD-02 OD-03 OD-07 OTHER-03 OTHER-07",
    ),
    "block acknowledged short": (
        alter(
            lambda f: f.can_id == SDO and f.data[0] & 0xE3 == 0xA2,
            lambda data: data[:1] + bytes((max(0, data[1] - 1),)) + data[2:],
        ),
        "SDO-25 SDO-26 SDO-27",
    ),
    "EMCY without error reset": (
        drop(lambda f: f.can_id == EMCY and f.data[:2] == b"\0\0"),
        "EMCY-02",
    ),
    "SYNC counter stays 0": (
        alter(lambda f: f.can_id == 0x80 and len(f.data) == 1, lambda _: b"\0"),
        "SYNC-07",
    ),
    "heartbeat twice": (twice(HEARTBEAT), "HB-03 HB-04 HB-05 BOTH-02 BOTH-03 BOTH-05 BOTH-07"),
    "TPDO twice": (twice(TPDO), "PDO-03 PDO-09 PDO-11 SYNC-02"),
    "wrong CRC": (
        alter(
            lambda f: f.can_id == SDO and f.data[0] & 0xE3 == 0xC1,
            lambda data: data[:1] + bytes((data[1] ^ 1,)) + data[2:],
        ),
        "SDO-23",
    ),
}


def _as_command(command: int, instead: int) -> Change:
    return alter(
        lambda f: f.can_id == 0 and f.data[:1] == bytes((command,)),
        lambda data: bytes((instead,)) + data[1:],
    )


INWARDS = {
    "deaf to SDO": (drop(is_frame(0x620)), "SDO-01 SDO-12 OD-01 STATE-02"),
    "deaf to commands for all": (
        drop(lambda f: f.can_id == 0 and f.data[1:] == b"\0"),
        "TRANS-02",
    ),
    "obeys commands for others": (
        alter(lambda f: f.can_id == 0 and len(f.data) == 2, lambda data: data[:1] + b"\0"),
        "TRANS-02",
    ),
    "STOPPED is PRE-OPERATIONAL": (_as_command(0x02, 0x80), "STATE-04 TRANS-01 BOTH-07"),
    "PRE-OPERATIONAL is OPERATIONAL": (_as_command(0x80, 0x01), "PDO-19 PDO-22 STATE-02"),
    "reset node is reset communication": (_as_command(0x81, 0x82), "TRANS-04"),
    "reset communication is reset node": (_as_command(0x82, 0x81), "TRANS-03"),
    "deaf to RPDO": (drop(is_frame(0x220)), "PDO-20 PDO-21 PDO-24 PDO-25"),
    "deaf to SYNC": (drop(is_frame(0x80)), "PDO-02 PDO-21 SYNC-01"),
    "deaf to remote frames": (drop(lambda f: f.rtr), "GUARD-01"),
    "toggle in the client's segment not looked at": (
        alter(is_frame(0x620, first=0x70), lambda data: b"\x60" + data[1:]),
        "SDO-07",
    ),
    "the client's abort ignored": (drop(is_frame(0x620, first=0x80)), "SDO-11"),
}  # fmt: skip


def numbers(results: list[Result]) -> str:
    return " ".join(result.case.number for result in results)


def in_order(expected: str) -> str:
    return " ".join(case.number for case in CASES if case.number in expected.split())


@pytest.mark.parametrize("fault", OUTWARDS)
def test_conform_fails_faults_in_sent_frames(fault: str) -> None:
    change, expected = OUTWARDS[fault]
    assert numbers(failed(judge(outwards=change, only=expected))) == in_order(expected)


@pytest.mark.parametrize("fault", INWARDS)
def test_conform_fails_faults_in_handling_of_frames(fault: str) -> None:
    change, expected = INWARDS[fault]
    assert numbers(failed(judge(inwards=change, only=expected))) == in_order(expected)


SHEETS = {
    "object missing": (without("2115"), "OD-01"),
    "another type": (changed("2115", "DataType=0x0007"), "OD-02"),
    "another default": (changed("1029sub1", "DefaultValue=1"), "OD-03"),
    "read-only entry takes values": (changed("2111", "AccessType=rw"), "OD-04"),
    "write-only entry is readable": (changed("2112", "AccessType=rw"), "OD-05"),
    "another vendor": (changed("1018sub1", "DefaultValue=0x00000124"), "OTHER-01"),
    "another name": (changed("1008", "DefaultValue=Something else"), "OTHER-03"),
    "another CAN-ID of EMCY": (changed("1014", "DefaultValue=$NODEID+0x90"), "EMCY-05"),
    "another heartbeat": (changed("1017", "DefaultValue=500"), "HB-02"),
}


@pytest.mark.parametrize("fault", SHEETS)
def test_device_that_is_not_as_its_eds_says(fault: str) -> None:
    text, expected = SHEETS[fault]
    assert numbers(failed(judge(text=text, only=expected))) == expected


def test_block_transfer_is_optional() -> None:
    refused = alter(
        lambda f: f.can_id == SDO and f.data[0] >> 5 in (5, 6),
        lambda data: b"\x80" + data[1:4] + (0x05040001).to_bytes(4, "little"),
    )
    (block,) = judge(outwards=refused, only="SDO-23")
    assert block.verdict == "not applicable"
    assert block.reason.startswith("the device has no SDO block transfer: abort 05040001")


def test_failed_case_names_its_last_frames() -> None:
    (result,) = judge(inwards=drop(is_frame(0x620)), only="SDO-01")
    assert result.reason == "no SDO response (5A0h) within 2 s (--timeout 2)"
    assert result.trace[-1] == "> 620 40 00 10 00 00 00 00 00"

"""Traps of an EDS for masters, generators and analysers, in the files of this repository."""

import re
from pathlib import Path

import pytest
from rich_eds import RICH_EDS

from smarttac_can.canopen.od.cia import DataType, ObjectType
from smarttac_can.canopen.od.data_types import SIGNED
from smarttac_can.canopen.od.eds import load_eds, read_sections

ROOT = Path(__file__).parents[3]
OWN = sorted((ROOT / "eds").glob("*.eds"))

each_file = pytest.mark.parametrize("path", [RICH_EDS, *OWN], ids=lambda path: path.stem)
each_own = pytest.mark.parametrize("path", OWN, ids=lambda path: path.stem)


def sections(path: Path) -> dict[str, dict[str, str]]:
    return read_sections(path.read_text(encoding="latin-1"), [])


@each_file
def test_a_domain_has_no_pdo_mapping(path: Path) -> None:
    """node-canopen refuses a DOMAIN with the key, whatever it says."""
    domains = [
        section
        for section in sections(path).values()
        if section.get("objecttype") in (f"0x{ObjectType.DOMAIN:X}", str(int(ObjectType.DOMAIN)))
    ]
    assert domains
    assert not [section for section in domains if "pdomapping" in section]


@each_file
def test_signed_values_are_decimal(path: Path) -> None:
    """dcfgen and generators in Go read 0xFFFE as 65534, outside of an INTEGER16."""
    looked_at = 0
    for name, section in sections(path).items():
        if int(section.get("datatype") or "0", 0) in SIGNED:
            for key in ("defaultvalue", "lowlimit", "highlimit"):
                text = section.get(key, "0")
                looked_at += 1
                assert re.fullmatch(r"-?[0-9]+", text), f"[{name}] {key}={text}"
    assert looked_at > 20


@each_file
def test_texts_are_printable_ascii(path: Path) -> None:
    od = load_eds(path.read_text(encoding="latin-1"), 32)
    for entry in od:
        if entry.data_type is DataType.VISIBLE_STRING:
            assert entry.default.isascii()
            assert entry.default.isprintable()


@each_own
def test_a_heartbeat_comes_twice_in_the_second_that_lely_waits(path: Path) -> None:
    od = load_eds(path.read_text(encoding="ascii"), 32)
    assert 0 < od["Producer heartbeat time"].default <= 500


def test_emcy_inhibit_time_bounds_the_frames_of_a_fault() -> None:
    od = load_eds((ROOT / "eds" / "stimulator.eds").read_text(encoding="ascii"), 32)
    assert od["Inhibit time EMCY"].default == 10, "1 ms"
    # A stimulator trips by the emergencies of its plate, and a second one must not come late.
    od = load_eds((ROOT / "eds" / "plate.eds").read_text(encoding="ascii"), 33)
    assert od["Inhibit time EMCY"].default == 0

"""Which identifiers matter to the host: those wanted, and those of its own that are urgent."""

from __future__ import annotations

from line import DRIVE, MEASUREMENT, START, both_nodes, plate_inside

from smarttac_can.canopen.device.frame import Frame

SYNC, NMT = 0x080, 0x000
STOP, PRE_OPERATIONAL = 0x02, 0x80


def test_loop_frames_are_urgent_and_public_ones_are_not() -> None:
    line, plate, node = both_nodes()
    line.nmt(START)
    assert plate.ids.urgent == {SYNC, 0x0A1, 0x721, *MEASUREMENT}
    assert node.ids.urgent == {SYNC, 0x0A0, 0x720, DRIVE}
    assert (plate.ids.emcy, node.ids.emcy) == (0x0A1, 0x0A0)


def test_with_the_plate_inside_no_tpdo_is() -> None:
    line, node = plate_inside()
    line.nmt(START)
    assert node.ids.urgent == {SYNC, 0x0A0, 0x720}


def test_everything_that_has_an_effect_is_heard() -> None:
    line, plate, node = both_nodes()
    line.nmt(START)
    own = {0x0A1, *MEASUREMENT, 0x5A1, 0x721}
    assert {NMT, SYNC, DRIVE, 0x621} | own <= plate.ids.heard, "another node may send its own"
    own = {0x0A0, DRIVE, 0x1A0, 0x2A0, 0x3A0, 0x4A0, 0x5A0, 0x720}
    assert {NMT, SYNC, *MEASUREMENT, 0x0A1, 0x220, 0x620, 0x721} | own <= node.ids.heard
    for each in (plate, node):
        for can_id in set(range(0x800)) - each.ids.heard:
            assert each.receive(Frame(can_id, bytes(8))) == []


def test_wanted_identifiers_are_equal_in_every_nmt_state() -> None:
    line, plate, node = both_nodes()
    for each in (plate, node):
        heard = each.ids.heard
        for command in (START, STOP, PRE_OPERATIONAL, STOP, START, PRE_OPERATIONAL):
            line.nmt(command)
            assert each.ids.heard == heard


def test_another_identifier_makes_them_others() -> None:
    line, _, node = both_nodes()
    before = node.ids
    cob_id = node.od.entry(0x1014, 0)
    assert line.write_entry(node, cob_id, 0x800000A0) == 0
    assert line.write_entry(node, cob_id, 0x000000B0) == 0
    assert node.ids is not before
    assert node.ids.emcy == 0x0B0
    assert node.ids.urgent >= {0x0B0}


def test_another_identifier_of_sync_is_told() -> None:
    line, _, node = both_nodes()
    assert node.ids.sync == SYNC
    assert line.write_entry(node, node.od.entry(0x1005, 0), 0x00000081) == 0
    assert node.ids.sync == 0x081
    assert node.ids.urgent >= {0x081}

"""While armed or running no write relaxes a limit or a watch."""

from typing import NamedTuple

import pytest
from driven import STATE, driven, write, write_entry
from inside import Loop

from smarttac_can.assurance.trials.fault_cases import disturb
from smarttac_can.assurance.trials.rig import Rig
from smarttac_can.bench.simulation import PLATE_ID, plate_od, stimulator_od
from smarttac_can.canopen.od.cia import Abort
from smarttac_can.canopen.od.dictionary import ObjectDictionary
from smarttac_can.canopen.od.entry import Entry
from smarttac_can.host.faulty_bus import FrameFault
from smarttac_can.instrument.nodes.lock import OF_PLATE, OF_STIMULATOR, Lock, Table
from smarttac_can.instrument.nodes.plate_node import PlateNode
from smarttac_can.instrument.nodes.stimulator_node import StimulatorNode
from smarttac_can.vocabulary.states import State

OK = 0


class Case(NamedTuple):
    """An entry, its value under a drive, a relaxed one, a tightened one; None is any, or none."""

    index: int
    subindex: int
    present: int | None
    relaxed: int | None
    tightened: int | None


CASES = (
    Case(0x2041, 1, 15_000, 15_001, 14_999),
    Case(0x2041, 3, 4_270_000, 4_269_999, 4_270_001),
    Case(0x1404, 5, 3, 4, 2),
    Case(0x1016, 1, 1 << 16 | 1000, 0, 1 << 16 | 999),
    Case(0x1005, 0, 0x80, 0x4000_0080, None),
    Case(0x1601, 0, 2, 0, None),
)
"""One of each rule, and a mapping; `test_lock_refuses_relaxing_writes_of_each_object` has all."""


def takes_no_relaxed(rig: Rig, case: Case, node: StimulatorNode | PlateNode) -> None:
    entry, node_id = node.od.entry(case.index, case.subindex), node.device.node_id
    before = entry.value
    assert case.present in (None, before)
    assert write_entry(rig, entry, before, node_id) == OK, "what was read may be written back"
    if case.relaxed is not None:
        assert write_entry(rig, entry, case.relaxed, node_id) == STATE
        assert entry.value == before


def takes(rig: Rig, case: Case, node: StimulatorNode | PlateNode, *values: int | None) -> None:
    entry = node.od.entry(case.index, case.subindex)
    for raw in values:
        if raw is not None:
            assert write_entry(rig, entry, raw, node.device.node_id) == OK


@pytest.mark.parametrize("case", CASES, ids=str)
def test_relaxing_is_refused_and_tightening_taken(case: Case) -> None:
    """While armed and while running; and at rest all that the device takes."""
    rig = driven()
    for word, state in ((1, State.ARMED), (3, State.RUNNING)):
        assert write(rig, "Controlword", word) == OK
        takes_no_relaxed(rig, case, rig.stimulator)
        assert rig.state is state
    takes(rig, case, rig.stimulator, case.tightened)
    rig.cycle(2)
    assert rig.state is State.RUNNING
    assert write(rig, "Controlword", 0) == OK
    if case.index == 0x1601:
        invalid = rig.od.entry(case.index - 0x200, 1)
        assert write_entry(rig, invalid, invalid.value | 1 << 31) == OK
    takes(rig, case, rig.stimulator, case.relaxed, case.tightened)


def test_a_refused_deadline_does_not_move_the_one_in_force() -> None:
    rig = driven()
    assert write_entry(rig, rig.od.entry(0x1404, 5), 100) == STATE
    disturb(FrameFault.LOSS, 0x1A1, 0x2A1, 0x3A1)(rig)
    rig.cycle(3)
    assert rig.state is State.FAULT


OF_THE_PLATE = (
    Case(0x2041, 1, 15_000, 15_001, 14_999),
    Case(0x1400, 5, 3, 100, 0),
    Case(0x1016, 1, 1 << 16 | 50, 0, 1 << 16 | 49),
    Case(0x1801, 2, 1, 254, None),
)


@pytest.mark.parametrize("case", OF_THE_PLATE, ids=str)
def test_the_plate_is_not_relaxed_while_its_stage_is_in_use(case: Case) -> None:
    """And in PRE-OPERATIONAL takes all that the device takes."""
    rig = driven()
    watch = rig.plate.od.entry(0x1016, 1)
    assert write_entry(rig, watch, 1 << 16 | 50, PLATE_ID) == OK
    takes_no_relaxed(rig, case, rig.plate)
    rig.cycle(30)
    assert rig.stage.read() > 0
    takes(rig, case, rig.plate, case.tightened)
    rig.nmt(0x80, PLATE_ID)
    takes(rig, case, rig.plate, case.relaxed, case.tightened)


@pytest.mark.parametrize(
    ("od", "table", "words"),
    [
        (stimulator_od(), OF_STIMULATOR, "while armed or running; disarm first"),
        (
            *(plate_od(), OF_PLATE),
            "while the stage is in use; disarm, and take the plate out of OPERATIONAL",
        ),
    ],
    ids=["stimulator", "plate"],
)
def test_lock_refusal_names_both_values_and_the_next_step(
    od: ObjectDictionary, table: Table, words: str
) -> None:
    with pytest.raises(Abort) as refused:
        Lock(od, table).require(od["Limit.Voltage"], 15_001)
    assert refused.value.reason == (
        "Limit.Voltage 150010 mV is refused, present value 150000 mV: "
        f"a higher value is refused {words}"
    )


Where = int | tuple[int, int]
"""An index with all that is there, or with a sub-index."""
OF_BOTH = {0x1005, 0x1006, 0x1014, 0x1017}


@pytest.mark.parametrize(
    ("od", "table", "other", "higher", "lower", "longer"),
    [
        (
            stimulator_od(),
            OF_STIMULATOR,
            {
                *(*OF_BOTH, *range(0x1600, 0x1604), 0x1804),
                *(0x2042, 0x2043, 0x2044, 0x2047),
                *((index, sub) for index in range(0x1400, 0x1407) for sub in (1, 2)),
            },
            {0x2041, 0x2046},
            {(0x2041, 3)},
            {(0x100C, 0), (0x100D, 0), *((index, 5) for index in range(0x1400, 0x1407))},
        ),
        (
            plate_od(),
            OF_PLATE,
            {
                *(*OF_BOTH, *range(0x1800, 0x1803)),
                *((0x1400, 1), (0x1400, 2)),
            },
            {0x2041, (0x1400, 5)},
            set(),
            {(0x100C, 0), (0x100D, 0)},
        ),
    ],
    ids=["stimulator", "plate"],
)
def test_lock_refuses_relaxing_writes_of_each_object(
    od: ObjectDictionary, table: Table, other: set[Where], higher: set[Where],
    lower: set[Where], longer: set[Where],
) -> None:  # fmt: skip
    """By place: values that relax it and others, whatever else would refuse them."""
    lock = Lock(od, table)

    def refused(entry: Entry, present: int, value: int) -> bool:
        entry.value = present
        try:
            lock.require(entry, value)
        except Abort as abort:
            assert abort.code == STATE
            return True
        return False

    found = set()
    for entry in od:
        # A present value of 5: one less, the same, one more, none; and 1 where there is none.
        relaxed = [refused(entry, *pair) for pair in ((5, 4), (5, 5), (5, 6), (5, 0), (0, 1))]
        places = {entry.index, (entry.index, entry.subindex)}
        if not entry.writable or entry.index == 0x1016:
            continue
        if places & lower:
            expected = [True, False, False, True, False]
        elif places & longer:
            expected = [False, False, True, True, False]
        elif places & higher:
            expected = [False, False, True, False, True]
        elif places & other:
            expected = [True, False, True, True, True]
        else:
            expected = [False] * 5
        assert relaxed == expected, entry.name
        assert (entry in lock.rules) == any(expected)
        found |= places
    assert other | higher | lower | longer <= found


@pytest.mark.parametrize("watch", range(1, 5))
@pytest.mark.parametrize(
    ("od", "table"), [(stimulator_od(), OF_STIMULATOR), (plate_od(), OF_PLATE)]
)
def test_every_watch_over_a_heartbeat_is_kept(
    od: ObjectDictionary, table: Table, watch: int
) -> None:
    lock, entry = Lock(od, table), od.entry(0x1016, watch)
    for present, relaxed in (
        (0x7F_0032, (0x7F_0033, 0x7F_8000, 0x7F_0000, 0x7E_0032, 0x80_0032, 0)),
        (0x7F_8000, (0x7F_8001, 0x7F_0000, 0)),
    ):
        entry.value = present
        for value in relaxed:
            with pytest.raises(Abort):
                lock.require(entry, value)
        for value in (present, present - 1):
            lock.require(entry, value)
    # 128 and 129 are no nodes, and 0 ms no watch: nothing is lost.
    for present in (0x80_0032, 0x81_0032, 0x7F_0000, 0):
        entry.value = present
        for value in (0, 0x07_0064):
            lock.require(entry, value)


def test_it_holds_without_a_bus_as_well() -> None:
    loop = Loop()
    for word, code in ((1, STATE), (0, OK)):
        assert loop.write("Controlword", word) == OK
        assert loop.write("Limit.Voltage", 20_000) == code

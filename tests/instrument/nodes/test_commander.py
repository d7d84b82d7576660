"""A commander in real time is supervised; one that starts anew, or rests, is lost."""

import struct

import pytest
from driven import MASTER, STATE, driven, reset_fault, write, write_entry
from line import PREOP as PRE_OPERATIONAL
from line import RESET, RESET_COMMUNICATION, START, STOP, Line, ready_inside
from one_watch import Present

from smarttac_can.assurance.trials.rig import Rig
from smarttac_can.bench.simulation import stimulator_od
from smarttac_can.canopen.device.device import Device
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.device.port import Clock
from smarttac_can.canopen.device.service import Application
from smarttac_can.canopen.od.cia import NMTCommand
from smarttac_can.instrument.nodes.stimulator_node import Commander, StimulatorNode
from smarttac_can.vocabulary.states import State
from smarttac_can.vocabulary.watchdogs import Watchdog

REFUSED = "not armed: the commander is not supervised: "
BOOT_UP, PREOP, STOPPED, OPERATIONAL = 0, 127, 4, 5
SETPOINT = Frame(0x320, struct.pack("<HI", 2000, 4_339_000))


def say(rig: Rig, state: int) -> None:
    rig.master.send(Frame(0x700 + MASTER, bytes((state,))))


def test_a_master_that_boots_again_is_gone_at_once() -> None:
    rig = driven()
    say(rig, BOOT_UP)
    assert rig.state is State.FAULT
    assert rig.stage.read() == 0
    assert rig.od["Diagnosis.Latched"].value == 1 << Watchdog.HEARTBEAT
    assert reset_fault(rig) == STATE, "it was not heard since"
    rig.cycle(100)
    assert reset_fault(rig) == 0


def test_a_master_that_is_gone_is_forgotten_with_its_watch() -> None:
    rig = driven()
    rig.heartbeat = False
    say(rig, BOOT_UP)
    assert rig.state is State.FAULT
    assert write_entry(rig, rig.od.entry(0x1016, 1), 0) == 0
    assert reset_fault(rig) == 0


def test_boot_up_after_a_reset_of_the_stimulator_is_no_loss() -> None:
    """The master may have been reset with it; it was heard before only."""
    rig = driven()
    rig.heartbeat = False
    rig.nmt(NMTCommand.RESET_COMMUNICATION, 32)
    assert write_entry(rig, rig.od.entry(0x1016, 1), MASTER << 16 | 1000) == 0
    say(rig, BOOT_UP)
    assert not rig.od["Diagnosis.Present"].value & 1 << Watchdog.HEARTBEAT


def watch() -> tuple[Clock, Commander, Present]:
    """A watch with its present faults."""
    present, device = Present(), Device(stimulator_od(), Application(), node_id=32)
    return device.clock, Commander(device, 0x21, present.observe, lockstep=False), present


def test_the_plate_may_boot_as_it_has_watchdogs_of_its_own() -> None:
    _, masters, present = watch()
    for state in (OPERATIONAL, BOOT_UP):
        masters.heard(0x21, state)
    assert not present
    masters.heard(MASTER, OPERATIONAL)
    masters.heard(MASTER, BOOT_UP)
    assert present == {Watchdog.HEARTBEAT}


@pytest.mark.parametrize("resting", [PREOP, STOPPED])
def test_master_out_of_operational_is_lost_after_1_s(resting: int) -> None:
    clock, masters, present = watch()
    for node_id in (MASTER, 2):
        masters.heard(node_id, OPERATIONAL)
    assert masters.level() == 0.0
    masters.heard(MASTER, resting)
    for _ in range(2):
        clock.advance(250_000)
        masters.heard(MASTER, resting)
        masters.heard(2, resting)
    assert masters.level() == 0.5, "the one that rests longest"
    clock.advance(499_999)
    for node_id in (MASTER, 2):
        masters.heard(node_id, resting)
    assert not present
    clock.advance(1)
    masters.heard(MASTER, resting)
    assert present == {Watchdog.HEARTBEAT}
    masters.heard(MASTER, OPERATIONAL)
    assert not present


def test_master_passing_pre_operational_is_not_lost() -> None:
    clock, masters, present = watch()
    masters.heard(MASTER, OPERATIONAL)
    for _ in range(2):
        masters.heard(MASTER, PREOP)
        clock.advance(900_000)
        masters.heard(MASTER, PREOP)
        assert not present
        masters.heard(MASTER, OPERATIONAL)
        clock.advance(40_000)


def test_a_master_that_never_announces_operational_is_not_gone() -> None:
    clock, masters, present = watch()
    for state in (BOOT_UP, *[PREOP] * 75):
        masters.heard(MASTER, state)
        clock.advance(20_000)
    assert not present


def test_a_node_that_is_silent_twice_is_back_once_it_is_heard() -> None:
    _, masters, present = watch()
    for lost in (True, True, False):
        masters.silent(5, lost)
        assert (Watchdog.HEARTBEAT in present) == lost


def test_setpoints_are_late_until_none_is() -> None:
    _, masters, present = watch()
    for rpdo, late, fault in (
        (2, True, True),
        (3, True, True),
        (2, False, True),
        (3, False, False),
    ):
        masters.late(rpdo, late)
        assert present == ({Watchdog.SETPOINT} if fault else set())


@pytest.mark.parametrize("command", [PRE_OPERATIONAL, STOP, RESET, RESET_COMMUNICATION])
def test_set_points_late_in_operational_are_not_so_outside(command: int) -> None:
    line, node = ready()
    assert line.write_entry(node, node.od.entry(0x1401, 5), 10) == 0
    line.send(SETPOINT)
    line.advance(11)
    late = 1 << Watchdog.SETPOINT
    assert node.od["Diagnosis.Present"].value & late
    line.nmt(command)
    assert not node.od["Diagnosis.Present"].value & late
    line.nmt(START)
    line.advance(100)
    assert not node.od["Diagnosis.Present"].value & late, "the deadline begins with a set-point"


@pytest.mark.parametrize(("other", "gone"), [(MASTER << 16 | 20, True), (2 << 16 | 30, False)])
def test_consumer_time_change_keeps_the_watch_node_change_resets(other: int, gone: bool) -> None:
    _, masters, present = watch()
    masters.heard(MASTER, OPERATIONAL)
    masters.consumer_changed(MASTER << 16 | 30, other)
    masters.heard(MASTER, BOOT_UP)
    assert present == ({Watchdog.HEARTBEAT} if gone else set())


def test_a_first_watch_does_not_stand_for_guarding_that_is_lost() -> None:
    _, masters, present = watch()
    masters.silent(0, True)
    masters.consumer_changed(0, MASTER << 16 | 30)
    assert present == {Watchdog.HEARTBEAT}


# Arming.


def ready(**presets: int) -> tuple[Line, StimulatorNode]:
    return ready_inside(**({"Drive_unwatched": 0} | presets))


def arm(line: Line, node: StimulatorNode) -> int:
    assert line.write(node, "Controlword", 0) == 0
    return line.write(node, "Controlword", 1)


def test_nobody_arms_unsupervised_in_real_time() -> None:
    line, node = ready()
    assert arm(line, node) == STATE
    assert node.block.state is State.READY
    assert node.od["Message"].value.startswith(REFUSED)
    line.send(Frame(0x220, bytes(3)), Frame(0x220, bytes((1, 0, 0))))
    assert node.block.state is State.READY
    assert line.read(node, "Cycle.Ignored controlwords") == 1


def test_in_lockstep_the_master_is_the_time() -> None:
    line, node = ready_inside(lockstep=True)
    assert node.od["Drive unwatched"].value == 0
    assert arm(line, node) == 0


def test_a_heartbeat_counts_once_it_was_heard_and_while_it_comes() -> None:
    line, node = ready()
    watch = node.od.entry(0x1016, 2)
    assert line.write_entry(node, watch, 9 << 16 | 30) == 0
    assert arm(line, node) == STATE, "never heard"
    line.send(Frame(0x709, bytes((PREOP,))))
    line.advance(29)
    assert arm(line, node) == 0, "whatever its state is"
    assert line.write(node, "Controlword", 0) == 0
    line.advance(2)
    assert arm(line, node) == STATE, "silent"
    line.send(Frame(0x709, bytes((OPERATIONAL,))))
    assert line.write_entry(node, watch, 0) == 0
    assert arm(line, node) == STATE, "not watched any more"


def test_a_setpoint_with_a_deadline_counts_once_it_came() -> None:
    line, node = ready()
    line.send(SETPOINT)
    assert arm(line, node) == STATE, "no deadline"
    assert line.write_entry(node, node.od.entry(0x1401, 5), 10) == 0
    assert arm(line, node) == STATE, "it has not come since"
    line.send(SETPOINT)
    assert arm(line, node) == 0


def test_arming_controlword_may_be_the_supervised_pdo() -> None:
    line, node = ready()
    assert line.write_entry(node, node.od.entry(0x1400, 5), 10) == 0
    line.send(Frame(0x220, bytes(3)), Frame(0x220, bytes((1, 0, 0))))
    assert node.block.state is State.ARMED


def test_a_master_that_guards_counts() -> None:
    line, node = ready()
    for index, raw in ((0x1017, 0), (0x100C, 100), (0x100D, 2)):
        assert line.write_entry(node, node.od.entry(index), raw) == 0
    assert arm(line, node) == STATE
    line.send(Frame(0x720, b"", rtr=True))
    assert arm(line, node) == 0
    line.advance(201)
    assert node.block.state is State.FAULT


SEND = "send the heartbeat of node"
ENTERED = "entered in Consumer heartbeat time but not heard yet"
GUARD = "guard this node: its life time is set, but no remote frame has come yet"


@pytest.mark.parametrize(
    ("written", "advice"),
    [
        (
            {},
            "enter your heartbeat in Consumer heartbeat time and send it, or set Drive unwatched "
            "to 1",
        ),
        ({(0x1016, 2): 9 << 16 | 30}, f"{SEND} 9, {ENTERED}"),
        (
            {(0x1016, entry): entry + 8 << 16 | 30 for entry in (1, 2, 3, 4)},
            f"{SEND} 9 or 10 or 11 or 12, {ENTERED}; its entries are all taken: write 0 to one "
            "for another",
        ),
        *(
            ({(0x1400 + n, 5): 10}, f"send RPDO {n + 1}, which has a deadline but has not come yet")
            for n in range(4)
        ),
        ({(0x1017, 0): 0, (0x100C, 0): 100, (0x100D, 0): 2}, GUARD),
        (
            {(0x100C, 0): 100, (0x100D, 0): 2},
            "set Producer heartbeat time to 0: life guarding rests beside a heartbeat",
        ),
        (
            {(0x1016, 1): 9 << 16 | 30, (0x1400, 5): 10},
            f"{SEND} 9, {ENTERED}, or send RPDO 1, which has a deadline but has not come yet",
        ),
    ],
)
def test_a_refused_arming_says_which_watch_is_missing(
    written: dict[tuple[int, int], int], advice: str
) -> None:
    line, node = ready()
    for (index, subindex), raw in written.items():
        assert line.write_entry(node, node.od.entry(index, subindex), raw) == 0
    assert arm(line, node) == STATE
    assert node.od["Message"].value == REFUSED + advice


def test_silent_plate_is_not_named_as_a_silent_master() -> None:
    rig = driven()
    assert rig.od.entry(0x1016, 4).value >> 16 == 0x21, "watched by default"
    assert write(rig, "Controlword", 0) == 0
    for index, subindex in ((0x1016, 1), (0x1401, 5)):
        assert write_entry(rig, rig.od.entry(index, subindex), 0) == 0
    rig.cycle(500)
    assert 0x21 in rig.stimulator.device.supervised_in_time, "its heartbeat comes each 500 ms"
    assert write(rig, "Controlword", 1) == STATE
    assert rig.od["Message"].value.startswith(f"{REFUSED}enter your heartbeat")
    for subindex in (1, 2, 3):
        assert write_entry(rig, rig.od.entry(0x1016, subindex), subindex << 16 | 30) == 0
    assert write(rig, "Controlword", 1) == STATE
    assert rig.od["Message"].value == (
        f"{REFUSED}{SEND} 1 or 2 or 3, {ENTERED}; its entries are all taken: write 0 to one for "
        "another"
    )

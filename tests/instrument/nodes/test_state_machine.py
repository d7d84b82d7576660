"""The state machine: every transition of the table, and every other pair refused."""

from itertools import product

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from line import (
    PREOP,
    RESET,
    RESET_COMMUNICATION,
    START,
    STOP,
    Line,
    plate_inside,
)

from smarttac_can.canopen.device.frame import Frame
from smarttac_can.instrument.nodes.states import TRANSITIONS, Event, Guard, StateMachine
from smarttac_can.instrument.nodes.stimulator_node import StimulatorNode
from smarttac_can.vocabulary.states import CONTROL_MASK, State

ALL = Guard.CLEAR | Guard.PREPARED
STATE = 0x08000022
OPEN_LOOP = 1
ARM, RUN, QUICK_STOP, FAULT_RESET = 1, 2, 4, 0x80


def machine_in(state: State) -> StateMachine:
    machine = StateMachine()
    machine.state = state
    return machine


@pytest.mark.parametrize(("state", "event"), list(product(State, Event)))
def test_every_event_has_its_rows_and_no_other(state: State, event: Event) -> None:
    rows = [row for row in TRANSITIONS if (row.state, row.event) == (state, event)]
    for holds in map(Guard, range(8)):
        machine = machine_in(state)
        allowed = [row for row in rows if row.guard & holds == row.guard]
        assert machine.handle(event, holds) == bool(allowed)
        assert machine.state is (allowed[0].next if allowed else state)


@pytest.mark.parametrize(
    ("event", "after"),
    [
        (Event.FAULT, State.FAULT),
        (Event.LEAVE, State.NOT_READY),
        (Event.DISARM, State.READY),
        (Event.STOP, State.ARMED),
        (Event.QUICK_STOP, State.QUICK_STOP),
        (Event.START_RUN, State.READY),
    ],
)
def test_end_of_a_drive_has_no_conditions(event: Event, after: State) -> None:
    machine = machine_in(State.RUNNING)
    assert machine.handle(event, Guard(0))
    assert machine.state is after


@pytest.mark.parametrize(("guard", "armed"), [(6, True), (2, False), (4, False), (5, False)])
def test_to_arm_takes_all_conditions_and_a_watch(guard: int, armed: bool) -> None:
    assert machine_in(State.READY).handle(Event.ARM, Guard(guard)) == armed


@pytest.mark.parametrize(
    ("guard", "after"),
    [(0, State.FAULT), (1, State.NOT_READY), (2, State.READY), (3, State.READY), (4, State.FAULT)],
)
def test_a_fault_is_reset_when_it_is_gone(guard: int, after: State) -> None:
    machine = machine_in(State.FAULT)
    assert machine.handle(Event.RESET, Guard(guard)) == (after is not State.FAULT)
    assert machine.state is after


def test_only_a_reset_that_rises_ends_a_fault() -> None:
    machine = machine_in(State.FAULT)
    machine.take_as_given(FAULT_RESET)
    for word, after in (
        (FAULT_RESET, State.FAULT), (0, State.FAULT), (FAULT_RESET, State.READY)
    ):  # fmt: skip
        assert machine.command(word, Guard(7))
        assert machine.state is after


def test_controlword_of_the_present_state_is_obeyed() -> None:
    machine = machine_in(State.READY)
    for word in (ARM, ARM, ARM | RUN, ARM | RUN):
        assert machine.command(word, Guard(7))
    assert machine.state is State.RUNNING
    assert not machine.command(RUN, Guard(7)), "it takes the arming back, and is no stop"
    assert machine.state is State.RUNNING


@pytest.mark.parametrize("word", [RUN, ARM | RUN, QUICK_STOP, ARM | QUICK_STOP, 8, 0x40])
def test_refused_command_when_ready_changes_nothing(word: int) -> None:
    machine = machine_in(State.READY)
    assert not machine.command(word, Guard(7))
    assert machine.state is State.READY
    assert machine.command(ARM, Guard(7)), "its bits were not taken as set"


@settings(max_examples=300)
@given(st.lists(st.tuples(st.integers(0, 255), st.sampled_from([Guard.NONE, Guard.CLEAR, ALL]))))
def test_no_controlword_skips_a_step(words: list[tuple[int, Guard]]) -> None:
    machine = StateMachine()
    machine.state = State.READY
    held = 0
    for word, holds in words:
        before = machine.state
        obeyed = machine.command(word, holds)
        if machine.state is not before:
            assert obeyed
        if machine.state is State.RUNNING and before is not State.RUNNING:
            assert before is State.ARMED
            assert (held & 3, word & 7) == (ARM, ARM | RUN)
            assert holds == ALL
        if machine.state is State.ARMED and before is State.READY:
            assert not held & ARM, "it has risen"
        if before is State.FAULT and machine.state is not State.FAULT:
            assert holds
            assert word & ~held & FAULT_RESET
        if obeyed:
            held = word
            assert not word & ~CONTROL_MASK


def ready() -> tuple[Line, StimulatorNode]:
    line, node = plate_inside()
    line.nmt(START)
    assert state(node) is State.NOT_READY
    line.advance(65)
    assert state(node) is State.READY
    assert line.write(node, "Setpoint.Voltage", 2000) == 0
    return line, node


def state(node: StimulatorNode) -> State:
    shown = State(node.od["Statusword"].value >> 8 & 7)
    assert shown is node.block.state
    assert bool(node.od["Statusword"].value & 1 << 5) == (shown is State.FAULT)
    return shown


def running() -> tuple[Line, StimulatorNode]:
    line, node = ready()
    line.run(node, OPEN_LOOP)
    line.advance(5)
    assert node.od["Drive.Voltage"].value == 2000
    return line, node


def test_the_way_up_and_down_by_sdo() -> None:
    line, node = ready()
    for word, after, voltage in (
        (ARM, State.ARMED, 0),
        (ARM | RUN, State.RUNNING, 2000),
        (ARM, State.ARMED, 0),
        (ARM | RUN, State.RUNNING, 2000),
        (0, State.READY, 0),
    ):
        assert line.write(node, "Mode", OPEN_LOOP) == 0
        assert line.write(node, "Controlword", word) == 0
        assert state(node) is after
        if not voltage:
            assert node.od["Drive.Voltage"].value == 0, "at once"
        line.advance(2)
        assert node.od["Drive.Voltage"].value == voltage


def test_only_running_drives_and_leaving_it_ends_the_mode() -> None:
    line, node = ready()
    assert line.write(node, "Mode", OPEN_LOOP) == 0
    line.advance(5)
    assert node.od["Drive.Voltage"].value == node.od["Mode display"].value == 0
    line.run(node, OPEN_LOOP)
    line.advance(1)
    assert node.od["Mode display"].value == OPEN_LOOP
    assert line.write(node, "Controlword", ARM) == 0
    assert node.od["Mode"].value == node.od["Mode display"].value == 0


@pytest.mark.parametrize("armed", [True, False])
def test_quick_stop(armed: bool) -> None:
    line, node = running()
    if armed:
        assert line.write(node, "Controlword", ARM) == 0
    assert line.write(node, "Controlword", QUICK_STOP | ARM | RUN) == 0
    assert state(node) is State.QUICK_STOP
    assert node.od["Drive.Voltage"].value == 0
    for word in (ARM, ARM | RUN, RUN):
        assert line.write(node, "Controlword", word) == STATE
    assert line.write(node, "Controlword", FAULT_RESET) == 0, "all commands are taken back"
    assert state(node) is State.READY


def test_start_run_disarms_and_ignores_the_standing_controlword() -> None:
    line, node = running()
    assert line.write(node, "Simulation.Start run", 1) == 0
    assert state(node) is State.READY
    assert node.od["Drive.Voltage"].value == 0
    assert line.read(node, "Controlword") == ARM | RUN
    assert line.write(node, "Controlword", ARM) == STATE, "it has not been taken back"
    assert line.write(node, "Controlword", 0) == 0
    assert line.write(node, "Controlword", ARM) == 0


@pytest.mark.parametrize("command", [STOP, PREOP, RESET, RESET_COMMUNICATION])
def test_leaving_operational_disarms_and_is_a_fault_when_running(command: int) -> None:
    line, node = ready()
    assert line.write(node, "Controlword", ARM) == 0
    line.nmt(command)
    assert state(node) is State.NOT_READY
    line.nmt(START)
    line.advance(66)
    assert state(node) is State.READY
    assert line.write(node, "Setpoint.Voltage", 2000) == 0
    line.run(node, OPEN_LOOP)
    line.advance(2)
    emergencies = [frame for frame in line.nmt(command) + line.nmt(START) if frame.can_id == 0xA0]
    assert [frame.data[:3] for frame in emergencies] == [bytes.fromhex("80 81 11")]
    assert state(node) is State.FAULT
    assert node.od["Drive.Voltage"].value == node.od["Mode"].value == 0
    assert node.od.entry(0x1003, 1).value == 0x8180
    assert line.write(node, "Controlword", 0) == 0
    assert line.write(node, "Controlword", ARM) == STATE
    assert line.write(node, "Controlword", FAULT_RESET) == 0
    line.advance(66)
    assert state(node) is State.READY


def controlword(word: int, mode: int = OPEN_LOOP) -> Frame:
    return Frame(0x220, bytes((word, 0, mode)))


def test_a_controlword_that_stands_by_rpdo_does_not_arm() -> None:
    line, node = ready()
    line.send(controlword(ARM), controlword(ARM))
    assert state(node) is State.READY
    line.send(controlword(0), controlword(ARM))
    assert state(node) is State.ARMED
    line.nmt(STOP)
    line.nmt(START)
    line.advance(2)
    line.send(controlword(ARM), controlword(ARM))
    assert state(node) is State.READY

"""The supervisor without a node: drives, latches, messages and resets."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import pytest
from one_watch import LIFTED, UNTARED, plan_of

from smarttac_can.bench.simulation import PLATE_ID, stimulator_od
from smarttac_can.canopen.od.cia import Abort
from smarttac_can.instrument.nodes import supervisor
from smarttac_can.instrument.nodes.bounds import InForce
from smarttac_can.instrument.nodes.stimulator_node import StimulatorNode
from smarttac_can.instrument.nodes.supervisor import Supervisor
from smarttac_can.instrument.nodes.watches import WatchState
from smarttac_can.vocabulary.signals import Drive
from smarttac_can.vocabulary.states import Mode, State
from smarttac_can.vocabulary.watchdogs import WATCHDOGS, Watchdog

ARM, RUN, QUICK_STOP, FAULT_RESET = 1, 2, 4, 0x80
NMT, HEARTBEAT, BUS_OFF = 1 << 0, 1 << 1, 1 << 7
NORMAL, LATERAL, STUCK, CONTROLLER, DOUBLE = 1 << 12, 1 << 13, 1 << 15, 1 << 19, 1 << 22
BUS_OFF_TEXT = "the CAN controller is bus-off"
ASKED = Drive(20.0, 43390.0)
LOWEST, HIGHEST = 43000.0, 44000.0

pytestmark = pytest.mark.sources


class Loop:
    """A supervisor with watchdogs set by a test."""

    def __init__(self, state: State = State.READY) -> None:
        self.od = stimulator_od()
        self.beyond = False
        plan = plan_of(self.od)._replace(f_min=LOWEST, f_max=HIGHEST)
        self.supervisor = Supervisor(self.od, plan)
        self.supervisor.note_zero()
        self.cycle()
        words = {State.ARMED: (ARM,), State.RUNNING: (ARM, ARM | RUN)}
        for word in words.get(state, ()):
            self.supervisor.command(word)
        assert self.supervisor.state is state

    def cycle(
        self,
        faults: int = 0,
        asked: Drive = ASKED,
        mode: Mode = Mode.OPEN_LOOP,
    ) -> Drive:
        """Have the watchdogs see these faults, and the bound of the vibration cut to 30 V."""
        cascade: Any = SimpleNamespace(mode=mode, contact=LIFTED, zero=UNTARED, tared=True)
        measured: Any = None

        def cut_and_record(
            _plan: object, _vibration: object, in_force: InForce, drive: Drive, _late: bool
        ) -> tuple[InForce, Drive]:
            return in_force, drive._replace(voltage=min(drive.voltage, 30.0))

        def watch_step(_plan: object, state: WatchState, _seen: object) -> tuple[WatchState, int]:
            vibration = state.vibration._replace(beyond=self.beyond)
            return state._replace(vibration=vibration), faults

        with (
            patch.object(supervisor, "watch_step", watch_step),
            patch.object(supervisor, "cut_and_record", cut_and_record),
        ):
            return self.supervisor.permit(asked, measured, mode, cascade, late=False)

    def come(self, watchdog: Watchdog) -> None:
        self.supervisor.observe(1 << watchdog, 1 << watchdog)

    def go(self, watchdog: Watchdog) -> None:
        self.supervisor.observe(0, 1 << watchdog)

    @property
    def shown(self) -> tuple[int, int, int]:
        """Code, present and latched, as a master reads them."""
        code, present, latched = (
            self.od[f"Diagnosis.{name}"].value for name in ("Code", "Present", "Latched")
        )
        supervisor = self.supervisor
        assert (present, latched) == (supervisor.present, supervisor.latched)
        return code, present, latched

    @property
    def message(self) -> str:
        return str(self.od["Message"].value)

    def by_rpdo(self, word: int) -> None:
        self.od["Controlword"].value = word
        self.supervisor.take_controlword()

    @property
    def ignored(self) -> int:
        return int(self.od["Cycle.Ignored controlwords"].value)


def test_supervisor_starts_without_fault_and_obeys_first_word() -> None:
    loop = Loop()
    assert loop.shown == (0, 0, 0)
    loop.by_rpdo(ARM)
    assert loop.supervisor.state is State.ARMED


@pytest.mark.parametrize(
    ("state", "voltage"), [(State.READY, 0.0), (State.ARMED, 0.0), (State.RUNNING, 20.0)]
)
def test_only_running_lets_a_voltage_out(state: State, voltage: float) -> None:
    loop = Loop(state)
    assert loop.cycle() == Drive(voltage, 43390.0)
    assert loop.supervisor.state is state


def test_supervisor_sends_the_voltage_cut_by_the_bound() -> None:
    loop = Loop(State.RUNNING)
    assert loop.cycle(asked=Drive(80.0, 43390.0)) == Drive(30.0, 43390.0)


def test_reading_beyond_the_range_gives_0_v_without_a_fault() -> None:
    loop = Loop(State.RUNNING)
    loop.beyond = True
    assert loop.cycle() == Drive(0.0, 43390.0)
    assert loop.cycle(mode=Mode.IDENTIFY) == Drive(20.0, 43390.0), "there it is a fault"
    loop.beyond = False
    assert loop.cycle() == Drive(20.0, 43390.0)
    assert loop.shown == (0, 0, 0)


def test_a_cycle_with_a_fault_lets_none_out() -> None:
    loop = Loop(State.RUNNING)
    assert loop.cycle(STUCK) == Drive(0.0, 43390.0)
    assert loop.supervisor.state is State.FAULT
    assert loop.shown == (0x5211, STUCK, STUCK)
    assert loop.message == "a sensor is stuck"


@pytest.mark.parametrize(
    ("frequency", "sent"),
    [
        (LOWEST, LOWEST),
        (HIGHEST, HIGHEST),
        (LOWEST - 0.1, 43500.0),
        (HIGHEST + 0.1, 43500.0),
        (float("nan"), 43500.0),
    ],
)
def test_at_0_v_a_frequency_beyond_its_limits_is_the_last_one(
    frequency: float, sent: float
) -> None:
    loop = Loop()
    loop.od["Drive.Frequency"].value = 4_350_000
    assert loop.cycle(asked=Drive(20.0, frequency)) == Drive(0.0, sent)


def test_a_fault_when_ready_is_present_and_not_latched() -> None:
    loop = Loop()
    loop.cycle(STUCK)
    assert (loop.supervisor.state, loop.shown) == (State.NOT_READY, (0, STUCK, 0))
    loop.cycle()
    assert (loop.supervisor.state, loop.shown) == (State.READY, (0, 0, 0))
    loop.come(Watchdog.BUS_OFF)
    assert (loop.supervisor.state, loop.shown) == (State.NOT_READY, (0, BUS_OFF, 0))
    assert loop.message == ""
    loop.go(Watchdog.BUS_OFF)
    assert (loop.supervisor.state, loop.shown) == (State.NOT_READY, (0, 0, 0))
    loop.cycle()
    assert loop.supervisor.state is State.READY


@pytest.mark.parametrize("state", [State.ARMED, State.RUNNING])
def test_fault_when_armed_is_latched_and_later_ones_are_added(state: State) -> None:
    loop = Loop(state)
    assert loop.supervisor.armed
    loop.come(Watchdog.BUS_OFF)
    assert not loop.supervisor.armed
    assert (loop.supervisor.state, loop.shown) == (State.FAULT, (0x8141, BUS_OFF, BUS_OFF))
    loop.come(Watchdog.HEARTBEAT)
    assert loop.shown == (0x8141, BUS_OFF | HEARTBEAT, BUS_OFF | HEARTBEAT)
    assert loop.message == BUS_OFF_TEXT, "that of the first"
    assert len(loop.supervisor.memory.lines) == 1
    loop.cycle(STUCK)
    assert loop.shown == (0x8141, BUS_OFF | HEARTBEAT | STUCK, BUS_OFF | HEARTBEAT)
    loop.cycle()
    assert loop.shown == (0x8141, BUS_OFF | HEARTBEAT, BUS_OFF | HEARTBEAT)


def test_plate_temperature_emcy_between_cycles_is_latched() -> None:
    """It is looked at in every cycle too; that it is latched there depends on when it comes."""
    loop = Loop(State.RUNNING)
    loop.come(Watchdog.BUS_OFF)
    loop.come(Watchdog.TEMPERATURE)
    hot = 1 << Watchdog.TEMPERATURE
    assert loop.shown == (0x8141, BUS_OFF | hot, BUS_OFF | hot)
    loop.cycle()
    assert loop.shown == (0x8141, BUS_OFF, BUS_OFF | hot)


def test_a_fault_is_reset_when_none_that_is_latched_is_present() -> None:
    loop = Loop(State.RUNNING)
    command = loop.supervisor.command
    loop.come(Watchdog.BUS_OFF)
    command(0)
    assert loop.shown == (0x8141, BUS_OFF, BUS_OFF), "to disarm resets nothing"
    with pytest.raises(Abort):
        command(FAULT_RESET)
    loop.go(Watchdog.BUS_OFF)
    assert loop.message == BUS_OFF_TEXT, "until it is reset"
    command(FAULT_RESET)
    assert (loop.supervisor.state, loop.shown) == (State.READY, (0, 0, 0))
    assert loop.message == ""


def test_later_fault_that_is_present_keeps_the_state_not_ready() -> None:
    loop = Loop(State.RUNNING)
    loop.come(Watchdog.NMT)
    loop.cycle(STUCK)
    loop.supervisor.command(0)
    loop.supervisor.command(FAULT_RESET)
    assert (loop.supervisor.state, loop.shown) == (State.NOT_READY, (0, STUCK, 0))


def test_unlatched_fault_that_needs_a_person_is_in_message() -> None:
    loop = Loop()
    loop.come(Watchdog.DOUBLE)
    assert loop.message.startswith("another node sends with an identifier")
    loop.go(Watchdog.DOUBLE)
    assert loop.message == ""


def test_a_message_about_something_else_stays() -> None:
    loop = Loop()
    loop.come(Watchdog.BUS_OFF)
    loop.od["Message"].value = "about something else"
    loop.come(Watchdog.DOUBLE)
    loop.od["Message"].value = "about something else"
    loop.go(Watchdog.DOUBLE)
    loop.go(Watchdog.BUS_OFF)
    loop.cycle()
    loop.supervisor.command(ARM)
    assert loop.message == "about something else"
    loop.come(Watchdog.BUS_OFF)
    loop.come(Watchdog.DOUBLE)
    assert loop.message == BUS_OFF_TEXT


@pytest.mark.parametrize("latched", [False, True])
def test_new_run_clears_message_except_of_a_latched_fault(latched: bool) -> None:
    loop = Loop(State.ARMED)
    if latched:
        loop.come(Watchdog.BUS_OFF)
    else:
        loop.od["Message"].value = "about something else"
    loop.supervisor.start_run(tared=False)
    assert loop.message == (BUS_OFF_TEXT if latched else "")
    assert loop.supervisor.state is (State.FAULT if latched else State.NOT_READY)


@pytest.mark.parametrize("lacking", ["live", "operational", "tared"])
def test_ready_needs_each_of_its_conditions(lacking: str) -> None:
    loop = Loop()
    supervisor = loop.supervisor
    setattr(supervisor, lacking, False)
    supervisor.prepare()
    assert supervisor.state is State.NOT_READY
    setattr(supervisor, lacking, True)
    supervisor.prepare()
    assert supervisor.state is State.READY


@pytest.mark.parametrize(
    ("state", "after", "latched"),
    [
        (State.READY, State.NOT_READY, 0),
        (State.ARMED, State.NOT_READY, 0),
        (State.RUNNING, State.FAULT, NMT),
    ],
)
def test_leaving_operational_or_restart_when_running_is_a_fault(
    state: State, after: State, latched: int
) -> None:
    for act in (Supervisor.leave, Supervisor.restart):
        loop = Loop(state)
        act(loop.supervisor)
        assert loop.supervisor.state is after
        assert loop.shown == (0x8180 if latched else 0, 0, latched)
        assert not loop.supervisor.live


def test_restart_clears_latched_faults_and_the_last_controlword() -> None:
    loop = Loop(State.ARMED)
    loop.come(Watchdog.BUS_OFF)
    loop.supervisor.restart()
    assert (loop.supervisor.state, loop.shown) == (State.NOT_READY, (0, 0, 0))
    loop.cycle()
    loop.by_rpdo(ARM)
    assert loop.supervisor.state is State.ARMED


@pytest.mark.parametrize("fault", [NORMAL, LATERAL])
def test_no_tare_while_sharp_or_under_a_force_that_has_tripped(fault: int) -> None:
    loop = Loop()
    supervisor = loop.supervisor
    assert not supervisor.tare_inhibited
    loop.cycle(fault)
    assert not supervisor.tare_inhibited, "present, but not latched"
    loop.cycle()
    supervisor.command(ARM)
    assert supervisor.tare_inhibited
    loop.cycle(fault)
    assert supervisor.state is State.FAULT
    assert supervisor.tare_inhibited
    loop.cycle()
    assert not supervisor.tare_inhibited, "latched, but gone"
    supervisor.command(0)
    supervisor.command(FAULT_RESET)
    supervisor.command(0)
    supervisor.command(ARM)
    loop.cycle(STUCK)
    assert not supervisor.tare_inhibited, "no force"


def test_controlword_by_rpdo_acts_once_and_counts_if_illegal() -> None:
    loop = Loop()
    for word, state, ignored in (
        (RUN, State.READY, 1),
        (RUN, State.READY, 1),
        (0, State.READY, 1),
        (ARM, State.ARMED, 1),
        (ARM | RUN, State.RUNNING, 1),
        (0x40, State.RUNNING, 2),
    ):
        loop.by_rpdo(word)
        assert (loop.supervisor.state, loop.ignored) == (state, ignored)


@pytest.mark.parametrize(("word", "code"), [(0x40, 0x06090030), (RUN, 0x08000022)])
def test_a_word_by_sdo_is_refused_with_a_reason(word: int, code: int) -> None:
    loop = Loop()
    with pytest.raises(Abort) as refused:
        loop.supervisor.command(word)
    assert refused.value.code == code
    assert loop.message == "", "the reason is no missing watch"


def faults(loop: Loop) -> list[str]:
    """The fault memory as a master reads it."""
    texts = [loop.od[f"Fault memory.Fault {number}"].value for number in range(1, 9)]
    return [text for text in texts if text]


def test_fault_is_stored_with_its_cause_and_setpoint() -> None:
    loop = Loop(State.RUNNING)
    assert faults(loop) == []
    loop.od["Mode"].value = Mode.AMPLITUDE
    for name, raw in (("Voltage", 4000), ("Amplitude", 1000), ("COF left", 3500)):
        loop.od[f"Setpoint.{name}"].value = raw
    loop.come(Watchdog.BUS_OFF)
    kept = [
        f"8141h {BUS_OFF_TEXT}; mode amplitude, Voltage 40000 mV, Frequency 43390 Hz, "
        "Amplitude 1000 nm, COF left 0.35, COF right 0.3"
    ]
    assert faults(loop) == kept
    loop.go(Watchdog.BUS_OFF)
    loop.supervisor.command(0)
    loop.supervisor.command(FAULT_RESET)
    assert faults(loop) == kept, "beyond the reset of the fault"


def test_a_reset_keeps_the_memory_and_out_of_running_adds_to_it() -> None:
    loop = Loop(State.RUNNING)
    loop.supervisor.memory.recall(("old",))
    loop.od.reset()
    loop.supervisor.restart()
    assert faults(loop) == ["8180h NMT left OPERATIONAL while running; reset node", "old"]


def test_eight_faults_are_kept_the_newest_first() -> None:
    loop = Loop(State.RUNNING)
    loop.supervisor.memory.recall(tuple(f"old {number}" for number in range(9)))
    assert faults(loop) == [f"old {number}" for number in range(8)]
    loop.come(Watchdog.BUS_OFF)
    assert faults(loop)[0].startswith("8141h")
    assert faults(loop)[1:] == [f"old {number}" for number in range(7)]


def unwatched() -> Loop:
    loop = Loop()
    loop.supervisor.supervised = False
    loop.supervisor.advice = lambda: "send a heartbeat"
    return loop


def test_an_unsupervised_commander_cannot_arm_and_is_told_why() -> None:
    loop = unwatched()
    loop.supervisor.command(0)
    with pytest.raises(Abort) as refused:
        loop.supervisor.command(ARM)
    assert refused.value.reason == "not armed: the commander is not supervised: send a heartbeat"
    loop.supervisor.supervised = True
    with pytest.raises(Abort) as refused:
        loop.supervisor.command(RUN)
    assert refused.value.reason == (
        "Controlword 0002h is refused in state ready: write 0, then 1 (arm), then 3 (run)"
    )
    loop.supervisor.command(ARM)


def test_nobody_arms_before_the_first_cycle_after_a_start() -> None:
    loop = Loop()
    loop.supervisor.leave()
    loop.supervisor.enter()
    with pytest.raises(Abort) as refused:
        loop.supervisor.command(ARM)
    assert refused.value.reason == (
        "not armed: no cycle was measured since the node was started, see that the plate runs"
    )
    loop.cycle()
    loop.supervisor.command(ARM)


def test_a_refusal_is_told_until_its_record_takes_a_write() -> None:
    loop = Loop()
    loop.supervisor.refuse("Setpoint.Voltage", "too high")
    loop.supervisor.accept("Mode")
    assert loop.message == "too high"
    loop.supervisor.accept("Setpoint.Amplitude")
    assert loop.message == ""
    loop.supervisor.refuse("Mode", "none")
    loop.od["Message"].value = "about something else"
    loop.supervisor.accept("Mode")
    assert loop.message == "about something else"


def test_message_of_latched_or_open_fault_outlasts_a_refusal() -> None:
    loop = Loop(State.ARMED)
    loop.come(Watchdog.BUS_OFF)
    loop.supervisor.refuse("Mode", "none")
    loop.supervisor.accept("Mode")
    assert loop.message == BUS_OFF_TEXT
    loop = Loop()
    loop.come(Watchdog.DOUBLE)
    told = loop.message
    loop.supervisor.refuse("Mode", "none")
    assert loop.message == "none"
    loop.supervisor.accept("Mode")
    assert loop.message == told


def test_it_is_told_only_where_the_watch_is_all_that_lacks() -> None:
    loop = unwatched()
    loop.cycle(STUCK)
    with pytest.raises(Abort) as refused:
        loop.supervisor.command(ARM)
    assert refused.value.reason == f"not armed: {WATCHDOGS[Watchdog.STUCK].text}"


@pytest.mark.parametrize(
    ("watchdog", "told"),
    [
        (Watchdog.AMPLITUDE, True),
        (Watchdog.SATURATED, True),
        (Watchdog.PICKUP, True),
        (Watchdog.RESONANCE, True),
        (Watchdog.UNSEEN, True),
        (Watchdog.NORMAL_FORCE, False),
        (Watchdog.TEMPERATURE, False),
        (Watchdog.STUCK, False),
    ],
)
@pytest.mark.parametrize("late", ["", "3 of the last 20 drives late"])
def test_late_drives_are_told_of_where_they_may_be_the_cause(
    watchdog: Watchdog, told: bool, late: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    loop = Loop(State.RUNNING)
    node = StimulatorNode(stimulator_od(), plate_node_id=PLATE_ID)
    monkeypatch.setattr(node._loop, "late_answers", SimpleNamespace(summary=lambda: late))
    loop.supervisor.details = node.block.supervisor.details
    loop.cycle(1 << watchdog)
    text = WATCHDOGS[watchdog].text + (f"; {late}" if told and late else "")
    assert loop.message == text
    assert loop.supervisor.memory.lines[0].partition("h ")[2].startswith(f"{text}; mode ")


def test_the_message_of_a_latched_fault_stays_as_the_fault_goes() -> None:
    loop = Loop(State.ARMED)
    loop.come(Watchdog.DOUBLE)
    text = loop.message
    assert text.startswith("another node sends")
    loop.go(Watchdog.DOUBLE)
    assert loop.message == text

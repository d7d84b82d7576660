"""The supervisor: state machine; present, latched and stored faults; and their objects."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Final, NamedTuple

from smarttac_can.canopen.od.cia import Abort, AbortCode
from smarttac_can.canopen.od.dictionary import ObjectDictionary
from smarttac_can.canopen.od.entry import Entry
from smarttac_can.instrument.nodes.bounds import UNDRIVEN, InForce, cut_and_record, without_lifts
from smarttac_can.instrument.nodes.process_image import Measured
from smarttac_can.instrument.nodes.states import Event, Guard, StateMachine
from smarttac_can.instrument.nodes.watches import (
    Seen,
    WatchPlan,
    WatchState,
    at_rest,
    watch_step,
)
from smarttac_can.science.control.cascade import Cascade
from smarttac_can.vocabulary.meanings import TARE, UNSUPERVISED
from smarttac_can.vocabulary.signals import Drive
from smarttac_can.vocabulary.states import CONTROL_MASK, Mode, State
from smarttac_can.vocabulary.watchdogs import (
    CYCLIC,
    WATCHDOGS,
    Watchdog,
    watchdogs_in,
)

_PLACES: Final = range(1, 9)
_SETPOINTS: Final = ("Voltage", "Frequency", "Amplitude", "COF left", "COF right")


class FaultMemory:
    """Text lines of the last faults, the newest first: code, cause, mode and set-points.

    It is only a record. The supervisor holds the latched faults, which inhibit a run.

    Parameters
    ----------
    od
        Object dictionary of ``stimulator.eds``.

    Attributes
    ----------
    lines
        Stored lines, as a tuple that another thread may read.
    """

    def __init__(self, od: ObjectDictionary) -> None:
        self._places = [od[f"Fault memory.Fault {number}"] for number in _PLACES]
        self._mode = od["Mode"]
        self._setpoints = [od[f"Setpoint.{name}"] for name in _SETPOINTS]
        self.lines: tuple[str, ...] = ()

    def recall(self, lines: tuple[str, ...]) -> None:
        """Start with lines that were stored elsewhere."""
        self.lines = lines[: len(self._places)]
        self.show()

    def show(self) -> None:
        """Write the lines to the object dictionary, also after a reset of it."""
        for place in self._places:
            place.value = ""
        for place, line in zip(self._places, self.lines, strict=False):
            place.value = line

    def note(self, code: int, text: str, circumstances: str) -> None:
        """Add a fault, with mode and set-points unless other circumstances are given."""
        line = f"{code:04X}h {text}; {circumstances or self._asked()}"
        self.recall((line, *self.lines))

    def _asked(self) -> str:
        mode = Mode(self._mode.value).name.lower().replace("_", " ")
        return ", ".join([f"mode {mode}", *map(_shown, self._setpoints)])


def _shown(entry: Entry) -> str:
    return f"{entry.name.rpartition('.')[2]} {entry.shown(entry.value)}"


# Needed in every cycle: module constants, as looking up an enumeration member is much slower.
_ARMED: Final = State.ARMED
_RUNNING: Final = State.RUNNING
_ARMED_STATES: Final = (_ARMED, _RUNNING)
_IDENTIFY: Final = int(Mode.IDENTIFY)
"""The mode without a finger, in which too much vibration is a fault."""
_CONTROLWORD: Final = "Controlword"
_PRESENT: Final = CYCLIC | sum(1 << w for w, row in WATCHDOGS.items() if row.lasting)
"""Bits of the faults that stay present until they are observed, or reported, as gone."""
_SHOWN: Final = sum(1 << watchdog for watchdog, row in WATCHDOGS.items() if row.shown)
_OVERLOAD: Final = 1 << Watchdog.NORMAL_FORCE | 1 << Watchdog.LATERAL_FORCE


class Diagnosis(NamedTuple):
    """Objects that show the code of the first latched fault, and the bits of all faults."""

    code: Entry
    present: Entry
    latched: Entry


class Refusal(NamedTuple):
    """Record to which a write was refused, and the reason."""

    record: str
    reason: str


_NO_REFUSAL: Final = Refusal("", "")


class Supervisor:
    """Permit a voltage only in RUNNING; latch a fault that comes while armed or running.

    It switches nothing off and sends nothing: the caller reads the state and the latched faults.

    Parameters
    ----------
    od
        Object dictionary of ``stimulator.eds``.
    plan
        Plan of the watchdogs at the start.

    Attributes
    ----------
    machine
        The state machine.
    plan
        Plan of the watchdogs; to be replaced only between two cycles.
    watch
        State of the watchdogs after the last cycle.
    in_force
        Drives that may be in force until the next one.
    memory
        Last faults as text.
    operational
        Whether the NMT state allows a voltage; True without CANopen.
    live
        Whether a measurement was received since the device became operational.
    tared
        Whether the gauges have a zero.
    supervised
        Whether a loss of the commander would be detected, or detection is not required; True
        without CANopen.
    advice
        Function that returns how to become supervised. It is called when arming is refused because
        the commander is not supervised.
    details
        Function that returns details for the text of a fault, such as the number of late drives. It
        is called when the fault is latched.
    present, latched
        Faults as bits, 1 << `Watchdog`.
    """

    def __init__(self, od: ObjectDictionary, plan: WatchPlan) -> None:
        self.machine = StateMachine()
        self.plan = plan
        self.rest()
        self.memory = FaultMemory(od)
        self._od = od
        self._controlword = od[_CONTROLWORD]
        self._diagnosis = Diagnosis(
            od["Diagnosis.Code"], od["Diagnosis.Present"], od["Diagnosis.Latched"]
        )
        self._message = od["Message"]
        self.operational = True
        self.live = False
        self.tared = False
        self.supervised = True
        self.advice: Callable[[], str] = str
        self.details: Callable[[Watchdog], str] = lambda _watchdog: ""
        self.present = self.latched = 0
        self._seen = 0
        self._ignores_first = False
        self._undriven = True
        self._refusal = _NO_REFUSAL

    @property
    def state(self) -> State:
        """Present state."""
        return self.machine.state

    @property
    def armed(self) -> bool:
        """Whether a fault would trip now: the device is armed or running."""
        return self.machine.state in _ARMED_STATES

    @property
    def tare_inhibited(self) -> bool:
        """Whether a new zero of the gauges is refused, as it would change a drive or hide a fault.

        True while armed or running, and while a latched fault of the normal or lateral force is
        present.
        """
        return self.armed or bool(self.present & self.latched & _OVERLOAD)

    def restart(self) -> None:
        """Reset to the state after power-on; a reset from RUNNING is a fault."""
        driven = self.machine.state is State.RUNNING
        self.machine.restart()
        self.memory.show()
        self.live = False
        self.present = self.latched = 0
        self._seen = 0
        if driven:
            self.machine.state = State.FAULT
            self._latch(Watchdog.NMT, "reset node")
        self._publish()

    def rest(self) -> None:
        """Reset the watchdogs of the cycle for a plate at rest."""
        self.watch: WatchState = at_rest(self.plan)
        self.in_force: InForce = UNDRIVEN

    def command(self, word: int) -> None:
        """Obey a controlword.

        Raises
        ------
        Abort
            VALUE for unknown bits; STATE if there is no transition for it, the state is then
            unchanged. With the reason.
        """
        if word & ~CONTROL_MASK:
            known = f"{CONTROL_MASK:04X}h are known"
            raise Abort(AbortCode.VALUE, f"Controlword {word:04X}h has unknown bits: {known}")
        if not self._obey(word):
            raise Abort(AbortCode.STATE, self._why_not(word))
        self._seen = word

    def take_controlword(self) -> None:
        """Obey a controlword received in an RPDO; count an illegal one, and ignore it.

        The bits of the first one in OPERATIONAL count as set before, and are not obeyed.
        """
        word = self._controlword.value
        if self._ignores_first:
            self._ignores_first = False
            self.machine.take_as_given(word)
        if word == self._seen:
            return
        self._seen = word
        if self._obey(word):
            self.accept(_CONTROLWORD)
        else:
            self._od["Cycle.Ignored controlwords"].count()
            self.refuse(_CONTROLWORD, self._why_not(word))

    def permit(
        self, asked: Drive, measured: Measured, mode: int, cascade: Cascade, *, late: bool
    ) -> Drive:
        """Supervise a cycle; return the drive to send, which is 0 V unless RUNNING.

        Parameters
        ----------
        asked
            Drive of the controllers.
        measured
            Measurement that it answers.
        mode
            Mode of the controllers in this cycle.
        cascade
            Controllers after the cycle.
        late
            Whether the drive reaches the plate too late for the cycle that begins with this
            measurement.
        """
        plan = self.plan
        if self._undriven and asked.voltage:
            # Here, as cycles of the run before may follow its end.
            self._undriven = False
            vibration = without_lifts(plan.bound, self.watch.vibration)
            self.watch = self.watch._replace(vibration=vibration)
        seen = (
            measured, mode, cascade.mode, asked, cascade.contact, cascade.zero, cascade.tared,
            self.in_force,
        )  # fmt: skip
        self.watch, faults = watch_step(plan, self.watch, tuple.__new__(Seen, seen))
        self.live = True
        self.observe(faults, CYCLIC)
        beyond = self.watch.vibration.beyond and mode != _IDENTIFY
        if beyond or self.machine.state is not _RUNNING:
            asked = Drive(0.0, self._safe_frequency(asked.frequency))
        self.in_force, drive = cut_and_record(
            plan.bound, self.watch.vibration, self.in_force, asked, late
        )
        return drive

    def observe(self, faults: int, watchdogs: int) -> None:
        """Set which faults of some watchdogs are present, and trip; nothing else trips.

        While armed or running, every fault is latched. In FAULT, a fault that comes between two
        cycles is latched. After the last fault has gone, the device becomes READY with the next
        cycle.

        Parameters
        ----------
        faults
            Faults that are present, as bits, 1 << `Watchdog`.
        watchdogs
            Watchdogs that were checked, as bits; `CYCLIC` in a cycle. The others stay unchanged.
        """
        before = self.present
        between = watchdogs != CYCLIC
        self.present = present = before & ~watchdogs | faults & _PRESENT
        state = self.machine.state
        if faults & _SHOWN and not self.latched:
            self._message.value = next(
                WATCHDOGS[w].text for w in watchdogs_in(faults) if WATCHDOGS[w].shown
            )
        if faults and state in _ARMED_STATES:
            self._fault(faults)
        elif between and state is State.FAULT:
            self._latch_all(faults)
        elif state < _ARMED and (faults or not between):
            self.prepare()
        if present != before:
            self._diagnosis.present.value = present
            gone = before & ~present & _SHOWN
            if gone and not self.latched:
                texts = [WATCHDOGS[watchdog].text for watchdog in watchdogs_in(gone)]
                if self._message.value in texts:
                    self._clear_message()

    def handle(self, event: Event) -> None:
        """Make the transition for an event, if there is one; leaving FAULT clears the faults."""
        before = self.machine.state
        self.machine.handle(event, self._holds())
        self._clear_after(before)

    def refuse(self, name: str, reason: str) -> None:
        """Set the Message to the reason of a refused write, unless a fault is latched.

        The Message stays until a write to that record is accepted, see `accept`.
        """
        if not self.latched:
            self._refusal = Refusal(name.partition(".")[0], reason)
            self._message.value = reason

    def accept(self, name: str) -> None:
        """Clear the reason of a refusal from the Message, as a write to its record was accepted."""
        record, reason = self._refusal
        if record == name.partition(".")[0]:
            self._refusal = _NO_REFUSAL
            if self._message.value == reason:
                self._clear_message()

    def leave(self) -> None:
        """Follow NMT out of OPERATIONAL; leaving it in RUNNING is a fault."""
        self.operational = False
        self.live = False
        if self.machine.state is State.RUNNING:
            bit = 1 << Watchdog.NMT
            self.observe(bit, bit)
        self.handle(Event.LEAVE)

    def enter(self) -> None:
        """Follow NMT into OPERATIONAL; the present controlword is not obeyed."""
        self.operational = True
        self._ignores_first = True

    def start_run(self, tared: bool) -> None:
        """Disarm for a new run, with or without a zero of the gauges."""
        self.tared = tared
        self._undriven = True
        if not self.latched:
            self._clear_message()
        self.handle(Event.START_RUN)
        self.prepare()

    def note_zero(self) -> None:
        """Record that the gauges have a zero."""
        self.tared = True
        self.accept(TARE)
        self.prepare()

    def prepare(self) -> None:
        """Change between NOT_READY and READY according to the conditions."""
        state = self.machine.state
        if state is State.NOT_READY or state is State.READY:
            prepared = self._holds() & Guard.PREPARED
            if (state is State.READY) != bool(prepared):
                self.handle(Event.PREPARED if prepared else Event.UNPREPARED)
        self._diagnosis.present.value = self.present

    def _safe_frequency(self, frequency: float) -> float:
        """Return the frequency if it is within the limits, else the one put out last."""
        plan = self.plan
        if plan.f_min <= frequency <= plan.f_max:
            return frequency
        return self._od["Drive.Frequency"].si_value

    def _holds(self) -> Guard:
        supervised = Guard.SUPERVISED if self.supervised else Guard.NONE
        if self.present & self.latched:
            return supervised
        if self.live and self.operational and self.tared and not self.present:
            return supervised | Guard.CLEAR | Guard.PREPARED
        return supervised | Guard.CLEAR

    def _obey(self, word: int) -> bool:
        self.prepare()
        before = self.machine.state
        done = self.machine.command(word, self._holds())
        self._clear_after(before)
        return done

    def _why_not(self, word: int) -> str:
        state = self.machine.state
        if state is State.READY and not self.supervised:
            return f"{UNSUPERVISED}{self.advice()}"
        if state is State.NOT_READY:
            return f"not armed: {', and '.join(self._lacks())}"
        name = state.name.lower().replace("_", " ")
        order = "write 0, then 1 (arm), then 3 (run)"
        return f"Controlword {word:04X}h is refused in state {name}: {order}"

    def _lacks(self) -> Iterator[str]:
        """Yield for each condition of READY that is not met what to do."""
        if not self.operational:
            yield "the node is not in NMT OPERATIONAL, start it"
        elif not self.live:
            yield "no cycle was measured since the node was started, see that the plate runs"
        if not self.tared:
            yield "the gauges are not tared, lift the finger and tare"
        for watchdog in watchdogs_in(self.present):
            yield WATCHDOGS[watchdog].text

    def _fault(self, bits: int) -> None:
        self.handle(Event.FAULT)
        self._latch_all(bits)

    def _latch_all(self, bits: int) -> None:
        for watchdog in watchdogs_in(bits):
            self._latch(watchdog)

    def _latch(self, watchdog: Watchdog, circumstances: str = "") -> None:
        bit = 1 << watchdog
        if self.latched & bit:
            return
        if not self.latched:
            row = WATCHDOGS[watchdog]
            details = self.details(watchdog)
            text = f"{row.text}; {details}" if details else row.text
            self._diagnosis.code.value = row.code
            self._message.value = text
            self.memory.note(row.code, text, circumstances)
        self.latched |= bit
        self._diagnosis.latched.value = self.latched

    def _clear_after(self, before: State) -> None:
        if before is State.FAULT and self.machine.state is not before:
            self.latched = 0
            self._clear_message()
            self._publish()

    def _clear_message(self) -> None:
        """Set the Message to the first present fault that needs action."""
        texts = (row.text for w in watchdogs_in(self.present) if (row := WATCHDOGS[w]).shown)
        self._message.value = next(texts, "")

    def _publish(self) -> None:
        self._diagnosis.present.value = self.present
        self._diagnosis.latched.value = self.latched
        if not self.latched:
            self._diagnosis.code.value = 0

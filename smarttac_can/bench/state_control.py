"""State and mode of a stimulator over a link: arm, run, stop, reset, tare, identify."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from smarttac_can.bench.errors import FaultError, NotReadyError
from smarttac_can.bench.link import Link
from smarttac_can.bench.named_objects import DISARM_FIRST, NamedObjects
from smarttac_can.bench.set_points import by_name
from smarttac_can.bench.traces import Trace
from smarttac_can.master.errors import BenchError, RefusedError
from smarttac_can.od.cia import AbortCode
from smarttac_can.vocabulary.model import PlateModel
from smarttac_can.vocabulary.modes import Mode
from smarttac_can.vocabulary.objects import AUTO_ZERO, NOT_TARED, UNWATCHED, ZERO
from smarttac_can.vocabulary.signals import TARE_SAMPLES
from smarttac_can.vocabulary.states import Control, IdentificationState, State
from smarttac_can.vocabulary.watchdogs import WATCHDOGS, Watchdog, watchdogs_in

_READY_CYCLES: Final = 100
"""What the tare at power-on takes, and some lost cycles."""
_IDENTIFY_CYCLES: Final = 100
_IDENTIFY_LIMIT: Final = 100
_CONTROLWORD: Final = "Controlword"
_BY_WRONG_ZERO: Final = (Watchdog.GAUGES, Watchdog.PICKUP)
"""What watches the plate finds them with a finger on it that was tared away."""


class StateControl:
    """The state machine of a stimulator and its procedures.

    Parameters
    ----------
    objects
        Those of the stimulator.

    Attributes
    ----------
    knows_fault
        Whether who asked for the state last was told of a fault.
    """

    def __init__(self, objects: NamedObjects) -> None:
        self._objects = objects
        self.knows_fault = False

    @property
    def _link(self) -> Link:
        return self._objects.link

    def choose(self, mode: Mode | str) -> None:
        """Arm the stimulator and run it in a mode; OFF disarms it."""
        number = by_name(Mode, mode)
        if number == Mode.OFF:
            self.disarm()
            return
        running = self.state is State.RUNNING
        if not running:
            self.arm()
        try:
            self._link.write("Mode", number)
            if not running:
                self._link.write(_CONTROLWORD, Control.ARM | Control.RUN)
        except RefusedError as error:
            # A watchdog that trips in between is the reason, not the state that it leads to.
            self.require_no_fault(self.state)
            if number == Mode.TEXTURE and error.code == AbortCode.NO_DATA:
                hint = f"cannot play: {self._objects.message}: a script sets bench.texture first"
                raise RefusedError(hint, error.code) from error
            raise

    @property
    def state(self) -> State:
        """State of the device."""
        state = self._objects.state
        self.knows_fault = state is State.FAULT
        return state

    def claim(self) -> None:
        """Become the one bench that drives, before a procedure of many steps; nothing moves by it.

        Raises
        ------
        BenchError
            If another bench drives, or whoever drives has armed the stimulator.
        """
        self._link.drive()
        if self.state in (State.ARMED, State.RUNNING):
            raise BenchError(f"somebody drives the stimulator: {DISARM_FIRST}")

    def arm(self) -> None:
        """Arm, still at 0 V: a fault trips from then on. A loop that has just begun tares first.

        Raises
        ------
        FaultError
            If a fault is latched.
        NotReadyError
            If something is missing, or a fault is present.
        """
        # The heartbeat that a killed bench leaves missing is a fault that is present; this one's
        # ends it.
        self._link.drive()
        state = self.state
        if state is State.ARMED:
            return
        self.require_no_fault(state)
        self._link.write(_CONTROLWORD, 0)
        if self.state is State.NOT_READY:
            self._link.run(_READY_CYCLES, [])
        if self.state is not State.READY:
            raise self._not_ready()
        try:
            self._link.write(_CONTROLWORD, Control.ARM)
        except RefusedError as error:
            raise self._not_ready() from error

    def disarm(self) -> None:
        """Go to 0 V and mode OFF; allowed in every state."""
        self._link.write(_CONTROLWORD, 0)
        self._link.write("Mode", Mode.OFF)

    def stop_driving(self) -> bool:
        """Disarm, unless this bench only reads; tell whether that was possible."""
        try:
            if not self._link.only_read:
                self.disarm()
        except BenchError:
            return False
        return True

    def quick_stop(self) -> None:
        """Go to 0 V at once, and stay there until `disarm` or `arm`."""
        if self.state in (State.ARMED, State.RUNNING):
            self._link.write(_CONTROLWORD, Control.QUICK_STOP)

    def reset_fault(self) -> None:
        """Reset a latched fault; nothing happens if there is none.

        Raises
        ------
        FaultError
            If its cause is still there.
        """
        self._link.drive()
        if self.state is not State.FAULT:
            return
        self._link.write(_CONTROLWORD, 0)
        try:
            self._link.write(_CONTROLWORD, Control.FAULT_RESET)
        except RefusedError as error:
            raise FaultError(f"the fault cannot be reset: {self._lack()}") from error
        self._link.write(_CONTROLWORD, 0)
        self.knows_fault = False

    def start_run(self) -> None:
        """Put the simulated plate to rest at tick 0, with its finger and noise, controllers off."""
        self._link.drive()
        self._link.start_run()

    def tare(self) -> None:
        """Take the present gauge readings, without a finger, as zero.

        Raises
        ------
        RefusedError
            While armed or running: `disarm` first. If a gauge is further from its null than
            ``Gauge null.Window``: something rests on the plate.
        FaultError
            If a latched fault bars it, as too large a force does while it is there.
        """
        self._link.drive()
        self._link.run(TARE_SAMPLES, [])
        try:
            self._link.write(AUTO_ZERO[0], ZERO)
        except RefusedError as error:
            if self._objects.is_refused_while_armed(error):
                raise RefusedError(f"cannot tare: {DISARM_FIRST}", error.code) from error
            message = self._objects.message
            if message.startswith(NOT_TARED):
                raise RefusedError(message, error.code) from error
            self.require_no_fault(self.state)
            raise

    def identify(self, progress: Callable[[int], None] | None = None) -> PlateModel:
        """Identify the unloaded plate and have the controllers designed for it.

        Parameters
        ----------
        progress
            Called with the percentage that is done.

        Raises
        ------
        FaultError
            If a fault is latched.
        BenchError
            If the plate could not be identified.
        """
        self.choose(Mode.IDENTIFY)
        for _ in range(_IDENTIFY_LIMIT):
            self._link.run(_IDENTIFY_CYCLES, [])
            if progress is not None:
                progress(self._link.read("Model.Progress"))
            found = self._link.read("Model.State")
            if found != IdentificationState.RUNNING or self.state is not State.RUNNING:
                break
        self.disarm()
        self.require_no_fault(self.state)
        if found != IdentificationState.DONE:
            reason = self._objects.message or "no end in sight"
            raise BenchError(
                f"the plate could not be identified ({reason}): lift "
                "the finger, tare, and see that the limits of the frequency hold the resonance"
            )
        return PlateModel(
            gain=self._objects.get("Model.Gain per volt", "m"),
            tau=self._objects.get("Model.Tau", "s"),
            f0=self._objects.get("Model.Resonance", "Hz"),
        )

    def require_no_fault(self, state: State, trace: Trace | None = None) -> None:
        """Raise `FaultError` in state FAULT, with what a run has recorded."""
        if state is State.FAULT:
            recorded = "; .trace holds the recording" if trace is not None else ""
            reason = _with_cure(self._objects.message)
            raise FaultError(
                f"a fault is latched ({reason}): remove the cause, then reset_fault(){recorded}",
                trace,
            )

    def _not_ready(self) -> NotReadyError:
        return NotReadyError(f"the stimulator is not ready: {self._lack()}")

    def _lack(self) -> str:
        wrong_time = self._link.wrong_time()
        if wrong_time:
            return wrong_time
        present = watchdogs_in(self._link.read("Diagnosis.Present"))
        if present:
            return _with_cure(", ".join(WATCHDOGS[watchdog].text for watchdog in present))
        message = self._objects.message
        if message.startswith((UNWATCHED, NOT_TARED)):
            return message
        return "it has to be tared, and its nodes have to be operational and give cycles"


def _with_cure(reason: str) -> str:
    """Return why a stimulator stands, and what to do where that is not what one would look for."""
    if not any(WATCHDOGS[watchdog].text in reason for watchdog in _BY_WRONG_ZERO):
        return reason
    return (
        f"{reason}; a zero taken under a finger, as one at power-on or reset may be, does this "
        "too: lift it, then tare()"
    )

"""The stimulator as a lab script sees it: connect, arm, set, read, run, record; over any link."""

from __future__ import annotations

import atexit
import os
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, Final, Self, cast

import numpy as np
import numpy.typing as npt

from smarttac_can.bench.errors import (
    BusyError,
    FaultError,
    NotReadyError,
    NotRunningError,
    RunInterruptedError,
)
from smarttac_can.bench.events import Events
from smarttac_can.bench.given import (
    Given,
    by_name,
    given,
    given_integer,
    integer,
    require_callable,
    said,
    sequence,
    within,
)
from smarttac_can.bench.given import metadata as own_metadata
from smarttac_can.bench.link import ClosedLink, Link, Reading, Row, unwrapped
from smarttac_can.bench.named_objects import (
    ARMED,
    DISARM_FIRST,
    Choice,
    InUnit,
    NamedObjects,
)
from smarttac_can.bench.plate_loads import SimulatedFinger
from smarttac_can.bench.recording import Recording
from smarttac_can.bench.recording_file import METADATA
from smarttac_can.bench.simulation import STIMULATOR_ID, LinkName, open_simulated_link
from smarttac_can.bench.textures import FINEST_MM_N, FOLLOWED_HZ, Texture
from smarttac_can.bench.traces import Trace, require_labels
from smarttac_can.canopen.bus.bus import LogHook
from smarttac_can.canopen.master.errors import BenchError, RefusedError
from smarttac_can.canopen.od.cia import AbortCode
from smarttac_can.canopen.od.dictionary import ObjectDictionary
from smarttac_can.host.process_signals import interrupt_waits
from smarttac_can.host.terminal import progress_bar
from smarttac_can.vocabulary.meanings import AUTO_ZERO, NOT_TARED, UNSUPERVISED, ZERO
from smarttac_can.vocabulary.model import PlateModel
from smarttac_can.vocabulary.signals import TARE_SAMPLES
from smarttac_can.vocabulary.states import (
    Control,
    IdentificationState,
    Law,
    Mode,
    State,
    VibrationLaw,
)
from smarttac_can.vocabulary.textures import TABLE_NAMES, TextureTable
from smarttac_can.vocabulary.watchdogs import WATCHDOGS, Watchdog, watchdogs_in

_EXPLAINED: Final = (AbortCode.NO_DATA, AbortCode.VALUE, AbortCode.STATE)
"""Abort codes of a refused texture for which the object Message holds the reason."""
_READY_CYCLES: Final = 100
"""Cycles that the tare at power-on takes, plus some lost cycles."""
_IDENTIFY_CYCLES: Final = 100
_IDENTIFY_LIMIT: Final = 100
_CONTROLWORD: Final = "Controlword"
_BY_WRONG_ZERO: Final = (Watchdog.GAUGES, Watchdog.PICKUP)
"""Watchdogs that trip on a correct plate if its zero was tared with a finger on it."""
_SIDES: Final = 2
CYCLES_PER_SECOND: Final = 1000
_LEAST_RECORDED: Final = 0.5
"""Fraction of the cycles of a run that must be recorded."""
_MOST_S: Final = 604_800
_LONG_S: Final = 2.0
"""A progress bar is shown for longer runs."""
_MOST_SAMPLES: Final = 1_000_000
_MOST_CYCLES: Final = 100
"""Most cycles per sample; the SDO reads of one sample fit in them, even on a slow bus."""


class Stimulator(NamedObjects):
    """A SMARTTAC stimulator, as a context manager that leaves it at 0 V.

    Create one with `connect` or `simulate`.

    Parameters
    ----------
    link
        Link to the stimulator; closed together with it.
    od
        Object dictionary from the EDS of the stimulator.

    Attributes
    ----------
    finger
        Finger of a simulated plate.
    """

    # A misspelt property is an error, not a new attribute.
    __slots__ = ("_knows_fault", "_recording", "finger")

    voltage = InUnit("Setpoint.Voltage", "V", "Set-point of mode OPEN_LOOP in V.")
    frequency = InUnit(
        "Setpoint.Frequency", "Hz", "Excitation frequency in Hz: fixed, or the start of its loop."
    )
    amplitude = InUnit("Setpoint.Amplitude", "um", "Set-point of the amplitude in um peak-to-peak.")
    boundary = InUnit("Setpoint.Boundary", "mm", "Boundary in mm from the middle of the plate.")
    law = Choice(
        "Friction law",
        Law,
        "Friction law: the amplitude to which its step is added; set by member or name.",
    )
    vibration_law = Choice(
        "Controller.Vibration law",
        VibrationLaw,
        "Law for amplitude and resonance; set by member or name, also while running.",
    )

    def __init__(self, link: Link, od: ObjectDictionary) -> None:
        super().__init__(link, od)
        # Whether the state was FAULT when it was last read.
        self._knows_fault = False
        self._recording: Recording | None = None
        self.finger = SimulatedFinger(self.get, self._set_all)

    @property
    def cof(self) -> tuple[float, float]:
        """Set-points of the COF left and right of the boundary; a number sets both."""
        with self._link.turn:
            return self.get("Setpoint.COF left"), self.get("Setpoint.COF right")

    @cof.setter
    def cof(self, cof: float | str | Iterable[float | str]) -> None:
        self._set_alike(_sides(cof))

    @property
    def mode(self) -> Mode:
        """Requested mode. Setting a mode arms and starts the stimulator; setting OFF disarms it.

        Setting raises `FaultError` and `NotReadyError` as `arm` does.
        """
        return Mode(self._link.read("Mode"))

    @mode.setter
    def mode(self, mode: Mode | str) -> None:
        number = by_name(Mode, mode)
        with self._link.turn:
            self._enter(number)

    def _enter(self, number: int) -> None:
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
            # If a watchdog trips meanwhile, report the fault, not the refusal that follows from it.
            self._require_no_fault(self.state)
            if number == Mode.TEXTURE and error.code == AbortCode.NO_DATA:
                hint = f"cannot play: {self.message}: a script sets bench.texture first"
                raise RefusedError(hint, error.code) from error
            raise

    @property
    def state(self) -> State:
        """State of the device. `run` raises no `FaultError` for a fault that was seen here."""
        state = self._shown_state()
        self._knows_fault = state is State.FAULT
        return state

    @property
    def texture_slot(self) -> int:
        """Slot, 1 to 4, that mode TEXTURE plays and `texture` reads; may be set while running."""
        return int(self._link.read("Texture.Slot"))

    @texture_slot.setter
    def texture_slot(self, slot: int) -> None:
        number = given_integer("texture_slot", slot)
        with self._link.turn, self._texture_explained("Texture.Slot"):
            self._set("Texture.Slot", number)

    @property
    def texture(self) -> Texture | None:
        """Texture in the selected slot, None if the slot is empty; may be set while it is played.

        Setting raises `ValueError` if a COF is beyond the bounds of the stimulator, and
        `RefusedError` if the stimulator refuses the texture; the slot is then unchanged. A warning
        is given if the texture is too fast or too fine to be followed: above `FOLLOWED_HZ`, or with
        a period below `FINEST_MM_N` over the force, at speed and force last passed to
        `finger.stroke`, or at 50 mm/s and 1 N.
        """
        with self._link.turn:
            data = self._link.read(self._table())
        return Texture(TextureTable.unpack(data)) if data else None

    @texture.setter
    def texture(self, texture: Texture | None) -> None:
        data = b""
        if texture is not None:
            if not isinstance(texture, Texture):
                raise ValueError(f"texture {said(texture)} is no Texture")
            bounds = self._od["Setpoint.COF left"]
            texture.table.require_within(int(bounds.low), int(bounds.high))
            data = texture.table.pack()
            self._warn_if_fast(texture)
        with self._link.turn:
            name = self._table()
            with self._texture_explained(name):
                self._link.write(name, data)

    def _warn_if_fast(self, texture: Texture) -> None:
        speed = self.finger.speed
        fast = texture.frequency(speed)
        if fast > FOLLOWED_HZ:
            at = "" if texture.is_over_time else f" at {speed:g} mm/s"
            warnings.warn(
                f"half of the texture is above {fast:.0f} Hz{at}, and the COF follows up to "
                f"{FOLLOWED_HZ:g} Hz: make it coarser, or stroke more slowly",
                stacklevel=3,
            )
        elif not texture.is_over_time and fast * FINEST_MM_N > speed * self.finger.force:
            warnings.warn(
                f"half of the texture has periods below {speed / fast:.2g} mm, and under "
                f"{self.finger.force:g} N the position is good for "
                f"{FINEST_MM_N / self.finger.force:.2g} mm: make it coarser, or press more",
                stacklevel=3,
            )

    def _table(self) -> str:
        return TABLE_NAMES[self.texture_slot - 1]

    @contextmanager
    def _texture_explained(self, name: str) -> Iterator[None]:
        """Raise the refusal of a texture again with the reason that the stimulator gives."""
        try:
            yield
        except RefusedError as error:
            if error.code not in _EXPLAINED:
                raise
            raise RefusedError(f"cannot write {name}: {self.message}", error.code) from error

    @classmethod
    def connect(
        cls,
        *,
        interface: str | None = None,
        channel: str | None = None,
        node_id: int = STIMULATOR_ID,
        plate_node_id: int | None = None,
        lockstep: bool = False,
        timeout: float | None = None,
        **options: Any,
    ) -> Self:
        """Connect to a stimulator on a CAN bus, and start it and its plate node, if there is one.

        Parameters
        ----------
        interface, channel, options
            Arguments of python-can; what is omitted comes from python-can's configuration.
            Frames of udp_multicast stay on this computer unless ``hop_limit`` is given there.
        node_id
            Node-ID of the stimulator, 1..127.
        plate_node_id
            Node-ID of the plate node, 1..127; None if the plate is inside the stimulator.
        lockstep
            Whether the nodes were started with ``--lockstep``: the bench then produces the SYNC.
        timeout
            Longest wait in s for an SDO answer, and in real time for the first values of `read`.
            By default 1, or 5 in lockstep, where a slow process misses nothing.

        Raises
        ------
        BenchError
            If the bus cannot be opened, no node answers, or the node is another device.
        """
        from smarttac_can.bench.can_link import open_can_link  # noqa: PLC0415 - loads canopen

        bench = cls(
            *open_can_link(
                interface=interface,
                channel=channel,
                node_id=node_id,
                plate_node_id=plate_node_id,
                lockstep=lockstep,
                timeout=timeout,
                options=options,
            )
        )
        _CONNECTED.append(bench)
        return bench

    @classmethod
    def simulate(
        cls,
        link: LinkName = "bus",
        *,
        seed: int = 1,
        subject: int = 1,
        plate_inside: bool = False,
        finger: Trace | Iterable[tuple[float, float, float]] | None = None,
        presets: Mapping[str, int | str] | None = None,
        log: LogHook | None = None,
    ) -> Self:
        """Simulate a stimulator and its plate inside this process, without threads or waiting.

        Parameters
        ----------
        link
            ``bus`` for two CANopen nodes and this bench on a virtual CAN bus, in lockstep;
            ``local`` for their function blocks without CANopen: the same numbers, faster.
        seed
            Seed of noise and finger, 0..2^32 - 1.
        subject
            Number of the finger's subject: 1..5 are presets, 6..9 are fitted to Table I.
        plate_inside
            Whether the plate is inside the stimulator node; without a bus it always is.
        finger
            Samples of your own finger, played instead of a stroke: time in s from the start of the
            run, position in mm from the middle of the plate, -38..38, and normal force in N, 0..10.
            There are 2 or more, in order of time, interpolated linearly. The finger is lifted
            before the first sample and after the last. A force down to -0.01, as by noise in the
            air, is 0. Or a trace, whose finger is played again.
        presets
            Values by name that replace defaults of the stimulator's EDS: raw integers, or texts
            with a unit as `set` takes them, such as ``800 nm``.
        log
            Function called with the time stamp in us and the frame, for every frame on the bus;
            not available with link ``local``.

        Raises
        ------
        ValueError
            If there is no such link, seed or subject, `plate_inside` is neither True nor False, a
            sample of `finger` is out of range or order, a preset is no value of its object, or
            `log` is not callable or the link has no bus.
        BenchError
            If a preset names an object that does not exist.
        """
        bench = cls(
            *open_simulated_link(
                link,
                seed=seed,
                subject=subject,
                plate_inside=plate_inside,
                finger=finger,
                presets={} if presets is None else presets,
                log=log,
            )
        )
        bench.finger.recall()
        return bench

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        try:
            self.close()
        except BenchError:
            # Report the first failure, not the one that follows from it.
            if kind is None:
                raise

    def close(self) -> None:
        """Disarm, unless this bench only reads, and leave the bus; may be called twice.

        The end of a ``with`` block calls it, and so does a normal end of the process: of its last
        line, by `sys.exit` or by an exception. A killed process cannot, and the stimulator trips
        when it misses the heartbeat of this bench. Any later access raises `BenchError`.

        A process that was forked from the one that connected has no connection of its own: there,
        every access raises `BenchError`, and its end sends nothing.

        Raises
        ------
        BenchError
            If the stimulator could not be disarmed. The bus is left all the same, and without the
            heartbeat of this bench the stimulator goes to 0 V after the heartbeat time.
        """
        link = self._link
        if isinstance(link, ClosedLink):
            return
        try:
            with link.turn:
                try:
                    if not link.only_read:
                        self.disarm()
                finally:
                    self._link = cast("Link", ClosedLink(link.where, "is closed: connect anew"))
        finally:
            if self in _CONNECTED:
                _CONNECTED.remove(self)
            link.close()

    def _disown(self) -> None:
        """Refuse every access from now on, without a word to the stimulator."""
        self._link = cast("Link", ClosedLink(self._link.where, _PARENTS))

    def __dir__(self) -> list[str]:
        return [name for name in super().__dir__() if not name.startswith("_")]

    def __repr__(self) -> str:
        return f"<Stimulator over {self._link.where}>"

    def claim(self) -> None:
        """Become the commander before a procedure of many steps, without moving anything.

        Raises
        ------
        BenchError
            If another bench is the commander, or the stimulator is armed.
        """
        with self._link.turn:
            self._link.drive()
            if self.state in ARMED:
                raise BenchError(f"the stimulator is in use: {DISARM_FIRST}")

    def arm(self) -> None:
        """Arm at 0 V; from then on a fault trips. A loop that has just started is tared first.

        Raises
        ------
        FaultError
            If a fault is latched.
        NotReadyError
            If something required is missing, or a fault is present.
        NotRunningError
            If the loop gives no cycles.
        BenchError
            If another bench is the commander, or the bus or a node is lost.
        """
        with self._link.turn:
            self._arm()

    def _arm(self) -> None:
        # After a bench was killed, its missing heartbeat is a fault that is present. The heartbeat
        # of this bench clears it.
        self._link.drive()
        state = self.state
        if state is State.ARMED:
            return
        self._require_no_fault(state)
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
        with self._link.turn:
            self._link.write(_CONTROLWORD, 0)
            self._link.write("Mode", Mode.OFF)

    def _stop_driving(self) -> bool:
        """Disarm, unless this bench only reads; return False if that failed."""
        try:
            if not self._link.only_read:
                self.disarm()
        except BenchError:
            return False
        return True

    def quick_stop(self) -> None:
        """Go to 0 V at once, and stay there until `disarm` or `arm` is called."""
        with self._link.turn:
            if self.state in ARMED:
                self._link.write(_CONTROLWORD, Control.QUICK_STOP)

    def reset_fault(self) -> None:
        """Reset a latched fault; nothing happens if there is none.

        Raises
        ------
        FaultError
            If the cause of the fault is still present.
        BenchError
            If another bench is the commander.
        """
        with self._link.turn:
            self._reset_fault()

    def _reset_fault(self) -> None:
        self._link.drive()
        if self.state is not State.FAULT:
            return
        self._link.write(_CONTROLWORD, 0)
        try:
            self._link.write(_CONTROLWORD, Control.FAULT_RESET)
        except RefusedError as error:
            raise FaultError(f"the fault cannot be reset: {self._lack()}") from error
        self._link.write(_CONTROLWORD, 0)
        self._knows_fault = False

    def start_run(self) -> None:
        """Restart plate, finger and noise of the simulation at tick 0, with the controllers off."""
        with self._link.turn:
            self._link.drive()
            self._link.start_run()
            self.finger.begin()

    def tare(self) -> None:
        """Take the present gauge readings, without a finger, as zero.

        Raises
        ------
        RefusedError
            While armed or running: `disarm` first. Also if a gauge is further from its null than
            ``Gauge null.Window``: something rests on the plate.
        FaultError
            If a fault is latched, for example by too large a force.
        NotRunningError
            If the loop gives no cycles.
        BusyError
            If another thread is running the loop.
        BenchError
            If another bench is the commander, or the bus or a node is lost.
        """
        self._link.drive()
        self._link.run(TARE_SAMPLES, [])
        try:
            self._link.write(AUTO_ZERO[0], ZERO)
        except RefusedError as error:
            if self._is_refused_while_armed(error):
                raise RefusedError(f"cannot tare: {DISARM_FIRST}", error.code) from error
            message = self.message
            if message.startswith(NOT_TARED):
                raise RefusedError(message, error.code) from error
            self._require_no_fault(self.state)
            raise

    def identify(self, progress: Callable[[int], None] | None = None) -> PlateModel:
        """Identify the unloaded plate, and design the controllers for it.

        Parameters
        ----------
        progress
            Function called with the progress in percent.

        Raises
        ------
        FaultError
            If a fault is latched.
        NotReadyError
            If a condition for arming is not met.
        NotRunningError
            If the loop gives no cycles.
        BusyError
            If another thread is running the loop.
        BenchError
            If the plate could not be identified, another bench is the commander, or the bus or a
            node is lost.
        """
        if progress is not None:
            require_callable("progress", progress)
        self._link.require_idle()
        self.mode = Mode.IDENTIFY
        reason = "it was stopped"
        for _ in range(_IDENTIFY_LIMIT):
            try:
                self._link.run(_IDENTIFY_CYCLES, [])
            except BusyError:  # another thread has begun to record, and not this
                self.disarm()
                raise
            if progress is not None:
                progress(self._link.read("Model.Progress"))
            found = self._link.read("Model.State")
            if found != IdentificationState.RUNNING or self.state is not State.RUNNING:
                break
        else:
            reason = f"no end within {_IDENTIFY_LIMIT * _IDENTIFY_CYCLES} cycles"
        self.disarm()
        self._require_no_fault(self.state)
        if found != IdentificationState.DONE:
            raise BenchError(
                f"the plate could not be identified ({self.message or reason}): lift "
                "the finger, tare, and see that the limits of the frequency include the resonance"
            )
        return PlateModel(
            gain=self.get("Model.Gain per volt", "m"),
            tau=self.get("Model.Tau", "s"),
            f0=self.get("Model.Resonance", "Hz"),
            softening=self.get("Model.Softening", "Hz/m"),
        )

    def _require_no_fault(self, state: State, trace: Trace | None = None) -> None:
        """Raise `FaultError` in state FAULT, with the trace of the run if there is one."""
        if state is State.FAULT:
            recorded = "; .trace holds the recording" if trace is not None else ""
            reason = _with_cure(self.message)
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
        message = self.message
        if message.startswith((UNSUPERVISED, NOT_TARED)):
            return message
        return "it has to be tared, and its nodes have to be operational and give cycles"

    def read(self) -> Reading:
        """Return the values that the stimulator published last, with their age.

        Right after `connect` it waits for the first values, up to the time-out given there. In
        lockstep and in a simulation the first values come with the first `run`.

        Raises
        ------
        NotRunningError
            If the stimulator has not published all values yet, or is not OPERATIONAL.
        HeartbeatLostError
            If the heartbeat of a node is lost.
        """
        return Reading.from_snapshot(self._link.snapshot(), self._od)

    def run(
        self,
        seconds: float | str,
        experiment: str = "run",
        subject: int | None = None,
        *,
        metadata: Mapping[str, str | float] | None = None,
        meanwhile: Callable[[int], None] = lambda _: None,
    ) -> Trace:
        """Run the loop, and return what was recorded in each of its cycles of 1 ms.

        From 2 s on, a progress bar is shown on a terminal and in a notebook.

        If a fault is already known from a `FaultError` or from `state`, the run only records. So
        time can pass until the cause is gone, before `reset_fault`.

        Parameters
        ----------
        seconds
            Length in s, 0.001 to 604800, or a text such as ``200 ms``; loop time in lockstep, time
            of the clock otherwise.
        experiment, subject
            Labels of the trace. By default the subject is that of the finger that this bench has
            put on a simulated plate, `finger.subject`; 0 if there is none, or it is a person.
        metadata
            Own keys with texts or numbers that the trace and its CSV file keep, such as
            ``{"humidity_percent": 45, "sample": "PMMA"}``.
        meanwhile
            Called again and again with the number of cycles recorded so far. It may write
            set-points, so that a step is within the trace.

        Raises
        ------
        ValueError
            If `seconds` is not a finite number within its bounds, or a label is invalid; nothing
            has run then.
        FaultError
            If a fault is latched at the end that was not known at the beginning; `trace` of the
            error is what was recorded.
        BusyError
            If another thread is in `run`, `tare` or `identify` of this stimulator; that call goes
            on.
        NotRunningError
            If the loop gives no cycles, or most of them were lost.
        HeartbeatLostError
            If the heartbeat of a node is lost.
        BusLostError
            If the bus is lost.
        RunInterruptedError
            On Ctrl-C, between two cycles.

        The last four errors disarm, unless this bench only reads. Their `trace` holds what was
        recorded until then, or is None.
        """
        subject = require_labels(experiment, self.finger.subject if subject is None else subject)
        made = partial(_trace, experiment, subject, own_metadata(metadata))
        require_callable("meanwhile", meanwhile)
        knew_fault = self._knows_fault
        cycles = round(within("seconds", seconds, 1e-3, _MOST_S, "s") * CYCLES_PER_SECOND)
        rows: list[Row] = []
        with self._running(rows, made) as interrupted:
            with progress_bar(experiment, _LONG_S) as progress:

                def ends() -> bool:
                    progress(len(rows) / cycles)
                    meanwhile(len(rows))
                    return interrupted()

                self._link.run(cycles, rows, ends)
                progress(len(rows) / cycles)
            if interrupted():
                raise RunInterruptedError(f"interrupted after {len(rows)} of {cycles} cycles")
            state = self.state
            if len(rows) < cycles * _LEAST_RECORDED:
                if not knew_fault:  # it says why, and stays latched
                    self._require_no_fault(state, made(rows))
                raise NotRunningError(
                    f"{cycles - len(rows)} of {cycles} cycles were lost: is this machine too "
                    "busy, or the bus too slow for it?"
                )
        trace = made(rows[:cycles])
        if not knew_fault:
            self._require_no_fault(state, trace)
        return trace

    def sample(self, names: Sequence[str], count: int) -> npt.NDArray[np.float64]:
        """Read objects once per sample, one or more cycles apart, while the loop runs.

        Use it for measured values that the node does not publish: raw gauges, ``Plate input.S1``.
        In real time a sample takes as long as its SDO reads, and the objects of one sample may come
        from successive cycles.

        Parameters
        ----------
        names
            Names of the objects, one or more.
        count
            Number of samples, 1 to 1000000.

        Returns
        -------
        ndarray
            Shape (count, number of objects), in displayed units.

        Raises
        ------
        ValueError
            If `count` is not an integer of 1 to 1000000, or `names` is not a list of names.
        BenchError
            If an object does not exist, or is not a number. Other errors as in `run`.
        """
        count = integer("count", count, 1, _MOST_SAMPLES)
        names = sequence("names", names)
        if not names:
            raise ValueError("names [] has no name of an object")
        samples: list[list[float]] = []
        rows: list[Row] = []
        knew_fault = self._knows_fault
        with self._running(rows, partial(_trace, "sample", 0, {})) as interrupted:

            def ends() -> bool:
                if rows:
                    samples.append([self.get(name) for name in names])
                return len(samples) == count or interrupted()

            self._link.run(count * _MOST_CYCLES, rows, ends)
            if len(samples) < count:
                few = f"{len(samples)} of {count} samples"
                if interrupted():
                    raise RunInterruptedError(f"interrupted after {few}")
                raise NotRunningError(f"the loop gave {few}: is the bus too slow for it?")
            state = self.state
        if not knew_fault:
            self._require_no_fault(state)
        return np.array(samples)

    @contextmanager
    def _running(
        self, rows: list[Row], made: Callable[[list[Row]], Trace]
    ) -> Iterator[Callable[[], bool]]:
        """Disarm and keep what was recorded if an error ends a run.

        Yields a function that returns whether Ctrl-C was pressed.
        """
        with interrupt_waits() as interrupted:
            try:
                yield interrupted
            except BusyError:  # the run of another thread goes on
                raise
            except BenchError as error:
                self._end_run(error, rows, made)
                raise

    def _end_run(
        self, error: BenchError, rows: list[Row], made: Callable[[list[Row]], Trace]
    ) -> None:
        """Attach what was recorded to the error that ends a run, and disarm."""
        if rows:
            error.trace = made(rows)
            error.add_note(f".trace holds the {len(rows)} cycles until then")
        if isinstance(self._link, ClosedLink):  # by another thread, which has disarmed
            return
        if not self._link.only_read:
            error.add_note(
                "the stimulator was disarmed"
                if self._stop_driving()
                else "it could not be disarmed: it stops when it misses the heartbeat of this bench"
            )

    def record(
        self,
        path: Path | str,
        *,
        raw: Path | str | None = None,
        subject: str = "",
        operator: str = "",
        notes: str = "",
        metadata: Mapping[str, str | float] | None = None,
    ) -> Recording:
        """Record in the background during a ``with`` block.

        Every cycle and every set-point, from this bench or from others, goes into a log. At the end
        of the block an HDF5 file is made from it. If the process is killed, the log remains and
        lacks 1 s at most: ``smarttac record --recover``. If an error or Ctrl-C ends the block, the
        stimulator is disarmed first.

        Parameters
        ----------
        path
            HDF5 file to create, ``.h5`` or ``.hdf5``; it must not exist. `read_recording` reads it.
        raw
            Additional file for all frames on the bus, in the format of python-can that its suffix
            selects; it must not exist.
        subject, operator, notes
            Texts stored in the file: who was recorded, by whom and how; up to 1000 characters each.
        metadata
            Own keys with texts or numbers, such as ``{"humidity_percent": 45, "sample": "PMMA"}``.

        Raises
        ------
        ValueError
            If one of these is not a text, or too long, or `metadata` has another value, or one of
            these three names as a key.
        BenchError
            If another recording of this bench is active. At the start of the block: if the file
            exists, has another suffix or cannot be written, h5py is missing, the TPDOs do not carry
            the tick, or `raw` has an unknown format or there is no bus.
        """
        if self._recording is not None and self._recording.goes_on:
            raise BenchError(f"{self._recording.path} is being recorded: one file at a time")
        own = own_metadata(metadata)
        for name in METADATA:
            if name in own:
                raise ValueError(f"{name} is an argument of record: give it there, not in metadata")
        self._recording = Recording(
            self._link,
            self._od,
            Path(path),
            None if raw is None else Path(raw),
            {**own, "subject": subject, "operator": operator, "notes": notes},
            self._stop_driving,
        )
        return self._recording

    def events(self) -> Events:
        """Receive state changes, faults and lost heartbeats during a ``with`` block.

        During the block any thread may make other calls. Several blocks may be open at once.

        Examples
        --------
        >>> with Stimulator.simulate() as stimulator, stimulator.events() as events:
        ...     stimulator.mode = "amplitude"
        ...     print([event.text for event in events.within(0.1)])
        ['ready', 'armed', 'running']
        """
        return Events(self._link, self._od.node_id)

    def mark(self, text: str) -> None:
        """Add a marker to the active recording.

        Parameters
        ----------
        text
            1 to 1000 characters.

        Raises
        ------
        BenchError
            If no recording is active.
        ValueError
            If the text is empty or too long.
        """
        if self._recording is None:
            raise BenchError("nothing is being recorded: markers go into a recording")
        self._recording.mark(text)


def _trace(
    experiment: str, subject: int, metadata: Mapping[str, str | float], rows: list[Row]
) -> Trace:
    return Trace(experiment, subject, unwrapped(rows), metadata)


_PARENTS: Final = "belongs to the process from which this one was forked: connect here"
_CONNECTED: Final[list[Stimulator]] = []
"""Benches of this process that are connected to a bus and not closed."""


@atexit.register
def _close_all() -> None:
    """Disarm at a normal end of the process what it has armed and not closed."""
    for bench in list(_CONNECTED):
        try:
            bench.close()
        except BenchError as error:
            warnings.warn(f"{bench!r} could not be disarmed at the end: {error}", stacklevel=1)


def _disown_all() -> None:
    """Leave all benches to the process from which this one was forked.

    The child has the sockets, but not the threads that receive: it could send, and would hear no
    answer.
    """
    for bench in _CONNECTED:
        bench._disown()  # noqa: SLF001 - a part of it
    _CONNECTED.clear()


if hasattr(os, "register_at_fork"):  # Windows does not fork
    os.register_at_fork(after_in_child=_disown_all)


def _sides(cof: float | str | Iterable[float | str]) -> dict[str, Given]:
    """Return the set-points of the COF, given as a number for both sides or as a pair."""
    names = ("Setpoint.COF left", "Setpoint.COF right")
    if isinstance(cof, str) or not isinstance(cof, Iterable) or getattr(cof, "ndim", 1) == 0:
        return dict.fromkeys(names, given("cof", cof, ""))
    pair = sequence("cof", cof)
    if len(pair) != _SIDES:
        raise ValueError(f"cof {said(cof)} is neither a number nor a pair, left and right")
    words = ("cof left", "cof right")
    return {n: given(word, side, "") for n, word, side in zip(names, words, pair, strict=True)}


def _with_cure(reason: str) -> str:
    """Return the reason of a fault, with a hint where a wrong zero may be the cause."""
    if not any(WATCHDOGS[watchdog].text in reason for watchdog in _BY_WRONG_ZERO):
        return reason
    return (
        f"{reason}; a zero taken under a finger, as one at power-on or reset may be, does this "
        "too: lift it, then tare()"
    )

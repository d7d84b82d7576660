"""The control loop as a script has it: it runs, and what comes of it is recorded or read."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Final

import numpy as np
import numpy.typing as npt

from smarttac_can.bench.errors import BusyError, NotRunningError, RunInterruptedError
from smarttac_can.bench.link import Row, unwrapped
from smarttac_can.bench.named_objects import NamedObjects, finite
from smarttac_can.bench.reading import Reading
from smarttac_can.bench.state_control import StateControl
from smarttac_can.bench.traces import Trace, require_labels
from smarttac_can.host.process_signals import interrupt_waits
from smarttac_can.host.terminal import progress_bar
from smarttac_can.master.errors import BenchError

CYCLES_PER_SECOND: Final = 1000
_LEAST_RECORDED: Final = 0.5
_MOST_S: Final = 604_800
_LONG_S: Final = 2.0
"""Who waits for longer is shown how far it is."""
_MOST_CYCLES: Final = 100
"""In which the objects of a sample have been read, on a slow bus as well."""


class Loop:
    """The loop of a stimulator.

    Parameters
    ----------
    objects
        Those of the stimulator.
    control
        Its state machine.
    """

    def __init__(self, objects: NamedObjects, control: StateControl) -> None:
        self._objects = objects
        self._control = control

    def read(self) -> Reading:
        """Return what the stimulator published last, with its age.

        Right after `connect` it waits for the first values, up to the time-out given there; in
        lockstep and in a simulation they come with the first `run`.

        Raises
        ------
        NotRunningError
            If it has not published all of them yet, or is no longer OPERATIONAL.
        HeartbeatLostError
            If a node has fallen silent.
        """
        return Reading.from_snapshot(self._objects.link.snapshot(), self._objects.od)

    def run(self, seconds: float, experiment: str = "run", subject: int = 0) -> Trace:
        """Let the loop run, and return what was recorded in each of its cycles of 1 ms.

        From 2 s on a bar shows how far it is, on a terminal and in a notebook.

        With a fault that is known already, by a `FaultError` or by `state`, it just records: the
        cause goes, and time passes, before `reset_fault`.

        Parameters
        ----------
        seconds
            How long, 0.001 to 604800: of the loop's time in lockstep, of the clock's otherwise.
        experiment, subject
            Labels of the trace.

        Raises
        ------
        ValueError
            If `seconds` is not a finite number, or outside its bounds, or a label is none; nothing
            has run then.
        FaultError
            If a fault is latched at its end that was not known at its beginning; `trace` of the
            error is what was recorded.
        BusyError
            If another thread is in `run`, `tare` or `identify` of this stimulator, which go on.
        NotRunningError
            If the loop gives no cycles, or most of them were lost.
        HeartbeatLostError
            If a node falls silent.
        RunInterruptedError
            At Ctrl-C, between two cycles.

        The last three disarm, and their `trace` is what was recorded until then.
        """
        require_labels(experiment, subject)
        knew_fault = self._control.knows_fault
        length = finite("seconds", seconds)
        cycles = round(length * CYCLES_PER_SECOND) if abs(length) <= _MOST_S else 0
        if cycles < 1:
            raise ValueError(f"seconds {seconds} is outside 0.001..{_MOST_S}")
        rows: list[Row] = []
        with self._running(rows, experiment, subject) as interrupted:
            with progress_bar(experiment, _LONG_S) as progress:

                def ends() -> bool:
                    progress(len(rows) / cycles)
                    return interrupted()

                self._objects.link.run(cycles, rows, ends)
                progress(len(rows) / cycles)
            if interrupted():
                raise RunInterruptedError(f"interrupted after {len(rows)} of {cycles} cycles")
            if len(rows) < cycles * _LEAST_RECORDED:
                raise NotRunningError(
                    f"{cycles - len(rows)} of {cycles} cycles were lost: is this machine too "
                    "busy, or the bus too slow for it?"
                )
            state = self._control.state
        trace = Trace(experiment, subject, unwrapped(rows[:cycles]))
        if not knew_fault:
            self._control.require_no_fault(state, trace)
        return trace

    def sample(self, names: Sequence[str], count: int) -> npt.NDArray[np.float64]:
        """Read objects again and again while the loop runs once, a cycle or more apart.

        What the node measures and does not publish is read so: raw gauges, ``Plate input.S1``.
        In real time one sample after another takes as long as the SDO reads do, and the objects of
        one sample may be of cycles that follow each other.

        Parameters
        ----------
        names
            Names of the objects, one or more.
        count
            How many times, 1 or more.

        Returns
        -------
        ndarray
            Shape (count, number of objects), in displayed units.

        Raises
        ------
        ValueError
            If `count` is no integer of 1 or more, or `names` are none.
        BenchError
            If there is no such object, or it is no number. Otherwise as `run`.
        """
        if type(count) is not int or count < 1:
            raise ValueError(f"count {count!r} is no integer of 1 or more")
        if isinstance(names, str) or not names:
            raise ValueError(f"names {names!r} are no list of names of objects")
        samples: list[list[float]] = []
        rows: list[Row] = []
        knew_fault = self._control.knows_fault
        with self._running(rows, "sample", 0) as interrupted:

            def ends() -> bool:
                if rows:
                    samples.append([self._objects.get(name) for name in names])
                return len(samples) == count or interrupted()

            self._objects.link.run(count * _MOST_CYCLES, rows, ends)
            if len(samples) < count:
                few = f"{len(samples)} of {count} samples"
                if interrupted():
                    raise RunInterruptedError(f"interrupted after {few}")
                raise NotRunningError(f"the loop gave {few}: is the bus too slow for it?")
            state = self._control.state
        if not knew_fault:
            self._control.require_no_fault(state)
        return np.array(samples)

    @contextmanager
    def _running(
        self, rows: list[Row], experiment: str, subject: int
    ) -> Iterator[Callable[[], bool]]:
        """Have the loop run in a block: an error disarms, and keeps what was recorded.

        It gives the block what tells whether Ctrl-C has come.
        """
        with interrupt_waits() as interrupted:
            try:
                yield interrupted
            except BusyError:  # not this run to be ended
                raise
            except BenchError as error:
                self._end_run(error, rows, experiment, subject)
                raise

    def _end_run(self, error: BenchError, rows: list[Row], experiment: str, subject: int) -> None:
        """Keep what a run has recorded that an error ends, and disarm."""
        if rows:
            error.trace = Trace(experiment, subject, unwrapped(rows))
            error.add_note(f".trace holds the {len(rows)} cycles until then")
        if not self._objects.link.only_read:
            error.add_note(
                "the stimulator was disarmed"
                if self._control.stop_driving()
                else "it could not be disarmed: it stops when it misses the heartbeat of this bench"
            )

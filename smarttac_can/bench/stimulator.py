"""The bench's stimulator: opened and closed, read, run and recorded, over any link."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self, cast

from smarttac_can.bench.errors import NotRunningError, RunInterruptedError
from smarttac_can.bench.finger import SimulatedFinger
from smarttac_can.bench.link import ClosedLink, Link, Row, unwrapped
from smarttac_can.bench.named_objects import finite
from smarttac_can.bench.open_link import LinkName, open_can_link, open_simulated_link
from smarttac_can.bench.reading import Reading
from smarttac_can.bench.recording import Recording
from smarttac_can.bench.simulation import STIMULATOR_ID
from smarttac_can.bench.state_control import StateControl
from smarttac_can.bench.traces import Trace, require_labels
from smarttac_can.host.bus import LogHook
from smarttac_can.host.process_signals import interrupt_waits
from smarttac_can.master.errors import BenchError
from smarttac_can.od.dictionary import ObjectDictionary

CYCLES_PER_SECOND: Final = 1000
_LEAST_RECORDED: Final = 0.5


class Stimulator(StateControl):
    """A SMARTTAC stimulator at the bench; a context manager that leaves it at 0 V.

    `connect` and `simulate` make one.

    Parameters
    ----------
    link
        How it is reached; closed with the stimulator.
    od
        EDS of the stimulator.

    Attributes
    ----------
    finger
        The finger of a simulated plate.
    """

    __slots__ = ("_recording", "finger")

    def __init__(self, link: Link, od: ObjectDictionary) -> None:
        super().__init__(link, od)
        self.finger = SimulatedFinger(self.set)
        self._recording: Recording | None = None

    @classmethod
    def connect(
        cls,
        *,
        interface: str | None = None,
        channel: str | None = None,
        node_id: int = STIMULATOR_ID,
        plate_node_id: int | None = None,
        lockstep: bool = False,
        timeout: float = 1.0,
        **options: Any,
    ) -> Self:
        """Connect to a stimulator on a CAN bus and start it, and its plate node if it has one.

        Parameters
        ----------
        interface, channel, options
            As python-can has them; what is not given comes from python-can's configuration.
        node_id
            Node-ID of the stimulator, 1..127.
        plate_node_id
            Node-ID of the plate node, 1..127; None with the plate inside the stimulator.
        lockstep
            Whether the nodes were started with ``--lockstep``: the bench then produces the SYNC.
        timeout
            Longest wait for an SDO answer in s.

        Raises
        ------
        BenchError
            If the bus cannot be opened, no node answers, or it is another device.
        """
        return cls(
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

    @classmethod
    def simulate(
        cls,
        link: LinkName = "bus",
        *,
        plate_inside: bool = False,
        presets: Mapping[str, int] | None = None,
        log: LogHook | None = None,
    ) -> Self:
        """Simulate a stimulator and its plate inside this process, without threads or waiting.

        Parameters
        ----------
        link
            ``bus`` for two CANopen nodes and this bench on a virtual CAN bus, in lockstep;
            ``local`` for their function blocks without CANopen: the same numbers, faster.
        plate_inside
            Whether the plate is inside the stimulator node; without a bus it always is.
        presets
            Raw values by name that replace defaults of the stimulator's EDS.
        log
            Called with the time stamp in us and the frame, for every frame on the bus.
        """
        return cls(
            *open_simulated_link(link, plate_inside=plate_inside, presets=presets or {}, log=log)
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            self.close()
        except BenchError:
            # The first failure is the one to report.
            if kind is None:
                raise

    def close(self) -> None:
        """Disarm, unless this bench only read, and leave the bus; may be called twice.

        A ``with`` does it. Where there is none, as in a notebook, the plate is driven for as long
        as the process lives, or until this is called. Whatever is asked of it afterwards raises
        `BenchError`.

        Raises
        ------
        BenchError
            If it could not be disarmed; the bus has been left all the same, and the heartbeat of
            this bench ends the drive within its time.
        """
        link = self._link
        if isinstance(link, ClosedLink):
            return
        try:
            if not link.only_read:
                self.disarm()
        finally:
            self._link = cast("Link", ClosedLink(link.where))
            link.close()

    def _stop_driving(self) -> bool:
        """Disarm, unless this bench only reads; tell whether that was possible."""
        try:
            if not self._link.only_read:
                self.disarm()
        except BenchError:
            return False
        return True

    def __repr__(self) -> str:
        return f"<Stimulator over {self._link.where}>"

    def read(self) -> Reading:
        """Return what the stimulator published last, with its age.

        Raises
        ------
        NotRunningError
            If it has published nothing yet, or is no longer OPERATIONAL.
        HeartbeatLostError
            If a node has fallen silent.
        """
        return Reading.from_snapshot(self._link.snapshot(), self._od)

    def run(self, seconds: float, experiment: str = "run", subject: int = 0) -> Trace:
        """Let the loop run, and return what was recorded in each of its cycles of 1 ms.

        With a fault that is known already, by a `FaultError` or by `state`, it just records: the
        cause goes, and time passes, before `reset_fault`.

        Parameters
        ----------
        seconds
            How long, 0.001 or more: of the loop's time in lockstep, of the clock's otherwise.
        experiment, subject
            Labels of the trace.

        Raises
        ------
        ValueError
            If `seconds` is not a finite number, or too short, or a label is none; nothing has run
            then.
        FaultError
            If a fault is latched at its end that was not known at its beginning; `trace` of the
            error is what was recorded.
        NotRunningError
            If the loop gives no cycles, or most of them were lost.
        HeartbeatLostError
            If a node falls silent.
        RunInterruptedError
            At Ctrl-C, between two cycles.

        The last three disarm, and their `trace` is what was recorded until then.
        """
        require_labels(experiment, subject)
        knew_fault = self._knows_fault
        cycles = round(finite("seconds", seconds) * CYCLES_PER_SECOND)
        if cycles < 1:
            raise ValueError(f"seconds {seconds} is below 0.001")
        rows: list[Row] = []
        with interrupt_waits() as interrupted:
            try:
                self._link.run(cycles, rows, interrupted)
                if interrupted():
                    raise RunInterruptedError(f"interrupted after {len(rows)} of {cycles} cycles")
                if len(rows) < cycles * _LEAST_RECORDED:
                    raise NotRunningError(
                        f"{cycles - len(rows)} of {cycles} cycles were lost: does another bench "
                        "script record, or is the bus too slow for it?"
                    )
                state = self.state
            except BenchError as error:
                self._end_run(error, rows, experiment, subject)
                raise
        trace = Trace.from_rows(experiment, subject, unwrapped(rows[:cycles]))
        if not knew_fault:
            self._require_no_fault(state, trace)
        return trace

    def _end_run(self, error: BenchError, rows: list[Row], experiment: str, subject: int) -> None:
        """Keep what a run has recorded that an error ends, and disarm."""
        if rows:
            error.trace = Trace.from_rows(experiment, subject, unwrapped(rows))
            error.add_note(f".trace holds the {len(rows)} cycles until then")
        if not self._link.only_read:
            error.add_note(
                "the stimulator was disarmed"
                if self._stop_driving()
                else "it could not be disarmed: it stops when it misses the heartbeat of this bench"
            )

    def record(self, path: Path | str, *, raw: Path | str | None = None) -> Recording:
        """Record in the background, whatever else is done, while a ``with`` block lasts.

        Every cycle that comes, with what is set meanwhile, from here or by others, goes into a log;
        at the end of the block an HDF5 file is made of it. A process that is killed leaves the log,
        which lacks a second at most: ``smarttac record --recover``. An error that ends the block,
        Ctrl-C too, disarms first.

        Parameters
        ----------
        path
            The file, which does not exist yet.
        raw
            File for all frames on the bus besides, in the format of python-can that its suffix
            stands for; it does not exist yet.

        Raises
        ------
        BenchError
            If another recording of this bench goes on; as the block begins, if the file exists or
            cannot be written, h5py is missing, the TPDOs do not carry the tick, or there is no
            such format or no bus.
        """
        if self._recording is not None and self._recording.goes_on:
            raise BenchError(f"{self._recording.path} is being recorded: one file at a time")
        self._recording = Recording(
            self._link,
            self._od,
            Path(path),
            None if raw is None else Path(raw),
            self._stop_driving,
        )
        return self._recording

    def mark(self, text: str) -> None:
        """Put a marker into the recording that goes on.

        Parameters
        ----------
        text
            1 to 1000 characters.

        Raises
        ------
        BenchError
            If none goes on.
        """
        if self._recording is None:
            raise BenchError("nothing is being recorded: markers go into a recording")
        self._recording.mark(text)

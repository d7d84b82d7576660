"""The bench's stimulator: set-points and read-backs in a person's units, over any link."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import TracebackType
from typing import Any, Final, Self

from smarttac_can.bench.errors import BenchError, FaultError, NotReadyError, RefusedError
from smarttac_can.bench.finger import SimulatedFinger
from smarttac_can.bench.link import Link, Row
from smarttac_can.bench.named_objects import NamedObjects
from smarttac_can.bench.open_link import (
    STIMULATOR_ID,
    LinkName,
    open_can_link,
    open_simulated_link,
)
from smarttac_can.bench.reading import Reading
from smarttac_can.bench.traces import Trace
from smarttac_can.control import identification
from smarttac_can.control.cascade import Mode
from smarttac_can.control.friction import Law
from smarttac_can.control.model import PlateModel
from smarttac_can.host.bus import LogHook
from smarttac_can.nodes.analogue_input import AUTO_ZERO, ZERO
from smarttac_can.nodes.read_back import STATE_SHIFT
from smarttac_can.nodes.state_machine import Control, State
from smarttac_can.nodes.watchdogs import WATCHDOGS, watchdogs_in
from smarttac_can.od.dictionary import ObjectDictionary

CYCLES_PER_SECOND: Final = 1000
_TARE_CYCLES: Final = 64
_READY_CYCLES: Final = 100
"""What the tare at power-on takes, and some lost cycles."""
_CONTROLWORD: Final = "Controlword"
_STATE_MASK: Final = 0b111
_IDENTIFY_CYCLES: Final = 100
_IDENTIFY_LIMIT: Final = 50


class Stimulator:
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

    # A misspelt property is an error, not a new attribute.
    __slots__ = ("_link", "_objects", "_od", "finger")

    def __init__(self, link: Link, od: ObjectDictionary) -> None:
        self._link = link
        self._od = od
        self._objects = NamedObjects(link, od)
        self.finger = SimulatedFinger(self.set)

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
            self.disarm()
        except BenchError:
            # The first failure is the one to report.
            if kind is None:
                raise
        finally:
            self._link.close()

    def get(self, name: str) -> float:
        """Read an object of the stimulator or the simulation by name, in its displayed unit.

        Raises
        ------
        BenchError
            If there is no such object, or it is no number.
        """
        return self._objects.get(name)

    def set(self, name: str, value: float) -> None:
        """Write an object by name, in its displayed unit; refused, not clipped, outside its limits.

        Raises
        ------
        RefusedError
            If the device refuses the value; nothing has changed then.
        BenchError
            If there is no such object, or it is no number.
        ValueError
            If the value is not finite.
        """
        self._objects.set(name, value)

    @property
    def mode(self) -> Mode:
        """Mode asked for; setting one arms the stimulator and runs it, OFF disarms it.

        Setting raises `FaultError` and `NotReadyError` as `arm` does.
        """
        return Mode(self._link.read("Mode"))

    @mode.setter
    def mode(self, mode: Mode | str) -> None:
        number = _by_name(Mode, mode)
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
        except RefusedError:
            # A watchdog that trips in between is the reason, not the state that it leads to.
            self._require_no_fault(self.state)
            raise

    @property
    def state(self) -> State:
        """State of the device."""
        return State(self._link.read("Statusword") >> STATE_SHIFT & _STATE_MASK)

    def arm(self) -> None:
        """Make the watchdogs sharp, at 0 V; a loop that has just begun gets the time for its tare.

        Raises
        ------
        FaultError
            If a fault is latched.
        NotReadyError
            If something is missing, or a fault is present.
        """
        state = self.state
        if state is State.ARMED:
            return
        self._require_no_fault(state)
        self._link.write(_CONTROLWORD, 0)
        if self.state is State.NOT_READY:
            self._link.run(_READY_CYCLES)
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
        self._link.write(_CONTROLWORD, 0)
        if self.state is not State.FAULT:
            return
        try:
            self._link.write(_CONTROLWORD, Control.FAULT_RESET)
        except RefusedError as error:
            raise FaultError(f"the fault cannot be reset: {self._lack()}") from error
        self._link.write(_CONTROLWORD, 0)

    def _require_no_fault(self, state: State) -> None:
        if state is State.FAULT:
            raise FaultError(
                f"a fault is latched ({self.message}): remove the cause, then reset_fault()"
            )

    def _not_ready(self) -> NotReadyError:
        return NotReadyError(f"the stimulator is not ready: {self._lack()}")

    def _lack(self) -> str:
        present = watchdogs_in(self._link.read("Diagnosis.Present"))
        if present:
            return ", ".join(WATCHDOGS[watchdog].text for watchdog in present)
        return "it has to be tared, and its nodes have to be operational and give cycles"

    @property
    def law(self) -> Law:
        """Friction law."""
        return Law(self._link.read("Friction law"))

    @law.setter
    def law(self, law: Law | str) -> None:
        self._link.write("Friction law", _by_name(Law, law))

    @property
    def voltage(self) -> float:
        """Set-point of mode OPEN_LOOP in V."""
        return self.get("Setpoint.Voltage") * 1e-3

    @voltage.setter
    def voltage(self, volts: float) -> None:
        self.set("Setpoint.Voltage", volts * 1e3)

    @property
    def frequency(self) -> float:
        """Excitation frequency in Hz: fixed, or where the resonance loop starts from."""
        return self.get("Setpoint.Frequency")

    @frequency.setter
    def frequency(self, hertz: float) -> None:
        self.set("Setpoint.Frequency", hertz)

    @property
    def amplitude(self) -> float:
        """Set-point of the amplitude in um peak-to-peak."""
        return self.get("Setpoint.Amplitude") * 1e-3

    @amplitude.setter
    def amplitude(self, micrometres: float) -> None:
        self.set("Setpoint.Amplitude", micrometres * 1e3)

    @property
    def cof(self) -> tuple[float, float]:
        """Set-points of the COF left and right of the boundary; a number sets both."""
        return self.get("Setpoint.COF left"), self.get("Setpoint.COF right")

    @cof.setter
    def cof(self, cof: float | Sequence[float]) -> None:
        left, right = cof if isinstance(cof, Sequence) else (cof, cof)
        self.set("Setpoint.COF left", left)
        self.set("Setpoint.COF right", right)

    @property
    def boundary(self) -> float:
        """Position of the boundary in mm from the middle of the plate."""
        return self.get("Setpoint.Boundary") * 1e-3

    @boundary.setter
    def boundary(self, millimetres: float) -> None:
        self.set("Setpoint.Boundary", millimetres * 1e3)

    @property
    def message(self) -> str:
        """Why the stimulator turned itself off; empty if it did not."""
        return self._link.text("Message")

    def read(self) -> Reading:
        """Return what the stimulator published last, with its age.

        Raises
        ------
        NotRunningError
            If it has published nothing yet.
        HeartbeatLostError
            If a node has fallen silent.
        """
        return Reading.from_snapshot(self._link.snapshot(), self._od)

    def run(self, seconds: float, experiment: str = "run", subject: int = 0) -> Trace:
        """Let the loop run, and return what was recorded in each of its cycles of 1 ms.

        Parameters
        ----------
        seconds
            How long, 0.001 or more: of the loop's time in lockstep, of the clock's otherwise.
        experiment, subject
            Labels of the trace.

        Raises
        ------
        NotRunningError
            If the loop gives no cycles.
        """
        cycles = round(seconds * CYCLES_PER_SECOND)
        if cycles < 1:
            raise ValueError(f"seconds {seconds} is below 0.001")
        return Trace.from_rows(experiment, subject, _unwrapped(self._link.run(cycles)))

    def start_run(self) -> None:
        """Put the simulated plate to rest at tick 0, with its finger and noise, controllers off."""
        self._link.start_run()

    def tare(self) -> None:
        """Take the present gauge readings, without a finger, as zero."""
        self._link.run(_TARE_CYCLES)
        self._link.write(AUTO_ZERO[0], ZERO)

    def identify(self, progress: Callable[[int], None] | None = None) -> PlateModel:
        """Identify the unloaded plate and have the controllers designed for it.

        Parameters
        ----------
        progress
            Called with the percentage that is done.

        Raises
        ------
        BenchError
            If the plate could not be identified.
        """
        self.mode = Mode.IDENTIFY
        for _ in range(_IDENTIFY_LIMIT):
            self._link.run(_IDENTIFY_CYCLES)
            if progress is not None:
                progress(self._link.read("Model.Progress"))
            state = self._link.read("Model.State")
            if state == identification.State.DONE:
                self.disarm()
                return PlateModel(
                    gain=self.get("Model.Gain per volt") * 1e-12,
                    tau=self.get("Model.Tau") * 1e-6,
                    f0=self.get("Model.Resonance"),
                )
            if state == identification.State.FAILED:
                break
        reason = self.message or "no end in sight"
        self.disarm()
        raise BenchError(
            f"the plate could not be identified ({reason}): lift the "
            "finger, tare, and set the frequency within 300 Hz of the resonance"
        )


def _by_name(choices: type[Mode] | type[Law], choice: int | str) -> int:
    if not isinstance(choice, str):
        return int(choices(choice))
    name = choice.upper().replace("-", "_").replace(" ", "_").replace("+", "_")
    if name not in choices.__members__:
        known = ", ".join(member.lower() for member in choices.__members__)
        raise ValueError(f"{choices.__name__.lower()} {choice!r} is none of {known}")
    return int(choices[name])


def _unwrapped(rows: list[Row]) -> list[Row]:
    """Extend the 16-bit ticks of the rows so that they keep rising."""
    if not rows:
        return rows
    tick = rows[0][0]
    extended = []
    for row in rows:
        tick += row[0] - tick & 0xFFFF
        extended.append((tick, *row[1:]))
    return extended
